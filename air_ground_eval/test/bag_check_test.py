#!/usr/bin/env python3
"""check_bag must name each of the usual faults of a recording, and accept a sound one."""
import os
import sys
import tempfile
import unittest

import numpy as np
import rosbag
import rosunit

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'scripts'))
from air_ground_eval import bag_check, datasets, geometry, messages  # noqa: E402

CAMERA = datasets.Camera(64, 48, 60, 60, 32, 24)


def write(path, **faults):
    """A bag of 3 s with the faults asked for."""
    with rosbag.Bag(path, 'w') as bag:
        edges = [(f'{r}_base_link', f'{r}_{f}', np.eye(4)) for r in ('mav', 'ground') for f in ('camera_optical_frame', 'imu_link')]
        if not faults.get('no_tf'):
            messages.write_latched(bag, '/tf_static', messages.static_transforms(edges, 99), 99)
        for i in range(600):
            t = 100 + i / 200
            for robot in ('mav', 'ground'):
                accel = np.array([0, 0, 9.81]) * faults.get('imu_factor', 1.0)
                gyro = np.array([0.01, 0, 0]) * faults.get('gyro_factor', 1.0)
                topic = f'/{robot}/imu/data' if robot == 'ground' or not faults.get('imu_elsewhere') else '/imu0'
                bag.write(topic, messages.imu(gyro, accel, 1e-6, 1e-4, t, f'{robot}_imu_link'), messages.stamp(t))
            if i % 10 == 0 and not (faults.get('gap') and 200 < i < 400):
                stamp = t - 0.5 if faults.get('jump') and i == 300 else t
                info = messages.camera_info(CAMERA, stamp, 'mav_camera_optical_frame')
                if faults.get('uncalibrated'):
                    info.K = [0.0] * 9
                if faults.get('fisheye'):
                    info.distortion_model = 'equidistant'
                bag.write('/mav/camera/camera_info', info, messages.stamp(t))
                bag.write('/mav/camera/image_raw', messages.image(np.zeros((48, 64)), 'mono8', stamp, 'mav_camera_optical_frame'), messages.stamp(t))
                frame = '' if faults.get('no_frame') else 'ground_camera_optical_frame'
                bag.write('/ground/rgb/image_raw', messages.image(np.zeros((48, 64, 3)), 'rgb8', t, frame), messages.stamp(t))
                bag.write('/ground/rgb/camera_info', messages.camera_info(CAMERA, t, frame), messages.stamp(t))
                shape = (24, 32) if faults.get('small_depth') else (48, 64)
                if not faults.get('no_depth'):
                    bag.write('/ground/depth/image_raw', messages.image(np.full(shape, faults.get('depth', 1500)), '16UC1', t, frame), messages.stamp(t))
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
        self.assertEqual([f for f in self.findings() if f.level != bag_check.OK], [])

    def test_errors(self):
        for text, faults in (('in g', dict(imu_factor=1 / 9.81)), ('gravity was removed', dict(imu_factor=0.01)), ('degrees', dict(gyro_factor=6000.0)),
                             ('not calibrated', dict(uncalibrated=True)), ('undistort', dict(fisheye=True)), ('/tf_static', dict(no_tf=True)),
                             ('frame id is empty', dict(no_frame=True)), ('/ground/depth/image_raw is missing', dict(no_depth=True)),
                             ('differ in size', dict(small_depth=True)), ('the bag has /imu0', dict(imu_elsewhere=True))):
            self.assert_found(bag_check.ERROR, text, **faults)

    def test_warnings(self):
        for text, faults in (('stamps go back', dict(jump=True)), ('a gap of', dict(gap=True)), ('millimetres', dict(depth=20000))):
            self.assert_found(bag_check.WARNING, text, **faults)

    def test_mapped_names(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write(path, imu_elsewhere=True)
            self.assertEqual([f.text for f in bag_check.check(path, {'/mav/imu/data': '/imu0'}) if f.level == bag_check.ERROR], [])

    def test_a_flight_in_the_city_needs_no_ground_robot(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write(path, no_depth=True, no_frame=True)
            self.assertTrue([f for f in bag_check.check(path) if f.level == bag_check.ERROR])
            found = bag_check.check(path, city=True)
            self.assertEqual([f.text for f in found if f.level == bag_check.ERROR], [])
            self.assertTrue(any('/gps/fix is missing' in f.text for f in found if f.level == bag_check.WARNING))
            other = bag_check.check(path, bases={'mav': 'imu_link'}, city=True)
            self.assertTrue(any('does not connect imu_link' in f.text for f in other if f.level == bag_check.ERROR))


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'bag_check_test', BagCheck)
