#!/usr/bin/env python3
"""The examples on data with known truth. examples_test.py PROGRAMS CONFIG; the photograph is located in end_to_end_city_test.py, where there is a city."""
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np

PROGRAMS, CONFIG = sys.argv[1:3]
TRUTH = np.array([1.3, -0.7, 0.4, 2.1])  # of the aerial map in the ground map: x y z [m], yaw [rad]


def run(program, *arguments):
    return subprocess.run([os.path.join(PROGRAMS, program), *map(str, arguments)], capture_output=True, text=True, check=False, timeout=300)


def write_ply(path, points):
    with open(path, 'w', encoding='utf-8') as stream:
        stream.write(f'ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nend_header\n')
        np.savetxt(stream, points, fmt='%.5f')


def boxes(random):
    """Surface points of boxes on a floor of 8 x 8 m, tops and sides."""
    floor = np.column_stack([random.uniform(-4, 4, (60000, 2)), np.zeros(60000)])
    parts = []
    for _ in range(9):
        centre, half, height = random.uniform(-3.3, 3.3, 2), random.uniform(0.2, 0.5, 2), random.uniform(0.2, 0.8)
        inside = np.all(np.abs(floor[:, :2] - centre) < half, axis=1)
        floor[inside, 2] = np.maximum(floor[inside, 2], height)
        for axis in (0, 1):
            side = np.column_stack([centre + half * random.uniform(-1, 1, (3000, 2)), random.uniform(0, height, 3000)])
            side[:, axis] = centre[axis] + half[axis] * random.choice([-1, 1], 3000)
            parts.append(side)
    return np.vstack([floor] + parts) + random.normal(0, 0.004, (60000 + 9 * 6000, 3))


class Examples(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.path = lambda name: os.path.join(folder.name, name)

    def test_an_aerial_cloud_finds_its_place_and_is_refined(self):
        random = np.random.default_rng(5)
        ground = boxes(random)
        x, y, z, yaw = TRUTH
        R = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        seen = ground[np.all(np.abs(ground[:, :2] - (0.8, -0.5)) < 2.4, axis=1)]
        write_ply(self.path('ground.ply'), ground)
        write_ply(self.path('aerial.ply'), (seen - (x, y, z)) @ R)
        found = run('01_find_in_height_map', self.path('aerial.ply'), self.path('ground.ply'))
        self.assertEqual(found.returncode, 0, found.stdout + found.stderr)
        coarse = np.array(found.stdout.splitlines()[-1].split(), float)
        self.assertLess(np.linalg.norm(coarse[:2] - TRUTH[:2]), 0.15, found.stdout)
        self.assertLess(abs(coarse[3] - yaw), 0.06)
        write_ply(self.path('large.ply'), 1.02 * (seen - (x, y, z)) @ R)  # in a unit 2 % too short
        refined = run('02_refine_by_icp', self.path('large.ply'), self.path('ground.ply'), *coarse, os.path.join(CONFIG, 'icp_refine.yaml'))
        self.assertEqual(refined.returncode, 0, refined.stdout + refined.stderr)
        words = refined.stdout.split()
        self.assertLess(np.linalg.norm(np.array(words[:3], float) - TRUTH[:3]), 0.01, refined.stdout)
        self.assertAlmostEqual(float(words[3]), yaw, delta=0.003)
        self.assertAlmostEqual(float(words[5]), 1 / 1.02, delta=0.002)

    def test_a_log_is_filtered_and_its_outlier_refused(self):
        """A circle of 10 m, its odometry 1 % too long and turning 0.02 deg a second too much; every 3 s a fix, the last but one 6 m off."""
        def truth(t):
            return np.array([10 * np.sin(0.1 * t), 10 - 10 * np.cos(0.1 * t), 2.0, 0.1 * t])
        random = np.random.default_rng(2)
        lines = []
        for t in np.arange(0, 60, 0.5):
            if t % 3 == 0:
                fix = truth(t) + random.normal(0, (0.2, 0.2, 0.2, 0.015))
                fix[0] += 6 * (t == 54)
                lines.append(f'fix {t} ' + ' '.join(map(str, fix)))
            lines.append(f'odometry {t} {t + 0.5} {1.01 * 0.4998} {0.0125} 0 {0.05 + 0.0002}')
        with open(self.path('log.txt'), 'w', encoding='utf-8') as stream:
            stream.write('\n'.join(lines))
        tracked = run('04_track_from_log', self.path('log.txt'))
        self.assertEqual(tracked.returncode, 0, tracked.stderr)
        words = tracked.stdout.split()
        self.assertEqual(float(words[0]), 60)
        self.assertLess(np.linalg.norm(np.array(words[1:4], float) - truth(60)[:3]), 0.5, tracked.stdout)
        turn = (float(words[4]) - truth(60)[3] + np.pi) % (2 * np.pi) - np.pi
        self.assertLess(abs(turn), 0.03)
        self.assertEqual(words[-1], '1')

    def test_bad_input_is_named(self):
        for program, arguments in (('01_find_in_height_map', ('/nowhere.ply', '/nowhere.ply')), ('03_locate_photograph', ('/nowhere.gpkg', 'x.png', 'y.yaml')),
                                   ('04_track_from_log', ('/nowhere.txt',))):
            result = run(program, *arguments)
            self.assertEqual(result.returncode, 1)
            self.assertIn('/nowhere', result.stderr)


if __name__ == '__main__':
    unittest.main(argv=sys.argv[:1])
