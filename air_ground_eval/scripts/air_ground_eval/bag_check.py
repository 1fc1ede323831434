"""Checks of a bag against what the nodes need: topics, types, rates, stamps, calibration, IMU units, frames, transforms."""
from collections import namedtuple

import cv2
import numpy as np

from . import bag_guess
from .bag_reader import POSE_TYPES, BagFacts, open_bag

ERROR, WARNING, OK = 'ERROR', 'WARNING', 'ok'
Finding = namedtuple('Finding', 'level text')

# standard topic: (types, least rate [Hz], who needs it)
MAV = {
    '/mav/camera/image_raw': (('sensor_msgs/Image',), 8, 'visual odometry'),
    '/mav/camera/camera_info': (('sensor_msgs/CameraInfo',), 0, 'visual odometry'),
    '/mav/imu/data': (('sensor_msgs/Imu',), 80, 'rotation prior and scale of visual odometry'),
    '/mav/imu/accel': (('sensor_msgs/Imu',), 0, 'specific force'),
    '/ground_truth/mav': (tuple(POSE_TYPES), 0, 'errors in the report')}
GROUND = {
    '/ground/rgb/image_raw': (('sensor_msgs/Image',), 5, 'RGB-D SLAM'),
    '/ground/rgb/camera_info': (('sensor_msgs/CameraInfo',), 0, 'RGB-D SLAM'),
    '/ground/depth/image_raw': (('sensor_msgs/Image',), 5, 'RGB-D SLAM'),
    '/ground/depth/camera_info': (('sensor_msgs/CameraInfo',), 0, 'registration of depth to colour'),
    '/ground/imu/data': (('sensor_msgs/Imu',), 80, 'the gravity direction of RGB-D SLAM'),
    '/ground/imu/accel': (('sensor_msgs/Imu',), 0, 'specific force'),
    '/ground_truth/ground': (tuple(POSE_TYPES), 0, 'errors in the report')}
CITY = {
    '/gps/fix': (('sensor_msgs/NavSatFix',), 0, 'GPS of the tracker, and for comparison'),
    '/mav/imu/mag': (('sensor_msgs/MagneticField',), 0, 'heading of the tracker with magnetometer'),
    '/barometer': (('sensor_msgs/FluidPressure',), 0, 'height of the tracker with barometer')}
OPTIONAL = {'/ground/imu/data', '/ground_truth/mav', '/ground_truth/ground', *CITY}
ELSEWHERE = ('/ground/depth/camera_info', '/mav/imu/accel', '/ground/imu/accel')  # not there unless depth is not registered, or the IMU in two parts
GREY = ('mono8', 'mono16', 'bgr8', 'rgb8', 'bgra8', 'rgba8', 'yuv422', *(f'bayer_{order}{bits}' for order in ('rggb', 'bggr', 'gbrg', 'grbg') for bits in (8, 16)),
        '8UC1', '8UC3', '8UC4')
DEPTH = ('16UC1', 'mono16', '32FC1')
MODELS = ('plumb_bob', 'rational_polynomial', 'equidistant')
IMAGES = {'mav': '/mav/camera/image_raw', 'ground': '/ground/rgb/image_raw'}
FLAT = 5  # [of 255]: spread of the brightness, below which hardly any corner is found
REST = 0.02  # [rad/s]: spread of the turn rate's means over 0.1 s, above the noise of consumer gyros and below any motion of a hand or a robot


class Stream:
    """Stamps, bag times, frame ids and a few first messages of a topic."""

    def __init__(self):
        self.stamps, self.times, self.frames, self.samples, self.accel, self.gyro = [], [], set(), [], [], []


def read(path, topics, limit=None):
    """One pass over the bag; images are kept only as a few samples. `limit`: ends when every topic has so many messages."""
    streams = {topic: Stream() for topic in topics}
    with open_bag(path) as bag:
        for topic, message, time in bag.read_messages(list(topics)):
            stream = streams[topic]
            stream.times.append(time.to_sec())
            if hasattr(message, 'header'):
                stream.stamps.append(message.header.stamp.to_sec())
                stream.frames.add(message.header.frame_id)
            if len(stream.samples) < 3:
                stream.samples.append(message)
            if message._type == 'sensor_msgs/Imu':
                a, w = message.linear_acceleration, message.angular_velocity
                stream.accel.append((a.x, a.y, a.z))
                stream.gyro.append((w.x, w.y, w.z))
            if limit and all(len(s.times) >= limit for s in streams.values()):
                break
    return streams


