"""Which topic of a bag is which input, by types and names; and the launch command that says so."""
import os
import re
import shlex

from .bag_reader import POSE_TYPES

# standard topic -> argument of the launch files
ARGUMENTS = {
    '/mav/camera/image_raw': 'mav_image', '/mav/camera/camera_info': 'mav_camera_info', '/mav/imu/data': 'mav_imu', '/ground_truth/mav': 'mav_truth',
    '/ground/rgb/image_raw': 'ground_image', '/ground/rgb/camera_info': 'ground_camera_info', '/ground/depth/image_raw': 'ground_depth',
    '/ground/depth/camera_info': 'ground_depth_camera_info', '/mav/imu/accel': 'mav_imu_accel', '/ground/imu/accel': 'ground_imu_accel',
    '/ground/imu/data': 'ground_imu', '/ground_truth/ground': 'ground_truth', '/gps/fix': 'gps_fix', '/mav/imu/mag': 'mav_magnetic_field',
    '/barometer': 'barometer_pressure'}
MAV_WORDS = ('mav', 'uav', 'drone', 'quad', 'copter', 'air', 'fly', 'px4', 'dji', 'iris', 'hummingbird', 'bebop', 'tello', 'anafi')
GROUND_WORDS = ('ground', 'ugv', 'rover', 'robot', 'husky', 'jackal', 'turtlebot', 'tb3', 'summit', 'pioneer', 'kinect', 'realsense')
TRUTH_WORDS = ('truth', 'gt', 'vicon', 'vrpn', 'mocap', 'leica', 'optitrack', 'qualisys', 'natnet')
DOWN_WORDS = ('down', 'bottom', 'nadir', 'belly')
LIDAR_WORDS = ('os0', 'os1', 'ouster', 'lidar', 'livox', 'velodyne')
INFRARED = re.compile(r'infra|(^|[/_])ir([/_]|$)')  # a depth camera's own eyes
RIGHT = re.compile(r'right|rect|cam1|infra2|(^|[/_])r([/_]|$)')  # of a stereo pair the left image is taken, as it is
IMAGE_TYPES = ('sensor_msgs/Image', 'sensor_msgs/CompressedImage')
TRANSPORTS = ('compressedDepth', 'compressed')  # the better first: the second may be a JPEG, of depth too


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
    depth is looked for on compressedDepth: where it is elsewhere, the topic is named in full."""
    own = recorded(facts, topic)
    return f'{argument}:={own}' if own == topic or argument == 'ground_depth' and own == f'{topic}/compressed' else f'{argument}_transport:=compressed'


def _common(a, b):
    """How many words of two topics agree from the front."""
    count = 0
    for x, y in zip(a.strip('/').split('/'), b.strip('/').split('/')):
        if x != y:
            break
        count += 1
    return count


def _has(topic, words):
    return any(word in re.sub('ground_?truth', 'truth', topic.lower()) for word in words)


def _best(topics, score):
    """The topic of the highest score, the first by name of several; None without."""
    return max(sorted(topics), key=score, default=None)


def _is_depth(facts, topic):
    """By what its pixels are, where that tells; a folder named depth holds a depth camera's grey images, too."""
    if transport(facts, topic) == 'compressed':
        return 'depth' in topic.lower() or f'{topic}/compressedDepth' in facts.types
    encoding = facts.encoding(topic)
    return 'disparity' not in topic.lower() and (encoding in ('16UC1', '32FC1') or encoding == 'mono16' and 'depth' in topic.lower())


def _same_robot(facts, a, b):
    """Whether two image topics are of cameras on one body, by /tf_static or, without it, by the folder of their driver."""
    frames = [facts.frame(recorded(facts, topic)) for topic in (a, b)]
    return all(frames) and facts.static_transform(*frames) is not None or _common(a, b) > 0


def _infos(facts, parent):
    return [t for t in facts.of_type('sensor_msgs/CameraInfo') if t.rsplit('/', 1)[0] == parent]


