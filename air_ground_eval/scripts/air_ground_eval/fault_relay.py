"""Stands between a publisher and a node, and spoils what passes: drops, delays, reorders, duplicates, corrupts, freezes, jumps in time."""
import io
import random
import struct
import threading

import genpy
import roslib.message
import rospy

FAULTS = ('drop', 'delay', 'reorder', 'duplicate', 'corrupt', 'freeze', 'jump')


class FaultRelay:
    """Passes messages from one topic to another. `faults`, which may be replaced at any time, maps names to amounts:

    drop, duplicate, corrupt: share of the messages (0 .. 1); corrupt: some bytes of the message are others
    delay: each comes so much later [s, wall clock]; reorder: so many are held and then sent backwards
    freeze: the message of that moment comes again and again (true); jump: added to the stamps [s]
    """

    def __init__(self, source, target, faults=None, seed=1, queue=1000):
        self.random = random.Random(seed)
        self.faults = faults or {}
        self.source, self.target, self.queue = source, target, queue
        self.lock, self.kind, self.publisher = threading.Lock(), None, None
        self.held, self.frozen = [], None
        self.subscriber = rospy.Subscriber(source, rospy.AnyMsg, self.take, queue_size=queue) if source else None

    def advertise(self, kind):
        """Publishes messages of this class; a relay of a topic finds it out by itself."""
        self.kind = kind
        self.publisher = rospy.Publisher(self.target, kind, queue_size=self.queue)

    def take(self, raw):
        with self.lock:
            if self.kind is None:
                self.advertise(roslib.message.get_message_class(raw._connection_header['type']))
            self.spoil(raw._buff)

    def send(self, message):
        """Takes a message that comes from the caller instead of a topic."""
        with self.lock:
            if self.kind is None:
                self.advertise(type(message))
            if not self.faults and not self.held:
                self.publisher.publish(message)
                return
            stream = io.BytesIO()
            message.serialize(stream)
            self.spoil(stream.getvalue())

    def chance(self, name):
        return self.random.random() < self.faults.get(name, 0)

    def spoil(self, data):
        if self.faults.get('freeze'):
            self.frozen = data = self.frozen or data
        else:
            self.frozen = None
        if self.chance('drop'):
            return
        if self.faults.get('jump') and hasattr(self.kind(), 'header'):
            data = shifted(data, self.faults['jump'])
        if self.chance('corrupt'):
            data = bytearray(data)
            for _ in range(max(4, len(data) // 2000)):
                data[self.random.randrange(len(data))] = self.random.randrange(256)
            data = bytes(data)
        self.held += [data] * (2 if self.chance('duplicate') else 1)
        if len(self.held) <= self.faults.get('reorder', 0):
            return
        if self.faults.get('reorder'):
            self.held.reverse()
        for one in self.held:
            if self.faults.get('delay'):
                threading.Timer(self.faults['delay'], self.publish, [one]).start()
            else:
                self.publish(one)
        self.held = []

    def publish(self, data):
        message = self.kind()
        try:
            message.deserialize(data)
            self.publisher.publish(message)
        except (genpy.DeserializationError, genpy.SerializationError, UnicodeDecodeError, struct.error, rospy.ROSException):
            pass  # spoilt beyond what a publisher could send


def shifted(data, seconds):
    """A serialised message with header, its stamp later by so much."""
    secs, nsecs = struct.unpack_from('<II', data, 4)
    stamp = secs * 10 ** 9 + nsecs + int(round(seconds * 1e9))
    return data[:4] + struct.pack('<II', *divmod(max(stamp, 0), 10 ** 9)) + data[12:]
