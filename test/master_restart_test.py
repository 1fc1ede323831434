#!/usr/bin/env python3
"""roscore is killed and started again under the running nodes: they track on meanwhile, and the new one knows all that the old one knew of them."""
import os
import signal
import subprocess
import sys
import threading
import time
import unittest

import rosgraph
import rospy
import rostest
from air_ground.msg import VoIncrement
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry

sys.path.insert(0, os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'air_ground_eval', 'scripts'))
from air_ground_eval import demo  # noqa: E402

NODES = ['/mav_vo', '/rgbd_slam', '/dense_fusion', '/heightmap_mcl', '/view_match', '/icp_refine', '/ekf_tracker']
SPEED = 1.0  # along x [m/s]


def wait_for(condition, seconds=60):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.1)
    return False


class Flight(threading.Thread):
    """Straight flight: increments and poses of an odometry at 20 Hz, a fix a second."""

    def __init__(self):
        super().__init__(daemon=True)
        self.increments = rospy.Publisher('mav/vo_increment', VoIncrement, queue_size=10)
        self.poses = rospy.Publisher('mav/odometry', Odometry, queue_size=10)
        self.fixes = rospy.Publisher('streetview/pose', PoseWithCovarianceStamped, queue_size=10)
        self.heard = 0
        self.subscriber = rospy.Subscriber('tracked/odometry', Odometry, self.on_tracked, queue_size=100)

    def on_tracked(self, _):
        self.heard += 1

    def run(self):
        begin = last = rospy.Time.now()
        while True:
            time.sleep(0.05)
            now = rospy.Time.now()
            increment = VoIncrement(previous_stamp=last, metric=True, scale_variance=0.02 ** 2, map_id=1)
            pose, fix = Odometry(child_frame_id='mav_base_link'), PoseWithCovarianceStamped()
            for message in (increment, pose, fix):
                message.header.stamp = now
            pose.header.frame_id, fix.header.frame_id = 'mav_map', 'world'
            pose.pose.pose.position.x = fix.pose.pose.position.x = SPEED * (now - begin).to_sec()
            increment.relative_pose.position.x = SPEED * (now - last).to_sec()
            increment.relative_pose.orientation.w = pose.pose.pose.orientation.w = fix.pose.pose.orientation.w = 1
            increment.covariance = [1e-6 * (i % 5 == 0) for i in range(16)]
            fix.pose.covariance = [0.01 * (i % 7 == 0) for i in range(36)]
            self.increments.publish(increment)
            self.poses.publish(pose)
            if int((now - begin).to_sec()) > int((last - begin).to_sec()):
                self.fixes.publish(fix)
            last = now


class MasterRestart(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.port = demo.free_port()
        cls.environment = dict(os.environ, ROS_MASTER_URI=f'http://localhost:{cls.port}')
        os.environ['ROS_MASTER_URI'] = cls.environment['ROS_MASTER_URI']
        cls.processes = []
        cls.core = cls.begin('rosmaster', '--core', '-p', str(cls.port))
        wait_for(rosgraph.is_master_online)
        # The flight alone publishes what the tracker takes: a new master that hears of another publisher first has the tracker cut the
        # connection to a flight that does not register again.
        cls.begin('roslaunch', 'air_ground', 'air_ground.launch', 'mav_vo_increment:=mav_vo/increment', 'mav_odometry:=mav_vo/odometry')
        wait_for(lambda: '/run_id' in rosgraph.Master('/test').getParamNames())  # two at once do not agree on it
        cls.begin('roslaunch', 'air_ground', 'tracker.launch')
        rospy.init_node('flight', disable_signals=True)
        cls.flight = Flight()
        cls.flight.start()

    @classmethod
    def begin(cls, *words):
        process = subprocess.Popen(words, env=cls.environment, stdout=subprocess.DEVNULL)
        cls.processes.append(process)
        return process

    @classmethod
    def tearDownClass(cls):
        for process in reversed(cls.processes):
            process.send_signal(signal.SIGINT)
        for process in cls.processes:
            process.wait(90)  # roslaunch gives a node that does not end 17 s

    def registered(self):
        """(kind, name, node) of all that the master has of the nodes."""
        try:
            state = rosgraph.Master('/test').getSystemState()
        except (rosgraph.MasterException, OSError):
            return set()
        return {(kind, name, node) for kind, part in zip(('publisher', 'subscriber', 'service'), state) for name, nodes in part
                for node in nodes if node in NODES}

    def test_nodes_track_on_and_are_known_again(self):
        self.assertTrue(wait_for(lambda: self.flight.heard > 20), 'the tracker does not track')
        self.assertTrue(wait_for(lambda: {('service', f'{node}/reset', node) for node in NODES} <= self.registered()), self.registered())
        time.sleep(8)  # they look at what the master has of them every 5 s
        before, history = self.registered(), rosgraph.Master('/test').getParam('/ekf_tracker/history')
        self.core.kill()
        self.core.wait()
        heard = self.flight.heard
        time.sleep(5)
        self.assertTrue(wait_for(lambda: self.flight.heard > heard + 60), 'the tracker does not track on')
        self.begin('rosmaster', '--core', '-p', str(self.port))
        self.assertTrue(wait_for(lambda: self.registered() == before, 120), before ^ self.registered())
        self.assertEqual(rosgraph.Master('/test').getParam('/ekf_tracker/history'), history)
        # One who comes now hears them, and can ask them.
        for words in (['rostopic', 'echo', '-n1', '/tracked/odometry'], ['rosservice', 'call', '/ekf_tracker/reset'],
                      ['rosservice', 'call', '/mav_vo/reset']):
            self.assertEqual(subprocess.run(words, env=self.environment, stdout=subprocess.DEVNULL, timeout=120, check=False).returncode, 0, words)
        heard = self.flight.heard
        self.assertTrue(wait_for(lambda: self.flight.heard > heard + 20), 'the connections of before were cut')


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'master_restart_test', MasterRestart, sys.argv)
