"""One bag of two robots that each recorded their own, or of two stretches of one recording, each taken for a robot's."""
import heapq
import os
import re

import genpy
import rosbag

from .bag_guess import IMAGE_TYPES, raw_name
from .bag_reader import BagError, BagFacts, open_bag

SHARED = ('/tf', '/tf_static', '/clock', '/rosout', '/rosout_agg', '/diagnostics')  # topics of many publishers
COMMON_FRAMES = {'world', 'earth', 'mocap'}  # of a reference that sees both robots
TF_TYPES = ('tf2_msgs/TFMessage', 'tf/tfMessage')
STATIC = ('/tf_static', 'tf_static')
CAMERA_TYPES = (*IMAGE_TYPES, 'theora_image_transport/Packet', 'sensor_msgs/CameraInfo')
DROPPED = ('/clock',)  # one for both: the player's


def frames_of(facts):
    """Frames that a bag names: in transforms, and in the first message of each topic with a header."""
    names = {frame for edge in facts.edges for frame in edge}
    with open_bag(facts.path) as bag:
        for topic in facts.types:
            for _, message, _ in bag.read_messages([topic]):
                if message._type in TF_TYPES:
                    names |= {frame for edge in message.transforms for frame in (edge.header.frame_id, edge.child_frame_id)}
                elif hasattr(message, 'header'):
                    names.add(message.header.frame_id)
                break
    return {name.lstrip('/') for name in names} - {''}


def stretch(argument):
    """(path, first, last) of x.bag@FIRST-LAST, in seconds from the bag's begin; (path, 0, None) of x.bag, and None for the last of x.bag@FIRST-. BagError for an empty one."""
    match = re.fullmatch(r'(.+)@(\d+(?:\.\d*)?)-(\d+(?:\.\d*)?)?', argument)
    if match is None or os.path.exists(argument):
        return argument, 0.0, None
    first, last = float(match[2]), float(match[3]) if match[3] else None
    if last is not None and last <= first:
        raise BagError(f'{argument}: it ends before it begins: expected BAG@FIRST-LAST, seconds from the bag\'s begin')
    return match[1], first, last


class Part:
    """A robot's bag, or a stretch of it, and what its topics, frames and times become in the merged one."""

    def __init__(self, robot, argument):
        path, first, last = stretch(argument)
        self.robot, self.facts = robot, BagFacts(path)
        self.whole = first == 0 and last is None
        self.first = self.facts.begin + first
        self.last = self.facts.end if last is None else min(self.facts.end, self.facts.begin + last)
        if self.first >= self.last and not self.whole:
            raise BagError(f'{argument}: nothing lies there: {path} is {self.facts.end - self.facts.begin:.1f} s long')
        self.frames, self.topics, self.shift = {}, {}, genpy.Duration()

    def begin(self):
        return self.first + self.shift.to_sec()

    def end(self):
        return self.last + self.shift.to_sec()

    def frame(self, name):
        return self.frames.get(name.lstrip('/'), name)

    def changed(self, message):
        if message._type in TF_TYPES:
            for edge in message.transforms:
                edge.header.stamp += self.shift
                edge.header.frame_id, edge.child_frame_id = self.frame(edge.header.frame_id), self.frame(edge.child_frame_id)
        elif hasattr(message, 'header'):
            if message.header.stamp:
                message.header.stamp += self.shift
            message.header.frame_id = self.frame(message.header.frame_id)
            if hasattr(message, 'child_frame_id'):
                message.child_frame_id = self.frame(message.child_frame_id)
        return message

    def messages(self, order):
        """(time [ns], order, topic, message, connection header), in order of time."""
        first, last = genpy.Time.from_sec(self.first), genpy.Time.from_sec(self.last)
        window = {} if self.first == self.facts.begin else dict(start_time=first)
        window.update({} if self.last == self.facts.end else dict(end_time=last - genpy.Duration(0, 1)))
        with open_bag(self.facts.path) as bag:
            for topic, message, header in () if self.whole else self._held(bag, first):
                yield (first + self.shift).to_nsec(), order, self.topics.get(topic, topic), self.changed(message), header
            for topic, message, time, header in bag.read_messages(return_connection_header=True, **window):
                if topic not in DROPPED and (self.whole or topic not in STATIC):
                    yield (time + self.shift).to_nsec(), order, self.topics.get(topic, topic), self.changed(message), header

    def _held(self, bag, first):
        """What a stretch holds from its begin on, though it was recorded before, or, static transforms, at any time: (topic, message, connection header)."""
        static = [topic for topic in STATIC if topic in self.facts.types]
        for topic, message, _, header in bag.read_messages(static, return_connection_header=True) if static else ():
            yield topic, message, {**header, 'latching': '1'}
        infos, newest = self.facts.of_type('sensor_msgs/CameraInfo'), {}
        for topic, message, _, header in bag.read_messages(infos, end_time=first - genpy.Duration(0, 1), return_connection_header=True) if infos else ():
            newest[topic] = message, header
        for topic, (message, header) in sorted(newest.items()):
            yield topic, message, header


