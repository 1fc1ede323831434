#!/usr/bin/env python3
"""check_bag on bags of robots whose transforms, names or images are as few have them: which camera is whose, and what it prints works as printed."""
import os
import re
import sys
import unittest

import numpy as np
import rosunit
from sensor_msgs.msg import Image

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [HERE, os.path.join(HERE, '..', 'scripts')]
from air_ground_eval import bag_camera, bag_reader, geometry, messages  # noqa: E402
from bag_layouts_test import PICTURE, BagLayouts, Recording  # noqa: E402

AHEAD = geometry.pose(geometry.R_BODY_FORWARD_CAMERA)
HIGH = AHEAD.copy()
HIGH[2, 3] = 0.7


class Robots(Recording):
    def ground(self, folder='/camera', frame='eye'):
        return self.camera(f'{folder}/rgb/image_raw', 'rgb8', frame).camera(f'{folder}/depth_registered/image_raw', '16UC1', frame)

    def mav(self, folder='/uav1/camera', frame='cam', imu='imu'):
        return self.camera(f'{folder}/image_raw', 'mono8', frame).imu('/uav1/imu/data', imu)

    def transforms(self, topic, *edges, rate=10):
        """edges: parent, child, and the transform (of the time) where that is not the identity."""
        def message(t):
            return messages.static_transforms([(parent, child, T[0](t) if T and callable(T[0]) else T[0] if T else np.eye(4)) for parent, child, *T in edges], t)

        return self.add(topic, rate, message)


def moving(t):
    return geometry.pose(translation=(0.1 * (t - 100), 0, 0))


