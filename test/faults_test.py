#!/usr/bin/env python3
"""Visual odometry and SLAM, live, while what they hear is spoilt: they name what is wrong, and come back by themselves. One case follows the other."""
import os
import sys
import unittest

import rosgraph
import rospy
import rostest
from air_ground.msg import VoStatus

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))
from live_bag import LiveBag  # noqa: E402

MAV_IMAGE, GROUND_IMAGE = '/mav/camera/image_raw', '/ground/rgb/image_raw'
ROBOTS = {'mav': ((MAV_IMAGE, '/mav/camera/camera_info', '/mav/imu/data'), '/mav/vo_status'),
          'ground': ((GROUND_IMAGE, '/ground/rgb/camera_info', '/ground/depth/image_raw', '/ground/imu/data'), '/ground/slam_status')}
NODES = ('/mav_vo', '/rgbd_slam')
PATIENCE = 12.0  # in which a robot is to track again [s of the bag]


class Faults(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.live = LiveBag(ROBOTS)
        cls.live.wait_for_listeners()
        cls.addresses = cls.where()

    @staticmethod
    def where():
        return [rosgraph.Master('/faults').lookupNode(node) for node in NODES]

    def tearDown(self):
        self.assertEqual(self.where(), self.addresses, 'a node was restarted')

    def expect_tracking(self, *names, within=PATIENCE):
        self.assertTrue(self.live.play(within, lambda: self.live.tracks(*names)), self.live.said)

    def step_clock(self, robot, seconds):
        for topic in ROBOTS[robot][0]:
            faults = self.live.relays[topic].faults
            faults['jump'] = faults.get('jump', 0) + seconds

    def test_1_both_track(self):
        self.expect_tracking('mav', 'ground', within=20)

    def test_2_messages_lost_twice_and_out_of_order(self):
        maps = [said.map_id for said in self.live.said.values()]
        for robot in ROBOTS:
            self.live.spoil(robot, drop=0.1, duplicate=0.2, reorder=2)
        self.live.play(2)
        for robot in ROBOTS:
            self.live.spoil(robot)
        self.live.play(1)
        self.expect_tracking('mav', 'ground')
        self.assertEqual([said.map_id for said in self.live.said.values()], maps)

    def test_3_corrupt_messages(self):
        for robot in ROBOTS:
            self.live.spoil(robot, corrupt=0.2)
        self.live.play(1)
        for robot in ROBOTS:
            self.live.spoil(robot)
        self.live.play(1)
        self.expect_tracking('mav', 'ground')

    def test_4_one_robot_gone_for_a_minute(self):
        self.live.history['mav'].clear()
        self.live.spoil('ground', drop=1)
        self.live.play(2)
        self.live.spoil('ground')
        self.step_clock('ground', 60)
        self.live.said['ground'] = self.live.said['ground']._replace(state=None)
        self.expect_tracking('ground')
        maps = {said.map_id for said in self.live.history['mav']}
        self.assertEqual(len(maps), 1, f'the other robot noticed: {set(self.live.history["mav"])}')
        self.expect_tracking('mav', 'ground')

    def test_5_a_frozen_camera(self):
        self.live.relays[MAV_IMAGE].faults['freeze'] = True
        self.live.play(1.5)
        self.live.relays[MAV_IMAGE].faults['freeze'] = False
        self.live.said['mav'] = self.live.said['mav']._replace(state=None)
        self.expect_tracking('mav')

    def test_6_clock_stepped_forth_and_back(self):
        for step in (3600, -3630):
            before = self.live.said['mav']
            self.step_clock('mav', step)
            self.live.said['mav'] = before._replace(state=None)
            self.live.play(1)
            # A new map's scale may need more motion than there is in this time.
            self.assertTrue(self.live.play(PATIENCE, lambda: self.live.said['mav'].state in (VoStatus.STATE_SCALING, VoStatus.STATE_TRACKING)), self.live.said)
            if step < 0:
                self.assertGreater(self.live.said['mav'].map_id, before.map_id)

    def test_7_cameras_swapped(self):
        self.live.rewind(12)  # time goes back on both robots, too
        self.expect_tracking('mav', 'ground')
        self.live.swapped = {GROUND_IMAGE: MAV_IMAGE, MAV_IMAGE: GROUND_IMAGE}
        self.live.play(1.5)
        self.live.swapped = {}
        for node in ('mav_vo', 'rgbd_slam'):
            self.assertTrue(self.live.play(3, lambda n=node: self.live.counted(n, 'are two cameras swapped?')), self.live.counters.get(node))
        self.live.play(1)
        self.expect_tracking('mav', 'ground')


if __name__ == '__main__':
    rospy.init_node('faults_test')
    rostest.rosrun('air_ground', 'faults_test', Faults, sys.argv)
