"""One bag of two robots that each recorded their own, or of two stretches of one recording, each taken for a robot's."""
import heapq
import os
import re

import genpy
import numpy as np
import rosbag

from .bag_reader import BagError, BagFacts, open_bag
from .bag_topics import IMAGE_TYPES, raw_name, with_slash

SHARED = ('/tf', '/tf_static', '/clock', '/rosout', '/rosout_agg', '/diagnostics')  # topics of many publishers
COMMON_FRAMES = {'world', 'earth', 'mocap'}  # of a reference that sees both robots
TF_TYPES = ('tf2_msgs/TFMessage', 'tf/tfMessage')
STATIC = ('/tf_static', 'tf_static')
CAMERA_TYPES = (*IMAGE_TYPES, 'theora_image_transport/Packet', 'sensor_msgs/CameraInfo')
DROPPED = ('/clock',)  # one for both: the player's
OTHER_CLOCK = 10**9  # [ns]: stamps so far from the times of recording are of another clock, as check_bag says
STAMPS_END = 2**32 * 10**9  # [ns]: what ROS's stamps can hold


def frames_of(facts):
    """Frames that a bag names: in all transforms, as each message may hold others, and in the first message of each other topic with a header."""
    names = {frame for edge in facts.edges for frame in edge}
    with open_bag(facts.path) as bag:
        for topic in facts.types:
            for _, message, _ in bag.read_messages([topic]):
                edges = message.transforms if message._type in TF_TYPES else [message] if hasattr(message, 'child_frame_id') else []
                names |= {frame for edge in edges for frame in (edge.header.frame_id, edge.child_frame_id)}
                if message._type in TF_TYPES or edges:
                    continue
                if hasattr(message, 'header'):
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

    def topic(self, name):
        return self.topics.get(name, with_slash(name))

    def frame(self, name):
        return self.frames.get(name.lstrip('/'), name)

    def moved(self, stamp, topic):
        """A stamp in the merged bag's time; zero is none, and stays."""
        if not stamp:
            return stamp
        if not 0 < stamp.to_nsec() + self.shift.to_nsec() < STAMPS_END:
            path = self.facts.path
            way = (f'rosbag filter "{path}" NEW.bag "topic != \'{topic}\'" leaves it out' if self.facts.types[topic] in TF_TYPES else
                   f'rosrun air_ground join_bags "{path}" NEW.bag --restamp {topic} takes the times of recording')
            raise BagError(f'{path}: {topic} has a stamp of {stamp.to_sec():.3f} s, of another clock than the bag\'s, which cannot be shifted by {self.shift.to_sec():.3f} s: {way}')
        return stamp + self.shift

    def changed(self, message, topic):
        if message._type in TF_TYPES:
            for edge in message.transforms:
                edge.header.stamp = self.moved(edge.header.stamp, topic)
                edge.header.frame_id, edge.child_frame_id = self.frame(edge.header.frame_id), self.frame(edge.child_frame_id)
        elif hasattr(message, 'header'):
            message.header.stamp = self.moved(message.header.stamp, topic)
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
                yield (first + self.shift).to_nsec(), order, self.topic(topic), self.changed(message, topic), header
            for topic, message, time, header in bag.read_messages(return_connection_header=True, **window):
                if with_slash(topic) not in DROPPED and (self.whole or topic not in STATIC):
                    yield (time + self.shift).to_nsec(), order, self.topic(topic), self.changed(message, topic), header

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


def _filled(times, stamps, delay):
    """Stamps [ns] in which those that are zero follow their neighbours; times: of recording [ns]; delay: after the stamps, the usual one [ns]."""
    known = np.flatnonzero(stamps)
    if not len(known):
        return times - delay
    first, last, filled = known[0], known[-1], stamps.copy()
    step = max(1, int(np.median(np.diff(stamps[known])))) if len(known) > 1 else 1
    lacking = first + np.flatnonzero(stamps[first:last] == 0)
    # Between two that are known it is between their stamps, however late it was recorded; counted from the first, as a double holds no nanoseconds since 1970.
    filled[lacking] = stamps[first] + np.rint(np.interp(times[lacking] - times[first], times[known] - times[first], stamps[known] - stamps[first])).astype(np.int64)
    if first > 0:
        head = times[:first] - delay
        filled[:first] = head + min(0, stamps[first] - step - head[-1])
    if last + 1 < len(stamps):
        tail = times[last + 1:] - delay
        filled[last + 1:] = tail + max(0, stamps[last] + step - tail[0])
    return filled


