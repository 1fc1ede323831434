"""Which topic of a bag is which input, by types and names; and the launch command that says so."""
import os
import re
import shlex

import numpy as np

from . import bag_camera, bag_registration
from .bag_reader import POSE_TYPES, POSITION_TYPES

# standard topic -> argument of the launch files
ARGUMENTS = {
    '/mav/camera/image_raw': 'mav_image', '/mav/camera/camera_info': 'mav_camera_info', '/mav/imu/data': 'mav_imu', '/ground_truth/mav': 'mav_truth',
    '/ground/rgb/image_raw': 'ground_image', '/ground/rgb/camera_info': 'ground_camera_info', '/ground/depth/image_raw': 'ground_depth',
    '/ground/depth/camera_info': 'ground_depth_camera_info', '/mav/imu/accel': 'mav_imu_accel', '/ground/imu/accel': 'ground_imu_accel',
    '/ground/imu/data': 'ground_imu', '/ground_truth/ground': 'ground_truth', '/gps/fix': 'gps_fix', '/mav/imu/mag': 'mav_magnetic_field',
    '/barometer': 'barometer_pressure'}
# What topics say of whom they are: whole words, or beginnings of words, where a part of another word would mean something else (stairs, quadruped, background).
MAV_WORDS = re.compile(r'drone|copter|quadrotor|multirotor|hummingbird|firefly|bebop|anafi|(?<![a-z])((mav|uav|dji|px4|airsim)|(quad|air|aerial|fly|flying|iris|tello)(?![a-z]))')
GROUND_WORDS = re.compile(r'robot|husky|jackal|turtlebot|summit|pioneer|kinect|realsense|(?<![a-z])(ground|ugv|rover|tb3)')
TRUTH_WORDS = re.compile(r'truth|vicon|vrpn|mocap|leica|optitrack|qualisys|natnet|(?<![a-z])gt(?![a-z])')
OWN_WORDS = re.compile(r'odom|wheel|slam|ekf|(?<![a-z])vi?o(?![a-z])')  # a robot's own estimate, which is no truth
LIDAR_WORDS = re.compile(r'ouster|lidar|livox|velodyne|(?<![a-z])os[01]')
NO_WORDS = re.compile(r'(?!)')
DOWN_WORDS = re.compile(r'down|bottom|nadir|belly')
COLOUR_WORDS = re.compile(r'rgb|colou?r')
LEFT_WORDS = re.compile(r'cam0|left|mono|gr[ae]y')
INFRARED = re.compile(r'infra|(^|[/_])ir([/_]|$)')  # a depth camera's own eyes
EYES = re.compile(r'/?(ir|infra(red)?_?\d?|(depth|rgb|ir)_to_(depth|rgb|ir))/')  # a depth camera's images of other kinds, in no folder of its driver (Azure Kinect)
RIGHT = re.compile(r'right|rect|cam1|infra2|(^|[/_])r([/_]|$)')  # of a stereo pair the left image is taken, as it is
CAMERAS = {'mav': '/mav/camera/image_raw', 'ground': '/ground/rgb/image_raw'}
FAST_IMU = 80 * 0.98  # [Hz]: what check_bag advises, for one that is nearly so
IMAGE_TYPES = ('sensor_msgs/Image', 'sensor_msgs/CompressedImage')
TRANSPORTS = ('compressedDepth', 'compressed')  # the better first: the second may be a JPEG, of depth too


def with_slash(topic):
    """As nodes without namespace resolve what was recorded, or given, without one."""
    return '/' + topic.lstrip('/')


def raw_name(topic):
    """The image topic that a compressed one belongs to."""
    parent, _, last = topic.rpartition('/')
    return parent if last in TRANSPORTS else topic


def image_topics(facts):
    """Image topics, raw or compressed, under the raw name."""
    return sorted({raw_name(t) for t in facts.of_type(*IMAGE_TYPES)})


def transport(facts, topic):
    """'raw', 'compressed' or None, as an image topic is in the bag."""
    if facts.types.get(topic) in IMAGE_TYPES:
        return 'raw' if facts.types[topic] == IMAGE_TYPES[0] else 'compressed'
    return 'compressed' if any(f'{topic}/{kind}' in facts.types for kind in TRANSPORTS) else None


