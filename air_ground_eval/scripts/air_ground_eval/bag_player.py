"""Plays a bag to nodes, its static transforms whole, and without what the nodes publish themselves.

`rosbag play` publishes /tf_static as it was recorded: of several latched messages a node that connects late gets the last, of others none. So
the union of all of them is published here, latched, for as long as the player lives, and the player's own goes where nobody listens. The same
holds for those on /tf that never change. What else is on /tf is handed on but for the edges that say where a frame is that a node, or the static
transforms, say otherwise: a frame with two parents leaves tf in pieces. A recorded /clock is left out. So is a static transform of a frame that another node
publishes one of (publish_calibration): that one corrects the bag, and what it says on /tf. So are the topics that the launch's own nodes publish (own_outputs.py): a bag that was
recorded while the suite ran holds that run's. So is what was recorded at another time than the sensors' messages (BagFacts.elsewhen), and where nothing was recorded for a minute, the clock leaps:
`rosbag play` would wait until then, for years where a clock was set.
"""
import re
import subprocess
import time

import numpy as np
import rosgraph
import rospy
from roslib.packages import find_node
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage

from . import own_outputs
from .bag_reader import APART

NAME = re.compile(r'[A-Za-z~/][A-Za-z0-9_/]*')  # of a topic, as ROS takes it; a recording may hold others, of which rosbag play dies
SHOWN = 3  # topics that are named as left out


def playable(topics):
    """(those that can be played, those that cannot: their names are none in ROS), in order."""
    names = sorted(set(topics) - {'/clock'})
    return [t for t in names if NAME.fullmatch(t)], [t for t in names if not NAME.fullmatch(t)]


def stretch(bag, start):
    """Options of `rosbag play` for what lies between begin and end of the recording, from `start` [s] after its begin on."""
    first, last = bag.recorded
    skipped = start
    if first < bag.begin:  # it counts from the first of all messages, and has 24 bits for that: rounded down
        skipped = float(np.nextafter(np.float32(start + bag.begin - first), np.float32(0)))
    most = [f'--duration={max(bag.end - first - skipped, 0) + 1}'] if bag.end < last else []
    return [f'--start={skipped}', *most, f'--skip-empty={APART:.0f}']


class StaticTransforms:
    """Publishes the static transforms of a bag, latched, but for those of frames whose place another node publishes on /tf_static.

    transforms: TFMessage; patience [s]: to hear those that publish there already.
    """

    def __init__(self, transforms, patience=2.0):
        self.transforms, self.heard, self.claimed = transforms, set(), set()  # claimed: frames whose place others publish
        self.publisher = None
        self.subscriber = rospy.Subscriber('/tf_static', TFMessage, self.hear, queue_size=100)
        end = time.monotonic() + patience
        while not rospy.is_shutdown() and time.monotonic() < end and self._others() - self.heard:
            time.sleep(0.05)
        self.publisher = rospy.Publisher('/tf_static', TFMessage, queue_size=1, latch=True)
        if self.transforms.transforms:
            self.publisher.publish(self.transforms)

    def _others(self):
        """Names of the nodes that publish static transforms."""
        try:
            published = rosgraph.Master(rospy.get_name()).getSystemState()[0]
        except (rosgraph.MasterException, OSError):
            return set()
        return {node for topic, nodes in published if topic == '/tf_static' for node in nodes} - {rospy.get_name()}

    def hear(self, message):
        """A message of any node, this one too."""
        caller = message._connection_header.get('callerid', '')
        if caller == rospy.get_name():
            return
        self.heard.add(caller)
        self.claimed |= {edge.child_frame_id.lstrip('/') for edge in message.transforms}
        ours = [edge for edge in self.transforms.transforms if edge.child_frame_id.lstrip('/') in self.claimed]
        if not ours:
            return
        for edge in ours:
            rospy.loginfo('where %s is, %s says: what the bag says of it is left out', edge.child_frame_id, caller)
        self.transforms = TFMessage([edge for edge in self.transforms.transforms if edge not in ours])
        if self.publisher is not None:  # for those who come later; who has heard both goes by the last, the other node's
            self.publisher.publish(self.transforms)


