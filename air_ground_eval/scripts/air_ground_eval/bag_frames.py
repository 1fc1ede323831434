"""Checks of frames and static transforms: what connects the sensors with their robots, and which way cameras look."""
import os
import re
import shlex

import numpy as np

from . import bag_guess, bag_imu, geometry, own_outputs
from .bag_finding import ERROR, OK, WARNING, Finding, quoted
from .bag_robots import BODIES, above
from .bag_topics import image_topics

NODES = {'mav': 'mav_vo', 'ground': 'rgbd_slam'}
IMAGES = ('/mav/camera/image_raw', '/ground/rgb/image_raw')
UPRIGHT = np.cos(np.radians(30))  # an optical axis nearer to the vertical is no ground robot's, which looks ahead
LEVEL = np.sin(np.radians(5))  # axes of a body that is turned and pitched: y is level
FORWARD = geometry.pose(geometry.R_BODY_FORWARD_CAMERA)  # T_body_optical of a level camera that looks ahead
SIBLINGS = re.compile(r'(.*_)(rgb|colou?r|depth|infra\d?|imu|gyro|accel)_optical_frame')  # of one depth camera: their axes are parallel
REFERENCES = re.compile(r'world|earth|ecef|truth|vicon|mocap|optitrack|(^|[/_])gt([/_]|$)')  # frames in which a robot is placed from outside
VIEWER = re.compile(r'/device_\d+/sensor_\d+/')  # topics as RealSense Viewer, and all that records by librealsense, names them


def publish(edges):
    """The command that publishes (parent, child, T_parent_child) edges."""
    words = ['rosrun', 'air_ground', 'publish_calibration']
    for parent, child, transform in edges:
        numbers = [*transform[:3, 3], *geometry.quaternion_from_matrix(transform[:3, :3])]
        words += ['--transform', ' '.join([parent, child, *(f'{round(x, 6) + 0.0:.6g}' for x in numbers)])]
    return ' '.join(f'"{word}"' if ' ' in word else shlex.quote(word) for word in words)


def check_viewer(facts):
    """One error for a recording of RealSense Viewer: its images and IMUs share one frame id, and tf knows nothing of where they are."""
    if not any(map(VIEWER.match, image_topics(facts))):
        return []
    path = shlex.quote(os.path.abspath(facts.path))
    record = "rosbag record -O ros.bag -e '/tf_static|/camera/(color|depth|aligned_depth_to_color)/(image_.*raw|camera_info)|/camera/(gyro|accel)/sample'"
    return [Finding(ERROR, f'recorded by RealSense Viewer, not by ROS: nothing says in ROS\'s terms where colour, depth and IMU sit. Let the driver play it and record that: '
                    f'{record}  beside  roslaunch realsense2_camera rs_from_file.launch rosbag_filename:={path} align_depth:=true  ; then check ros.bag')]


def check_static(facts):
    """How the static transforms were recorded."""
    result = [Finding(ERROR, f'/tf_static: the rotation of {edge} is zero or not finite') for edge in sorted(facts.broken_edges)]
    result += [Finding(WARNING, f'/tf_static has several parents of {child!r}, {", ".join(map(repr, parents))}, and a frame has one: the last is taken, {parents[-1]!r}. Let one node alone publish '
                       f'where {child} is; where another is right, rosrun air_ground publish_calibration --transform "PARENT {child} X Y Z QX QY QZ QW" beside the replay says so')
               for child, parents in sorted(facts.rivals.items())]
    how = [f'in {facts.static_messages} messages'] if facts.static_messages > 1 else []
    how += ['not latched'] if facts.static_messages and not facts.static_latched else []
    if how:
        result.append(Finding(OK, f'/tf_static comes {" and ".join(how)}: replay.launch hands it on whole; rosbag play by itself does not'))
    if facts.constant_on_tf:
        result.append(Finding(OK, f'/tf holds transforms that never change, of {quoted(facts.constant_on_tf)}: replay.launch takes them as static'))
    if '/clock' in facts.types:
        result.append(Finding(OK, '/clock is in the bag: replay.launch leaves it out; rosbag play --clock by itself does not'))
    return result


