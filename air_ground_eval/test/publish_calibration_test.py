#!/usr/bin/env python3
"""publish_calibration serves one replay after another: each roslaunch brings a master of its own, on the same port."""
import os
import subprocess
import sys
import tempfile
import time
import unittest

import rosgraph
import rosunit

HERE = os.path.dirname(os.path.realpath(__file__))
SCRIPTS = os.path.join(HERE, '..', 'scripts')
sys.path.insert(0, SCRIPTS)
from air_ground_eval import demo  # noqa: E402


class PublishCalibration(unittest.TestCase):
    def setUp(self):
        self.port = demo.free_port()
        self.environment = dict(os.environ, ROS_MASTER_URI=f'http://localhost:{self.port}')

    def begin(self, *words, **options):
        process = subprocess.Popen(words, env=self.environment, stdout=subprocess.DEVNULL, **options)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    def publishers(self, seconds=20):
        """Of /tf_static, by the master, as soon as there is one."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                found = dict(rosgraph.Master('/test', f'http://localhost:{self.port}').getSystemState()[0]).get('/tf_static')
            except (rosgraph.MasterException, OSError):
                found = None
            if found:
                return found
            time.sleep(0.1)
        return []

    def test_it_registers_with_a_new_master(self):
        said = tempfile.TemporaryFile('w+', encoding='utf-8')
        self.addCleanup(said.close)
        program = self.begin(sys.executable, os.path.join(SCRIPTS, 'publish_calibration'), '--transform', 'base camera 1 2 3 0 0 0 1', stderr=said)
        for replay in range(2):
            master = self.begin('rosmaster', '--core', '-p', str(self.port))
            self.assertEqual(len(self.publishers()), 1, f'replay {replay}')
            echo = subprocess.run(['rostopic', 'echo', '-n1', '/tf_static'], env=self.environment, capture_output=True, text=True, timeout=90, check=False)
            self.assertIn('child_frame_id: "camera"', echo.stdout)
            time.sleep(5)  # it looks once a second, and must have seen this master before it ends
            master.kill()
            master.wait()
        self.assertIsNone(program.poll())
        said.seek(0)
        self.assertEqual(said.read().count('another master has taken the place'), 1)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'publish_calibration_test', PublishCalibration)
