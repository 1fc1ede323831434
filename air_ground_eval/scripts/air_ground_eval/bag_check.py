"""Checks of a bag against what the nodes need: topics, types, rates, stamps, calibration, IMU units, frames, transforms."""
import shlex

import numpy as np

from . import bag_camera, bag_depth, bag_frames, bag_guess, bag_imu, bag_missing, bag_names, bag_parts, city_truth, own_outputs
from .bag_finding import ERROR, OK, WARNING, Finding, quoted
from .bag_missing import OPTIONAL
from .bag_reader import APART, POSE_TYPES, BagFacts, open_bag
from .bag_registration import Registration
from .bag_topics import packets, raw_name, recorded, transport

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
ELSEWHERE = ('/ground/depth/camera_info', '/mav/imu/accel', '/ground/imu/accel')  # not there unless depth is not registered, or the IMU in two parts
BURSTS = 3  # times the median step: a long one, as it lies between packets of messages
LACKING = 0.05  # of the messages
IMAGES = {'mav': '/mav/camera/image_raw', 'ground': '/ground/rgb/image_raw'}
REGISTRATION = ('/ground/depth/image_raw', '/ground/rgb/image_raw', '/ground/depth/camera_info', '/ground/rgb/camera_info')
SPREAD = 24  # messages from all over a topic that are kept, at most
FEW = 0.01  # of the messages, or one, may lack a stamp: the nodes do without these
PRESSURES = (20e3, 120e3)  # [Pa]: as ekf_tracker takes them


class Stream:
    """Stamps, bag times, frame ids and a few first messages of a topic; with `spread` some from all over the bag, too."""

    def __init__(self, spread=False):
        self.stamps, self.times, self.frames, self.samples, self.spread, self.accel, self.gyro = [], [], set(), [], [], [], []
        self.unstamped = 0  # messages without stamp that were left out
        self._step = 1 if spread else None

    def add(self, message, time):
        """time: of the bag [s]."""
        if len(self.samples) < 3:
            self.samples.append(message)
        if self._step and len(self.times) % self._step == 0:
            self.spread.append(message)
            if len(self.spread) > SPREAD:
                self.spread, self._step = self.spread[::2], 2 * self._step
        self.times.append(time)
        if hasattr(message, 'header'):
            self.stamps.append(message.header.stamp.to_sec())
            self.frames.add(message.header.frame_id)
        if message._type == 'sensor_msgs/Imu':
            a, w = message.linear_acceleration, message.angular_velocity
            self.accel.append((a.x, a.y, a.z))
            self.gyro.append((w.x, w.y, w.z))

    def leave_out_unstamped(self):
        """Messages without stamp, where they are few, as the nodes do. Calibrations need none."""
        kept = np.flatnonzero(np.array(self.stamps) > 0)
        lacking = len(self.stamps) - len(kept)
        if not 0 < lacking <= max(1, FEW * len(self.stamps)) or len(kept) < 2 or self.samples[0]._type == 'sensor_msgs/CameraInfo':
            return
        self.unstamped = lacking
        for column in ('stamps', 'times', 'accel', 'gyro'):
            values = getattr(self, column)
            setattr(self, column, [values[i] for i in kept] if values else [])


def read(path, topics, limit=None, spread=()):
    """One pass over the bag; images are kept only as a few samples. `limit`: ends when every topic has so many messages; `spread`: see Stream."""
    streams = {topic: Stream(topic in spread) for topic in topics}
    if not streams:  # rosbag takes no topics for all of them
        return streams
    with open_bag(path) as bag:
        for topic, message, time in bag.read_messages(list(topics)):
            streams[topic].add(message, time.to_sec())
            if limit and all(len(s.times) >= limit for s in streams.values()):
                break
    return streams