def first_frames(facts, names):
    """robot -> frame id of its first image."""
    topics = {robot: bag_guess.recorded(facts, names.get(standard, standard)) for robot, standard in IMAGES.items()}
    frames = {robot: facts.frame(topic) for robot, topic in topics.items() if topic}
    return {robot: frame for robot, frame in frames.items() if frame is not None}


def check(path, names=None, bases=None, city=False, robots=('mav', 'ground')):
    """Findings, most fundamental first.

    `names`: standard topic -> name in this bag; `bases`: robot -> its body frame, where that is not mav_base_link or ground_base_link;
    `city`: a flight for city.launch, without a ground robot; `robots`: those that are expected.
    """
    names = names or {}
    bases = {'mav': 'mav_base_link', 'ground': 'ground_base_link', **(bases or {})}
    wanted = {**(MAV if 'mav' in robots else {}), **(CITY if city else GROUND if 'ground' in robots else {})}
    facts = path if isinstance(path, BagFacts) else BagFacts(path)
    actual = {standard: names.get(standard, standard) for standard in wanted}
    findings = []
    present = {}
    for standard, (types, _, purpose) in wanted.items():
        topic = actual[standard]
        if topic in facts.types and facts.types[topic] in types:
            present[standard] = topic
        elif 'sensor_msgs/Image' in types and bag_guess.transport(facts, topic) == 'compressed':
            present[standard] = bag_guess.recorded(facts, topic)
            argument = bag_guess.TRANSPORT_ARGUMENTS[standard] + ':=compressed'
            findings.append(Finding(WARNING, f'{topic} is there as {present[standard]} alone: replay with {argument}'))
        elif standard not in ELSEWHERE:
            findings.append(_missing(facts, standard, topic, types, purpose, actual, city))
    streams = read(facts.path, present.values())
    for robot in robots:
        _unite(*(streams.get(present.get(f'/{robot}/imu/{part}')) for part in ('data', 'accel')))
    for standard, topic in present.items():
        findings += _stamps(topic, streams[topic], wanted[standard][1])
    for standard, topic in present.items():
        if standard.endswith('camera_info'):
            findings += _camera_info(topic, streams[topic])
        elif standard.endswith('image_raw'):
            findings += _image(topic, streams[topic], DEPTH if 'depth' in standard else GREY)
        elif standard.endswith('imu/data'):
            findings += _imu(topic, streams[topic])
            findings += _gravity_and_start(topic, streams[topic], facts, bases[standard.split('/')[1]])
        elif standard in CITY or city or standard.endswith('imu/accel') or not facts.counts[topic]:
            continue
        elif streams[topic].frames != {'world'}:
            findings.append(Finding(WARNING, f'{topic} is in frame {_list(streams[topic].frames)}; the report takes both robots\' as one frame'))
    findings += _pairs(present, streams)
    findings += _clocks(present, streams)
    findings += _static(facts)
    findings += _transforms(facts, present, streams, bases)
    return findings


def _missing(facts, standard, topic, types, purpose, actual, city):
    level = WARNING if standard in OPTIONAL else ERROR
    if topic in facts.types:
        return Finding(level, f'{topic} has type {facts.types[topic]}, expected {" or ".join(types)}')
    if f'{topic}/theora' in facts.types:
        return Finding(level, f'{topic} is there as {topic}/theora alone, which no node decodes: republish it as compressed (rosrun image_transport republish)')
    argument = bag_guess.ARGUMENTS[standard]
    similar = [t for t in facts.of_type(*types) if t not in actual.values()]
    hint = f'; the bag has {", ".join(similar[:4])} of this type: set {argument}:= (here: --map)' if similar else ''
    if standard.endswith('camera_info') and not similar:
        hint = '; rosrun air_ground publish_calibration publishes it from a file'
    if standard == '/mav/imu/data' and not similar and not city:
        level, hint = WARNING, ': mav_use_imu:=false lets the alignment with the ground robot\'s map tell the scale'
    return Finding(level, f'{topic} is missing ({purpose}){hint}')


