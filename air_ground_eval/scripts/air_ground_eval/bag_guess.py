"""Which topic of a bag is which input, by types and names; and the launch command that says so."""
import os
import re
import shlex

import numpy as np

from . import bag_camera, bag_references, bag_registration
from .bag_references import TRUTH_WORDS
from .bag_robots import BODIES, common, drives, flies, frame_of, has, joined, may_fly, on_one_body, owner
from .bag_topics import TRANSPORTS, image_topics, raw_name, recorded, transport, with_slash

# standard topic -> argument of the launch files
ARGUMENTS = {
    '/mav/camera/image_raw': 'mav_image', '/mav/camera/camera_info': 'mav_camera_info', '/mav/imu/data': 'mav_imu', '/ground_truth/mav': 'mav_truth',
    '/ground/rgb/image_raw': 'ground_image', '/ground/rgb/camera_info': 'ground_camera_info', '/ground/depth/image_raw': 'ground_depth',
    '/ground/depth/camera_info': 'ground_depth_camera_info', '/mav/imu/accel': 'mav_imu_accel', '/ground/imu/accel': 'ground_imu_accel',
    '/ground/imu/data': 'ground_imu', '/ground_truth/ground': 'ground_truth', '/gps/fix': 'gps_fix', '/mav/imu/mag': 'mav_magnetic_field',
    '/barometer': 'barometer_pressure'}
OWN_WORDS = re.compile(r'odom|wheel|slam|ekf|(?<![a-z])vi?o(?![a-z])')  # a robot's own estimate, which is no truth
LIDAR_WORDS = re.compile(r'ouster|lidar|livox|velodyne|(?<![a-z])os[01]')
EYE_WORDS = re.compile(r'cam|rgb|colou?r')  # what a lidar's own images (range, reflectivity) are not called
ODD_WORDS = re.compile(r'davis|thermal|boson|lepton|optris|(?<![a-z])(dvs|event|flir)')  # cameras of few pixels, or of no light: the last choice
DOWN_WORDS = re.compile(r'down|bottom|nadir|belly')
COLOUR_WORDS = re.compile(r'rgb|colou?r')
LEFT_WORDS = re.compile(r'cam0|left|mono|gr[ae]y')
INFRARED = re.compile(r'infra|(^|[/_])ir([/_]|$)')  # a depth camera's own eyes
RIGHT = re.compile(r'right|rect|cam1|infra2|(^|[/_])r([/_]|$)')  # of a stereo pair the left image is taken, as it is
NONE = 'none'  # in place of a topic: the bag has none of it, whatever else it holds
MAY_LACK = re.compile('/(mav|ground)/imu/|/ground_truth/')  # standard topics of which a bag may have none
HOUSING = 0.05  # [m]: cameras no further apart are of one make
CAMERAS = {'mav': '/mav/camera/image_raw', 'ground': '/ground/rgb/image_raw'}
FAST_IMU = 80 * 0.98  # [Hz]: what check_bag advises, for one that is nearly so


def compressed_argument(facts, argument, topic):
    """The launch argument that has a node take an image topic that the bag holds compressed alone; `argument`: mav_image, ground_image or ground_depth. Compressed
    depth is looked for on compressedDepth: where it is elsewhere, the topic is named in full. One of another name needs its relay()."""
    own = recorded(facts, topic)
    full = own == topic != raw_name(own) or argument == 'ground_depth' and own == f'{topic}/compressed'
    return f'{argument}:={own}' if full else f'{argument}_transport:=compressed'


def relay(argument, topic):
    """The command that hands on compressed images whose topic's name does not say so, under one by which the nodes take them; '' where it says so."""
    return '' if topic != raw_name(topic) else f'rosrun topic_tools relay {topic} {topic}/{TRANSPORTS[0] if argument == "ground_depth" else TRANSPORTS[1]}'


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


def infos(facts, image):
    """The topics with the calibration of an image topic, the likeliest first: below it, as AirSim has it, else beside it, or where RealSense Viewer keeps it (Color_0/info beside
    Color_0/image); else a folder higher, where its frame and size are the images' (uHumans2)."""
    name = raw_name(image)
    parent = name.rpartition('/')[0]
    folders, upper = (name, parent, re.sub('/image$', '/info', parent)), parent.rpartition('/')[0]
    known = facts.of_type('sensor_msgs/CameraInfo')
    found = [t for t in known if t.rpartition('/')[0] in folders]
    return sorted(found, key=lambda t: t.rpartition('/')[0] != name) or [t for t in known if upper and t.rpartition('/')[0] == upper and _fits(facts, t, image)]


def _fits(facts, info, image):
    """Whether a calibration's frame and size are those of an image topic."""
    return frame_of(facts, info) == frame_of(facts, image) and bag_camera.stated_size(facts.first_message(info)) == size(facts, image)


def size(facts, image):
    """(width, height) of a topic's first image; None where that cannot be told."""
    picture = facts.first_message(recorded(facts, image))
    return picture and bag_camera.image_size(picture)