def recorded(facts, topic):
    """The topic under which the bag holds an image topic: itself, or compressed; None without."""
    return topic if facts.types.get(topic) in IMAGE_TYPES else next((f'{topic}/{t}' for t in TRANSPORTS if f'{topic}/{t}' in facts.types), None)


def compressed_argument(facts, argument, topic):
    """The launch argument that has a node take an image topic that the bag holds compressed alone; `argument`: mav_image, ground_image or ground_depth. Compressed
    depth is looked for on compressedDepth: where it is elsewhere, the topic is named in full. One of another name needs its relay()."""
    own = recorded(facts, topic)
    full = own == topic != raw_name(own) or argument == 'ground_depth' and own == f'{topic}/compressed'
    return f'{argument}:={own}' if full else f'{argument}_transport:=compressed'


def relay(argument, topic):
    """The command that hands on compressed images whose topic's name does not say so, under one by which the nodes take them; '' where it says so."""
    return '' if topic != raw_name(topic) else f'rosrun topic_tools relay {topic} {topic}/{TRANSPORTS[0] if argument == "ground_depth" else TRANSPORTS[1]}'


def _common(a, b):
    """How many words of two topics agree from the front."""
    count = 0
    for x, y in zip(a.strip('/').split('/'), b.strip('/').split('/')):
        if x != y:
            break
        count += 1
    return count


def has(topic, words):
    """Whether a topic's name says one of the words; ground_truth is no ground robot."""
    return words.search(re.sub('ground_?truth', 'truth', topic.lower())) is not None


def _best(topics, score):
    """The topic of the highest score, the first by name of several; None without."""
    return max(sorted(topics), key=score, default=None)


def _is_depth(facts, topic):
    """By what its pixels are, where that tells; a folder named depth holds a depth camera's grey images, too, and those of a colour camera."""
    encoding = facts.encoding(topic)
    if transport(facts, topic) == 'compressed':
        kept = [t for t in (topic, *(f'{topic}/{kind}' for kind in TRANSPORTS)) if facts.types.get(t) == 'sensor_msgs/CompressedImage']
        pictures = [picture for picture in map(facts.first_message, kept) if picture is not None]
        if any('compressedDepth' in picture.format for picture in pictures):
            return True
        encoding = _compressed_encoding(pictures[0]) if pictures else None
    return 'disparity' not in topic.lower() and (encoding in ('16UC1', '32FC1') or encoding == 'mono16' and 'depth' in topic.lower())


def _compressed_encoding(picture):
    """Of the pixels of a CompressedImage: as its format says ('rgb8; jpeg compressed bgr8'); where that names the file's kind alone, 16 bits are no colours."""
    stated, more, _ = picture.format.partition(';')
    if more or 'jp' in stated.lower():
        return stated.strip()
    pixels = bag_camera.picture(picture)
    return 'mono16' if pixels is not None and pixels.dtype == np.uint16 and pixels.ndim == 2 else None


def _connected(facts, a, b):
    """Whether /tf_static has the cameras of two image topics on one body; None where it does not know both."""
    frames = [facts.frame(recorded(facts, topic)) for topic in (a, b)]
    if all(frames) and facts.static_transform(*frames) is not None:
        return True
    return False if {frame for edge in facts.edges for frame in edge}.issuperset(frames) else None


def _may_fly(facts, topic, ground):
    """Whether a camera may be the MAV's, beside that of the ground robot's images (None: there is none): not one that sits on it, by /tf_static or, without it, by the folder of
    their driver, nor another eye of it where the driver has no folder."""
    if ground is None or has(topic, GROUND_WORDS):
        return ground is None
    connected = _connected(facts, topic, ground)
    return has(topic, MAV_WORDS) or (not connected if connected is not None else _common(topic, ground) == 0 and not EYES.match(topic))