class BagPlayer:
    """`rosbag play` as a child of this node, under its own node name; it begins paused. bag: BagFacts; nodes: whose outputs are not played (own_outputs.running).

    topics: those that are played.
    """

    def __init__(self, bag, name='player', rate=1.0, start=0.0, nodes=None):
        self.static, self.chains = None, own_outputs.chains(nodes or {})
        static = bag.static_transforms(chains=self.chains)
        if static.transforms or '/tf' in bag.types:
            self.static = StaticTransforms(static)
        self.name = rospy.resolve_name(name)
        command = find_node('rosbag', 'play')[:1] + ['--quiet', '--clock', '--hz=200', '--queue=2000', f'--rate={rate}', *stretch(bag, start), '--pause']
        self.topics, others = playable(bag.types)
        if others:
            rospy.logwarn('%d topic(s) of the bag left out, whose names ROS does not take: %s%s', len(others), ', '.join(others[:SHOWN]), ' ...' if len(others) > SHOWN else '')
        self._leave_out(own_outputs.published(nodes or {}))
        command += ['--topics', *self.topics, '--bags', bag.path] if len(self.topics) < len(bag.types) else [bag.path]
        command += ['/tf_static:=/tf_static_of_bag', f'__name:={name}']
        if '/tf' in bag.types:
            command.append('/tf:=/tf_of_bag')
            self.others = {*(frame for chain in self.chains for frame in chain[1:]), *(edge.child_frame_id for edge in static.transforms)}
            self.left_out = set()
            self.moving = rospy.Publisher('/tf', TFMessage, queue_size=100)
            self.relay = rospy.Subscriber('/tf_of_bag', TFMessage, self._hand_on, queue_size=1000)
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        rospy.on_shutdown(self.stop)

    def _leave_out(self, published):
        """What was recorded of the topics that nodes publish in this run, too."""
        own = [topic for topic in self.topics if f'/{topic.lstrip("/")}' in published]
        self.topics = [topic for topic in self.topics if topic not in own]
        if own:
            rospy.loginfo('topics of the bag that are not played, since nodes of this launch publish them: %s', ', '.join(own))
        if not self.topics:
            rospy.logerr('there is nothing else in the bag: no images, no IMU')

    def _is_said_otherwise(self, edge):
        """By nodes or static transforms. Between two frames of a chain the other way round, too: mav_map -> ground_map, where that was recorded with inverse_tf."""
        parent, child = edge.header.frame_id.lstrip('/'), edge.child_frame_id.lstrip('/')
        return child in self.others or self.static is not None and child in self.static.claimed or any(parent in chain and child in chain for chain in self.chains)

    def _hand_on(self, message):
        said = [(edge, self._is_said_otherwise(edge)) for edge in message.transforms]
        kept = [edge for edge, otherwise in said if not otherwise]
        new = {edge.child_frame_id.lstrip('/') for edge, otherwise in said if otherwise} - self.left_out
        if new:
            self.left_out |= new
            rospy.loginfo('/tf of the bag: what it says of %s is left out, since nodes or the static transforms say so', ', '.join(sorted(new)))
        if kept:
            self.moving.publish(TFMessage(kept))

    def running(self):
        return self.process.poll() is None

    def pause(self, pause):
        """False when the player has ended."""
        try:
            rospy.ServiceProxy(self.name + '/pause_playback', SetBool)(pause)
            return True
        except (rospy.ServiceException, rospy.ROSException):
            return False

    def wait_until_ready(self, timeout=60.0):
        """Until it has opened the bag and advertised its topics: its service is there before, but answers only then."""
        end = time.monotonic() + timeout
        while self.running() and time.monotonic() < end and not rospy.is_shutdown():
            try:
                rospy.wait_for_service(self.name + '/pause_playback', timeout=1.0)
                return self.pause(True)
            except rospy.ROSException:
                continue
        return False

    def stop(self):
        if self.running():
            self.process.terminate()
            try:
                self.process.wait(5)
            except subprocess.TimeoutExpired:
                self.process.kill()
