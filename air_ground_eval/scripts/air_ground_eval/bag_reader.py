"""What the report needs from the bag itself: its time span, static transforms and reference poses."""
import numpy as np
import rosbag

from . import geometry
from .evaluation import Track

# Message types that carry the pose of a body, and where in the message it lies.
POSE_TYPES = {
    'geometry_msgs/PoseStamped': lambda m: (m.pose.position, m.pose.orientation),
    'geometry_msgs/PoseWithCovarianceStamped': lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    'nav_msgs/Odometry': lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    'geometry_msgs/TransformStamped': lambda m: (m.transform.translation, m.transform.rotation)}


class BagFacts:
    """Facts of a bag. Raises rosbag.ROSBagException or OSError when it cannot be read (an unindexed one: rosbag reindex)."""

    def __init__(self, path):
        self.path = path
        with rosbag.Bag(path) as bag:
            self.begin, self.end = bag.get_start_time(), bag.get_end_time()
            self.types = {topic: info.msg_type for topic, info in bag.get_type_and_topic_info().topics.items()}
            self.counts = {topic: info.message_count for topic, info in bag.get_type_and_topic_info().topics.items()}
            self.edges = {}  # (parent, child) -> T_parent_child
            for _, message, _ in bag.read_messages(['/tf_static']):
                for edge in message.transforms:
                    t, r = edge.transform.translation, edge.transform.rotation
                    self.edges[(edge.header.frame_id.lstrip('/'), edge.child_frame_id.lstrip('/'))] = geometry.pose_from_tq(
                        [t.x, t.y, t.z], [r.x, r.y, r.z, r.w])

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
        with rosbag.Bag(self.path) as bag:
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
