"""What the tests of faults share: a rendered bag that is played to live nodes, each topic through a relay that can spoil it."""
import collections
import os
import sys
import time

import rosbag
import roslib.message
import rospy
from air_ground.msg import VoStatus
from diagnostic_msgs.msg import DiagnosticArray
from tf2_msgs.msg import TFMessage

sys.path.insert(0, os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'air_ground_eval', 'scripts'))
from air_ground_eval import bag_reader, demo  # noqa: E402
from air_ground_eval.fault_relay import FaultRelay  # noqa: E402

LAG = 0.4    # behind what was sent, from which on the bag waits [s]
STALL = 5.0  # without a word, from which on it does not [s]
Said = collections.namedtuple('Said', 'state map_id reason')


class LiveBag:
    """Plays the bag of ~world, ~seed and ~simulate (options of the simulator) at ~rate. robots: name -> (topics, status topic)."""

    def __init__(self, robots):
        path = demo.rendered_bag('faults', str(rospy.get_param('~world')), rospy.get_param('~seed'), ['--quiet'] + str(rospy.get_param('~simulate')).split())
        self.rate = rospy.get_param('~rate', 1.0)
        self.facts = bag_reader.BagFacts(path)
        self.bag = rosbag.Bag(path)
        self.relays = {topic: FaultRelay(None, topic) for topics, _ in robots.values() for topic in topics}
        self.robots = {name: topics for name, (topics, _) in robots.items()}
        self.swapped = {}  # topic -> topic on which its messages come instead
        self.static = rospy.Publisher('/tf_static', TFMessage, queue_size=1, latch=True)
        self.static.publish(self.facts.static_transforms(('mav_base_link', 'ground_base_link')))
        self.said = {name: Said(None, 0, 'nothing') for name in robots}
        self.history = {name: [] for name in robots}
        self.sent, self.heard = {}, {}  # robot -> newest stamp [s]; and when it was heard
        self.counters = {}
        self.subscribers = [rospy.Subscriber(status, VoStatus, self.on_status, name, queue_size=1000) for name, (_, status) in robots.items()]
        self.subscribers.append(rospy.Subscriber('/diagnostics', DiagnosticArray, self.on_diagnostics, queue_size=100))
        for topic, relay in self.relays.items():
            kind = self.bag.get_type_and_topic_info(topic_filters=[topic]).topics[topic].msg_type
            relay.advertise(roslib.message.get_message_class(kind))
        self.rewind(0)

    def on_status(self, status, name):
        self.heard[name] = (status.header.stamp.to_sec(), time.monotonic())
        self.said[name] = Said(status.state, status.map_id, status.reason)
        self.history[name].append(self.said[name])

    def on_diagnostics(self, message):
        for status in message.status:
            self.counters[status.name.split(':')[0]] = {value.key: value.value for value in status.values}

    def counted(self, node, event):
        return any(event in key and value not in ('', '0') for key, value in self.counters.get(node, {}).items())

    def wait_for_listeners(self, timeout=60):
        end = time.monotonic() + timeout
        while deaf := [topic for topic, relay in self.relays.items() if not relay.publisher.get_num_connections()]:
            if time.monotonic() > end:
                raise AssertionError(f'nobody listens to {", ".join(deaf)}')
            time.sleep(0.1)

    def rewind(self, position):
        """To so many seconds after the bag's begin."""
        self.position, self.begin = position, self.bag.get_start_time()
        self.messages = self.bag.read_messages(topics=list(self.relays), start_time=rospy.Time(self.begin + position))
        self.origin = None

    def spoil(self, robot, **faults):
        """Sets the faults of a robot's topics; what they jump in time stays."""
        for topic in self.robots[robot]:
            jump = self.relays[topic].faults.get('jump')
            self.relays[topic].faults = dict(faults, **({'jump': jump} if jump and 'jump' not in faults else {}))

    def lags(self):
        """A robot's node is behind and working on it: a slow machine plays more slowly, instead of making another test of this."""
        now = time.monotonic()
        return any(self.sent.get(name, 0) - stamp > LAG and now - at < STALL for name, (stamp, at) in self.heard.items())

    def send(self, topic, message):
        target = self.swapped.get(topic, topic)
        self.relays[target].send(message)
        for name, topics in self.robots.items():
            faults = self.relays[target].faults
            if topic == topics[0]:
                self.sent[name] = 0 if set(faults) - {'jump'} or self.swapped else message.header.stamp.to_sec() + faults.get('jump', 0)

    def play(self, seconds, until=None):
        """Plays so much of the bag, or until the condition holds, for which it waits a while at the end: whether it does."""
        self.origin = time.monotonic() - self.position / self.rate
        end = self.position + seconds
        for topic, message, stamp in self.messages:
            self.position = stamp.to_sec() - self.begin
            time.sleep(max(0, self.origin + self.position / self.rate - time.monotonic()))
            while self.lags():
                time.sleep(0.02)
                self.origin = time.monotonic() - self.position / self.rate
            self.send(topic, message)
            if self.position >= end or (until and until()):
                break
        patience = time.monotonic() + STALL
        while until and not until() and (self.lags() or time.monotonic() < patience):
            time.sleep(0.05)
        return bool(until and until())

    def tracks(self, *names):
        return all(self.said[name].state == VoStatus.STATE_TRACKING for name in names)
