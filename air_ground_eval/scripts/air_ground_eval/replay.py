"""What the reports of replays share: hearing nodes, holding the player while they lag, their services, rviz's picture."""
import os
import re
import signal
import subprocess
import threading
import time
import xmlrpc.client

import rosgraph
import rospy
from air_ground.msg import VoStatus
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, Imu
from tf2_msgs.msg import TFMessage

from . import bag_guess, geometry
from .bag_topics import TRANSPORTS, recorded
from .earlier_files import move_aside
from .pacing import CALLER, ClockKeeper, CpuLoad, Pacer

STATES = {VoStatus.STATE_WAITING: 'WAITING', VoStatus.STATE_INITIALIZING: 'INITIALIZING', VoStatus.STATE_SCALING: 'SCALING',
          VoStatus.STATE_TRACKING: 'TRACKING', VoStatus.STATE_LOST: 'LOST'}

LOADING = ('reading ', 'preparing ')  # how the state of a node begins that does not listen yet, in the diagnostics
SAY_AGAIN = 60.0  # [s]


def pose_from_message(pose):
    """4x4 transform of a geometry_msgs/Pose. ValueError for a quaternion that is zero or not finite."""
    p, q = pose.position, pose.orientation
    return geometry.pose_from_tq([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])


class Robot:
    """What was heard from a robot's odometry. on: `node` runs; else another is in its place, or none. image: its input topic."""

    def __init__(self, node, image, on=True):
        self.node, self.image, self.on = node, rospy.resolve_name(image), on
        self.delay = 0.0  # of the bag's time of its images after their stamps [s], which may be another clock's
        self.span = None  # stamps of the first and the last image of the part of the bag that is played [s], where it has any
        self.odometry = {}  # stamp -> T_map_base
        self.latencies = []  # from each image to its pose, on the bag's clock [s]
        self.last_status = None
        self.processing, self.lost, self.frames = 0.0, 0, 0
        self.map_begins = []  # (stamp of the first status that names a map [s], its id)

    def heard(self, status):
        self.last_status = status
        self.frames += 1
        self.processing += status.processing_time
        self.lost += status.state == VoStatus.STATE_LOST
        if not self.map_begins or self.map_begins[-1][1] != status.map_id:
            self.map_begins.append((status.header.stamp.to_sec(), status.map_id))

    def map_at(self, stamp):
        """Id of its map at a stamp [s]; 0: not known."""
        return next((map_id for begin, map_id in reversed(self.map_begins) if begin <= stamp + 1e-6), 0)

    def state(self):
        return {'state': STATES.get(self.last_status.state, str(self.last_status.state)), 'reason': self.last_status.reason,
                'processing_ms': 1000 * self.processing / self.frames, 'lost': self.lost}

    def switched_off(self):
        """By its argument, and no other node speaks in its place."""
        return not self.on and not self.odometry and self.last_status is None


