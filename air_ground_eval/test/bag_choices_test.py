#!/usr/bin/env python3
"""check_bag where a bag holds more than one topic that would do: which IMU, which reference poses; what it says of an IMU that is too slow, of messages that ROS 2 defined, and of
those that were recorded at another time or are too few."""
import contextlib
import io
import os
import re
import shlex
import sys
import unittest
from unittest import mock

import genpy.dynamic
import numpy as np
import rosbag
import rosunit
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import CameraInfo, FluidPressure, Image

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [HERE, os.path.join(HERE, '..', 'scripts')]
from air_ground_eval import bag_check, bag_imu, bag_reader, geometry, messages, pixel_range  # noqa: E402
from bag_layouts_test import CAMERA, BagLayouts, Recording, load  # noqa: E402


def position(t):
    message = PointStamped()
    message.header.stamp, message.header.frame_id = messages.stamp(t), 'world'
    return message


def pressure(value):
    def message(t):
        result = FluidPressure(fluid_pressure=value)
        result.header.stamp, result.header.frame_id = messages.stamp(t), 'fcu'
        return result

    return message


def info_of_ros_2(t):
    """Whose fields are d, k, r and p."""
    text = re.sub(r'(?m)^(float64\[\d*\] +)([DKRP])\b', lambda found: found[1] + found[2].lower(), CameraInfo._full_text)
    message = genpy.dynamic.generate_dynamic('sensor_msgs/CameraInfo', text)['sensor_msgs/CameraInfo'](width=64, height=48, k=[60, 0, 32, 0, 60, 24, 0, 0, 1])
    message.header.stamp, message.header.frame_id = messages.stamp(t), 'eye'
    return message


