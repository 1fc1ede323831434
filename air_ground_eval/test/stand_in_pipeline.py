#!/usr/bin/env python3
"""Stands in for the five nodes: turns the ground truth topics of a bag into estimates with known errors.

Parameters: ~refined_error [m, along x of ground_map], ~refined_error_yaw [rad], ~vo_scale, ~status (of the refinement), ~estimate_delay [s] (from the stamp of an alignment to when it comes), ~silent (a reason: the MAV
gives no pose and says so), ~ground (false: no ground robot), ~vo_unit (of a MAV without scale: it publishes no odometry, and says so in what it saves), ~static_file (gets the frames that a late listener finds on /tf_static).
The MAV's map starts at MAV_MAP_IN_WORLD, the ground robot's at GROUND_MAP_IN_WORLD, both as a VO or SLAM would choose them.
"""
import os
import sys
import threading

import numpy as np
import rospy
from air_ground.msg import AlignmentEstimate, VoStatus
from air_ground.srv import SaveMap, SaveMapResponse, SaveTrajectory, SaveTrajectoryResponse
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from tf2_msgs.msg import TFMessage

sys.path.insert(0, os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'scripts'))
from air_ground_eval import evaluation, geometry, messages  # noqa: E402

MAV_MAP_IN_WORLD = geometry.pose(geometry.rotation_z(2.0), (1.0, -2.0, 0.5))
GROUND_MAP_IN_WORLD = geometry.pose(geometry.rotation_z(-0.7), (-1.5, 0.8, 0.1))


