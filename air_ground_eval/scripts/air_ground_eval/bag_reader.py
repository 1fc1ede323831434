"""What the report needs from the bag itself: its time span, static transforms and reference poses."""
import numpy as np
import rosbag

from . import geometry
from .evaluation import Track


class BagError(Exception):
    """A bag that cannot be read: one line that says what to do."""


# Message types that carry the pose of a body, and where in the message it lies.
POSE_TYPES = {
    'geometry_msgs/PoseStamped': lambda m: (m.pose.position, m.pose.orientation),
    'geometry_msgs/PoseWithCovarianceStamped': lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    'nav_msgs/Odometry': lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    'geometry_msgs/TransformStamped': lambda m: (m.transform.translation, m.transform.rotation)}


def open_bag(path):
    """rosbag.Bag for reading; BagError where there is none, or none that can be played."""
    try:
        bag = rosbag.Bag(path)
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
            self.begin, self.end = bag.get_start_time(), bag.get_end_time()
            topics = bag.get_type_and_topic_info().topics
            self.types = {topic: info.msg_type for topic, info in topics.items()}
            self.counts = {topic: info.message_count for topic, info in topics.items()}
            static = [topic for topic in self.types if topic.strip('/') == 'tf_static']
            self.static_latched = bool(static)
            self.static_messages = 0
            self.static = {}  # child -> TransformStamped: the last of each, as tf keeps them
            self.edges = {}  # (parent, child) -> T_parent_child
            self.broken_edges = set()  # 'parent -> child' of those whose quaternion is zero or not finite
            try:
                for _, message, _, header in bag.read_messages(static, return_connection_header=True) if static else ():
                    self.static_latched &= header.get('latching', b'0') in (b'1', '1')
                    self.add_static(message)
            except (rosbag.ROSBagException, OSError, ValueError) as error:
                raise BagError(f'{path} is damaged ({error}): run  rosbag reindex "{path}"  and try again') from error

    def add_static(self, message):
        """Transforms of a TFMessage: of this bag, or of another publisher."""
        self.static_messages += 1
        for edge in message.transforms:
            parent, child = edge.header.frame_id.lstrip('/'), edge.child_frame_id.lstrip('/')
            t, r = edge.transform.translation, edge.transform.rotation
            try:
                transform = geometry.pose_from_tq([t.x, t.y, t.z], [r.x, r.y, r.z, r.w])
            except ValueError:
                self.broken_edges.add(f'{parent} -> {child}')
                continue
            self.edges = {**{names: T for names, T in self.edges.items() if names[1] != child}, (parent, child): transform}
            self.static[child] = edge

    def of_type(self, *kinds):
        """Topics of these message types, in order."""
        return sorted(topic for topic, kind in self.types.items() if kind in kinds)

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

    def pose_track(self, topic, T_base_camera):
        """Camera track from a topic with the poses of base_link, or None when the bag holds no such topic or no poses."""
        kind = self.types.get(topic)
        if kind not in POSE_TYPES:
            return None
        stamps, positions, quaternions = [], [], []
        with open_bag(self.path) as bag:
            for _, message, _ in bag.read_messages([topic]):
                p, q = POSE_TYPES[kind](message)
                stamp = message.header.stamp.to_sec()
                if not stamps or stamp > stamps[-1]:
                    stamps.append(stamp)
                    positions.append((p.x, p.y, p.z))
                    quaternions.append((q.x, q.y, q.z, q.w))
        if len(stamps) < 2:
            return None
        poses = np.tile(np.eye(4), (len(stamps), 1, 1))
        poses[:, :3, :3] = geometry.matrix_from_quaternion(quaternions)
        poses[:, :3, 3] = positions
        return Track(np.array(stamps), poses @ T_base_camera)
