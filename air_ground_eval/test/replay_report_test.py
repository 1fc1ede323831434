#!/usr/bin/env python3
"""Replays a small bag through replay.launch with a stand-in for the nodes whose errors are known: the report must find them."""
import os
import subprocess
import sys
import tempfile
import unittest
from unittest import mock

import genpy.dynamic
import numpy as np
import rosbag
import rospkg
import rospy
import rostest
import yaml
from air_ground.msg import AlignmentEstimate, VoStatus
from geometry_msgs.msg import Point, PointStamped, TransformStamped

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'scripts'))
from air_ground_eval import bag_reader, demo, evaluation, geometry, messages, ply, truth  # noqa: E402
from air_ground_eval import replay as replays  # noqa: E402
from air_ground_eval.recording import Camera  # noqa: E402

sys.path.insert(0, HERE)
DURATION = 6.0
SLOWLY = ('rate:=0.5',)  # for bounds on the bag's clock: the player does not wait for the stand-in


OldVoStatus = genpy.dynamic.generate_dynamic('air_ground/VoStatus', VoStatus._full_text.replace('uint32 map_revision', '#'))['air_ground/VoStatus']
# Of EuRoC's Vicon body in the MAV's: its markers lie behind and below, and their axes are turned.
T_BASE_MARKERS = geometry.pose_from_tq((0.069, -0.028, -0.124), (0.3, -0.5, 0.6, 0.2))


def other_truth(bag, mav, ground, t):
    """The MAV's poses as a Vicon tells them, of its body of markers; a prism's positions, above the ground robot's camera, as a total station does."""
    message = TransformStamped(child_frame_id='vicon/firefly_sbx/firefly_sbx')
    message.header.stamp, message.header.frame_id = messages.stamp(100 + t), 'world'
    edge = messages.static_transforms([('world', 'x', mav @ T_BASE_MARKERS)], 0).transforms[0]
    message.transform = edge.transform
    bag.write('/vicon/firefly_sbx/firefly_sbx', message, messages.stamp(100 + t))
    point = PointStamped(point=Point(*(ground @ [0.1, 0, 0.7, 1])[:3]))
    point.header.stamp = messages.stamp(100 + t)
    bag.write('/leica/position', point, messages.stamp(100 + t))


def accepted(seconds):
    """A refined alignment."""
    message = AlignmentEstimate(stage=AlignmentEstimate.STAGE_REFINED, status=AlignmentEstimate.STATUS_CONVERGED, scale=1.0)
    message.header.stamp, message.pose.pose.orientation.w = messages.stamp(seconds), 1.0
    return message


def write_bag(path, truth=True, ahead=None, vicon=False, old=False, earlier=False, stray=False):
    """A MAV that flies a helix and a ground robot that drives an arc; ground truth only, and images stamped so much `ahead` of the time of recording, as the truth is [s].
    vicon: the same truth as other_truth has it, too; old: recorded with another version of the nodes' messages; earlier: while
    the nodes ran, icp_refine accepted an alignment and mav_map lay elsewhere; stray: a message is of years later."""
    with rosbag.Bag(path, 'w') as bag:
        if stray:
            bag.write('/notes', messages.text('landed'), messages.stamp(100 + 1e8))
        edges = [('mav_base_link', 'mav_camera_optical_frame', geometry.pose(geometry.R_BODY_DOWN_CAMERA, (0.05, 0, -0.02))),
                 ('ground_base_link', 'ground_camera_optical_frame', geometry.pose(geometry.R_BODY_FORWARD_CAMERA, (0.1, 0, 0.4)))]
        for edge in edges:  # as the Python API, a filter or a merge leaves them: apart, and not latched
            bag.write('/tf_static', messages.static_transforms([edge], 99.999), messages.stamp(99.999))
        for t in np.arange(0, DURATION, 0.02):
            mav = geometry.pose(geometry.rotation_z(0.6 * t), (np.cos(t), np.sin(t), 1.5 + 0.1 * t))
            ground = geometry.pose(geometry.rotation_z(0.3 * t), (2 * np.cos(0.3 * t), 2 * np.sin(0.3 * t), 0.05 * np.sin(t)))
            for name, pose in (('mav', mav), ('ground', ground)):
                topic = f'/ground_truth/{name}' if truth else f'/hidden/{name}'
                bag.write(topic, messages.pose_stamped(pose, 100 + t + (ahead or 0.0), 'world'), messages.stamp(100 + t))
            if earlier:
                bag.write('/alignment/refined', accepted(100 + t), messages.stamp(100 + t))
                bag.write('/tf', messages.static_transforms([('ground_map', 'mav_map', geometry.pose(translation=(t, 7, 0)))], 100 + t), messages.stamp(100 + t))
            if vicon:
                other_truth(bag, mav, ground, t)
            if old:
                bag.write('/ground/slam_status', OldVoStatus(), messages.stamp(100 + t))
            if ahead is not None:
                stamp = 100 + t + ahead
                bag.write('/mav/camera/image_raw', messages.image(np.zeros((8, 8)), 'mono8', stamp, 'camera'), messages.stamp(100 + t))
                bag.write('/mav/camera/camera_info', messages.camera_info(Camera(8, 8, 8, 8, 4, 4), stamp + 3600 * (t == 1), 'camera'), messages.stamp(100 + t))
    vertices = [(-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0)]
    with open(os.path.splitext(path)[0] + '.world.ply', 'wb') as stream:
        stream.write(b'ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n'
                     b'element face 2\nproperty list uchar int vertex_indices\nend_header\n')
        stream.write(np.array(vertices, '<f4').tobytes())
        for face in ((0, 1, 2), (0, 2, 3)):
            stream.write(b'\x03' + np.array(face, '<i4').tobytes())