def infos(facts, image):
    """The topics with the calibration of an image topic, the likeliest first: below it, as AirSim has it, else beside it, or where RealSense Viewer keeps it (Color_0/info beside
    Color_0/image)."""
    name = raw_name(image)
    parent = name.rpartition('/')[0]
    folders = (name, parent, re.sub('/image$', '/info', parent))
    found = [t for t in facts.of_type('sensor_msgs/CameraInfo') if t.rpartition('/')[0] in folders]
    return sorted(found, key=lambda t: t.rpartition('/')[0] != name)


def _agreement(facts, colour, depth):
    """How well a colour camera's calibration is that of the depth registered to it: 2 where both are one, 1 for a rectified image whose depth is without distortion, else 0."""
    known = [[facts.first_message(t) for t in infos(facts, topic)[:1] if t not in facts.foreign] for topic in (colour, depth)]
    if not all(known):
        return 0
    a, b = (bag_camera.of_images(found[0], topic) for found, topic in zip(known, (colour, depth)))
    distortions = [np.trim_zeros(np.array(info.D), 'b') for info in (a, b)]
    if len(distortions[0]) == len(distortions[1]) and np.allclose(*distortions) and not bag_registration.differences(a, b):
        return 2
    return int(not len(distortions[1]) and bag_camera.RECTIFIED.search(colour) is not None)


def mapped(rules):
    """standard topic -> topic, of the --map rules TOPIC:=STANDARD. ValueError where a rule has no standard topic. That may go by its launch argument and on either side, as
    launch files have the argument on the left, and its slash may be missing."""
    result = {}
    for rule in rules:
        left, separator, right = rule.partition(':=')
        standard, topic = (_standard(right), left) if _standard(right) or not _standard(left) else (_standard(left), right)
        if not separator or not topic or not standard:
            known = ', '.join(f'{name} ({argument})' for name, argument in ARGUMENTS.items())
            raise ValueError(f'{rule}: expected TOPIC:=STANDARD, where STANDARD is one of {known}')
        result[standard] = topic
    return result


def _standard(name):
    """The standard topic of this name, with or without slash, or of this launch argument; None for others."""
    slashed = with_slash(name)
    return slashed if slashed in ARGUMENTS else next((standard for standard, argument in ARGUMENTS.items() if argument == name), None)


class _Choices:
    """standard topic -> topic of the bag; a topic is chosen once."""

    def __init__(self, names):
        self.names, self.taken = names, set(names.values())

    def choose(self, standard, topics, score):
        """Of the topics that of the highest score, unless the standard topic has one; None without."""
        if standard not in self.names:
            topic = _best([t for t in topics if t not in self.taken], score)
            if topic is not None:
                self.names[standard] = topic
                self.taken.add(topic)
        return self.names.get(standard)

    def choose_first(self, standard, topics):
        return self.choose(standard, topics, lambda topic: -topics.index(topic))


def guess(facts, city=False, robots=('mav', 'ground'), given=None):
    """standard topic -> topic of the bag, for those that can be told; a standard topic that is there stays. robots: those that are in the bag; given: what is known."""
    names = {standard: standard for standard in ARGUMENTS if (standard in facts.types or transport(facts, standard))
             and (standard.split('/')[1] in robots or standard.split('/')[1] not in ('mav', 'ground'))}
    names.update(given or {})
    known = {raw_name(topic) for topic in names.values()}
    images = [t for t in image_topics(facts) if t not in known]
    depths = [t for t in images if _is_depth(facts, t)]
    colours = [t for t in images if t not in depths and 'disparity' not in t.lower()]
    choices = _Choices(names)
    if not city and 'ground' in robots:
        _guess_depth_camera(facts, choices, depths, colours)
    ground = names.get(CAMERAS['ground']) if 'ground' in robots else None
    if 'mav' in robots:  # a camera that sits on the ground robot is not the MAV's
        choices.choose(CAMERAS['mav'], [t for t in colours if _may_fly(facts, t, ground)],
                       lambda t: (has(t, MAV_WORDS), not city and has(t, DOWN_WORDS), has(t, LEFT_WORDS), not has(t, RIGHT), not has(t, INFRARED), bool(infos(facts, t)), 'raw' in t))
    for robot in CAMERAS:
        if names.get(CAMERAS[robot]) and robot in robots:
            _guess_sensors(facts, choices, robot)
    if '/ground/depth/image_raw' in names:  # beside colour in one folder, it may have none of its own
        choices.choose_first('/ground/depth/camera_info', infos(facts, names['/ground/depth/image_raw']))
    if city:
        for standard, kind in (('/gps/fix', 'sensor_msgs/NavSatFix'), ('/mav/imu/mag', 'sensor_msgs/MagneticField'), ('/barometer', 'sensor_msgs/FluidPressure')):
            choices.choose(standard, facts.of_type(kind), lambda t: ('diff' not in t.lower(), has(t, MAV_WORDS)))  # differential pressure is of an airspeed sensor
    return names


