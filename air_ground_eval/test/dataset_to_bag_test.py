#!/usr/bin/env python3
"""Folders in the four layouts and those of TUM-VI, written here with known content, must come out of dataset_to_bag as bags that check_bag accepts."""
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import rosbag
import rosunit
from PIL import Image

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'scripts'))
from air_ground_eval import bag_check, bag_reader, datasets, evaluation, geometry, imu_synthesis, registration  # noqa: E402
from air_ground_eval.recording import Camera  # noqa: E402

WIDTH, HEIGHT = 160, 120
RATE = 30.0


def camera_pose(t):
    """T_world_camera of a hand-held camera: level, looking along +y of a world with z up, swaying with known accelerations."""
    position = np.array([0.3 * np.sin(2 * t), 0.1 * t, 1.0 + 0.1 * np.cos(3 * t)])
    R_world_camera = geometry.rotation_z(0.4 * np.sin(t)) @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]])
    return geometry.pose(R_world_camera, position)


def write_image(path, index):
    gradient = np.add.outer(np.arange(HEIGHT), np.arange(WIDTH)) + index
    Image.fromarray(np.stack([gradient % 256, gradient // 2 % 256, 0 * gradient], 2).astype(np.uint8)).save(path)


def write_depth(path, counts):
    Image.fromarray(np.full((HEIGHT, WIDTH), counts, np.uint16)).save(path)


def write_7scenes(folder, count=60, tilt=True):
    """The reference frame is tilted, so that gravity-direction.txt matters."""
    T_reference_world = geometry.pose(geometry.leveling_rotation([0.3, -0.8, 0.5]).T if tilt else None)
    for i in range(count):
        stem = os.path.join(folder, f'frame-{i:06d}')
        write_image(stem + '.color.png', i)
        write_depth(stem + '.depth.png', 2000)
        np.savetxt(stem + '.pose.txt', T_reference_world @ camera_pose(i / RATE))
    if tilt:
        np.savetxt(os.path.join(folder, 'gravity-direction.txt'), T_reference_world[:3, :3] @ [0, 0, -1.0])


def write_tum(folder, count=60):
    os.makedirs(os.path.join(folder, 'rgb'))
    os.makedirs(os.path.join(folder, 'depth'))
    with open(os.path.join(folder, 'calibration.txt'), 'w', encoding='utf-8') as stream:
        stream.write('131.25 131 79.5 59.5\n')
    with open(os.path.join(folder, 'rgb.txt'), 'w', encoding='utf-8') as rgb, open(os.path.join(folder, 'depth.txt'), 'w', encoding='utf-8') as depth, \
            open(os.path.join(folder, 'groundtruth.txt'), 'w', encoding='utf-8') as truth:
        for stream in (rgb, depth, truth):
            stream.write('# comment\n')
        for i in range(count):
            t = 1305031102.0 + i / RATE
            write_image(os.path.join(folder, 'rgb', f'{i}.png'), i)
            write_depth(os.path.join(folder, 'depth', f'{i}.png'), 10000)
            rgb.write(f'{t:.6f} rgb/{i}.png\n')
            depth.write(f'{t + 0.004:.6f} depth/{i}.png\n')
            pose = camera_pose(i / RATE)
            q = geometry.quaternion_from_matrix(pose[:3, :3])
            truth.write(f'{t:.6f} ' + ' '.join(f'{v:.9f}' for v in [*pose[:3, 3], *q]) + '\n')


def write_euroc(folder, count=40):
    T_body_camera = geometry.pose(geometry.rotation_z(0.3) @ geometry.R_BODY_DOWN_CAMERA, (0.02, -0.01, 0.03))
    os.makedirs(os.path.join(folder, 'mav0', 'cam0', 'data'))
    os.makedirs(os.path.join(folder, 'mav0', 'imu0'))
    os.makedirs(os.path.join(folder, 'mav0', 'state_groundtruth_estimate0'))

    def sensor(path, transform, more):
        with open(path, 'w', encoding='utf-8') as stream:
            data = ', '.join(f'{v:.9f}' for v in transform.ravel())
            stream.write(f'%YAML:1.0\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\n{more}')

    root = os.path.join(folder, 'mav0')
    sensor(os.path.join(root, 'cam0', 'sensor.yaml'), T_body_camera,
           f'resolution: [{WIDTH}, {HEIGHT}]\nintrinsics: [100, 101, 79.5, 59.5]\ndistortion_model: radial-tangential\n'
           'distortion_coefficients: [-0.1, 0.01, 0.001, 0.0001]\n')
    sensor(os.path.join(root, 'imu0', 'sensor.yaml'), np.eye(4), 'rate_hz: 200\n')
    begin = 1403636579000000000
    for i in range(count):
        gradient = np.add.outer(np.arange(HEIGHT), np.arange(WIDTH)) + i
        Image.fromarray((gradient % 256).astype(np.uint8)).save(os.path.join(root, 'cam0', 'data', f'{begin + i * 50000000}.png'))
    with open(os.path.join(root, 'imu0', 'data.csv'), 'w', encoding='utf-8') as stream:
        stream.write('#timestamp\n')
        for i in range(count * 10):
            stream.write(f'{begin + i * 5000000},0.1,0.2,0.3,0,0,9.81\n')
    with open(os.path.join(root, 'state_groundtruth_estimate0', 'data.csv'), 'w', encoding='utf-8') as stream:
        stream.write('#timestamp\n')
        for i in range(count * 4):
            stream.write(f'{begin + i * 12500000},{0.01 * i},0,1,1,0,0,0,0,0,0,0,0,0,0,0,0\n')
    return T_body_camera


def write_zurich(folder):
    """Three images one second apart at one place, looking to grid north; a fourth whose stamp does not increase, a fifth that is missing."""
    images, logs, panoramas = (os.path.join(folder, name) for name in ('MAV Images', 'Log Files', 'Street View Images'))
    for path in (images, logs, panoramas):
        os.makedirs(path)
    for i in range(1, 5):
        write_image(os.path.join(images, f'{i:05d}.jpg'), i)
    Image.new('RGB', (64, 32)).save(os.path.join(panoramas, 'pano_001.jpg'))
    np.savez(os.path.join(folder, 'calibration_data.npz'), intrinsic_matrix=np.array([[150, 0, 80], [0, 151, 60], [0, 0, 1.0]]),
             distCoeff=np.array([[-0.28, 0.1, 0.001, 0.002, -0.02]]))

    def log(name, header, rows):
        with open(os.path.join(logs, name), 'w', encoding='utf-8') as stream:
            stream.write(header + '\n' + ''.join(','.join(str(x) for x in row) + ',\n' for row in rows))

    stamps = [7000000, 8000000, 9000000, 9000000, 10000000]
    log('GroundTruthAGM.csv', 'Timpstemp, imgid, svid_1', [(t, i, 1, 2, 3) for i, t in enumerate(stamps, 1)])
    # omega 90 degrees: the camera's y is up, it looks along grid north.
    log('GroundTruthAGL.csv', 'imgid, x_gt', [(i, 465666.0, 5247973.0, 470.0 + i, 90, 0, 0, 465669.0, 5247973.0, 470.0) for i in (1, 2, 3)])
    log('OnbordGPS.csv', 'Timpstemp, imgid', [(t, 1, 473843450, 85450370, 480000, 1, 1, 3, 2.5, 4.0, 0, 0, 0, 8) for t in range(7000000, 9100000, 200000)])
    log('RawAccel.csv', 'Timpstemp, Error_count', [(t, 0, 0.5, 0.0, -9.81, 9, 156, 0, 0, 0, 0, 0) for t in range(6990000, 9100000, 100000)])
    log('RawGyro.csv', 'Timpstemp, Error_count', [(t, 0, 0.0, 0.0, 0.1, 9, 34, 0, 0, 0, 0, 0) for t in range(6991000, 9100000, 100000)])
    log('BarometricPressure.csv', 'Timpstemp, Pressure', [(t, 957.89, 471.4, 10.3, 0) for t in range(7000000, 9100000, 100000)])
    log('StreetViewGPS.csv', 'lat, lon, yaw_degree', [(47.384345, 8.545037, 161.01, -94.94, 1.97, 1)])


def convert(*arguments, force=True):
    program = os.path.join(HERE, '..', 'scripts', 'dataset_to_bag')
    return subprocess.run(['/usr/bin/python3', program, *arguments, *(['--force'] if force else [])], capture_output=True, text=True, check=False)


def messages_of(path, topic):
    with rosbag.Bag(path) as bag:
        return [m for _, m, _ in bag.read_messages([topic])]


def camera_truth(facts):
    """Track of the MAV's camera by the bag's reference poses of base_link."""
    reference = facts.reference('/ground_truth/mav')
    return evaluation.Track(reference.stamps, reference.poses @ facts.static_transform('mav_base_link', 'mav_camera_optical_frame'))


class DatasetToBag(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = temporary.name
        self.bag = os.path.join(self.folder, 'out.bag')

    def test_7scenes_both_robots(self):
        data = os.path.join(self.folder, 'scene')
        os.mkdir(data)
        write_7scenes(data)
        result = convert('--ground', data + '@0-29', '--mav', data + '@30-59', '--out', self.bag, '--imu-noise', '0')
        self.assertEqual(result.returncode, 0, result.stderr)
        errors = [f.text for f in bag_check.check(self.bag) if f.level == bag_check.ERROR]
        self.assertEqual(errors, [])
        mav, rgb, depth = (messages_of(self.bag, t) for t in ('/mav/camera/image_raw', '/ground/rgb/image_raw', '/ground/depth/image_raw'))
        self.assertEqual((len(mav), mav[0].encoding), (30, 'mono8'))
        self.assertEqual((len(rgb), rgb[0].encoding), (30, 'rgb8'))
        self.assertEqual((len(depth), depth[0].encoding), (30, '16UC1'))
        self.assertEqual(mav[0].header.stamp, rgb[0].header.stamp)
        self.assertEqual(rgb[7].header.stamp, depth[7].header.stamp)
        self.assertEqual(np.frombuffer(rgb[3].data, np.uint8).reshape(HEIGHT, WIDTH, 3)[10, 20, 0], 33)
        # Ground truth is levelled: the camera stood 1.1 m up and looked horizontally, whatever the reference frame's tilt.
        # (The world's horizontal origin and heading are free; heights and relative motion are not.)
        truth = messages_of(self.bag, '/ground_truth/ground')
        self.assertAlmostEqual(truth[0].pose.position.z, 1.1, places=4)
        q = truth[0].pose.orientation
        up = geometry.matrix_from_quaternion([q.x, q.y, q.z, q.w])[2]
        self.assertTrue(np.allclose(up, [0, 0, 1], atol=1e-6), up)
        self.assertIn('SYNTHESISED', messages_of(self.bag, '/dataset_info')[0].data)
        with open(os.path.join(self.folder, 'out.README.txt'), encoding='utf-8') as stream:
            self.assertIn('SYNTHESISED', stream.read())

    def test_synthesised_imu_is_that_of_the_motion(self):
        """Against the analytic derivatives of camera_pose."""
        stamps = np.arange(0, 4, 1 / RATE)
        T_base_camera = geometry.pose(geometry.R_BODY_FORWARD_CAMERA)
        poses = np.array([camera_pose(t) @ geometry.inverse(T_base_camera) for t in stamps])
        noisy = poses.copy()
        noisy[:, :3, 3] += 0.002 * np.random.default_rng(3).standard_normal((len(stamps), 3))
        imu = imu_synthesis.synthesize(stamps, noisy, noise=0.0)
        t = imu['stamps']
        acceleration = np.stack([-1.2 * np.sin(2 * t), 0 * t, -0.9 * np.cos(3 * t)], 1)
        forces = []
        for time, a in zip(t, acceleration):
            R = (camera_pose(time) @ geometry.inverse(T_base_camera))[:3, :3]
            forces.append(R.T @ (a + [0, 0, 9.81]))
        inner = (t > 0.4) & (t < 3.6)
        error = (imu['accel'] - np.array(forces))[inner]
        self.assertLess(np.sqrt(np.mean(error ** 2)), 0.15)
        self.assertLess(np.abs(error.mean(0)).max(), 0.05)
        self.assertLess(np.abs(imu['gyro'][inner] - np.stack([0 * t, 0 * t, 0.4 * np.cos(t)], 1)[inner]).max(), 0.01)

    def test_tum(self):
        data = os.path.join(self.folder, 'rgbd')
        os.mkdir(data)
        write_tum(data)
        result = convert('--ground', data, '--out', self.bag, '--keep-stamps')
        self.assertEqual(result.returncode, 0, result.stderr)
        depth = messages_of(self.bag, '/ground/depth/image_raw')
        self.assertEqual(np.frombuffer(depth[0].data, np.uint16)[0], 2000)  # 10000 counts of 0.2 mm
        self.assertAlmostEqual(depth[0].header.stamp.to_sec(), 1305031102.004, places=5)
        truth = messages_of(self.bag, '/ground_truth/ground')
        expected = camera_pose(10 / RATE) @ geometry.inverse(geometry.pose(geometry.R_BODY_FORWARD_CAMERA))
        p, q = truth[10].pose.position, truth[10].pose.orientation
        actual = geometry.pose_from_tq([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
        self.assertTrue(np.allclose(actual, expected, atol=1e-5))

    def test_euroc(self):
        data = os.path.join(self.folder, 'V1')
        os.mkdir(data)
        T_body_camera = write_euroc(data)
        result = convert('--mav', data, '--out', self.bag, '--mav-mount', 'down')
        self.assertEqual(result.returncode, 0, result.stderr)
        info = messages_of(self.bag, '/mav/camera/camera_info')[0]
        self.assertAlmostEqual(info.D[0], -0.1)
        self.assertAlmostEqual(info.K[4], 101)
        imu = messages_of(self.bag, '/mav/imu/data')
        self.assertAlmostEqual(imu[5].linear_acceleration.z, 9.81)
        self.assertNotIn('SYNTHESISED', messages_of(self.bag, '/dataset_info')[0].data)
        # The camera relative to the IMU is what sensor.yaml says, whatever base_link was chosen.
        facts = bag_reader.BagFacts(self.bag)
        self.assertTrue(np.allclose(facts.static_transform('mav_imu_link', 'mav_camera_optical_frame'), T_body_camera, atol=1e-6))
        truth = camera_truth(facts)
        expected = geometry.pose(None, (0.01 * 40, 0, 1)) @ T_body_camera
        self.assertTrue(np.allclose(truth.poses[40], expected, atol=1e-5))

    def test_euroc_images_are_those_of_data_csv(self):
        """Any format, names that are no stamps, folders; what is missing is counted."""
        data = os.path.join(self.folder, 'phone')
        os.mkdir(data)
        write_euroc(data)
        cam0 = os.path.join(data, 'mav0', 'cam0')
        os.makedirs(os.path.join(cam0, 'frames'))
        for i in range(3):
            write_image(os.path.join(cam0, 'frames', f'img{i}.jpg'), i)
        begin = 1403636579000000000
        with open(os.path.join(cam0, 'data.csv'), 'w', encoding='utf-8') as stream:
            stream.write('#timestamp [ns],filename\n')
            for i in range(3):
                stream.write(f'{begin + 50000000 * i}, frames/img{i}.jpg\r\n')
            stream.write(f'{begin + 150000000},{begin + 150000000}.png\n{begin + 200000000},gone.jpg\n')
        result = convert('--mav', data, '--out', self.bag, '--keep-stamps')
        self.assertEqual(result.returncode, 0, result.stderr)
        images = messages_of(self.bag, '/mav/camera/image_raw')
        self.assertTrue(np.allclose([m.header.stamp.to_nsec() - begin for m in images], [0, 50000000, 100000000, 150000000], atol=1000))
        self.assertIn('1 of 5 images named in', result.stdout)
        self.assertIn('gone.jpg', result.stdout)
        os.rename(os.path.join(cam0, 'frames'), os.path.join(cam0, 'elsewhere'))
        os.rename(os.path.join(cam0, 'data'), os.path.join(cam0, 'nowhere'))
        self.assertIn('5 of 5 images named in', convert('--mav', data, '--out', self.bag).stderr)

    def test_euroc_mounting_that_is_none(self):
        data = os.path.join(self.folder, 'integers')
        os.mkdir(data)
        write_euroc(data)
        path = os.path.join(data, 'mav0', 'imu0', 'sensor.yaml')
        with open(path, 'w', encoding='utf-8') as stream:  # a rotation that was written as integers
            stream.write('T_BS:\n  data: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\nrate_hz: 200\n')
        result = convert('--mav', data, '--out', self.bag)
        self.assertNotEqual(result.returncode, 0)
        self.assertIn(f'{path}: the upper left 3x3 of T_BS is no rotation', result.stderr)

    def test_euroc_fisheye(self):
        data = os.path.join(self.folder, 'tumvi')
        os.mkdir(data)
        write_euroc(data)
        path = os.path.join(data, 'mav0', 'cam0', 'sensor.yaml')
        with open(path, encoding='utf-8') as stream:
            text = stream.read().replace('radial-tangential', 'equidistant')
        with open(path, 'w', encoding='utf-8') as stream:
            stream.write(text)
        self.assertEqual(convert('--mav', data, '--out', self.bag).returncode, 0)
        info = messages_of(self.bag, '/mav/camera/camera_info')[0]
        self.assertEqual((info.distortion_model, len(info.D)), ('equidistant', 4))

    def test_tum_vi(self):
        """Images of 16 bits, one calibration of kalibr for all, a motion capture's poses of the IMU."""
        data = os.path.join(self.folder, 'dataset-room1_512_16')
        os.mkdir(data)
        T_imu_camera = write_euroc(data)
        root, begin = os.path.join(data, 'mav0'), 1403636579000000000
        for path in (('cam0', 'sensor.yaml'), ('imu0', 'sensor.yaml')):
            os.remove(os.path.join(root, *path))
        os.rename(os.path.join(root, 'state_groundtruth_estimate0'), os.path.join(root, 'mocap0'))
        self.assertIn('dso/camchain.yaml', convert('--mav', data, '--out', self.bag).stderr)
        os.mkdir(os.path.join(data, 'dso'))
        with open(os.path.join(data, 'dso', 'camchain.yaml'), 'w', encoding='utf-8') as stream:
            rows = ', '.join(str([round(float(v), 9) for v in row]) for row in geometry.inverse(T_imu_camera))
            stream.write(f'cam0:\n  T_cam_imu: [{rows}]\n  camera_model: pinhole\n  distortion_model: equidistant\n  distortion_coeffs: [0.003, 0.0007, -0.002, 0.0002]\n'
                         f'  intrinsics: [100, 101, 79.5, 59.5]\n  resolution: [{WIDTH}, {HEIGHT}]\n  rostopic: /cam0/image_raw\n')
        gradient = np.linspace(2000, 60000, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH)
        for low, high, first, last in ((2000, 60000, 7, 234), (0, 1000, 0, 250), (7400, 7900, 21, 234)):  # 16 bits, 10 bits, a thermal camera's 14
            counts = (low + (gradient - 2000) / 58000 * (high - low)).astype(np.uint16)
            for i in range(40):  # fades in: one scale for all, or brightness would have no meaning
                Image.fromarray((counts if i > 2 else low + (counts - low) // 2).astype(np.uint16)).save(os.path.join(root, 'cam0', 'data', f'{begin + i * 50000000}.png'))
            result = convert('--mav', data, '--out', self.bag, '--keep-stamps')
            self.assertEqual(result.returncode, 0, result.stderr)
            self.assertIn('images of 16 bits', result.stdout)
            images = [np.frombuffer(m.data, np.uint8).reshape(HEIGHT, WIDTH) for m in messages_of(self.bag, '/mav/camera/image_raw')]
            np.testing.assert_allclose([images[9][0, 0], images[9][-1, -1]], [first, last], atol=2)
            self.assertGreater(len(np.unique(images[9])), 0.9 * (last - first))
            self.assertAlmostEqual(float(images[0][-1, -1]), (first + last) / 2, delta=2)
        info = messages_of(self.bag, '/mav/camera/camera_info')[0]
        self.assertEqual((info.distortion_model, info.K[4], len(info.D)), ('equidistant', 101, 4))
        facts = bag_reader.BagFacts(self.bag)
        np.testing.assert_allclose(facts.static_transform('mav_imu_link', 'mav_camera_optical_frame'), T_imu_camera, atol=1e-6)
        truth = camera_truth(facts)
        np.testing.assert_allclose(truth.poses[40], geometry.pose(None, (0.01 * 40, 0, 1)) @ T_imu_camera, atol=1e-5)

    def expect_gps_of_zurich(self):
        fix = messages_of(self.bag, '/gps/fix')[0]
        np.testing.assert_allclose([fix.latitude, fix.longitude, fix.altitude, fix.position_covariance[0]], [47.384345, 8.545037, 480 + 47.3, 2.5 ** 2], rtol=0, atol=1e-6)

    def test_zurich_in_degrees_and_with_views_to_the_left(self):
        data = os.path.join(self.folder, 'AGZ')
        write_zurich(data)
        path, panoramas = pathlib.Path(data, 'Log Files', 'OnbordGPS.csv'), pathlib.Path(data, 'Street View Images')
        path.write_text(path.read_text(encoding='utf-8').replace('473843450,85450370,480000', '47.3843450,8.5450370,480.000'), encoding='utf-8')
        (panoramas / 'pano_001.jpg').rename(panoramas / 'left-001.jpg')
        self.assertIn('look 90 degrees to the left', convert('--mav', data, '--out', self.bag).stdout)
        self.expect_gps_of_zurich()
        self.assertIn('left-001.jpg,47.3843450,8.5450370,463.50,71.01', pathlib.Path(self.folder, 'out.city', 'geotags.csv').read_text(encoding='utf-8'))

    def test_zurich_urban(self):
        data = os.path.join(self.folder, 'AGZ')
        write_zurich(data)
        result = convert('--mav', data, '--out', self.bag, '--keep-stamps')
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn('1 images whose stamp is not later', result.stdout)
        self.assertIn('1 of 4 images named in GroundTruthAGM.csv are missing', result.stdout)
        self.assertEqual([m.header.stamp.to_sec() for m in messages_of(self.bag, '/mav/camera/image_raw')], [7, 8, 9])
        info = messages_of(self.bag, '/mav/camera/camera_info')[0]
        self.assertTrue(np.allclose(info.K, [150, 0, 80, 0, 151, 60, 0, 0, 1]) and np.allclose(info.D, [-0.28, 0.1, 0.001, 0.002, -0.02]))
        self.assertAlmostEqual(messages_of(self.bag, '/barometer')[0].fluid_pressure, 95789.0, places=6)
        self.expect_gps_of_zurich()
        imu = messages_of(self.bag, '/mav/imu/data')[0]
        self.assertAlmostEqual(imu.linear_acceleration.z, -9.81)
        facts = bag_reader.BagFacts(self.bag)
        # The autopilot's z is down, the camera looks to its left: base_link's x, along the camera, is its -y.
        T_base_imu = facts.static_transform('mav_base_link', 'mav_imu_link')
        self.assertTrue(np.allclose(T_base_imu[:3, :3] @ [0, 0, 1], [0, 0, -1], atol=1e-9))
        self.assertTrue(np.allclose(T_base_imu[:3, :3] @ [0, -1, 0], [1, 0, 0], atol=1e-9))
        truth = camera_truth(facts)
        # 0.455 degrees west of the zone's meridian, at 47.38 degrees north: grid north is 0.335 degrees west of true north.
        axis = truth.poses[0][:3, 2]
        self.assertAlmostEqual(np.degrees(np.arctan2(axis[0], axis[1])), -0.455 * np.sin(np.radians(47.38)), delta=0.002)
        self.assertAlmostEqual(axis[2], 0, places=6)
        self.assertTrue(np.allclose(truth.poses[0][:3, 1], [0, 0, -1], atol=1e-6))
        self.assertTrue(np.allclose(truth.poses[:, :3, 3], [[0, 0, 0], [0, 0, 1], [0, 0, 2]], atol=1e-3))
        city = os.path.join(self.folder, 'out.city')
        lines = pathlib.Path(city, 'geotags.csv').read_text(encoding='utf-8').splitlines()
        self.assertEqual(lines[0], 'image,lat,lon,alt,heading_deg')
        self.assertEqual(lines[1], 'pano_001.jpg,47.3843450,8.5450370,463.50,161.01')  # 7.5 m below the flight
        from air_ground_eval import city_database
        facts = city_database.tracker_parameters(None, city_database.read_city_file(os.path.join(city, 'city.yaml')))
        self.assertEqual(facts['origin'], [465666.0, 5247973.0, 471.0])

    def test_real_recordings(self):
        """What other people recorded, where it is there (AIR_GROUND_TEST_DATA, or shared/data beside the checkout)."""
        data = os.environ.get('AIR_GROUND_TEST_DATA') or os.path.join(HERE, '..', '..', '..', 'shared', 'data')
        found = [(name, count) for name, count in (('euroc_v101_start', 90), ('handheld_l515', 1059), ('agz_zurich', 0)) if os.path.isdir(os.path.join(data, name))]
        if not found:
            print(f'[  SKIPPED ] DatasetToBag.test_real_recordings: no recordings in {data}')  # for tools/run_tests: rosunit's results do not tell
            self.skipTest(f'no recordings in {data}')
        for name, count in found:
            recording = datasets.read_recording(os.path.join(data, name), 'auto', {})
            self.assertEqual(len(recording.colour), count, name)
            self.assertGreater(len(recording.imu.stamps), 100)
        if found[-1][0] == 'agz_zurich':
            # Photogrammetry's positions and the receiver's, through degrees: metres apart (6 on average).
            from air_ground_eval.city_database import WorldFrame
            frame = WorldFrame(recording.city['crs'], recording.city['origin'], recording.city['geoid_undulation'])
            offset = frame.from_geodetic(*recording.gps.places.T) - recording.poses[:, :3, 3]
            self.assertLess(np.median(np.linalg.norm(offset, axis=1)), 10)
            self.assertGreater(len(recording.geotags), 100)

    def test_bad_input_is_named(self):
        data = os.path.join(self.folder, 'scene')
        os.mkdir(data)
        write_7scenes(data, 10)
        cases = [(['--ground', data + '@0-99'], 'range must lie within 0-9'), (['--ground', self.folder], 'known layouts'),
                 ([], 'give --ground'), (['--mav', '/nonexistent'], 'no such folder')]
        for arguments, text in cases:
            result = convert(*arguments, '--out', self.bag)
            self.assertEqual(result.returncode, 1, arguments)
            self.assertIn(text, result.stderr)
            self.assertNotIn('Traceback', result.stderr)
        config = os.path.join(self.folder, 'config.yaml')
        for content, text in [(b'depth: [1,\n', 'while parsing'), (b'- 1\n', 'expected named values'), (b'\xff\n', 'decode byte')]:
            with open(config, 'wb') as stream:
                stream.write(content)
            result = convert('--ground', data, '--config', config, '--out', self.bag)
            self.assertEqual(result.returncode, 1, content)
            self.assertIn(config + ': ', result.stderr)
            self.assertIn(text, result.stderr)
            self.assertEqual(result.stderr.count('\n'), 1, result.stderr)
        with open(os.path.join(data, 'frame-000003.pose.txt'), 'w', encoding='utf-8') as stream:
            stream.write('1 2 3\n')
        result = convert('--ground', data, '--out', self.bag)
        self.assertIn('frame-000003.pose.txt: expected a 4x4 matrix', result.stderr)
        self.assertFalse(os.path.exists(self.bag))

    def test_registration(self):
        """A point seen by the depth camera lands where the colour camera sees it, with its depth; nearer surfaces win."""
        depth_camera = Camera(WIDTH, HEIGHT, 150, 150, 80, 60)
        colour_camera = Camera(WIDTH, HEIGHT, 130, 130, 78, 61)
        T_depth_colour = geometry.pose(geometry.rotation_z(0.05), (0.03, -0.01, 0.02))
        depth = np.full((HEIGHT, WIDTH), np.nan)
        depth[40, 100], depth[40, 101] = 2.0, 1.0
        registered = registration.register_depth(depth, depth_camera, colour_camera, T_depth_colour)
        for u, z in ((100, 2.0), (101, 1.0)):
            point = np.array([(u - 80) / 150 * z, (40 - 60) / 150 * z, z, 1])
            x, y, d = (geometry.inverse(T_depth_colour) @ point)[:3]
            self.assertAlmostEqual(registered[int(round(130 * y / d + 61)), int(round(130 * x / d + 78))], d, places=6)
        wall = registration.register_depth(np.full((HEIGHT, WIDTH), 2.0), depth_camera, colour_camera, np.eye(4))
        self.assertTrue(np.all(np.isfinite(wall[15:-15, 20:-20])))
        big = registration.register_depth(np.full((HEIGHT, WIDTH), 2.0), colour_camera, depth_camera, np.eye(4))
        self.assertTrue(np.all(np.isfinite(big[5:-5, 5:-5])), 'holes where the colour camera resolves more')


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'dataset_to_bag_test', DatasetToBag)
