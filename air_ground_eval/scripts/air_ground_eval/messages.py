"""ROS messages from arrays, and rosbag writing with latched connections."""
import genpy
import numpy as np
from geometry_msgs.msg import PoseStamped, TransformStamped
from sensor_msgs.msg import CameraInfo, FluidPressure, Image, Imu, NavSatFix
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from . import geometry


def stamp(seconds):
    """genpy.Time, rounded to the nanosecond."""
    nanoseconds = int(round(seconds * 1e9))
    return genpy.Time(nanoseconds // 10**9, nanoseconds % 10**9)


def image(array, encoding, seconds, frame):
    channels = {'mono8': (np.uint8, 1), 'rgb8': (np.uint8, 3), '16UC1': (np.uint16, 1)}
    kind, count = channels[encoding]
    array = np.ascontiguousarray(array, dtype=kind)
    message = Image()
    message.header.stamp = stamp(seconds)
    message.header.frame_id = frame
    message.height, message.width = array.shape[:2]
    message.encoding = encoding
    message.step = array.shape[1] * count * array.itemsize
    message.data = array.tobytes()
    return message


def camera_info(camera, seconds, frame):
    message = CameraInfo()
    message.header.stamp = stamp(seconds)
    message.header.frame_id = frame
    message.width, message.height = camera.width, camera.height
    message.distortion_model = camera.model
    message.D = list(camera.distortion)
    message.K = [camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1]
    message.R = [1, 0, 0, 0, 1, 0, 0, 0, 1]
    message.P = [camera.fx, 0, camera.cx, 0, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0]
    return message


def imu(gyro, accel, gyro_variance, accel_variance, seconds, frame):
    message = Imu()
    message.header.stamp = stamp(seconds)
    message.header.frame_id = frame
    message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z = map(float, gyro)
    message.linear_acceleration.x, message.linear_acceleration.y, message.linear_acceleration.z = map(float, accel)
    message.orientation_covariance[0] = -1
    for i in (0, 4, 8):
        message.angular_velocity_covariance[i] = gyro_variance
        message.linear_acceleration_covariance[i] = accel_variance
    return message


def gps_fix(place, deviations, seconds, frame):
    """place: latitude, longitude [deg], height above the ellipsoid [m]; deviations: horizontal, vertical [m]."""
    message = NavSatFix()
    message.header.stamp = stamp(seconds)
    message.header.frame_id = frame
    message.latitude, message.longitude, message.altitude = map(float, place)
    message.position_covariance[0] = message.position_covariance[4] = float(deviations[0]) ** 2
    message.position_covariance[8] = float(deviations[1]) ** 2
    message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_APPROXIMATED
    return message


def pressure(pascal, seconds, frame):
    message = FluidPressure(fluid_pressure=float(pascal))
    message.header.stamp = stamp(seconds)
    message.header.frame_id = frame
    return message


def fill_pose(target, transform):
    q = geometry.quaternion_from_matrix(transform[:3, :3])
    target.position.x, target.position.y, target.position.z = map(float, transform[:3, 3])
    target.orientation.x, target.orientation.y, target.orientation.z, target.orientation.w = map(float, q)


def pose_stamped(transform, seconds, frame):
    message = PoseStamped()
    message.header.stamp = stamp(seconds)
    message.header.frame_id = frame
    fill_pose(message.pose, transform)
    return message


def static_transforms(edges, seconds):
    """TFMessage of (parent, child, T_parent_child) edges."""
    message = TFMessage()
    for parent, child, transform in edges:
        edge = TransformStamped()
        edge.header.stamp = stamp(seconds)
        edge.header.frame_id, edge.child_frame_id = parent, child
        q = geometry.quaternion_from_matrix(transform[:3, :3])
        t, r = edge.transform.translation, edge.transform.rotation
        t.x, t.y, t.z = map(float, transform[:3, 3])
        r.x, r.y, r.z, r.w = map(float, q)
        message.transforms.append(edge)
    return message


def text(string):
    return String(data=string)


def write_latched(bag, topic, message, seconds):
    """Writes a message so that rosbag play advertises its topic as latched."""
    header = {'topic': topic, 'type': message._type, 'md5sum': message._md5sum,
              'message_definition': message._full_text, 'latching': '1', 'callerid': '/dataset_to_bag'}
    bag.write(topic, message, stamp(seconds), connection_header=header)