def _guess_depth_camera(facts, choices, depths, colours):
    """The ground robot's images."""
    depth = choices.choose('/ground/depth/image_raw', depths,
                           lambda t: (has(t, GROUND_WORDS), not has(t, MAV_WORDS), has(t, bag_registration.REGISTERED), 'raw' in t))
    if depth is None:
        return
    frame = facts.frame(recorded(facts, depth))
    choices.choose('/ground/rgb/image_raw', [t for t in colours if not has(t, MAV_WORDS) and not has(t, INFRARED)],
                   lambda t: (has(t, GROUND_WORDS), (same := facts.frame(recorded(facts, t)) == frame), _agreement(facts, t, depth) if same or has(depth, bag_registration.REGISTERED) else 0,
                              has(t, COLOUR_WORDS), _common(t, depth), not has(t, RIGHT), 'raw' in t))
    if '/ground/rgb/image_raw' not in choices.names:  # a MAV's, or of a camera for something else
        choices.taken.discard(choices.names.pop('/ground/depth/image_raw'))


def _guess_sensors(facts, choices, robot):
    """What goes with a robot's images: their calibration, IMU, reference poses. What is named as this robot's comes first where there is another robot that it may be of."""
    image, others = choices.names[CAMERAS[robot]], [choices.names[c] for r, c in CAMERAS.items() if r != robot and choices.names.get(c)]
    own, other = (MAV_WORDS, GROUND_WORDS) if robot == 'mav' else (GROUND_WORDS, MAV_WORDS)
    other = other if others else NO_WORDS
    choices.choose_first(CAMERAS[robot].replace('image_raw', 'camera_info'), infos(facts, image))
    imus, connected = _mounted(facts, [t for t in facts.of_type('sensor_msgs/Imu') if not has(t, other)], image, others)
    doubt = others and not connected
    imu = choices.choose(f'/{robot}/imu/data', [t for t in imus if 'accel' not in t.lower()],
                         lambda t: (bool(doubt and has(t, own)), not has(t, LIDAR_WORDS) and not has(t, TRUTH_WORDS), _common(t, image), facts.rate(t) >= FAST_IMU, has(t, own), 'raw' not in t,
                                    'gyro' not in t.lower()))
    if imu is not None and 'gyro' in imu.lower():
        choices.choose(f'/{robot}/imu/accel', [t for t in imus if 'accel' in t.lower()], lambda t: _common(t, imu))
    choices.choose(f'/ground_truth/{robot}', [t for t in facts.of_type(*POSE_TYPES) if has(t, TRUTH_WORDS) and not has(t, other) and facts.counts[t] > 1],
                   lambda t: (bool(others and has(t, own)), facts.types[t] not in POSITION_TYPES, has(t, own)))


def _mounted(facts, imus, image, others):
    """(Of the IMUs those that /tf_static connects with the images' camera, True); where none is, (those that are not on the other robot, False)."""
    def connected(imu, topic):
        seen = recorded(facts, topic)
        return seen is not None and facts.static_transform(facts.frame(seen), facts.frame(imu)) is not None

    own = [imu for imu in imus if connected(imu, image)]
    return own or [imu for imu in imus if not any(connected(imu, other) for other in others)], bool(own)


