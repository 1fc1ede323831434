#!/usr/bin/env python3
"""A bag that was recorded while the suite ran holds that run's results, transforms, too: a replay must not take them for its own."""
import os
import sys
import tempfile
import unittest
from unittest import mock

import numpy as np
import rosbag
import rosunit
from air_ground.msg import AlignmentEstimate
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [os.path.join(HERE, '..', 'scripts'), HERE]
import as_module  # noqa: E402
from air_ground_eval import bag_check, bag_guess, bag_player, bag_reader, evaluation, geometry, messages, own_outputs, report  # noqa: E402

INDOORS = ('mav_vo', 'rgbd_slam', 'dense_fusion', 'heightmap_mcl', 'view_match', 'icp_refine')
ESTIMATORS = (('mav_map', 'mav_odom'), ('mav_odom', 'mav_base_link'), ('ground_map', 'ground_odom'), ('ground_odom', 'ground_base_link'))
ALIGNMENT, TRACKED, OTHER = ('ground_map', 'mav_map'), ('world', 'mav_map'), ('mav_base_link', 'gimbal')


def write_bag(path, still=False):
    """Four seconds of images of both robots, with what the nodes published meanwhile; still: their transforms never change."""
    with rosbag.Bag(path, 'w') as bag:
        for t in np.arange(100, 104, 0.1):
            time = messages.stamp(t)
            for topic in ('/mav/camera/image_raw', '/ground/rgb/image_raw', '/mav/track_image'):
                bag.write(topic, messages.image(np.zeros((8, 8)), 'mono8', t, 'camera'), time)
            pose = geometry.pose(translation=(0 if still else t, 0, 0))
            bag.write('/tf', messages.static_transforms([(p, c, pose) for p, c in (*ESTIMATORS, ALIGNMENT, OTHER)], t), time)
            estimate = AlignmentEstimate(stage=evaluation.STAGE_REFINED, status=AlignmentEstimate.STATUS_CONVERGED, reason='of an earlier run', scale=1.0)
            estimate.header.stamp, estimate.pose.pose.orientation.w = time, 1.0
            for topic, message in (('/alignment/refined', estimate), ('/mav/odometry', Odometry()), ('/diagnostics', DiagnosticArray()), ('/tracked/geodetic', NavSatFix()), ('/ublox/fix', NavSatFix())):
                bag.write(topic, message, time)


def outputs(*nodes):
    return {node: [f'/{topic}' for topic in own_outputs.OUTPUTS[node]] for node in nodes}


