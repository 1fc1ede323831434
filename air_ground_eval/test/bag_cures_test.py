#!/usr/bin/env python3
"""check_bag says what to do about what a bag lacks, in terms of the robot that lacks it; import_kalibr finds the topics by itself."""
import os
import sys
import unittest
from unittest import mock

import numpy as np
import rosunit

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [HERE, os.path.join(HERE, '..', 'scripts')]
from air_ground_eval import bag_camera, bag_check, bag_reader, bag_registration, geometry, messages  # noqa: E402
from bag_layouts_test import CAMERA, PICTURE, BagLayouts, Recording, run  # noqa: E402
from bag_mountings_test import Robots  # noqa: E402

OPTICAL = geometry.R_BODY_FORWARD_CAMERA.T  # takes a body's axes to those of a level optical frame


class BagCures(unittest.TestCase):
    setUp, path, check, assert_arguments = BagLayouts.setUp, BagLayouts.path, BagLayouts.check, BagLayouts.assert_arguments
    warned, published = BagLayouts.warned, BagLayouts.published

    def test_a_gyro_alone(self):
        """As a Kobuki's: of use on the ground; a MAV needs more."""
        Robots(self.path(), [('base_link', 'eye'), ('base_link', 'imu')]).ground().imu('/imu', 'imu', accel=(0, 0, 0))
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assertTrue(self.warned(output, 'the gyro alone tells turns'), output)
        self.assert_arguments(command, ground_imu='/imu')
        self.assert_arguments(self.check('--map', 'none:=ground_imu')[2], ground_imu='none')
        Robots(self.path(), [('base_link', 'cam'), ('base_link', 'imu')]).camera('/uav/image_raw', 'mono8', 'cam').imu('/imu', 'imu', accel=(0, 0, 0))
        status, output, command = self.check()
        self.assertEqual(status, 1, output)
        self.assert_arguments(command, mav_use_imu='false')

    def test_an_imu_of_one_message(self):
        recording = Robots(self.path(), [('base_link', 'cam'), ('base_link', 'imu')]).camera('/uav/image_raw', 'mono8', 'cam')
        recording.add('/imu', 0.5, lambda t: messages.imu((0, 0, 0), (0, 0, 9.81), 1e-6, 1e-4, t, 'imu'))
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_use_imu='false')

    def test_no_robot_is_offered_the_others_topics(self):
        robots = Robots(self.path(), [('base_link', 'eye'), ('fcu', 'cam'), ('fcu', 'imu')]).ground().camera('/uav/image_raw', 'mono8', 'cam', info=False)
        robots.imu('/mavros/imu/data', 'imu').imu('/mavros/imu/data_raw', 'imu').add('/camera/ir/camera_info', 20, lambda t: messages.camera_info(CAMERA, t, 'eye'))
        output, command = self.check()[1:]
        self.assertNotIn('of this type', output)
        self.assertIn('publish_calibration --camera-info FILE.yaml image:=/uav/image_raw', output)
        self.assert_arguments(command, ground_imu='none')

    def test_a_mavs_images_in_a_body_frame(self):
        """As Gazebo's, ahead and pitched down; not those of optical axes, nor of an IMU's whose x axis is up."""
        for pitch in (0, np.pi / 2):
            T = geometry.pose(np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]), (0.05, 0, -0.03))
            Robots(self.path()).camera('/uav/image_raw', 'mono8', 'camera_link').imu('/imu', 'base_link').transforms('/tf_static', ('base_link', 'camera_link', T))
            output = self.check()[1]
            self.assertTrue(self.warned(output, 'are those of a body'), output)
            facts = bag_reader.BagFacts(self.path())
            facts.add_static(messages.static_transforms(self.published(output), 100))
            np.testing.assert_allclose(facts.static_transform('base_link', 'camera_link'), T @ geometry.pose(geometry.R_BODY_FORWARD_CAMERA), atol=1e-5)
        for R, accel in ((geometry.R_BODY_FORWARD_CAMERA, (0, 0, 9.81)), (geometry.R_BODY_DOWN_CAMERA, (0, 0, 9.81)), (np.eye(3), (9.81, 0, 0))):
            Robots(self.path()).camera('/uav/image_raw', 'mono8', 'cam').imu('/imu', 'base', accel=accel).transforms('/tf_static', ('base', 'cam', geometry.pose(R)))
            self.assertNotIn('of a body', self.check()[1])

    def test_camera_and_imu_in_one_frame(self):
        Robots(self.path()).camera('/uav/image_raw', 'mono8', 'world').imu('/imu', 'world')
        output = self.check()[1]
        self.assertTrue(self.warned(output, "are both in frame 'world'"), output)
        self.assertIn(f'import_kalibr CALIBRATION --bag {self.path()} --image /uav/image_raw --imu-topic /imu ', output)

    def test_the_parts_of_a_depth_camera_without_transforms(self):
        recording = Recording(self.path()).camera('/camera/color/image_raw', 'rgb8', 'd4_color_optical_frame').camera('/camera/depth/image_raw', '16UC1', 'd4_depth_optical_frame')
        recording.imu('/camera/imu', 'd4_imu_optical_frame', accel=OPTICAL @ (0, 0, 9.81))
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_imu='/camera/imu', ground_depth_registered='false')
        self.assertEqual([edge[1] for edge in self.published(output)], [f'd4_{part}_optical_frame' for part in ('color', 'imu', 'depth')])

    def test_images_that_no_node_decodes(self):
        Recording(self.path(), [('base_link', 'cam')]).add('/tello/image_raw/h264', 10, lambda t: messages.text('')).add('/tello/camera_info', 10, lambda t: messages.camera_info(CAMERA, t, 'cam'))
        status, output, command = self.check()
        self.assertEqual((status, output.count('ERROR')), (1, 1), output)
        self.assertIn('republish h264 in:=/tello/image_raw compressed out:=/tello/image_raw', output)
        self.assert_arguments(command, mav_image='/tello/image_raw', mav_camera_info='/tello/camera_info')

    def test_small_things(self):
        recording = Robots(self.path(), [('base_link', 'cam'), ('base_link', 'imu')]).camera('/uav/image_undistorted', 'mono8', 'cam', distortion=[0.1, 0, 0, 0]).imu('/imu', 'imu')
        recording.add('/vicon/uav', 50, lambda t: messages.pose_stamped(np.eye(4), t, 'vicon'))
        output = self.check()[1]
        self.assertTrue(self.warned(output, 'undistorted by its name'), output)
        self.assertNotIn('as one frame', output)
        recording = Robots(self.path(), [('base_link', 'eye')]).camera('/camera/rgb/image_raw', 'rgb8', 'eye').camera('/camera/depth_registered/image_raw', '16UC1', 'eye', factor=0)
        output = recording.camera('/camera/depth/image_raw', '16UC1', 'eye') and self.check()[1]
        self.assertRegex(output, 'ERROR .*has any depth .*has depth on /camera/depth/image_raw, too')

    def test_broken_images(self):
        """Of no pixels, or short of a byte: named, and left out of what the others tell."""
        def fault(array, encoding, **fields):
            message = messages.image(array, '16UC1' if array.dtype == np.uint16 else encoding, 1, 'cam')
            for name, value in {'encoding': encoding, **fields}.items():
                setattr(message, name, value)
            return message

        counts = PICTURE.astype(np.uint16) * 16
        for kinds, encoding, array in ((bag_camera.GREY, 'mono16', counts), (bag_camera.DEPTH, '16UC1', counts), (bag_camera.GREY, 'mono8', PICTURE)):
            whole = fault(array, encoding)
            for broken in (fault(array, encoding, data=whole.data[:-1]), fault(array, encoding, width=0, height=0, step=0, data=b'')):
                for samples, level in (([broken, whole, whole], bag_check.WARNING), ([whole, whole, broken], bag_check.WARNING), ([broken], bag_check.ERROR)):
                    stream = mock.Mock(samples=samples, spread=samples)
                    found = [f for f in bag_camera.check_image('/cam', stream, kinds) if f.level != bag_check.OK]
                    self.assertEqual([f.level for f in found], [level], found)
                    self.assertIn(f'1 of the first {len(samples)} images are broken', found[0].text)
        nothing = fault(counts, '16UC1', width=0, height=0, step=0, data=b'')
        for images in ((nothing, whole), (whole, nothing), (nothing, nothing)):
            self.assertEqual(bag_registration.Registration(images, [{'cam'}] * 2, [None] * 2, ['/depth', '/rgb']).check('/depth', '/rgb'), [])

    def test_import_kalibr_takes_what_check_bag_guesses(self):
        Robots(self.path()).camera('/left/image_raw', 'mono8', 'left', info=False).imu('/imu/imu', 'imu')
        for width, status in ((64, 0), (752, 1)):
            with open(self.path('sensor.yaml'), 'w', encoding='utf-8') as stream:
                stream.write(f'sensor_type: camera\nT_BS: {{data: {np.eye(4).ravel().tolist()}}}\nresolution: [{width}, 48]\ncamera_model: pinhole\nintrinsics: [60, 60, 32, 24]\n'
                             'distortion_model: radial-tangential\ndistortion_coefficients: [0, 0, 0, 0]\n')
            found, output = run('import_kalibr', self.path('sensor.yaml'), '--bag', self.path(), '--out', self.path('out'))
            self.assertEqual(found, status, output)
            if not status:
                self.assertIn('/left/image_raw is taken for mav_image, as check_bag guesses', output)
                self.assertIn('mav_image:=/left/image_raw mav_camera_info:=/left/camera_info mav_imu:=/imu/imu', output)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'bag_cures_test', BagCures)
