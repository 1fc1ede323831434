#!/usr/bin/env python3
"""Dead reckoning, errors along the way and where world lies: against made truth."""
import os
import sys
import tempfile
import unittest
from unittest import mock

import numpy as np
import rosbag
import rosunit
from scipy.spatial.transform import Rotation, Slerp
from geometry_msgs.msg import PointStamped, TransformStamped
from sensor_msgs.msg import NavSatFix

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [os.path.join(HERE, '..', 'scripts'), HERE]
import as_module  # noqa: E402
from air_ground_eval import bag_reader, city_database, city_evaluation, city_report, city_table, city_truth, evaluation, geometry, messages, track_calibration, zurich_urban  # noqa: E402
from air_ground_eval.recording import DatasetError  # noqa: E402

DURATION = 20.0


def truth_at(t):
    """2 m/s along an S, body tilted."""
    yaw = 0.4 * np.sin(0.3 * t)
    return geometry.pose(geometry.rotation_z(yaw) @ np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]]),
                         (2 * t, 3 * np.sin(0.3 * t), 5 + np.sin(0.2 * t)))


class OldRotation:
    """Rotation with the names of SciPy 1.3, of Ubuntu 20.04."""

    def __init__(self, rotation):
        self.rotation = rotation
        self.as_quat, self.as_rotvec, self.as_dcm = rotation.as_quat, rotation.as_rotvec, rotation.as_matrix

    @classmethod
    def from_dcm(cls, matrix):
        return cls(Rotation.from_matrix(matrix))

    @classmethod
    def from_quat(cls, quaternion):
        return cls(Rotation.from_quat(quaternion))

    @classmethod
    def from_rotvec(cls, vector):
        return cls(Rotation.from_rotvec(vector))

    @classmethod
    def from_euler(cls, axes, angles):
        return cls(Rotation.from_euler(axes, angles))


def old_slerp(stamps, rotations):
    slerp = Slerp(stamps, rotations.rotation)
    return lambda query: OldRotation(slerp(query))