def _list(frames):
    return ', '.join(repr(f) for f in sorted(frames))


def _stamps(topic, stream, least_rate):
    stamps, times = np.array(stream.stamps), np.array(stream.times)
    result = []
    if len(stamps) == 1 and not least_rate and 'camera_info' in topic:
        return [Finding(OK, f'{topic}: 1 message, taken for all images')]
    if len(stamps) < 2:
        return [Finding(ERROR, f'{topic} holds {len(stamps)} message(s)')]
    steps = np.diff(stamps)
    if np.any(stamps <= 0):
        result.append(Finding(ERROR, f'{topic}: {np.count_nonzero(stamps <= 0)} messages have no stamp'))
    if np.any(steps < 0):
        result.append(Finding(WARNING, f'{topic}: stamps go back {np.count_nonzero(steps < 0)} times (by up to {-steps.min():.3f} s); '
                              'by more than 1 s the nodes start afresh'))
    if np.any(steps == 0):
        result.append(Finding(WARNING, f'{topic}: {np.count_nonzero(steps == 0)} stamps repeat; the repeated messages will be dropped'))
    delay = np.median(times - stamps)
    if abs(delay) > 1.0:
        result.append(Finding(WARNING, f'{topic}: stamps are {delay:.1f} s before the time of recording'))
    rate = 1 / max(np.median(steps), 1e-9)
    gap = steps.max()
    if rate < least_rate:
        result.append(Finding(WARNING, f'{topic}: {rate:.1f} Hz; at least {least_rate} Hz are advised'))
    if least_rate > 0 and gap > max(0.5, 5 / rate):
        result.append(Finding(WARNING, f'{topic}: a gap of {gap:.2f} s after {stamps[np.argmax(steps)] - stamps[0]:.1f} s'))
    if not result:
        result.append(Finding(OK, f'{topic}: {len(stamps)} messages, {rate:.1f} Hz'))
    return result


def _camera_info(topic, stream):
    info = stream.samples[0]
    result = []
    if not (info.K[0] > 0 and info.K[4] > 0):
        result.append(Finding(ERROR, f'{topic}: fx = {info.K[0]:g}, fy = {info.K[4]:g}: the camera is not calibrated'))
    elif not (0.1 * info.width < info.K[2] < 0.9 * info.width and 0.1 * info.height < info.K[5] < 0.9 * info.height):
        result.append(Finding(WARNING, f'{topic}: principal point ({info.K[2]:.1f}, {info.K[5]:.1f}) is far from the centre of {info.width}x{info.height}'))
    if info.distortion_model not in (*MODELS, ''):
        result.append(Finding(ERROR, f'{topic}: distortion model {info.distortion_model!r}; the nodes know {", ".join(MODELS)}: undistort first'))
    elif info.distortion_model == '' and any(info.D):
        result.append(Finding(ERROR, f'{topic}: D is set but distortion_model is empty; plumb_bob is needed'))
    return result


