"""What the end-to-end tests share: a demonstration run once for all test cases, its output and its report."""
import os
import subprocess
import sys
import tempfile
import unittest

import rospy
import yaml

sys.path.insert(0, os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'air_ground_eval', 'scripts'))
from air_ground_eval.demo import find_program  # noqa: E402

TIME_LIMIT = 1400  # [s], rendering, building of databases, and replay


class DemonstrationTest(unittest.TestCase):
    """Runs `program` of the package on the world of ~world, ~seed and ~simulate (options of the simulator) before the first test.

    Bags and databases come from the cache where they were made before. Fails with the program's last lines when it leaves no report.
    """
    program = None

    @classmethod
    def setUpClass(cls):
        rospy.init_node(cls.program + '_test', anonymous=True, disable_signals=True)
        cls.folder = tempfile.TemporaryDirectory()
        cls.out = os.path.join(cls.folder.name, 'out')
        command = [find_program(cls.program), cls.out, '--no-rviz', '--world', str(rospy.get_param('~world')),
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

    def test_one_publisher_for_each_transform(self):
        edges = self.report['tf_publishers']
        required, forbidden = self.transforms()
        self.assertTrue(required <= set(edges), edges)
        self.assertFalse(forbidden & set(edges), edges)
        for edge, publishers in edges.items():
            self.assertEqual(len(publishers), 1, edge)

    def test_no_node_died(self):
        died = [line for line in self.output.splitlines() if 'has died' in line]
        self.assertEqual(died, [])

    def transforms(self):
        """Edges of tf ('parent -> child') that must be there, and that must not."""
        raise NotImplementedError
