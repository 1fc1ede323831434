#!/usr/bin/env python3
"""What the figures of reports and tables count: recordings whose errors are known, told to them as the nodes would."""
import os
import subprocess
import sys
import unittest
from unittest import mock

import numpy as np
import rosunit
from air_ground.msg import AlignmentEstimate, VoStatus
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [os.path.join(HERE, '..', 'scripts'), HERE]
import as_module  # noqa: E402
from air_ground_eval import evaluation, geometry, messages, report, report_table  # noqa: E402
from air_ground_eval import replay as replays  # noqa: E402

CONVERGED, AMBIGUOUS, REJECTED = evaluation.STATUS_CONVERGED, evaluation.STATUS_AMBIGUOUS, 4


def track(begin, end):
    """A camera that flies a helix; its map is the world."""
    stamps = np.arange(begin, end, 0.1)
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, :3, 3] = np.stack([np.cos(stamps), np.sin(stamps), 0.1 * (stamps - begin)], 1)
    return evaluation.Track(stamps, poses)


def estimate(stamp, error=0.0, stage=evaluation.STAGE_REFINED, status=CONVERGED, sigma=0.01, **more):
    """An alignment that puts the MAV `error` [m] beside where it is."""
    return evaluation.Estimate(stamp, geometry.pose(translation=(error, 0, 0)), status, stage, np.full(6, sigma),
                               T_mav_map_camera=geometry.pose(translation=(np.cos(stamp), np.sin(stamp), 0.1 * (stamp - 100))), arrived=stamp + 1, **more)


def alignment_of(estimates, truth_end=180.0, **more):
    """(values of report.yaml on the alignment, notes) of 80 s from 100 s on."""
    recorded = report.Recorded('', 'x.bag', 100, 180, track(100, 180), track(100, 180), estimates, mav_truth=track(100, truth_end), ground_truth=track(100, 180), **more)
    built = report.Report(recorded)
    built._alignment()
    return report.rounded(built.values), recorded.notes


def yaml_of(errors=(), coarse=(), vo_coverage=100.0, vo_since=100.0, vo_percent=0.03, converged=True):
    """A report.yaml: errors (stamp, m, deg) of the CONVERGED refinements, coarse (height maps, m, status)."""
    return {'bag_duration_s': 40, 'player_held_s': 0.0, 'vo_ate_rmse_m': 0.001, 'vo_ate_rmse_percent_of_path': vo_percent, 'vo_scale_error_percent': 0.1,
            'vo_coverage_percent': vo_coverage, 'vo_coverage_since_first_pose_percent': vo_since, 'slam_ate_rmse_m': 0.001, 'slam_ate_rmse_percent_of_path': 0.01, 'slam_coverage_percent': 100.0,
            'alignment_accepted': converged, 'alignment_accepted_after_s': 12.0,
            'refined_errors_stamp_s': [e[0] for e in errors], 'refined_errors_m': [e[1] for e in errors], 'refined_errors_deg': [e[2] for e in errors],
            'coarse_error_height_maps': [c[0] for c in coarse], 'coarse_error_m': [c[1] for c in coarse], 'coarse_error_yaw_deg': [0.0] * len(coarse),
            'coarse_error_overlap': [0.5] * len(coarse), 'coarse_error_status': [c[2] for c in coarse]}


def heard_by(module, **more):
    """A recorder of replay_report that listens to nothing."""
    with mock.patch('rospy.Subscriber'), mock.patch('rospy.get_param', side_effect=lambda name, default=None: default):
        recorder = module.Recorder(100.0)
    for name, value in more.items():
        setattr(recorder, name, value)
    return recorder


def message_of(stamp, ground_map_id=0, **more):
    message = AlignmentEstimate(stage=evaluation.STAGE_REFINED, status=CONVERGED, scale=1.0, ground_map_id=ground_map_id, **more)
    message.header.stamp, message.pose.pose.orientation.w = messages.stamp(stamp), 1.0
    return message


