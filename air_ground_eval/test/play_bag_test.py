#!/usr/bin/env python3
"""A replay begins when its nodes listen, however long one of them loads."""
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from unittest import mock

import numpy as np
import rosbag
import rospy
import rosunit
from roslib.packages import find_node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'scripts'))
from air_ground_eval import bag_player, bag_reader, messages, replay  # noqa: E402

IMAGES = 10


def write_info(bag, t):
    info = CameraInfo(width=8, height=8)
    info.header.stamp = messages.stamp(t)
    bag.write('/mav/camera/camera_info', info, messages.stamp(t))


def write_bag(path, begin=100.0, pause=0.0):
    """A second of images with their calibration; the second half comes after a pause [s].
    A last calibration comes half a second later: the player ends with what it has published last still in its queue."""
    with rosbag.Bag(path, 'w') as bag:
        for i in range(IMAGES):
            t = begin + 0.1 * i + (pause if 2 * i >= IMAGES else 0)
            bag.write('/mav/camera/image_raw', messages.image(np.zeros((8, 8)), 'mono8', t, 'camera'), messages.stamp(t))
            write_info(bag, t)
        write_info(bag, t + 0.5)


class PlayBag(unittest.TestCase):
    def begin(self, **parameters):
        """play_bag with these parameters, and the queue of its lines."""
        for name, value in parameters.items():
            rospy.set_param(f'/play_bag/{name}', value)
        process = subprocess.Popen([find_node('air_ground', 'play_bag')[0]], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                                   env=dict(os.environ, ROSCONSOLE_STDOUT_LINE_BUFFERED='1', PYTHONUNBUFFERED='1'))
        self.addCleanup(process.stdout.close)
        self.addCleanup(process.wait)
        self.addCleanup(process.terminate)
        lines = queue.Queue()
        threading.Thread(target=lambda: [lines.put(line) for line in process.stdout], daemon=True).start()
        return lines

    def said(self, lines, text, seconds=40):
        """All lines until one holds the text."""
        said, end = '', time.monotonic() + seconds
        while text not in said and time.monotonic() < end:
            try:
                said += lines.get(timeout=1)
            except queue.Empty:
                continue
        self.assertIn(text, said)

    def test_no_image_is_played_before_a_node_that_loads_listens(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, 'x.bag')
            write_bag(path)
            lines = self.begin(bag=path, wait_for=rospy.get_name())
            self.said(lines, f'waiting for {rospy.get_name()}')
            time.sleep(3)  # longer than the bag
            heard = []
            subscriber = rospy.Subscriber('/mav/camera/image_raw', Image, lambda message: heard.append(round(message.header.stamp.to_sec(), 3)), queue_size=100)
            end = time.monotonic() + 40
            while len(heard) < IMAGES and time.monotonic() < end:
                time.sleep(0.1)
            subscriber.unregister()
        self.assertEqual(heard, [round(100 + 0.1 * i, 3) for i in range(IMAGES)])

    def test_no_message_of_another_time_is_waited_for(self):
        """One that was added with another clock's time, before or after the others, on a topic that nobody hears or among the images; and a pause of a day, as between two robots' recordings."""
        begin = 1.6e9
        for number, (topic, away, pause) in enumerate((('/tf_static', 1e8, 0), ('/tf_static', -1e8, 0), ('/mav/camera/image_raw', 1e8, 0), ('/mav/camera/image_raw', -1e8, 0), ('', 0, 86400))):
            with self.subTest(topic=topic, away=away, pause=pause), tempfile.TemporaryDirectory() as folder:
                path = os.path.join(folder, 'x.bag')
                write_bag(path, begin, pause)
                if topic:
                    message = messages.static_transforms([('base', 'lidar', np.eye(4))], begin) if topic == '/tf_static' else messages.image(np.zeros((8, 8)), 'mono8', begin, 'stray')
                    with rosbag.Bag(path, 'a') as bag:
                        bag.write(topic, message, messages.stamp(begin + away))
                heard, clock = [], []
                subscribers = [rospy.Subscriber('/mav/camera/image_raw', Image, lambda m: heard.append((m.header.stamp.to_sec() - begin, m.header.frame_id)), queue_size=100),
                               rospy.Subscriber('/clock', Clock, lambda m: clock.append(m.clock.to_sec() - begin), queue_size=1000)]
                facts = bag_reader.BagFacts(path)
                player = bag_player.BagPlayer(facts, name=f'player_{number}')
                try:
                    self.assertTrue(player.wait_until_ready())
                    end = time.monotonic() + 30
                    while replay.unconnected() and time.monotonic() < end:
                        time.sleep(0.1)
                    player.pause(False)
                    end = time.monotonic() + 60
                    while player.running() and time.monotonic() < end:
                        time.sleep(0.05)
                    self.assertFalse(player.running())
                    while len(heard) < IMAGES and time.monotonic() < end:
                        time.sleep(0.05)
                    time.sleep(0.5)  # for more than there should be
                finally:
                    player.stop()
                    for subscriber in subscribers:
                        subscriber.unregister()
                np.testing.assert_allclose([t for t, _ in heard], [0.1 * i + (pause if 2 * i >= IMAGES else 0) for i in range(IMAGES)], atol=1e-6)
                self.assertEqual({frame for _, frame in heard}, {'camera'})
                self.assertTrue(-0.1 < min(clock) and max(clock) < pause + 1.5, (min(clock), max(clock)))

    @staticmethod
    def waited(listens_after, says):
        """By a clock of its own, that steps by a second: (what wait_to_listen answers, after how long [s], lines of the console) of a node that subscribes after so long; says: time -> its line in the diagnostics."""
        clock, said = [0.0], []

        def sleep(_):
            clock[0] += 1

        def loading(node):
            return replay.Recorder.loading(mock.Mock(said={node: says(clock[0])}, lock=threading.Lock()), node)

        with mock.patch.object(replay, 'not_listening', lambda nodes, topics: [] if clock[0] >= listens_after else nodes), \
                mock.patch.object(replay, 'time', mock.Mock(monotonic=lambda: clock[0], sleep=sleep)), mock.patch.object(replay, 'rospy') as ros:
            ros.is_shutdown.return_value = False
            ros.loginfo.side_effect = ros.logerr.side_effect = lambda text, *values: said.append(text % values)
            return replay.wait_to_listen(['/image'], ['localizer'], timeout=60.0, loading=loading), clock[0], said

    def test_a_node_that_loads_is_waited_for_as_long_as_it_says_so(self):
        index = 'preparing the search index over 80000 views: building it, which takes minutes for a large city'
        answer, after, said = self.waited(3000, lambda t: 'reading the database x.gpkg' if t < 100 else index)
        self.assertEqual((answer, after), (True, 3000))
        self.assertIn(f'still waiting: localizer is {index}', said)
        self.assertLess(len(said), 60)

    def test_one_that_does_not_is_missed(self):
        answer, after, said = self.waited(3000, lambda t: 'reading the database x.gpkg' if t < 500 else 'waiting for images')
        self.assertFalse(answer)
        self.assertAlmostEqual(after, 561, delta=3)
        self.assertIn('no sign of localizer', said[-1])
        self.assertAlmostEqual(self.waited(3000, lambda t: '')[1], 61, delta=3)


if __name__ == '__main__':
    rospy.init_node('play_bag_test')
    rosunit.unitrun('air_ground', 'play_bag_test', PlayBag)
