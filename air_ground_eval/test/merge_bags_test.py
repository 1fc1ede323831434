#!/usr/bin/env python3
"""Two robots' bags with the same names in both become one that check_bag finds nothing wrong with."""
import os
import resource
import shlex
import signal
import subprocess
import sys
import tempfile
import unittest

import cv2
import numpy as np
import rosbag
import rostest
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CompressedImage

HERE = os.path.dirname(os.path.realpath(__file__))
SCRIPTS = os.path.join(HERE, '..', 'scripts')
sys.path[:0] = [HERE, SCRIPTS]
from air_ground_eval import bag_check, bag_guess, bag_merge, bag_reader, geometry, messages  # noqa: E402
from air_ground_eval.recording import Camera  # noqa: E402
from bag_layouts_test import Recording  # noqa: E402

CAMERA = Camera(64, 48, 60, 60, 32, 24)
LATER = 86400.0  # the ground robot drives the next day [s]


def write(path, begin, depth, x):
    """A robot's own bag: /camera/..., /imu/data, frames base_link, camera and imu; the camera x metres before the base."""
    T_base_camera = geometry.pose()
    T_base_camera[0, 3] = x
    with rosbag.Bag(path, 'w') as bag:
        messages.write_latched(bag, '/tf_static', messages.static_transforms([('base_link', 'camera', T_base_camera), ('base_link', 'imu', np.eye(4))], begin), begin)
        for i in range(600):
            t = begin + i / 200
            bag.write('/imu/data', messages.imu(np.array([0.01, 0, 0]), np.array([0, 0, 9.81]), 1e-6, 1e-4, t, 'imu'), messages.stamp(t))
            if i % 10:
                continue
            bag.write('/camera/image_raw', messages.image(np.zeros((48, 64, 3)), 'rgb8', t, 'camera'), messages.stamp(t))
            bag.write('/camera/camera_info', messages.camera_info(CAMERA, t, 'camera'), messages.stamp(t))
            if depth:
                bag.write('/camera/depth/image_raw', messages.image(np.full((48, 64), 1500), '16UC1', t, 'camera'), messages.stamp(t))


def write_once(path, begin, seconds):
    """A recording whose calibration and mountings come once, at its begin, the latter latched."""
    with rosbag.Bag(path, 'w') as bag:
        edges = [('base_link', 'camera_optical', geometry.pose(geometry.R_BODY_FORWARD_CAMERA)), ('base_link', 'imu', np.eye(4))]
        messages.write_latched(bag, '/tf_static', messages.static_transforms(edges, begin), begin)
        bag.write('/camera/camera_info', messages.camera_info(CAMERA, begin, 'camera_optical'), messages.stamp(begin))
        picture = np.indices((48, 64)).sum(0) % 16 * 16
        for i in range(round(200 * seconds)):
            t = begin + i / 200
            bag.write('/imu/data', messages.imu(np.array([0.01, 0, 0]), np.array([0, 0, 9.81]), 1e-6, 1e-4, t, 'imu'), messages.stamp(t))
            if i % 10 == 0:
                bag.write('/camera/image_raw', messages.image(np.dstack([picture] * 3), 'rgb8', t, 'camera_optical'), messages.stamp(t))
                bag.write('/camera/depth/image_raw', messages.image(np.full((48, 64), 1500), '16UC1', t, 'camera_optical'), messages.stamp(t))


def write_imu(path, lacking, own_clock=0.0):
    """600 messages every 5 ms, recorded 6 to 20 ms later, four together; those of the indices `lacking` without stamp, the others of a clock that is `own_clock` behind. Returns the true times."""
    true = 1000.0 + np.arange(600) / 200
    with rosbag.Bag(path, 'w') as bag:
        for i, t in enumerate(true):
            message = messages.imu(np.array([0.01, 0, 0]), np.array([0, 0, 9.81]), 1e-6, 1e-4, 0 if i in lacking else t - own_clock, 'imu')
            bag.write('/imu', message, messages.stamp(t + 0.02 - 0.0047 * (i % 4)))
    return true


def stamps_of(path, topic):
    with rosbag.Bag(path) as bag:
        return np.array([message.header.stamp.to_sec() for _, message, _ in bag.read_messages([topic])])


def run(program, *arguments, before=None):
    return subprocess.run(['/usr/bin/python3', os.path.join(SCRIPTS, program), *arguments], capture_output=True, text=True, check=False, preexec_fn=before)


