#!/usr/bin/env python3
"""A rendered street through roslaunch: simulator, database, odometry, localizer, tracker, report. Parameters: see end_to_end.py."""
import os
import sys

import numpy as np
import rostest

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))

from end_to_end import DemonstrationTest  # noqa: E402


class EndToEndCity(DemonstrationTest):
    program = 'run_city_demo'

    def transforms(self):
        return {'world -> mav_map', 'mav_map -> mav_odom', 'mav_odom -> mav_base_link'}, set()

    def test_tracker(self):
        r = self.report
        self.assertTrue(r['tracker_started'])
        self.assertLess(r['tracker_position_error_mean_m'], 1.0)
        self.assertLess(r['tracker_position_error_max_m'], 4.0)
        self.assertLess(r['tracker_yaw_error_mean_deg'], 3.0)
        self.assertLess(r['tracker_position_error_mean_m'], r['gps_position_error_mean_m'])
        # What it states must fit its errors: 4 if consistent; a short flight's errors are few and alike.
        self.assertGreater(r['tracker_nees_mean'], 0.1)
        self.assertLess(r['tracker_nees_mean'], 15.0)
        self.assertLess(r['tracker_stated_sigma_x_mean_m'], 1.0)
        self.assertGreater(r['way_length_m'] - r['tracker_start_after_m'], 15.0)

    def test_fixes(self):
        self.assertGreater(self.report['tracker_fixes_fused'], 3)
        self.assertEqual(self.report['fixes_wrong'], 0)
        self.assertEqual(self.report['tracker_wrong_fixes_fused'], 0)
        self.assertEqual(self.report['tracker_recoveries'], 0)

    def test_tracker_with_magnetometer(self):
        self.assertLess(self.report['magnetometer_position_error_mean_m'], 1.0)
        self.assertLess(self.report['magnetometer_yaw_error_mean_deg'], 3.0)

    def test_files(self):
        for name in ('vo', 'gps', 'tracker', 'tracker_with_magnetometer', 'truth'):
            rows = np.loadtxt(os.path.join(self.out, f'{name}_trajectory.txt'), ndmin=2)
            self.assertEqual(rows.shape[1], 8, name)
            self.assertTrue(np.all(np.isfinite(rows)), name)
        for name in ('trajectories.png', 'uncertainty.png'):
            self.assertGreater(os.path.getsize(os.path.join(self.out, name)), 20000)


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'end_to_end_city_test', EndToEndCity, sys.argv)