class Recorder:
    """Listens to diagnostics and tf; a report's own recorder adds its topics and robots. `nodes`: names of the nodes that are watched."""

    def __init__(self, begin, nodes):
        self.lock = threading.Lock()
        self.begin, self.end, self.nodes = begin, float('inf'), nodes
        self.robots = {}  # name -> Robot: a report's own
        self.progress = {}  # node -> newest stamp of its output, on the bag's clock [s]
        self.diagnostics = {}  # hardware id -> {key: value} of the last message
        self.said = {}  # hardware id -> its line in the diagnostics
        self.missing = {}  # topic -> why no message of it can come
        self.tf_publishers = {}  # 'parent -> child': names of the nodes that publish it
        self.cores = []  # (time of the bag [s], {node: cores that it kept busy}), about every second
        self.refused = []  # lines on topics of the bag that no node takes
        self.played = 0.0  # when the newest message of the bag's cameras or IMUs that was heard was recorded [s]
        self.ended = None  # the bag's time, and the wall's, when the clock stood still [s]
        self.last_output = time.monotonic()
        self.subscribers = [rospy.Subscriber('/diagnostics', DiagnosticArray, self.on_diagnostics, queue_size=100),
                            rospy.Subscriber('/tf', TFMessage, self.on_tf, queue_size=1000)]

    def touch(self):
        self.last_output = time.monotonic()

    def follow(self, bag, player):
        """Hears how far the player of this name is: it gives no /clock while it is behind its own time, as on a busy machine. By the bag's index: stamps may be of a clock that steps."""
        self.end = bag.end
        for robot in self.robots.values():
            topic = recorded(bag, robot.image)
            robot.delay = bag.delay(topic)
            times = [time for time in bag.times(topic, self.begin) if time <= bag.end] if topic else []
            robot.span = (times[0] - robot.delay, times[-1] - robot.delay) if times else None
        for name, kind in (('sensor_msgs/CameraInfo', CameraInfo), ('sensor_msgs/Imu', Imu)):
            topics = [topic for topic, of in bag.types.items() if of == name]
            if topics:
                self.subscribers += [rospy.Subscriber(topic, kind, self.on_played, (player, iter(bag.times(topic, self.begin))), queue_size=1000) for topic in topics]
                return

    def on_played(self, message, expected):
        """expected: name of the player, and when its next messages on this topic were recorded. One that is lost has them told too early, not too late."""
        player, times = expected
        if message._connection_header.get('callerid') == player:  # publish_calibration may publish it, too
            self.played = max(self.played, next(times, self.played))

    def now(self):
        """The bag's time: the clock's, or what was played where the player gives none [s]. After the bag's end it goes on as the wall's."""
        clock = max(rospy.get_time(), self.played)
        return clock if self.ended is None else max(clock, self.ended[0] + time.monotonic() - self.ended[1])

    def clock_ends(self):
        """The bag has ended: what the nodes still work on comes later than its clock says."""
        self.ended = (self.now(), time.monotonic())

    def advance(self, node, time):
        if self.begin <= time <= self.end + 1 and time > self.progress.get(node, 0.0):
            self.progress[node] = time

    def hear_status(self, robot, message):
        """Takes a VoStatus of a robot's odometry."""
        with self.lock:
            robot.heard(message)
            self.advance(robot.node, message.header.stamp.to_sec() + robot.delay)
            if message.state != VoStatus.STATE_WAITING:  # said again and again while images wait for what never comes
                self.touch()

    def on_diagnostics(self, message):
        with self.lock:
            for status in message.status:
                # "<node>: <task>", as diagnostic_updater names them; two instances of a program share their hardware id.
                for name in (status.name.split(':')[0].strip().lstrip('/'), status.hardware_id):
                    if name in self.nodes:
                        self.diagnostics[name] = {v.key: v.value for v in status.values}
                        self.said[name] = status.message
                        break

    def loading(self, node):
        """What a node says that still reads what it needs; else ''."""
        with self.lock:
            said = self.said.get(node.strip('/'), '')
        return said if said.startswith(LOADING) else ''

    def reason(self, robot):
        """Why a robot gives no pose, as far as anything was heard."""
        status = robot.last_status
        if status is not None and status.reason:
            return status.reason
        if status is None and robot.image in self.missing:
            return self.missing[robot.image]
        return self.said.get(robot.node) or f'{robot.node} has said nothing: see its lines above'

    def progress_of(self, name, robot):
        """A robot's part of the progress lines."""
        if robot.switched_off():
            return f'{name} switched off'
        state = STATES.get(robot.last_status.state, '?').lower() if robot.last_status is not None else 'without a word'
        return f'{name} {state}' + ('' if state == 'tracking' else f' ({self.reason(robot)})')

    def on_tf(self, message):
        node = message._connection_header.get('callerid', '?').lstrip('/')
        with self.lock:
            for edge in message.transforms:
                name = f'{edge.header.frame_id.lstrip("/")} -> {edge.child_frame_id.lstrip("/")}'
                self.tf_publishers.setdefault(name, set()).add(node)

    def losses(self):
        """A line for each topic that no node takes, and for each counter of dropped or doubtful data in the last diagnostics."""
        with self.lock:
            return self.refused + [f'{node}: {key}: {value}' for node, values in sorted(self.diagnostics.items()) for key, value in values.items()
                    if ('dropped' in key or 'in doubt' in key) and value.strip() not in ('', '0')]