def chain(facts, frame):
    """A frame and those above it, up to the root of its tree of static transforms."""
    parents = {child: parent for parent, child in facts.edges}
    result = [frame]
    while result[-1] in parents and len(result) < 100:
        result.append(parents[result[-1]])
    return result


def guess_base(facts, robot, frame, names=None):
    """The body frame that /tf_static connects with a camera's frame: <robot>_base_link, another base_link, else the root.

    Where it connects the camera with nothing: the MAV's is that of the IMU, as calibrations of camera and IMU tell their poses in its frame, or without IMU the camera's
    own, whose vertical the ground map tells. None for a ground robot of which only optical frames are known: its map would lie on its side.
    """
    frames = chain(facts, frame)
    imu = facts.frame((names or {}).get(f'/{robot}/imu/data'))
    if robot == 'mav':
        if len(frames) == 1 and all(parent != frame for parent, _ in facts.edges):
            return (guess_base(facts, robot, imu) or imu) if imu else frame or None
        return _body(robot, frames)
    bodies = [f for f in frames[1:] if 'optical' not in f.lower()]
    if not bodies and imu:  # a body that the IMU sits on, though nothing tells where the camera does
        bodies = [f for f in chain(facts, imu)[1:] if 'optical' not in f.lower() and f not in frames]
    return _body(robot, bodies) if bodies else None


def _body(robot, frames):
    """Of frames, each above the one before, the robot's base: by name (camera_base is an Azure Kinect's), else the uppermost."""
    named = [f for f in frames if f in (f'{robot}_base_link', f'{robot}_base_footprint')] + [f for f in frames if f.rpartition('/')[2] in ('base_link', 'base', 'base_footprint')]
    return next(iter(named + [f for f in frames if 'base' in f or 'body' in f]), frames[-1])


def command(facts, names, bases, frames, city=False, registered=True, arguments=()):
    """The roslaunch command for this bag. bases: robot -> body frame; frames: robot -> its images' frame; registered: depth is seen from the colour camera;
    arguments: further ones, as what is wrong with the bag asks for, in place of the topics guessed."""
    told = {argument.partition(':=')[0] for argument in arguments}
    names = {standard: topic for standard, topic in names.items() if (not registered or standard != '/ground/depth/camera_info') and ARGUMENTS[standard] not in told}
    robots = [robot for robot, image in (('mav', '/mav/camera/image_raw'), ('ground', '/ground/rgb/image_raw')) if image in names]
    words = ['roslaunch', 'air_ground', 'city.launch' if city else 'replay.launch', f'bag:={os.path.abspath(facts.path)}']
    words.append(f'out:=out-{os.path.splitext(os.path.basename(facts.path))[0]}')  # where roslaunch is started, as its default is: a bag's folder may be read-only
    words += ['db:=CITY.gpkg', 'world_config:=WORLD.yaml'] if city else []
    compressed = [compressed_argument(facts, ARGUMENTS[standard], topic) for standard, topic in names.items() if transport(facts, topic) == 'compressed']
    full = {argument.partition(':=')[0] for argument in compressed}
    words += [f'{ARGUMENTS[standard]}:={topic}' for standard, topic in names.items() if topic != standard and ARGUMENTS[standard] not in full]
    words += compressed
    words += [] if registered else ['ground_depth_registered:=false']
    words += ['mav_use_imu:=false'] if 'mav' in robots and '/mav/imu/data' not in names and not city else []
    for robot in robots:
        words += [f'{robot}_base_frame:={bases[robot]}'] if bases.get(robot, f'{robot}_base_link') != f'{robot}_base_link' else []
        default = f'{robot}_camera_optical_frame'
        words += [f'{robot}_camera_frame:={frames[robot]}'] if not city and frames.get(robot, default) not in (default, '') else []
    if not city:
        words += [] if 'mav' in robots else ['mav_vo:=false', 'dense_fusion:=false']
        words += [] if 'ground' in robots else ['rgbd_slam:=false']
        words += [] if len(robots) == 2 else ['heightmap_mcl:=false', 'view_match:=false', 'icp_refine:=false']
    return ' '.join(shlex.quote(word) for word in [*words, *arguments])