def first_frames(facts, names):
    """robot -> frame id of its camera: as the nodes have it, of the first camera_info, else of the first image."""
    topics = {robot: recorded(facts, names.get(standard, standard)) for robot, standard in IMAGES.items()}
    infos = {robot: names.get(info := standard.replace('image_raw', 'camera_info'), info) for robot, standard in IMAGES.items()}
    frames = {robot: facts.frame(infos[robot]) or facts.frame(topic) for robot, topic in topics.items() if topic}
    frames.update({robot: facts.frame(infos[robot]) or '' for robot, standard in IMAGES.items() if names.get(standard) in packets(facts)})
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
    wanted = {standard: need for standard, need in wanted.items() if names.get(standard) != bag_guess.NONE}
    actual = {standard: names.get(standard, standard) for standard in wanted}
    apart = bag_missing.mounting(facts, actual, bases) if 'mav' in robots else ''
    findings = bag_missing.undecoded(facts, actual)
    present = {}
    for standard, (types, _, purpose) in wanted.items():
        topic = actual[standard]
        if otherwise := facts.defined_otherwise(topic):  # its fields may be others, too
            findings.append(Finding(ERROR, otherwise))
        elif topic in facts.types and facts.types[topic] in types:
            present[standard] = topic
        elif 'sensor_msgs/Image' in types and transport(facts, topic) == 'compressed':
            present[standard] = recorded(facts, topic)
            argument = bag_guess.compressed_argument(facts, bag_guess.ARGUMENTS[standard], topic)
            relay = bag_guess.relay(bag_guess.ARGUMENTS[standard], present[standard])
            instead = f', and beside it {relay}, since no node takes compressed images under this name' if relay else ''
            findings.append(Finding(WARNING, f'{raw_name(topic)} is there compressed, as {present[standard]}: replay with {argument}{instead}', beside=relay))
        elif standard not in ELSEWHERE:
            findings.append(bag_missing.check(facts, standard, types, purpose, actual, city, apart))
    streams = read(facts.path, present.values(), spread=[topic for standard, topic in present.items() if standard in ('/ground/depth/image_raw', '/barometer')])
    for stream in streams.values():
        stream.leave_out_unstamped()
    for robot in robots:
        bag_imu.unite(*(streams.get(present.get(f'/{robot}/imu/{part}')) for part in ('data', 'accel')))
    for standard, topic in present.items():
        findings += _stamps(standard, topic, streams[topic], wanted[standard][1])
    for standard, topic in present.items():
        if standard.endswith('camera_info'):
            findings += bag_camera.check_info(topic, streams[topic], present.get(standard.replace('camera_info', 'image_raw'), topic))
        elif standard.endswith('image_raw'):
            images = bag_camera.check_image(topic, streams[topic], bag_camera.DEPTH if 'depth' in standard else bag_camera.GREY, bag_missing.other_depth(facts, topic) if 'depth' in standard else '')
            findings += images + (bag_depth.check_range(topic, streams[topic].spread, [f.argument for f in images]) if 'depth' in standard else [])
        elif standard.endswith('imu/data'):
            findings += bag_imu.check(standard, topic, streams[topic], standard.replace('data', 'accel') in present)
            findings += bag_imu.gravity_and_start(topic, streams[topic], facts, bases[standard.split('/')[1]])
        elif standard == '/barometer':
            findings += _pressure(topic, streams[topic].spread)
        elif standard in CITY or standard.endswith('imu/accel') or not facts.counts[topic]:
            continue
        elif city:
            findings += [Finding(WARNING, text) for text in city_truth.doubts(facts, topic, bases['mav'])]
        elif streams[topic].frames != {'world'} and present.keys() >= {f'/ground_truth/{robot}' for robot in IMAGES}:
            findings.append(Finding(WARNING, f'{topic} is in frame {quoted(streams[topic].frames)}; the report takes both robots\' as one frame'))
    findings += _pairs(present, streams)
    findings += _clocks(present, streams)
    findings += bag_frames.check_static(facts)
    frames = {robot: {frame.lstrip('/') for standard, topic in present.items() if standard.startswith(f'/{robot}/') for frame in streams[topic].frames} for robot in robots}
    findings += bag_frames.check_odometry(facts, [image.split('/')[1] for image in bag_frames.IMAGES if image in present], bases, frames)
    findings += own_outputs.check(facts) + _elsewhen(facts) + [Finding(WARNING, text) for text in bag_parts.advice(facts.path)]
    registration = _registration(present, streams)
    findings += bag_frames.check_viewer(facts) or bag_frames.check(facts, present, streams, bases, registration is not None and registration.mismatch() != '',
                                                               bag_missing.import_line(facts, actual), apart != '')
    imu = streams.get(present.get('/ground/imu/data'))
    levelled = imu and np.any(imu.accel) and not any(f.argument == bag_imu.without('/ground/imu/data') for f in findings)
    if not levelled and '/ground/rgb/image_raw' in present:
        findings += bag_frames.check_level(bases['ground'])
    return findings