def node_exists(name):
    try:
        rosgraph.Master(CALLER).lookupNode(rospy.resolve_name(name))
        return True
    except (rosgraph.MasterException, OSError):
        return False


def _system_state():
    """Publishers and subscribers by the master: topic -> names of the nodes."""
    publishers, subscribers, _ = rosgraph.Master(CALLER).getSystemState()
    return dict(publishers), dict(subscribers)


def not_listening(nodes, topics):
    """Those of the nodes that have subscribed to none of the topics: their constructors have not come so far."""
    try:
        subscribers = _system_state()[1]
    except (rosgraph.MasterException, OSError):
        return list(nodes)
    return [node for node in nodes if not any(rospy.resolve_name(node) in subscribers.get(rospy.resolve_name(topic), []) for topic in topics)]


def unconnected():
    """(topic, publisher, subscriber) that the master knows, but between which no message could pass yet. Nodes that do not answer are left out."""
    master, missing = rosgraph.Master(CALLER), []
    try:
        publishers, subscribers = _system_state()
        for node in sorted({node for nodes in publishers.values() for node in nodes}):
            wanted = {(topic, listener) for topic, nodes in publishers.items() if node in nodes
                      for listener in subscribers.get(topic, []) if listener != node and topic not in ('/rosout', '/rosout_agg')}
            if not wanted:
                continue
            try:
                connections = xmlrpc.client.ServerProxy(master.lookupNode(node)).getBusInfo(CALLER)[2]
            except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
                continue
            missing += [(topic, node, listener) for topic, listener in sorted(wanted - {(c[4], c[1]) for c in connections if c[2] == 'o'})]
    except (rosgraph.MasterException, OSError):
        pass
    return missing


def wait_to_listen(topics, nodes, more_topics=(), timeout=60.0, loading=lambda node: ''):
    """Waits until each of the nodes has subscribed to one of the topics that are played (tf aside) or of `more_topics`. False when one did not come.

    loading: what a node says that still reads what it needs, else ''. The time [s] begins when none does.
    """
    topics = [topic for topic in topics if topic.strip('/') not in ('tf', 'tf_static', 'clock')] + list(more_topics)
    begin = shown = time.monotonic()
    while not rospy.is_shutdown():
        missing = not_listening(nodes, topics)
        if not missing:
            return True
        busy = [f'{node} is {line}' for node, line in zip(missing, map(loading, missing)) if line]
        now = time.monotonic()
        if busy:
            begin = now
            if now - shown > SAY_AGAIN:
                shown = now
                rospy.loginfo('still waiting: %s', '; '.join(busy))
        elif now - begin > timeout:
            rospy.logerr('no sign of %s: subscribed to no topic of the bag. The lines above say whether it started; its inputs are arguments of the launch file', ', '.join(missing))
            return False
        time.sleep(0.2)
    return False


def missing_inputs(bag, inputs, patience=5.0):
    """Topic -> why nothing can come on it, for those of `inputs` (argument, topic, message type) that neither bag nor node publishes.

    Nodes that make an input out of the bag's (publish_calibration, image_proc) have `patience` [s] to come up.
    """
    end = time.monotonic() + patience
    while True:
        result = _missing_now(bag, inputs)
        if not result or time.monotonic() > end or rospy.is_shutdown():
            return result
        time.sleep(0.2)


