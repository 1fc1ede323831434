#!/usr/bin/env python3
"""check_bag on bags as public data sets and the drivers of others record them: which topic is which, and a clear line about what is wrong."""
import contextlib
import io
import os
import shlex
import sys
import tempfile
import unittest
from unittest import mock

import cv2
import numpy as np
import rosbag
import rosunit
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Float32, Header

HERE = os.path.dirname(os.path.realpath(__file__))
SCRIPTS = os.path.join(HERE, '..', 'scripts')
sys.path[:0] = [HERE, SCRIPTS]
from air_ground_eval import bag_guess, bag_parts, bag_reader, bag_robots, bag_topics, geometry, messages  # noqa: E402
from air_ground_eval.recording import Camera  # noqa: E402
from as_module import load  # noqa: E402

PICTURE = (np.indices((48, 80)).sum(0) % 16 * 16).astype(np.uint8)
CAMERA = Camera(64, 48, 60, 60, 32, 24)
DEPTH = {'16UC1': np.full((48, 80), 1500, np.uint16), '32FC1': np.full((48, 80), 1.5, np.float32)}
CHANNELS = {'mono8': 1, 'yuv422_yuy2': 2, 'rgb8': 3, 'bgr8': 3, 'bgra8': 4}


def image(encoding, stamp, frame, factor=1, pixels=(64, 48)):
    array = PICTURE.astype(np.uint16) * 16 if encoding == 'mono16' else DEPTH[encoding] * factor if encoding in DEPTH else np.dstack([PICTURE] * CHANNELS[encoding])
    array = array[:pixels[1], :pixels[0]]
    message = Image(height=pixels[1], width=pixels[0], encoding=encoding, step=array.nbytes // pixels[1], data=array.tobytes())
    message.header.stamp, message.header.frame_id = messages.stamp(stamp), frame
    return message


def intrinsics(f, cx, cy):
    return [f, 0, cx, 0, f, cy, 0, 0, 1]


class Recording:
    """A bag of 2 s."""

    def __init__(self, path, mountings=(), begin=100):
        self.path, self.begin = path, begin
        with rosbag.Bag(path, 'w') as bag:
            if mountings:
                messages.write_latched(bag, '/tf_static', messages.static_transforms([(p, c, np.eye(4)) for p, c in mountings], 99), 99)

    def add(self, topic, rate, message):
        with rosbag.Bag(self.path, 'a') as bag:
            for t in np.arange(self.begin, self.begin + 2, 1 / rate):
                bag.write(topic, message(t), messages.stamp(t))
        return self

    def camera(self, topic, encoding, frame, info=True, model='plumb_bob', distortion=(), size=None, info_frame=None, late=0.0, factor=1, pixels=(64, 48), info_topic=None, **fields):
        def calibration(t):
            message = messages.camera_info(CAMERA, t - (late or 0.0), frame if info_frame is None else info_frame)
            message.distortion_model, message.D = model, list(distortion)
            message.width, message.height = size or pixels
            for name, value in fields.items():
                setattr(message, name, value)
            return message

        self.add(topic, 20, lambda t: image(encoding, 0 if late is None else t - late, frame, factor, pixels))
        return self.add(info_topic or topic.rsplit('/', 1)[0] + '/camera_info', 20, calibration) if info else self

    def compressed(self, topic, form, frame, pixels=PICTURE, kind='.jpg', **options):
        def picture(t):
            message = CompressedImage(format=form, data=cv2.imencode(kind, pixels)[1].tobytes())
            message.header.stamp, message.header.frame_id = messages.stamp(t), frame
            return message

        self.add(topic, 20, picture)
        parent = bag_topics.raw_name(topic).rsplit('/', 1)[0]
        return self.add(f'{parent}/camera_info', 20, lambda t: messages.camera_info(CAMERA, t, frame)) if options.get('info', True) else self

    def imu(self, topic, frame, accel=(0, 0, 9.81), gyro=(0.01, 0, 0.001), measured=True, rate=200):
        def sample(t):
            message = messages.imu(gyro, accel, 1e-6, 1e-4, t, frame)
            message.angular_velocity_covariance[0] = 1e-6 if measured else -1
            return message

        return self.add(topic, rate, sample)

    def poses(self, topic):
        return self.add(topic, 50, lambda t: messages.pose_stamped(geometry.pose(), t, 'world'))


def run(program, *arguments):
    """(status, output)."""
    module, output = load(program), io.StringIO()
    with contextlib.redirect_stdout(output), mock.patch.object(sys, 'argv', [program, *arguments]):
        status = module.main()
    return status, output.getvalue()


class BagLayouts(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)

    def path(self, name='x.bag'):
        return os.path.join(self.folder.name, name)

    def check(self, *arguments, path=None):
        status, output = run('check_bag', path or self.path(), *arguments)
        command = output.strip().splitlines()[-1].split()
        return status, output, {word.partition(':=')[0]: word.partition(':=')[2] for word in command if ':=' in word}

    def assert_arguments(self, command, **expected):
        self.assertEqual({name: command.get(name) for name in expected}, expected)

    def depth_camera(self, prefix='/camera', root='camera_link'):
        """As a RealSense's driver records by default."""
        eyes = ('color', 'infra1', 'infra2', 'imu')
        recording = Recording(self.path(), [(root, f'{eye}_frame') for eye in eyes])
        recording.camera(f'{prefix}/color/image_raw', 'rgb8', 'color_frame').camera(f'{prefix}/aligned_depth_to_color/image_raw', '16UC1', 'color_frame')
        for eye in ('infra1', 'infra2'):
            recording.camera(f'{prefix}/{eye}/image_rect_raw', 'mono8', f'{eye}_frame')
        return recording.imu(f'{prefix}/imu', 'imu_frame')

    def test_the_eyes_of_a_depth_camera_are_no_mav(self):
        self.depth_camera()
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_image='/camera/color/image_raw', ground_depth='/camera/aligned_depth_to_color/image_raw', ground_imu='/camera/imu',
                              mav_vo='false', mav_image=None)
        self.assertIn('--only mav', output)
        status, output, command = self.check('--only', 'mav')
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_image='/camera/color/image_raw', mav_imu='/camera/imu', rgbd_slam='false', ground_image=None, ground_depth=None)

    def test_of_a_stereo_camera_depth_belongs_to_the_left_eye(self):
        """As a ZED's and an Azure Kinect's drivers name them."""
        recording = Recording(self.path(), [('base_link', 'left'), ('base_link', 'right'), ('base_link', 'imu')])
        for eye in ('left', 'right'):
            recording.camera(f'/zed/zed_node/{eye}/image_rect_color', 'bgra8', eye)
        recording.camera('/zed/zed_node/depth/depth_registered', '32FC1', 'left').imu('/zed/zed_node/imu/data', 'imu')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_image='/zed/zed_node/left/image_rect_color', ground_imu='/zed/zed_node/imu/data', ground_depth_registered=None, mav_image=None)

        recording = Recording(self.path(), [('camera_base', 'depth'), ('camera_base', 'rgb'), ('camera_base', 'imu')])
        recording.camera('/rgb/image_raw', 'bgra8', 'rgb').camera('/depth_to_rgb/image_raw', '16UC1', 'rgb').camera('/depth/image_raw', '16UC1', 'depth')
        recording.camera('/ir/image_raw', 'mono8', 'depth').imu('/imu', 'imu')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_image='/rgb/image_raw', ground_depth='/depth_to_rgb/image_raw', ground_imu='/imu', mav_image=None)

    def test_a_simulated_helicopter(self):
        """As rotors: its name says that it flies, a disparity is no depth, ground_truth is no ground robot."""
        recording = Recording(self.path(), [('firefly/base_link', 'left'), ('firefly/base_link', 'imu')])
        recording.camera('/firefly/vi_sensor/left/image_raw', 'mono8', 'left').camera('/firefly/vi_sensor/camera_depth/depth/disparity', '32FC1', 'left')
        recording.camera('/firefly/vi_sensor/right/image_raw', 'mono8', 'right').imu('/firefly/vi_sensor/imu', 'imu').imu('/firefly/ground_truth/imu', 'imu')
        recording.poses('/firefly/ground_truth/pose')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_image='/firefly/vi_sensor/left/image_raw', mav_imu='/firefly/vi_sensor/imu', mav_truth='/firefly/ground_truth/pose',
                              ground_depth=None)

    def test_without_transforms_the_imu_is_the_base(self):
        """As TUM-VI, UZH-FPV and NTU VIRAL: calibration apart; the left eye, the IMU that is not the lidar's."""
        recording = Recording(self.path())
        recording.camera('/snappy_cam/stereo_l', 'mono8', 'l', info=False).camera('/snappy_cam/stereo_r', 'mono8', 'r', info=False)
        recording.imu('/imu/imu', 'imu', accel=(9.0, 0, 3.9)).imu('/os1_cloud_node1/imu', 'os1').poses('/groundtruth/odometry')
        status, output, command = self.check()
        self.assertEqual(status, 1)
        self.assert_arguments(command, mav_image='/snappy_cam/stereo_l', mav_imu='/imu/imu', mav_base_frame='imu', mav_truth='/groundtruth/odometry')
        self.assertIn('publish_calibration --camera-info FILE.yaml --transform "imu l X Y Z', output)
        self.assertIn(f'import_kalibr CALIBRATION --bag {self.path()} --image /snappy_cam/stereo_l --imu-topic /imu/imu ', output)
        self.assertIn('image:=/snappy_cam/stereo_l camera_info:=/mav/camera/camera_info', output)
        self.assertEqual(output.count('ERROR'), 1, output)

    def test_a_robots_own_odometry_is_no_truth(self):
        for topic, offered in (('/robot/odom', False), ('/wheels/odometry', False), ('/vio/pose', False), ('/tracker/pose', True)):
            recording = Recording(self.path(), [('firefly/base_link', 'left'), ('firefly/base_link', 'imu')])
            recording.camera('/firefly/left/image_raw', 'mono8', 'left').imu('/firefly/imu', 'imu').poses(topic)
            output = self.check()[1]
            self.assertEqual('of this type: set mav_truth' in output, offered, output)

    def test_an_imu_that_helps_nobody_is_left_out(self):
        """As TUM RGB-D: the accelerometer of a Kinect, mounted nowhere."""
        recording = Recording(self.path(), [('kinect', 'openni')])
        recording.camera('/camera/rgb/image_color', 'rgb8', '/openni').camera('/camera/depth/image', '32FC1', '/openni')
        recording.imu('/imu', '/imu', gyro=(0, 0, 0))
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_imu='none', ground_image='/camera/rgb/image_color', ground_base_frame='kinect')
        self.assertEqual(output.splitlines()[-1].count('ground_imu:='), 1)
        self.assertIn('WARNING without IMU the ground map is levelled by what lies flat in it', output)

    def test_of_two_cameras_the_one_that_looks_down(self):
        recording = Recording(self.path(), [('base_link', frame) for frame in ('front', 'down', 'imu')])
        recording.camera('/uav1/a_front_camera/image_raw', 'rgb8', 'front').camera('/uav1/down_camera/image_raw', 'mono8', 'down').imu('/uav1/imu', 'imu')
        self.assert_arguments(self.check()[2], mav_image='/uav1/down_camera/image_raw')

    def test_two_robots_with_depth_cameras(self):
        """The names tell which is which."""
        recording = Recording(self.path(), [(f'{robot}/base_link', f'{robot}/{sensor}') for robot in ('drone1', 'husky') for sensor in ('cam', 'imu')])
        for robot in ('drone1', 'husky'):
            recording.camera(f'/{robot}/camera/color/image_raw', 'rgb8', f'{robot}/cam').imu(f'/{robot}/camera/imu', f'{robot}/imu')
            recording.camera(f'/{robot}/camera/aligned_depth_to_color/image_raw', '16UC1', f'{robot}/cam')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_image='/husky/camera/color/image_raw', ground_depth='/husky/camera/aligned_depth_to_color/image_raw', ground_imu='/husky/camera/imu',
                              mav_image='/drone1/camera/color/image_raw', mav_imu='/drone1/camera/imu', ground_depth_registered=None)

    def test_robots_whose_frames_have_the_same_names(self):
        """As when the bags of two robots with drivers of one kind were put together by other tools than merge_bags."""
        recording = Recording(self.path(), [('base_link', 'cam'), ('base_link', 'imu')]).imu('/uav/imu/data', 'imu').imu('/ugv/imu/data', 'imu')
        recording.camera('/uav/camera/image_raw', 'mono8', 'cam').camera('/ugv/rgb/image_raw', 'rgb8', 'cam').camera('/ugv/depth/image_raw', '16UC1', 'cam')
        status, output, _ = self.check()
        self.assertEqual(status, 1, output)
        self.assertIn("the body frame of both robots is 'base_link'", output)

    def test_the_unit_of_depth(self):
        for factor, level, unit in ((1, 'ok', None), (5, 'WARNING', None), (10, 'WARNING', '0.0002')):
            recording = Recording(self.path(), [('ground_base_link', 'cam')]).camera('/ground/rgb/image_raw', 'rgb8', 'cam')
            recording.camera('/ground/depth/image_raw', '16UC1', 'cam', factor=factor)
            _, output, command = self.check()
            self.assertEqual(any(line.startswith('WARNING') and 'ground_depth_unit' in line for line in output.splitlines()), level == 'WARNING', output)
            self.assert_arguments(command, ground_depth_unit=unit)

    def test_colour_and_depth_share_a_calibration(self):
        """As simulators have it: of two robots, and of a drone alone, whose depth is not a ground robot's."""
        recording = Recording(self.path(), [(f'{robot}/base', f'{robot}/{sensor}') for robot in ('X1', 'X2') for sensor in ('cam', 'imu')])
        recording.camera('/X1/front/image_raw', 'rgb8', 'X1/cam').camera('/X1/front/depth', '32FC1', 'X1/cam', info=False).imu('/X1/imu/data', 'X1/imu')
        recording.camera('/X2/down/image_raw', 'mono8', 'X2/cam').imu('/X2/imu/data', 'X2/imu')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_camera_info='/X1/front/camera_info', mav_image='/X2/down/image_raw')

        recording = Recording(self.path(), [('Drone1', 'front')]).imu('/airsim_node/Drone1/imu/Imu', 'Drone1')
        recording.camera('/airsim_node/Drone1/front/Scene', 'bgr8', 'front').camera('/airsim_node/Drone1/front/DepthPlanar', '32FC1', 'front', info=False)
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_image='/airsim_node/Drone1/front/Scene', mav_camera_info='/airsim_node/Drone1/front/camera_info', ground_depth=None)
        recording.add('/airsim_node/Drone1/front/Scene/camera_info', 20, lambda t: messages.camera_info(CAMERA, t, 'front'))  # where AirSim itself has it
        self.assert_arguments(self.check()[2], mav_camera_info='/airsim_node/Drone1/front/Scene/camera_info')

    def test_a_camera_alone_is_its_own_base(self):
        Recording(self.path()).camera('/camera/image_raw', 'mono8', 'cam')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_base_frame='cam', mav_use_imu='false')

    def warned(self, output, text):
        return any(line.startswith('WARNING') and text in line for line in output.splitlines())

    def test_depth_of_another_camera_is_told_by_its_calibration(self):
        """Though frames are one and sizes nearly: 53x30 and 80x45 (848x480 and 1280x720, a sixteenth) differ by 0.6 % in their proportions."""
        for name, pixels, f, colour_f, registered in (('depth', (64, 48), 38, 60, False), ('depth', (53, 30), 26.3, 57, False), ('depth', (64, 48), 60.5, 60, True),
                                                      ('depth', (53, 30), 57 * 53 / 80, 57, True), ('aligned_depth_to_color', (64, 48), 38, 60, True)):
            colour = (80, 45) if pixels == (53, 30) else (64, 48)
            recording = Recording(self.path(), [('base_link', '0')])
            recording.camera('/camera/color/image_raw', 'rgb8', '0', pixels=colour, K=intrinsics(colour_f, (colour[0] - 1) / 2, (colour[1] - 1) / 2))
            recording.camera(f'/camera/{name}/image_raw', '16UC1', '0', pixels=pixels, K=intrinsics(f, (pixels[0] - 1) / 2, (pixels[1] - 1) / 2))
            status, output, command = self.check()
            self.assertEqual(status, 0, output)
            self.assert_arguments(command, ground_depth_registered=None if registered else 'false', ground_depth_camera_info=None if registered else f'/camera/{name}/camera_info')
            self.assertEqual(self.warned(output, 'differ in their calibration'), f / pixels[0] * colour[0] / colour_f < 0.9, output)
            self.assertEqual(self.warned(output, 'realsense-ros of 2018'), name != 'depth', output)
            self.assertEqual(self.warned(output, 'the distance between the two cameras counts as zero'), not registered, output)
            self.assertEqual('calibration serves, scaled' in output, registered and pixels != colour, output)

    def test_a_recording_of_realsense_viewer(self):
        recording = Recording(self.path())
        for sensor, stream, encoding, f in ((0, 'Depth_0', 'mono16', 38), (0, 'Infrared_1', 'mono8', 38), (1, 'Color_0', 'rgb8', 60)):
            folder = f'/device_0/sensor_{sensor}/{stream}'
            recording.camera(f'{folder}/image/data', encoding, '0', info_topic=f'{folder}/info/camera_info', info_frame='', K=intrinsics(f, 31.5, 23.5))
        recording.imu('/device_0/sensor_2/Accel_0/imu/data', '0', gyro=(0, 0, 0)).imu('/device_0/sensor_2/Gyro_0/imu/data', '0', accel=(0, 0, 0))
        recording.add('/device_0/sensor_0/option/Enable Auto Exposure/value', 1, lambda t: Float32(1))
        status, output, command = self.check()
        self.assertEqual(status, 1, output)
        self.assert_arguments(command, ground_image='/device_0/sensor_1/Color_0/image/data', ground_depth='/device_0/sensor_0/Depth_0/image/data', mav_image=None,
                              ground_camera_info='/device_0/sensor_1/Color_0/info/camera_info', ground_depth_camera_info='/device_0/sensor_0/Depth_0/info/camera_info',
                              ground_imu='/device_0/sensor_2/Gyro_0/imu/data', ground_imu_accel='/device_0/sensor_2/Accel_0/imu/data', ground_depth_registered='false')
        errors = [line for line in output.splitlines() if line.startswith('ERROR')]
        self.assertEqual(len(errors), 1, output)
        self.assertIn(f'roslaunch realsense2_camera rs_from_file.launch rosbag_filename:={self.path()} align_depth:=true', errors[0])

    def test_compressed_colour_of_a_depth_camera(self):
        """A folder may be named depth, and hold colour: the pixels tell."""
        steps = dict(pixels=DEPTH['16UC1'][:, :64], kind='.png')
        for depth in ('16UC1; png compressed ', 'png'):
            recording = Recording(self.path(), [('base_link', 'cam')]).compressed('/depth_camera/color/image_raw/compressed', 'rgb8; jpeg compressed bgr8', 'cam', PICTURE[:, :64])
            recording.compressed('/depth_camera/depth/image_raw/compressed', depth, 'cam', **steps)
            status, output, command = self.check()
            self.assertEqual(status, 0, output)
            self.assert_arguments(command, ground_image='/depth_camera/color/image_raw', ground_depth='/depth_camera/depth/image_raw/compressed')
        recording = Recording(self.path(), [('base', 'depth')]).compressed('/rgb_to_depth/image_raw/compressed', 'jpeg', 'depth', PICTURE[:, :64])
        recording.camera('/depth/image_raw', '16UC1', 'depth')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_image='/rgb_to_depth/image_raw', ground_depth='/depth/image_raw')

    def published(self, output):
        """The edges (parent, child, T_parent_child) of the commands to run beside the replay, as publish_calibration takes them."""
        edges = []
        for line in output.splitlines():
            if line.startswith('rosrun air_ground publish_calibration '):
                words = shlex.split(line)
                edges += [load('publish_calibration').edge(words[i + 1].split()) for i, word in enumerate(words) if word == '--transform']
        return edges

    def test_a_ground_camera_without_transforms_looks_ahead(self):
        """What is printed works as printed; an IMU in optical axes is no body, and optical frames alone are no robot."""
        for mountings in ([], [('camera_color_optical_frame', 'camera_imu_optical_frame')], [('camera_imu_optical_frame', 'camera_color_optical_frame')]):
            recording = Recording(self.path(), mountings).camera('/camera/color/image_raw', 'rgb8', 'camera_color_optical_frame')
            recording.camera('/camera/aligned_depth_to_color/image_raw', '16UC1', 'camera_color_optical_frame').imu('/camera/imu', 'camera_imu_optical_frame', accel=(0, -9.81, 0))
            status, output, command = self.check()
            self.assertEqual(status, 0, output)
            self.assertTrue(self.warned(output, 'taken for level, looking ahead'), output)
            self.assert_arguments(command, ground_base_frame=None, ground_imu='/camera/imu')
            facts = bag_reader.BagFacts(self.path())
            edges = self.published(output)
            self.assertEqual([edge[:2] for edge in edges], [('ground_base_link', (mountings or [('camera_color_optical_frame',)])[0][0])]
                             + ([] if mountings else [('camera_color_optical_frame', 'camera_imu_optical_frame')]))
            facts.add_static(messages.static_transforms(edges, 100))
            np.testing.assert_allclose(facts.static_transform('ground_base_link', 'camera_color_optical_frame'), geometry.pose(geometry.R_BODY_FORWARD_CAMERA), atol=1e-9)
        self.assertIn('--transform "ground_base_link camera_color_optical_frame 0 0 0 -0.5 0.5 -0.5 0.5"', self.layout_without_tf())

    def layout_without_tf(self):
        Recording(self.path()).camera('/camera/color/image_raw', 'rgb8', 'camera_color_optical_frame').camera('/camera/depth/image_raw', '16UC1', 'camera_color_optical_frame')
        return self.check()[1]

    def test_images_in_a_body_frame(self):
        """As Gazebo's cameras: camera_link, x forward. What is printed turns the camera alone, not what sits on it."""
        recording = Recording(self.path(), [('base_link', 'camera_link'), ('camera_link', 'imu_link')])
        recording.camera('/camera/rgb/image_raw', 'rgb8', 'camera_link').camera('/camera/depth/image_raw', '32FC1', 'camera_link').imu('/imu', 'imu_link')
        status, output, _ = self.check()
        self.assertEqual(status, 0, output)
        self.assertTrue(self.warned(output, 'the map lie on its side'), output)
        facts = bag_reader.BagFacts(self.path())
        facts.add_static(messages.static_transforms(self.published(output), 100))
        np.testing.assert_allclose(facts.static_transform('base_link', 'camera_link'), geometry.pose(geometry.R_BODY_FORWARD_CAMERA), atol=1e-9)
        np.testing.assert_allclose(facts.static_transform('base_link', 'imu_link'), np.eye(4), atol=1e-9)
        Recording(self.path(), [('base_link', 'camera_optical')]).camera('/rgb/image_raw', 'rgb8', 'camera_optical').camera('/depth/image_raw', '16UC1', 'camera_optical')
        self.assertNotIn('on its side', self.check()[1])

    def test_depth_belongs_to_the_rectified_image(self):
        """As a ZED's first driver: depth is aligned to the rectified left image, which lies beside the raw one."""
        distortion = [-0.17, 0.03, 0, 0, 0]
        for f in (60, 58):
            recording = Recording(self.path(), [('base_link', 'left')])
            recording.camera('/zed/rgb_raw/image_raw_color', 'rgb8', 'left', distortion=distortion, K=intrinsics(60.5, 32, 24))
            recording.camera('/zed/rgb/image_rect_color', 'rgb8', 'left').camera('/zed/depth/depth_registered', '32FC1', 'left', K=intrinsics(f, 32, 24))
            self.assert_arguments(self.check()[2], ground_image='/zed/rgb/image_rect_color')
        recording = Recording(self.path(), [('base_link', 'rgb')]).camera('/camera/rgb/image_rect_color', 'rgb8', 'rgb', distortion=distortion)
        recording.camera('/camera/rgb/image_raw', 'rgb8', 'rgb', info=False).camera('/camera/depth_registered/image_raw', '16UC1', 'rgb', distortion=distortion)
        self.assert_arguments(self.check()[2], ground_image='/camera/rgb/image_raw')

    def test_words_are_whole(self):
        for topic, flies in (('/stairs/camera', False), ('/quadruped/camera', False), ('/chair/camera', False), ('/uav1/camera', True), ('/mavros/imu', True), ('/air/camera', True),
                             ('/airsim_node/a', True), ('/firefly/camera', True), ('/quad_2/camera', True), ('/hexacopter/camera', True), ('/Drone1/camera', True)):
            self.assertEqual(bag_robots.has(topic, bag_robots.MAV_WORDS), flies, topic)
        for topic, drives in (('/background/rgb', False), ('/ground_truth/pose', False), ('/groundtruth', False), ('/ground/rgb', True), ('/ugv_1/rgb', True), ('/robot1/rgb', True)):
            self.assertEqual(bag_robots.has(topic, bag_robots.GROUND_WORDS), drives, topic)
        self.assertFalse(bag_robots.has('/length', bag_guess.TRUTH_WORDS))
        Recording(self.path(), [('base_link', 'cam')]).camera('/stairs/camera/color/image_raw', 'rgb8', 'cam').camera('/stairs/camera/depth/image_raw', '16UC1', 'cam')
        self.assert_arguments(self.check()[2], ground_image='/stairs/camera/color/image_raw', mav_image=None)

    def found(self, text, level='ERROR', imu=None, recording=None, **camera):
        if recording is None:
            recording = Recording(self.path(), [('mav_base_link', 'cam'), ('mav_base_link', 'imu'), ('mav_base_link', 'other')])
            recording.camera('/mav/camera/image_raw', camera.pop('encoding', 'mono8'), 'cam', **camera).imu('/mav/imu/data', 'imu', **(imu or {}))
        output = self.check()[1]
        self.assertTrue(any(line.startswith(level) and text in line for line in output.splitlines()), f'no {level} with "{text}" in\n{output}')

    def test_rectified_images_have_the_calibration_of_P(self):
        """image_raw and image_rect share a camera_info, of which K and D are the former's, P the latter's."""
        recording = Recording(self.path(), [('base_link', 'cam'), ('base_link', 'imu')]).imu('/imu/data', 'imu')
        recording.camera('/left/image_rect', 'mono8', 'cam', distortion=[-0.3, 0.1, 0, 0, 0], R=list(geometry.rotation_z(0.01).ravel()))
        status, output, _ = self.check()
        self.assertEqual(status, 0, output)
        self.assertIn('P is taken, not K and D, for /left/image_rect is rectified', output)
        self.assertIn('rectification turned /left/image_rect by 0.6 degrees', output)
        Recording(self.path(), [('mav_base_link', 'cam'), ('mav_base_link', 'imu')]).camera('/mav/camera/image_raw', 'mono8', 'cam', K=[0.0] * 9).imu('/mav/imu/data', 'imu')
        self.assertIn('P is taken, not K and D, for K is empty', self.check()[1])

    def test_one_clear_line(self):
        self.found('set it in the driver', late=None)
        self.found('two clocks', late=50.0)
        self.found('in degrees', imu=dict(gyro=(8.0, 5.0, 12.0)))
        self.found('are cut off at 39.2 m/s^2', level='WARNING', imu=dict(accel=(39.2266, 0, 9.81)))
        self.found('are not measured', imu=dict(measured=False))
        self.found('an attitude alone helps no node', level='WARNING', imu=dict(gyro=(0, 0, 0), accel=(0, 0, 0)))
        self.assert_arguments(self.check()[2], mav_use_imu='false')
        self.found('has at most 4', model='equidistant', distortion=[0.1] * 5)
        self.found('multiplied by 0.5', size=(128, 96))
        self.found('the nodes go by the latter', level='WARNING', info_frame='other')
        for name, model in (('OpenCV', 'fisheye'), ('kalibr', 'radtan')):
            self.found('0 errors', level='0 errors', model=model, distortion=[0.1, 0.01, 0, 0])
        self.found('0 errors', level='0 errors', encoding='yuv422_yuy2')
        self.found('0 errors', level='0 errors', size=(129, 97), binning_x=2, binning_y=2)
        self.found('is for 32x24', binning_x=2, binning_y=2)
        self.found('0 errors', level='0 errors', header=Header(frame_id='cam'))
        self.found('use 12 of 16 bits', level='ok', encoding='mono16')
        ground = Recording(self.path(), [('ground_base_link', 'cam')]).camera('/ground/rgb/image_raw', 'rgb8', 'cam')
        self.found('are these millimetres', recording=ground.camera('/ground/depth/image_raw', '32FC1', 'cam', factor=1000))
        ground = Recording(self.path(), [('ground_base_link', 'cam')]).camera('/ground/rgb/image_raw', 'rgb8', 'cam')
        self.found('has any depth', recording=ground.camera('/ground/depth/image_raw', '32FC1', 'cam', factor=np.float32(np.nan)))
        ground = Recording(self.path(), [('ground_base_link', 'cam')]).camera('/ground/rgb/image_raw', 'rgb8', 'cam')
        self.found('does not connect ground_base_link with eye', recording=ground.camera('/ground/depth/image_raw', '16UC1', 'eye'))
        self.found('all stamps are 50.0 s before', level='ok', recording=Recording(self.path()).camera('/mav/camera/image_raw', 'mono8', 'cam', late=50.0))
        with rosbag.Bag(self.path()) as whole, rosbag.Bag(self.path('spoilt.bag'), 'w', compression='bz2', chunk_threshold=5000) as spoilt:
            for topic, message, time in whole.read_messages():
                spoilt.write(topic, message, time)
        with open(self.path('spoilt.bag'), 'r+b') as file:
            content = file.read()
            file.seek(content.index(b'BZh', len(content) // 2) + 20)  # within a compressed chunk
            file.write(b'?' * 100)
        self.assertIn('which keeps what lies before the damage', self.check(path=self.path('spoilt.bag'))[1])
        os.mkdir(self.path('ros2'))
        with open(self.path('ros2/metadata.yaml'), 'w', encoding='ascii') as file:
            file.write('rosbag2_bagfile_information:')
        self.assertIn('rosbags-convert --src FOLDER --dst x.bag --dst-typestore ros1_noetic', self.check(path=self.path('ros2'))[1])

    def test_parts_are_joined_and_stamps_mended(self):
        first = Recording(self.path('x_0.bag'), [('mav_base_link', 'cam'), ('mav_base_link', 'imu')])
        first.camera('/mav/camera/image_raw', 'mono8', 'cam', late=50.0).imu('/mav/imu/data', 'imu')
        Recording(self.path('x_1.bag'), begin=102).camera('/mav/camera/image_raw', 'mono8', 'cam', late=50.0).imu('/mav/imu/data', 'imu')
        parts = [self.path(f'x_{number}.bag') for number in (0, 1)]
        self.assertIn(f'join_bags {" ".join(parts)} {self.path("x.bag")}', self.check(path=parts[1])[1])
        split = [self.path(f's_2026-11-30-10-0{number}-00_{number}.bag') for number in (0, 1)]
        others = [self.path(name) for name in ('x_2.bag', 's_2026-11-30-09-00-00_0.bag')]  # of other flights
        for path, begin in zip(split + others, (100, 102, 500, 50)):
            Recording(path, begin=begin).imu('/mav/imu/data', 'imu')
        for paths, expected in ((parts, [parts] * 2), (split, [split] * 2), (others, [[], []])):
            self.assertEqual([bag_parts.parts_beside(path) for path in paths], expected)
        topics = ['--restamp', '/mav/camera/image_raw', '--restamp', '/mav/camera/camera_info']
        status, output = run('join_bags', self.path('x_0.bag'), self.path('x_1.bag'), self.path('x.bag'), *topics)
        self.assertEqual(status, 0, output)
        self.assertIn('/mav/camera/image_raw: stamps shifted by +50.000 s', output)
        with rosbag.Bag(self.path('x.bag')) as bag:
            self.assertEqual(bag.get_message_count('/mav/imu/data'), 800)
            self.assertTrue(all(m.header.stamp == t for _, m, t in bag.read_messages('/mav/camera/image_raw')))
        Recording(self.path('y.bag'), [('mav_base_link', 'cam')]).camera('/mav/camera/image_raw', 'mono8', 'cam', late=None)
        self.assertEqual(run('join_bags', self.path('y.bag'), self.path('z.bag'), *topics[:2])[0], 0)
        with rosbag.Bag(self.path('z.bag')) as bag:
            self.assertTrue(all(m.header.stamp == t for _, m, t in bag.read_messages('/mav/camera/image_raw')))
        self.assertEqual(run('join_bags', self.path('y.bag'), self.path('w.bag'), '--restamp', '/other')[0], 1)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'bag_layouts_test', BagLayouts)