class BagChoices(unittest.TestCase):
    setUp, path, check, assert_arguments = BagLayouts.setUp, BagLayouts.path, BagLayouts.check, BagLayouts.assert_arguments
    warned = BagLayouts.warned

    def recording(self, *mountings):
        return Recording(self.path(), mountings)

    def test_the_cameras_own_imu_before_the_autopilots(self):
        """Whatever its name says: by the driver's folder, by what /tf_static connects, and by its rate."""
        self.recording(('base_link', 'cam'), ('base_link', 'imu')).camera('/cam0/image_raw', 'mono8', 'cam').imu('/imu0', 'imu').imu('/mavros/imu/data', 'imu', rate=50)
        self.assert_arguments(self.check()[2], mav_imu='/imu0', mav_use_imu=None)
        self.recording().camera('/cam0/image_raw', 'mono8', 'cam').imu('/imu0', 'imu').imu('/mavros/imu/data', 'fcu', rate=50)
        self.assert_arguments(self.check()[2], mav_imu='/imu0')
        self.recording().camera('/camera/fisheye1/image_raw', 'mono8', 'cam').imu('/camera/imu', 'imu').imu('/mavros/imu/data', 'fcu')
        self.assert_arguments(self.check()[2], mav_imu='/camera/imu')
        self.recording(('body', 'cam'), ('body', 'imu')).camera('/cam0/image_raw', 'mono8', 'cam').imu('/imu0', 'imu').imu('/mavros/imu/data', 'fcu')
        self.assert_arguments(self.check()[2], mav_imu='/imu0')
        self.recording().camera('/cam0/image_raw', 'mono8', 'cam').imu('/imu0', 'imu', rate=50).imu('/mavros/imu/data', 'fcu', rate=50)
        self.assert_arguments(self.check()[2], mav_imu='/mavros/imu/data')

    def test_of_two_robots_the_name_tells_whose_imu_it_is(self):
        """Where nothing else does: a faster one may be the other's."""
        recording = self.recording(('ground_base_link', 'eye')).camera('/cam0/image_raw', 'mono8', 'cam')
        recording.camera('/camera/color/image_raw', 'rgb8', 'eye').camera('/camera/aligned_depth_to_color/image_raw', '16UC1', 'eye')
        recording.imu('/imu/data', 'imu').imu('/mavros/imu/data', 'fcu', rate=50)
        self.assert_arguments(self.check()[2], mav_imu='/mavros/imu/data', ground_imu='none')

    def test_the_rate_of_a_topic(self):
        """Neither packets nor a pause count."""
        recording = self.recording().imu('/imu', 'imu', rate=50)
        recording.add('/packets', 50, lambda t: messages.imu((0, 0, 0), (0, 0, 9.81), 1e-6, 1e-4, 100 + 0.1 * int((t - 100) / 0.1) + 1e-5 * round(50 * t) % 5e-5, 'imu'))
        recording.add('/paused', 100, lambda t: messages.imu((0, 0, 0), (0, 0, 9.81), 1e-6, 1e-4, t + (5 if t > 101 else 0), 'imu'))
        facts = bag_reader.BagFacts(self.path())
        for topic, rate in (('/imu', 50), ('/packets', 50), ('/paused', 100), ('/none', 0)):
            self.assertAlmostEqual(facts.rate(topic), rate, delta=1, msg=topic)

    def test_an_imu_that_is_too_slow(self):
        """As the Zurich Urban MAV's, and MAVROS's unless its streams are set: nothing would ever become metric by it."""
        self.recording(('base_link', 'cam'), ('base_link', 'fcu')).camera('/cam0/image_raw', 'mono8', 'cam').imu('/mavros/imu/data', 'fcu', rate=10)
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_imu='/mavros/imu/data', mav_use_imu='false')
        self.assertIn('WARNING /mavros/imu/data: 10.0 Hz; less than 25 Hz leave gaps', output)
        self.assertEqual(output.count('/mavros/imu/data: 10.0 Hz'), 1)
        recording = self.recording(('ground_base_link', 'cam'), ('ground_base_link', 'imu')).camera('/ground/rgb/image_raw', 'rgb8', 'cam')
        recording.camera('/ground/depth/image_raw', '16UC1', 'cam').imu('/ground/imu/data', 'imu', rate=10)
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, ground_imu='none')
        self.assertIn('it tells neither turns nor the vertical', output)
        self.recording(('ground_base_link', 'cam')).camera('/ground/rgb/image_raw', 'rgb8', 'cam').camera('/ground/depth/image_raw', '16UC1', 'cam')
        self.assert_arguments(self.check()[2], ground_imu='none')  # its images would wait for what never comes
        for rate, used in ((30, None), (100, None)):
            self.recording(('base_link', 'cam'), ('base_link', 'fcu')).camera('/cam0/image_raw', 'mono8', 'cam').imu('/mavros/imu/data', 'fcu', rate=rate)
            _, output, command = self.check()
            self.assert_arguments(command, mav_use_imu=used)
            self.assertEqual('at least 80 Hz are advised' in output, rate < 80, output)

    def test_reference_poses_before_positions(self):
        recording = self.recording(('base_link', 'cam'), ('base_link', 'imu')).camera('/cam0/image_raw', 'mono8', 'cam').imu('/imu0', 'imu')
        recording.add('/leica/position', 20, position).poses('/optitrack/body')
        self.assert_arguments(self.check()[2], mav_truth='/optitrack/body')
        recording = self.recording(('base_link', 'cam'), ('base_link', 'imu')).camera('/cam0/image_raw', 'mono8', 'cam').imu('/imu0', 'imu')
        recording.add('/leica/position', 20, position)
        self.assert_arguments(self.check()[2], mav_truth='/leica/position')

    def test_a_reference_pose_without_stamp_is_left_out(self):
        """The first one's, of an age ago."""
        self.recording().add('/vicon', 50, lambda t: messages.pose_stamped(np.eye(4), 0 if t < 100.01 else t, 'world'))
        reference = bag_reader.BagFacts(self.path()).reference('/vicon')
        self.assertEqual((len(reference.stamps), reference.stamps[0]), (99, 100.02))

    def test_thermal_images_are_not_dark(self):
        """A microbolometer of 14 bits: all that it sees lies within 500 counts, which the nodes stretch."""
        counts = (7400 + np.add.outer(np.arange(48), np.arange(64)) / 110 * 500).astype(np.uint16)
        for array, padding, text in ((counts, 0, 'ok      /thermal/image_raw: its pixels use counts 7'), (counts, 8, 'ok      /thermal/image_raw: its pixels use counts 7'),
                                     (0 * counts + 7400, 0, 'image 3 is flat'), (0 * counts + 7400, 8, 'image 3 is flat')):
            def image(t, array=array, padding=padding):
                message = messages.image(np.pad(array, ((0, 0), (0, padding))), '16UC1', t, 'cam')  # rows are filled up with zeros
                message.encoding, message.width = 'mono16', array.shape[1]
                return message

            recording = self.recording(('base_link', 'cam')).add('/thermal/image_raw', 10, image)
            recording.add('/thermal/camera_info', 10, lambda t: messages.camera_info(CAMERA, t, 'cam'))
            output = self.check()[1]
            self.assertIn(text, output)
            self.assertEqual('is flat' in output, 'is flat' in text, output)

    def test_event_and_thermal_cameras_are_the_last_choice(self):
        """And of several images that are alike those with more pixels; a stream that is no image after all others."""
        for odd, other in (('/davis/left/image_raw', '/visensor/left/image_raw'), ('/stereo/davis_left/image_raw', '/stereo/frame_left/image_raw'), ('/boson_thermal/image_raw', '/visual/image_raw')):
            recording = self.recording(('base_link', 'odd'), ('base_link', 'cam'), ('base_link', 'imu')).camera(odd, 'mono16', 'odd').camera(other, 'mono8', 'cam')
            recording.imu(odd.replace('image_raw', 'imu'), 'imu').imu('/stim/imu', 'imu')
            self.assert_arguments(self.check()[2], mav_image=other, mav_imu='/stim/imu')
        self.recording(('base_link', 'cam')).camera('/a/image_raw', 'mono8', 'cam', pixels=(32, 24)).camera('/b/image_raw', 'mono8', 'cam')
        self.assert_arguments(self.check()[2], mav_image='/b/image_raw')
        recording = self.recording(('base_link', 'cam')).camera('/z/images', 'mono8', 'cam')

        def stream(t):
            message = Image(data=b'12345')
            message.header.stamp, message.header.frame_id = messages.stamp(t), 'cam'
            return message

        recording.add('/a/camera_h264_stream_raw', 10, stream)
        self.assert_arguments(self.check()[2], mav_image='/z/images')

    def test_images_of_16_bits_that_nothing_calls_depth(self):
        """A thermal camera's, whatever is beside it, or those of a camera alone."""
        for topic, beside in (('/boson/image_raw', False), ('/boson/image_raw', True), ('/eye/image_raw', False)):
            recording = self.recording(('base_link', 'cam'), ('base_link', 'imu')).camera(topic, '16UC1', 'cam').imu('/imu', 'imu')
            if beside:
                recording.camera('/visual/image_raw', 'mono8', 'cam')
            self.assert_arguments(self.check()[2], mav_image='/visual/image_raw' if beside else topic, ground_depth=None)
        self.recording(('base_link', 'cam')).camera('/oak/stereo/image_raw', '16UC1', 'cam').camera('/oak/rgb/image_raw', 'rgb8', 'cam')
        self.assert_arguments(self.check()[2], ground_depth='/oak/stereo/image_raw', ground_image='/oak/rgb/image_raw')

    def test_a_robots_number_tells_nothing(self):
        """/robot1 has the depth camera, /robot2, on a body of its own, flies; a lone /robot does not."""
        recording = self.recording(*((f'{robot}/base_link', f'{robot}/{sensor}') for robot in ('robot1', 'robot2') for sensor in ('cam', 'imu')))
        recording.camera('/robot1/color/image_raw', 'rgb8', 'robot1/cam').camera('/robot1/depth/image_raw', '16UC1', 'robot1/cam').imu('/robot1/imu', 'robot1/imu')
        recording.camera('/robot2/image_raw', 'mono8', 'robot2/cam').imu('/robot2/imu', 'robot2/imu')
        status, output, command = self.check()
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_image='/robot2/image_raw', mav_imu='/robot2/imu', ground_image='/robot1/color/image_raw', ground_imu='/robot1/imu')
        self.assertNotIn('nothing says so', output)
        recording = self.recording(('base', 'eye'), ('body', 'cam')).camera('/head/color/image_raw', 'rgb8', 'eye').camera('/head/depth/image_raw', '16UC1', 'eye')
        recording.camera('/robot/image_raw', 'mono8', 'cam')
        status, output, command = self.check()
        self.assert_arguments(command, mav_image=None)
        self.assertNotIn('the bag is of one robot', output)
        self.assertIn("no camera for the MAV's: where it is one of those below, --map TOPIC:=mav_image", output)

    def test_what_else_it_might_have_been(self):
        recording = self.recording(('base_link', 'cam')).camera('/husky/left/image_raw', 'mono8', 'cam').camera('/husky/right/image_raw', 'mono8', 'cam')
        output = self.check()[1]
        self.assertIn("guess   no depth images, without which there is no ground robot: taken for the MAV's", output)
        self.assertIn('guess   other images: /husky/right/image_raw: --map TOPIC:=mav_image takes one of them instead', output)
        self.assertNotIn('no depth images', self.check('--only', 'mav')[1])
        recording.camera('/drone/image_raw', 'mono8', 'cam')
        self.assertNotIn('no depth images', self.check()[1])

    def test_reference_poses_of_nobody(self):
        """Of two robots, where nothing says whose."""
        recording = self.recording(('base', 'eye'), ('body', 'cam')).camera('/camera/color/image_raw', 'rgb8', 'eye').camera('/camera/depth/image_raw', '16UC1', 'eye')
        recording.camera('/uav/image_raw', 'mono8', 'cam').poses('/gt')
        output, command = self.check()[1:]
        self.assert_arguments(command, mav_truth=None, ground_truth=None)
        self.assertIn('the bag has /gt of this type: set mav_truth:=', output)
        recording.poses('/vicon/uav')
        self.assert_arguments(self.check()[2], mav_truth='/vicon/uav', ground_truth=None)

    def test_the_body_of_a_motion_capture_that_is_the_mav(self):
        """Not the first by name: that with the name of its base frame, or of its topics; what stands still is none."""
        def body(recording, name, speed=1.0):
            return recording.add(f'/vicon/{name}/{name}', 50, lambda t: messages.pose_stamped(geometry.pose(translation=(speed * (t - 100), 0, 0)), t, 'vicon'))

        for frames, image, bodies, taken in ((('hex1/base', 'hex1/cam'), '/cam0/image_raw', ('box1', 'hex1', 'wand'), 'hex1'), (('base_link', 'cam'), '/hex1/image_raw', ('box1', 'hex1', 'wand'), 'hex1'),
                                             (('base_link', 'cam'), '/cam0/image_raw', ('box', 'quad'), 'quad')):
            recording = self.recording(frames).camera(image, 'mono8', frames[1])
            for name in (*bodies, 'table'):
                body(recording, name, 1.0 if name != 'table' else 0.001)
            output, command = self.check()[1:]
            self.assert_arguments(command, mav_truth=f'/vicon/{taken}/{taken}')
            others = ', '.join(f'/vicon/{name}/{name}' for name in bodies if name != taken)
            self.assertIn(f'guess   other reference poses than /vicon/{taken}/{taken}: {others}: --map TOPIC:=mav_truth takes one of them instead', output)
            self.assertNotIn('other reference poses', self.check('--map', '/vicon/table/table:=mav_truth')[1])
        recording = self.recording(('base_link', 'cam')).camera('/cam0/image_raw', 'mono8', 'cam')
        body(body(recording, 'hex', 0.0), 'wall', 0.0)  # a MAV that stands, too
        self.assert_arguments(self.check()[2], mav_truth='/vicon/hex/hex')

    def test_none_of_what_the_bag_holds(self):
        """--map none:=STANDARD, for IMUs and reference poses."""
        self.flight().poses('/vicon')
        status, output, command = self.check('--map', 'none:=mav_imu', '--map', 'mav_truth:=/none')
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, mav_imu=None, mav_truth=None, mav_use_imu='false')
        self.assertNotIn('/mav/imu/data', output)
        recording = self.recording(('ground_base_link', 'eye'), ('ground_base_link', 'imu')).camera('/ground/rgb/image_raw', 'rgb8', 'eye').camera('/ground/depth/image_raw', '16UC1', 'eye')
        recording.imu('/ground/imu/data', 'imu')
        self.assert_arguments(self.check('--map', 'none:=ground_imu')[2], ground_imu='none')
        said = io.StringIO()
        with contextlib.redirect_stderr(said), self.assertRaises(SystemExit):
            self.check('--map', 'none:=mav_image')
        self.assertIn('--only leaves out a robot', said.getvalue())

    def test_rules_of_map_as_people_write_them(self):
        """STANDARD by its launch argument, without slash, or on the left, as launch files have it; a name that is none of these is named before the bag is read."""
        self.recording(('base_link', 'cam'), ('base_link', 'imu')).camera('/eye/image_raw', 'mono8', 'cam').imu('/imu0', 'imu').imu('/imu1', 'imu').imu('bare', 'imu')
        for rule in ('/imu1:=/mav/imu/data', '/imu1:=mav_imu', 'imu1:=mav/imu/data', 'mav_imu:=/imu1', 'mav_imu:=imu1', '/mav/imu/data:=/imu1'):
            status, output, command = self.check('--map', rule)
            self.assertEqual(status, 0, f'{rule}: {output}')
            self.assert_arguments(command, mav_imu='/imu1')
        self.assert_arguments(self.check('--map', 'bare:=mav_imu')[2], mav_imu='bare')  # recorded without slash
        self.assert_arguments(self.check('--map', '/ground/imu/data:=/mav/imu/data')[2], mav_imu='/ground/imu/data')  # both are standard: as it is written
        for rule in ('/imu1:=/mav/imu', 'imu1', ':=mav_imu', 'mav_imu:='):
            said = io.StringIO()
            with contextlib.redirect_stderr(said), mock.patch.object(sys, 'argv', ['check_bag', '/no/such.bag', '--map', rule]), self.assertRaises(SystemExit) as ended:
                load('check_bag').main()
            self.assertEqual(ended.exception.code, 2, rule)
            self.assertIn(f'--map {rule}: expected TOPIC:=STANDARD', said.getvalue())
            self.assertIn('/mav/imu/data (mav_imu)', said.getvalue())

    def test_a_video_flies_through_a_city(self):
        """A consumer's drone gives images and GPS."""
        self.recording(('base_link', 'cam')).camera('/drone/image_raw', 'rgb8', 'cam')
        status, output, command = self.check('--city')
        self.assertEqual(status, 0, output)
        self.assertTrue(self.warned(output, 'mav_use_imu:=false lets the fixes tell the scale'), output)
        self.assert_arguments(command, mav_use_imu='false')

    def test_the_barometer_is_no_airspeed_sensor(self):
        """/mavros/imu/diff_pressure comes first by name, and holds some hundred Pa."""
        recording = self.recording(('base_link', 'cam'), ('base_link', 'imu')).camera('/cam0/image_raw', 'mono8', 'cam').imu('/imu0', 'imu')
        recording.add('/mavros/imu/diff_pressure', 10, pressure(120.0)).add('/mavros/imu/static_pressure', 10, pressure(95800.0))
        status, output, command = self.check('--city')
        self.assertEqual(status, 0, output)
        self.assert_arguments(command, barometer_pressure='/mavros/imu/static_pressure')
        self.assertNotIn('kPa', output)
        self.assertIn('WARNING /mavros/imu/diff_pressure: its median pressure is 120, not between 20 and 120 kPa', self.check('--city', '--map', 'barometer_pressure:=/mavros/imu/diff_pressure')[1])
        recording.add('/hpa', 10, pressure(958.0))
        self.assertIn('WARNING /hpa: its median pressure is 958, not between 20 and 120 kPa', self.check('--city', '--map', '/hpa:=/barometer')[1])

    def test_calibration_as_ros_2_defines_it(self):
        """As converters write it unless told otherwise: no node takes it, and no guess may rest on it."""
        recording = self.recording(('base_link', 'eye'))
        for folder, encoding in (('/camera/color', 'rgb8'), ('/camera/aligned_depth_to_color', '16UC1')):
            recording.camera(f'{folder}/image_raw', encoding, 'eye', info=False).add(f'{folder}/camera_info', 20, info_of_ros_2)
        status, output, command = self.check()
        self.assertEqual(status, 1, output)
        self.assert_arguments(command, ground_image='/camera/color/image_raw', ground_depth='/camera/aligned_depth_to_color/image_raw', ground_depth_registered=None)
        errors = [line for line in output.splitlines() if line.startswith('ERROR')]
        self.assertEqual(len(errors), 2, output)
        for error, topic in zip(errors, ('/camera/color/camera_info', '/camera/aligned_depth_to_color/camera_info')):
            self.assertIn(f'{topic}: no node takes it', error)
            self.assertIn('--dst-typestore ros1_noetic', error)

    def flight(self):
        return self.recording(('base_link', 'cam'), ('base_link', 'imu')).camera('/cam0/image_raw', 'mono8', 'cam').imu('/imu0', 'imu')

    def test_what_was_recorded_at_another_time_is_named(self):
        """A message that was added with the time of another clock, and a clock that jumped; 61 s are told from 59 s."""
        with mock.patch.object(messages, 'stamp', side_effect=lambda t, stamp=messages.stamp: stamp(t + 1.6e9)):
            for topic, away, named in (('/tf_static', 1e8, True), ('/tf_static', -1e8, True), ('/imu0', 1e8, True), ('/imu0', -1e8, True), ('/tf_static', 64, True), ('/tf_static', 59, False)):
                self.flight()
                with rosbag.Bag(self.path(), 'a') as bag:
                    message = messages.imu((0, 0, 0), (0, 0, 9.81), 1e-6, 1e-4, 101, 'imu') if topic == '/imu0' else messages.static_transforms([('base_link', 'lidar', np.eye(4))], 101)
                    bag.write(topic, message, messages.stamp(100 + away))
                status, output, _ = self.check()
                self.assertEqual(status, 0, output)
                self.assertEqual(self.warned(output, f'{topic} (1)'), named, output)
                facts = bag_reader.BagFacts(self.path())
                if named:
                    self.assertEqual(facts.elsewhen, {topic: 1})
                    np.testing.assert_allclose([facts.begin, facts.end], [1.6e9 + (100 if topic == '/imu0' or away > 0 else 99), 1.6e9 + 101.995], atol=1.01)
                    words = shlex.split(next(line for line in output.splitlines() if 'rosbag filter' in line).partition('rosbag filter')[2])
                    self.assertEqual(words[:2], [self.path(), 'NEW.bag'])
                    kept = [eval(words[2], {'t': time}) for *_, time in rosbag.Bag(self.path()).read_messages()]  # as rosbag filter does
                    self.assertEqual((kept.count(False), kept.count(True)), (1, sum(facts.counts.values()) - 1))

    def test_robots_that_were_recorded_years_apart(self):
        """Neither is a stray message: one of them may have had no clock."""
        recording = self.recording(('base', 'eye'), ('body', 'cam'), ('body', 'imu')).camera('/camera/color/image_raw', 'rgb8', 'eye').camera('/camera/aligned_depth_to_color/image_raw', '16UC1', 'eye')
        with mock.patch.object(messages, 'stamp', side_effect=lambda t, stamp=messages.stamp: stamp(t + 1.6e9)):
            recording.camera('/drone/image_raw', 'mono8', 'cam').imu('/drone/imu', 'imu')
        status, output, _ = self.check()
        self.assertEqual(status, 0, output)
        self.assertEqual(bag_reader.BagFacts(self.path()).elsewhen, {})
        self.assertTrue(self.warned(output, 'one after the other'), output)

    def test_what_nobody_needs_is_no_error(self):
        """Reference poses and sensors that the nodes do without: too few of them, or without stamps."""
        for topic, message, city in (('/ground_truth/mav', lambda t: messages.pose_stamped(np.eye(4), t, 'world'), False), ('/barometer', pressure(95800.0), True)):
            for count, text in ((1, f'{topic} holds 1 message(s)'), (20, f'{topic}: 20 of 20 messages have no stamp')):
                self.flight()
                with rosbag.Bag(self.path(), 'a') as bag:
                    for i in range(count):
                        bag.write(topic, message(101 if count == 1 else 0), messages.stamp(100 + 0.1 * i))
                status, output, _ = self.check(*(['--city'] if city else []))
                self.assertEqual(status, 0, output)
                self.assertTrue(self.warned(output, text), output)
        self.flight().add('/vicon/start', 0.5, lambda t: messages.pose_stamped(np.eye(4), t, 'world'))
        self.assert_arguments(self.check()[2], mav_truth=None)  # a mark of where it began
        for message, text in ((101, 'holds 1 message(s)'), (0, 'have no stamp')):
            recording = self.recording(('ground_base_link', 'eye'), ('ground_base_link', 'imu')).camera('/ground/rgb/image_raw', 'rgb8', 'eye').camera('/ground/depth/image_raw', '16UC1', 'eye')
            recording.add('/ground/imu/data', 0.5 if message else 200, lambda t, message=message: messages.imu((0, 0, 0), (0, 0, 9.81), 1e-6, 1e-4, message, 'imu'))
            status, output, command = self.check()
            self.assertEqual(status, 0, output)
            self.assertTrue(self.warned(output, text), output)
            self.assert_arguments(command, ground_imu='none')  # images would wait for it

    def test_one_calibration_for_all_images_whatever_its_name(self):
        recording = self.recording(('base_link', 'cam'), ('base_link', 'imu')).camera('/cam0/image_raw', 'mono8', 'cam', info=False).imu('/imu0', 'imu')
        recording.add('/cam0/calibration', 0.5, lambda t: messages.camera_info(CAMERA, t, 'cam'))
        status, output, _ = self.check('--map', '/cam0/calibration:=mav_camera_info')
        self.assertEqual(status, 0, output)
        self.assertIn('ok      /cam0/calibration: 1 message, taken for all images', output)

    def test_as_the_nodes_have_it(self):
        def constant(name, *path):
            with open(os.path.join(HERE, '..', '..', 'air_ground_common', *path), encoding='utf-8') as stream:
                return [float(a) / float(b or 1) for a, b in re.findall(rf'\b{name} = ([0-9.e-]+)(?: / ([0-9.]+))?[,;]', stream.read())]

        for name, value in (('kHot', pixel_range.HOT), ('kTail', pixel_range.TAIL), ('kMargin', pixel_range.MARGIN), ('kNarrow', pixel_range.NARROW), ('kEven', pixel_range.EVEN)):
            self.assertEqual(constant(name, 'src', 'ros', 'pixel_range.cpp'), [value], name)
        with open(os.path.join(HERE, '..', '..', 'ekf_tracker_node', 'src', 'sensors.cpp'), encoding='utf-8') as stream:
            least, most = (f'{value / 1e3:g}e3' for value in bag_check.PRESSURES)
            self.assertIn(f'pressure >= {least} && pressure <= {most}', stream.read())
        self.assertEqual(constant('kSteadyRate', 'visual_frontend', 'src', 'imu_attitude.cpp'), [bag_imu.SLOWEST])


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'bag_choices_test', BagChoices)