def examine(facts, city=False, present=('mav', 'ground'), given=None, bases=None, frames=None):
    """(names, findings, the command that replays the bag), guessed but for what is known: `given`: standard topic -> its name; `bases`, `frames`: robot -> its
    body frame, its images' frame. `present`: robots that may be in the bag."""
    adopted = bag_names.adopt(facts)
    names = bag_guess.guess(facts, city, present, given)
    robots = [robot for robot, image in IMAGES.items() if names.get(image) and not (city and robot == 'ground')] or list(present)
    frames = {**first_frames(facts, names), **(frames or {})}
    bases = {**{robot: bag_guess.guess_base(facts, robot, frame, names) or f'{robot}_base_link' for robot, frame in frames.items()}, **(bases or {})}
    findings = adopted + check(facts, names, bases, city, robots)
    arguments = dict.fromkeys(finding.argument for finding in findings if finding.argument)
    return names, findings, bag_guess.command(facts, names, bases, frames, city, city or registered(facts, names), arguments)


def _stamps(standard, topic, stream, least_rate):
    stamps = np.array(stream.stamps)
    result = []
    level, without = (WARNING, bag_imu.without(standard)) if standard in OPTIONAL else (ERROR, '')
    instead = f': replay without it, {without}' if without else ''
    if len(stamps) == 1 and standard.endswith('camera_info'):
        return [Finding(OK, f'{topic}: 1 message, taken for all images')]
    if len(stamps) < 2:
        without = bag_imu.without(standard)  # as where it is missing
        return [Finding(WARNING if without else level, f'{topic} holds {len(stamps)} message(s)' + (f': replay without it, {without}' if without else ''), without)]
    if np.any(stamps <= 0) and stream.samples[0]._type == 'sensor_msgs/CameraInfo':
        return [Finding(OK, f'{topic}: {len(stamps)} messages without stamp: each holds until the next one')]
    if np.any(stamps <= 0):
        return [Finding(level, f'{topic}: {np.count_nonzero(stamps <= 0)} of {len(stamps)} messages have no stamp (header.stamp is zero), and the nodes drop these: set it in the driver, or by '
                        f'rosrun air_ground join_bags BAG OUT --restamp {topic}, which goes by the others\' stamps or, where most have none, by the times of recording{instead}', without)]
    if stream.unstamped:
        result.append(Finding(WARNING, f'{topic}: {stream.unstamped} of {len(stamps) + stream.unstamped} messages have no stamp (header.stamp is zero): the nodes drop these, so few do no harm; '
                              f'rosrun air_ground join_bags BAG OUT --restamp {topic} gives them stamps between the others\', which stay as they are'))
    steps = np.diff(stamps)
    if np.any(steps < 0):
        result.append(Finding(WARNING, f'{topic}: stamps go back {np.count_nonzero(steps < 0)} times (by up to {-steps.min():.3f} s); '
                              'by more than 1 s the nodes start afresh'))
    if np.any(steps == 0):
        result.append(Finding(WARNING, f'{topic}: {np.count_nonzero(steps == 0)} stamps repeat; the repeated messages will be dropped'))
    rate = 1 / max(np.median(steps), 1e-9)
    gap = steps.max()
    long = steps > BURSTS / rate
    if long.mean() > 0.02 and steps[long].sum() > 0.7 * steps.sum():
        result.append(Finding(WARNING, f'{topic}: {1 / steps.mean():.0f} messages a second, but most of them within {1000 / rate:.2g} ms of another: stamped when a packet arrived, not '
                              'when they were measured; have the driver take the sensor\'s own clock'))
        return result
    if rate < bag_imu.SLOWEST and bag_imu.without(standard):
        result.append(bag_imu.too_slow(standard, topic, rate))
    elif rate < least_rate:
        result.append(Finding(WARNING, f'{topic}: {rate:.1f} Hz; at least {least_rate} Hz are advised'))
    pause = max(0.5, 5 / rate)
    if least_rate > 0 and gap > pause:
        result.append(Finding(WARNING, f'{topic}: a gap of {gap:.2f} s after {stamps[np.argmax(steps)] - stamps[0]:.1f} s'))
    lacking = np.maximum(np.round(steps[steps <= pause] * rate) - 1, 0)
    if least_rate > 0 and lacking.sum() > LACKING * len(stamps):
        result.append(Finding(WARNING, f'{topic}: {lacking.sum():.0f} of {len(stamps) + lacking.sum():.0f} messages are missing at {rate:.0f} Hz, up to {lacking.max():.0f} in a row: where the '
                              'recorder lost them, rosbag record --buffsize 0, compressed images or a faster disk help'))
    if not result:
        result.append(Finding(OK, f'{topic}: {len(stamps)} messages, {rate:.1f} Hz'))
    return result


