#!/usr/bin/env python3
"""RGB-D folders as data sets are published: calibrations, sizes, depth units, frames of the reference poses, and what is wrong with them."""
import os
import sys
import tempfile
import tracemalloc
import unittest

import cv2
import numpy as np
import rosunit
from PIL import Image

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [HERE, os.path.join(HERE, '..', 'scripts')]
from air_ground_eval import datasets, geometry, imu_synthesis, pose_check, registration  # noqa: E402
from air_ground_eval.recording import Camera, DatasetError  # noqa: E402
from dataset_to_bag_test import HEIGHT, RATE, WIDTH, camera_pose, convert, messages_of, write_7scenes, write_tum  # noqa: E402

VGA = (640, 480)
ROOM_CAMERA = Camera(320, 240, 240.0, 240.0, 159.5, 119.5)
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
Y_UP = geometry.pose(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))  # world with z up, in one with y up


def looking(t):
    """T_world_camera of a hand in a room of 4 x 4 x 3 m, turning about all of its axes; z is up."""
    turn = geometry.rotation_from_axes('YXZ', np.array([[0.7 * np.sin(1.3 * t), 0.25 * np.sin(2.1 * t + 1), 0.1 * np.sin(1.7 * t)]]))[0]
    return geometry.pose(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]) @ turn, [0.2 * np.sin(t), 0.2 * np.sin(0.7 * t), 1.4])


class Room:
    """Walls, floor and ceiling with a texture; images and depth by ray casting."""

    def __init__(self):
        noise = np.random.default_rng(7).integers(0, 255, (160, 160, 3)).astype(np.uint8)
        self.texture = cv2.GaussianBlur(cv2.resize(noise, (1280, 1280), interpolation=cv2.INTER_NEAREST), (5, 5), 0)
        u, v = np.meshgrid(np.arange(ROOM_CAMERA.width), np.arange(ROOM_CAMERA.height))
        self.rays = np.stack([(u - ROOM_CAMERA.cx) / ROOM_CAMERA.fx, (v - ROOM_CAMERA.cy) / ROOM_CAMERA.fy, np.ones(u.shape)], -1)

    def render(self, pose):
        """(colour uint8 (h, w, 3), depth (h, w) [m])."""
        rays, origin = self.rays @ pose[:3, :3].T, pose[:3, 3]
        with np.errstate(divide='ignore', invalid='ignore'):
            away = np.stack([np.where(rays[..., axis] > 0, (high - origin[axis]) / rays[..., axis], (low - origin[axis]) / rays[..., axis])
                             for axis, (low, high) in enumerate(((-2, 2), (-2, 2), (0, 3)))])
        wall, depth = np.argmin(away, 0), np.min(away, 0)
        point = (origin + depth[..., None] * rays) * 150
        x, y = (np.where(wall == 0, point[..., 1], point[..., 0]), np.where(wall == 2, point[..., 1], point[..., 2]))
        place = [np.mod(c + 300 * wall, 1279).astype(np.float32) for c in (x, y)]
        return cv2.remap(self.texture, *place, cv2.INTER_LINEAR), depth


def save(path, array):
    os.makedirs(os.path.dirname(path), exist_ok=True)
    Image.fromarray(array).save(path)


def write_text(path, text):
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, 'w', encoding='utf-8') as stream:
        stream.write(text)


def tum_line(stamp, pose):
    return f'{stamp:.6f} ' + ' '.join(f'{v:.9f}' for v in [*pose[:3, 3], *geometry.quaternion_from_matrix(pose[:3, :3])]) + '\n'


def grey(size, value=90, kind=np.uint8):
    return np.full((size[1], size[0]), value, kind)


def write_tum_of(folder, colour_size, depth_size=None, calibration=None):
    """Two images of each, no texture, standing still."""
    for i in range(2):
        save(os.path.join(folder, 'rgb', f'{i}.png'), grey(colour_size))
        save(os.path.join(folder, 'depth', f'{i}.png'), grey(depth_size or colour_size, 5000, np.uint16))
    for name in ('rgb', 'depth'):
        write_text(os.path.join(folder, name + '.txt'), ''.join(f'{1000 + i / RATE:.6f} {name}/{i}.png\n' for i in range(2)))
    if calibration:
        write_text(os.path.join(folder, 'calibration.txt'), calibration)
    return folder


