#!/usr/bin/env python3
"""Stands in for visual odometry and the street-level localizer: makes both out of the ground truth of a bag.

Parameters: ~odometry (false: fixes alone), ~yaw_drift [rad/m] and ~scale of the odometry, ~fix_period [s], ~fix_delay [s], ~fix_sigma [m] (its noise, and what is
stated; the yaw's is 0.02 rad a metre of it), ~wrong_every (each n-th fix is 30 m off; 0: none), ~seed.
"""
import os
import sys

import numpy as np
import rospy
from air_ground.msg import StreetviewMatch, VoIncrement, VoStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry

sys.path.insert(0, os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'scripts'))
from air_ground_eval import geometry, messages, replay  # noqa: E402

RATE = 10.0  # [Hz]


class StandIn:
    def __init__(self):
        self.random = np.random.default_rng(rospy.get_param('~seed', 1))
        self.drift, self.scale = rospy.get_param('~yaw_drift', 0.0), rospy.get_param('~scale', 1.0)
        self.sigma = rospy.get_param('~fix_sigma', 0.2)
        self.odometry_made = rospy.get_param('~odometry', True)
        self.period, self.delay = rospy.get_param('~fix_period', 1.0), rospy.get_param('~fix_delay', 0.5)
        self.wrong_every = rospy.get_param('~wrong_every', 0)
        self.last = self.last_stamp = None
        self.T_map_base = np.eye(4)
        self.waiting, self.last_fix, self.count = [], 0.0, 0
        self.increments = rospy.Publisher('mav/vo_increment', VoIncrement, queue_size=100)
        self.odometry = rospy.Publisher('mav/odometry', Odometry, queue_size=100)
        self.status = rospy.Publisher('mav/vo_status', VoStatus, queue_size=100)
        self.fixes = rospy.Publisher('streetview/pose', PoseWithCovarianceStamped, queue_size=100)
        self.matches = rospy.Publisher('streetview/match', StreetviewMatch, queue_size=100)
        rospy.Subscriber('ground_truth/mav', PoseStamped, self.on_truth, queue_size=1000)

    def on_truth(self, message):
        stamp, pose = message.header.stamp, replay.pose_from_message(message.pose)
        if self.last is None:  # gravity-aligned, heading 0 at its start
            self.T_map_base = geometry.pose(geometry.rotation_z(-np.arctan2(pose[1, 0], pose[0, 0])) @ pose[:3, :3])
        elif (stamp - self.last_stamp).to_sec() < 1 / RATE - 1e-3:
            return
        elif self.odometry_made:
            self.step(stamp, geometry.inverse(self.last) @ pose, pose[:3, :3])
        self.last, self.last_stamp = pose, stamp
        if stamp.to_sec() - self.last_fix >= self.period:
            self.last_fix = stamp.to_sec()
            self.waiting.append((stamp, pose))
        while self.waiting and stamp.to_sec() - self.waiting[0][0].to_sec() >= self.delay:
            self.fix(*self.waiting.pop(0))

    def step(self, stamp, motion, attitude):
        length = np.linalg.norm(motion[:3, 3])
        # About the vertical: roll and pitch come from gravity and do not drift.
        motion = motion @ geometry.pose(attitude.T @ geometry.rotation_z(self.drift * length) @ attitude)
        motion[:3, 3] *= self.scale
        self.T_map_base = self.T_map_base @ motion
        increment = VoIncrement(previous_stamp=self.last_stamp, metric=True, scale_variance=0.02 ** 2, map_id=1)
        increment.header.stamp, increment.header.frame_id = stamp, 'mav_map'
        messages.fill_pose(increment.relative_pose, motion)
        increment.covariance = list(np.diag([(0.02 * length + 0.002) ** 2] * 3 + [(0.05 * length + 0.002) ** 2]).ravel())
        odometry = Odometry(child_frame_id='mav_base_link')
        odometry.header.stamp, odometry.header.frame_id = stamp, 'mav_map'
        messages.fill_pose(odometry.pose.pose, self.T_map_base)
        status = VoStatus(state=VoStatus.STATE_TRACKING, processing_time=0.01)
        status.header.stamp = stamp
        self.increments.publish(increment)
        self.odometry.publish(odometry)
        self.status.publish(status)

    def fix(self, stamp, pose):
        self.count += 1
        sigma_yaw = 0.02 * self.sigma
        pose = pose @ geometry.pose(geometry.rotation_z(sigma_yaw * self.random.standard_normal()))
        pose[:3, 3] += self.sigma * self.random.standard_normal(3)
        if self.wrong_every and self.count % self.wrong_every == 0:
            pose[:3, 3] += (30, 0, 0)
        fix = PoseWithCovarianceStamped()
        fix.header.stamp, fix.header.frame_id = stamp, 'world'
        messages.fill_pose(fix.pose.pose, pose)
        fix.pose.covariance = list(np.diag([self.sigma ** 2] * 3 + [0.01 ** 2] * 2 + [sigma_yaw ** 2]).ravel())
        match = StreetviewMatch(status=StreetviewMatch.STATUS_ACCEPTED, time=self.delay)
        match.header.stamp, match.header.frame_id = stamp, 'world'
        self.matches.publish(match)
        self.fixes.publish(fix)


if __name__ == '__main__':
    rospy.init_node('stand_in_city')
    stand_in = StandIn()
    rospy.spin()