def _unmounted(facts, base, frame, topic):
    """A ground camera of which nothing tells how it sits on its robot: as most do."""
    root = bag_guess.chain(facts, frame)[-1]
    command = publish([(base, root, FORWARD @ geometry.inverse(facts.static_transform(root, frame)))])
    return Finding(WARNING, f'/tf_static does not connect {base} with {frame} (of {topic}): taken for level, looking ahead, at the origin of {base}, which needs, beside the replay,  {command}  '
                   '; where it sits or looks otherwise, put in its position [m] and the quaternion of its optical axes (x right, y down, z forward) in those of the body (x forward, y left, '
                   'z up)', beside=command)


def _on_its_side(facts, base, frame, topic):
    """A ground camera that looks up or down by its transform, and whose frame is not called optical: that of a body, as simulators have it, whose z points up."""
    T_base_camera = facts.static_transform(base, frame)
    if abs(T_base_camera[2, 2]) < UPRIGHT or 'optical' in frame.lower():
        return []
    text = (f'{topic} is in frame {frame!r}, whose z axis, {base} -> {frame} says, is vertical: images are taken for such of an optical frame (x right, y down, z forward), so that the camera '
            f'would look {"up" if T_base_camera[2, 2] > 0 else "down"}, and the map lie on its side')
    if base == frame:
        return [Finding(WARNING, f'{text}: name the body frame (--ground-base)')]
    return [_turned(facts, base, frame, text)]


def _of_a_body(facts, base, frame, topic, imu):
    """A MAV's camera whose axes are those of a body that may be turned and pitched, and whose frame is not called optical. imu: its stream, None without."""
    R = facts.static_transform(base, frame)[:3, :3]
    if base == frame or 'optical' in frame.lower() or not _z_up(facts, base, imu) or abs(R[2, 1]) > LEVEL or R[2, 2] < -LEVEL:
        return []
    return [_turned(facts, base, frame, f'{topic} is in frame {frame!r}, whose axes, {base} -> {frame} says, are those of a body (y level, z not downwards): images are taken for such of an '
                    f'optical frame (x right, y down, z forward), so that the camera would look {"up" if R[2, 2] > UPRIGHT else "ahead, on its side" if R[2, 2] < LEVEL else "up, on its side"}')]


def _z_up(facts, base, imu):
    """Whether the z axis of a base is up: by the mean force on an IMU that sits on it, without by its name. The frame of an IMU may have any axes."""
    T_base_imu = imu and imu.accel and facts.static_transform(base, sorted(imu.frames)[0].lstrip('/'))
    if T_base_imu is None or not imu or not np.any(imu.accel):
        return BODIES.search(base.lower()) is not None
    mean = T_base_imu[:3, :3] @ np.nanmean(imu.accel, axis=0)
    return mean[2] > UPRIGHT * np.linalg.norm(mean)


def _turned(facts, base, frame, text):
    """The warning about a camera in the frame of a body, with the command that has it look along that frame's x axis."""
    edges = [(e.header.frame_id, e.child_frame_id) for e in facts.static_transforms([base]).transforms]
    turned = [(parent, child, facts.static_transform(parent, child) @ FORWARD) for parent, child in edges if child == frame]
    turned += [(parent, child, geometry.inverse(FORWARD) @ facts.static_transform(parent, child)) for parent, child in edges if parent == frame]
    command = publish(turned)
    return Finding(WARNING, f'{text}. Where it looks along the x axis of {frame}, this, beside the replay, takes the place of what the bag says:  {command}', beside=command)


def check_level(base):
    """What makes the map of a ground robot without IMU level, where `base` may be tilted."""
    if re.search('base|body|foot', base):
        return []
    return [Finding(WARNING, f'without IMU the ground map is levelled by what lies flat in it (most of the surfaces within 45 degrees of the z axis of {base}: floors, table tops, ceilings); '
                    f'until they are seen, or where there are none, it is as level as {base} is at the start. Where that is a camera tilted by more, rosrun air_ground publish_calibration '
                    f'--transform "ground_base_link {base} X Y Z QX QY QZ QW" beside the replay, with ground_base_frame:=ground_base_link')]


