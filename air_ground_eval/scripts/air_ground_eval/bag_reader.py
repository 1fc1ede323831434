"""What the report needs from the bag itself: its time span, static transforms and reference poses."""
import itertools
import os
import struct

import genpy
import numpy as np
import rosbag
import roslib.message
import rospy

from . import geometry, messages, own_outputs, reference_faults
from .bag_topics import PACKETS
from .truth import Reference
from .video import is_video


# Else messages keep the definitions of ROS 2.
CONVERT = 'rosbags-convert --src FOLDER --dst x.bag --dst-typestore ros1_noetic'


class BagError(Exception):
    """A bag that cannot be read: one line that says what to do."""


# Message types that carry the pose of a body, or its position alone, and where in the message it lies.
POSE_TYPES = {
    'geometry_msgs/PoseStamped': lambda m: (m.pose.position, m.pose.orientation),
    'geometry_msgs/PoseWithCovarianceStamped': lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    'nav_msgs/Odometry': lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    'geometry_msgs/TransformStamped': lambda m: (m.transform.translation, m.transform.rotation),
    'geometry_msgs/PointStamped': lambda m: (m.point, None)}  # of a total station
POSITION_TYPES = ('geometry_msgs/PointStamped',)
SENSOR_TYPES = ('sensor_msgs/Image', 'sensor_msgs/CompressedImage', *PACKETS, 'sensor_msgs/CameraInfo', 'sensor_msgs/Imu')
APART = 60.0  # [s]: what was recorded so long before all sensors' messages, or after them, is no part of a replay
LEAP = 1e7  # [s]: no recording pauses that long: its clock was set meanwhile


def _numbers(edge):
    """Translation [m] and quaternion (x, y, z, w) of a TransformStamped."""
    t, r = edge.transform.translation, edge.transform.rotation
    return [t.x, t.y, t.z], [r.x, r.y, r.z, r.w]


def _named(edge):
    """((parent, child), T_parent_child) of a TransformStamped; None in place of a transform whose quaternion is zero or not finite."""
    names = edge.header.frame_id.lstrip('/'), edge.child_frame_id.lstrip('/')
    try:
        return names, geometry.pose_from_tq(*_numbers(edge))
    except ValueError:
        return names, None


def _definition_here(kind, otherwise):
    """MD5 sum of a message type as it is defined here; `otherwise` where it is not."""
    try:
        found = roslib.message.get_message_class(kind)
    except (ImportError, ValueError, AttributeError):
        found = None
    return otherwise if found is None else found._md5sum


def _times(bag):
    """topic -> when its messages were recorded [s], in order; the index has them as they lie in the file."""
    times = {}
    for connection in bag._get_connections():
        times.setdefault(connection.topic, []).extend(entry.time.to_sec() for index in bag._get_indexes([connection]) for entry in index)
    return {topic: np.sort(values) for topic, values in times.items()}


def _sensors_span(times):
    """When the first and the last message of sensors was recorded [s]; times: of each topic, of which, where the clock leapt, the longest part counts."""
    parts = [max(np.split(t, np.flatnonzero(np.diff(t) > LEAP) + 1), key=len) for t in times]
    return min(part[0] for part in parts), max(part[-1] for part in parts)


class _Bag(rosbag.Bag):
    """One whose damaged parts are BagErrors, too."""

    def read_messages(self, *arguments, **options):
        try:
            yield from super().read_messages(*arguments, **options)
        except (rosbag.ROSBagException, genpy.MessageException, struct.error, OSError, ValueError, EOFError, LookupError, RuntimeError) as error:
            raise BagError(f'{self.filename} is damaged ({error}): run  rosbag reindex "{self.filename}", which keeps what lies before the damage, and try again') from error


