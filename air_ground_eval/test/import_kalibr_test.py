#!/usr/bin/env python3
"""Kalibr's files, written here with known content, must come out of import_kalibr as camera_info, transforms and parameters of that content."""
import os
import shlex
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import rosbag
import rospy
import rostest
import yaml
from sensor_msgs.msg import CameraInfo, Image
from tf2_msgs.msg import TFMessage

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'scripts'))
from air_ground_eval import calibration, geometry, messages  # noqa: E402
from air_ground_eval.recording import Camera  # noqa: E402

# The camera looks down, the IMU's axes are the body's, the camera 10 cm ahead of it: in the camera the IMU lies 10 cm towards +y (the image's
# bottom), since the image's top points ahead.
T_CAM_IMU = [[0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.1], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
CHAIN = {'cam0': {'T_cam_imu': T_CAM_IMU, 'camera_model': 'pinhole', 'distortion_model': 'radtan', 'distortion_coeffs': [-0.28, 0.07, 0.0002, 1.8e-05],
                  'intrinsics': [458.6, 457.3, 367.2, 248.4], 'resolution': [752, 480], 'rostopic': '/cam0/image_raw', 'timeshift_cam_imu': -8.121e-05},
         'cam1': {'camera_model': 'pinhole', 'distortion_model': 'equidistant', 'distortion_coeffs': [-0.01, 0.02, -0.03, 0.004],
                  'intrinsics': [190.9, 190.8, 254.9, 256.8], 'resolution': [512, 512], 'rostopic': '/cam1/image_raw/compressed', 'timeshift_cam_imu': 0.025},
         'cam2': {'camera_model': 'omni', 'distortion_model': 'radtan', 'distortion_coeffs': [0, 0, 0, 0], 'intrinsics': [1.2, 600, 600, 300, 300],
                  'resolution': [600, 600]}}
IMU = {'accelerometer_noise_density': 2e-3, 'accelerometer_random_walk': 3e-3, 'gyroscope_noise_density': 1.6968e-04, 'gyroscope_random_walk': 1e-05,
       'rostopic': '/imu0', 'update_rate': 200.0}


class ImportKalibr(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory(prefix='a folder with spaces ')
        self.addCleanup(temporary.cleanup)
        self.folder = temporary.name
        for name, content in (('camchain.yaml', CHAIN), ('imu.yaml', IMU)):
            with open(self.path(name), 'w', encoding='utf-8') as stream:
                yaml.safe_dump(content, stream)

    def path(self, *names):
        return os.path.join(self.folder, *names)

    def run_import(self, *arguments):
        return subprocess.run(['/usr/bin/python3', os.path.join(HERE, '..', 'scripts', 'import_kalibr'), self.path('camchain.yaml'), *arguments,
                               '--out', self.path('out')], capture_output=True, text=True, check=False)

    def test_camera_info_and_parameters(self):
        result = self.run_import(self.path('imu.yaml'))
        self.assertEqual(result.returncode, 0, result.stderr)
        info = calibration.read_camera_info(self.path('out', 'camera_info.yaml'))
        self.assertEqual((info.width, info.height, info.distortion_model), (752, 480, 'plumb_bob'))
        self.assertTrue(np.allclose(info.K, [458.6, 0, 367.2, 0, 457.3, 248.4, 0, 0, 1]))
        self.assertTrue(np.allclose(info.D, [-0.28, 0.07, 0.0002, 1.8e-05, 0]))
        with open(self.path('out', 'mav_vo.yaml'), encoding='utf-8') as stream:
            parameters = yaml.safe_load(stream)
        for name, value in (('gyro_noise_density', 1.6968e-4), ('accel_noise_density', 2e-3), ('gyro_bias_walk', 1e-5), ('accel_bias_walk', 3e-3)):
            self.assertIsInstance(parameters[name], float)
            self.assertAlmostEqual(parameters[name], value, places=9)
        self.assertIn('mav_image:=/cam0/image_raw mav_camera_info:=/cam0/camera_info mav_imu:=/imu0', result.stdout)

    def test_values_replace_lines_commented_or_not(self):
        text, unknown = calibration.filled_in('# time_offset: 0        # [s] (-0.1..0.1)\nrate: 3\n', {'time_offset': -8.1e-05, 'other': 1.0}, 'x')
        self.assertEqual(yaml.safe_load(text), {'time_offset': -8.1e-05, 'rate': 3})
        self.assertEqual(unknown, ['other'])
        self.assertIn('# [s] (-0.1..0.1)', text)

    def test_fisheye_and_refusals(self):
        result = self.run_import('--camera', 'cam1')
        self.assertEqual(result.returncode, 0, result.stderr)
        info = calibration.read_camera_info(self.path('out', 'camera_info.yaml'))
        self.assertEqual(info.distortion_model, 'equidistant')
        self.assertTrue(np.allclose(info.D, [-0.01, 0.02, -0.03, 0.004]))
        self.assertIn('has no T_cam_imu', result.stdout)
        self.assertIn('mav_image:=/cam1/image_raw ', result.stdout)
        for camera, text in (('cam2', 'camera model omni'), ('cam7', 'no camera cam7; it has cam0, cam1, cam2')):
            result = self.run_import('--camera', camera)
            self.assertEqual(result.returncode, 1)
            self.assertIn(text, result.stderr)
            self.assertEqual(len(result.stderr.splitlines()), 1, result.stderr)
        with open(self.path('camchain.yaml'), 'w', encoding='utf-8') as stream:
            stream.write('cam0: [\n')
        result = self.run_import()
        self.assertEqual((result.returncode, len(result.stderr.splitlines())), (1, 1), result.stderr)

    def test_the_command_names_the_ground_robots_inputs_too(self):
        """A bag without calibration and mounting of the MAV, and a ground robot of which nothing is as the launch files have it."""
        eye = Camera(64, 48, 60, 60, 32, 24)
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            edges = [('base_footprint', 'base', np.eye(4)), ('base', 'eye', np.eye(4)), ('base', 'depth_eye', np.eye(4))]
            messages.write_latched(bag, '/tf_static', messages.static_transforms(edges, 99), 99)
            for t in np.arange(100, 102, 0.05):
                bag.write('/cam0/image_raw', messages.image(np.zeros((48, 64)), 'mono8', t, 'cam0'), messages.stamp(t))
                bag.write('/imu0', messages.imu([0.01, 0, 0], [0, 0, 9.81], 1e-6, 1e-4, t, 'imu0'), messages.stamp(t))
                bag.write('/camera/color/image_raw', messages.image(np.zeros((48, 64, 3)), 'rgb8', t, 'eye'), messages.stamp(t))
                bag.write('/camera/depth/image_raw', messages.image(np.full((48, 64), 20000), '16UC1', t, 'depth_eye'), messages.stamp(t))
                for name, frame in (('color', 'eye'), ('depth', 'depth_eye')):
                    bag.write(f'/camera/{name}/camera_info', messages.camera_info(eye, t, frame), messages.stamp(t))
                bag.write('/camera/imu', messages.imu([0.01, 0, 0], [0, 0, 9.81], 1e-6, 1e-4, t, 'floating'), messages.stamp(t))
        result = self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag'))
        self.assertEqual(result.returncode, 0, result.stderr)
        words = shlex.split(result.stdout.splitlines()[-1])
        for word in ('ground_base_frame:=base', 'ground_camera_frame:=eye', 'ground_depth_registered:=false', 'ground_depth_camera_info:=/camera/depth/camera_info',
                     'ground_imu:=none', 'ground_depth_unit:=0.0002', 'mav_imu:=/imu0', 'mav_camera_frame:=cam0'):
            self.assertIn(word, words)
        self.assertFalse([word for word in words if word.startswith(('mav_base_frame', 'mav_use_imu', 'ground_imu:=/'))], words)

    def test_what_is_the_mavs_is_not_the_ground_robots(self):
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            for t in (5, 6):
                for topic, kind, shape in (('/cam0/image_raw', 'mono8', (48, 64)), ('/cam0/depth', '16UC1', (48, 64))):
                    bag.write(topic, messages.image(np.full(shape, 1500 if kind == '16UC1' else 0), kind, t, 'left_eye'), messages.stamp(t))
                bag.write('/imu0', messages.imu([0, 0, 0], [0, 0, 9.81], 1, 1, t, 'imu_of_mine'), messages.stamp(t))
        words = shlex.split(self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag')).stdout.splitlines()[-1])
        self.assertIn('rgbd_slam:=false', words)
        self.assertFalse([word for word in words if word.startswith('ground_')], words)

    def test_launch_file_publishes_transforms_and_camera_info(self):
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            bag.write('/cam0/image_raw', messages.image(np.zeros((480, 752)), 'mono8', 5, 'left_eye'), messages.stamp(5))
            bag.write('/imu0', messages.imu([0, 0, 0], [0, 0, 9.81], 1, 1, 5, 'imu_of_mine'), messages.stamp(5))
        result = self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag'))
        self.assertEqual(result.returncode, 0, result.stderr)
        words = shlex.split(result.stdout.splitlines()[-1])
        for word in (f'bag:={self.path("x.bag")}', 'mav_image:=/cam0/image_raw', 'mav_camera_info:=/cam0/camera_info', 'mav_imu:=/imu0',
                     'mav_camera_frame:=left_eye', 'rgbd_slam:=false', f'mav_vo_config:={self.path("out", "mav_vo.yaml")}'):
            self.assertIn(word, words)
        rospy.init_node('import_kalibr_test', anonymous=True)
        infos, edges = [], {}
        rospy.Subscriber('/cam0/camera_info', CameraInfo, infos.append)
        rospy.Subscriber('/tf_static', TFMessage, lambda m: edges.update({e.child_frame_id: e for e in m.transforms}))
        images = rospy.Publisher('/cam0/image_raw', Image, queue_size=5)
        process = subprocess.Popen(['roslaunch', self.path('out', 'sensors.launch')], stdout=subprocess.DEVNULL)
        try:
            for i in range(200):
                if len(edges) == 2 and infos:
                    break
                images.publish(messages.image(np.zeros((480, 752)), 'mono8', 100 + i, 'left_eye'))
                rospy.rostime.wallsleep(0.1)
        finally:
            process.terminate()
            process.wait(30)
        self.assertEqual(infos[0].header.frame_id, 'left_eye')
        self.assertGreaterEqual(infos[0].header.stamp.to_sec(), 100)
        self.assertEqual(infos[0].width, 752)
        t = edges['left_eye'].transform.translation
        self.assertEqual(edges['left_eye'].header.frame_id, 'mav_base_link')
        self.assertTrue(np.allclose([t.x, t.y, t.z], [0.1, 0, 0], atol=1e-8), t)
        t, q = edges['imu_of_mine'].transform.translation, edges['imu_of_mine'].transform.rotation
        self.assertTrue(np.allclose(geometry.pose_from_tq([t.x, t.y, t.z], [q.x, q.y, q.z, q.w]), np.eye(4), atol=1e-8))


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'import_kalibr_test', ImportKalibr)