def _image(topic, stream, encodings):
    image = stream.samples[0]
    result = []
    if image._type == 'sensor_msgs/CompressedImage':
        return result if image_size(image) else [Finding(ERROR, f'{topic}: the first image cannot be decoded (format {image.format!r})')]
    if image.encoding not in encodings:
        result.append(Finding(ERROR, f'{topic}: encoding {image.encoding!r}; expected one of {", ".join(encodings)}'))
    if len(image.data) != image.step * image.height:
        result.append(Finding(ERROR, f'{topic}: {len(image.data)} bytes for {image.height} rows of {image.step}'))
    elif image.encoding in ('16UC1', 'mono16') and encodings is DEPTH:
        dtype = np.dtype(np.uint16).newbyteorder('>' if image.is_bigendian else '<')
        depth = np.frombuffer(image.data, dtype).reshape(image.height, -1)
        valid = depth[depth > 0]
        if len(valid) < 0.02 * depth.size:
            result.append(Finding(WARNING, f'{topic}: {100 * len(valid) / depth.size:.1f} % of the first image has a depth'))
        elif np.median(valid) > 12000:
            result.append(Finding(WARNING, f'{topic}: median depth {np.median(valid)} counts; 16UC1 is read as millimetres (TUM: 5000 a metre)'))
    elif encodings is GREY:
        wide = '16' in image.encoding
        grey = np.frombuffer(stream.samples[-1].data, np.dtype(np.uint16).newbyteorder('>' if image.is_bigendian else '<') if wide else np.uint8) / (257 if wide else 1)
        if grey.std() < FLAT:
            result.append(Finding(WARNING, f'{topic}: image {len(stream.samples)} is flat (brightness {grey.mean():.0f} +- {grey.std():.1f} of 255): a covered lens? '
                                  + ('12 bits in 16? Scale them to the full range' if wide else 'too dark?')))
    return result