def _area(facts, image):
    width, height = size(facts, image) or (0, 0)
    return width * height


def _is_grey(facts, topic, images):
    """Whether images of 16 bits are brightness, though they might be depth: a thermal camera's, and those that neither their name nor a camera beside them says to be depth."""
    if facts.encoding(topic) != '16UC1' or 'depth' in topic.lower() or has(topic, bag_registration.REGISTERED):
        return False
    return has(topic, ODD_WORDS) or not any(common(topic, other) or on_one_body(facts, topic, other) for other in images if not _is_depth(facts, other))


def kinds(facts, images):
    """(depth images, others that cameras took) of image topics; a lidar takes none."""
    depths = [t for t in images if _is_depth(facts, t) and not _is_grey(facts, t, images)]
    return depths, [t for t in images if t not in depths and 'disparity' not in t.lower() and (has(t, EYE_WORDS) or not has(t, LIDAR_WORDS))]


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
        none = topic.lstrip('/') == NONE
        if none and not MAY_LACK.match(standard):
            raise ValueError(f'{rule}: {NONE} leaves out an IMU or reference poses; --only leaves out a robot')
        result[standard] = NONE if none else topic
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
    depths, colours = kinds(facts, [t for t in image_topics(facts) if t not in known])
    choices = _Choices(names)
    if not city and 'ground' in robots:
        _guess_depth_camera(facts, choices, depths, colours)
    ground = names.get(CAMERAS['ground']) if 'ground' in robots else None
    if 'mav' in robots:  # a camera that sits on the ground robot is not the MAV's
        choices.choose(CAMERAS['mav'], [t for t in colours if len(robots) == 1 or may_fly(facts, t, ground)],
                       lambda t: (flies(facts, t), not has(t, ODD_WORDS) and _area(facts, t) > 0, not city and has(t, DOWN_WORDS), has(t, LEFT_WORDS), not has(t, RIGHT),
                                  not has(t, INFRARED), bool(infos(facts, t)), 'raw' in t, 'front' in t.lower(), _area(facts, t)))
    for robot in CAMERAS:
        if names.get(CAMERAS[robot]) and robot in robots:
            _guess_sensors(facts, choices, robot)
    if '/ground/depth/image_raw' in names:  # beside colour in one folder, it may have none of its own
        choices.choose_first('/ground/depth/camera_info', infos(facts, names['/ground/depth/image_raw']))
    if city:
        for standard, kind in (('/gps/fix', 'sensor_msgs/NavSatFix'), ('/mav/imu/mag', 'sensor_msgs/MagneticField'), ('/barometer', 'sensor_msgs/FluidPressure')):
            choices.choose(standard, facts.of_type(kind), lambda t: ('diff' not in t.lower(), flies(facts, t)))  # differential pressure is of an airspeed sensor
    return names


def _guess_depth_camera(facts, choices, depths, colours):
    """The ground robot's images."""
    depth = choices.choose('/ground/depth/image_raw', [t for t in depths if owner(facts, t) != 'mav'],
                           lambda t: (drives(facts, t), not flies(facts, t), has(t, bag_registration.REGISTERED), 'front' in t.lower(), 'raw' in t))
    if depth is None:
        return
    choices.choose('/ground/rgb/image_raw', [t for t in colours if not flies(facts, t) and not has(t, INFRARED)], lambda t: _partnership(facts, t, depth))
    if '/ground/rgb/image_raw' not in choices.names:  # a MAV's, or of a camera for something else
        choices.taken.discard(choices.names.pop('/ground/depth/image_raw'))


def _partnership(facts, colour, depth):
    """How well a colour camera goes with depth: by the body, frames and calibration, by where they sit, then by names."""
    frames = frame_of(facts, depth), frame_of(facts, colour)
    same = frames[0] == frames[1]
    agreement = _agreement(facts, colour, depth) if same or has(depth, bag_registration.REGISTERED) else 0
    connected = True if same else joined(facts, *frames)
    between = facts.static_transform(*frames)
    near = -max(HOUSING, np.linalg.norm(between[:3, 3])) if between is not None else -np.inf
    words = len(set(colour.split('/')) & set(depth.split('/')))
    return (connected is not False, drives(facts, colour), same, agreement, connected is True, near, common(colour, depth) > 0, has(colour, COLOUR_WORDS), common(colour, depth),
            words, not has(colour, RIGHT), 'raw' in colour)


