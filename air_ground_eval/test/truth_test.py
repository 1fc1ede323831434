#!/usr/bin/env python3
"""Reference poses as those of a camera: of other bodies, other clocks, with noise; odometry and truth are made, and what is between them is known."""
import os
import re
import sys
import tempfile
import unittest
from unittest import mock

import numpy as np
import rosbag
import rosunit

sys.path.insert(0, os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'scripts'))
from air_ground_eval import bag_reader, evaluation, geometry, messages, path_length, reference_clock, reference_faults, truth  # noqa: E402

# Of EuRoC's Vicon body in the MAV's: its markers lie behind and below, and their axes are turned.
T_BASE_MARKERS = geometry.pose_from_tq((0.069, -0.028, -0.124), (0.3, -0.5, 0.6, 0.2))


def robot_run(stamps, speed, begin=10.0, end=80.0, radius=2.0):
    """(positions, quaternions) of a robot that drives a circle, at 1 m/s^2 from rest at `begin` and to rest soon after `end` [s]."""
    spent, gone = (np.clip(stamps - at, 0, speed) for at in (begin, end))  # accelerating, braking
    way = spent ** 2 / 2 + speed * np.clip(stamps - begin - speed, 0, end - begin - speed) + speed * gone - gone ** 2 / 2
    return turned_along(np.stack([3 + radius * np.sin(way / radius), 4 - radius * np.cos(way / radius), 1 + 0 * way], 1), np.stack([0 * way, 0 * way, way / radius], 1))


def turned_along(positions, angles):
    return positions, geometry.quaternion_from_matrix(geometry.rotation_from_axes('xyz', angles))


def with_noise(positions, quaternions, metres, radians, random):
    turns = geometry.rotation_from_axes('xyz', radians * random.normal(size=positions.shape))
    return positions + metres * random.normal(size=positions.shape), geometry.quaternion_from_matrix(geometry.matrix_from_quaternion(quaternions) @ turns)