def _pressure(topic, samples):
    """Of the air, in Pa."""
    median = np.median([message.fluid_pressure for message in samples]) if samples else PRESSURES[0]
    if PRESSURES[0] <= median <= PRESSURES[1]:
        return []
    return [Finding(WARNING, f'{topic}: its median pressure is {median:.4g}, not between 20 and 120 kPa, so that the tracker refuses it: is it in hPa (Pa are needed), or an airspeed sensor\'s '
                    'differential pressure (then name the barometer\'s topic: barometer_pressure:=, here --map)?')]


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
        alone = np.count_nonzero(distance > tolerance) if np.all(b > 0) else 0
        if alone > 0.02 * len(a):
            result.append(Finding(WARNING, f'{present[image]}: {alone} of {len(a)} images have no {present[other]} within {1000 * tolerance:g} ms'))
        if other.endswith('camera_info'):
            info, pictures = streams[present[other]].samples[0], streams[present[image]].samples
            size = next(filter(None, map(bag_camera.image_size, pictures)), None)
            stated = bag_camera.stated_size(info)
            if size and stated != size:
                result.append(Finding(ERROR, f'{present[other]} is for {stated[0]}x{stated[1]}, the images are {size[0]}x{size[1]}' + bag_camera.resized(info, size)))
        else:
            result += _depth_and_colour(present, streams)
    return result


def registered(facts, names):
    """Whether depth is as the colour camera sees it, by the first images and calibrations; True without any."""
    present = {standard: recorded(facts, names.get(standard, standard)) for standard in REGISTRATION[:2]}
    present.update({standard: names[standard] for standard in REGISTRATION[2:] if facts.counts.get(names.get(standard)) and names[standard] not in facts.foreign})
    if None in present.values():
        return True
    streams = {topic: Stream() for topic in present.values()}
    for topic, stream in streams.items():
        stream.add(facts.first_message(topic), 0.0)
    return not _registration(present, streams).mismatch()


def _registration(present, streams):
    """Of depth to colour, by their streams; None where one has no images."""
    depth, colour, *infos = (streams.get(present.get(standard)) for standard in REGISTRATION)
    if not (depth and colour and depth.samples and colour.samples):
        return None
    return Registration([s.samples[0] for s in (depth, colour)], [depth.frames, colour.frames], [s.samples[0] if s and s.samples else None for s in infos],
                        [present[standard] for standard in REGISTRATION[:2]])