def image_size(message):
    """(width, height) of a raw or compressed image; None where that cannot be told. A compressedDepth image begins with 12 bytes of its own."""
    if message._type == 'sensor_msgs/Image':
        return message.width, message.height
    data = np.frombuffer(message.data, np.uint8)
    try:
        picture = cv2.imdecode(data[12:] if 'compressedDepth' in message.format else data, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        picture = None
    return None if picture is None else picture.shape[1::-1]


def _unite(gyro, accelerometer):
    """Gives a gyro's stream the accelerations of an accelerometer's own, where there is one, at its stamps."""
    if gyro and accelerometer and accelerometer.accel:
        gyro.accel = np.column_stack([np.interp(gyro.stamps, accelerometer.stamps, column) for column in np.array(accelerometer.accel).T])


def _imu(topic, stream):
    accel, gyro = np.array(stream.accel), np.array(stream.gyro)
    result = []
    if not (np.all(np.isfinite(accel)) and np.all(np.isfinite(gyro))):
        bad = np.count_nonzero(~np.isfinite(accel).all(1) | ~np.isfinite(gyro).all(1))
        result.append(Finding(WARNING, f'{topic}: {bad} readings are not finite'))
        finite = np.isfinite(accel).all(1) & np.isfinite(gyro).all(1)
        accel, gyro = accel[finite], gyro[finite]
    if len(accel) == 0:
        return result + [Finding(ERROR, f'{topic}: no finite reading')]
    norm = np.median(np.linalg.norm(accel, axis=1))
    if norm == 0:
        result.append(Finding(ERROR, f'{topic}: there is no acceleration in it; if the accelerometer has a topic of its own, name it: mav_imu_accel:= or '
                              'ground_imu_accel:= (here: --map TOPIC:=/mav/imu/accel)'))
    elif 0.9 < norm < 1.1:
        result.append(Finding(ERROR, f'{topic}: the acceleration is about {norm:.2f}: it is in g; m/s^2 are needed'))
    elif norm < 2:
        result.append(Finding(ERROR, f'{topic}: the acceleration is about {norm:.2f} m/s^2: gravity was removed; specific force is needed'))
    elif not 8.5 < norm < 11.5:
        result.append(Finding(WARNING, f'{topic}: the acceleration is about {norm:.2f} m/s^2, not 9.81'))
    rate = np.median(np.linalg.norm(gyro, axis=1))
    if np.max(np.abs(gyro)) > 35:
        result.append(Finding(ERROR, f'{topic}: turn rates up to {np.max(np.abs(gyro)):.0f}: they seem to be in degrees; rad/s are needed'))
    elif rate == 0:
        result.append(Finding(WARNING, f'{topic}: the turn rate is always zero'))
    return result


def _pairs(present, streams):
    """Images with their camera_info, and colour with depth."""
    result = []
    for image, other, tolerance in (('/mav/camera/image_raw', '/mav/camera/camera_info', 1e-6),
                                    ('/ground/rgb/image_raw', '/ground/rgb/camera_info', 1e-6),
                                    ('/ground/rgb/image_raw', '/ground/depth/image_raw', 0.02)):
        if image not in present or other not in present:
            continue
        a, b = np.array(streams[present[image]].stamps), np.sort(streams[present[other]].stamps)
        if not len(a) or not len(b):
            continue
        if len(b) == 1 and other.endswith('camera_info'):
            tolerance = np.inf
        i = np.clip(np.searchsorted(b, a), 1, max(len(b) - 1, 1))
        distance = np.minimum(np.abs(b[np.minimum(i, len(b) - 1)] - a), np.abs(b[i - 1] - a))
        alone = np.count_nonzero(distance > tolerance)
        if alone > 0.02 * len(a):
            result.append(Finding(WARNING, f'{present[image]}: {alone} of {len(a)} images have no {present[other]} within {1000 * tolerance:g} ms'))
        if other.endswith('camera_info'):
            info, picture = streams[present[other]].samples[0], streams[present[image]].samples[0]
            size = image_size(picture)
            if size and (info.width, info.height) != size:
                result.append(Finding(ERROR, f'{present[other]} is for {info.width}x{info.height}, the images are {size[0]}x{size[1]}'))
        else:
            result += _registration(present[image], streams[present[image]], present[other], streams[present[other]],
                                    '/ground/depth/camera_info' in present)
    return result


def registered(facts, names):
    """Whether depth is as the colour camera sees it, by the size and frame of the first images; True without any."""
    wanted = [names.get(standard, standard) for standard in ('/ground/rgb/image_raw', '/ground/depth/image_raw')]
    topics = [next((t for t in facts.of_type('sensor_msgs/Image', 'sensor_msgs/CompressedImage') if bag_guess.raw_name(t) == topic), None) for topic in wanted]
    if None in topics:
        return True
    streams = read(facts.path, topics, limit=1)
    return not _mismatch(*(streams[t] for t in topics))


def _mismatch(colour, depth):
    """By what depth images show that another camera than the colour camera took them; empty where nothing does."""
    if not colour.samples or not depth.samples:
        return ''
    sizes = image_size(colour.samples[0]), image_size(depth.samples[0])
    if None not in sizes and sizes[0] != sizes[1]:
        return 'differ in size'
    return '' if depth.frames == colour.frames else f'are in frames {_list(depth.frames)} and {_list(colour.frames)}'


def _registration(colour_topic, colour, depth_topic, depth, calibrated):
    """Depth is to be seen from the colour camera, image by image, or to be registered to it."""
    result, mismatch = [], _mismatch(colour, depth)
    if mismatch and calibrated:
        result.append(Finding(WARNING, f'{depth_topic} and {colour_topic} {mismatch}: depth seems not to be registered to colour: replay with '
                              'ground_depth_registered:=false, or record the registered one (aligned_depth_to_color, depth_registered)'))
    elif mismatch:
        result.append(Finding(ERROR, f'{depth_topic} and {colour_topic} {mismatch}: depth seems not to be registered to colour, and the depth camera\'s '
                              'calibration is missing: record it (camera_info beside the images), or the registered depth (aligned_depth_to_color, depth_registered)'))
    steps = [np.median(np.diff(s.stamps)) if len(s.stamps) > 1 else 0 for s in (colour, depth)]
    if min(steps) > 0 and max(steps) > 1.2 * min(steps):
        result.append(Finding(WARNING, f'{depth_topic} comes at {1 / steps[1]:.1f} Hz, {colour_topic} at {1 / steps[0]:.1f} Hz: what has no partner is left out'))
    return result


def _gravity_and_start(topic, stream, facts, base):
    """Whether the mean specific force points up in the body frame, and whether the recording begins at rest."""
    accel, gyro, stamps = np.array(stream.accel), np.array(stream.gyro), np.array(stream.stamps)
    finite = np.isfinite(accel).all(1) & np.isfinite(gyro).all(1)
    accel, gyro, stamps = accel[finite], gyro[finite], stamps[finite]
    result = []
    if len(accel) < 20:
        return result
    T_base_imu = facts.static_transform(base, sorted(stream.frames)[0].lstrip('/'))
    mean = accel.mean(0)
    if T_base_imu is not None and np.linalg.norm(mean) > 0:
        up = T_base_imu[:3, :3] @ mean / np.linalg.norm(mean)
        if up[2] < np.cos(np.radians(45)):
            sign = ', or it has the sign of gravity (at rest it must be +9.81 along the axis that points up)' if up[2] < -np.cos(np.radians(45)) else ''
            result.append(Finding(WARNING, f'{topic}: its mean acceleration points along ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}) of {base}, which is not up: '
                                  f'the mounting {base} -> {_list(stream.frames)} or the order of the axes is wrong (or {base} is not z up){sign}'))
    first = stamps <= stamps[0] + 1.0
    bins = ((stamps[first] - stamps[0]) / 0.1).astype(int)
    means = np.array([gyro[first][bins == b].mean(0) for b in np.unique(bins)])
    if len(means) > 4 and np.linalg.norm(means.std(0)) > REST:
        result.append(Finding(WARNING, f'{topic}: the recording begins in motion; gyro bias and gravity are known later than after a second at rest'))
    return result


def _clocks(present, streams):
    """Both robots' stamps against each other and against the time of recording."""
    spans = {}
    for robot, standard in IMAGES.items():
        if standard in present and len(streams[present[standard]].stamps) > 1:
            stream = streams[present[standard]]
            spans[robot] = (min(stream.stamps), max(stream.stamps), min(stream.times), max(stream.times))
    if len(spans) < 2:
        return []
    mav, ground = spans['mav'], spans['ground']
    if mav[0] <= ground[1] and ground[0] <= mav[1]:
        return []
    if mav[2] <= ground[3] and ground[2] <= mav[3]:
        return [Finding(ERROR, f'the clocks of the robots do not overlap: recorded together, but stamped {mav[0]:.1f} to {mav[1]:.1f} s (MAV) and {ground[0]:.1f} to '
                        f'{ground[1]:.1f} s (ground robot), {abs(mav[0] - ground[0]):.1f} s apart: synchronise them (chrony, ntp)')]
    return [Finding(WARNING, 'the robots were recorded one after the other: the replay runs through the pause between them')]


def _static(facts):
    """How the static transforms were recorded."""
    result = [Finding(ERROR, f'/tf_static: the rotation of {edge} is zero or not finite') for edge in sorted(facts.broken_edges)]
    how = [f'in {facts.static_messages} messages'] if facts.static_messages > 1 else []
    how += ['not latched'] if facts.static_messages and not facts.static_latched else []
    if how:
        result.append(Finding(OK, f'/tf_static comes {" and ".join(how)}: replay.launch hands it on whole; rosbag play by itself does not'))
    if facts.constant_on_tf:
        result.append(Finding(OK, f'/tf holds transforms that never change, of {_list(facts.constant_on_tf)}: replay.launch takes them as static'))
    if '/clock' in facts.types:
        result.append(Finding(OK, '/clock is in the bag: replay.launch leaves it out; rosbag play --clock by itself does not'))
    return result


def _transforms(facts, present, streams, bases):
    result = []
    sensors = (('mav', '/mav/camera/image_raw'), ('mav', '/mav/imu/data'), ('ground', '/ground/rgb/image_raw'), ('ground', '/ground/imu/data'))
    for robot, standard in sensors:
        if standard not in present:
            continue
        frames = streams[present[standard]].frames
        if '' in frames:
            result.append(Finding(ERROR, f'{present[standard]}: the frame id is empty'))
            continue
        if len(frames) > 1:
            result.append(Finding(WARNING, f'{present[standard]}: several frame ids: {_list(frames)}'))
        frame = sorted(frames)[0].lstrip('/')
        if facts.static_transform(bases[robot], frame) is None:
            result.append(Finding(ERROR, f'/tf_static does not connect {bases[robot]} with {frame} (of {present[standard]}): '
                                  f'rosrun air_ground publish_calibration --transform "{bases[robot]} {frame} X Y Z QX QY QZ QW" beside the replay'))
    return result
