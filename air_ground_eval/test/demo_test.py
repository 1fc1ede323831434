#!/usr/bin/env python3
"""rviz on a display that nobody sees: drawn rarely, and behind all others. Ctrl-C, which a replay is given the time to end by."""
import glob
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from unittest import mock

import rosunit

SCRIPTS = os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'scripts')
sys.path.insert(0, SCRIPTS)
from air_ground_eval import demo  # noqa: E402


def output_of(command):
    """In a session of its own, as roslaunch starts a node."""
    return subprocess.run(shlex.split(demo.BEHIND_ALL) + command, start_new_session=True, capture_output=True, text=True, check=True).stdout


# Takes its time to end, as roslaunch does, which stops nodes, then the master that it started.
SLOW = "trap 'kill $!; sleep 2; touch DONE; exit' INT; sleep 60 & touch BEGUN; wait"
REPLAY = 'import os, sys; sys.path.insert(0, sys.argv[1]); from air_ground_eval import demo; sys.exit(demo.run_replay(["sh", "-c", sys.argv[2]], os.environ))'


class Unwatched(unittest.TestCase):
    def test_ctrl_c_gives_roslaunch_the_time_to_end(self):
        """Killed a quarter of a second after it, it left its master, and that /use_sim_time."""
        with tempfile.TemporaryDirectory() as folder:
            process = subprocess.Popen([sys.executable, '-c', REPLAY, SCRIPTS, SLOW], cwd=folder, env=dict(os.environ, TMPDIR=folder), start_new_session=True, stderr=subprocess.PIPE,
                                       text=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
            end = time.monotonic() + 20
            while not os.path.exists(os.path.join(folder, 'BEGUN')) and time.monotonic() < end:
                time.sleep(0.05)
            os.killpg(process.pid, signal.SIGINT)
            time.sleep(0.5)
            process.send_signal(signal.SIGINT)  # who is impatient asks again
            said = process.communicate(timeout=30)[1]
            self.assertEqual(sorted(os.listdir(folder)), ['BEGUN', 'DONE'], said)
            self.assertEqual((process.returncode, said), (130, ''))

    def test_ctrl_c_is_no_failure_to_explain(self):
        with mock.patch.object(demo, 'run_replay', return_value=demo.INTERRUPTED), self.assertRaises(SystemExit) as ended:
            demo.launch('run_demo', 'replay.launch', [], '/nowhere', None)
        self.assertEqual(ended.exception.code, 130)

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