def _depth_and_colour(present, streams):
    """Depth is to be seen from the colour camera, image by image, or to be registered to it."""
    topics, registration = [present[standard] for standard in REGISTRATION[:2]], _registration(present, streams)
    result = registration.check(*topics) if registration else []
    steps = [np.median(np.diff(streams[t].stamps)) if len(streams[t].stamps) > 1 else 0 for t in topics]
    if min(steps) > 0 and max(steps) > 1.2 * min(steps):
        result.append(Finding(WARNING, f'{topics[0]} comes at {1 / steps[0]:.1f} Hz, {topics[1]} at {1 / steps[1]:.1f} Hz: what has no partner is left out'))
    return result


def _delays(present, streams):
    """Stamps against the time of recording."""
    delays = {topic: np.median(np.array(s.times) - s.stamps) for topic, s in ((t, streams[t]) for t in present.values()) if len(s.stamps) > 1 and min(s.stamps) > 0}
    if len(delays) > 1 and min(np.abs(list(delays.values()))) > 1 > np.ptp(list(delays.values())):
        delay = np.median(list(delays.values()))
        return [Finding(OK, f'all stamps are {abs(delay):.1f} s {"before" if delay > 0 else "after"} the time of recording, by another clock, or recorded from another bag')]
    return [Finding(WARNING, f'{topic}: stamps are {abs(delay):.1f} s {"before" if delay > 0 else "after"} the time of recording') for topic, delay in delays.items() if abs(delay) > 1]


def _clocks(present, streams):
    """Stamps of an IMU against its camera's, of both robots against each other, and against the time of recording."""
    result, spans = _delays(present, streams), {}
    for robot, standard in IMAGES.items():
        if standard in present and len(streams[present[standard]].stamps) > 1:
            stream = streams[present[standard]]
            spans[robot] = (min(stream.stamps), max(stream.stamps), min(stream.times), max(stream.times))
            imu = streams.get(present.get(f'/{robot}/imu/data'))
            begin, end, *_ = spans[robot]
            if imu and imu.stamps and min(begin, min(stream.times), min(imu.stamps)) > 0 and (max(imu.stamps) < begin or end < min(imu.stamps)):
                result.append(Finding(ERROR, f'{present[standard]} is stamped {begin:.1f} to {end:.1f} s, {present[f"/{robot}/imu/data"]} {min(imu.stamps):.1f} to '
                                      f'{max(imu.stamps):.1f} s: two clocks. Let both drivers stamp by one, or take the time of recording: rosrun air_ground join_bags BAG OUT --restamp TOPIC'))
    if len(spans) < 2:
        return result
    mav, ground = spans['mav'], spans['ground']
    if mav[0] <= ground[1] and ground[0] <= mav[1]:
        return result
    if mav[2] <= ground[3] and ground[2] <= mav[3]:
        return result + [Finding(WARNING, f'the clocks of the robots do not overlap: recorded together, but stamped {mav[0]:.1f} to {mav[1]:.1f} s (MAV) and {ground[0]:.1f} to '
                        f'{ground[1]:.1f} s (ground robot), {abs(mav[0] - ground[0]):.1f} s apart. The alignment of their maps needs no common clock, but who looks up on tf where the MAV is in the ground map: synchronise them (chrony, ntp)')]
    return result + [Finding(WARNING, 'the robots were recorded one after the other: the replay leaps over the pause between them')]


def _elsewhen(facts):
    """What was recorded at another time than the sensors' messages."""
    if not facts.elsewhen:
        return []
    names = [f'{topic} ({count})' for topic, count in sorted(facts.elsewhen.items())]
    away = max(facts.begin - facts.recorded[0], facts.recorded[1] - facts.end)
    return [Finding(WARNING, f'recorded more than {APART:.0f} s before all images and IMU readings, or after them ({away:.0f} s at the most): {", ".join(names[:6])}{" ..." if len(names) > 6 else ""}. '
                    'Was the clock set meanwhile, or were they added? A replay leaves them out, but for static transforms; rosbag play would wait until then: '
                    f'rosbag filter {shlex.quote(facts.path)} NEW.bag "{facts.begin} <= t.to_sec() <= {facts.end}"  writes a bag without them')]