def _guess_sensors(facts, choices, robot):
    """What goes with a robot's images: their calibration, IMU, reference poses. Where there is another robot that they may be of, what is named as this robot's comes first, and
    reference poses that say of neither are nobody's."""
    image, others = choices.names[CAMERAS[robot]], [choices.names[c] for r, c in CAMERAS.items() if r != robot and choices.names.get(c)]
    own, theirs = (flies, drives) if robot == 'mav' else (drives, flies)
    choices.choose_first(CAMERAS[robot].replace('image_raw', 'camera_info'), infos(facts, image))
    imus, connected = _mounted(facts, [t for t in facts.of_type('sensor_msgs/Imu') if not (others and theirs(facts, t))], image, others)
    doubt = others and not connected
    imu = choices.choose(f'/{robot}/imu/data', [t for t in imus if 'accel' not in t.lower()],
                         lambda t: (bool(doubt and own(facts, t)), not has(t, LIDAR_WORDS) and not has(t, TRUTH_WORDS) and has(t, ODD_WORDS) <= has(image, ODD_WORDS),
                                    common(t, image), facts.rate(t) >= FAST_IMU, own(facts, t), 'raw' not in t, 'gyro' not in t.lower()))
    if imu is not None and 'gyro' in imu.lower():
        choices.choose(f'/{robot}/imu/accel', [t for t in imus if 'accel' in t.lower()], lambda t: common(t, imu))
    if f'/ground_truth/{robot}' not in choices.names:
        base = guess_base(facts, robot, frame_of(facts, image), choices.names)
        choices.choose(f'/ground_truth/{robot}', references(facts, choices.names, robot), bag_references.rank(facts, robot, base, [image, imu or '']))


def references(facts, names, robot):
    """Topics of reference poses that may be a robot's. names: standard topic -> topic of the bag."""
    others = [names[camera] for other, camera in CAMERAS.items() if other != robot and names.get(camera)]
    return bag_references.candidates(facts, robot, names[CAMERAS[robot]], others)


def _mounted(facts, imus, image, others):
    """(Of the IMUs those that /tf_static connects with the images' camera, True); where none is, (those that are not on the other robot, False)."""
    own = [imu for imu in imus if facts.static_transform(frame_of(facts, image), frame_of(facts, imu)) is not None]
    return own or [imu for imu in imus if not any(on_one_body(facts, imu, other) for other in others)], bool(own)


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
        bodies = [f for f in chain(facts, imu) if 'optical' not in f.lower() and f not in frames and (f != imu or BODIES.search(f.lower()))]
    return _body(robot, bodies) if bodies else None


def _body(robot, frames):
    """Of frames, each above the one before, the robot's base: by name (camera_base is an Azure Kinect's), else the uppermost."""
    named = [f for f in frames if f in (f'{robot}_base_link', f'{robot}_base_footprint')] + [f for f in frames if f.rpartition('/')[2] in ('base_link', 'base', 'base_footprint')]
    return next(iter(named + [f for f in frames if 'base' in f or 'body' in f]), frames[-1])


def command(facts, names, bases, frames, city=False, registered=True, arguments=()):
    """The roslaunch command for this bag. bases: robot -> body frame; frames: robot -> its images' frame; registered: depth is seen from the colour camera;
    arguments: further ones, as what is wrong with the bag asks for, in place of the topics guessed."""
    told = {argument.partition(':=')[0] for argument in arguments}
    names = {standard: topic for standard, topic in names.items() if (not registered or standard != '/ground/depth/camera_info') and ARGUMENTS[standard] not in told
             and (topic != NONE or standard == '/ground/imu/data')}  # whose node waits for one unless it is told that there is none
    robots = [robot for robot, image in (('mav', '/mav/camera/image_raw'), ('ground', '/ground/rgb/image_raw')) if image in names]
    words = ['roslaunch', 'air_ground', 'city.launch' if city else 'replay.launch', f'bag:={os.path.abspath(facts.path)}']
    words.append(f'out:=out-{os.path.splitext(os.path.basename(facts.path))[0]}')  # where roslaunch is started, as its default is: a bag's folder may be read-only
    words += ['db:=CITY.gpkg', 'world_config:=WORLD.yaml'] if city else []
    compressed = [compressed_argument(facts, ARGUMENTS[standard], topic) for standard, topic in names.items() if transport(facts, topic) == 'compressed']
    full = {argument.partition(':=')[0] for argument in compressed}
    words += [f'{ARGUMENTS[standard]}:={topic}' for standard, topic in names.items() if topic != standard and ARGUMENTS[standard] not in full]
    words += compressed
    words += [] if registered else ['ground_depth_registered:=false']
    words += ['mav_use_imu:=false'] if 'mav' in robots and '/mav/imu/data' not in names else []
    for robot in robots:
        words += [f'{robot}_base_frame:={bases[robot]}'] if bases.get(robot, f'{robot}_base_link') != f'{robot}_base_link' else []
        default = f'{robot}_camera_optical_frame'
        words += [f'{robot}_camera_frame:={frames[robot]}'] if not city and frames.get(robot, default) not in (default, '') else []
    if not city:
        words += [] if 'mav' in robots else ['mav_vo:=false', 'dense_fusion:=false']
        words += [] if 'ground' in robots else ['rgbd_slam:=false']
        words += [] if len(robots) == 2 else ['heightmap_mcl:=false', 'view_match:=false', 'icp_refine:=false']
    return ' '.join(shlex.quote(word) for word in [*words, *arguments])