def write_room(folder, to_file=lambda pose: pose, count=60, counts_per_metre=5000, truth='groundtruth.txt'):
    """`count` images of the room at 15 Hz in the TUM layout; to_file makes of a camera's pose what is written."""
    room = Room()
    times = np.arange(count) / 15
    for i, t in enumerate(times):
        colour, depth = room.render(looking(t))
        save(os.path.join(folder, 'rgb', f'{i}.png'), colour)
        save(os.path.join(folder, 'depth', f'{i}.png'), np.rint(depth * counts_per_metre).astype(np.uint16))
    c = ROOM_CAMERA
    write_text(os.path.join(folder, 'calibration.txt'), f'{c.fx} {c.fy} {c.cx} {c.cy}\n')
    for name in ('rgb', 'depth'):
        write_text(os.path.join(folder, name + '.txt'), ''.join(f'{t:.6f} {name}/{i}.png\n' for i, t in enumerate(times + 1000.01)))
    write_text(os.path.join(folder, truth), ''.join(tum_line(t + 1000.01, to_file(looking(t))) for t in times))


def intrinsics_of(camera):
    return [camera.fx, camera.fy, camera.cx, camera.cy]


class RgbdFolders(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = temporary.name
        self.bag = os.path.join(self.folder, 'out.bag')

    def inside(self, *names):
        return os.path.join(self.folder, *names)

    def config(self, text):
        write_text(self.inside('config.yaml'), text)
        return self.inside('config.yaml')

    def refused(self, folder, config=None, layout='auto'):
        with self.assertRaises(DatasetError) as raised:
            datasets.read_recording(folder, layout, config or {})
        self.assertNotIn('\n', str(raised.exception))
        return str(raised.exception)

    # ---- calibrations

    def test_calibration_beside_the_images(self):
        """As ETH3D writes it; its images are of another size than a Kinect's."""
        recording = datasets.read_recording(write_tum_of(self.inside('eth3d'), (739, 458), calibration='726.21 726.21 359.2 202.5\n'), 'auto', {})
        np.testing.assert_allclose(intrinsics_of(recording.camera), [726.21, 726.21, 359.2, 202.5])
        self.assertEqual((recording.camera.width, recording.camera.height), (739, 458))
        self.assertIsNone(recording.depth_camera)
        full = write_tum_of(self.inside('full'), VGA, calibration='# fx fy cx cy k1 k2 p1 p2\n520 521 318 238 0.1 -0.2 0.003 0.004\n')
        self.assertEqual(datasets.read_recording(full, 'auto', {}).camera.distortion, (0.1, -0.2, 0.003, 0.004, 0.0))
        stated = {'colour_camera': {'fx_px': 500, 'fy_px': 501, 'cx_px': 320, 'cy_px': 240}}
        np.testing.assert_allclose(intrinsics_of(datasets.read_recording(full, 'auto', stated).camera), [500, 501, 320, 240])
        for text, part in (('525 525 319.5\n', 'expected "fx fy cx cy"'), ('fx fy\n', 'expected numbers'), ('1050 1050 639.5 479.5\n', 'principal point')):
            write_text(os.path.join(full, 'calibration.txt'), text)
            self.assertIn(part, self.refused(full))

    def test_published_calibrations(self):
        for name, expected, distortion in (('rgbd_dataset_freiburg1_desk', [517.3, 516.5, 318.6, 255.3], (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
                                           ('rgbd_dataset_freiburg2_xyz', [520.9, 521.0, 325.1, 249.7], (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
                                           ('rgbd_dataset_freiburg3_office', [535.4, 539.2, 320.1, 247.6], (0.0,) * 5),
                                           ('rgbd_bonn_box', [542.822841, 542.576870, 315.593520, 237.756098], (0.039903, -0.099343, -0.00073, -0.000144, 0.0))):
            recording = datasets.read_recording(write_tum_of(self.inside(name), VGA), 'auto', {})
            np.testing.assert_allclose(intrinsics_of(recording.camera), expected)
            np.testing.assert_allclose(recording.camera.distortion, distortion)
            self.assertTrue(any('as published' in note for note in recording.notes), recording.notes)
            self.assertAlmostEqual(recording.depth_unit, 1 / 5000)
        half = datasets.read_recording(write_tum_of(self.inside('half', 'freiburg3'), (320, 240)), 'auto', {})
        np.testing.assert_allclose(intrinsics_of(half.camera), [267.7, 269.6, 159.8, 123.55])
        self.assertIn('its calibration (TUM freiburg3', self.refused(write_tum_of(self.inside('wide', 'freiburg3'), (640, 360))))

    def test_no_calibration(self):
        """A Kinect's is assumed for its own size alone."""
        recording = datasets.read_recording(write_tum_of(self.inside('mine'), VGA), 'auto', {})
        np.testing.assert_allclose(intrinsics_of(recording.camera), [525, 525, 319.5, 239.5])
        self.assertTrue(any('assumed' in note for note in recording.notes))
        for size in ((739, 458), (1280, 960)):
            self.assertIn('give --config with "colour_camera: {fx_px', self.refused(write_tum_of(self.inside(f'of_{size[0]}'), size)))

    def test_7scenes_of_another_size(self):
        for name, size in (('small', (WIDTH, HEIGHT)), ('wide', (640, 360))):
            for i in range(2):
                save(self.inside(name, f'frame-{i:06d}.color.png'), grey(size))
                save(self.inside(name, f'frame-{i:06d}.depth.png'), grey(size, 2000, np.uint16))
        recording = datasets.read_recording(self.inside('small'), 'auto', {})
        np.testing.assert_allclose(intrinsics_of(recording.camera), [146.25, 146.25, 79.625, 59.625])
        np.testing.assert_allclose(intrinsics_of(recording.depth_camera), [146.25, 146.25, 79.625, 59.625])
        self.assertIn('640x360', self.refused(self.inside('wide')))

    # ---- depth

    def test_depth_of_another_size(self):
        """CoRBS: 512x424 beside 1920x1080."""
        data = write_tum_of(self.inside('corbs'), (480, 270), (128, 106), '265 265 239.5 134.5\n')
        result = convert('--ground', data, '--out', self.bag)
        self.assertEqual(result.returncode, 1)
        self.assertIn('"depth_camera: {fx_px', result.stderr)
        self.assertEqual(result.stderr.count('\n'), 1, result.stderr)
        config = 'depth_camera: {fx_px: 91.5, fy_px: 91.5, cx_px: 63.5, cy_px: 52.5, distortion: [0.08, -0.26, 0, 0, 0.09]}\n' \
                 'depth_from_colour: {translation_m: [0.05, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}\n'
        result = convert('--ground', data, '--out', self.bag, '--config', self.config(config))
        self.assertEqual(result.returncode, 0, result.stderr)
        depth = messages_of(self.bag, '/ground/depth/image_raw')[0]
        self.assertEqual((depth.width, depth.height), (480, 270))
        self.assertEqual(np.frombuffer(depth.data, np.uint16).reshape(270, 480)[135, 240], 1000)
        result = convert('--ground', data, '--out', self.bag, '--config', self.config(config.replace('fx_px: 91', 'width_px: 512, height_px: 424, fx_px: 91')))
        self.assertIn('depth_camera in the calibration file is of 512x424, the images are 128x106', result.stderr)
        quarter = write_tum_of(self.inside('quarter'), (320, 240), (160, 120), '262 262 159.5 119.5\n')
        recording = datasets.read_recording(quarter, 'auto', {})
        registered = registration.depth_in_millimetres(recording, recording.depth[0].path)
        self.assertTrue(np.all(registered[2:-2, 2:-2] == 1000), 'of the same proportions: registered')

    def test_distortion_of_the_depth_camera(self):
        """A ray through a distorted depth pixel lands where an ideal camera sees it."""
        distortion = (0.5, 0.02, 0.001, -0.002, 0.0)
        depth_camera, colour_camera = Camera(128, 106, 91, 91, 63.5, 52.5, distortion), Camera(256, 212, 300, 300, 127.5, 105.5)
        x, y, _ = registration.distort(0.3, -0.25, distortion)
        u, v = int(round(91 * x + 63.5)), int(round(91 * y + 52.5))
        depth = np.full((106, 128), np.nan)
        depth[v, u] = 2.0
        seen = np.argwhere(np.isfinite(registration.register_depth(depth, depth_camera, colour_camera, np.eye(4))))
        np.testing.assert_allclose(seen.mean(0), [105.5 - 0.25 * 300, 127.5 + 0.3 * 300], atol=3.0)  # a depth pixel is 3.3 of colour

    # ---- what is missing

    def test_missing_images_and_poses_that_are_none(self):
        data = self.inside('holes')
        os.mkdir(data)
        write_tum(data)
        os.remove(os.path.join(data, 'rgb', '7.png'))
        os.remove(os.path.join(data, 'depth', '9.png'))
        path = os.path.join(data, 'groundtruth.txt')
        with open(path, encoding='utf-8') as stream:
            lines = stream.read().splitlines()
        lines[5] = ' '.join(lines[5].split()[:4] + ['0 0 0 0'])
        lines[6] = ' '.join(lines[6].split()[:4] + ['nan nan nan nan'])
        write_text(path, '\n'.join(lines) + '\n')
        result = convert('--ground', data, '--out', self.bag)
        self.assertEqual(result.returncode, 0, result.stderr)
        for text in ('1 of 60 images named in ' + os.path.join(data, 'rgb.txt'), 'the first: rgb/7.png', 'depth/9.png', '2 of 60 poses have a quaternion that is zero'):
            self.assertIn(text, result.stdout)
        self.assertEqual(len(messages_of(self.bag, '/ground/rgb/image_raw')), 59)
        self.assertEqual(len(messages_of(self.bag, '/ground_truth/ground')), 58)
        for i in range(10, 50):
            os.remove(os.path.join(data, 'rgb', f'{i}.png'))
        self.assertIn('41 of 60 images', self.refused(data))

    # ---- frames of the reference poses

    def test_world_of_the_poses(self):
        """z up stays; y up is found by how the camera is carried; what is stated goes before."""
        data = self.inside('tum')
        os.mkdir(data)
        write_tum(data)
        before = datasets.read_recording(data, 'auto', {})
        self.assertTrue(any('taken as z up' in note for note in before.notes), before.notes)
        np.testing.assert_allclose(before.poses[10], camera_pose(10 / RATE), atol=1e-6)
        truth = ''.join(tum_line(1305031102.0 + i / RATE, Y_UP @ camera_pose(i / RATE)) for i in range(60))
        write_text(os.path.join(data, 'groundtruth.txt'), truth)
        for config, text in (({}, 'no gravity direction, and z of the reference poses cannot be up'), ({'gravity_direction': [0, -1, 0]}, None)):
            recording = datasets.read_recording(data, 'auto', config)
            self.assertEqual(any('z of the reference poses cannot be up' in note for note in recording.notes), text is not None)
            self.assertAlmostEqual(recording.poses[10, 2, 3], camera_pose(10 / RATE)[2, 3], places=5)
            np.testing.assert_allclose(recording.poses[10, 2, :3], [0, -1, 0], atol=1e-6)
        # A camera that looks down is carried otherwise: its own upper edge says nothing.
        down = [geometry.pose(geometry.R_BODY_DOWN_CAMERA, (0.1 * i, 0, 2)) for i in range(60)]
        write_text(os.path.join(data, 'groundtruth.txt'), ''.join(tum_line(1305031102.0 + i / RATE, pose) for i, pose in enumerate(down)))
        recording = datasets.read_recording(data, 'auto', {}, geometry.R_BODY_DOWN_CAMERA)
        np.testing.assert_allclose(recording.poses[10], down[10], atol=1e-6)
        self.assertIn('expected three numbers', self.refused(data, {'gravity_direction': [0, 1]}))

    def test_poses_of_a_marker_make_no_imu(self):
        T_marker_camera = geometry.pose_from_tq([0.1, 0.02, -0.05], [0.5, -0.5, 0.5, 0.5])
        data = self.inside('marker')
        write_room(data, lambda pose: pose @ geometry.inverse(T_marker_camera))
        result = convert('--ground', data, '--out', self.bag)
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn('reference poses turn otherwise than the images of marker do', result.stdout)
        self.assertIn('IMU: none, 0 reference poses', result.stdout)
        self.assertEqual(messages_of(self.bag, '/ground/imu/data') + messages_of(self.bag, '/ground_truth/ground'), [])
        line = result.stdout[result.stdout.index('quaternion_xyzw: [') + 18:]
        found = np.array([float(x) for x in line[:line.index(']')].split(',')])
        self.assertLess(geometry.rotation_angle(geometry.matrix_from_quaternion(found).T @ T_marker_camera[:3, :3]), np.radians(3))
        result = convert('--ground', data, '--out', self.bag, '--imu', 'synthesize')
        self.assertEqual(result.returncode, 1)
        self.assertIn('turn otherwise', result.stderr)
        config = self.config('pose_from_camera: {translation_m: [0.1, 0.02, -0.05], quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]}\n')
        result = convert('--ground', data, '--out', self.bag, '--keep-stamps', '--config', config)
        self.assertIn('turn as the images do', result.stdout)
        self.assertIn('SYNTHESISED', result.stdout)
        position = messages_of(self.bag, '/ground_truth/ground')[30].pose.position
        np.testing.assert_allclose([position.x, position.y, position.z], looking(2.0)[:3, 3], atol=1e-5)

    def test_poses_that_agree_and_images_that_do_not_tell(self):
        data = self.inside('room')
        write_room(data)
        recording = datasets.read_recording(data, 'auto', {})
        agreement = pose_check.compare(recording, recording.colour)
        self.assertGreaterEqual(agreement.pairs, pose_check.FEWEST)
        self.assertLess(agreement.ratio, 0.1)
        for name in os.listdir(os.path.join(data, 'rgb')):
            save(os.path.join(data, 'rgb', name), grey((320, 240)))
        recording.poses = recording.poses @ geometry.pose(geometry.rotation_z(np.pi / 2))
        self.assertEqual(pose_check.compare(recording, recording.colour).pairs, 0)

    # ---- the synthesised IMU

    def test_gaps_make_no_imu(self):
        """A second without poses: no readings there, and right ones beside it."""
        stamps = np.arange(0, 6, 1 / RATE)
        stamps = stamps[(stamps < 2.5) | (stamps > 3.5)]
        imu = imu_synthesis.synthesize(stamps, np.array([camera_pose(t) for t in stamps]), noise=0.0)
        t = imu['stamps']
        self.assertFalse(np.any((t > 2.5) & (t < 3.5)))
        self.assertEqual(imu['pieces'], 2)
        self.assertAlmostEqual(imu['left_out'], 1.03, delta=0.05)
        turn = 0.4 * np.cos(t)  # about the camera's -y
        inner = (np.abs(t - 3) > 0.8) & (t > 0.3) & (t < 5.7)
        self.assertLess(np.abs(imu['gyro'][inner, 1] + turn[inner]).max(), 0.01)
        ticks = (t - t[0]) * 200
        self.assertLess(np.abs(ticks - np.rint(ticks)).max(), 1e-6)
        # Slow poses have no gaps for all that.
        slow = np.arange(0, 20, 0.4)
        self.assertEqual(imu_synthesis.synthesize(slow, np.array([camera_pose(0.1 * s) for s in slow]))['pieces'], 1)
        with self.assertRaisesRegex(ValueError, 'without a gap'):
            imu_synthesis.synthesize(np.arange(20) * 0.02 + np.repeat(np.arange(4), 5), np.array([camera_pose(t) for t in np.arange(20)]))

    def test_long_recordings_fit_the_memory(self):
        """Ten minutes at 100 Hz; dense equations took 2 GB."""
        stamps = np.arange(0, 600, 0.01)
        poses = np.tile(np.eye(4), (len(stamps), 1, 1))
        poses[:, 0, 3] = np.sin(stamps)
        tracemalloc.start()
        imu = imu_synthesis.synthesize(stamps, poses, noise=0.0)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        self.assertLess(peak, 3e8)
        self.assertLess(np.abs(imu['accel'][200:-200, 0] + np.sin(imu['stamps'][200:-200])).max(), 0.02)

    # ---- numbered images

    def test_icl_nuim(self):
        """Numbers of frames as stamps, y up in a mirrored world, its own intrinsics."""
        data = self.inside('living_room_traj0_frei_png')
        write_room(data, lambda pose: MIRROR @ geometry.inverse(geometry.pose(np.diag([1.0, -1, -1]))) @ Y_UP @ pose @ MIRROR, truth='livingRoom0.gt.freiburg')
        for name in ('rgb.txt', 'depth.txt', 'calibration.txt'):
            os.remove(os.path.join(data, name))
        truth = os.path.join(data, 'livingRoom0.gt.freiburg')
        with open(truth, encoding='utf-8') as stream:
            lines = stream.read().splitlines()
        write_text(truth, ''.join(f'{i} ' + line.split(' ', 1)[1] + '\n' for i, line in enumerate(lines)))
        write_text(os.path.join(data, 'associations.txt'), ''.join(f'{i} depth/{i}.png {i} rgb/{i}.png\n' for i in range(1, 60)) + '60 depth/60.png 60 rgb/60.png\n')
        config = {'frame_rate_hz': 15, 'colour_camera': {'fx_px': 240, 'fy_px': -240, 'cx_px': 159.5, 'cy_px': 119.5}}
        recording = datasets.read_recording(data, 'auto', config)
        self.assertEqual((len(recording.colour), len(recording.depth), len(recording.poses)), (59, 59, 59))
        self.assertAlmostEqual(recording.colour[0].stamp, 1 / 15)
        self.assertAlmostEqual(recording.depth_unit, 1 / 5000)
        self.assertEqual(recording.camera.fy, 240)
        self.assertTrue(any('2 of 120 images' in note for note in recording.notes), recording.notes)
        agreement = pose_check.compare(recording, recording.colour)
        self.assertGreaterEqual(agreement.pairs, pose_check.FEWEST)
        self.assertLess(agreement.ratio, 0.1)
        first = looking(1 / 15)
        np.testing.assert_allclose(recording.poses[20, 2, 3] - recording.poses[0, 2, 3], looking(21 / 15)[2, 3] - first[2, 3], atol=1e-5)
        np.testing.assert_allclose(recording.poses[20, 2, :3], looking(21 / 15)[2, :3], atol=1e-5)
        for i in range(1, 3):
            save(self.inside('traj1', 'rgb', f'{i}.png'), grey(VGA))
            save(self.inside('traj1', 'depth', f'{i}.png'), grey(VGA, 5000, np.uint16))
        write_text(self.inside('traj1', 'traj1.gt.freiburg'), tum_line(1, np.eye(4)) + tum_line(2, np.eye(4)))
        np.testing.assert_allclose(intrinsics_of(datasets.read_recording(self.inside('traj1'), 'auto', {}).camera), [481.2, 480, 319.5, 239.5])

    def test_scannet(self):
        """SensReader's files, and those of the exporter: colour and depth of different sizes, lost poses."""
        def matrix(fx, fy, cx, cy):
            return np.array([[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])

        colour, depth, sizes = matrix(1158.3, 1153.53, 649, 483.5), matrix(572, 572, 320, 240), ((1296, 968), VGA)
        for i in range(3):
            pose = geometry.pose(None, (0.1 * i, 0, 1)) if i else np.full((4, 4), -np.inf)
            stem = self.inside('sens', f'frame-{i:06d}')
            for folder, names in (('sens', (stem + '.color.jpg', stem + '.depth.pgm', stem + '.pose.txt')),
                                  ('exported', [self.inside('exported', *name) for name in (('color', f'{i}.jpg'), ('depth', f'{i}.png'), ('pose', f'{i}.txt'))])):
                save(names[0], grey(sizes[0]))
                os.makedirs(os.path.dirname(names[1]), exist_ok=True)
                cv2.imwrite(names[1], grey(sizes[1], 1500, np.uint16))
                os.makedirs(os.path.dirname(names[2]), exist_ok=True)
                np.savetxt(names[2], pose)
        identity = ' '.join('1' if i % 5 == 0 else '0' for i in range(16))
        write_text(self.inside('sens', '_info.txt'), 'm_versionNumber = 4\nm_sensorName = StructureSensor\nm_colorWidth = 1296\nm_colorHeight = 968\nm_depthWidth = 640\n'
                   f'm_depthHeight = 480\nm_depthShift = 1000\nm_calibrationColorIntrinsic = {" ".join(map(str, colour.ravel()))} \nm_calibrationColorExtrinsic = {identity} \n'
                   f'm_calibrationDepthIntrinsic = {" ".join(map(str, depth.ravel()))} \nm_calibrationDepthExtrinsic = {identity} \nm_frames.size = 3\n')
        os.makedirs(self.inside('exported', 'intrinsic'))
        np.savetxt(self.inside('exported', 'intrinsic', 'intrinsic_color.txt'), colour)
        np.savetxt(self.inside('exported', 'intrinsic', 'intrinsic_depth.txt'), depth)
        for folder in ('sens', 'exported'):
            recording = datasets.read_recording(self.inside(folder), 'auto', {})
            np.testing.assert_allclose(intrinsics_of(recording.camera), [1158.3, 1153.53, 649, 483.5])
            np.testing.assert_allclose(intrinsics_of(recording.depth_camera), [572, 572, 320, 240])
            self.assertEqual((len(recording.colour), len(recording.depth), len(recording.poses)), (3, 3, 2))
            registered = registration.depth_in_millimetres(recording, recording.depth[0].path)
            self.assertEqual((registered.shape, registered[484, 649]), ((968, 1296), 1500))
        os.remove(self.inside('exported', 'intrinsic', 'intrinsic_color.txt'))
        self.assertIn('1296x968, and nothing states its calibration', self.refused(self.inside('exported')))

    def test_redwood(self):
        """Microseconds in the names; poses by their place in trajectory.log."""
        for i in range(4):
            save(self.inside('00021', 'rgb', f'{i + 1:07d}-{33368 * i:012d}.jpg'), grey(VGA))
            save(self.inside('00021', 'depth', f'{i + 1:07d}-{33368 * i + 5000:012d}.png'), grey(VGA, 2000, np.uint16))
        poses = [geometry.pose(None, (0.1 * i, 0, 0)) for i in range(4)]
        write_text(self.inside('00021', 'trajectory.log'), ''.join(
            f'{i} {i} {i + 1}\n' + '\n'.join(' '.join(map(str, row)) for row in pose) + '\n' for i, pose in enumerate(poses)))
        recording = datasets.read_recording(self.inside('00021'), 'auto', {'depth_counts_per_metre': 2000})
        np.testing.assert_allclose([f.stamp for f in recording.colour], [0, 0.033368, 0.066736, 0.100104])
        self.assertAlmostEqual(recording.depth[1].stamp, 0.038368)
        self.assertAlmostEqual(recording.depth_unit, 1 / 2000)
        np.testing.assert_allclose(recording.pose_stamps, [f.stamp for f in recording.colour])
        np.testing.assert_allclose(np.linalg.norm(np.diff(recording.poses[:, :3, 3], axis=0), axis=1), 0.1)
        self.assertTrue(any('cannot be up' in note for note in recording.notes), recording.notes)
        result = convert('--ground', self.inside('00021'), '--out', self.bag)
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn('1000 counts a metre', result.stdout)

    def test_pairs_in_one_folder(self):
        for i in range(2):
            save(self.inside('scene_01', f'{i:05d}-color.png'), grey(VGA))
            save(self.inside('scene_01', f'{i:05d}-depth.png'), grey(VGA, 2000, np.uint16))
        recording = datasets.read_recording(self.inside('scene_01'), 'auto', {})
        self.assertEqual((len(recording.colour), len(recording.depth), len(recording.poses)), (2, 2, 0))

    def test_whole_stamps_count_frames(self):
        """As lists are that people make of ICL-NUIM's folders."""
        data = write_tum_of(self.inside('whole'), VGA)
        for name in ('rgb', 'depth'):
            write_text(os.path.join(data, name + '.txt'), ''.join(f'{i} {name}/{i}.png\n' for i in range(2)))
        write_text(os.path.join(data, 'groundtruth.txt'), tum_line(0, np.eye(4)) + tum_line(1, np.eye(4)))
        recording = datasets.read_recording(data, 'auto', {'frame_rate_hz': 20})
        np.testing.assert_allclose([[f.stamp for f in recording.colour], [f.stamp for f in recording.depth], recording.pose_stamps], [[0, 0.05]] * 3)

    def test_images_of_two_sizes(self):
        """Named before anything is written."""
        data = self.inside('scene')
        os.mkdir(data)
        write_7scenes(data, 3)
        save(os.path.join(data, 'frame-000000.depth.png'), grey((80, 60), 2000, np.uint16))
        save(os.path.join(data, 'frame-000002.depth.png'), grey((80, 60), 2000, np.uint16))
        result = convert('--ground', data + '@1-2', '--out', self.bag)
        self.assertEqual(result.returncode, 1)
        self.assertIn('frame-000001.depth.png: is 160x120, its camera 80x60', result.stderr)
        self.assertEqual(result.stderr.count('\n'), 1, result.stderr)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'rgbd_folders_test', RgbdFolders)