def guess(facts, city=False, robots=('mav', 'ground'), given=None):
    """standard topic -> topic of the bag, for those that can be told; a standard topic that is there stays. robots: those that are in the bag; given: what is known."""
    names = {standard: standard for standard in ARGUMENTS if (standard in facts.types or transport(facts, standard))
             and (standard.split('/')[1] in robots or standard.split('/')[1] not in ('mav', 'ground'))}
    names.update(given or {})
    known = {raw_name(topic) for topic in names.values()}
    images = [t for t in image_topics(facts) if t not in known]
    depths = [t for t in images if _is_depth(facts, t)]
    colours = [t for t in images if t not in depths and 'disparity' not in t.lower()]
    taken = set(names.values())

    def choose(standard, topics, score):
        if standard not in names:
            topic = _best([t for t in topics if t not in taken], score)
            if topic is not None:
                names[standard] = topic
                taken.add(topic)
        return names.get(standard)

    if not city and 'ground' in robots:
        depth = choose('/ground/depth/image_raw', depths,
                       lambda t: (_has(t, GROUND_WORDS), not _has(t, MAV_WORDS), _has(t, ('aligned', 'registered', 'depth_to_rgb')), 'raw' in t))
        if depth is not None:
            frame = facts.frame(recorded(facts, depth))
            choose('/ground/rgb/image_raw', [t for t in colours if not _has(t, MAV_WORDS) and not INFRARED.search(t)],
                   lambda t: (_has(t, GROUND_WORDS), facts.frame(recorded(facts, t)) == frame, _has(t, ('rgb', 'color', 'colour')), _common(t, depth),
                              not RIGHT.search(t), 'raw' in t))
            if '/ground/rgb/image_raw' not in names:  # a MAV's, or of a camera for something else
                taken.discard(names.pop('/ground/depth/image_raw'))
    ground = names.get('/ground/rgb/image_raw') if 'ground' in robots else None
    if 'mav' in robots:  # a camera that sits on the ground robot is not the MAV's
        choose('/mav/camera/image_raw', [t for t in colours if ground is None or not _has(t, GROUND_WORDS) and (_has(t, MAV_WORDS) or not _same_robot(facts, t, ground))],
               lambda t: (_has(t, MAV_WORDS), not city and _has(t, DOWN_WORDS), _has(t, ('cam0', 'left', 'mono', 'gray', 'grey')), not RIGHT.search(t),
                          not INFRARED.search(t), 'raw' in t))
    cameras = ('/mav/camera/image_raw', '/ground/rgb/image_raw')
    for robot, camera, own, other in (('mav', '/mav/camera/image_raw', MAV_WORDS, GROUND_WORDS), ('ground', '/ground/rgb/image_raw', GROUND_WORDS, MAV_WORDS)):
        image = names.get(camera)
        if image is None or robot not in robots:
            continue
        other = other if all(names.get(c) for c in cameras) else ()
        parent = raw_name(image).rsplit('/', 1)[0]
        choose(camera.replace('image_raw', 'camera_info'), _infos(facts, parent), lambda t: 0)
        imus = _mounted(facts, [t for t in facts.of_type('sensor_msgs/Imu') if not _has(t, other)], image, [names.get(i) for i in cameras if i != camera])
        imu = choose(f'/{robot}/imu/data', [t for t in imus if 'accel' not in t],
                     lambda t, image=image, own=own: (_has(t, own), not _has(t, LIDAR_WORDS + TRUTH_WORDS), _common(t, image), 'raw' not in t, 'gyro' not in t))
        if imu is not None and 'gyro' in imu:
            choose(f'/{robot}/imu/accel', [t for t in imus if 'accel' in t], lambda t, imu=imu: _common(t, imu))
        choose(f'/ground_truth/{robot}', [t for t in facts.of_type(*POSE_TYPES) if _has(t, TRUTH_WORDS) and not _has(t, other)],
               lambda t, own=own: _has(t, own))
    if '/ground/depth/image_raw' in names:  # beside colour in one folder, it may have none of its own
        choose('/ground/depth/camera_info', _infos(facts, raw_name(names['/ground/depth/image_raw']).rsplit('/', 1)[0]), lambda t: 0)
    if city:
        for standard, kind in (('/gps/fix', 'sensor_msgs/NavSatFix'), ('/mav/imu/mag', 'sensor_msgs/MagneticField'), ('/barometer', 'sensor_msgs/FluidPressure')):
            choose(standard, facts.of_type(kind), lambda t: _has(t, MAV_WORDS))
    return names


def _mounted(facts, imus, image, others):
    """Of the IMUs those that /tf_static connects with the images' camera; where none is, those that are not on the other robot."""
    def connected(imu, topic):
        seen = recorded(facts, topic)
        return seen is not None and facts.static_transform(facts.frame(seen), facts.frame(imu)) is not None

    own = [imu for imu in imus if connected(imu, image)]
    return own or [imu for imu in imus if not any(other and connected(imu, other) for other in others)]


def guess_base(facts, robot, frame, names=None):
    """The body frame that /tf_static connects with a sensor's frame: <robot>_base_link, another base_link, else the root. Where it connects the sensor with
    nothing: the IMU's frame, as calibrations of camera and IMU tell their poses in it; without IMU the MAV's camera, whose vertical the ground map tells. None without."""
    parents = {child: parent for parent, child in facts.edges}
    chain = [frame]
    while chain[-1] in parents and len(chain) < 100:
        chain.append(parents[chain[-1]])
    if len(chain) == 1 and chain[0] not in parents.values():
        imu = facts.frame((names or {}).get(f'/{robot}/imu/data'))
        return (guess_base(facts, robot, imu) or imu) if imu else frame or None if robot == 'mav' else None
    return next((f for f in chain if f == f'{robot}_base_link'), None) or next((f for f in chain if 'base' in f or 'body' in f), chain[-1])


def command(facts, names, bases, frames, city=False, registered=True, arguments=()):
    """The roslaunch command for this bag. bases: robot -> body frame; frames: robot -> its images' frame; registered: depth is seen from the colour camera;
    arguments: further ones, as what is wrong with the bag asks for, in place of the topics guessed."""
    told = {argument.partition(':=')[0] for argument in arguments}
    names = {standard: topic for standard, topic in names.items() if (not registered or standard != '/ground/depth/camera_info') and ARGUMENTS[standard] not in told}
    robots = [robot for robot, image in (('mav', '/mav/camera/image_raw'), ('ground', '/ground/rgb/image_raw')) if image in names]
    words = ['roslaunch', 'air_ground', 'city.launch' if city else 'replay.launch', f'bag:={os.path.abspath(facts.path)}']
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