class ReportFigures(unittest.TestCase):
    def test_poses_of_an_ended_ground_map_are_not_compared(self):
        """In the frame of the map that was saved they would be wrong by where it began."""
        estimates = [estimate(120 + i, 3.0, ground_map_id=1) for i in range(12)] + [estimate(150, 0.02, ground_map_id=2), estimate(151, 0.01)]
        estimates.insert(3, estimate(123.5, 3.0, stage=evaluation.STAGE_COARSE, ground_map_id=1))
        values, notes = alignment_of(estimates, ground_map_id=2)
        self.assertEqual(values['refined_errors_m'], [0.02, 0.01])
        self.assertNotIn('coarse_error_m', values)
        self.assertEqual(values['refined_of_ended_ground_maps'], 12)
        self.assertIn('12 of 14 accepted poses are in a ground map that ended, and are not compared', notes)
        values, notes = alignment_of(estimates[:3], ground_map_id=2)
        self.assertTrue(values['alignment_accepted'])
        self.assertIn('in a ground map that ended alone', values['alignment_verdict'])
        self.assertNotIn('T_ground_map_mav_map_translation_m', values)
        self.assertEqual(len(alignment_of(estimates)[0]['refined_errors_m']), 14)  # of an odometry that does not tell

    def test_the_ground_map_is_the_one_that_was_saved(self):
        recorder = heard_by(as_module.load('replay_report'))
        for stamp, map_id in ((110, 1), (120, 2), (130, 2), (140, 3)):
            status = VoStatus(map_id=map_id)
            status.header.stamp = messages.stamp(stamp)
            recorder.on_status(status, 'ground')
        self.assertEqual([recorder.robots['ground'].map_at(stamp) for stamp in (109, 119.5, 130, 139)], [0, 1, 2, 2])
        with mock.patch('rospy.get_time', return_value=141.0):
            recorder.on_estimate(message_of(120, 7))
        self.assertEqual((recorder.estimates[0].ground_map_id, recorder.estimates[0].arrived), (7, 141.0))

    def test_poses_without_truth_are_counted(self):
        """And what is printed beside the error is of the pose that has it."""
        values, notes = alignment_of([estimate(150, 0.02, sigma=0.01, overlap=0.8), estimate(170, 5.0, sigma=0.7, overlap=0.1)], truth_end=160.0)
        self.assertEqual(values['refined_errors_m'], [0.02])
        self.assertEqual(values['refined_without_truth'], 1)
        self.assertIn('1 of 2 accepted poses have no truth at their time, and are not compared', notes)
        self.assertEqual((values['refined_sigma_m_m_m_rad_rad_rad'][0], values['refined_overlap']), (0.01, 0.8))
        self.assertEqual(alignment_of([estimate(150)])[1], [])

    def test_a_cloud_that_is_refined_again_counts_once(self):
        values = alignment_of([estimate(150, 0.02), estimate(150, 0.3), estimate(152, 0.02), estimate(152, 0.02, status=REJECTED)])[0]
        self.assertEqual((values['alignment_refined_converged'], values['alignment_refined_converged_clouds']), (3, 2))
        self.assertEqual(values['refined_errors_stamp_s'], [50, 50, 52])
        table = as_module.load('chain_table')
        cells = dict(zip(table.HEAD, table.row_of('x', yaml_of([(20 + i // 2, 0.01, 0.1) for i in range(26)]))))
        self.assertEqual(cells['wrong, accepted'], '0 of 26 (13 clouds)')
        some = yaml_of([(20, 0.3, 0.1), (20, 0.01, 0.1), (22, 0.01, 0.1)])
        cells = dict(zip(table.HEAD, table.row_of('x', dict(some, refined_without_truth=2, refined_of_ended_ground_maps=3))))
        self.assertEqual(cells['wrong, accepted'], '1 of 3 (1 of 2 clouds); not compared: 5')
        self.assertIn('1 of 2 clouds', '\n'.join(table.distribution([some])))
        none = '\n'.join(table.distribution([yaml_of([(20 + i // 2, 0.01, 0.1) for i in range(26)])] * 3))
        self.assertRegex(none, r'0 of 39 clouds.* below 7\.4 %')  # 1 - 0.05^(1/39)

    def test_the_bound_is_that_of_a_binomial(self):
        bound = as_module.load('chain_table').upper_bound
        self.assertAlmostEqual(bound(0, 149), 1 - 0.05 ** (1 / 149), places=6)
        self.assertAlmostEqual(bound(1, 10), 0.3942, places=4)
        self.assertEqual(bound(3, 3), 1.0)

    def test_what_covers_little_is_in_no_median(self):
        """Of odometry that was lost and began another map, 4 s are left, and 1 mm of error."""
        table = as_module.load('chain_table')
        short, late = yaml_of(vo_coverage=10.0, vo_since=12.0, vo_percent=0.001), yaml_of(vo_coverage=20.0, vo_percent=0.001)
        self.assertEqual(table.row_of('x', short)[1], '1 mm (0.00 %), covers 10 %')
        self.assertEqual(table.row_of('x', yaml_of())[1], '1 mm (0.03 %)')
        at_rest = yaml_of(vo_coverage=84.0)  # in the first seconds: no map has ended
        text = table.distribution([short, late, at_rest, yaml_of()])
        self.assertIn('| VO ATE [% of the path] | 2 of 4 | 0.03 | 0.03 | 0.03 |', text)
        self.assertIn('| SLAM ATE [% of the path] | 4 of 4 | 0.01 | 0.01 | 0.01 |', text)
        self.assertTrue(any(line.endswith(': VO of 2 of 4.') for line in text), text)
        self.assertNotIn('Left out', '\n'.join(table.distribution([yaml_of()])))

    def test_a_track_covers_from_the_first_pose_on(self):
        """Before it nothing was lost; after it the maps that ended are."""
        for first, expected in ((105.0, 100), (140.0, 100), (110.0, 100 * 40 / 70)):
            stamps = (105.0, 180.0) if first == 105.0 else (140.0, 180.0)
            built = report.Report(report.Recorded('', 'x.bag', 100, 180, track(*stamps), track(100, 180), [], first_poses={'mav': first}))
            built._odometry('vo', 'mav', built.r.mav, None)
            self.assertAlmostEqual(built.values['vo_coverage_since_first_pose_percent'], expected, delta=1)

    def test_a_track_covers_the_time_of_its_robots_images(self):
        """In a bag of two robots, one recorded after the other or for longer, all that could be tracked is all; of another clock, too."""
        for delay in (0.0, 50.0):
            images = (140.0 - delay, 156.0 - delay)
            for tracked, expected in ((images, 100), ((images[0], images[0] + 8), 50)):
                built = report.Report(report.Recorded('', 'x.bag', 100, 1000, track(*tracked), track(100, 1000), [], spans={'mav': images}, delays={'mav': delay}))
                for prefix, robot, of in (('vo', 'mav', expected), ('slam', 'ground', 100)):
                    built._odometry(prefix, robot, getattr(built.r, robot), None)
                    for key in ('coverage_percent', 'coverage_since_first_pose_percent'):
                        self.assertAlmostEqual(built.values[f'{prefix}_{key}'], of, delta=1)

    def test_seeds_that_never_became_metric_are_said(self):
        table = as_module.load('chain_table')
        answers = ['final        : 9 poses over 8 m; ATE RMSE rigid 0.00%d m\n' % k if k % 2 else 'no scale\n' for k in range(1, 6)]
        with mock.patch.object(table.subprocess, 'run', side_effect=[subprocess.CompletedProcess([], 0, text) for text in answers]), mock.patch.object(table.demo, 'find_program'):
            self.assertEqual(table.offline_error('x.bag'), (0.003, 3))
        self.assertEqual(table.offline_cell(0.003, 3), '3.0 mm (3 of 5 seeds)')
        self.assertEqual(table.offline_cell(0.003, 5), '3.0 mm')
        self.assertEqual(table.offline_cell(None, 0), 'none')

    def test_faults_tell_which_map_their_errors_are_of(self):
        table = as_module.load('fault_table')
        said = ('799 images, 180 localised (the first after 1.00 s), map 3, 20 keyframes, metric after 36.00 s, corrected as a whole 0 times; 9 ms\n'
                'as published: 80 poses over 1.9 m; ATE RMSE yaw-aligned 0.001 m (0.05 % of path), rigid 0.001 m, scale error +0.10 %\n')
        with mock.patch.object(table.subprocess, 'run', return_value=subprocess.CompletedProcess([], 0, said)), mock.patch.object(table, 'find_program'):
            row = table.cells(table.run_odometry('x.bag', False))
        self.assertEqual(row, ['180 of 799', '3', '36.0 s', '0.001 m (0.05 %)', '1.9 m', '+0.10 %', 'none', '', ''])
        self.assertEqual(len(table.cells({'error': 'no output'})), len(row))
        self.assertEqual(len(table.HEAD), 1 + len(row))

    def test_coarse_is_right_from_the_map_after_which_all_are(self):
        table = as_module.load('chain_table')
        name, wrong = table.HEAD[4], 'coarse wrong, CONVERGED'
        rows = [(1, 0.1, 'AMBIGUOUS'), (2, 0.6, 'CONVERGED'), (3, 0.1, 'CONVERGED'), (4, 0.1, 'CONVERGED')]
        for coarse, right, counted in ((rows, '3 (50 %)', '1 of 3'), (rows[:2], 'not to the end', '1 of 1'), (rows[1:2], 'never', '1 of 1'), ([], 'never', '0 of 0'), (rows[2:], '3 (50 %)', '0 of 2')):
            cells = dict(zip(table.HEAD, table.row_of('x', yaml_of(coarse=coarse))))
            self.assertEqual((cells[name], cells[wrong]), (right, counted))

    def test_the_last_coarse_error_is_the_last(self):
        """The same height maps are compared again where the ground map changes."""
        values = {'bag': 'x', 'bag_duration_s': 40, 'wall_time_s': 40, 'vo_switched_off': True, 'slam_switched_off': True, 'refined_status': 'NONE', 'alignment_accepted': False,
                  'alignment_verdict': '', 'coarse_error_height_maps': [1, 5, 5], 'coarse_error_m': [0.9, 0.8, 0.1], 'coarse_error_yaw_deg': [3, 3, 1], 'coarse_error_status': ['AMBIGUOUS'] * 3}
        self.assertRegex(report_table.table(values, []), r'coarse error after height map 5 +0\.100 m, 1\.0 deg')

    def test_a_scale_that_is_told_anew_moves_no_pose(self):
        """Of a MAV without IMU: odometry was published in the scale of its time, and estimates are in its map's own unit."""
        recorder = heard_by(as_module.load('replay_report'))
        ended = {1: [(100, 0.3, 0.0)], 2: [(120, 0.5, 0.02), (150, 0.7, -0.05)]}  # map of the MAV -> (from then on [s], metres a unit, its tilt [rad])
        T_ground_visual, truth = geometry.pose(geometry.rotation_z(1.0), (2, 1, 0)), track(100, 180)
        for map_id, scales in ended.items():
            status = VoStatus(map_id=map_id)
            status.header.stamp = messages.stamp(scales[0][0] - 5)
            recorder.on_status(status, 'mav')
            for begin, scale, tilt in scales:
                said = message_of(begin, map_id=map_id)
                said.scale = scale
                messages.fill_pose(said.pose.pose, geometry.pose(geometry.rotation_from_axes('x', [[tilt]])[0], (0, 0, tilt)))
                with mock.patch('rospy.get_time', return_value=begin + 5.0):
                    recorder.on_map_scale(said)
        visual, published = truth.poses.copy(), []
        visual[:, :3, :3] = geometry.inverse(T_ground_visual)[:3, :3] @ truth.poses[:, :3, :3]
        visual[:, :3, 3] = (truth.poses[:, :3, 3] - T_ground_visual[:3, 3]) @ T_ground_visual[:3, :3] / 0.6
        for stamp, pose in zip(truth.stamps, visual):
            _, scale, tilt = [s for scales in ended.values() for s in scales if s[0] <= stamp + 1e-6][-1]
            similarity = geometry.pose(geometry.rotation_from_axes('x', [[tilt]])[0], (0, 0, tilt))
            pose = pose.copy()
            pose[:3, 3] *= scale
            published.append(similarity @ pose)
        for stamp, map_id in ((110, 1), (130, 2), (160, 2)):
            message = message_of(stamp, map_id=map_id)
            message.scale = 0.6
            messages.fill_pose(message.pose.pose, T_ground_visual)
            with mock.patch('rospy.get_time', return_value=stamp + 5.0):
                recorder.on_estimate(message)
        estimates = recorder.metric_estimates()
        poses, known = recorder.in_last_scale(evaluation.Track(truth.stamps, np.array(published))).at(np.array([e.stamp for e in estimates]))
        self.assertTrue(all(known))
        for e, pose, true in zip(estimates, poses, truth.at(np.array([110.0, 130.0, 160.0]))[0]):
            e.T_mav_map_camera = pose
            error = evaluation.alignment_error(e, np.eye(4), truth)
            self.assertLess(error[0], 1e-3)
            self.assertLess(error[2], 1e-6)
        self.assertAlmostEqual(estimates[1].scale, 0.6 / 0.7)  # of the map that is saved

    def test_delays_go_on_after_the_end_of_the_bag(self):
        """The clock stands still then: what the nodes still worked on came at once."""
        recorder = heard_by(as_module.load('replay_report'), end=110.0)
        wall = mock.patch.object(replays.time, 'monotonic')
        with mock.patch('rospy.get_time', return_value=110.0), wall as monotonic:
            for seconds, stamp in ((50.0, 108.0), (54.0, 109.0), (70.0, 109.5)):
                monotonic.return_value = seconds
                if seconds == 70.0:
                    recorder.clouds_asked_for()
                field = DiagnosticArray(status=[DiagnosticStatus(values=[KeyValue('newest image [s]', str(stamp))])])
                field.header.stamp = messages.stamp(stamp)
                recorder.on_field(field)
                recorder.on_estimate(message_of(stamp))
                if seconds == 50.0:
                    recorder.clock_ends()
        self.assertEqual([e.arrived for e in recorder.estimates], [110.0, 114.0, 130.0])
        self.assertEqual(recorder.latencies(), ([(108.0, 2.0, 2.0), (109.0, 5.0, 5.0)], 1))


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'report_figures_test', ReportFigures)