class BagMountings(unittest.TestCase):
    setUp, path, check, assert_arguments = BagLayouts.setUp, BagLayouts.path, BagLayouts.check, BagLayouts.assert_arguments
    warned, published = BagLayouts.warned, BagLayouts.published

    def robots(self, *mountings):
        return Robots(self.path(), mountings)

    def test_cameras_in_two_trees_are_of_two_robots(self):
        """Though both drivers have the folder /camera."""
        recording = self.robots(('ground_base_link', 'eye'), ('mav_base_link', 'infra'), ('mav_base_link', 'imu')).imu('/camera/imu', 'imu')
        recording.camera('/camera/color/image_raw', 'rgb8', 'eye').camera('/camera/aligned_depth_to_color/image_raw', '16UC1', 'eye').camera('/camera/infra1/image_rect_raw', 'mono8', 'infra')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_image='/camera/color/image_raw', mav_image='/camera/infra1/image_rect_raw', mav_imu='/camera/imu', mav_vo=None)

    def ground_alone(self, recording, *hidden):
        """The bag is of the ground robot, whose other cameras are no MAV's."""
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_image=None, mav_vo='false')
        self.assertIn('the bag is of one robot', output)
        for topic in hidden:
            self.assertTrue(any(line.startswith('guess   other images: ') and topic in line for line in output.splitlines()), output)
        return command

    def test_a_camera_on_a_limb_is_no_mavs(self):
        """A hand that /tf moves below a root that odom is above, or, as Spot has it, below."""
        for root in (('odom', 'base_link', moving), ('base_link', 'odom', moving)):
            recording = self.robots(('base_link', 'eye'), ('hand', 'grip')).ground('/head').camera('/hand/color/image_raw', 'rgb8', 'grip')
            recording.transforms('/tf', root, ('base_link', 'hand', moving)).imu('/imu', 'base_link')
            self.assert_arguments(self.ground_alone(recording, '/hand/color/image_raw'), ground_image='/head/rgb/image_raw', ground_imu='/imu')
        for parent in ('map', 'world'):  # what both robots move in is no body
            recording = self.robots(('base', 'eye'), ('body', 'grip')).ground('/head').camera('/other/image_raw', 'mono8', 'grip')
            recording.transforms('/tf', (parent, 'base', moving), (parent, 'body', moving), ('earth', parent, moving))
            output = self.check()[1]
            self.assertIn('guess   mav_image: /other/image_raw', output)
            self.assertNotIn('nothing says so', output)

    def test_images_of_a_lidar_are_no_mavs(self):
        recording = self.robots(('base_link', 'eye')).ground().camera('/ouster/nearir_image', 'mono16', 'lidar', info=False)
        self.assertNotIn('ouster', ' '.join(self.ground_alone(recording).values()))

    def test_depth_goes_with_the_camera_beside_it(self):
        """Not with another that its name calls a colour camera, and the front one before the others."""
        recording = Robots(self.path())
        places = {'back': -0.4, 'frontleft': 0.4}
        recording.transforms('/tf_static', *(edge for name, x in places.items() for edge in (('body', name, geometry.pose(AHEAD[:3, :3], (x, 0, 0))), (name, f'{name}_fisheye'))), ('body', 'hand'))
        for name in places:
            recording.camera(f'/spot/camera/{name}/image', 'mono8', f'{name}_fisheye').camera(f'/spot/depth/{name}/image', '16UC1', name)
        recording.camera('/spot/camera/hand_color/image', 'rgb8', 'hand')
        command = self.ground_alone(recording, '/spot/camera/hand_color/image')
        self.assert_arguments(command, ground_image='/spot/camera/frontleft/image', ground_depth='/spot/depth/frontleft/image')
        self.assert_arguments(self.check('--map', '/spot/depth/back/image:=ground_depth')[2], ground_image='/spot/camera/back/image')

    def test_where_nothing_names_a_flyer(self):
        """A second camera may be on the ground robot; that it is not is said by names, by its IMU, or by a body of its own."""
        for topic, frame, edges, imu, said in (('/usb_cam/image_raw', 'cam', (), None, True), ('/uav/image_raw', 'cam', (), None, False),
                                               ('/usb_cam/image_raw', 'cam', (('fcu', 'cam'),), ('/mavros/imu/data', 'fcu'), False),
                                               ('/rear/image_raw', 'cam', (('rear_link', 'cam'),), None, True), ('/eye/image_raw', 'cam', (('mav_base_link', 'cam'),), None, False)):
            recording = self.robots(('base_link', 'eye'), *edges).ground().camera(topic, 'mono8', frame)
            if imu:
                recording.imu(*imu)
            _, output, command = self.check()
            self.assert_arguments(command, mav_image=topic, mav_imu=imu and imu[0])
            self.assertEqual(f"guess   {topic} is taken for the MAV's, though nothing says so" in output, said, output)

    def test_an_imu_on_the_other_robots_body(self):
        """By transforms that /tf changes, and by what merge_bags wrote before frames."""
        recording = self.robots(('base_link', 'pan_mount'), ('head', 'eye')).ground('/head').camera('/cam0/image_raw', 'mono8', 'cam').imu('/imu', 'base_link').imu('/imu0', 'imu4', rate=100)
        recording.transforms('/tf', ('odom', 'base_link', moving), ('base_link', 'head', moving))
        self.assert_arguments(self.check()[2], mav_imu='/imu0', ground_imu='none')  # its head moves
        recording = self.robots().ground().camera('/bebop/image_raw', 'rgb8', 'cam').imu('/imu/data', 'ground_base_link').transforms('/tf', ('ground_odom', 'ground_base_link', moving))
        self.assert_arguments(self.check()[2], mav_imu=None, mav_use_imu='false', ground_imu='/imu/data', ground_base_frame=None)

    def test_the_imu_of_a_body_without_transforms_of_the_camera(self):
        """As MAVROS and many bases have it, in base_link: the IMU's own frame is the body."""
        recording = self.robots().ground(frame='camera_optical_frame').imu('/imu/data', 'base_link').transforms('/tf', ('odom', 'base_link', moving))
        command = self.ground_alone(recording)
        self.assert_arguments(command, ground_imu='/imu/data', ground_base_frame='base_link')
        self.assertEqual([edge[:2] for edge in self.published(self.check()[1])], [('base_link', 'camera_optical_frame')])

    def test_a_calibration_one_folder_up(self):
        """As uHumans2 has it, where its frame and size are the images'."""
        for frame, pixels, known in (('eye', (64, 48), True), ('other', (64, 48), False), ('eye', (80, 48), False)):
            recording = self.robots(('base', 'eye')).camera('/tesse/left/rgb/image_raw', 'rgb8', 'eye', info_topic='/tesse/left/camera_info', info_frame=frame, size=pixels)
            recording.camera('/tesse/depth/mono/image_raw', '32FC1', 'eye', info=False)
            status, output, command = self.check()
            self.assertEqual(status, 0 if known else 1, output)
            self.assert_arguments(command, ground_camera_info='/tesse/left/camera_info' if known else None)

    def test_an_image_with_a_calibration_before_one_without(self):
        recording = self.robots(('base_link', 'cam'), ('base_link', 'imu')).imu('/mavros/imu/data', 'imu')
        recording.camera('/apriltag/tag_detections_image', 'mono8', 'cam', info=False).camera('/camera/image_color', 'rgb8', 'cam')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_image='/camera/image_color', mav_camera_info='/camera/camera_info')

    def test_the_other_eyes_of_a_depth_camera_without_folder_and_transforms(self):
        """As an Azure Kinect's; an infrared camera with a folder of its own may fly."""
        recording = self.robots().camera('/rgb/image_raw', 'bgra8', 'rgb').camera('/depth_to_rgb/image_raw', '16UC1', 'rgb').camera('/depth/image_raw', '16UC1', 'depth')
        recording.camera('/ir/image_raw', 'mono8', 'depth').camera('/rgb_to_depth/image_raw', 'bgra8', 'depth').imu('/imu', 'imu')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_image='/rgb/image_raw', mav_image=None, mav_vo='false')
        recording.camera('/t265/infra1/image_rect_raw', 'mono8', 'cam')
        self.assert_arguments(self.check()[2], ground_image='/rgb/image_raw', mav_image='/t265/infra1/image_rect_raw')

    def test_a_frame_with_two_parents(self):
        recording = self.robots(('base_link', 'eye'), ('base_link', 'other')).ground()
        self.assertNotIn('several parents', self.check()[1])
        recording.transforms('/tf_static', ('mount', 'eye'))
        output = self.check()[1]
        self.assertTrue(self.warned(output, "/tf_static has several parents of 'eye', 'base_link', 'mount', and a frame has one: the last is taken, 'mount'"), output)
        facts = bag_reader.BagFacts(self.path())
        facts.add_static(messages.static_transforms([('base_link', 'eye', np.eye(4))], 99))
        self.assertEqual(facts.rivals, {}, 'another publisher decides')

    def test_encodings_that_the_nodes_read(self):
        def image(t, array, encoding):
            message = Image(height=48, width=80, encoding=encoding, step=array.nbytes // 48, data=array.tobytes())
            message.header.stamp, message.header.frame_id = messages.stamp(t), 'cam'
            return message

        for encoding, array in (('rgb16', np.dstack([PICTURE.astype(np.uint16) * 16] * 3)), ('rgba16', np.dstack([PICTURE.astype(np.uint16) * 16] * 3 + [np.full((48, 80), 65535, np.uint16)])),
                                ('yuyv', np.dstack([PICTURE, np.full((48, 80), 128, np.uint8)])), ('8SC1', PICTURE)):
            self.robots(('base_link', 'cam')).add('/cam/image_raw', 10, lambda t, a=array, e=encoding: image(t, a, e))
            output = self.check()[1]
            self.assertEqual("ERROR   /cam/image_raw: encoding '8SC1'; expected one of" in output, encoding == '8SC1', output)
            self.assertEqual('use 12 of 16 bits' in output, encoding == 'rgb16', output)
        with open(os.path.join(HERE, '..', '..', 'air_ground_common', 'src', 'ros', 'pixel_range.cpp'), encoding='utf-8') as stream:
            sixteen = {name.replace('TYPE_', '') for name in re.findall(r'== enc::(\w+)', stream.read())}
        self.assertEqual(sixteen, {e if e == '16UC1' else e.upper() for e in bag_camera.GREY if '16' in e and 'a16' not in e})

    def test_theora_alone(self):
        self.robots(('mav_base_link', 'cam'), ('mav_base_link', 'imu')).imu('/mav/imu/data', 'imu').add('/mav/camera/image_raw/theora', 10, lambda t: messages.text(''))
        output = self.check('--only', 'mav')[1]
        self.assertIn('rosrun image_transport republish theora in:=/mav/camera/image_raw compressed out:=/mav/camera/image_raw', output)
        self.assertIn('record /mav/camera/image_raw/compressed', output)

    def test_the_robots_own_odometry_is_named_above_its_base(self):
        """odom -> base_footprint, with base_link fixed to that; whatever odom is called, unless the suite's own SLAM was recorded."""
        for odom, slam, named in (('odom', False, True), ('ground_odom', False, True), ('ground_odom', True, False)):
            recording = self.robots(('base_footprint', 'base_link'), ('base_link', 'camera_base'), ('camera_base', 'eye')).ground().transforms('/tf', (odom, 'base_footprint', moving))
            if slam:
                recording.add('/ground/slam_status', 10, lambda t: messages.text(''))
            status, output, command = self.check()
            self.assertEqual(status, 0, output)
            self.assert_arguments(command, ground_base_frame='base_link')  # camera_base is no robot's
            self.assertEqual(f'/tf holds {odom} -> base_footprint, to which base_link is fixed' in output, named, output)
            self.assertEqual(f'ground_odom_from_tf:=true ground_odom_frame:={odom}' in output, named, output)

    def test_compressed_images_of_a_topic_whose_name_does_not_say_so(self):
        recording = self.robots(('base', 'cam'), ('base', 'imu'), ('base_link', 'eye')).imu('/uav1/imu/data', 'imu').camera('/camera/rgb/image_raw', 'rgb8', 'eye')
        recording.compressed('/uav1/camera/image_jpeg', 'jpeg', 'cam', PICTURE[:, :64]).compressed('/camera/depth_png', 'png', 'eye', np.full((48, 64), 1500, np.uint16), '.png', info=False)
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_image='/uav1/camera/image_jpeg', mav_image_transport='compressed', mav_camera_info='/uav1/camera/camera_info',
                              ground_depth='/camera/depth_png', ground_depth_transport='compressed')
        lines = output.splitlines()
        for line in ('rosrun topic_tools relay /uav1/camera/image_jpeg /uav1/camera/image_jpeg/compressed', 'rosrun topic_tools relay /camera/depth_png /camera/depth_png/compressedDepth'):
            self.assertIn(line, lines)
        self.robots(('mav_base_link', 'cam'), ('mav_base_link', 'imu')).imu('/mav/imu/data', 'imu').compressed('/mav/camera/image_raw/compressed', 'jpeg', 'cam', PICTURE[:, :64])
        self.assertNotIn('topic_tools', self.check()[1])

    def test_transforms_on_topics_of_namespaces(self):
        """As of robots whose /tf and /tf_static were remapped. What is printed works as printed, though both call their bases the same."""
        recording = self.robots().ground('/ugv/camera').mav()
        recording.transforms('/ugv/tf_static', ('mount', 'eye', AHEAD)).transforms('/ugv/tf', ('base_link', 'mount', HIGH @ geometry.inverse(AHEAD)), ('base_link', 'wheel'))
        recording.transforms('/uav1/tf', ('odom', 'base_link', moving), ('base_link', 'cam', HIGH), ('base_link', 'imu')).transforms('/arm/tf_static', ('shoulder', 'elbow'))
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assertTrue(self.warned(output, "tf of /ugv says where 'eye' is, and the nodes hear /tf_static and /tf alone"), output)
        self.assertIn('tf of /arm is heard by no node', output)
        self.assert_arguments(command, ground_base_frame='ugv/base_link', mav_base_frame='uav1/base_link', mav_image='/uav1/camera/image_raw', mav_imu='/uav1/imu/data')
        edges = self.published(output)
        self.assertEqual(sorted(edge[:2] for edge in edges), [('mount', 'eye'), ('uav1/base_link', 'cam'), ('uav1/base_link', 'imu'), ('ugv/base_link', 'mount')])
        facts = bag_reader.BagFacts(self.path())
        facts.add_static(messages.static_transforms(edges, 100))
        for base, camera in (('ugv/base_link', 'eye'), ('uav1/base_link', 'cam')):
            np.testing.assert_allclose(facts.static_transform(base, camera), HIGH, atol=1e-5)
        self.assertNotIn('at the origin', output)
        self.robots().ground('/ugv/camera').mav(imu='base_link').transforms('/ugv/tf_static', ('base_link', 'eye', HIGH)).transforms('/uav1/tf_static', ('base_link', 'cam', HIGH))
        status, output, command = self.check()  # as MAVROS names its IMU's frame
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_base_frame='ugv/base_link', mav_base_frame='base_link')

    def test_transforms_of_both_robots_in_one_frames_name(self):
        """Of a camera's frame that two namespaces have, none is taken: tf could keep one."""
        recording = self.robots().ground('/ugv/camera', 'cam').mav(frame='cam')
        output = recording.transforms('/ugv/tf_static', ('base_link', 'cam', HIGH)).transforms('/uav1/tf_static', ('body', 'cam', AHEAD)) and self.check()[1]
        self.assertTrue(self.warned(output, "says where 'cam' is, as another namespace does"), output)
        self.assertNotIn('--transform "base_link cam', output)

    def test_frames_with_a_prefix(self):
        """tf has robot1/eye where the images say eye, or the other way round."""
        for tf, eye in (('robot1/', ''), ('', 'robot1/')):
            self.robots().ground(frame=f'{eye}eye').transforms('/tf_static', (f'{tf}base_link', f'{tf}eye', HIGH))
            status, output, command = self.check()
            self.assertEqual(status, 0, output)
            self.assertTrue(self.warned(output, f"'{eye}eye' of images or IMU is in no transform, '{tf}eye' is"), output)
            self.assert_arguments(command, ground_base_frame=f'{tf}base_link')
            facts = bag_reader.BagFacts(self.path())
            facts.add_static(messages.static_transforms(self.published(output), 100))
            np.testing.assert_allclose(facts.static_transform(f'{tf}base_link', f'{eye}eye'), HIGH, atol=1e-9)
            self.assertNotIn('at the origin', output)
        self.robots().ground().transforms('/tf_static', ('a/base', 'a/eye'), ('b/base', 'b/eye'))
        output = self.check()[1]
        self.assertTrue(self.warned(output, "'eye' of images or IMU is in no transform, 'a/eye', 'b/eye' are"), output)
        self.assertEqual([edge[:2] for edge in self.published(output)], [('ground_base_link', 'eye')])

    def test_a_camera_that_moves_against_what_the_imu_sits_on(self):
        """A gimbal, and a ground robot's head: no transform to publish mends that, and the body is no odometry's frame."""
        self.robots(('gimbal', 'cam'), ('body', 'imu')).mav().transforms('/tf', ('body', 'gimbal', moving), ('odom', 'body', moving))
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assertTrue(self.warned(output, 'gimbal and imu (of /uav1/imu/data) move against each other'), output)
        self.assert_arguments(command, mav_base_frame='gimbal', mav_use_imu='false')
        self.assertNotIn('odom_from_tf', output)
        self.assertNotIn('publish_calibration', output)
        self.robots(('head', 'eye'), ('base', 'imu')).ground().imu('/imu', 'imu').transforms('/tf', ('base', 'head', moving))
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_base_frame='head', ground_imu='none')
        status, output, _ = self.check('--ground-base', 'base')
        self.assertEqual(status, 1, output)
        self.assertIn('name a body frame that is fixed to the camera (--ground-base)', output)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'bag_mountings_test', BagMountings)