class Truth(unittest.TestCase):
    def test_a_constant_mounting_changes_no_error(self):
        """Truth of another body of the MAV gives the errors of the camera's own truth: told by static transforms, or estimated from a flight that turns."""
        random, stamps = np.random.default_rng(4), np.arange(0, 40, 0.02)
        angles = np.stack([0.15 * np.sin(1.3 * stamps), 0.12 * np.cos(0.9 * stamps), 0.4 * stamps + 0.5 * np.sin(0.7 * stamps)], 1)
        base = np.tile(np.eye(4), (len(stamps), 1, 1))
        base[:, :3, :3] = geometry.rotation_from_axes('xyz', angles)
        base[:, :3, 3] = np.stack([2 * np.cos(0.3 * stamps), 3 * np.sin(0.2 * stamps), 1.5 + 0.5 * np.sin(0.5 * stamps)], 1)
        T_base_camera = geometry.pose(geometry.R_BODY_DOWN_CAMERA, (0.05, 0, -0.02))
        own = evaluation.Track(stamps, base @ T_base_camera)
        poses = geometry.inverse(geometry.pose(geometry.rotation_z(1.1), (1, 2, 3))) @ own.poses
        poses[:, :3, 3] = 1.01 * (poses[:, :3, 3] + np.cumsum(random.normal(size=(len(stamps), 3)), 0) * 4e-4)
        estimate = evaluation.Track(stamps, poses)
        expected = evaluation.trajectory_error(own, estimate)
        positions = np.tile(np.eye(4), (len(stamps), 1, 1))
        positions[:, :3, 3] = (base @ T_BASE_MARKERS)[:, :3, 3]
        naive = evaluation.trajectory_error(evaluation.Track(stamps, base @ T_BASE_MARKERS @ T_base_camera), estimate)
        self.assertGreater(naive['rmse_m'], 1.1 * expected['rmse_m'])
        for reference in (truth.Reference(stamps, base @ T_BASE_MARKERS), truth.Reference(stamps, positions, attitude=False)):
            mounting = truth.estimate_mounting(reference, estimate)
            error = evaluation.trajectory_error(truth.mounted(reference, mounting, estimate), estimate)
            for key in ('rmse_m', 'scale_error_percent', 'rmse_with_scale_m'):
                self.assertAlmostEqual(error[key], expected[key], delta=0.05 * abs(expected[key]), msg=key)
            self.assertEqual(len(mounting.free), 0)
        T_markers_camera = geometry.inverse(T_BASE_MARKERS) @ T_base_camera
        mounting = truth.estimate_mounting(truth.Reference(stamps, base @ T_BASE_MARKERS), estimate)
        self.assertLess(np.linalg.norm(mounting.T_b_c[:3, 3] - T_markers_camera[:3, 3]), 0.03)
        self.assertLess(geometry.rotation_angle(mounting.T_b_c[:3, :3].T @ T_markers_camera[:3, :3]), np.radians(0.5))
        # Turned about the vertical alone, nothing tells how high the markers are.
        base[:, :3, :3] = geometry.rotation_from_axes('xyz', angles * [0, 0, 1])
        poses = base @ T_base_camera
        mounting = truth.estimate_mounting(truth.Reference(stamps, base @ T_BASE_MARKERS), evaluation.Track(stamps, poses))
        self.assertEqual(len(mounting.free), 1)
        self.assertGreater(abs(geometry.inverse(T_BASE_MARKERS)[:3, :3].T @ mounting.free[0])[2], 0.99)

    def test_a_body_that_is_not_named_may_be_the_base(self):
        """Of a robot that turns about the vertical alone, reference poses of base_link are told from those of a marker beside it; how high a camera sits upon it is taken from the transforms."""
        stamps = np.arange(0, 40, 0.05)
        base = np.tile(np.eye(4), (len(stamps), 1, 1))
        base[:, :3, :3] = geometry.rotation_from_axes('xyz', np.stack([0 * stamps, 0 * stamps, 0.4 * stamps], 1))
        base[:, :3, 3] = np.stack([2 * np.cos(0.3 * stamps), 3 * np.sin(0.2 * stamps), 0 * stamps], 1)
        T_base_camera = geometry.pose(geometry.R_BODY_FORWARD_CAMERA, (0.17, 0.03, 0.9))
        estimate = evaluation.Track(stamps, base @ T_base_camera)
        for T_base_body, of_base in ((np.eye(4), True), (geometry.pose(np.eye(3), (0.2, 0, 0)), False), (geometry.pose(geometry.rotation_z(0.1), (0, 0, 0)), False)):
            bag = mock.Mock(reference=lambda topic, T=T_base_body: truth.Reference(stamps, base @ T), edges={})
            track, what, (note,) = truth.camera_track(bag, '/gt', 'ground', 'base_link', T_base_camera, estimate)
            self.assertEqual('moves as base_link does' in note, of_base, note)
            self.assertIn('along (0.00 0.00 1.00)', note.replace('-', ''))
            self.assertEqual(what == 'poses of base_link, by its motion', of_base)
            off = np.abs(track.poses[:, 2, 3] - 0.9).max()
            self.assertLess(off, 1e-6) if of_base else self.assertGreater(off, 0.5)
            self.assertEqual(track.heights, of_base)  # else how far the camera is above the body is not known
        # base_footprint, 0.12 m below, moves alike: nothing tells of which the poses are, and heights are not compared.
        tf = {('base_footprint', 'base_link'): geometry.pose(np.eye(3), (0, 0, 0.12)), ('base_link', 'imu'): geometry.pose(np.eye(3), (0.3, 0, 0.2))}
        bag = mock.Mock(reference=lambda topic: truth.Reference(stamps, base @ geometry.pose(np.eye(3), (0, 0, -0.12))), edges=tf,
                        static_transform=lambda a, b: {'base_footprint': tf['base_footprint', 'base_link'], 'imu': geometry.inverse(tf['base_link', 'imu'])}.get(a))
        track, what, (note,) = truth.camera_track(bag, '/gt', 'ground', 'base_link', T_base_camera, estimate)
        self.assertIn('base_footprint would do as well', note)
        self.assertNotIn('imu', note)
        self.assertFalse(track.heights)
        estimates = [evaluation.Estimate(20.0, geometry.pose(np.eye(3), (0.03, 0, 0)), 3, 1, np.zeros(6), T_mav_map_camera=estimate.poses[400])]
        for heights, error in ((True, np.hypot(0.03, 0.12)), (False, 0.03)):
            rows = evaluation.alignment_errors(estimates, np.eye(4), track, heights)
            self.assertAlmostEqual(rows[0]['position_m'], error, places=3)

    def test_a_reference_of_another_clock(self):
        """A turn of 1 rad/s and 20 ms are 1.1 degrees that no odometry made. A robot that goes straight on tells no time: its poses stay as they are stamped."""
        random, stamps = np.random.default_rng(5), np.arange(0, 40, 0.01)
        base = np.tile(np.eye(4), (len(stamps), 1, 1))
        angles = np.stack([0.1 * np.sin(1.3 * stamps), 0.1 * np.cos(0.9 * stamps), 1.2 * np.sin(0.8 * stamps)], 1)
        base[:, :3, :3] = geometry.rotation_from_axes('xyz', angles)
        base[:, :3, 3] = np.stack([2 * np.cos(0.5 * stamps), 3 * np.sin(0.4 * stamps), 1.5 + 0.5 * np.sin(0.5 * stamps)], 1)
        straight = np.tile(np.eye(4), (len(stamps), 1, 1))
        straight[:, 0, 3] = 0.5 * stamps
        T_base_camera = geometry.pose(geometry.R_BODY_DOWN_CAMERA, (0.05, 0, -0.02))
        for way, late, attitude in ((base, 0.02, True), (base, -0.02, True), (base, 0.0, True), (base, 0.02, False), (base, 0.35, True), (straight, 0.02, True)):
            camera = (way @ T_base_camera)[::5]
            camera[:, :3, 3] += np.cumsum(random.normal(size=(len(camera), 3)), 0) * 1e-4
            camera[:, :3, :3] = camera[:, :3, :3] @ geometry.rotation_from_axes('xyz', 1e-3 * random.normal(size=(len(camera), 3)))
            estimate = evaluation.Track(stamps[::5], camera)
            reference = truth.Reference(stamps + late, way if attitude else way @ T_base_camera, attitude, 'markers' if attitude else 'prism')
            bag = mock.Mock(reference=lambda topic, r=reference: r, static_transform=lambda frame, base: np.eye(4))
            track, what, notes = truth.camera_track(bag, '/gt', 'mav', 'base_link', T_base_camera, estimate)
            told = late if way is base else 0.0
            found = re.search(r', (\d+) ms (earlier|later)', what)
            self.assertEqual(found is not None, told != 0, what)
            self.assertEqual(any('another clock' in note for note in notes), told != 0)
            if found:
                self.assertAlmostEqual(int(found.group(1)) * (1 if found.group(2) == 'earlier' else -1), 1e3 * told, delta=5)
                where, known = track.at(estimate.stamps)
                self.assertLess(geometry.rotation_angle(np.swapaxes(where, 1, 2)[:, :3, :3] @ camera[:, :3, :3])[known].mean(), np.radians(0.3))

    def test_noise_of_a_reference_is_no_other_clock(self):
        """Between two noisy poses their mean is less noisy than either: poses at the images' stamps seemed to be half an interval off."""
        def noisy(poses, degrees, metres, random):
            noise = geometry.rotation_from_axes('xyz', np.radians(degrees) * random.normal(size=(len(poses), 3)))
            result = poses.copy()
            result[:, :3, :3] = poses[:, :3, :3] @ noise
            result[:, :3, 3] += metres * random.normal(size=(len(poses), 3))
            return result
        stamps = np.arange(0, 60, 1 / 30)
        way = np.tile(np.eye(4), (len(stamps), 1, 1))
        way[:, :3, :3] = geometry.rotation_from_axes('xyz', np.stack([0.1 * np.sin(1.3 * stamps), 0.1 * np.cos(0.9 * stamps), 0.3 * np.sin(0.8 * stamps)], 1))
        way[:, :3, 3] = np.stack([2 * np.cos(0.5 * stamps), 3 * np.sin(0.4 * stamps), 0.5 * np.sin(0.5 * stamps)], 1)
        for seed in range(3):
            random = np.random.default_rng(seed)
            reference, estimate = (evaluation.Track(stamps, noisy(way, *noise, random)) for noise in ((0.1, 0.002), (0.01, 5e-4)))
            for attitude in (True, False):
                self.assertEqual(reference_clock.clock_shift(reference, estimate, attitude), 0.0)
        late = evaluation.Track(stamps + 3.0, way)
        self.assertIsNone(reference_clock.clock_shift(late, estimate, True))
        for few in ([7], [7, 97], range(0, len(stamps), 9)):  # an old map, a slow camera: nothing to compare
            few = evaluation.Track(stamps[few], way[few])
            self.assertEqual(reference_clock.clock_shift(reference, few, True), 0.0)

    def test_poses_that_a_motion_capture_made_up(self):
        """A body that it lost keeps its last pose, lies at 0, or elsewhere, or is turned over; from 30 to 200 Hz, with noise and without."""
        for rate in (30, 100, 200):
            stamps, moving, end = np.arange(0, 90, 1 / rate), 40 * rate, 70 * rate
            for speed, metres in ((0.3, 0.0), (0.3, 1e-3), (2.0, 0.0), (2.0, 1e-3)):
                truth_is = with_noise(*robot_run(stamps, speed), metres, metres, np.random.default_rng(1))
                for fault, begin, count in (('held', moving, rate), ('held', moving, 5 * rate), ('held', end, len(stamps) - end), ('zero', moving, 1), ('zero', moving, rate), ('zero', 0, 3 * rate),
                                            ('zero', end, len(stamps) - end), ('off', moving, 1), ('off', moving, rate // 10), ('over', moving, rate // 10)):
                    positions, quaternions = (values.copy() for values in truth_is)
                    wrong = slice(begin, begin + count)
                    if fault == 'held':
                        positions[wrong], quaternions[wrong] = positions[begin - 1], quaternions[begin - 1]
                    elif fault == 'zero':
                        positions[wrong], quaternions[wrong] = 0, (0, 0, 0, 1)
                    elif fault == 'off':
                        positions[wrong] += (1, -2, 0.5)
                    else:
                        quaternions[wrong] = geometry.quaternion_from_matrix(geometry.matrix_from_quaternion(quaternions[wrong]) @ np.diag([1, -1, -1]))
                    believed = reference_faults.believable(stamps, positions, quaternions)
                    what = (rate, speed, metres, fault, begin, count)
                    self.assertFalse(np.any(believed[wrong]), what)
                    self.assertLessEqual(np.count_nonzero(~believed), count + 1, what)  # the pose that is repeated was right once

    def test_poses_that_a_body_can_have(self):
        """What stands exactly still, starts by fractions of a millimetre, is told rarely, twice, rounded or corrected, or moves quickly."""
        random = np.random.default_rng(2)

        def all_believed(what, *poses):
            self.assertTrue(np.all(reference_faults.believable(*poses)), what)

        for rate in (1, 5, 10, 30, 100, 200):
            stamps = np.arange(0, 90, 1 / rate)
            jitter = np.clip(0.2 * random.normal(size=len(stamps)), -0.45, 0.45) / rate
            for speed in (0.06, 0.5, 3.0):
                p, q = robot_run(stamps, speed)
                hold = np.arange(len(stamps)) // (5 * rate)
                corrected = p + 0.05 * random.normal(size=(hold[-1] + 1, 3))[hold]
                all_believed((rate, speed, 'smooth'), stamps, p, q)
                all_believed((rate, speed, 'positions alone'), stamps, p, 0 * q)
                all_believed((rate, speed, 'jitter'), stamps + jitter, p, q)
                all_believed((rate, speed, 'rounded'), stamps, np.round(p, 2), np.round(q, 3))
                all_believed((rate, speed, 'corrected'), stamps, *with_noise(corrected, q, 0.01, 1e-3, random))
                for metres in (1e-4, 1e-3, 1e-2):
                    all_believed((rate, speed, metres), stamps, *with_noise(p, q, metres, metres, random))
                for times in (2, 3, 20):
                    again = np.arange(len(stamps)) // times * times
                    all_believed((rate, speed, times), stamps, p[again], q[again])
                at_rest_mostly = robot_run(stamps, speed, 70.0, 75.0)
                all_believed((rate, speed, 'rest'), stamps, *at_rest_mostly)
                all_believed((rate, speed, 'noisy rest'), stamps, *with_noise(*at_rest_mostly, 1e-4, 1e-4, random))
                stop_and_go = np.cumsum(np.where(stamps % 10 < 4, 0, speed / rate))  # at once, as a simulated robot may
                all_believed((rate, speed, 'stops'), stamps, *turned_along(np.outer(stop_and_go, (1, 0, 0)), np.outer(stop_and_go, (0, 0, 0))))
        for rate in (30, 100, 200):  # a hand, at rest most of the time
            stamps = np.arange(0, 60, 1 / rate)
            now = np.convolve(np.sin(0.3 * stamps) > 0.7, np.ones(rate // 3) / (rate // 3), 'same')[:, None]
            hand = turned_along(now * np.stack([0.2 * np.sin(7 * stamps), 0.15 * np.sin(9 * stamps + 1), 0.1 * np.sin(13 * stamps)], 1),
                                now * np.stack([np.sin(8 * stamps), 0.8 * np.sin(6 * stamps), 1.2 * np.sin(5 * stamps)], 1))
            all_believed(('hand', rate), stamps, *hand)
            all_believed(('noisy hand', rate), stamps, *with_noise(*hand, 5e-4, 1e-3, random))
        for few in range(4):
            all_believed(few, stamps[:few], hand[0][:few], hand[1][:few])

    def test_a_bags_poses_that_are_left_out_are_said(self):
        stamps = np.arange(100, 120, 0.02)
        positions, quaternions = robot_run(stamps, 1.0, 102.0, 115.0)
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            with rosbag.Bag(path, 'w') as bag:
                for i, stamp in enumerate(stamps):
                    lost = 400 <= i < 450
                    pose = geometry.pose() if lost else geometry.pose_from_tq(positions[i], quaternions[i])
                    bag.write('/ground_truth/ground', messages.pose_stamped(pose, stamp, 'world'), messages.stamp(stamp))
            facts = bag_reader.BagFacts(path)
            reference = facts.reference('/ground_truth/ground')
            self.assertEqual((len(reference.stamps), reference.left_out), (len(stamps) - 50, 50))
            poses = geometry.pose_from_tq((0, 0, 0), (0, 0, 0, 1)) @ reference.poses
            track, _, (note,) = truth.camera_track(facts, '/ground_truth/ground', 'ground', 'base', np.eye(4), evaluation.Track(reference.stamps, poses))
            self.assertIn('/ground_truth/ground: 50 of 1000 reference poses are left out', note)
            self.assertFalse(np.any(track.at(np.array([108.5]))[1]))

    def test_positions_that_are_published_as_poses(self):
        """A receiver's, bridged with one attitude for ever: taken for attitudes, a right odometry is off by all that it turns."""
        stamps = np.arange(0, 60, 0.05)
        camera = np.tile(np.eye(4), (len(stamps), 1, 1))
        camera[:, :3, :3] = geometry.rotation_from_axes('xyz', np.stack([0.1 * np.sin(1.3 * stamps), 0.1 * np.cos(0.9 * stamps), 0.3 * stamps], 1))
        camera[:, :3, 3] = np.stack([2 * np.cos(0.3 * stamps), 3 * np.sin(0.2 * stamps), 1.5 + 0.5 * np.sin(0.5 * stamps)], 1)
        bridged = np.tile(np.eye(4), (len(stamps), 1, 1))
        bridged[:, :3, 3] = (camera @ [0.1, -0.3, 0.2, 1])[:, :3]
        straight = camera.copy()
        straight[:, :3, :3] = np.eye(3)
        for poses, estimate, positions in ((bridged, camera, True), (camera @ T_BASE_MARKERS, camera, False), (straight, straight, False)):
            bag = mock.Mock(reference=lambda topic, poses=poses: truth.Reference(stamps, poses), edges={})
            T_world_map = geometry.pose(geometry.rotation_z(0.7), (1, 2, 3))
            track, what, notes = truth.camera_track(bag, '/rtk/pose', 'mav', 'base_link', np.eye(4), evaluation.Track(stamps, geometry.inverse(T_world_map) @ estimate))
            self.assertEqual(what.startswith('positions of'), positions, what)
            self.assertEqual(any('its attitudes never turn, while those of mav do' in note for note in notes), positions, notes)
            self.assertLess(geometry.rotation_angle(np.swapaxes(track.poses, 1, 2)[:, :3, :3] @ estimate[:, :3, :3]).max(), np.radians(0.5))
            self.assertLess(np.linalg.norm((track.poses - estimate)[:, :3, 3], axis=1).max(), 0.01)

    def test_a_body_that_rests_tells_no_errors(self):
        """As one that lies beside the flight: the scale between both is nothing, and was an error of millions of percent."""
        random, stamps = np.random.default_rng(7), np.arange(0, 40, 0.02)
        estimate = evaluation.Track(stamps, np.tile(np.eye(4), (len(stamps), 1, 1)))
        estimate.poses[:, :3, :3] = geometry.rotation_from_axes('z', np.sin(0.3 * stamps)[:, None])
        estimate.poses[:, :3, 3] = np.stack([2 * np.cos(0.5 * stamps), 3 * np.sin(0.4 * stamps), 0.5 * np.sin(0.5 * stamps)], 1)
        for metres in (0.0, 1e-3, 0.03):
            for attitude in (True, False):
                rests, moves = (np.tile(geometry.pose(translation=(1, 2, 0)), (len(stamps), 1, 1)) for _ in range(2))
                moves[:] = estimate.poses
                for poses in (rests, moves):
                    poses[:, :3, 3] += metres * random.normal(size=(len(stamps), 3))
                    bag = mock.Mock(reference=lambda topic, r=truth.Reference(stamps, poses, attitude): r, edges={})
                    track, what, notes = truth.camera_track(bag, '/vicon', 'mav', 'base_link', np.eye(4), estimate)
                    self.assertEqual(track is None, poses is rests, what)
                    self.assertEqual(len(notes), 1)
                    self.assertEqual(any('which does not move while mav gives poses: no errors' in note for note in notes), poses is rests, notes)

    def test_positions_on_a_line_and_the_vertical(self):
        """A straight drive tells nothing of a turn about it; a right alignment was off by whatever noise made of that."""
        for seed in range(5):
            random, stamps = np.random.default_rng(seed), np.arange(0, 60, 0.05)
            base = np.tile(np.eye(4), (len(stamps), 1, 1))
            base[:, :3, :3] = geometry.rotation_from_axes('xyz', np.stack([0.005 * np.sin(7 * stamps), -0.05 + 0.005 * np.sin(9 * stamps), 0.4 + 0 * stamps], 1))
            base[:, :3, 3] = 0.3 * stamps[:, None] * base[:, :3, 0].mean(0)  # uphill
            camera = base @ geometry.pose(geometry.R_BODY_FORWARD_CAMERA, (0.1, 0, 0.6))
            prism = np.tile(np.eye(4), (len(stamps), 1, 1))
            prism[:, :3, 3] = camera[:, :3, 3] + 0.01 * random.normal(size=(len(stamps), 3))
            T_world_map = geometry.pose(geometry.rotation_z(random.uniform(-3, 3)), (1, 2, 3))
            T_world_map[:3, :3] = T_world_map[:3, :3] @ geometry.rotation_from_axes('xy', [[0.01, -0.01]])[0]
            estimate = evaluation.Track(stamps, geometry.inverse(T_world_map) @ camera)
            estimate.poses[:, :3, 3] += np.cumsum(random.normal(size=(len(stamps), 3)), 0) * 1e-3
            bag = mock.Mock(reference=lambda topic, r=truth.Reference(stamps, prism, False): r, edges={})
            track, _, notes = truth.camera_track(bag, '/prism', 'ground', 'base_link', np.eye(4), estimate)
            self.assertIn('so nearly on a line', notes[-1])
            tied = evaluation.tie_to_world(track, estimate)
            self.assertLess(geometry.rotation_angle(tied[:3, :3].T @ T_world_map[:3, :3]), np.radians(2.0))
        # Where the way is broad, or leads up, the map's own vertical counts for nothing.
        stamps = np.arange(0, 60, 0.05)
        for way in ((3 * np.sin(0.2 * stamps), 1.5 * np.cos(0.3 * stamps), 0 * stamps), (0 * stamps, 0 * stamps, 0.1 * stamps)):
            camera = np.tile(np.eye(4), (len(stamps), 1, 1))
            camera[:, :3, 3] = np.stack(way, 1)
            tilted = geometry.pose(geometry.rotation_from_axes('x', [[0.3]])[0])
            mounting = truth.estimate_mounting(truth.Reference(stamps, camera, False), evaluation.Track(stamps, geometry.inverse(tilted) @ camera))
            self.assertFalse(mounting.vertical)
            if way[0][-1]:
                self.assertLess(geometry.rotation_angle(mounting.T_w_m[:3, :3].T @ tilted[:3, :3]), 1e-3)

    def test_noise_is_no_way(self):
        """A sum of steps makes 647 m of 150 m. What is exact keeps its length; a body at rest goes nowhere."""
        def slow(t):
            return robot_run(t, 7.4 / 120, -10.0, 1e3, 2.5)[0]

        def flight(t):
            return np.stack([2 * np.cos(0.5 * t), 3 * np.sin(0.4 * t), 1.5 + 0.5 * np.sin(0.5 * t)], 1)

        def hand(t):
            return np.stack([0.1 * np.sin(6 * t), 0.08 * np.sin(5 * t + 1), 0.05 * np.sin(9 * t)], 1)

        def back_and_forth(t):
            return np.outer(0.1 * np.sin(6 * t), (1, 0, 0))

        random = np.random.default_rng(8)
        for way, rate, noises in ((slow, 30, (0.002, 0.005, 0.01)), (flight, 200, (0.01,)), (flight, 30, (0.002, 0.01)), (hand, 100, (0.002,))):
            fine, stamps = np.arange(0, 120, 0.001), np.arange(0, 120, 1 / rate)
            true = np.linalg.norm(np.diff(way(fine), axis=0), axis=1).sum()
            for metres in noises:
                positions = way(stamps) + metres * random.normal(size=(len(stamps), 3))
                self.assertAlmostEqual(path_length.path_length(stamps, positions), true, delta=0.03 * true, msg=(way, rate, metres))
                self.assertAlmostEqual(path_length.noise(stamps, positions), metres, delta=0.1 * metres)
                gone = path_length.distance_travelled(stamps, positions)
                self.assertTrue(len(gone) == len(stamps) and np.all(np.diff(gone) >= 0))
                self.assertAlmostEqual(gone[len(gone) // 2], np.linalg.norm(np.diff(way(fine[:60000]), axis=0), axis=1).sum(), delta=0.03 * true)
        for way in (slow, flight, hand, back_and_forth):
            for rate in (1, 5, 10, 30, 200):
                stamps = np.arange(0, 60, 1 / rate)
                for positions in (way(stamps), np.round(way(stamps), 6)):
                    self.assertAlmostEqual(path_length.path_length(stamps, positions) / np.linalg.norm(np.diff(positions, axis=0), axis=1).sum(), 1, delta=1e-3, msg=(way, rate))
        stamps = np.arange(0, 60, 0.01)
        self.assertLess(path_length.path_length(stamps, 0.01 * random.normal(size=(len(stamps), 3))), 0.1)
        for few in range(3):
            self.assertAlmostEqual(path_length.path_length(stamps[:few], slow(stamps)[:few]), 7.4 / 120 * 0.01 * max(0, few - 1), places=6)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'truth_test', Truth)
