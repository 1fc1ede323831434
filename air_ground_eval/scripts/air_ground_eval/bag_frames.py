"""Checks of frames and static transforms: what connects the sensors with their robots, and which way cameras look."""
import os
import re
import shlex

import numpy as np

from . import bag_guess, bag_imu, geometry, own_outputs
from .bag_finding import ERROR, OK, WARNING, Finding, quoted

NODES = {'mav': 'mav_vo', 'ground': 'rgbd_slam'}
IMAGES = ('/mav/camera/image_raw', '/ground/rgb/image_raw')
UPRIGHT = np.cos(np.radians(30))  # an optical axis nearer to the vertical is no ground robot's, which looks ahead
FORWARD = geometry.pose(geometry.R_BODY_FORWARD_CAMERA)  # T_body_optical of a level camera that looks ahead
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
    if not any(map(VIEWER.match, bag_guess.image_topics(facts))):
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
    edges = [(e.header.frame_id, e.child_frame_id) for e in facts.static_transforms([base]).transforms]
    turned = [(parent, child, facts.static_transform(parent, child) @ FORWARD) for parent, child in edges if child == frame]
    turned += [(parent, child, geometry.inverse(FORWARD) @ facts.static_transform(parent, child)) for parent, child in edges if parent == frame]
    command = publish(turned)
    return [Finding(WARNING, f'{text}. Where it looks along the x axis of {frame}, this, beside the replay, takes the place of what the bag says:  {command}', beside=command)]


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
        above = '' if child == bases[robot] else f', to which {bases[robot]} is fixed'
        result.append(Finding(OK, f'/tf holds {parent} -> {child}{above}, which a replay leaves out, since {node} publishes where {bases[robot]} is: where that is the robot\'s own '
                              f'odometry, run {node} with {robot}_odom_from_tf:=true {robot}_odom_frame:={parent} on the robot (and, to try it, in a replay)'))
    return result


def _move(facts, a, b):
    """Whether two frames that no static transform connects are in one tree with what changes on /tf."""
    parents = {**{child: parent for parent, child in facts.edges}, **facts.moving}
    above = []
    for frame in (a, b):
        above.append({frame})
        while (frame := parents.get(frame)) is not None and frame not in above[-1]:
            above[-1].add(frame)
    return bool(above[0] & above[1])


def _unconnected(facts, standard, base, frame, topic, imus):
    """A sensor that no static transform connects with its base. imus: frames of IMUs."""
    without = bag_imu.without(standard)
    if _move(facts, base, frame):
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
    known = ', the pose of the camera in the IMU frame (kalibr: T_cam_imu inverted; import_kalibr does that)' if base in imus else ''
    return Finding(ERROR, f'{text}: rosrun air_ground publish_calibration --transform "{base} {frame} X Y Z QX QY QZ QW" beside the replay{known}')


def check(facts, present, streams, bases, unregistered):
    """Findings about the mountings. present: standard topic -> name; bases: robot -> body frame; unregistered: the depth camera's mounting is needed, too."""
    result, assumed = [], {}  # robot -> frames that a transform of ours connects with its base
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
        if robot == 'mav' and sensor == 'camera' and (frame == bases[robot] or 'optical' in bases[robot].lower()):
            result.append(Finding(OK, f'the body frame of the MAV is {bases[robot]!r}, for want of another: mav/odometry tells how that moves (z forward, where it is a camera\'s)'))
        connected = any(facts.static_transform(root, frame) is not None for root in (bases[robot], *assumed.get(robot, ())))
        if not connected:
            result.append(_unconnected(facts, standard, bases[robot], frame, topic, imus))
        if standard == '/ground/rgb/image_raw' and connected:
            result += _on_its_side(facts, bases[robot], frame, topic)
        elif standard == '/ground/rgb/image_raw':
            assumed[robot] = (frame,)
    return result