class CityEvaluation(unittest.TestCase):
    def test_gps_is_that_of_the_tracker(self):
        """A receiver more, whose topic comes first by name, 0.01 degrees (1.1 km) further north; and the tracker's own output of another run."""
        module = as_module.load('city_report')
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            with rosbag.Bag(path, 'w') as bag:
                for t in range(100, 103):
                    for topic, north in (('/backup/fix', 0.01), ('/gps/fix', 0.0), ('/tracked/geodetic', 0.5)):
                        fix = NavSatFix(latitude=46.9 + north, longitude=7.4, altitude=500.0)
                        fix.header.stamp = messages.stamp(t)
                        bag.write(topic, fix, messages.stamp(t))
            bag = bag_reader.BagFacts(path)
            east, north = city_database.converted((7.4, 46.9, 0), 'EPSG:4326', 'EPSG:2056')[:2]
            parameters = {'origin_crs': 'EPSG:2056', 'origin': (east, north, 500.0)}
            for name, topic, distance in (('/gps/fix', '/gps/fix', 0.0), ('/backup/fix', '/backup/fix', 1112.0), ('/ublox/fix', '/backup/fix', 1112.0)):
                notes = []
                with mock.patch.object(module.rospy, 'resolve_name', return_value=name):
                    found = module.gps_topic(bag, notes)
                self.assertEqual((found, len(notes)), (topic, name != topic))
                self.assertAlmostEqual(module.read_gps(bag, found, parameters).positions[0][1], distance, delta=2.0)
            self.assertIn('GPS is that of /backup/fix, since the bag has no /ublox/fix', notes[0])
            self.assertIsNone(module.read_gps(bag, '', parameters))
        values = {'bag': 'x.bag', 'bag_duration_s': 3, 'wall_time_s': 3, 'images_tried': 0, 'fixes': 0, 'gps_topic': '/backup/fix', 'tracker_coverage_since_start_percent': 93.4}
        self.assertIn('\nGPS: /backup/fix\n', city_table.table(values, ['gps', 'tracker'], '', {}, []))

    def test_scipy_before_and_after_it_renamed_matrices(self):
        """Ground truth: turns about z."""
        angles = np.array([0.1, 0.3])
        matrices, half = np.array([geometry.rotation_z(a) for a in angles]), np.array([[0, 0, np.sin(a / 2), np.cos(a / 2)] for a in angles])
        poses = np.array([geometry.pose(m) for m in matrices])

        def check():
            np.testing.assert_allclose(geometry.quaternion_from_matrix(matrices), half, atol=1e-12)
            np.testing.assert_allclose(geometry.quaternion_from_matrix(matrices[1]), half[1], atol=1e-12)
            np.testing.assert_allclose(geometry.matrix_from_quaternion(half), matrices, atol=1e-12)
            np.testing.assert_allclose(geometry.rotation_angle(matrices), angles, atol=1e-12)
            np.testing.assert_allclose(geometry.rotation_angle(matrices[0]), angles[0], atol=1e-12)
            np.testing.assert_allclose(geometry.rotation_from_axes('Z', angles[:, None]), matrices, atol=1e-12)
            np.testing.assert_allclose(geometry.interpolate_poses([0, 1], poses, [0.5], 2)[0][0, :3, :3], geometry.rotation_z(0.2), atol=1e-12)
            np.testing.assert_allclose(track_calibration.expmap(track_calibration.logmap(matrices)), matrices, atol=1e-12)

        check()
        with mock.patch.multiple(geometry, Rotation=OldRotation, Slerp=old_slerp), mock.patch.object(track_calibration, 'Rotation', OldRotation):
            check()

    def steps(self, metric=True, factor=1.0):
        times = np.arange(0, DURATION, 0.1)
        poses = [truth_at(t) for t in times]
        result = []
        for a, b, ta, tb in zip(poses, poses[1:], times, times[1:]):
            motion = geometry.inverse(a) @ b
            motion[:3, 3] *= factor
            result.append(city_evaluation.Increment(ta, tb, motion, np.diag([1e-4] * 3 + [1e-6]), metric))
        return result, {t: p[:3, :3] for t, p in zip(times, poses)}, poses

    def test_exact_increments_return_the_truth(self):
        """Also of a tilted body and with an unknown unit: a wrong sign or a neglected tilt is metres."""
        steps, attitudes, poses = self.steps(metric=False, factor=0.25)
        start = np.append(poses[0][:3, 3], city_evaluation.yaw_of(poses[0]))
        result = city_evaluation.dead_reckoning(steps, 0.0, start, np.zeros((4, 4)), 4.0, attitudes)
        self.assertLess(np.abs(result.positions - np.array([p[:3, 3] for p in poses])).max(), 1e-9)
        self.assertLess(np.abs(result.yaws - city_evaluation.yaw_of(np.array(poses))).max(), 1e-9)

    def test_pure_odometry_ends_where_it_was_lost(self):
        """Nobody knows what the robot did meanwhile: to join both parts would put the second one where the first ended."""
        steps, _, _ = self.steps()
        self.assertEqual(city_evaluation.unbroken(steps, 0.55), (steps[5:], None))
        before, (begin, length) = city_evaluation.unbroken(steps[:20] + steps[25:], 0.55)
        self.assertEqual(before, steps[5:20])
        self.assertAlmostEqual(begin, steps[19].stamp)
        self.assertAlmostEqual(length, 0.6)

    def test_covariance_is_the_spread(self):
        steps, attitudes, poses = self.steps()
        start = np.append(poses[0][:3, 3], city_evaluation.yaw_of(poses[0]))
        stated = city_evaluation.dead_reckoning(steps, 0.0, start, np.zeros((4, 4)), 1.0, attitudes).deviations[-1]
        random = np.random.default_rng(5)
        ends = []
        for _ in range(200):
            noisy = [city_evaluation.Increment(s.previous_stamp, s.stamp, s.motion @ geometry.pose(
                geometry.rotation_z(1e-3 * random.standard_normal()), 1e-2 * random.standard_normal(3)), s.covariance) for s in steps]
            end = city_evaluation.dead_reckoning(noisy, 0.0, start, np.zeros((4, 4)), 1.0, attitudes)
            ends.append(np.append(end.positions[-1], end.yaws[-1]))
        self.assertTrue(np.allclose(np.std(ends, axis=0), stated, rtol=0.2), (np.std(ends, axis=0), stated))

    def test_noise_is_the_trackers(self):
        steps, attitudes, poses = self.steps(metric=False, factor=0.25)
        start = np.append(poses[0][:3, 3], city_evaluation.yaw_of(poses[0]))

        def stated(**values):
            return city_evaluation.dead_reckoning(steps[:1], 0.0, start, np.zeros((4, 4)), 4.0, attitudes, noise=city_evaluation.Noise(**values)).covariances[-1]

        # A step of a tenth of a second, covariance 1e-4 and 1e-6 in a unit of 4 m; floors are given for a twentieth.
        self.assertAlmostEqual(stated(covariance_factor=0.1)[2, 2], 16 * (1e-5 + 2 * 1e-6))
        self.assertAlmostEqual(stated(covariance_factor=0.1)[3, 3], 1e-7 + 2 * 1e-8)
        self.assertAlmostEqual(stated(min_translation_stddev=0.01)[2, 2], 16 * (1e-4 + 2 * 1e-4))

    def test_the_last_word_on_a_fix_counts(self):
        updates = city_evaluation.Updates()
        for stamp, result, revised in ((1, 'waiting', False), (1, 'duplicate', False), (1, 'agreed', True), (2, 'initialised', False), (2, 'refused', True)):
            updates.add(city_evaluation.Update(stamp, result), revised)
        self.assertEqual([u.result for u in updates], ['agreed', 'duplicate', 'refused'])
        updates.add(city_evaluation.Update(3, 'agreed'), True)  # what was said before was not heard
        self.assertEqual(len(updates), 3 + 1)

    def test_errors_by_hand(self):
        times = np.arange(0, 10.01, 0.1)
        way = city_evaluation.Way(times, np.array([geometry.pose(geometry.rotation_z(3.1), (5 * t, 0, 0)) for t in times]))
        self.assertAlmostEqual(way.distance[-1], 50.0)
        offset = np.array([(3, 0, 4)] * 51)
        deviations = np.tile([3.0, 1.0, 4.0, 0.1], (51, 1))
        covariances = np.tile(np.diag([9.0, 1.0, 16.0, 0.01]), (51, 1, 1))
        at = times[::2]
        estimated = city_evaluation.Estimated(at, np.column_stack([5 * at, 0 * at, 0 * at]) + offset, np.full(51, -3.1), deviations, covariances)
        v = city_evaluation.statistics(way, estimated)
        self.assertAlmostEqual(v['position_error_mean_m'], 5.0)
        self.assertAlmostEqual(v['horizontal_error_mean_m'], 3.0)
        self.assertAlmostEqual(v['stated_sigma_z_mean_m'], 4.0)
        yaw = 2 * np.pi - 6.2  # across the seam
        self.assertAlmostEqual(v['yaw_error_max_deg'], np.degrees(yaw))
        self.assertAlmostEqual(v['nees_mean'], 1 + 1 + (yaw / 0.1) ** 2)
        ends, table = city_evaluation.along_the_way(way, {'x': estimated.after(6.0)})
        self.assertEqual(list(ends), [25.0, 50.0])
        self.assertTrue(np.isnan(table['x'][0][0]))
        self.assertAlmostEqual(table['x'][0][1], 5.0)
        self.assertAlmostEqual(table['x'][1][1], np.sqrt(26))

    def test_a_reference_once_a_second_tells_errors(self):
        """As the Zurich flight's. The way is curved: in between, straight lines miss it by up to 0.13 m, and so would errors."""
        seconds, at = np.arange(0, 21.0), np.arange(0, 20.0, 1 / 15)
        for seconds, share in ((seconds, (0.05, 0.2)), (np.array([0.0, 20.0]), (0.0, 0.01))):
            way = city_evaluation.Way(seconds, np.array([truth_at(t) for t in seconds]))
            poses = np.array([truth_at(t) @ geometry.pose(None, (0.3, 0, 0.4)) for t in at])
            statistics = city_evaluation.statistics(way, city_evaluation.estimated_from_poses(at, poses, np.tile(np.eye(6), (len(at), 1, 1))))
            self.assertTrue(share[0] <= statistics['poses_compared'] / len(at) <= share[1], statistics)
            if len(seconds) > 2:
                self.assertAlmostEqual(statistics['position_error_max_m'], 0.5, delta=0.025)
                self.assertEqual(len(city_evaluation.fix_errors(way, [city_evaluation.Fix(t, truth_at(t), np.eye(6)) for t in at])), len(at))

    def test_the_report_says_how_much_its_errors_rest_on(self):
        def notes(step, shift=0.0):
            stamps = np.arange(0, 20.0, step) + shift
            with tempfile.TemporaryDirectory() as folder:
                at = np.arange(0, 20.0, 0.1)
                tracker = city_evaluation.estimated_from_poses(at, np.array([truth_at(t) for t in at]), np.tile(np.eye(6), (len(at), 1, 1)))
                recorded = city_report.Recorded(bag='x.bag', out=folder, begin=0.0, end=20.0, wall_time=20.0, tracker=tracker, updates=[],
                                                truth=evaluation.Track(stamps, np.array([truth_at(t) for t in stamps])))
                city_report.Report(recorded).build()
                return ' '.join(recorded.notes)

        self.assertEqual(notes(0.1), '')
        self.assertIn('errors are of the 20 of 200 poses of the tracker that are near one of the ground truth, which has one every 1 s', notes(1.0))
        self.assertIn('none is near a pose of the tracker in time', notes(0.1, shift=100.0))

    def test_fixes(self):
        times = np.array([0.0, 0.2])
        way = city_evaluation.Way(times, np.array([np.eye(4)] * 2))
        near, far = geometry.pose(None, (1, 0, 0)), geometry.pose(geometry.rotation_z(0.2), (0, 0, 0))
        rows = city_evaluation.fix_errors(way, [city_evaluation.Fix(0.1, near, 0.25 * np.eye(6)), city_evaluation.Fix(0.1, far, np.eye(6)),
                                                city_evaluation.Fix(5.0, near, np.eye(6))])
        self.assertEqual([row['wrong'] for row in rows], [False, True])
        self.assertAlmostEqual(rows[0]['normalised'], 4.0)

    def test_headings_between_poses_a_second_apart(self):
        """A fix that is turned by 10 degrees is wrong wherever the reference turns steadily; where it begins to turn by 30 degrees a second in between, nothing is said."""
        seconds, at = np.arange(0, 21.0), np.arange(0.5, 20.0)
        turned = [city_evaluation.Fix(t, truth_at(t) @ geometry.pose(geometry.rotation_z(np.radians(10))), np.eye(6)) for t in at]
        way = city_evaluation.Way(seconds, np.array([truth_at(t) for t in seconds]))
        rows = city_evaluation.fix_errors(way, turned)
        self.assertEqual([row['wrong'] for row in rows], [True] * len(at))
        np.testing.assert_allclose(np.degrees([row['yaw_rad'] for row in rows]), 10, atol=0.5)
        turns = np.radians(30) * np.maximum(seconds - 10, 0)
        way = city_evaluation.Way(seconds, np.array([truth_at(0) @ geometry.pose(geometry.rotation_z(yaw)) for yaw in turns]))
        np.testing.assert_array_equal(at[~way.heading_known(at)], [9.5, 10.5])
        for way in (city_evaluation.Way(seconds[:2], way.poses[:2]), city_evaluation.Way(seconds, way.poses, attitude=False)):
            self.assertFalse(way.heading_known(at).any())

    def build(self, folder, truth, **more):
        """(values, table) of a tracker that is right from 2 to 18 s."""
        at = np.arange(2, 18.0, 0.1)
        tracker = city_evaluation.estimated_from_poses(at, np.array([truth_at(t) for t in at]), np.tile(np.eye(6), (len(at), 1, 1)))
        recorded = city_report.Recorded(**{**dict(bag='x.bag', out=folder, begin=0.0, end=18.0, wall_time=20.0, tracker=tracker, updates=[], truth=truth), **more})
        report = city_report.Report(recorded)
        return report.build(), report.table()

    def test_how_many_fixes_are_compared_is_said(self):
        """The truth ends at 10 s, and has a pose a second up to 5 s; of 16 fixes two are wrong before that, and all are after it."""
        stamps = np.append(np.arange(0, 5.0), np.arange(5, 10.0, 0.1))
        truth = evaluation.Track(stamps, np.array([truth_at(t) for t in stamps]))
        shift = {3.5: geometry.pose(geometry.rotation_z(0.2)), 7.5: geometry.pose(translation=(3, 0, 0))}
        fixes = [city_evaluation.Fix(t, truth_at(t) @ shift.get(t, np.eye(4) if t < 10 else geometry.pose(translation=(9, 0, 0))), np.eye(6)) for t in np.arange(2.5, 18.0)]
        updates = [city_evaluation.Update(fix.stamp, city_report.FUSED, used=fix.stamp) for fix in fixes]
        with tempfile.TemporaryDirectory() as folder:
            values, table = self.build(folder, truth, fixes=fixes, updates=updates)
            self.assertEqual([values[key] for key in ('fixes', 'fixes_compared', 'fixes_heading_compared', 'fixes_wrong')], [16, 8, 8, 2])
            self.assertIn('; wrong: 2 of 8 compared, headings of 8', table)
            # 2 m/s along the way, and more across it: fixes after the truth's end are no updates at its end.
            self.assertAlmostEqual(values['tracker_distance_between_updates_mean_m'], 2.1, delta=0.15)
            values, table = self.build(folder, truth, fixes=fixes[8:])
            self.assertEqual((values['fixes_compared'], 'none compared' in table), (0, True))
            values, table = self.build(folder, truth, fixes=fixes, truth_attitude=False)
            self.assertEqual([values.get(key) for key in ('fixes_compared', 'fixes_heading_compared', 'fixes_wrong', 'tracker_yaw_error_mean_deg', 'tracker_nees_mean')], [8, 0, 1, None, None])
            self.assertAlmostEqual(values['tracker_position_error_max_m'], 0, delta=0.04)
            self.assertIn('wrong: 1 of 8 compared, headings of 0', table)

    def test_the_bags_clock_and_that_of_the_stamps(self):
        """Recorded 1000 s later than stamped, as by another clock: the tracker covers all the same."""
        with tempfile.TemporaryDirectory() as folder:
            values, _ = self.build(folder, None, begin=1000.0, end=1018.0, delay=1000.0)
            self.assertGreater(values['tracker_coverage_since_start_percent'], 99)

    def test_what_the_ground_truth_is_of(self):
        """By hand: markers 0.5 m ahead of base_link, turned by 90 degrees; a prism; what is no reference."""
        T_base_markers = geometry.pose(geometry.rotation_z(np.pi / 2), (0.5, 0, 0))

        def stamped(kind, t, frame='world', **more):
            message = kind(**more)
            message.header.stamp, message.header.frame_id = messages.stamp(t), frame
            return message

        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            with rosbag.Bag(path, 'w') as bag:
                bag.write('/tf_static', messages.static_transforms([('base', 'markers', T_base_markers)], 100), messages.stamp(100))
                for t in (100, 101, 102):
                    for topic, child, frame in (('/vicon', 'markers', 'world'), ('/vicon/other', 'loose', 'vicon')):
                        pose = stamped(TransformStamped, t, frame, child_frame_id=child)
                        T = truth_at(t) @ T_base_markers
                        pose.transform = messages.static_transforms([('a', 'b', T)], t).transforms[0].transform
                        bag.write(topic, pose, messages.stamp(t))
                    prism = stamped(PointStamped, t)
                    prism.point.x = 2.0 * t
                    for topic, message in (('/prism', prism), ('/gps/fix', stamped(NavSatFix, t)), ('/unstamped', stamped(PointStamped, 0))):
                        bag.write(topic, message, messages.stamp(t))
            facts = bag_reader.BagFacts(path)
            track, attitude, notes = city_truth.base_track(facts, '/vicon', 'base', 'world')
            np.testing.assert_allclose(track.poses, [truth_at(t) for t in (100, 101, 102)], atol=1e-9)
            self.assertEqual((attitude, notes), (True, []))
            track, attitude, notes = city_truth.base_track(facts, '/vicon/other', 'base', 'world')
            np.testing.assert_allclose(track.poses[0], truth_at(100) @ T_base_markers, atol=1e-9)
            self.assertRegex(' '.join(notes), "is in frame 'vicon', and is taken for one in 'world'.* where loose is, which no static transform connects with base")
            track, attitude, (note,) = city_truth.base_track(facts, '/prism', 'base', 'world')
            self.assertEqual((attitude, list(track.poses[:, 0, 3])), (False, [200.0, 202.0, 204.0]))
            self.assertIn('/prism tells positions alone', note)
            for topic, why in (('/none', 'the bag has no /none'), ('/gps/fix', 'is of type sensor_msgs/NavSatFix; a reference is of geometry_msgs/PoseStamped'),
                               ('/unstamped', 'holds fewer than two poses that have a stamp')):
                track, attitude, (note,) = city_truth.base_track(facts, topic, 'base', 'world')
                self.assertEqual((track, why in note), (None, True), note)

    def test_frame(self):
        """Against the geodetic definition: a minute of latitude is 1852 m to a percent, east is east, up is up."""
        frame = city_database.WorldFrame('EPSG:4326', (8.5, 47.4, 400.0), 47.0)
        x, y, z = frame.from_geodetic(np.array([47.4, 47.4 + 1 / 60, 47.4]), np.array([8.5, 8.5, 8.5 + 1 / 60]), np.full(3, 450.0)).T
        self.assertTrue(np.allclose((x[0], y[0], z[0]), (0, 0, 3), atol=1e-6))
        self.assertTrue(np.allclose((x[1], y[1]), (0, 1853), atol=2), (x, y))
        self.assertTrue(np.allclose((x[2], y[2]), (1855 * np.cos(np.radians(47.4)), 0), atol=5), (x, y))

    def test_parameters_of_the_tracker(self):
        city = city_database.City('EPSG:2056', np.array([2600000.0, 1200000.0, 500.0]))
        parameters = city_database.tracker_parameters(city, {'magnetic_declination': 2})
        self.assertEqual(parameters, {'origin_crs': 'EPSG:2056', 'origin': [2600000.0, 1200000.0, 500.0], 'declination': 2.0})
        self.assertEqual([line.split()[0] for line in city_database.what_is_unknown(parameters)], ['geoid_undulation'])
        without_file = city_database.what_is_unknown(city_database.tracker_parameters(city, {}))
        self.assertEqual(len(without_file), 2)
        self.assertRegex(without_file[1], '^declination .* magnetometer is not used.*magnetic_declination$')
        with self.assertRaises(city_database.CityError):
            city_database.tracker_parameters(city, {'crs': 'EPSG:2056', 'origin': [0, 0, 0]})
        with self.assertRaises(city_database.CityError):
            city_database.read_city('/nowhere.gpkg')

    def test_origin_of_another_system(self):
        """The database in Swiss LV95, the city file in UTM: one place, or an error that says the origin to build with."""
        place = city_database.converted((465666.0, 5247973.0, 469.0), 'EPSG:32632', 'EPSG:2056')
        self.assertTrue(np.allclose(place[:2], (2683400, 1248600), atol=3000), place)
        city = city_database.City('EPSG:2056', np.round(place, 3))
        facts = {'crs': 'EPSG:32632', 'origin': [465666.0, 5247973.0, 469.0], 'geoid_undulation': 47.3}
        parameters = city_database.tracker_parameters(city, facts)
        self.assertEqual(parameters['origin_crs'], 'EPSG:2056')
        self.assertEqual(parameters['origin'], [round(x, 3) for x in place])
        self.assertEqual(parameters['geoid_undulation'], 47.3)
        for by in ((1, 0, 0), (0, 0, 1)):
            with self.assertRaisesRegex(city_database.CityError, f'--origin {city_database.origin_text(place)}'):
                city_database.tracker_parameters(city_database.City('EPSG:2056', np.add(place, by)), facts)
        with self.assertRaisesRegex(city_database.CityError, 'without an origin'):
            city_database.tracker_parameters(city, {'crs': 'EPSG:32632'})

    def test_world_of_the_zurich_flight(self):
        """`crs` alone puts the default origin into that system; an origin of another one is named."""
        with tempfile.TemporaryDirectory() as folder:
            for name, line in (('GroundTruthAGM.csv', '7000000, 1, 1,'), ('GroundTruthAGL.csv', '1, 465666.7, 5247973.2, 471.5, 90, 0, 0, 465669, 5247973, 470,')):
                with open(os.path.join(folder, name), 'w', encoding='utf-8') as stream:
                    stream.write(f'header\n{line}\n')
            utm = zurich_urban.read_zurich_urban(folder, {})
            self.assertEqual((utm.city['crs'], utm.city['origin']), ('EPSG:32632', [465666.0, 5247973.0, 471.0]))
            place = city_database.converted(utm.city['origin'], 'EPSG:32632', 'EPSG:2056')
            self.assertIn(f'in EPSG:2056: --origin {city_database.origin_text(place)}', ' '.join(utm.notes))
            swiss = zurich_urban.read_zurich_urban(folder, {'crs': 'EPSG:2056'})
            self.assertEqual(swiss.city['crs'], 'EPSG:2056')
            self.assertTrue(np.allclose(swiss.city['origin'], place, atol=2), swiss.city['origin'])
            self.assertLess(np.linalg.norm(swiss.poses[0][:3, 3]), 2)
            self.assertTrue(np.allclose(swiss.poses[0][:3, :3], utm.poses[0][:3, :3], atol=1e-6))
            with self.assertRaisesRegex(DatasetError, f'EPSG:2056, where the flight begins at {place[0]:.0f}'[:-1]):
                zurich_urban.read_zurich_urban(folder, {'crs': 'EPSG:2056', 'origin': [465666, 5247973, 469]})
            with self.assertRaisesRegex(DatasetError, 'expected easting'):
                zurich_urban.read_zurich_urban(folder, {'origin': [465666]})

    def test_undulation_that_is_not_known(self):
        """-1000, as the tracker's parameter has it, is no kilometre."""
        frame = city_database.WorldFrame('EPSG:4326', (8.5, 47.4, 400.0), -1000.0)
        self.assertAlmostEqual(frame.from_geodetic(47.4, 8.5, 450.0)[2], 50.0)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'city_evaluation_test', CityEvaluation)
