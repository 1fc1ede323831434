#!/usr/bin/env python3
"""rviz on a display that nobody sees: drawn rarely, and behind all others."""
import glob
import os
import shlex
import subprocess
import sys
import tempfile
import unittest

import rosunit

sys.path.insert(0, os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'scripts'))
from air_ground_eval import demo  # noqa: E402


def output_of(command):
    """In a session of its own, as roslaunch starts a node."""
    return subprocess.run(shlex.split(demo.BEHIND_ALL) + command, start_new_session=True, capture_output=True, text=True, check=True).stdout


class Unwatched(unittest.TestCase):
    def test_every_configuration_of_ours_is_drawn_once_a_second(self):
        files = glob.glob(demo.package_file('config/rviz/*.rviz'))
        self.assertGreaterEqual(len(files), 3)
        with tempfile.TemporaryDirectory() as folder:
            for path in files:
                with open(path, encoding='utf-8') as before, open(demo.unwatched(path, folder), encoding='utf-8') as after:
                    changed = [(a, b) for a, b in zip(before, after) if a != b]
                self.assertEqual([b.strip() for _, b in changed], ['Frame Rate: 1'], path)
            other = os.path.join(folder, 'other.rviz')
            with open(other, 'w', encoding='utf-8') as stream:
                stream.write('Panels:\n')
            with self.assertRaisesRegex(ValueError, 'other.rviz.*frame rate'):
                demo.unwatched(other, os.path.join(folder, '..'))

    def test_the_prefix_lets_others_go_first(self):
        self.assertEqual(output_of(['nice']).strip(), '19')
        self.assertEqual(output_of(['printf', '%s|', 'a b', '$c']), 'a b|$c|')
        if os.path.exists('/proc/self/autogroup'):
            self.assertIn('nice 19', output_of(['cat', '/proc/self/autogroup']))


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'demo_test', Unwatched)