def roslaunch(file, *arguments):
    """Runs a launch file on a master of its own; returns its output, and a line with the status of the replay."""
    port = demo.free_port()
    with tempfile.TemporaryFile('w+') as output:
        status = demo.run_replay(['roslaunch', '-p', str(port), file, *arguments], dict(os.environ, ROS_MASTER_URI=f'http://localhost:{port}'),
                                 stdout=output, stderr=subprocess.STDOUT, timeout=160)
        output.seek(0)
        return output.read() + f'\nstatus {status}\n'


def replay(folder, stand_in, *arguments):
    """Runs replay.launch with the stand-in; returns its output."""
    launch = os.path.join(folder, 'stand_in_replay.launch')
    package = rospkg.RosPack().get_path('air_ground')
    params = ''.join(f'<param name="{k}" value="{v}"/>' for k, v in stand_in.items())
    with open(launch, 'w', encoding='utf-8') as stream:
        stream.write('<launch><arg name="truth" default="/ground_truth"/><arg name="bag"/><arg name="out"/>'
                     '<param name="replay_report/outputs/icp_refine" value="alignment/refined"/>'  # the stand-in publishes it
                     f'<node pkg="air_ground" type="stand_in_pipeline.py" name="stand_in_pipeline">{params}'
                     '<remap from="ground_truth/mav" to="$(arg truth)/mav"/><remap from="ground_truth/ground" to="$(arg truth)/ground"/></node>'
                     f'<include file="{package}/launch/replay.launch" pass_all_args="true"><arg name="wait_for" value="stand_in_pipeline"/>'
                     + ''.join(f'<arg name="{n}" value="false"/>' for n in ('mav_vo', 'rgbd_slam', 'dense_fusion', 'heightmap_mcl', 'icp_refine'))
                     + '</include></launch>')
    return roslaunch(launch, f'bag:={folder}/x.bag', f'out:={folder}/out', *arguments)


