#!/usr/bin/env python3
"""A rendered street through roslaunch: simulator, database, odometry, localizer, tracker, report, by run_city_demo.

Bag and database come from the cache where they were made before. Parameters: ~world, ~seed, ~simulate (options of the simulator).
"""
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import rospy
import rostest
import yaml

TIME_LIMIT = 1400  # [s], rendering, building and replay


class EndToEndCity(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node('end_to_end_city_test', anonymous=True, disable_signals=True)
        cls.folder = tempfile.TemporaryDirectory()
        cls.out = os.path.join(cls.folder.name, 'out')
        command = ['rosrun', 'air_ground', 'run_city_demo', cls.out, '--no-rviz', '--world', str(rospy.get_param('~world')),
                   '--seed', str(rospy.get_param('~seed')), '--simulate', '--quiet ' + str(rospy.get_param('~simulate', ''))]
        result = subprocess.run(command, text=True, timeout=TIME_LIMIT, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        cls.output = result.stdout
        path = os.path.join(cls.out, 'report.yaml')
        assert os.path.isfile(path), 'no report was written:\n' + '\n'.join(cls.output.splitlines()[-80:])
        with open(path, encoding='utf-8') as stream:
            cls.report = yaml.safe_load(stream)
        print('\n'.join(line for line in cls.output.splitlines() if 'parameter /' not in line)[-8000:])

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def test_tracker(self):
        r = self.report
        self.assertTrue(r['tracker_started'])
        self.assertTrue(r['tracker_position_error_mean_m'] < 1.0 or r['tracker_error_over_vo_error'] < 1 / 3, r['tracker_position_error_mean_m'])
        self.assertLess(r['tracker_position_error_max_m'], 4.0)
        self.assertLess(r['tracker_yaw_error_mean_deg'], 3.0)
        self.assertLess(r['tracker_position_error_mean_m'], r['gps_position_error_mean_m'])
        self.assertGreater(r['way_length_m'] - r['tracker_start_after_m'], 15.0)

    def test_fixes(self):
        self.assertGreater(self.report['tracker_fixes_fused'], 3)
        self.assertEqual(self.report['fixes_wrong'], 0)
        self.assertEqual(self.report['tracker_wrong_fixes_fused'], 0)
        self.assertEqual(self.report['tracker_recoveries'], 0)

    def test_tracker_with_magnetometer(self):
        self.assertLess(self.report['magnetometer_position_error_mean_m'], 1.0)
        self.assertLess(self.report['magnetometer_yaw_error_mean_deg'], 3.0)

    def test_one_publisher_for_each_transform(self):
        edges = self.report['tf_publishers']
        self.assertEqual(edges['world -> mav_map'], ['ekf_tracker'])
        self.assertTrue({'mav_map -> mav_odom', 'mav_odom -> mav_base_link'} <= set(edges), edges)
        for edge, publishers in edges.items():
            self.assertEqual(len(publishers), 1, edge)

    def test_files(self):
        for name in ('vo', 'gps', 'tracker', 'tracker_with_magnetometer', 'truth'):
            rows = np.loadtxt(os.path.join(self.out, f'{name}_trajectory.txt'), ndmin=2)
            self.assertEqual(rows.shape[1], 8, name)
            self.assertTrue(np.all(np.isfinite(rows)), name)
        for name in ('trajectories.png', 'uncertainty.png'):
            self.assertGreater(os.path.getsize(os.path.join(self.out, name)), 20000)

    def test_no_node_died(self):
        died = [line for line in self.output.splitlines() if 'has died' in line and 'city_report' not in line]
        self.assertEqual(died, [])


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'end_to_end_city_test', EndToEndCity, sys.argv)
