#!/usr/bin/env python3
"""A rendered world through roslaunch: simulator, bag, all nodes, report. The bag comes from the cache where it was rendered before.

Parameters: ~world, ~seed, ~simulate (options of the simulator), ~accept (true: the alignment must be accepted and accurate;
false: it must be refused, with a reason).
"""
import os
import socket
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import rospy
import rostest
import yaml

TIME_LIMIT = 1300  # [s], rendering and replay


def free_port():
    with socket.socket() as s:
        s.bind(('127.0.0.1', 0))
        return s.getsockname()[1]


def run(command, **options):
    return subprocess.run(command, text=True, timeout=TIME_LIMIT, check=False, **options)


class EndToEnd(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node('end_to_end_test', anonymous=True, disable_signals=True)
        world, seed = rospy.get_param('~world'), str(rospy.get_param('~seed'))
        cache = os.path.join(os.environ.get('AIR_GROUND_CACHE') or os.path.expanduser('~/.cache/air_ground'), 'bags')
        rendered = run(['rosrun', 'air_ground', 'simulate', '--world', world, '--seed', seed, '--cache', cache, '--quiet',
                        *str(rospy.get_param('~simulate', '')).split()], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        assert rendered.returncode == 0, 'rendering failed:\n' + rendered.stdout
        bag = rendered.stdout.strip().splitlines()[-1]
        cls.accept = rospy.get_param('~accept')
        cls.folder = tempfile.TemporaryDirectory()
        cls.out = os.path.join(cls.folder.name, 'out')
        port = free_port()
        result = run(['roslaunch', '-p', str(port), 'air_ground', 'replay.launch', f'bag:={bag}', f'out:={cls.out}'],
                     env=dict(os.environ, ROS_MASTER_URI=f'http://localhost:{port}'), stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        cls.output = result.stdout
        path = os.path.join(cls.out, 'report.yaml')
        assert os.path.isfile(path), 'no report was written:\n' + '\n'.join(cls.output.splitlines()[-80:])
        with open(path, encoding='utf-8') as stream:
            cls.report = yaml.safe_load(stream)
        print('\n'.join(line for line in cls.output.splitlines() if 'parameter /' not in line)[-6000:])

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

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
            self.assertTrue(self.report['refined_reason'])
            self.assertNotIn('refined_error_m', self.report)

    def test_files(self):
        for name, columns in (('mav_trajectory.txt', 8), ('ground_trajectory.txt', 8), ('alignment.txt', 16)):
            rows = np.loadtxt(os.path.join(self.out, name), ndmin=2)
            self.assertEqual(rows.shape[1], columns, name)
            self.assertTrue(np.all(np.isfinite(rows)), name)
        self.assertGreater(os.path.getsize(os.path.join(self.out, 'report.png')), 20000)
        self.assertEqual(os.path.isfile(os.path.join(self.out, 'augmented_map.ply')) and self.accept, self.accept)

    def test_one_publisher_for_each_transform(self):
        edges = self.report['tf_publishers']
        expected = {'mav_map -> mav_odom', 'mav_odom -> mav_base_link', 'ground_map -> ground_odom', 'ground_odom -> ground_base_link'}
        self.assertTrue(expected <= set(edges), edges)
        self.assertEqual('ground_map -> mav_map' in edges, self.accept)
        for edge, publishers in edges.items():
            self.assertEqual(len(publishers), 1, edge)

    def test_no_node_died(self):
        died = [line for line in self.output.splitlines() if 'has died' in line and 'replay_report' not in line]
        self.assertEqual(died, [])


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'end_to_end_test', EndToEnd, sys.argv)