class StandIn:
    def __init__(self):
        self.lock = threading.Lock()
        self.poses = {'mav': {}, 'ground': {}}
        self.scale = rospy.get_param('~vo_scale', 1.0)
        self.maps = {'mav': MAV_MAP_IN_WORLD, 'ground': GROUND_MAP_IN_WORLD}
        self.T_base_camera = {'mav': geometry.pose(geometry.R_BODY_DOWN_CAMERA, (0.05, 0, -0.02)),
                              'ground': geometry.pose(geometry.R_BODY_FORWARD_CAMERA, (0.1, 0, 0.4))}
        self.odometry = {n: rospy.Publisher(f'{n}/odometry', Odometry, queue_size=100) for n in self.maps}
        self.status = {'mav': rospy.Publisher('mav/vo_status', VoStatus, queue_size=100),
                       'ground': rospy.Publisher('ground/slam_status', VoStatus, queue_size=100)}
        self.estimates = {0: rospy.Publisher('alignment/coarse', AlignmentEstimate, queue_size=10),
                          1: rospy.Publisher('alignment/refined', AlignmentEstimate, queue_size=10)}
        self.field = rospy.Publisher('mav/distance_field', DiagnosticArray, queue_size=10)
        self.silent, self.unit = rospy.get_param('~silent', ''), rospy.get_param('~vo_unit', '')
        self.static, self.static_children = None, set()
        self.count = 0
        self.last_estimate = 0.0
        self.delay, self.waiting = rospy.get_param('~estimate_delay', 0.0), []  # stamps and poses of the MAV
        rospy.Service('mav_vo/save_trajectory', SaveTrajectory, lambda request: self.save(request, 'mav'))
        rospy.Service('rgbd_slam/save_trajectory', SaveTrajectory, lambda request: self.save(request, 'ground'))
        rospy.Service('icp_refine/save_map', SaveMap, self.save_map)
        for name in self.maps if rospy.get_param('~ground', True) else ('mav',):
            rospy.Subscriber(f'ground_truth/{name}', PoseStamped, self.on_truth, name, queue_size=1000)

    def on_static(self, message):
        self.static_children |= {edge.child_frame_id for edge in message.transforms}
        with open(rospy.get_param('~static_file'), 'w', encoding='utf-8') as stream:
            stream.write(' '.join(sorted(self.static_children)))

    def on_truth(self, message, name):
        if self.static is None:
            self.static = rospy.Subscriber('/tf_static', TFMessage, self.on_static, queue_size=10)
        if self.silent and name == 'mav':
            status = VoStatus(state=VoStatus.STATE_INITIALIZING, reason=self.silent)
            status.header.stamp = message.header.stamp
            self.status[name].publish(status)
            return
        p, q = message.pose.position, message.pose.orientation
        pose = geometry.inverse(self.maps[name]) @ geometry.pose_from_tq([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
        if name == 'mav':
            pose[:3, 3] *= self.scale
        stamp = message.header.stamp.to_sec()
        odometry = Odometry()
        odometry.header.stamp, odometry.header.frame_id = message.header.stamp, f'{name}_map'
        odometry.child_frame_id = f'{name}_base_link'
        messages.fill_pose(odometry.pose.pose, pose)
        if name != 'mav' or not self.unit:
            self.odometry[name].publish(odometry)
        status = VoStatus(state=VoStatus.STATE_TRACKING, processing_time=0.012)
        status.header.stamp = message.header.stamp
        self.status[name].publish(status)
        with self.lock:
            self.poses[name][stamp] = pose
            if name == 'mav' and not self.unit and stamp - self.last_estimate >= 1.0:
                self.last_estimate = stamp
                self.waiting.append((message.header.stamp, pose))
            while self.waiting and stamp - self.waiting[0][0].to_sec() >= self.delay:
                self.count += 1
                self.estimate(*self.waiting.pop(0))

    def estimate(self, stamp, T_mav_map_base):
        """Publishes the true alignment, displaced at the MAV's camera by the known errors; the refined one has a scale."""
        truth = geometry.inverse(GROUND_MAP_IN_WORLD) @ MAV_MAP_IN_WORLD
        camera_in_map = (T_mav_map_base @ self.T_base_camera['mav'])[:3, 3]
        camera = truth[:3, :3] @ camera_in_map + truth[:3, 3]
        for stage, error, yaw, scale in ((0, 0.8 / self.count, 0.1, 1.0), (1, rospy.get_param('~refined_error', 0.05),
                                                                           rospy.get_param('~refined_error_yaw', 0.02), 1.05)):
            turn = geometry.pose(geometry.rotation_z(yaw), camera - geometry.rotation_z(yaw) @ camera)
            shift = geometry.pose(None, (error, 0, 0))
            message = AlignmentEstimate(stage=stage, iterations=self.count, reason='stand-in', overlap=0.8, scale=scale)
            message.status = AlignmentEstimate.STATUS_CONVERGED if stage == 0 else rospy.get_param('~status', 3)
            message.header.stamp, message.header.frame_id, message.child_frame_id = stamp, 'ground_map', 'mav_map'
            alignment = shift @ turn @ truth
            alignment[:3, 3] -= (scale - 1) * alignment[:3, :3] @ camera_in_map
            messages.fill_pose(message.pose.pose, alignment)
            message.pose.covariance = list((1e-4 * np.eye(6)).ravel())
            self.estimates[stage].publish(message)
        field = DiagnosticArray(status=[DiagnosticStatus(values=[KeyValue('newest image [s]', f'{stamp.to_sec() - 0.7:.9f}')])])
        field.header.stamp = stamp
        self.field.publish(field)

    def save(self, request, name):
        with self.lock:
            items = sorted(self.poses[name].items())
        if not items:
            return SaveTrajectoryResponse(False, 'no poses', 0)
        T_base_camera = self.T_base_camera[name].copy()
        if name == 'mav' and self.unit:
            T_base_camera[:3, 3] *= self.scale
        track = evaluation.Track(np.array([s for s, _ in items]), np.array([p for _, p in items]) @ T_base_camera)
        evaluation.write_tum(request.path, track)
        if name == 'mav' and self.unit:
            with open(request.path, encoding='utf-8') as stream:
                lines = stream.read()
            with open(request.path, 'w', encoding='utf-8') as stream:
                stream.write(f'# unit: {self.unit}\n{lines}')
        return SaveTrajectoryResponse(True, 'saved', len(track))

    def save_map(self, request):
        """The floor z = 0 of the world: the ground robot saw x < 0 exactly, the MAV x >= -0.5, 2 cm too high."""
        if rospy.get_param('~status', 3) != AlignmentEstimate.STATUS_CONVERGED:
            return SaveMapResponse(False, 'no alignment', 0)
        points = []
        for x in np.arange(-2, 2, 0.02):
            for y in np.arange(-1, 1, 0.02):
                if x < 0:
                    points.append((x, y, 0.0, 0))
                if x >= -0.5:
                    points.append((x, y, 0.02, 1))
        points = np.array(points)
        T = geometry.inverse(GROUND_MAP_IN_WORLD)
        kind = np.dtype([('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('red', 'u1'), ('green', 'u1'), ('blue', 'u1'), ('source', 'u1')])
        data = np.zeros(len(points), kind)
        for i, axis in enumerate('xyz'):
            data[axis] = (points[:, :3] @ T[:3, :3].T + T[:3, 3])[:, i]
        data['source'] = points[:, 3]
        data['red'] = np.where(data['source'] == 0, 200, 128)
        data['green'] = data['blue'] = np.where(data['source'] == 0, 20, 128)
        names = {'<f4': 'float', '|u1': 'uchar'}
        header = 'ply\nformat binary_little_endian 1.0\nelement vertex %d\n' % len(data)
        header += ''.join(f'property {names[kind[n].str]} {n}\n' for n in kind.names) + 'end_header\n'
        with open(request.path, 'wb') as stream:
            stream.write(header.encode() + data.tobytes())
        return SaveMapResponse(True, 'saved', len(data))


if __name__ == '__main__':
    rospy.init_node('stand_in_pipeline')
    stand_in = StandIn()
    rospy.spin()
