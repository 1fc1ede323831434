#!/usr/bin/env python3
"""check_bag must name each of the usual faults of a recording, and accept a sound one."""
import os
import struct
import subprocess
import sys
import tempfile
import unittest
from unittest import mock

import cv2
import genpy.dynamic
import numpy as np
import rosbag
import rosunit
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Imu

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'scripts'))
from air_ground_eval import bag_camera, bag_check, bag_depth, bag_frames, bag_guess, bag_player, bag_reader, geometry, messages, own_outputs, replay  # noqa: E402
from air_ground_eval.recording import Camera  # noqa: E402

CAMERA = Camera(64, 48, 60, 60, 32, 24)
PICTURE = np.indices((48, 64)).sum(0) % 16 * 16


def compressed(array, seconds, frame, prefix=b'', kind='.jpg', form='mono8; jpeg compressed'):
    message = CompressedImage(format=form, data=prefix + cv2.imencode(kind, array)[1].tobytes())
    message.header.stamp, message.header.frame_id = messages.stamp(seconds), frame
    return message


def write(path, **faults):
    """A bag of 3 s with the faults asked for."""
    with rosbag.Bag(path, 'w') as bag:
        edges = [(f'{r}_base_link', f'{r}_{f}', np.eye(4)) for r in ('mav', 'ground') for f in ('camera_optical_frame', 'imu_link')]
        if not faults.get('no_tf'):
            for part in ([edges[:2], edges[2:]] if faults.get('split_tf') else [edges]):
                if faults.get('split_tf'):
                    bag.write('/tf_static', messages.static_transforms(part, 99), messages.stamp(99))
                else:
                    messages.write_latched(bag, '/tf_static', messages.static_transforms(part, 99), 99)
        if faults.get('clock'):
            bag.write('/clock', Clock(messages.stamp(100)), messages.stamp(100))
        later = faults.get('clocks', 0.0)
        noise = np.random.default_rng(5).normal(0, faults.get('gyro_noise', 0), (600, 3))
        for i in range(600):
            t = 100 + i / 200
            for robot in ('mav', 'ground'):
                accel = np.array([9.81, 0, 0] if faults.get('imu_axes') else [0, 0, 9.81]) * faults.get('imu_factor', 1.0)
                if faults.get('shaken'):
                    accel = faults['shaken'] * np.sin([70 * t, 83 * t, 97 * t])
                gyro = np.array([0.01 + (0.3 * np.sin(5 * t) if faults.get('moving') else 0), 0, 0]) * faults.get('gyro_factor', 1.0) + noise[i]
                topic = f'/{robot}/imu/data' if robot == 'ground' or not faults.get('imu_elsewhere') else '/imu0'
                stamp = 100 + (i // 10 * 10 + 10) / 200 + i % 10 * 1e-5 if faults.get('packets') else t
                bag.write(topic, messages.imu(gyro, accel, 1e-6, 1e-4, stamp, f'{robot}_imu_link'), messages.stamp(t))
            if i % 10 == 0 and not (faults.get('gap') and 200 < i < 400) and not (faults.get('lossy') and i % 80 > 50):
                stamp = t - 0.5 if faults.get('jump') and i == 300 else t
                info = messages.camera_info(CAMERA, stamp, 'mav_camera_optical_frame')
                if faults.get('uncalibrated'):
                    info.K, info.P = [0.0] * 9, [0.0] * 12
                if faults.get('fisheye'):
                    info.distortion_model = faults['fisheye']
                if not (faults.get('info_once') and i):
                    bag.write('/mav/camera/camera_info', info, messages.stamp(t))
                if faults.get('compressed'):
                    bag.write('/mav/camera/image_raw/compressed', compressed(np.zeros((48, 64), np.uint8), stamp, 'mav_camera_optical_frame'), messages.stamp(t))
                else:
                    bag.write('/mav/camera/image_raw', messages.image(np.full((48, 64), 128) if faults.get('flat') else PICTURE, 'mono8', stamp, 'mav_camera_optical_frame'), messages.stamp(t))
                frame = '' if faults.get('no_frame') else 'ground_camera_optical_frame'
                bag.write('/ground/rgb/image_raw', messages.image(np.dstack([PICTURE] * 3), 'rgb8', t + later, frame), messages.stamp(t))
                bag.write('/ground/rgb/camera_info', messages.camera_info(CAMERA, t + later, frame), messages.stamp(t))
                shape = {None: (48, 64), 'half': (24, 32), 'cut': (24, 64)}[faults.get('small_depth')]
                depth = faults.get('depth', 1500) if i >= faults.get('depth_from', 0) else 1500
                for kind in faults.get('depth_as', ()):
                    how, form = ('.png', '16UC1; png compressed ') if kind == 'png' else ('.jpg', '8UC1; jpeg compressed ')
                    steps = np.full(shape, depth if kind == 'png' else 100, np.uint16 if kind == 'png' else np.uint8)
                    bag.write('/ground/depth/image_raw/compressed', compressed(steps, t, frame, b'', how, form), messages.stamp(t))
                if faults.get('compressed'):
                    picture = compressed(np.full(shape, depth, np.uint16), t, frame, bytes(12), '.png', '16UC1; compressedDepth')
                    bag.write('/ground/depth/image_raw/compressedDepth', picture, messages.stamp(t))
                elif not faults.get('no_depth') and not faults.get('depth_as') and not (faults.get('slow_depth') and i % 20):
                    depth_frame = 'ground_depth_optical_frame' if faults.get('depth_frame') else frame
                    if faults.get('depth_calibrated'):
                        bag.write('/ground/depth/camera_info', messages.camera_info(CAMERA, t + later, depth_frame), messages.stamp(t))
                    bag.write('/ground/depth/image_raw', messages.image(np.full(shape, depth), '16UC1', t + later, depth_frame), messages.stamp(t))
                for robot in ('mav', 'ground'):
                    bag.write(f'/ground_truth/{robot}', messages.pose_stamped(geometry.pose(), t, 'world'), messages.stamp(t))


class BagCheck(unittest.TestCase):
    def findings(self, **faults):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write(path, **faults)
            return bag_check.check(path)

    def assert_found(self, level, text, **faults):
        found = [f.text for f in self.findings(**faults) if f.level == level]
        self.assertTrue(any(text in f for f in found), f'{faults}: no {level} with "{text}" in {found}')

    def test_a_sound_bag(self):
        for faults in ({}, dict(gyro_noise=0.07)):  # and one of a noisy IMU at rest
            self.assertEqual([f.text for f in self.findings(**faults) if f.level != bag_check.OK], [])
        self.assert_found(bag_check.WARNING, 'begins in motion', moving=True, gyro_noise=0.07)

    def test_errors(self):
        for text, faults in (('in g', dict(imu_factor=1 / 9.81)), ('gravity was removed', dict(imu_factor=0.01)), ('gravity was removed', dict(shaken=3.0)), ('gravity was removed', dict(shaken=0.8)), ('degrees', dict(gyro_factor=6000.0)),
                             ('not calibrated', dict(uncalibrated=True)), ('undistort', dict(fisheye='omni')), ('/tf_static', dict(no_tf=True)),
                             ('frame id is empty', dict(no_frame=True)), ('/ground/depth/image_raw is missing', dict(no_depth=True)),
                             ('differ in size', dict(small_depth='cut')), ('calibration is missing', dict(depth_frame=True)), ('the bag has /imu0', dict(imu_elsewhere=True))):
            self.assert_found(bag_check.ERROR, text, **faults)

    def test_depth_of_the_colour_camera_at_another_resolution(self):
        self.assertEqual([f.text for f in self.findings(small_depth='half') if f.level != bag_check.OK], [])
        self.assert_found(bag_check.OK, 'at another resolution', small_depth='half')
        self.assert_found(bag_check.ERROR, 'calibration is missing', small_depth='half', depth_frame=True)

    def test_warnings(self):
        for text, faults in (('clocks of the robots do not overlap', dict(clocks=5000.0)), ('stamps go back', dict(jump=True)), ('a gap of', dict(gap=True)),
                             ('messages are missing at 20 Hz, up to 2 in a row', dict(lossy=True)), ('messages a second, but most of them within 0.01 ms', dict(packets=True)), ('taken for 5000 a metre', dict(depth=20000)),
                             ('taken for 5000 a metre', dict(depth=20000, compressed=True)), ('taken for 5000 a metre', dict(depth=20000, depth_from=200)), ('half lies beyond 8.0 m', dict(depth=8000, depth_from=400)),
                             ('mav_image_transport:=compressed', dict(compressed=True)), ('ground_depth_transport:=compressed', dict(compressed=True)),
                             ('ground_depth_registered:=false', dict(depth_frame=True, depth_calibrated=True)), ('comes at 10.0 Hz', dict(slow_depth=True)),
                             ('(1.00, 0.00, 0.00) of mav_base_link, which is not up', dict(imu_axes=True)), ('the sign of gravity', dict(imu_factor=-1.0)), ('begins in motion', dict(moving=True)), ('image 3 is flat (brightness 128 +- 0.0', dict(flat=True))):
            self.assert_found(bag_check.WARNING, text, **faults)

    def test_depth_compressed_as_any_image(self):
        """image_transport's compressed keeps depth as PNG alone; `rosbag record -e '.*compressed.*'` takes a JPEG of it beside compressedDepth."""
        self.assert_found(bag_check.WARNING, 'replay with ground_depth:=/ground/depth/image_raw/compressed', depth_as=['png'])
        self.assert_found(bag_check.ERROR, 'hold no depth: record /ground/depth/image_raw/compressedDepth', depth_as=['jpeg'])
        self.assert_found(bag_check.WARNING, 'taken for 5000 a metre', depth_as=['png'], depth=20000)
        both = self.findings(depth_as=['jpeg'], compressed=True, depth=20000)
        self.assertEqual([f.text for f in both if f.level == bag_check.ERROR], [])
        self.assertTrue(any('/compressedDepth: median depth 20000 steps' in f.text for f in both), both)
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            for faults, word in ((dict(depth_as=['png']), 'ground_depth:=/ground/depth/image_raw/compressed'),
                                 (dict(depth_as=['jpeg'], compressed=True), 'ground_depth_transport:=compressed')):
                write(path, **faults)
                facts = bag_reader.BagFacts(path)
                words = bag_guess.command(facts, bag_guess.guess(facts), {}, {}).split()
                self.assertEqual([w for w in words if w.startswith('ground_depth')], [word])
                with mock.patch.object(replay, '_system_state', return_value=({}, {})):
                    missing = replay._missing_now(facts, [('ground_depth', '/ground/depth/image_raw', 'sensor_msgs/Image')])
                self.assertIn(f'set {word}', missing['/ground/depth/image_raw'])

    def test_depth_in_metres_behind_its_header(self):
        a, b = 10100.0, -1009.0  # steps = a / depth + b
        steps = np.full((48, 64), round(a / 0.5 + b), np.uint16)
        message = compressed(steps, 1, 'camera', struct.pack('<iff', 0, a, b), '.png', '32FC1; compressedDepth png')
        self.assertAlmostEqual(float(np.median(bag_camera.depths(message))), 0.5, places=3)
        self.assertEqual(bag_camera.check_depth('/depth', [message]), [])

    def test_too_little_depth_is_doubtful_and_none_is_wrong(self):
        depth = np.zeros((48, 64), np.uint16)
        for valid, level in ((0, bag_camera.ERROR), (40, bag_camera.WARNING), (400, None)):
            depth.flat[:valid] = 900
            found = bag_camera.check_depth('/depth', [compressed(depth, 1, 'camera', b'', '.png', '16UC1; png compressed ')])
            self.assertEqual([f.level for f in found], [level] if level else [], valid)

    def test_a_pause_is_named_once(self):
        self.assertFalse([f.text for f in self.findings(gap=True) if 'are missing at' in f.text])

    def test_an_imu_of_no_use_is_left_out_of_the_command(self):
        for faults in (dict(imu_factor=1 / 9.81), dict(shaken=3.0), dict(gyro_factor=6000.0)):
            arguments = {f.argument for f in self.findings(**faults) if f.argument}
            self.assertEqual(arguments, {'mav_use_imu:=false', 'ground_imu:=none'}, faults)

    def test_no_errors_where_the_nodes_can_help_themselves(self):
        for faults in (dict(compressed=True), dict(split_tf=True), dict(fisheye='equidistant'), dict(info_once=True)):
            self.assertEqual([f.text for f in self.findings(**faults) if f.level == bag_check.ERROR], [], faults)
        self.assert_found(bag_check.OK, '/clock is in the bag', clock=True)
        self.assert_found(bag_check.OK, '/tf_static comes in 2 messages and not latched', split_tf=True)

    def test_topics_are_guessed_and_the_command_printed(self):
        """Names as the drivers of others give them."""
        def first(path, cameras, edges):
            with rosbag.Bag(path, 'w') as bag:
                messages.write_latched(bag, '/tf_static', messages.static_transforms([(p, c, np.eye(4)) for p, c in edges], 99), 99)
                for t in np.arange(100, 102, 0.05):
                    for topic, kind, frame in cameras:
                        size = (48, 64, 3) if kind == 'rgb8' else (48, 64)
                        picture = compressed(np.zeros(size, np.uint8), t, frame) if topic.endswith('compressed') else messages.image(np.zeros(size), kind, t, frame)
                        bag.write(topic, picture, messages.stamp(t))
                        info = topic.replace('/compressed', '').rsplit('/', 1)[0] + '/camera_info'
                        bag.write(info, messages.camera_info(CAMERA, t, frame), messages.stamp(t))

        def imu(path, topic, frame):
            with rosbag.Bag(path, 'a') as bag:
                for t in np.arange(100, 102, 0.005):
                    bag.write(topic, messages.imu([0, 0, 0.001], [0, 0, 9.81], 1e-6, 1e-4, t, frame), messages.stamp(t))

        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            first(path, [('/cam0/image_raw', 'mono8', 'cam0'), ('/cam1/image_raw', 'mono8', 'cam1')], [('imu4', 'cam0'), ('imu4', 'cam1')])
            imu(path, '/imu0', 'imu4')
            check = os.path.join(HERE, '..', 'scripts', 'check_bag')
            result = subprocess.run(['/usr/bin/python3', check, path], capture_output=True, text=True, check=False)
            self.assertEqual(result.returncode, 0, result.stdout + result.stderr)
            self.assertEqual(result.stdout.splitlines()[-1], f'roslaunch air_ground replay.launch bag:={path} out:=out-x mav_image:=/cam0/image_raw '
                             'mav_camera_info:=/cam0/camera_info mav_imu:=/imu0 mav_base_frame:=imu4 mav_camera_frame:=cam0 rgbd_slam:=false '
                             'heightmap_mcl:=false view_match:=false icp_refine:=false')

            first(path, [('/drone/mono/image_raw/compressed', 'mono8', 'drone_cam'), ('/camera/color/image_raw', 'rgb8', 'camera_color'),
                         ('/camera/aligned_depth_to_color/image_raw', '16UC1', 'camera_color'), ('/camera/depth/image_rect_raw', '16UC1', 'camera_depth')],
                  [('drone/base_link', 'drone_cam'), ('drone/base_link', 'drone_imu'), ('base_footprint', 'base'), ('base', 'camera_color')])
            imu(path, '/drone/imu/data_raw', 'drone_imu')
            facts = bag_reader.BagFacts(path)
            names = bag_guess.guess(facts)
            self.assertEqual(names, {
                '/mav/camera/image_raw': '/drone/mono/image_raw', '/mav/camera/camera_info': '/drone/mono/camera_info', '/mav/imu/data': '/drone/imu/data_raw',
                '/ground/rgb/image_raw': '/camera/color/image_raw', '/ground/rgb/camera_info': '/camera/color/camera_info',
                '/ground/depth/image_raw': '/camera/aligned_depth_to_color/image_raw', '/ground/depth/camera_info': '/camera/aligned_depth_to_color/camera_info'})
            self.assertTrue(bag_check.registered(facts, names))
            self.assertFalse(bag_check.registered(facts, {**names, '/ground/depth/image_raw': '/camera/depth/image_rect_raw'}))
            line = bag_guess.command(facts, names, {'mav': bag_guess.guess_base(facts, 'mav', 'drone_cam'),
                                                    'ground': bag_guess.guess_base(facts, 'ground', 'camera_color')}, {'mav': 'drone_cam', 'ground': 'camera_color'})
            for word in ('mav_image_transport:=compressed', 'mav_base_frame:=drone/base_link', 'ground_base_frame:=base', 'ground_camera_frame:=camera_color'):
                self.assertIn(word, line.split())
            self.assertNotIn(':=false', line)
            self.assertNotIn('ground_depth_camera_info', line)
            unregistered = bag_guess.command(facts, names, {}, {}, registered=False).split()
            self.assertIn('ground_depth_camera_info:=/camera/aligned_depth_to_color/camera_info', unregistered)
            self.assertIn('ground_depth_registered:=false', unregistered)

    def test_an_imu_belongs_to_the_robot_that_it_is_mounted_on(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            with rosbag.Bag(path, 'w') as bag:
                edges = [('base', 'eye', np.eye(4)), ('base', 'gyro', np.eye(4)), ('body', 'cam', np.eye(4))]
                messages.write_latched(bag, '/tf_static', messages.static_transforms(edges, 99), 99)
                for t in np.arange(100, 102, 0.05):
                    for topic, kind, frame in (('/drone/image_raw', 'mono8', 'cam'), ('/camera/rgb/image_raw', 'rgb8', 'eye'), ('/camera/depth/image_raw', '16UC1', 'eye')):
                        bag.write(topic, messages.image(np.full((48, 64, 3) if kind == 'rgb8' else (48, 64), 100), kind, t, frame), messages.stamp(t))
                        bag.write(topic.replace('image_raw', 'camera_info'), messages.camera_info(CAMERA, t, frame), messages.stamp(t))
                    for k in range(10):
                        bag.write('/imu', messages.imu([0, 0, 0.001], [0, 0, 9.81], 1e-6, 1e-4, t + 0.005 * k, 'gyro'), messages.stamp(t + 0.005 * k))
            facts = bag_reader.BagFacts(path)
            names = bag_guess.guess(facts)
            self.assertNotIn('/mav/imu/data', names)
            self.assertEqual(names['/ground/imu/data'], '/imu')
            self.assertIn('mav_use_imu:=false', bag_guess.command(facts, names, {}, {}).split())
            found = bag_check.check(facts, names, {'mav': 'body', 'ground': 'base'})
            self.assertEqual([f.text for f in found if f.level == bag_check.ERROR], [])
            self.assertTrue(any('mav_use_imu:=false' in f.text for f in found if f.level == bag_check.WARNING))

    def test_gyro_and_accelerometer_apart(self):
        """As RealSense's driver publishes them unless told otherwise."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write(path, imu_elsewhere=True)
            with rosbag.Bag(path, 'a') as bag:
                for t in np.arange(100, 103, 0.005):
                    bag.write('/drone/gyro/sample', messages.imu([0, 0, 0.001], [0, 0, 0], 1e-6, 1e-4, t, 'mav_imu_link'), messages.stamp(t))
                for t in np.arange(100, 103, 0.016):
                    bag.write('/drone/accel/sample', messages.imu([0, 0, 0], [0, 0, 9.81], 1e-6, 1e-4, t, 'mav_imu_link'), messages.stamp(t))
            names = {'/mav/imu/data': '/drone/gyro/sample'}
            apart = [f.text for f in bag_check.check(path, names) if f.level == bag_check.ERROR]
            self.assertTrue(any('mav_imu_accel' in text for text in apart), apart)
            facts = bag_reader.BagFacts(path)
            facts.types = {topic: kind for topic, kind in facts.types.items() if topic != '/imu0'}
            names = bag_guess.guess(facts)
            self.assertEqual((names['/mav/imu/data'], names['/mav/imu/accel']), ('/drone/gyro/sample', '/drone/accel/sample'))
            self.assertEqual([f.text for f in bag_check.check(path, names) if f.level == bag_check.ERROR], [])
            self.assertIn('mav_imu_accel:=/drone/accel/sample', bag_guess.command(facts, names, {}, {}).split())

    def test_depth_by_run_lengths(self):
        """Against Wilson's description, number by number: of zeros, of others, and their differences."""
        depth = np.random.default_rng(3).integers(0, 65536, (9, 11), np.uint16)
        depth[2:4], depth[5], depth[8] = 0, 1500, 0
        numbers, before, flat = [], 0, depth.ravel().tolist()
        while flat:
            zeros = next((i for i, z in enumerate(flat) if z), len(flat))
            others = next((i for i, z in enumerate(flat[zeros:]) if not z), len(flat) - zeros)
            numbers += [zeros, others]
            for z in flat[zeros:zeros + others]:
                numbers, before = numbers + [2 * (z - before) if z >= before else 2 * (before - z) - 1], z
            flat = flat[zeros + others:]
        groups = []
        for number in numbers:
            while number > 7:
                groups, number = groups + [number % 8 + 8], number // 8
            groups.append(number)
        groups += [0] * (-len(groups) % 8)
        words = [sum(group << (28 - 4 * i) for i, group in enumerate(groups[k:k + 8])) for k in range(0, len(groups), 8)]
        data = struct.pack(f'<{len(words) + 2}I', 11, 9, *words)
        message = CompressedImage(format='16UC1; compressedDepth rvl', data=bytes(12) + data)
        np.testing.assert_array_equal(bag_camera.picture(message), depth)
        np.testing.assert_array_equal(bag_camera.depths(message), depth)
        for broken in (data[:40], b'', struct.pack('<III', 1 << 30, 9, 0)):
            self.assertIsNone(bag_camera.picture(CompressedImage(format=message.format, data=bytes(12) + broken)))

    def test_mountings_on_tf_are_static_and_no_frame_has_two_parents(self):
        """As TUM's RGB-D bags have it: all on /tf, names with slashes, and a motion capture's pose of the body."""
        T_kinect_camera, T_camera_eye = geometry.pose_from_tq((0.1, 0.2, 0.3), (0.5, -0.5, 0.5, -0.5)), geometry.pose_from_tq((0, -0.045, 0), (0, 0.6, 0, 0.8))
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            with rosbag.Bag(path, 'w') as bag:
                for t in np.arange(100, 170, 0.1):
                    edges = [('/kinect', '/camera', T_kinect_camera), ('/camera', '/eye', T_camera_eye)]
                    if round(10 * t) % 10 == 0:
                        bag.write('/tf', messages.static_transforms([('/camera', '/imu', np.eye(4))], t), messages.stamp(t))
                    if int(10 * t) % 2:  # the robot stands for the first half, and its pose comes in messages of its own
                        edges = [('/world', '/kinect', geometry.pose(translation=(max(0.0, t - 115), 2, 3)))]
                    bag.write('/tf', messages.static_transforms(edges, t), messages.stamp(t))
            facts = bag_reader.BagFacts(path)
        self.assertEqual(facts.constant_on_tf, {'camera', 'eye', 'imu'})
        self.assertEqual(facts.moving, {'kinect': 'world'})
        self.assertEqual(bag_frames.check_odometry(facts, ['ground'], {'ground': 'other'}), [])
        self.assertIn('world -> kinect, to which camera is fixed', bag_frames.check_odometry(facts, ['ground'], {'ground': 'camera'})[0].text)
        finding, = bag_frames.check_odometry(facts, ['ground'], {'ground': 'kinect'})
        self.assertIn('a reference, by its name, and no odometry', finding.text)
        np.testing.assert_allclose(facts.static_transform('kinect', 'eye'), T_kinect_camera @ T_camera_eye, atol=1e-9)
        turned = {(e.header.frame_id, e.child_frame_id): e.transform.translation for e in facts.static_transforms(['camera']).transforms}
        self.assertEqual(set(turned), {('camera', 'kinect'), ('camera', 'eye'), ('camera', 'imu')})
        inverse = turned['camera', 'kinect']
        np.testing.assert_allclose([inverse.x, inverse.y, inverse.z], np.linalg.inv(T_kinect_camera)[:3, 3], atol=1e-9)

        published = []
        player = bag_player.BagPlayer.__new__(bag_player.BagPlayer)
        player.others, player.left_out, player.chains, player.static = {'kinect', 'camera'}, set(), [], mock.Mock(claimed={'eye'})
        player.moving = type('Publisher', (), {'publish': lambda _, message: published.append(message)})()
        player._hand_on(messages.static_transforms([('/world', '/kinect', np.eye(4)), ('/world', '/door', np.eye(4))], 100))
        player._hand_on(messages.static_transforms([('/world', '/kinect', np.eye(4)), ('/world', '/eye', np.eye(4))], 101))
        self.assertEqual([[e.child_frame_id for e in m.transforms] for m in published], [['/door']])

    def test_the_odometry_of_a_robot_is_played_where_its_node_follows_that(self):
        for given, frames in (({}, ['mav_map', 'mav_odom', 'mav_base_link']), ({'mav_vo/odom_from_tf': True}, ['mav_map', 'mav_odom']),
                              ({'mav_vo/odom_from_tf': True, 'mav_vo/odom_frame': 'wheels'}, ['mav_map', 'wheels']), ({'mav_vo/base_frame': 'base_link'}, ['mav_map', 'mav_odom', 'base_link'])):
            with mock.patch('rospy.get_param', side_effect=lambda name, default, given=given: given.get(name, default)):
                self.assertEqual(own_outputs.chains(['mav_vo']), [frames])

    def test_messages_of_another_version(self):
        old = genpy.dynamic.generate_dynamic('sensor_msgs/Imu', Imu._full_text.replace('float64[9] linear_acceleration_covariance', '#'))['sensor_msgs/Imu']
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write(path, imu_elsewhere=True)
            with rosbag.Bag(path, 'a') as bag:
                for t in np.arange(100, 103, 0.005):
                    message = old()
                    message.header.stamp, message.header.frame_id, message.linear_acceleration.z = messages.stamp(t), 'mav_imu_link', 9.81
                    bag.write('/mav/imu/data', message, messages.stamp(t))
            errors = [f.text for f in bag_check.check(path, robots=('mav',)) if f.level == bag_check.ERROR]
        self.assertEqual(len(errors), 1, errors)
        self.assertIn('/mav/imu/data: no node takes it, since sensor_msgs/Imu is defined otherwise in the bag than here', errors[0])

    def test_mapped_names(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write(path, imu_elsewhere=True)
            self.assertEqual([f.text for f in bag_check.check(path, {'/mav/imu/data': '/imu0'}) if f.level == bag_check.ERROR], [])

    def test_a_compressed_topic_may_be_named_itself(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write(path, compressed=True)
            facts = bag_reader.BagFacts(path)
            names, findings, command = bag_check.examine(facts, given={'/mav/camera/image_raw': '/mav/camera/image_raw/compressed'})
            self.assertEqual(names['/mav/camera/camera_info'], '/mav/camera/camera_info')
            self.assertEqual([f.text for f in findings if f.level == bag_check.ERROR], [])
            self.assertIn('mav_image:=/mav/camera/image_raw/compressed', command.split())
            self.assertNotIn('mav_image_transport:=compressed', command.split())

    def test_a_bag_of_something_else(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            with rosbag.Bag(path, 'w') as bag:
                messages.write_latched(bag, '/tf_static', messages.static_transforms([('base_link', 'laser', np.eye(4))], 99), 99)
                bag.write('/chatter', messages.text('hello'), messages.stamp(100))
            check = os.path.join(HERE, '..', 'scripts', 'check_bag')
            result = subprocess.run(['/usr/bin/python3', check, path], capture_output=True, text=True, check=False)
            self.assertEqual((result.returncode, result.stderr), (1, ''))
            self.assertIn('ERROR   /mav/camera/image_raw is missing', result.stdout)
            self.assertNotIn('roslaunch', result.stdout)

    def test_how_far_depth_reaches(self):
        with open(os.path.join(HERE, '..', '..', 'config', 'rgbd_slam.yaml'), encoding='utf-8') as stream:
            self.assertIn(f'\ndepth_max_range: {bag_depth.MAX_RANGE} ', stream.read())
        images = [messages.image(np.where(np.arange(64) < 64 * share, 5000, 1500) * np.ones((48, 1)), '16UC1', 1, 'cam') for share in (0.75,)]
        self.assertIn('75 % of its depths lie beyond 4.5 m', bag_depth.check_range('/depth', images)[0].text)
        self.assertEqual(bag_depth.check_range('/depth', images, ['ground_depth_unit:=0.0002']), [])
        self.assert_found(bag_check.WARNING, 'set depth_max_range in a copy of config/rgbd_slam.yaml', depth=5000)

    def test_the_last_step_of_16_bits_is_no_depth(self):
        """Where half of an image has none, its driver's word for that decided what a step was."""
        images = [messages.image(np.where(np.arange(64) < 40, 65535, 1500) * np.ones((48, 1)), '16UC1', 1, 'cam')]
        self.assertEqual(bag_camera.check_depth('/depth', images) + bag_depth.check_range('/depth', images), [])

    def test_topics_whose_names_are_none_in_ros_are_not_played(self):
        names = ['/clock', '/cam/image_raw', '/device_0/option/Enable Auto Exposure/value', 'imu', '/a-b', '/1']
        self.assertEqual(bag_player.playable(names), (['/1', '/cam/image_raw', 'imu'], ['/a-b', '/device_0/option/Enable Auto Exposure/value']))

    def test_another_publisher_corrects_the_static_transforms(self):
        """publish_calibration beside a replay takes the place of what the bag says of a frame, whichever comes first."""
        def heard(caller, *edges):
            message = messages.static_transforms(edges, 100)
            message._connection_header = {'callerid': caller}
            return message

        turned = geometry.pose(geometry.R_BODY_FORWARD_CAMERA)
        for first in (True, False):
            published = []
            with mock.patch.object(bag_player, 'rospy') as ros, mock.patch.object(bag_player.rosgraph, 'Master') as master:
                ros.get_name.return_value, ros.is_shutdown.return_value = '/player', False
                ros.Publisher.return_value.publish = published.append
                master.return_value.getSystemState.return_value = [[['/tf_static', ['/player', '/other']]], [], []]
                other = heard('/other', ('base', '/camera', turned))
                ros.Subscriber.side_effect = lambda topic, kind, callback, **_: callback(other) if first else None
                player = bag_player.StaticTransforms(messages.static_transforms([('base', 'camera', np.eye(4)), ('base', 'imu', np.eye(4))], 100), patience=0.1)
                player.hear(heard('/player', ('base', 'imu', np.eye(4))))
                if not first:
                    player.hear(other)
            frames = [[e.child_frame_id for e in m.transforms] for m in published]
            self.assertEqual(frames, [['imu']] if first else [['camera', 'imu'], ['imu']])

    def test_a_flight_in_the_city_needs_no_ground_robot(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write(path, no_depth=True, no_frame=True)
            self.assertTrue([f for f in bag_check.check(path) if f.level == bag_check.ERROR])
            found = bag_check.check(path, city=True)
            self.assertEqual([f.text for f in found if f.level == bag_check.ERROR], [])
            self.assertTrue(any('/gps/fix is missing' in f.text for f in found if f.level == bag_check.WARNING))
            self.assertFalse([f.text for f in found if '/ground_truth/mav' in f.text and f.level != bag_check.OK])
            with rosbag.Bag(path, 'a') as bag:
                for t in np.arange(100, 103, 0.1):
                    bag.write('/vicon/hex', messages.pose_stamped(geometry.pose(), t, 'vicon'), messages.stamp(t))
            vicon = bag_check.check(path, {'/ground_truth/mav': '/vicon/hex'}, city=True)
            self.assertTrue(any("/vicon/hex is in frame 'vicon'" in f.text for f in vicon if f.level == bag_check.WARNING), vicon)
            other = bag_check.check(path, bases={'mav': 'imu_link'}, city=True)
            self.assertTrue(any('does not connect imu_link' in f.text for f in other if f.level == bag_check.ERROR))


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'bag_check_test', BagCheck)