def _missing_now(bag, inputs):
    try:
        published, listeners = _system_state()
    except (rosgraph.MasterException, OSError):
        published, listeners = {}, {}
    result = {}
    for argument, topic, kind in inputs:
        topic = rospy.resolve_name(topic)
        compressed = [f'{topic}/{name}' for name in TRANSPORTS if f'{topic}/{name}' in bag.types]
        if otherwise := bag.defined_otherwise(topic):
            result[topic] = otherwise
            continue
        if topic in bag.types or published.get(topic) or any(listeners.get(t) for t in compressed):
            continue
        others = bag.of_type(kind)
        if compressed:
            hint = f'it has {compressed[0]}: set {bag_guess.compressed_argument(bag, argument, topic)}'
        elif others:
            hint = f'of type {kind} it has {", ".join(others)}: set {argument}:='
        else:
            hint = f'it has none of type {kind}'
        result[topic] = f'no message on {topic}: the bag has no such topic; {hint}'
    return result


def begin(recorder, bag, player, inputs, more_topics=()):
    """Lets the bag go when the nodes of ~wait_for listen to it, or to `more_topics`, and all connections stand; else says why not, and what to do. inputs: see missing_inputs."""
    if not player.wait_until_ready():
        return f'rosbag play did not start with {bag.path}: its lines above say why'
    nodes = rospy.get_param('~wait_for', '').split()
    if nodes:
        rospy.loginfo('waiting for %s: a localizer loads its database', ', '.join(nodes))
    if not wait_to_listen(player.topics, nodes, [*(topic for _, topic, _ in inputs), *more_topics], 600.0, recorder.loading):
        return 'a node did not start: the lines above say why'
    recorder.missing = missing_inputs(bag, inputs)
    for line in recorder.missing.values():
        rospy.logerr('%s', line)
    if recorder.missing:
        return 'nothing to replay: the lines above say which arguments to set; rosrun air_ground check_bag --city proposes them'
    if not let_go(recorder, bag, player):
        return f'rosbag play ended with {bag.path} before it began: its lines above say why'
    return None


def let_go(recorder, bag, player, timeout=30.0):
    """Lets a player that began paused go once all publishers and subscribers are connected; False when it has ended before."""
    if not player.wait_until_ready():
        return False
    begin = time.monotonic()
    while True:
        missing = unconnected()
        refused = sorted({topic for topic, publisher, _ in missing if publisher == player.name and bag.defined_otherwise(topic)})
        missing = [(topic, *nodes) for topic, *nodes in missing if topic not in refused]
        if not missing or rospy.is_shutdown() or time.monotonic() - begin > timeout:
            break
        time.sleep(0.2)
    recorder.refused = [bag.defined_otherwise(topic) for topic in refused]
    for line in recorder.refused:
        rospy.logerr('%s', line)
    for topic, publisher, listener in missing:
        rospy.logwarn('%s: no connection from %s to %s; the bag plays without. Where a line above speaks of md5sum, they define the message otherwise: build both from one version; '
                      'else see whether both machines know each other\'s address (ROS_IP)', topic, publisher, listener)
    return player.pause(False)


def play_to_end(recorder, player, end, limits, summary):
    """Returns, when the bag has ended, for how long the player was held [s]. Shows summary() at every 10 % of the bag."""
    pacer, clock = Pacer(recorder, player, limits), ClockKeeper()
    shown = 0
    while not rospy.is_shutdown() and player.running():
        now = recorder.now()
        if now > 0:
            if not pacer.paused:
                clock.step(recorder.played)
            pacer.step(now, may_hold=not clock.leads())
            tenth = int(10 * (now - recorder.begin) / max(end - recorder.begin, 1e-3))
            if tenth > shown and tenth <= 10:
                shown = tenth
                rospy.loginfo('replay %d %%: %s', 10 * tenth, summary())
            if now >= end - 0.05:
                break
        time.sleep(0.1)
    pacer.release()
    held = sum(pacer.held_for.values(), 0.0)
    if held > 1:
        rospy.loginfo('the player was held for %.0f s in all so that the nodes could keep up (%s)', held,
                      ', '.join(f'{name}: {seconds:.0f} s' for name, seconds in pacer.held_for.most_common()))
    return held