def open_bag(path):
    """rosbag.Bag for reading; BagError where there is none, or none that can be played."""
    if os.path.isfile(os.path.join(path, 'metadata.yaml')) or str(path).endswith(('.mcap', '.db3')):
        raise BagError(f'{path} is a recording of ROS 2: make a bag of ROS 1 of it (pip install rosbags; {CONVERT})')
    if is_video(str(path)):
        raise BagError(f'{path} is a video: make a bag of it (rosrun air_ground dataset_to_bag --mav {path} --config camera.yaml --out x.bag)')
    try:
        bag = _Bag(path)
    except rosbag.ROSBagUnindexedException as error:
        raise BagError(f'{path} was not closed when it was recorded, or is cut short: run  rosbag reindex "{path}"  and try again') from error
    except (rosbag.ROSBagException, OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise BagError(f'{path} cannot be read as a bag ({reason}): check the argument bag:=') from error
    if bag.get_message_count() == 0:
        bag.close()
        raise BagError(f'{path} holds no messages')
    return bag


class BagFacts:
    """Facts of a bag; BagError when it cannot be read."""

    def __init__(self, path):
        self.path = path
        with open_bag(path) as bag:
            topics = bag.get_type_and_topic_info().topics
            self.foreign = {c.topic for c in bag._get_connections() if c.md5sum != _definition_here(c.datatype, c.md5sum)}  # topics whose messages are defined otherwise here
            self.types = {topic: info.msg_type for topic, info in topics.items()}
            self.counts = {topic: info.message_count for topic, info in topics.items()}
            self.recorded, self.begin, self.end, self.elsewhen = self._span(_times(bag))
            static = [topic for topic in self.types if topic.strip('/') == 'tf_static']
            self.rates = {}  # topic -> rate(topic), of those that were asked for
            self.delays = {}  # topic -> delay(topic), of those that were asked for
            self.first = {}  # topic -> its first message, of those that were asked for
            self.static_latched = bool(static)
            self.static_messages = 0
            self.edges = {}  # (parent, child) -> T_parent_child: the last of each child, as tf keeps them
            self.broken_edges = set()  # 'parent -> child' of those whose quaternion is zero or not finite
            self.rivals = {}  # child -> its parents in /tf_static, in order, of those that have several
            for _, message, _, header in bag.read_messages(static, return_connection_header=True) if static else ():
                self.static_latched &= header.get('latching', b'0') in (b'1', '1')
                self.static_messages += 1
                for edge in message.transforms:
                    self._add_edge(edge)
            self.moving = {}  # child -> parent, of the transforms on /tf that change
            self.constant_on_tf = self._add_constant(bag)
            self.elsewhere = self._of_namespaces(bag)  # namespace -> {(parent, child): T_parent_child}: its static transforms, on /x/tf_static and /x/tf, which no node hears

    def _span(self, times):
        """((first, last) of all messages, begin, end of what is replayed [s], topic -> how many of its messages lie outside: of another clock, or of no sensor's time)."""
        together = np.sort(np.concatenate(list(times.values())))
        first, last = _sensors_span([times[topic] for topic, kind in self.types.items() if kind in SENSOR_TYPES] or [together])
        kept = together[(together >= first - APART) & (together <= last + APART)]
        begin, end = float(kept[0]), float(kept[-1])
        outside = {topic: int(np.count_nonzero((t < begin) | (t > end))) for topic, t in times.items()}
        return (float(together[0]), float(together[-1])), begin, end, {topic: count for topic, count in outside.items() if count}

    def add_static(self, message):
        """Transforms of another publisher's TFMessage, which take the place of the bag's."""
        for edge in message.transforms:
            self._add_edge(edge)
            self.rivals.pop(edge.child_frame_id.lstrip('/'), None)

    def _add_edge(self, edge):
        (parent, child), transform = _named(edge)
        if transform is None:
            self.broken_edges.add(f'{parent} -> {child}')
            return
        before = next((a for a, b in self.edges if b == child and a != parent), None)
        if before is not None:
            self.rivals[child] = [a for a in self.rivals.get(child, [before]) if a != parent] + [parent]
        self.edges = {**{names: T for names, T in self.edges.items() if names[1] != child}, (parent, child): transform}

    def _add_constant(self, bag):
        """Transforms on /tf that never change are mountings: recordings of tf's first version have all of theirs there. Returns their children."""
        constant, self.moving = self._constant(bag, [topic for topic in self.types if topic.strip('/') == 'tf'], {child for _, child in self.edges})
        for edge in constant:
            self._add_edge(edge)
        return {edge.child_frame_id.lstrip('/') for edge in constant}

    def _of_namespaces(self, bag):
        result = {}
        for topic, kind in sorted(self.types.items()):
            space, _, last = topic.strip('/').rpartition('/')
            if not space or last not in ('tf', 'tf_static') or kind not in ('tf2_msgs/TFMessage', 'tf/tfMessage'):
                continue
            edges = self._constant(bag, [topic], ())[0] if last == 'tf' else (edge for _, message, _ in bag.read_messages([topic]) for edge in message.transforms)
            result.setdefault(f'/{space}', {}).update({names: transform for names, transform in map(_named, edges) if transform is not None})
        return result

    def _constant(self, bag, topics, taken, windows=40, lengths=(0.5, 2.0)):
        """(Edges of transforms that never change, without those of the children `taken`; child -> parent of those that do.)

        Looked at in so many windows over the recording, since a robot may stand for a while; in longer ones where one is told too rarely, as once a second.
        """
        constant, first, moving = set(), {}, {}
        for seconds in lengths if topics else ():
            first, seen = {}, {}
            for window, start in enumerate(np.linspace(self.begin, max(self.begin, self.end - seconds), windows)):
                for _, message, _ in bag.read_messages(topics, rospy.Time(start), rospy.Time(start + seconds)):
                    for edge in message.transforms:
                        child = edge.child_frame_id.lstrip('/')
                        kept = first.setdefault(child, edge)
                        same = kept.header.frame_id == edge.header.frame_id and np.allclose(np.concatenate(_numbers(kept)), np.concatenate(_numbers(edge)), rtol=0, atol=1e-6)
                        if not same:
                            moving[child] = edge.header.frame_id.lstrip('/')
                        seen.setdefault(child, set()).add(window)
            still = set(first) - set(moving) - set(taken)
            constant = {child for child in still if len(seen[child]) > windows // 2}
            if constant == still:
                break
        return [first[child] for child in sorted(constant)], moving

    def static_transforms(self, bases=(), chains=()):
        """The static transforms as a TFMessage, for nodes that publish where the frames `bases` are, and the transforms along `chains` of frames, parent before child: since a
        frame has one parent, the edges above them are turned around, but those within a chain left out (of an earlier run that never changed)."""
        edges = {(parent, child): transform for (parent, child), transform in self.edges.items() if not any(parent in chain and child in chain for chain in chains)}
        bases = [*bases, *(frame for chain in chains for frame in reversed(chain[1:]))]
        known = {*bases, *(frame for chain in chains for frame in chain)}
        for base in bases:
            frame, below = base, None
            while parent := next((parent for parent, child in edges if child == frame and parent != below), None):
                transform = edges.pop((parent, frame))
                if parent in known:
                    break
                edges[frame, parent] = geometry.inverse(transform)
                frame, below = parent, frame
        return messages.static_transforms([(parent, child, transform) for (parent, child), transform in edges.items()], self.begin)

    def first_message(self, topic):
        """None without one."""
        if topic not in self.first:
            with open_bag(self.path) as bag:
                self.first[topic] = next((message for _, message, _ in bag.read_messages([topic])), None) if topic in self.types else None
        return self.first[topic]

    def frame(self, topic):
        """Frame id of a topic's first message, without a slash before it; None without one."""
        header = getattr(self.first_message(topic), 'header', None)
        return None if header is None else header.frame_id.lstrip('/')

    def delay(self, topic, most=100):
        """How long after its stamp a message was recorded [s], the median of the first ones: the bag's clock less that of the stamps. 0 without stamps."""
        if topic not in self.delays:
            delays = []
            with open_bag(self.path) as bag:
                for _, message, time in bag.read_messages([topic]) if topic in self.types else ():
                    if getattr(getattr(message, 'header', None), 'stamp', None):
                        delays.append((time - message.header.stamp).to_sec())
                    if len(delays) == most or not hasattr(message, 'header'):
                        break
            self.delays[topic] = float(np.median(delays)) if delays else 0.0
        return self.delays[topic]

    def times(self, topic, begin=0.0):
        """When a topic's messages were recorded, from `begin` on [s]: by the index, without reading them."""
        with open_bag(self.path) as bag:
            times = [entry.time.to_sec() for entry in bag._get_entries(bag._get_connections([topic]))]
        return [time for time in times if time > begin - 1e-3]

    def rate(self, topic, most=200, together=10):
        """Messages a second by the stamps of the first ones, whether they come in packets or with a pause; 0 without stamps."""
        if topic not in self.rates:
            with open_bag(self.path) as bag:
                messages_read = bag.read_messages([topic]) if topic in self.types else ()
                stamps = [message.header.stamp.to_sec() for _, message, _ in itertools.islice(messages_read, most) if hasattr(message, 'header')]
            together = min(together, len(stamps) - 1)
            span = np.median(np.subtract(stamps[together:], stamps[:-together])) if together > 0 else 0.0
            self.rates[topic] = together / span if span > 0 else 0.0
        return self.rates[topic]

    def encoding(self, topic):
        """Of a raw image's pixels; None without one."""
        return getattr(self.first_message(topic), 'encoding', None)

    def defined_otherwise(self, topic):
        """Why no node here takes a topic, and what to do; None where that is no reason."""
        found = next((name for name in (topic, topic.lstrip('/')) if name in self.foreign), None)
        if found is None:
            return None
        ros_2 = f' (of a recording of ROS 2: {CONVERT})' if self.types[found] == 'sensor_msgs/CameraInfo' else ''
        return (f'{topic}: no node takes it, since {self.types[found]} is defined otherwise in the bag than here (md5sum). Replay the bag with the version that recorded it, or convert it{ros_2}: '
                f'rosbag check -g rules.bmr "{self.path}" writes rules, to be filled in, for rosbag fix "{self.path}" converted.bag rules.bmr')

    def of_type(self, *kinds):
        """Topics of these message types, in order; without what the nodes published, which is no input."""
        return sorted(topic for topic, kind in self.types.items() if kind in kinds and topic not in own_outputs.ALL)

    def static_transform(self, target, source):
        """T_target_source through the static transforms, or None when they do not connect the two."""
        reached, frontier = {target: np.eye(4)}, [target]
        while frontier:
            frame = frontier.pop()
            for (parent, child), transform in self.edges.items():
                for a, b, T_a_b in ((parent, child, transform), (child, parent, geometry.inverse(transform))):
                    if a == frame and b not in reached:
                        reached[b] = reached[frame] @ T_a_b
                        frontier.append(b)
        return reached.get(source)

    def reference(self, topic):
        """The Reference on a topic, whatever body its poses are of; None when the bag holds no such topic or no poses. What is not finite, or not believable, is left out."""
        kind = self.types.get(topic)
        if kind not in POSE_TYPES:
            return None
        stamps, positions, quaternions, frame = [], [], [], ''
        with open_bag(self.path) as bag:
            for _, message, _ in bag.read_messages([topic]):
                p, q = POSE_TYPES[kind](message)
                stamp = message.header.stamp.to_sec()
                if stamp > (stamps[-1] if stamps else 0) and np.all(np.isfinite([p.x, p.y, p.z])):
                    stamps.append(stamp)
                    positions.append((p.x, p.y, p.z))
                    quaternions.append((q.x, q.y, q.z, q.w) if q else (0, 0, 0, 0))
                frame = getattr(message, 'child_frame_id', '') or frame
        stamps, positions, quaternions = np.array(stamps), np.array(positions).reshape(-1, 3), np.array(quaternions, float).reshape(-1, 4)
        norms = np.linalg.norm(quaternions, axis=1)
        turned = np.isfinite(norms) & (norms > 1e-9)
        attitude = bool(np.any(turned))
        quaternions[~turned] = 0
        keep = np.flatnonzero(turned if attitude else np.ones(len(stamps), bool))
        believed = keep[reference_faults.believable(stamps[keep], positions[keep], quaternions[keep])]
        if len(believed) < 2:
            return None
        poses = np.tile(np.eye(4), (len(believed), 1, 1))
        if attitude:
            poses[:, :3, :3] = geometry.matrix_from_quaternion(quaternions[believed])
        poses[:, :3, 3] = positions[believed]
        return Reference(stamps[believed], poses, attitude, frame.lstrip('/'), len(keep) - len(believed))
