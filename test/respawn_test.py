#!/usr/bin/env python3
"""Every node is killed in the middle, live: roslaunch starts it again, and the chain comes back to an accepted alignment of a new map."""
import os
import signal
import sys
import time
import unittest
import xmlrpc.client

import rosgraph
import rospy
import rostest
from air_ground.msg import AlignmentEstimate

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))
from faults_test import ROBOTS  # noqa: E402
from live_bag import LiveBag  # noqa: E402

KILLED_AT = {'mav_vo': 7, 'rgbd_slam': 7, 'dense_fusion': 14, 'heightmap_mcl': 17, 'view_match': 18, 'icp_refine': 20}  # [s of the bag]


def pid_of(node):
    """Of the process behind the node's present address; None while there is none."""
    try:
        return xmlrpc.client.ServerProxy(rosgraph.Master('/respawn').lookupNode(node)).getPid('/respawn')[2]
    except (rosgraph.MasterException, OSError):
        return None


class Respawn(unittest.TestCase):
    def test_the_chain_comes_back(self):
        live = LiveBag(ROBOTS)
        live.wait_for_listeners()
        refined = []
        subscriber = rospy.Subscriber('/alignment/refined', AlignmentEstimate, refined.append, queue_size=100)
        killed = {}
        for node, moment in KILLED_AT.items():
            live.play(max(0, moment - live.position))
            if node == 'mav_vo':
                first = live.said['mav'].map_id
                self.assertNotEqual(first, 0)
            killed[node] = pid_of(node)
            self.assertIsNotNone(killed[node], node)
            os.kill(killed[node], signal.SIGKILL)
        del refined[:]
        live.play(2)

        def aligned():
            return any(e.status == AlignmentEstimate.STATUS_CONVERGED and e.map_id != first for e in refined)

        if not live.play(60, aligned):  # the bag waits for odometry and SLAM, not for those behind them
            end = time.monotonic() + 90
            while not aligned() and time.monotonic() < end:
                time.sleep(0.2)
        self.assertTrue(aligned(), f'{live.said} {[(e.status, e.map_id, e.reason) for e in refined[-3:]]}')
        for node, pid in killed.items():
            self.assertNotIn(pid_of(node), (None, pid), node)
        subscriber.unregister()


if __name__ == '__main__':
    rospy.init_node('respawn_test')
    rostest.rosrun('air_ground', 'respawn_test', Respawn, sys.argv)