def check_odometry(facts, robots, bases, frames=None):
    """Who else says where a base is: a replay leaves that out, and nobody does so on a live robot. frames: robot -> those of its sensors: what carries one is no odometry's frame, but
    the body that a gimbal sits on."""
    result = []
    for robot in robots:
        node = NODES[robot]
        child = next((frame for frame in bag_guess.chain(facts, bases[robot]) if frame in facts.moving), None)
        parent = facts.moving.get(child, '')
        own = parent in (f'{robot}_odom', f'{robot}_map') and any(f'/{topic}' in facts.types for topic in own_outputs.OUTPUTS[node])
        carries = any(facts.static_transform(parent, frame) is not None for frame in (frames or {}).get(robot, ()))
        if not parent or own or carries:
            continue
        held = '' if child == bases[robot] else f', to which {bases[robot]} is fixed'
        leaves = f'/tf holds {parent} -> {child}{held}, which a replay leaves out, since {node} publishes where {bases[robot]} is'
        if REFERENCES.search(parent.lower()):
            result.append(Finding(OK, f'{leaves}: a reference, by its name, and no odometry'))
            continue
        result.append(Finding(OK, f'{leaves}: where that is the robot\'s own '
                              f'odometry, run {node} with {robot}_odom_from_tf:=true {robot}_odom_frame:={parent} on the robot (and, to try it, in a replay)'))
    return result


def move(facts, a, b):
    """Whether two frames that no static transform connects are in one tree with what changes on /tf."""
    return not set(above(facts, a)).isdisjoint(above(facts, b))


def siblings(a, b):
    """Whether two frames are of one depth camera, by their names."""
    found = [SIBLINGS.fullmatch(frame) for frame in (a, b)]
    return all(found) and found[0][1] == found[1][1]


def _beside(known, frame, topic, importing):
    """A sensor whose place nothing tells but the name of its frame, which is that of a camera whose place is known, or of an IMU that is the base. importing: as for _unconnected()."""
    command = publish([(known, frame, np.eye(4))])
    return Finding(WARNING, f'/tf_static does not connect {known} with {frame} (of {topic}): taken for parallel, as those of one depth camera are, and at one place, which needs, beside the replay,  '
                   f'{command}  ; they lie up to some cm apart: put in what the driver tells (rs-enumerate-devices -c), in metres'
                   + (f', or, of a calibration,  {importing}' if importing else ''), beside=command)


def _upright(imu):
    """Whether the mean force on an IMU, in axes of a level optical frame, points up, as far as it measures any."""
    mean = np.nanmean(imu.accel, axis=0) if len(imu.accel) else np.zeros(3)
    return not np.any(mean) or -mean[1] > np.cos(np.radians(45)) * np.linalg.norm(mean)


def _unconnected(facts, standard, base, frame, topic, importing):
    """A sensor that no static transform connects with its base. importing: the command that imports a calibration of camera and IMU; '' where the base is not the IMU."""
    without = bag_imu.without(standard)
    if move(facts, base, frame):
        text = f'{base} and {frame} (of {topic}) move against each other, by /tf (a gimbal, a pan-tilt head?), and the nodes need them fixed'
        if without:
            return Finding(WARNING, f'{text}: replay without this IMU, {without}, or with one that is fixed to the camera', without)
        return Finding(ERROR, f'{text}: ' + ('record depth registered to colour by its driver' if 'depth' in standard else
                                             f'name a body frame that is fixed to the camera (--{standard.split("/")[1]}-base)'))
    if standard == '/ground/rgb/image_raw':
        return _unmounted(facts, base, frame, topic)
    text = f'/tf_static does not connect {base} with {frame} (of {topic})'
    if standard == '/ground/imu/data':
        return Finding(WARNING, f'{text}: replay without it, {without}, or publish where it sits', without)
    known = f', the pose of the camera in the IMU frame (kalibr: T_cam_imu inverted; {importing}  does that)' if importing else ''
    return Finding(ERROR, f'{text}: rosrun air_ground publish_calibration --transform "{base} {frame} X Y Z QX QY QZ QW" beside the replay{known}')


