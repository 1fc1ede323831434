#!/usr/bin/env python3
"""A rendered world through roslaunch: simulator, bag, all nodes, report.

Parameters: those of end_to_end.py, and ~accept (true: the alignment must be accepted and accurate; false: it must be refused, with a reason).
"""
import os
import sys

import numpy as np
import rospy
import rostest

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))

from end_to_end import DemonstrationTest  # noqa: E402


class EndToEnd(DemonstrationTest):
    program = 'run_demo'

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.accept = rospy.get_param('~accept')

    def transforms(self):
        alignment = {'ground_map -> mav_map'}
        edges = {'mav_map -> mav_odom', 'mav_odom -> mav_base_link', 'ground_map -> ground_odom', 'ground_odom -> ground_base_link'}
        return (edges | alignment, set()) if self.accept else (edges, alignment)

    def test_odometry(self):
        self.assertLess(self.report['vo_ate_rmse_percent_of_path'], 2.0)
        self.assertLess(self.report['slam_ate_rmse_percent_of_path'], 1.0)
        self.assertGreater(self.report['vo_coverage_percent'], 70)
        self.assertGreater(self.report['slam_coverage_percent'], 90)

    def test_alignment(self):
        self.assertEqual(self.report['alignment_accepted'], self.accept, self.report.get('alignment_verdict', ''))
        if self.accept:
            self.assertLess(self.report['refined_error_m'], 0.08)
            self.assertLess(self.report['refined_error_deg'], 3.0)
            self.assertGreater(self.report['added_area_m2'], 0.5)
            self.assertLess(self.report['aerial_surface_error_median_m'], 0.05)
            deviations = np.array(self.report['refined_sigma_m_m_m_rad_rad_rad'])
            self.assertTrue(np.all(deviations > 0) and np.all(deviations < 0.2))
        else:
            self.assertIn('no alignment accepted', self.output)
            # A node said which status it refuses with, and why.
            self.assertRegex(self.report['alignment_verdict'], r' says (AMBIGUOUS|DEGENERATE|REJECTED|SEARCHING): (?!no reason given)')
            self.assertNotIn('refined_error_m', self.report)

    def test_files(self):
        for name, columns in (('mav_trajectory.txt', 8), ('ground_trajectory.txt', 8), ('alignment.txt', 17)):
            rows = np.loadtxt(os.path.join(self.out, name), ndmin=2)
            self.assertEqual(rows.shape[1], columns, name)
            self.assertTrue(np.all(np.isfinite(rows)), name)
        self.assertGreater(os.path.getsize(os.path.join(self.out, 'report.png')), 20000)
        # Without an alignment the map holds the ground robot's points alone.
        if self.accept:
            self.assertTrue(os.path.isfile(os.path.join(self.out, 'augmented_map.ply')))
            self.assertGreater(self.report['augmented_map_aerial_points'], 1000)
        else:
            self.assertEqual(self.report.get('augmented_map_aerial_points', 0), 0)


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'end_to_end_test', EndToEnd, sys.argv)
