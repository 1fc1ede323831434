"""Keeps a replay's player and its clock in step with the nodes."""
import collections
import os
import time
import xmlrpc.client

import rosgraph
import rospy
from rosgraph_msgs.msg import Clock

CALLER = '/replay_report'


def _processor_time(pid):
    """Of a process: CPU time used, and that with the time that its threads waited for a processor [s]. Raises OSError when it has ended."""
    with open(f'/proc/{pid}/stat', encoding='ascii') as stream:
        words = stream.read().rsplit(')', 1)[1].split()
    used = (int(words[11]) + int(words[12])) / os.sysconf('SC_CLK_TCK')
    run = waited = 0
    for thread in os.listdir(f'/proc/{pid}/task'):
        try:
            with open(f'/proc/{pid}/task/{thread}/schedstat', encoding='ascii') as stream:
                numbers = stream.read().split()
        except OSError:
            continue  # it has ended, or the kernel keeps none
        run, waited = run + int(numbers[0]), waited + int(numbers[1])
    return used, max(used, 1e-9 * run) + 1e-9 * waited


class CpuLoad:
    """CPU time that the nodes use, from /proc (zero for nodes on other machines).

    wanted: name -> mean number of cores that the node used or waited for, between the last two calls of cores(). On a busy machine a node that
    has much to do may get hardly any time: that is not idle.
    """

    def __init__(self, nodes):
        self.nodes = nodes
        self.processes = {}
        self.previous = {}
        self.wanted = {}
        self.last_lookup = 0.0

    def cores(self):
        """Mean number of cores that each node kept busy since the last call: name -> cores."""
        now = time.monotonic()
        if len(self.processes) < len(self.nodes) and now - self.last_lookup > 2.0:
            self.last_lookup = now
            self._find()
        result, self.wanted = {}, {}
        for name, pid in self.processes.items():
            try:
                used, wanted = _processor_time(pid)
            except (OSError, IndexError):
                continue
            before = self.previous.get(name)
            self.previous[name] = (now, used, wanted)
            if before is not None:
                seconds = max(now - before[0], 1e-3)
                result[name] = max(0.0, used - before[1]) / seconds
                self.wanted[name] = max(0.0, wanted - before[2]) / seconds
        return result

    def _find(self):
        master = rosgraph.Master(CALLER)
        for name in self.nodes:
            if name not in self.processes:
                try:
                    uri = master.lookupNode(rospy.resolve_name(name))
                    self.processes[name] = xmlrpc.client.ServerProxy(uri).getPid(CALLER)[2]
                except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
                    continue


class Pacer:
    """Holds the player while a node lags, and lets go when the one that lags is idle (it is then waiting for data).

    limits: node -> how far behind the clock its output may be [s of the bag].
    """

    def __init__(self, recorder, player, limits):
        self.recorder, self.limits, self.player = recorder, limits, player
        self.load, self.busy, self.last_load = CpuLoad(recorder.nodes), set(), 0.0
        self.paused, self.since, self.slowest = False, None, ''
        self.held_for = collections.Counter()  # node: wall time for which it was the slowest [s]

    def step(self, now, may_hold=True):
        """now: time of the bag [s]; may_hold: no ClockKeeper leads."""
        wall = time.monotonic()
        if wall - self.last_load > 1.0:
            self.last_load = wall
            cores = self.load.cores()
            self.recorder.cores.append((now, cores))
            self.busy = {name for name, wanted in self.load.wanted.items() if wanted > 0.1}
        with self.recorder.lock:
            lags = {name: (now - stamp) / self.limits[name] for name, stamp in self.recorder.progress.items()
                    if name in self.busy and name in self.limits}
        lag = max(lags.values(), default=0.0)
        if self.paused:
            self._count(wall)
        if lags:
            self.slowest = max(lags, key=lags.get)
        if not self.paused and may_hold and lag > 1.0:
            self._set(True)
        elif self.paused and lag < 0.6:
            self._set(False)

    def release(self):
        if self.paused:
            self._count(time.monotonic())
            self._set(False)

    def _count(self, wall):
        self.held_for[self.slowest] += wall - self.since
        self.since = wall

    def _set(self, pause):
        if not self.player.pause(pause):
            return
        self.since, self.paused = time.monotonic(), pause


class ClockKeeper:
    """Gives /clock while the player gives none: it does so only while it waits for the next message, so not where it reads more slowly than it plays.

    A player that is held gives its own clock again and again, as it was when it waited last: time would jump between the two. It would not be held anyhow: while it is late
    it looks at no request. Stopped as a process (SIGSTOP), it would not send either what it has read, and not at all what is left so at the bag's end.
    """

    BEHIND = 0.5  # [s] of the clock behind what was played
    MARGIN = 0.05  # [s]: never ahead of the player's own clock, for time must not go back

    def __init__(self):
        self.publisher, self.given = None, None

    def leads(self):
        """The newest time on /clock is from here: the player must not be held."""
        return self.given is not None and rospy.get_time() <= self.given + 1e-6

    def step(self, played):
        """To be called while the player is not held. played: when the newest message that was heard was recorded [s]."""
        if played - rospy.get_time() < self.BEHIND:
            return
        if self.publisher is None:
            self.publisher = rospy.Publisher('/clock', Clock, queue_size=10)
            rospy.logwarn('the player cannot read the bag as fast as it plays: /clock follows what it has read. Faster: rosbag decompress, a quicker disk, fewer other programs, or rate:=0.5')
        self.given = played - self.MARGIN
        self.publisher.publish(Clock(rospy.Time.from_sec(self.given)))