def check(facts, present, streams, bases, unregistered, importing, told=False):
    """Findings about the mountings. present: standard topic -> name; bases: robot -> body frame; unregistered: the depth camera's mounting is needed, too; importing: the command that
    imports a calibration of the MAV's camera; told: that the mounting of that is missing was said with what else is."""
    result, eye, assumed = [], None, {}  # eye: frame of the ground robot's colour camera; assumed: robot -> frames that a transform of ours connects with its base
    sensors = [('mav', '/mav/camera/image_raw'), ('mav', '/mav/imu/data'), ('ground', '/ground/rgb/image_raw'), ('ground', '/ground/imu/data')]
    if unregistered:
        sensors.append(('ground', '/ground/depth/image_raw'))
    if bases['mav'] == bases['ground'] and all(image in present for image in IMAGES):
        result.append(Finding(ERROR, f'the body frame of both robots is {bases["mav"]!r}, and a frame has one place: of the bags that each robot recorded, '
                              'rosrun air_ground merge_bags FLIGHT.bag GROUND.bag BOTH.bag names the frames apart; else have each publish its own (tf_prefix)'))
    imus = {frame.lstrip('/') for standard in ('/mav/imu/data', '/ground/imu/data') if standard in present for frame in streams[present[standard]].frames}
    for robot, standard in sensors:
        if standard not in present:
            continue
        topic, info = present[standard], present.get(standard.replace('image_raw', 'camera_info')) if 'image' in standard else None
        frames = streams[topic].frames
        named = streams[info].frames - {''} if info else set()  # the nodes take camera_info's, where it has one
        sensor = 'imu' if 'imu' in standard else 'camera'
        frame = sorted(named or frames)[0].lstrip('/')
        if not frame and 'depth' not in standard:
            result.append(Finding(ERROR, f'{topic}: the frame id is empty: set {sensor}_frame, or base_{sensor} (its pose on the robot), in a copy of '
                                  f'config/{NODES[robot]}.yaml and replay with {NODES[robot]}_config:=COPY'))
            continue
        if len(frames) > 1:
            result.append(Finding(WARNING, f'{topic}: several frame ids: {quoted(frames)}'))
        if named and frame not in {f.lstrip('/') for f in frames | {''}}:
            result.append(Finding(WARNING, f'{topic} is in frame {quoted(frames)}, {info} in {quoted(named)}: the nodes go by the latter'))
        imu = streams.get(present.get(f'/{robot}/imu/data'))
        if standard == '/mav/camera/image_raw' and imu and frame in {f.lstrip('/') for f in imu.frames}:
            result.append(Finding(WARNING, f'{topic} and {present["/mav/imu/data"]} are both in frame {frame!r}, and are so taken for parallel and at one place, which hardly any are: '
                                  f'{importing}  names them apart, or set base_camera and base_imu in a copy of config/mav_vo.yaml and replay with mav_vo_config:=COPY'))
        elif robot == 'mav' and sensor == 'camera' and (frame == bases[robot] or 'optical' in bases[robot].lower()):
            result.append(Finding(OK, f'the body frame of the MAV is {bases[robot]!r}, for want of another: mav/odometry tells how that moves (z forward, where it is a camera\'s)'))
        connected = any(facts.static_transform(root, frame) is not None for root in (bases[robot], *assumed.get(robot, ())))
        known = eye if robot == 'ground' and (sensor == 'camera' or _upright(imu)) else bases[robot] if sensor == 'camera' else None
        if not connected and known and siblings(known, frame) and not move(facts, known, frame):
            result.append(_beside(known, frame, topic, importing if robot == 'mav' else ''))
        elif not connected and not (told and standard == '/mav/camera/image_raw'):
            result.append(_unconnected(facts, standard, bases[robot], frame, topic, importing if bases[robot] in imus else ''))
        if standard == '/ground/rgb/image_raw':
            eye = frame
            if connected:
                result += _on_its_side(facts, bases[robot], frame, topic)
            else:
                assumed[robot] = (frame,)
        elif standard == '/mav/camera/image_raw' and connected:
            result += _of_a_body(facts, bases[robot], frame, topic, imu)
    return result