def shifts(paths, topics):
    """topic -> what its stamps lack to the times of recording (the median); None where they are zero. BagError for a topic that no part has."""
    delays = {topic: [] for topic in topics}
    for path in paths:
        with open_bag(path) as bag:
            for topic, message, time in bag.read_messages(topics) if topics else ():
                if hasattr(message, 'header'):
                    delays[topic].append((time - message.header.stamp).to_nsec() if message.header.stamp else None)
    for topic, found in delays.items():
        if not found:
            raise BagError(f'--restamp {topic}: no bag has stamps on this topic')
    return {topic: None if None in found else genpy.Duration(0, sorted(found)[len(found) // 2]) for topic, found in delays.items()}


class Restamped:
    """A part of a recording, with other stamps on some topics."""

    def __init__(self, path, shifts_of_topics):
        self.path, self.shifts = path, shifts_of_topics

    def messages(self, order):
        """As Part's."""
        with open_bag(self.path) as bag:
            for topic, message, time, header in bag.read_messages(return_connection_header=True):
                if topic in self.shifts:
                    shift = self.shifts[topic]
                    message.header.stamp = time if shift is None else message.header.stamp + shift
                yield time.to_nsec(), order, topic, message, header


def _name(topic):
    """What a topic is of, whatever its transport."""
    return topic[:-len('/theora')] if topic.endswith('/theora') else raw_name(topic)


def _folder(topic):
    return _name(topic).rpartition('/')[0]


def renamed(parts):
    """Of each part the topics that both name, in any transport. A camera's images and calibration are known by their folder: they stay together."""
    names = set.intersection(*({_name(topic) for topic in part.facts.types} for part in parts)) - set(SHARED)
    cameras = [{topic for topic, kind in part.facts.types.items() if kind in CAMERA_TYPES} for part in parts]
    folders = {_folder(topic) for topic in set.union(*cameras) if _name(topic) in names}
    return [{topic for topic in part.facts.types if _name(topic) in names or topic in camera and _folder(topic) in folders} for part, camera in zip(parts, cameras)]


def plan(mav, ground, begin_together):
    """The two parts, of bags or stretches of them (BAG@FIRST-LAST). Topics and frames that both bags name get their robot's name in front, so that each is one robot's."""
    parts = [Part('mav', mav), Part('ground', ground)]
    frames = frames_of(parts[0].facts) & (frames_of(parts[1].facts) - COMMON_FRAMES)
    for part, topics in zip(parts, renamed(parts)):
        part.topics = {topic: f'/{part.robot}{topic}' for topic in topics}
        part.frames = {frame: f'{part.robot}_{frame}' for frame in frames}
    if begin_together:
        parts[1].shift = genpy.Duration.from_sec(parts[0].first - parts[1].first)
    return parts


def merge(parts, out, compression='lz4'):
    """Writes the bag and gives the number of messages. BagError where it cannot be written."""
    count = 0
    try:
        with rosbag.Bag(out, 'w', compression=compression) as bag:
            # Stamps and topics decide, never the messages themselves, which have no order.
            for time, order, topic, message, header in heapq.merge(*(part.messages(i) for i, part in enumerate(parts)), key=lambda item: item[:2]):
                bag.write(topic, message, genpy.Time(time // 10**9, time % 10**9), connection_header={**header, 'topic': topic} if header else None)
                count += 1
    except OSError as error:
        raise BagError(f'{out} cannot be written ({error.strerror or error})') from error
    return count