def end_launch(line, failed=False):
    """Says how the replay ended, and ends the launch that this node belongs to, as Ctrl-C would: when a required node ends by itself,
    roslaunch calls it a death, in red. Under another parent than roslaunch the node just ends. Returns its exit status; roslaunch has none of
    its own, so the status also goes into the file that AIR_GROUND_REPLAY_STATUS names, for who started the launch (see demo.launch).
    """
    (rospy.logfatal if failed else rospy.loginfo)(line)
    if os.environ.get('AIR_GROUND_REPLAY_STATUS'):
        with open(os.environ['AIR_GROUND_REPLAY_STATUS'], 'w', encoding='ascii') as stream:
            stream.write(str(int(failed)))
    time.sleep(0.2)  # the line before those of roslaunch
    try:
        with open(f'/proc/{os.getppid()}/cmdline', 'rb') as stream:
            words = [os.path.basename(word) for word in stream.read().split(b'\0')[:3]]
    except OSError:
        words = []
    if b'roslaunch' in words and not rospy.is_shutdown():
        os.kill(os.getppid(), signal.SIGINT)
        stop = time.monotonic() + 20
        while not rospy.is_shutdown() and time.monotonic() < stop:
            time.sleep(0.05)
    return int(failed)


def wait_for_rest(recorder, idle_time, limit):
    """Returns when the nodes publish nothing more and want little CPU, at the latest after `limit` [s]."""
    load = CpuLoad(recorder.nodes)
    begin = quiet_since = time.monotonic()
    load.cores()
    while not rospy.is_shutdown() and time.monotonic() - begin < limit:
        time.sleep(min(1.0, idle_time))
        now = time.monotonic()
        load.cores()
        if sum(load.wanted.values()) > 0.3 or now - recorder.last_output < 1.0:
            quiet_since = now
        if now - quiet_since >= idle_time:
            return
    if rospy.is_shutdown():
        rospy.logwarn('the launch is ending (a node that it requires died, or it was interrupted): the report is written now, with what the nodes have given so far')
        return
    rospy.logwarn('the nodes were still busy %.0f s after the end of the bag (idle_limit): the report is written now, without what they have yet to do', limit)


def make_room(folder, names):
    """move_aside, which it says."""
    earlier = move_aside(folder, names)
    if earlier:
        rospy.loginfo('the results of an earlier replay are now in %s: another out:= keeps both apart', earlier)


def save(service, kind, path, notes):
    """Calls a node's save service; says in `notes` why nothing came."""
    try:
        rospy.wait_for_service(service, timeout=2.0)
        answer = rospy.ServiceProxy(service, kind)(path)
    except (rospy.ROSException, rospy.ServiceException) as error:
        notes.append(f'{service}: {error}')
        return False
    if not answer.success:
        notes.append(f'{service}: {answer.message}')
    return answer.success and os.path.isfile(path)


def take_screenshot(path, notes):
    """A picture of rviz's window through X; needs xwininfo (x11-utils) and import (ImageMagick)."""
    if not os.environ.get('DISPLAY'):
        notes.append('no screenshot: there is no DISPLAY')
        return
    try:
        tree = subprocess.run(['xwininfo', '-root', '-tree'], capture_output=True, text=True, timeout=10, check=True).stdout
        windows = re.findall(r'(0x[0-9a-f]+) "[^"]*RViz[^"]*".*?(\d+)x(\d+)\+', tree)
        if not windows:
            notes.append('no screenshot: rviz shows no window')
            return
        window = max(windows, key=lambda w: int(w[1]) * int(w[2]))[0]
        subprocess.run(['import', '-window', window, path], capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError) as error:
        notes.append(f'no screenshot: {error}')
