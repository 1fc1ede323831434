#!/usr/bin/env python3
"""How a replay waits for its nodes: when the player is held, for whom, and who gives the clock."""
import os
import subprocess
import sys
import threading
import time
import unittest
from unittest import mock

import numpy as np
import rospy
import rosunit
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [os.path.join(HERE, '..', 'scripts'), HERE]
import as_module  # noqa: E402
from air_ground_eval import pacing  # noqa: E402
from air_ground_eval import replay as replays  # noqa: E402


class Pacing(unittest.TestCase):
    def test_the_clock_follows_what_was_played_and_never_leads(self):
        """The player gives no /clock while it is behind its own time."""
        with mock.patch.object(pacing, 'rospy') as ros:
            ros.Time.from_sec = rospy.Time.from_sec
            ros.get_time.return_value = 100.0
            keeper = pacing.ClockKeeper()
            keeper.step(100.4)
            ros.Publisher.assert_not_called()  # the player's own clock is there
            for played in (101.0, 102.0, 102.0):
                keeper.step(played)
            ros.Publisher.assert_called_once_with('/clock', mock.ANY, queue_size=10)
            ros.logwarn.assert_called_once()
            given = [call.args[0].clock.to_sec() for call in ros.Publisher.return_value.publish.call_args_list]
            np.testing.assert_allclose(given, [100.95, 101.95, 101.95])
            ros.get_time.return_value = 102.1
            keeper.step(102.2)
            self.assertEqual(ros.Publisher.return_value.publish.call_count, 3)

    def test_who_is_late_is_not_held(self):
        """A player that is held repeats the time at which it waited last: before what the ClockKeeper gave meanwhile, time went back by 2 s."""
        with mock.patch.object(pacing, 'rospy') as ros, mock.patch.object(pacing, 'CpuLoad') as load:
            ros.Time.from_sec = rospy.Time.from_sec
            load.return_value.cores.return_value = load.return_value.wanted = {'mav_vo': 0.9}
            player, recorder = mock.Mock(), mock.Mock(nodes=['mav_vo'], progress={'mav_vo': 95.0}, lock=threading.Lock(), cores=[])
            ros.get_time.return_value = 100.0
            keeper, pacer = pacing.ClockKeeper(), pacing.Pacer(recorder, player, {'mav_vo': 1.5})
            self.assertFalse(keeper.leads())
            keeper.step(102.0)
            ros.get_time.return_value = 101.95
            self.assertTrue(keeper.leads())
            pacer.step(101.95, may_hold=not keeper.leads())
            player.pause.assert_not_called()
            ros.get_time.return_value = 102.3  # the player waits again
            pacer.step(102.3, may_hold=not keeper.leads())
            player.pause.assert_called_once_with(True)

    def test_the_slowest_node_is_said_to_be_waited_for(self):
        """A node that lagged when the player was first held got all of the time for which another was waited for."""
        with mock.patch.object(pacing, 'CpuLoad') as load, mock.patch.object(pacing, 'time') as wall:
            load.return_value.cores.return_value = load.return_value.wanted = {'mav_vo': 0.9, 'dense_fusion': 0.9}
            recorder = mock.Mock(nodes=['mav_vo', 'dense_fusion'], progress={'mav_vo': 95.0, 'dense_fusion': 99.0}, lock=threading.Lock(), cores=[])
            pacer = pacing.Pacer(recorder, mock.Mock(), {'mav_vo': 1.0, 'dense_fusion': 1.0})
            for seconds, progress in ((10, {}), (12, {'mav_vo': 99.9, 'dense_fusion': 96.0}), (42, {'dense_fusion': 99.9})):
                wall.monotonic.return_value = float(seconds)
                recorder.progress.update(progress)
                pacer.step(100.0)
            self.assertEqual(dict(pacer.held_for), {'mav_vo': 2.0, 'dense_fusion': 30.0})
            self.assertFalse(pacer.paused)

    def test_before_its_first_cloud_dense_fusion_is_waited_for(self):
        """Nothing told how far it was, and its queue ran over: of a video without IMU it lost every third image."""
        class Heard(as_module.load('replay_report').Recorder):
            def __init__(self):
                self.lock, self.nodes, self.begin, self.end = threading.Lock(), ['dense_fusion'], 100.0, 150.0
                self.progress, self.diagnostics, self.said, self.fused, self.played, self.ended = {}, {}, {}, {}, 120.0, None

        recorder = Heard()
        with mock.patch.object(replays, 'rospy') as ros:
            ros.get_time.return_value = 120.0
            recorder.on_diagnostics(DiagnosticArray(status=[DiagnosticStatus(name='dense_fusion: state', values=[KeyValue(key='lag [s]', value='11.5')])]))
        self.assertEqual(recorder.progress, {'dense_fusion': 108.5})

    def test_who_waits_for_a_processor_is_not_idle(self):
        """On a busy machine the nodes of lowest priority get hardly any time: the report must not be written meanwhile."""
        processor = {min(os.sched_getaffinity(0))}
        spin = 'import os; os.sched_setaffinity(0, {processor}); os.nice({nice})\nwhile True: pass'
        processes = [subprocess.Popen([sys.executable, '-c', spin.format(processor=processor, nice=nice)]) for nice in (19, 0, 0, 0)]
        try:
            load = pacing.CpuLoad(['starved', 'asleep'])
            with subprocess.Popen(['sleep', '60']) as asleep:
                load.processes = {'starved': processes[0].pid, 'asleep': asleep.pid}
                load.cores()
                for _ in range(20):  # until both have started, which waits for the processor, too
                    time.sleep(1)
                    used = load.cores()
                    if load.wanted['starved'] > 0.8 and load.wanted['asleep'] < 0.01:
                        break
                asleep.kill()
            self.assertLess(used['starved'], 0.2)
            self.assertGreater(load.wanted['starved'], 0.8)
            self.assertLess(load.wanted['asleep'], 0.01)
        finally:
            for process in processes:
                process.kill()
                process.wait()


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'pacing_test', Pacing)
