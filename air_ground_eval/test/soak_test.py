#!/usr/bin/env python3
"""soak ends, and says why, where there is nothing to watch; roslaunch is a stand-in."""
import os
import struct
import subprocess
import sys
import tempfile
import time
import unittest
from unittest import mock

import numpy as np
import rosbag
import rosunit

HERE = os.path.dirname(os.path.realpath(__file__))
SCRIPTS = os.path.join(HERE, '..', 'scripts')
sys.path[:0] = [SCRIPTS, HERE]
import as_module  # noqa: E402
from air_ground_eval import bag_reader, messages  # noqa: E402

DIES = '#!/bin/sh\necho "RLException: [air_grund.launch] is neither a launch file in package [air_ground] nor is [air_ground] a launch file name"\nexit 1\n'
LIVES = '#!/bin/sh\nexec rosmaster --core -p "$2"\n'
# Some seconds after its master has begun to answer, however long that took.
DIES_LATER = ('#!/bin/sh\nrosmaster --core -p "$2" & master=$!\n'
              'until /usr/bin/python3 -c "import socket, sys; socket.create_connection((\'localhost\', int(sys.argv[1])))" "$2" 2>/dev/null\n'
              'do kill -0 $master || exit 1; sleep 0.2; done\nsleep 8; kill $master; exit 124\n')


def write_bag(path, topics=('/mav/camera/image_raw', '/alignment/refined')):
    with rosbag.Bag(path, 'w') as bag:
        for t in np.arange(100, 101, 0.1):
            for topic in topics:
                bag.write(topic, messages.image(np.zeros((8, 8)), 'mono8', t, 'camera'), messages.stamp(t))


class Soak(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder, self.bag, self.out = folder.name, os.path.join(folder.name, 'x.bag'), os.path.join(folder.name, 'out')
        write_bag(self.bag)

    def soak(self, roslaunch, *arguments, hours=0.0004):
        """(Exit status, what it printed), with a stand-in for roslaunch."""
        path = os.path.join(self.folder, 'roslaunch')
        with open(path, 'w', encoding='utf-8') as stream:
            stream.write(roslaunch)
        os.chmod(path, 0o755)
        environment = dict(os.environ, PATH=self.folder + os.pathsep + os.environ['PATH'])
        command = [sys.executable, os.path.join(SCRIPTS, 'soak'), '--bag', self.bag, '--out', self.out, '--hours', str(hours), *arguments]
        result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=240, check=False)
        self.assertNotIn('Traceback', result.stderr)
        return result.returncode, result.stdout + result.stderr

    def test_a_launch_that_dies_at_once(self):
        status, said = self.soak(DIES, hours=1)
        self.assertEqual(status, 1)
        self.assertIn('RLException: [air_grund.launch] is neither a launch file', said)
        self.assertIn(f'soak: roslaunch ended with status 1 before it had a master; the lines above are the last of {self.out}/console.txt', said)

    def test_a_launch_that_dies_later(self):
        status, said = self.soak(DIES_LATER, hours=1)
        self.assertEqual(status, 1)
        self.assertIn('soak: roslaunch ended by itself, with status 124', said)

    def test_no_node_was_seen(self):
        status, said = self.soak(LIVES)
        self.assertEqual(status, 1)
        self.assertIn('soak: none of the nodes was seen; the lines above are the last of', said)

    def test_bags_that_cannot_be_played(self):
        with open(self.bag, 'rb') as stream:
            half = stream.read()[:-2000]
        with open(self.bag, 'wb') as stream:
            stream.write(half)
        status, said = self.soak(DIES)
        self.assertEqual((status, said.count('\n')), (1, 1), said)
        self.assertIn(f'run  rosbag reindex "{self.bag}"', said)
        write_bag(self.bag, ['/alignment/refined'])
        status, said = self.soak(LIVES)
        self.assertEqual((status, said.count('\n')), (1, 1), said)
        self.assertIn('holds nothing to play: no images, no IMU', said)

    def test_an_earlier_run_stays(self):
        os.mkdir(self.out)
        for name in ('soak.csv', 'soak.png', 'notes.txt'):
            with open(os.path.join(self.out, name), 'w', encoding='ascii') as stream:
                stream.write('four hours')
        self.assertIn(f'what an earlier run left is now in {self.out}/earlier-1', self.soak(DIES)[1])
        with open(os.path.join(self.out, 'earlier-1', 'soak.csv'), encoding='ascii') as stream:
            self.assertEqual(stream.read(), 'four hours')
        self.assertEqual(sorted(os.listdir(self.out)), ['console.txt', 'earlier-1', 'notes.txt'])

    def test_results_of_an_earlier_run_are_not_played(self):
        module = as_module.load('soak')
        with mock.patch.object(module, 'rospy'):
            for arguments, played in (([], ['/mav/camera/image_raw']), (['icp_refine:=false'], ['/alignment/refined', '/mav/camera/image_raw'])):
                loop = module.Loop(bag_reader.BagFacts(self.bag), 1.0, module.own_topics(arguments))
                self.assertEqual(sorted(loop.topics), played)

    def test_rounds_follow_each_other_from_now_on(self):
        module = as_module.load('soak')
        with rosbag.Bag(self.bag, 'a') as bag:  # by another clock: not waited for
            bag.write('/mav/camera/image_raw', messages.image(np.zeros((8, 8)), 'mono8', 100, 'camera'), messages.stamp(100 + 1e8))
        with mock.patch.object(module, 'rospy') as rospy:
            rospy.is_shutdown.return_value = False
            loop = module.Loop(bag_reader.BagFacts(self.bag), 10.0, module.own_topics([]))
            self.assertLess(loop.length, 2)
            now = time.time()
            for _ in range(3):
                loop.play(lambda: False)
            played = [call.args[0] for call in rospy.Publisher.return_value.publish.call_args_list[1:]]  # the first is tf_static
        stamps = [secs + 1e-9 * nsecs for secs, nsecs in (struct.unpack_from('<II', message.recorded, 4) for message in played)]
        np.testing.assert_allclose(stamps, now + np.concatenate([k * loop.length + np.arange(0, 1, 0.1) for k in range(3)]), atol=0.5)
        self.assertTrue(np.all(np.diff(stamps) > 0.09))


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'soak_test', Soak)