class MergeBags(unittest.TestCase):
    def test_two_stretches_of_one_recording(self):
        with tempfile.TemporaryDirectory() as folder:
            whole, pair = (os.path.join(folder, name) for name in ('x.bag', 'pair.bag'))
            write_once(whole, 1000.0, 6)
            program = os.path.join(SCRIPTS, 'merge_bags')
            result = subprocess.run(['/usr/bin/python3', program, f'{whole}@0-3', f'{whole}@3-6', pair, '--begin-together'], capture_output=True, text=True, check=False)
            self.assertEqual(result.returncode, 0, result.stdout + result.stderr)
            with rosbag.Bag(pair) as bag:
                self.assertEqual({header['latching'] for *_, header in bag.read_messages('/tf_static', return_connection_header=True)}, {b'1'})
            facts = bag_reader.BagFacts(pair)
            self.assertEqual([facts.counts[f'/{robot}/camera/{topic}'] for robot in ('mav', 'ground') for topic in ('image_raw', 'camera_info')], [60, 1, 60, 1])
            self.assertAlmostEqual(facts.end - facts.begin, 599 / 200, places=3)
            check = subprocess.run(['/usr/bin/python3', os.path.join(SCRIPTS, 'check_bag'), pair], capture_output=True, text=True, check=False)
            self.assertEqual(check.returncode, 0, check.stdout + check.stderr)
            self.assertIn('0 errors', check.stdout)
            for word in ('mav_base_frame:=', 'rgbd_slam:=', 'mav_vo:='):  # both robots, with frames of standard names
                self.assertNotIn(word, check.stdout.splitlines()[-1])
            for wrong, text in ((f'{whole}@9-12', 'is 6.0 s long'), (f'{whole}@3-2', 'it ends before it begins')):
                with self.assertRaisesRegex(bag_reader.BagError, text):
                    bag_merge.Part('mav', wrong)

    def test_two_robots_of_the_same_make(self):
        with tempfile.TemporaryDirectory() as folder:
            mav, ground, both = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag', 'both.bag'))
            write(mav, 1000.0, False, 0.1)
            write(ground, 1000.0 + LATER, True, 0.3)
            count = bag_merge.merge(bag_merge.plan(mav, ground, begin_together=True), both)
            facts = bag_reader.BagFacts(both)
            self.assertEqual(count, sum(facts.counts.values()))
            self.assertEqual(sum(facts.counts.values()), sum(sum(bag_reader.BagFacts(path).counts.values()) for path in (mav, ground)))
            self.assertAlmostEqual(facts.end - facts.begin, 599 / 200, places=6)
            for robot, x in (('mav', 0.1), ('ground', 0.3)):
                self.assertAlmostEqual(facts.static_transform(f'{robot}_base_link', f'{robot}_camera')[0, 3], x)
            names = bag_guess.guess(facts)
            self.assertEqual((names['/mav/imu/data'], names['/ground/imu/data']), ('/mav/imu/data', '/ground/imu/data'))
            self.assertEqual([f.text for f in bag_check.check(facts, names) if f.level == bag_check.ERROR], [])
            streams = bag_check.read(both, ['/mav/imu/data', '/ground/imu/data'])
            self.assertEqual(streams['/mav/imu/data'].stamps[0], streams['/ground/imu/data'].stamps[0])
            self.assertEqual(streams['/ground/imu/data'].frames, {'ground_imu'})

    def told(self, folder, *arguments):
        """(what merge_bags tells check_bag, check_bag's arguments of the last line) of two bags in a folder."""
        both = os.path.join(folder, 'both.bag')
        merged = run('merge_bags', *arguments, both, '--begin-together')
        self.assertEqual(merged.returncode, 0, merged.stdout + merged.stderr)
        words = shlex.split(merged.stdout.splitlines()[-1].partition('check_bag ')[2])
        self.assertEqual(words[0], both)
        check = run('check_bag', *words)
        self.assertEqual(check.returncode, 0, check.stdout + check.stderr)
        return words[1:], dict(word.split(':=') for word in shlex.split(check.stdout.splitlines()[-1]) if ':=' in word)

    def assert_arguments(self, command, **expected):
        self.assertEqual({name: command.get(name) for name in expected}, expected)

    def test_whose_a_topic_is_where_nothing_says_so(self):
        """A drone with a depth camera, IMU and reference, and a robot whose depth comes later by name and which has neither: check_bag alone takes the one for the other."""
        with tempfile.TemporaryDirectory() as folder:
            mav, ground = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag'))
            write(mav, 1000.0, True, 0.1)
            with rosbag.Bag(mav, 'a') as bag:
                for i in range(20):
                    bag.write('/gt', messages.pose_stamped(np.eye(4), 1000 + 0.1 * i, 'world'), messages.stamp(1000 + 0.1 * i))
            Recording(ground, [('chassis', 'eye')]).camera('/oak/rgb/image_raw', 'rgb8', 'eye').camera('/oak/stereo/image_raw', '16UC1', 'eye')
            words, command = self.told(folder, mav, ground)
            self.assertEqual(words[::2], ['--map'] * (len(words) // 2))
            self.assertTrue({'/camera/image_raw:=mav_image', '/gt:=mav_truth'} <= set(words), words)
            self.assert_arguments(command, mav_image='/camera/image_raw', mav_camera_info='/camera/camera_info', mav_imu='/imu/data', mav_truth='/gt', ground_image='/oak/rgb/image_raw',
                                  ground_depth='/oak/stereo/image_raw', ground_imu='none', ground_base_frame='chassis', mav_base_frame='base_link')

    def test_nothing_is_told_that_check_bag_guesses(self):
        with tempfile.TemporaryDirectory() as folder:
            mav, ground = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag'))
            write(mav, 1000.0, False, 0.1)
            write(ground, 1000.0, True, 0.3)
            words, command = self.told(folder, mav, ground)
            self.assertEqual(words, [])
            self.assert_arguments(command, mav_image=None, ground_image='/ground/camera/image_raw', ground_imu=None)

    def test_topics_of_robots_whose_names_say_otherwise(self):
        """merge_bags itself wrote /mav before them; an IMU that one robot has in a frame of both."""
        with tempfile.TemporaryDirectory() as folder:
            whole = os.path.join(folder, 'x.bag')
            recording = Recording(whole, [('base_link', 'cam'), ('base_link', 'imu')]).camera('/jackal/color/image_raw', 'rgb8', 'cam').camera('/jackal/depth/image_raw', '16UC1', 'cam')
            recording.imu('/jackal/imu', 'imu')
            words, command = self.told(folder, f'{whole}@1-2', f'{whole}@2-')
            self.assertEqual(words, [])
            self.assert_arguments(command, mav_image='/mav/jackal/color/image_raw', mav_imu='/mav/jackal/imu', ground_image='/ground/jackal/color/image_raw', ground_imu='/ground/jackal/imu')
        with tempfile.TemporaryDirectory() as folder:
            mav, ground = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag'))
            Recording(mav, [('base_link', 'lens')]).camera('/bebop/image_raw', 'rgb8', 'lens')
            Recording(ground).camera('/camera/color/image_raw', 'rgb8', 'eye').camera('/camera/depth/image_raw', '16UC1', 'eye').imu('/imu/data', 'base_link')
            words, command = self.told(folder, mav, ground)
            self.assertEqual(words, [])
            self.assert_arguments(command, mav_imu=None, mav_use_imu='false', ground_imu='/imu/data', ground_base_frame=None)

    def test_a_bag_without_images(self):
        with tempfile.TemporaryDirectory() as folder:
            mav, ground = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag'))
            Recording(mav).imu('/mavros/imu/data', 'fcu')
            recording = Recording(ground, [('base', 'eye'), ('other', 'cam')]).camera('/camera/color/image_raw', 'rgb8', 'eye').camera('/camera/depth/image_raw', '16UC1', 'eye')
            recording.camera('/rear/image_raw', 'mono8', 'cam')
            words, command = self.told(folder, mav, ground)
            self.assertEqual(words, ['--only', 'ground', '--map', 'none:=ground_imu'])
            self.assert_arguments(command, mav_vo='false', ground_image='/camera/color/image_raw', ground_imu='none')

    def test_one_robot_records_compressed_images(self):
        """/camera/image_raw/compressed of the MAV beside /camera/image_raw of the ground robot: one camera's two transports, after a merge by names alone."""
        with tempfile.TemporaryDirectory() as folder:
            mav, ground, both = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag', 'both.bag'))
            write(mav, 1000.0, False, 0.1)
            with rosbag.Bag(mav) as bag, rosbag.Bag(os.path.join(folder, 'compressed.bag'), 'w') as small:
                for topic, message, time, header in bag.read_messages(return_connection_header=True):
                    if topic == '/camera/image_raw':
                        picture = CompressedImage(message.header, 'mono8; jpeg compressed', cv2.imencode('.jpg', np.zeros((48, 64), np.uint8))[1].tobytes())
                        small.write('/camera/image_raw/compressed', picture, time)
                    elif topic != '/camera/camera_info':
                        small.write(topic, message, time, connection_header=header)
                    else:
                        small.write('/camera/image_rect', messages.image(np.zeros((48, 64)), 'mono8', time.to_sec(), 'camera'), time)
                        small.write(topic, message, time)
            write(ground, 1000.0, True, 0.3)
            parts = bag_merge.plan(small.filename, ground, begin_together=False)
            bag_merge.merge(parts, both)
            types = bag_reader.BagFacts(both).types
            for topic in ('/mav/camera/image_raw/compressed', '/mav/camera/camera_info', '/mav/camera/image_rect', '/ground/camera/image_raw', '/ground/camera/camera_info',
                          '/camera/depth/image_raw'):
                self.assertIn(topic, types)
            self.assertEqual([topic for topic in types if topic.startswith('/camera')], ['/camera/depth/image_raw'])
            names = bag_guess.guess(bag_reader.BagFacts(both))
            self.assertEqual((names['/mav/camera/camera_info'], names['/ground/rgb/image_raw']), ('/mav/camera/camera_info', '/ground/camera/image_raw'))

    def test_calibration_follows_its_images(self):
        """Only the MAV's bag has it."""
        with tempfile.TemporaryDirectory() as folder:
            paths = [os.path.join(folder, name) for name in ('mav.bag', 'ground.bag')]
            for path, info in zip(paths, (True, False)):
                with rosbag.Bag(path, 'w') as bag:
                    bag.write('/camera/image_raw', messages.image(np.zeros((48, 64)), 'mono8', 1, 'camera'), messages.stamp(1))
                    bag.write('/odom' if info else '/scan', messages.text(''), messages.stamp(1))
                    if info:
                        for folder_of_info in ('/camera', '/camera/image_raw'):  # beside it, or below it, as AirSim has it
                            bag.write(f'{folder_of_info}/camera_info', messages.camera_info(CAMERA, 1, 'camera'), messages.stamp(1))
            parts = bag_merge.plan(*paths, begin_together=False)
            self.assertEqual([part.topics for part in parts], [{t: f'/mav{t}' for t in ('/camera/image_raw', '/camera/camera_info', '/camera/image_raw/camera_info')},
                                                               {'/camera/image_raw': '/ground/camera/image_raw'}])

    def test_names_without_slash_are_those_with_one(self):
        """As rosbag's and rosbags' writers keep them: `imu` became /mavimu, and `tf_static` one robot's."""
        with tempfile.TemporaryDirectory() as folder:
            mav, ground, both = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag', 'both.bag'))
            for path, slash, frame in ((mav, '', 'cam'), (ground, '/', 'eye')):
                with rosbag.Bag(path, 'w') as bag:
                    bag.write(f'{slash}imu', messages.imu([0, 0, 0], [0, 0, 9.81], 1, 1, 5, 'imu'), messages.stamp(5))
                    bag.write(f'{slash}eye/image_raw', messages.image(np.zeros((48, 64)), 'mono8', 5, frame), messages.stamp(5))
                    bag.write('tf_static', messages.static_transforms([('base_link', frame, np.eye(4))], 5), messages.stamp(5))
                    bag.write(f'{frame}/text', messages.text(''), messages.stamp(5))
            parts = bag_merge.plan(mav, ground, begin_together=False)
            self.assertEqual([part.topics for part in parts], [{'imu': '/mav/imu', 'eye/image_raw': '/mav/eye/image_raw'}, {'/imu': '/ground/imu', '/eye/image_raw': '/ground/eye/image_raw'}])
            bag_merge.merge(parts, both)
            facts = bag_reader.BagFacts(both)
            self.assertEqual(facts.counts, {'/tf_static': 2, '/cam/text': 1, '/eye/text': 1, **{f'/{robot}/{topic}': 1 for robot in ('mav', 'ground') for topic in ('imu', 'eye/image_raw')}})
            self.assertEqual(set(facts.edges), {('mav_base_link', 'cam'), ('ground_base_link', 'eye')})

    def test_times_stay_unless_asked(self):
        with tempfile.TemporaryDirectory() as folder:
            mav, ground, both = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag', 'both.bag'))
            write(mav, 1000.0, False, 0.1)
            write(ground, 1001.0, True, 0.3)
            bag_merge.merge(bag_merge.plan(mav, ground, begin_together=False), both)
            streams = bag_check.read(both, ['/mav/imu/data', '/ground/imu/data'])
            self.assertEqual((streams['/mav/imu/data'].stamps[0], streams['/ground/imu/data'].stamps[0]), (1000.0, 1001.0))
            self.assertEqual(sorted(streams['/mav/imu/data'].times), streams['/mav/imu/data'].times)

    def test_messages_without_stamp_follow_the_others(self):
        """A driver's first message, one in the midst, the last two: the others keep their stamps, and with them their distances."""
        lacking = {0, 1, 300, 598, 599}
        with tempfile.TemporaryDirectory() as folder:
            bag, out = (os.path.join(folder, name) for name in ('x.bag', 'y.bag'))
            true = write_imu(bag, lacking)
            others = [i for i in range(600) if i not in lacking]
            result = run('join_bags', bag, out, '--restamp', '/imu')
            self.assertEqual(result.returncode, 0, result.stderr)
            self.assertIn('/imu: 5 of 600 stamps were zero: these follow the others, which stay as they are', result.stdout)
            stamps = stamps_of(out, '/imu')
            self.assertTrue(np.allclose(stamps[others], true[others], rtol=0, atol=1e-6))
            self.assertTrue(np.all(np.diff(stamps) > 0), np.diff(stamps).min())
            self.assertLess(np.abs(stamps - true).max(), 0.02)
            os.remove(out)
            true = write_imu(bag, lacking, own_clock=300.0)  # of another clock all are shifted, the zero ones with them
            result = run('join_bags', bag, out, '--restamp', '/imu')
            self.assertIn('5 of 600 stamps were zero: these follow the others, stamps shifted by +300.0', result.stdout)
            stamps = stamps_of(out, '/imu')
            self.assertLess(np.ptp(stamps[others] - true[others]), 1e-6)
            self.assertLess(np.abs(stamps - true).max(), 0.03)
            self.assertTrue(np.all(np.diff(stamps) > 0))
            os.remove(out)
            write_imu(bag, set(range(400)))  # what the few others say of the delay is not to be trusted
            self.assertIn('/imu: stamped with the times of recording', run('join_bags', bag, out, '--restamp', '/imu').stdout)
            facts = bag_check.read(out, ['/imu'])['/imu']
            self.assertTrue(np.array_equal(facts.stamps, facts.times))

    def test_a_few_messages_without_stamp_are_no_error(self):
        with tempfile.TemporaryDirectory() as folder:
            bag = os.path.join(folder, 'x.bag')
            for lacking, level in (({0}, bag_check.WARNING), ({0, 5, 6, 7, 8, 400}, bag_check.WARNING), (set(range(7)), bag_check.ERROR), (set(range(600)), bag_check.ERROR)):
                write_imu(bag, lacking)
                found = [f for f in bag_check.check(bag, {'/mav/imu/data': '/imu'}, robots=('mav',)) if 'have no stamp' in f.text]
                self.assertEqual([f.level for f in found], [level])
                self.assertIn(f'{len(lacking)} of 600 messages', found[0].text)
                self.assertIn('the nodes drop these', found[0].text)
            write_imu(bag, {0, 300})
            texts = [f.text for f in bag_check.check(bag, {'/mav/imu/data': '/imu'}, robots=('mav',)) if f.text.startswith('/imu')]
            self.assertEqual(len([text for text in texts if 'tf_static' not in text and 'no stamp' not in text]), 0, texts)  # neither a gap, nor stamps that go back

    def test_stamps_that_are_zero_stay(self):
        """As publish_calibration's of static transforms: to shift them back ended with a traceback."""
        with tempfile.TemporaryDirectory() as folder:
            mav, ground, both = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag', 'both.bag'))
            write(mav, 1000.0, False, 0.1)
            write(ground, 1000.0 + LATER, True, 0.3)
            with rosbag.Bag(ground, 'a') as bag:
                edges = messages.static_transforms([('base_link', 'lidar', np.eye(4))], 0)
                self.assertFalse(edges.transforms[0].header.stamp)
                messages.write_latched(bag, '/tf_static', edges, 1000.0 + LATER)
            bag_merge.merge(bag_merge.plan(mav, ground, begin_together=True), both)
            with rosbag.Bag(both) as bag:
                stamps = {edge.child_frame_id: edge.header.stamp.to_sec() for _, m, _ in bag.read_messages('/tf_static') for edge in m.transforms}
            self.assertEqual((stamps['lidar'], stamps['ground_imu'], stamps['mav_imu']), (0, 1000, 1000))

    def test_a_stamp_that_cannot_be_shifted_names_its_topic(self):
        for kind, topic, way in (('imu', '/boot', '--restamp /boot'), ('tf', '/tf', 'rosbag filter')):
            with tempfile.TemporaryDirectory() as folder:
                mav, ground, both = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag', 'both.bag'))
                write(mav, 1000.0, False, 0.1)
                write(ground, 1000.0 + LATER, True, 0.3)
                with rosbag.Bag(ground, 'a') as bag:  # seconds since the driver's start
                    message = messages.imu([0, 0, 0], [0, 0, 9.81], 1, 1, 5, 'imu') if kind == 'imu' else messages.static_transforms([('base_link', 'arm', np.eye(4))], 5)
                    bag.write(topic, message, messages.stamp(1001.0 + LATER))
                result = run('merge_bags', mav, ground, both, '--begin-together')
                self.assertEqual((result.returncode, result.stderr), (1, ''))
                self.assertIn(f'{topic} has a stamp of 5.000 s', result.stdout)
                self.assertIn(way, result.stdout)
                self.assertEqual(sorted(os.listdir(folder)), ['ground.bag', 'mav.bag'])

    def test_a_bag_that_is_not_whole_has_no_name(self):
        """After a damaged input, a full disk or an interruption."""
        def full():
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (100000, 100000))

        class Interrupted:
            def messages(self, order):
                yield 10**12, order, '/text', messages.text('x'), None
                raise KeyboardInterrupt

        with tempfile.TemporaryDirectory() as folder:
            mav, ground, both = (os.path.join(folder, name) for name in ('mav.bag', 'ground.bag', 'both.bag'))
            write(mav, 1000.0, False, 0.1)
            write(ground, 1000.0, True, 0.3)
            names = sorted(os.listdir(folder))
            for arguments in (('merge_bags', mav, ground, both, '--compression', 'none'), ('join_bags', mav, ground, both, '--compression', 'none')):
                result = run(*arguments, before=full)
                self.assertEqual(result.returncode, 1, result.stdout + result.stderr)
                self.assertIn(f'{both} cannot be written', result.stdout)
                self.assertEqual(sorted(os.listdir(folder)), names)
            os.mkdir(both + '.part')
            result = run('merge_bags', mav, ground, both)
            self.assertEqual((result.returncode, result.stderr), (1, ''))
            self.assertIn(f'{both} cannot be written (Is a directory)', result.stdout)
            os.rmdir(both + '.part')
            with self.assertRaises(KeyboardInterrupt):
                bag_merge.merge([Interrupted()], both)
            self.assertEqual(sorted(os.listdir(folder)), names)
            with open(ground, 'r+b') as file:
                content = file.read()
                at = content.index(b'/camera/image_raw', len(content) // 2)
                file.seek(at - 200)
                file.write(b'?' * 400)
            result = run('join_bags', mav, ground, both)
            self.assertEqual((result.returncode, sorted(os.listdir(folder))), (1, names), result.stdout + result.stderr)

    def test_frames_of_every_message(self):
        """On /tf each publisher has messages of its own: `odom` stood in none of the first ones, and was shared by both robots. Odometry may come without any transform."""
        with tempfile.TemporaryDirectory() as folder:
            paths = [os.path.join(folder, name) for name in ('mav.bag', 'ground.bag')]
            for path in paths:
                with rosbag.Bag(path, 'w') as bag:
                    for i, edge in enumerate([('base_link', 'wheel'), ('odom', 'base_link')] * 3):
                        moved = geometry.pose(np.eye(3), (0.1 * i, 0, 0))  # else it would be a mounting, which is known
                        bag.write('/tf', messages.static_transforms([(*edge, moved)], 100 + i), messages.stamp(100 + i))
                    odometry = Odometry(child_frame_id='footprint')
                    odometry.header.stamp, odometry.header.frame_id = messages.stamp(100), 'start'
                    bag.write('/odometry', odometry, messages.stamp(100))
            parts = bag_merge.plan(*paths, begin_together=False)
            for part in parts:
                self.assertEqual(part.frames, {name: f'{part.robot}_{name}' for name in ('base_link', 'wheel', 'odom', 'footprint', 'start')})


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'merge_bags_test', MergeBags, sys.argv)