def _mended(times, stamps):
    """(new stamps of each part [ns], what became of them); times, stamps: of each part's messages of one topic, in order [ns], 0 where there is no stamp."""
    all_times, all_stamps = np.concatenate(times), np.concatenate(stamps)
    count, lacking = len(all_stamps), np.count_nonzero(all_stamps == 0)
    if 2 * lacking > count:
        return times, 'stamped with the times of recording'
    delays = np.sort((all_times - all_stamps)[all_stamps > 0])
    delay = int(delays[len(delays) // 2])
    # Where some alone are zero, the others are right unless they are of another clock: to shift them by what a message takes would part them from the other sensors.
    shift = delay if not lacking or abs(delay) > OTHER_CLOCK else 0
    done = ([f'{lacking} of {count} stamps were zero: these follow the others' + ('' if shift else ', which stay as they are')] if lacking else [])
    done += [f'stamps shifted by {shift * 1e-9:+.3f} s'] if shift or not lacking else []
    return [_filled(t, s, delay) + shift for t, s in zip(times, stamps)], ', '.join(done)


def restamped(paths, topics):
    """(the parts of a recording with mended stamps on some topics, topic -> what became of them). Stamps of another clock are all shifted by what they lack to the times of recording, the
    median; those that are zero follow the others, or take the times of recording where most are zero. BagError for a topic that no part has."""
    found = {topic: [([], []) for _ in paths] for topic in topics}
    for part, path in enumerate(paths):
        with open_bag(path) as bag:
            for topic, message, time in bag.read_messages(topics) if topics else ():
                if hasattr(message, 'header'):
                    for column, value in zip(found[topic][part], (time, message.header.stamp)):
                        column.append(value.to_nsec())
    stamps, done = [{} for _ in paths], {}
    for topic, columns in found.items():
        if not any(times for times, _ in columns):
            raise BagError(f'--restamp {topic}: no bag has stamps on this topic')
        new, done[topic] = _mended(*([np.array(column, np.int64) for column in kind] for kind in zip(*columns)))
        for part, values in zip(stamps, new):
            if np.any(values <= 0) or np.any(values >= STAMPS_END):
                raise BagError(f'--restamp {topic}: its stamps are of several clocks, so that one shift serves them not all: have its driver stamp by one')
            part[topic] = values
    return [Restamped(path, part) for path, part in zip(paths, stamps)], done


class Restamped:
    """A part of a recording, with other stamps on some topics: topic -> those of its messages, in order [ns]."""

    def __init__(self, path, stamps):
        self.path, self.stamps = path, stamps

    def messages(self, order):
        """As Part's."""
        next_stamps = {topic: iter(stamps.tolist()) for topic, stamps in self.stamps.items()}
        with open_bag(self.path) as bag:
            for topic, message, time, header in bag.read_messages(return_connection_header=True):
                if topic in next_stamps and hasattr(message, 'header'):
                    stamp = next(next_stamps[topic])
                    message.header.stamp = genpy.Time(stamp // 10**9, stamp % 10**9)
                yield time.to_nsec(), order, topic, message, header


def _name(topic):
    """What a topic is of, whatever its transport."""
    return with_slash(topic[:-len('/theora')] if topic.endswith('/theora') else raw_name(topic))


def _folder(topic):
    return _name(topic).rpartition('/')[0]


def renamed(parts):
    """Of each part the topics that both name, in any transport. A camera's images and calibration are known by their folder, or the images' name: they stay together."""
    names = set.intersection(*({_name(topic) for topic in part.facts.types} for part in parts)) - set(SHARED)
    cameras = [{topic for topic, kind in part.facts.types.items() if kind in CAMERA_TYPES} for part in parts]
    folders = {folder for topic in set.union(*cameras) if _name(topic) in names for folder in (_folder(topic), _name(topic))}
    return [{topic for topic in part.facts.types if _name(topic) in names or topic in camera and _folder(topic) in folders} for part, camera in zip(parts, cameras)]


def plan(mav, ground, begin_together):
    """The two parts, of bags or stretches of them (BAG@FIRST-LAST). Topics and frames that both bags name get their robot's name in front, so that each is one robot's."""
    parts = [Part('mav', mav), Part('ground', ground)]
    frames = frames_of(parts[0].facts) & (frames_of(parts[1].facts) - COMMON_FRAMES)
    for part, topics in zip(parts, renamed(parts)):
        part.topics = {topic: f'/{part.robot}{with_slash(topic)}' for topic in topics}
        part.frames = {frame: f'{part.robot}_{frame}' for frame in frames}
    if begin_together:
        parts[1].shift = genpy.Duration.from_sec(parts[0].first - parts[1].first)
    return parts


def merge(parts, out, compression='lz4'):
    """Writes the bag and gives the number of messages; it has its name once it is whole. BagError where it cannot be written."""
    count, partial = 0, out + '.part'
    try:
        with rosbag.Bag(partial, 'w', compression=compression) as bag:
            # Stamps and topics decide, never the messages themselves, which have no order.
            for time, order, topic, message, header in heapq.merge(*(part.messages(i) for i, part in enumerate(parts)), key=lambda item: item[:2]):
                bag.write(topic, message, genpy.Time(time // 10**9, time % 10**9), connection_header={**header, 'topic': topic} if header else None)
                count += 1
        os.replace(partial, out)
    except OSError as error:
        raise BagError(f'{out} cannot be written ({error.strerror or error})') from error
    finally:
        if os.path.isfile(partial):
            os.remove(partial)
    return count