class ReplayReport(unittest.TestCase):
    def run_replay(self, stand_in, truth=True, start=0.0, arguments=(), **recording):
        folder = tempfile.TemporaryDirectory(prefix='a folder with spaces ')
        self.addCleanup(folder.cleanup)
        write_bag(os.path.join(folder.name, 'x.bag'), truth, **recording)
        static_file = os.path.join(folder.name, 'static.txt')
        output = replay(folder.name, dict(stand_in, static_file=static_file), f'start:={start}', *arguments, *([] if truth else ['truth:=/hidden']))
        out = os.path.join(folder.name, 'out')
        self.assertTrue(os.path.isfile(os.path.join(out, 'report.yaml')), output)
        # One who listens late hears all static transforms of the bag.
        with open(static_file, encoding='utf-8') as stream:
            self.assertEqual(stream.read(), 'ground_camera_optical_frame mav_camera_optical_frame')
        with open(os.path.join(out, 'report.yaml'), encoding='utf-8') as stream:
            return out, yaml.safe_load(stream), output

    def test_a_part_of_a_bag_is_counted_from_its_begin(self):
        values = self.run_replay({}, start=2.0, arguments=SLOWLY)[1]
        self.assertAlmostEqual(values['bag_duration_s'], DURATION - 2, delta=0.1)
        self.assertGreater(values['vo_coverage_percent'], 90)
        self.assertLess(values['alignment_accepted_after_s'], 1.5)  # the first pose's

    def test_accepted_is_when_the_pose_came(self):
        """The stamp is that of the data behind it."""
        values = self.run_replay({'estimate_delay': 2.0}, arguments=SLOWLY)[1]
        self.assertGreater(values['alignment_accepted_after_s'], 2.0 - 0.1)  # the clock of a replay has steps
        self.assertLess(values['alignment_accepted_after_s'], 2.0 + 1.5)

    def test_known_errors_are_found(self):
        out, values, output = self.run_replay({'refined_error': 0.05, 'refined_error_yaw': 0.02, 'vo_scale': 1.0}, arguments=SLOWLY)
        self.assertTrue(values['alignment_accepted'])
        self.assertLess(values['vo_ate_rmse_m'], 1e-3)
        self.assertLess(values['slam_ate_rmse_m'], 1e-3)
        self.assertAlmostEqual(values['refined_error_m'], 0.05, delta=2e-3)
        self.assertAlmostEqual(values['refined_error_deg'], np.degrees(0.02), delta=0.05)
        self.assertAlmostEqual(values['refined_scale_error_percent'], 5.0, delta=0.1)  # 1.05 between two maps of the same scale
        self.assertAlmostEqual(values['coarse_error_m'][0], 0.8, delta=5e-3)
        self.assertAlmostEqual(values['coarse_error_m'][3], 0.2, delta=5e-3)
        self.assertAlmostEqual(values['coarse_error_yaw_deg'][0], np.degrees(0.1), delta=0.05)
        self.assertTrue(np.allclose(values['coarse_error_overlap'], 0.8))
        self.assertGreater(values['refined_latency_median_s'], 0.7 - 0.1)  # the clock of a replay has steps
        self.assertLess(values['refined_latency_median_s'], 0.7 + 2)
        self.assertGreater(values['cloud_latency_median_s'], 0.7 - 0.1)
        self.assertLess(values['cloud_latency_median_s'], 0.7 + 2)
        for name in ('vo', 'slam'):
            self.assertGreater(values[f'{name}_latency_median_s'], -0.1)
            self.assertLess(values[f'{name}_latency_median_s'], 0.6)
        self.assertAlmostEqual(values['ground_surface_error_median_m'], 0.0, delta=2e-3)
        self.assertAlmostEqual(values['aerial_surface_error_median_m'], 0.02, delta=2e-3)
        self.assertAlmostEqual(values['added_area_m2'], 4.0, delta=0.4)
        self.assertEqual(len(ply.read_points(os.path.join(out, 'augmented_map.ply'))), values['augmented_map_points'])
        self.assertGreater(os.path.getsize(os.path.join(out, 'report.png')), 20000)
        rows = np.loadtxt(os.path.join(out, 'alignment.txt'))
        self.assertEqual(rows.shape[1], 17)
        self.assertTrue(np.allclose(rows[:, 10:16], 0.01, atol=1e-6))
        self.assertIn(1.05, rows[:, 16])
        track = evaluation.read_tum(os.path.join(out, 'mav_trajectory.txt'))
        self.assertGreater(len(track), 0.9 * DURATION / 0.02)
        self.assertIn('refined error', output)
        # The end of a good replay looks like one.
        self.assertIn(f'replay complete: results in {out}', output)
        self.assertIn('status 0', output)
        self.assertNotIn('has died', output)

    def test_scale_error_and_refusal(self):
        out, values, output = self.run_replay({'vo_scale': 1.05, 'status': 2})
        self.assertAlmostEqual(values['vo_scale_error_percent'], 5.0, delta=0.1)
        self.assertGreater(values['vo_ate_rmse_m'], 0.02)
        self.assertFalse(values['alignment_accepted'])
        self.assertNotIn('refined_error_m', values)
        self.assertIn('DEGENERATE', values['alignment_verdict'])
        self.assertIn('no alignment accepted', output)
        self.assertFalse(os.path.exists(os.path.join(out, 'augmented_map.ply')))

    def test_results_of_an_earlier_run_are_not_this_ones(self):
        _, values, output = self.run_replay({'status': 2}, earlier=True)
        self.assertFalse(values['alignment_accepted'])
        self.assertIn('topics of the bag that are not played, since nodes of this launch publish them: /alignment/refined', output)
        self.assertNotIn('ground_map -> mav_map', values['tf_publishers'])

    def test_without_ground_truth(self):
        out, values, _ = self.run_replay({}, truth=False, stray=True)
        self.assertAlmostEqual(values['bag_duration_s'], DURATION, delta=0.1)
        self.assertGreater(values['vo_coverage_percent'], 90)
        self.assertFalse(values['ground_truth_in_bag'])
        self.assertNotIn('vo_ate_rmse_m', values)
        self.assertNotIn('refined_error_m', values)
        self.assertGreater(values['vo_estimated_path_length_m'], 5.0)
        self.assertTrue(values['alignment_accepted'])
        self.assertGreater(values['augmented_map_points'], 1000)
        self.assertNotIn('map_surface_error_median_m', values)
        self.assertTrue(os.path.isfile(os.path.join(out, 'report.png')))

    def test_truth_of_other_bodies(self):
        """A Vicon's markers and a total station's prism: taken for base_link, the MAV's ATE would be 16 mm, and the ground robot's would be missing."""
        values, output = self.run_replay({}, vicon=True, arguments=('mav_truth:=/vicon/firefly_sbx/firefly_sbx', 'ground_truth:=/leica/position'))[1:]
        self.assertLess(values['vo_ate_rmse_m'], 2e-3)
        self.assertLess(values['slam_ate_rmse_m'], 2e-3)
        self.assertEqual(values['vo_truth'], 'poses of vicon/firefly_sbx/firefly_sbx, mounting estimated')
        self.assertEqual(values['slam_truth'], 'positions of a body that is not named, mounting estimated')
        self.assertIn('note: /vicon/firefly_sbx/firefly_sbx tells poses of vicon/firefly_sbx/firefly_sbx, which no static transform connects to mav_base_link', output)
        self.assertIn("its attitudes are the odometry's own", output)

    def test_a_map_without_scale(self):
        """A MAV alone without IMU: its trajectory is saved in its map's unit, which the report must not take for metres."""
        values, output = self.run_replay({'vo_scale': 0.4, 'vo_unit': 'the median depth of the first view', 'ground': 'false'})[1:]
        self.assertEqual(values['vo_unit'], 'the median depth of the first view')
        self.assertLess(values['vo_ate_rmse_scale_corrected_m'], 1e-3)
        self.assertAlmostEqual(values['vo_metres_per_unit'], 2.5, delta=0.01)
        for name in ('vo_ate_rmse_m', 'vo_scale_error_percent', 'vo_estimated_path_length_m'):
            self.assertNotIn(name, values)
        self.assertAlmostEqual(values['vo_estimated_path_length_units'] / values['vo_path_length_m'], 0.4, delta=0.01)
        self.assertRegex(output, r'MAV odometry ATE RMSE, scale unknown +0\.000 m = 0\.0')
        self.assertIn('mav: scale unknown', output)
        self.assertIn('status 0', output)

    def test_what_a_truth_is_of(self):
        """A body that static transforms connect needs no estimate; poses on our own topic are those of base_link."""
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write_bag(path, vicon=True)
            with rosbag.Bag(path, 'a') as bag:
                bag.write('/tf_static', messages.static_transforms([('mav_base_link', 'vicon/firefly_sbx/firefly_sbx', T_BASE_MARKERS)], 99.9), messages.stamp(99.9))
            facts = bag_reader.BagFacts(path)
            T_base_camera = facts.static_transform('mav_base_link', 'mav_camera_optical_frame')
            nothing = evaluation.Track(np.zeros(0), np.zeros((0, 4, 4)))
            own = truth.camera_track(facts, '/ground_truth/mav', 'mav', 'mav_base_link', T_base_camera, nothing)
            self.assertEqual(own[1:], ('poses of mav_base_link', []))
            self.assertTrue(np.array_equal(own[0].poses, facts.reference('/ground_truth/mav').poses @ T_base_camera))
            vicon = truth.camera_track(facts, '/vicon/firefly_sbx/firefly_sbx', 'mav', 'mav_base_link', T_base_camera, nothing)
            self.assertEqual(vicon[1:], ('poses of vicon/firefly_sbx/firefly_sbx', []))
            self.assertTrue(np.allclose(vicon[0].poses, own[0].poses, atol=1e-9))
            few = evaluation.Track(own[0].stamps[:5], own[0].poses[:5])
            track, _, (note,) = truth.camera_track(facts, '/leica/position', 'mav', 'mav_base_link', T_base_camera, few)
            self.assertIsNone(track)
            self.assertIn('fewer than 20 poses of mav are of its time', note)

    def test_stamps_of_another_clock(self):
        """As of a camera that counts from when it was switched on, or a computer without a network: how far the player is, nodes lag and time has gone is not for them to tell."""
        for ahead in (-90.0, 1e6):
            _, values, output = self.run_replay({}, ahead=ahead, arguments=SLOWLY)
            for tenth in (1, 5, 9):
                self.assertEqual(output.count(f'replay {10 * tenth} %'), 1, output)
            self.assertLess(abs(values['alignment_accepted_after_s']), 2)
            self.assertGreater(values['refined_latency_median_s'], 0.7 - 0.1)
            self.assertLess(values['refined_latency_median_s'], 0.7 + 2)
            self.assertGreater(values['vo_coverage_percent'], 90)

    def test_the_time_of_a_robots_images(self):
        """By their stamps, of the part that is played; of a robot without any nothing is known."""
        with tempfile.TemporaryDirectory() as folder, mock.patch.object(replays, 'rospy') as ros:
            path = os.path.join(folder, 'x.bag')
            write_bag(path, ahead=-90.0)
            with rosbag.Bag(path, 'a') as bag:
                bag.write('/hidden/mav', messages.pose_stamped(np.eye(4), 130, 'world'), messages.stamp(130))
            facts = bag_reader.BagFacts(path)
            for start in (0.0, 2.0):
                recorder = replays.Recorder(facts.begin + start, [])
                ros.resolve_name = lambda name: name
                recorder.robots = {'mav': replays.Robot('mav_vo', '/mav/camera/image_raw'), 'ground': replays.Robot('rgbd_slam', '/ground/rgb/image_raw')}
                recorder.follow(facts, '/player')
                self.assertTrue(np.allclose(recorder.robots['mav'].span, (10.0 + start, 10.0 + DURATION - 0.02), atol=0.021), recorder.robots['mav'].span)
                self.assertIsNone(recorder.robots['ground'].span)

    def test_a_robot_without_pose_and_one_switched_off(self):
        out, values, output = self.run_replay({'silent': 'too dark, says the stand-in', 'ground': 'false'}, old=True, arguments=SLOWLY)
        for say in ('ERROR', 'note'):
            self.assertRegex(output, say + r'.*: /ground/slam_status: no node takes it, since air_ground/VoStatus is defined otherwise in the bag than here')
        progress = [line for line in output.splitlines() if 'replay 50 %' in line]
        self.assertEqual(len(progress), 1, output)
        self.assertIn('mav initializing (too dark, says the stand-in), ground switched off', progress[0])
        self.assertIn('mav_vo gave no pose at all: too dark, says the stand-in', output)
        self.assertIn('status 1', output)
        self.assertNotIn('rgbd_slam gave no pose', output)
        self.assertTrue(values['slam_switched_off'])
        self.assertNotIn('slam_poses', values)
        self.assertNotIn('has died', output)

    def assert_refused(self, *lines, bag, **parameters):
        """The replay ends before anything plays, with these lines and nothing that looks like a crash."""
        with tempfile.TemporaryDirectory() as folder:
            launch = os.path.join(folder, 'x.launch')
            with open(launch, 'w', encoding='utf-8') as stream:
                stream.write('<launch><param name="use_sim_time" value="true"/><node pkg="air_ground" type="replay_report" name="replay_report" output="screen" '
                             f'required="true"><param name="bag" value="{bag}"/><param name="out" value="{folder}/out"/>'
                             + ''.join(f'<param name="{k}" value="{v}"/>' for k, v in parameters.items()) + '</node></launch>')
            output = roslaunch(launch)
            self.assertIn('status 1', output)
            for line in lines:
                self.assertIn(line, output)
            for bad in ('Traceback', 'terminate called', 'has died'):
                self.assertNotIn(bad, output)
            self.assertFalse(os.path.exists(os.path.join(folder, 'out', 'report.yaml')))

    def test_what_cannot_be_replayed_is_named(self):
        with tempfile.TemporaryDirectory(prefix='a folder with spaces ') as folder:
            self.assert_refused('missing.bag cannot be read as a bag (No such file or directory)', bag=f'{folder}/missing.bag')
            whole, half, text = (os.path.join(folder, name) for name in ('x.bag', 'half.bag', 'text.bag'))
            write_bag(whole)
            with open(whole, 'rb') as source, open(half, 'wb') as target:
                target.write(source.read(os.path.getsize(whole) // 2))
            self.assert_refused(f'rosbag reindex "{half}"', bag=half)
            with open(text, 'w', encoding='utf-8') as stream:
                stream.write('no bag\n')
            self.assert_refused('cannot be read as a bag', bag=text)
            with rosbag.Bag(whole, 'a') as bag:
                bag.write('/cam0/image_raw', messages.image(np.zeros((8, 8)), 'mono8', 101, 'camera'), messages.stamp(101))
            self.assert_refused('no message on /mav/camera/image_raw: the bag has no such topic; of type sensor_msgs/Image it has /cam0/image_raw: set mav_image:=',
                                'no message on /ground/depth/image_raw', bag=whole)

    def test_a_robots_clock_that_steps_tells_nothing_of_the_player(self):
        """Stamps 5 s behind until chrony corrects them: what is heard was never played later than it was recorded, whoever else publishes it."""
        with tempfile.TemporaryDirectory() as folder, mock.patch.object(replays, 'rospy') as ros:
            path = os.path.join(folder, 'x.bag')
            with rosbag.Bag(path, 'w') as bag:
                bag.write('/imu', messages.imu([0] * 3, [0] * 3, 1, 1, 99, 'imu'), messages.stamp(99))
                for k in range(300):
                    info = messages.camera_info(Camera(8, 8, 8, 8, 4, 4), 100 + 0.1 * k - (5 if k < 150 else 0), 'camera')
                    bag.write('/camera_info', info, messages.stamp(100 + 0.1 * k))
            facts = bag_reader.BagFacts(path)
            for start in (0.0, 8.0):
                recorder = replays.Recorder(facts.begin + start, [])
                recorder.follow(facts, '/player')
                (topic, _, hear, argument), _ = ros.Subscriber.call_args
                self.assertEqual(topic, '/camera_info')
                with rosbag.Bag(path) as bag:
                    for _, info, time_played in bag.read_messages('/camera_info', rospy.Time.from_sec(facts.begin + start)):
                        for caller in ('/player', '/publish_calibration'):
                            info._connection_header = {'callerid': caller}
                            hear(info, argument)
                        self.assertAlmostEqual(recorder.played, time_played.to_sec(), delta=1e-6)
                hear(mock.Mock(_connection_header={'callerid': '/player'}), argument)
                self.assertAlmostEqual(recorder.played, facts.end, delta=1e-6)

    def test_results_of_an_earlier_replay_stay(self):
        with tempfile.TemporaryDirectory() as folder, mock.patch.object(replays, 'rospy'):
            out = os.path.join(folder, 'out')
            for text in ('first', 'second', 'third'):
                replays.make_room(out, ('report.yaml', 'report.png', 'mav_trajectory_map*.txt'))
                self.assertEqual([name for name in os.listdir(out) if not name.startswith('earlier')], [])
                with open(os.path.join(out, f'mav_trajectory_map{len(text)}.txt'), 'w', encoding='ascii'):
                    pass
                with open(os.path.join(out, 'report.yaml'), 'w', encoding='ascii') as stream:
                    stream.write(text)
            found = {}
            for name in ('earlier-1', 'earlier-2', '.'):
                with open(os.path.join(out, name, 'report.yaml'), encoding='ascii') as stream:
                    found[name] = stream.read()
            self.assertEqual(found, {'earlier-1': 'first', 'earlier-2': 'second', '.': 'third'})
            self.assertEqual(sorted(os.listdir(os.path.join(out, 'earlier-2'))), ['mav_trajectory_map6.txt', 'report.yaml'])


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'replay_report_test', ReplayReport)