class EarlierRun(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = os.path.join(folder.name, 'x.bag')

    def player(self, nodes, parameters=None):
        """(A player that plays nothing, the lines that it said); parameters: of the nodes, as the launch files set them."""
        said, parameters = [], parameters or {}
        with mock.patch.object(bag_player, 'rospy') as ros, mock.patch.object(bag_player, 'StaticTransforms'), mock.patch.object(bag_player.subprocess, 'Popen') as popen, \
                mock.patch('rospy.get_param', side_effect=lambda name, default=None: parameters.get(name, default)):
            ros.loginfo.side_effect = ros.logerr.side_effect = lambda text, *values: said.append(text % values)
            player = bag_player.BagPlayer(bag_reader.BagFacts(self.path), nodes=nodes)
        player.static.claimed, player.command = set(), popen.call_args[0][0]
        return player, said

    def handed_on(self, nodes, **parameters):
        """Of the recorded transforms those that come on /tf while these nodes run."""
        player, _ = self.player(outputs(*nodes), {f'{node}/{name}': value for node, given in parameters.items() for name, value in given.items()})
        edges = (*ESTIMATORS, ALIGNMENT, TRACKED, ALIGNMENT[::-1], OTHER)
        with mock.patch.object(bag_player, 'rospy'):
            player._hand_on(messages.static_transforms([(p, c, np.eye(4)) for p, c in edges], 100))
        return {(edge.header.frame_id, edge.child_frame_id) for call in player.moving.publish.call_args_list for edge in call.args[0].transforms}

    def test_transforms_of_nodes_that_run_are_left_out(self):
        write_bag(self.path)
        mav, ground = set(ESTIMATORS[:2]), set(ESTIMATORS[2:])
        self.assertEqual(self.handed_on(INDOORS), {OTHER})
        self.assertEqual(self.handed_on(INDOORS[:-1]), {ALIGNMENT, ALIGNMENT[::-1], TRACKED, OTHER})
        self.assertEqual(self.handed_on(INDOORS, icp_refine={'publish_tf': False}), {ALIGNMENT, ALIGNMENT[::-1], TRACKED, OTHER})
        self.assertEqual(self.handed_on(INDOORS, icp_refine={'inverse_tf': True}), {TRACKED, OTHER})
        self.assertEqual(self.handed_on(('rgbd_slam', 'icp_refine')), mav | {OTHER})
        self.assertEqual(self.handed_on(INDOORS, rgbd_slam={'publish_tf': False}), ground | {OTHER})
        self.assertEqual(self.handed_on(INDOORS, mav_vo={'odom_from_tf': True}), {('mav_odom', 'mav_base_link'), OTHER})
        self.assertEqual(self.handed_on(('mav_vo', 'ekf_tracker')), ground | {ALIGNMENT[::-1], OTHER})
        self.assertEqual(self.handed_on(()), mav | ground | {ALIGNMENT, ALIGNMENT[::-1], TRACKED, OTHER})

    def test_transforms_of_nodes_that_never_changed_are_no_mountings(self):
        """Turned around as edges above a base are, mav_odom -> mav_map would stand against what mav_vo says."""
        write_bag(self.path, still=True)
        facts = bag_reader.BagFacts(self.path)
        self.assertIn('mav_map', facts.constant_on_tf)
        chains = self.player(outputs(*INDOORS))[0].chains
        self.assertEqual([(e.header.frame_id, e.child_frame_id) for e in facts.static_transforms(chains=chains).transforms], [OTHER])

    def test_topics_of_nodes_that_run_are_not_played(self):
        write_bag(self.path)
        sensors = {'/mav/camera/image_raw', '/ground/rgb/image_raw', '/tracked/geodetic', '/ublox/fix', '/tf'}
        player, said = self.player(outputs(*INDOORS))
        self.assertEqual(set(player.topics), sensors)
        self.assertEqual(set(player.command[player.command.index('--topics') + 1:player.command.index('--bags')]), sensors)
        self.assertEqual([line for line in said if 'not played' in line],
                         ['topics of the bag that are not played, since nodes of this launch publish them: /alignment/refined, /diagnostics, /mav/odometry, /mav/track_image'])
        # Switched off: the recording's own is wanted.
        self.assertEqual(set(self.player(outputs(*INDOORS[1:]))[0].topics), sensors | {'/mav/odometry', '/mav/track_image'})
        player, said = self.player({})
        self.assertNotIn('--topics', player.command)
        self.assertEqual(said, [])
        # Another name by an argument, as the recording's odometry is an autopilot's.
        self.assertIn('/mav/odometry', self.player({'mav_vo': ['/vo/odometry']})[0].topics)

    def test_names_are_the_launch_files(self):
        given = {'~outputs': {'mav_vo': 'uav/odometry /vo/status', 'view_match': 'alignment/views'}}
        with mock.patch('rospy.get_param', side_effect=given.get):
            self.assertEqual(own_outputs.running(), {'mav_vo': ['/uav/odometry', '/vo/status'], 'view_match': ['/alignment/views']})

    def test_an_earlier_alignment_is_not_accepted(self):
        write_bag(self.path)
        module = as_module.load('replay_report')
        for nodes, accepted in ((INDOORS, False), (INDOORS[:-1], True)):  # without icp_refine the recorded alignment is what is asked for
            player = self.player(outputs(*nodes))[0]
            with mock.patch('rospy.Subscriber'), mock.patch('rospy.get_param', side_effect=lambda name, default=None: default), mock.patch('rospy.get_time', return_value=100.0):
                recorder = module.Recorder(100.0)
                with rosbag.Bag(self.path) as bag:
                    for topic, message, _ in bag.read_messages(player.topics):
                        if topic == '/alignment/refined':
                            recorder.on_estimate(message)
            nothing = evaluation.Track(np.zeros(0), np.zeros((0, 4, 4)))
            built = report.Report(report.Recorded('', 'x.bag', 100, 104, nothing, nothing, recorder.metric_estimates()))
            built._alignment()
            self.assertEqual(built.values['alignment_accepted'], accepted)

    def test_check_bag_says_so_once(self):
        write_bag(self.path)
        facts = bag_reader.BagFacts(self.path)
        said = [finding for finding in bag_check.check(facts) if 'earlier run' in finding.text]
        self.assertEqual([(finding.level, finding.text) for finding in said], [
            (bag_check.OK, 'the bag holds results of an earlier run of the suite, which a replay leaves out where it runs the node that publishes them: /alignment/refined, /mav/odometry, '
             '/mav/track_image, /tracked/geodetic')])

    def test_results_are_no_inputs(self):
        """The picture of tracks has the MAV's name, and the camera's topic may have none."""
        with rosbag.Bag(self.path, 'w') as bag:
            for topic in ('/cam0/image_raw', '/mav/track_image'):
                bag.write(topic, messages.image(np.zeros((8, 8)), 'mono8', 100, 'camera'), messages.stamp(100))
            for topic in ('/tracked/geodetic', '/ublox/fix'):
                bag.write(topic, NavSatFix(), messages.stamp(100))
        names = bag_guess.guess(bag_reader.BagFacts(self.path), city=True)
        self.assertEqual((names['/mav/camera/image_raw'], names['/gps/fix']), ('/cam0/image_raw', '/ublox/fix'))


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'earlier_run_test', EarlierRun)
