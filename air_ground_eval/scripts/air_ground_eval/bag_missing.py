"""What is said of an input that a bag lacks: what else in it may be meant, else what provides it."""
import os
import shlex

from . import bag_camera, bag_frames, bag_guess, bag_imu
from .bag_finding import ERROR, WARNING, Finding
from .bag_robots import common, drives, flies, frame_of, on_one_body
from .bag_topics import IMAGE_TYPES, image_topics, packets, raw_name, recorded, republish, transport

OPTIONAL = {'/ground/imu/data', '/ground_truth/mav', '/ground_truth/ground', '/gps/fix', '/mav/imu/mag', '/barometer'}
INFO, IMAGE, IMU = '/mav/camera/camera_info', '/mav/camera/image_raw', '/mav/imu/data'


def import_line(facts, names):
    """The import_kalibr command for this bag's MAV. names: standard topic -> its name."""
    words = ['rosrun', 'air_ground', 'import_kalibr', 'CALIBRATION', '--bag', os.path.abspath(facts.path)]
    for option, standard in (('--image', IMAGE), ('--imu-topic', IMU)):
        words += [option, names[standard]] if names.get(standard) in facts.types or recorded(facts, names.get(standard)) else []
    return ' '.join(map(shlex.quote, words))


def mounting(facts, names, bases):
    """Of a MAV's camera of which a bag has neither calibration nor mounting: the transform that is to be filled in; '' for others."""
    image, base = names.get(IMAGE), bases['mav']
    frame = frame_of(facts, image) if transport(facts, image) else ''
    if not frame or names[INFO] in facts.types or similar(facts, INFO, ('sensor_msgs/CameraInfo',), names):
        return ''
    apart = facts.static_transform(base, frame) is None and not bag_frames.move(facts, base, frame) and not bag_frames.siblings(base, frame)
    return f'"{base} {frame} X Y Z QX QY QZ QW"' if apart else ''


def similar(facts, standard, types, names):
    """Topics of these types that may be meant: no reference is a robot's own estimate, no sensor another robot's, no calibration that of images of another size."""
    found = [t for t in facts.of_type(*types) if t not in names.values()]
    argument, robot = bag_guess.ARGUMENTS[standard], 'mav' if 'mav' in standard else 'ground' if 'ground' in standard else None
    if argument in ('mav_truth', 'ground_truth'):
        return [t for t in found if bag_guess.TRUTH_WORDS.search(t.lower()) or not bag_guess.OWN_WORDS.search(t.lower())]
    if robot:
        found = [t for t in found if not _of_another(facts, t, robot, names)]
    if standard.endswith('camera_info'):
        size = bag_guess.size(facts, names.get(standard.replace('camera_info', 'image_raw')))
        found = [t for t in found if not size or facts.counts[t] and bag_camera.stated_size(facts.first_message(t)) == size]
    return found


def _of_another(facts, topic, robot, names):
    """Whether a topic is the other robot's: by its name, by what it sits on, or because it begins as that robot's images do."""
    own, other = (names.get(bag_guess.CAMERAS[r]) for r in (robot, 'ground' if robot == 'mav' else 'mav'))
    if not other or not transport(facts, other):
        return False
    if own and transport(facts, own) and on_one_body(facts, topic, own):
        return False
    return (drives if robot == 'mav' else flies)(facts, topic) or on_one_body(facts, topic, other) is True or common(topic, other) > common(topic, own or '')


def check(facts, standard, types, purpose, names, city, transform):
    """The finding. purpose: what the input serves; transform: as mounting() has it."""
    topic, level = names[standard], WARNING if standard in OPTIONAL else ERROR
    if topic in facts.types:
        return Finding(level, f'{topic} has type {facts.types[topic]}, expected {" or ".join(types)}')
    if types[0] in IMAGE_TYPES and topic in packets(facts):
        return Finding(level, f'{topic} is there as {packets(facts)[topic]} alone, which no node decodes: {republish(facts, topic)}')
    argument, other = bag_guess.ARGUMENTS[standard], similar(facts, standard, types, names)
    hint = f'; the bag has {", ".join(other[:4])} of this type: set {argument}:= (here: --map)' if other else ''
    without = ''
    if standard.endswith('camera_info') and not other:
        hint = _calibration(facts, standard, names, transform)
    elif standard == IMU and not other:
        what = 'the fixes' if city else "the alignment with the ground robot's map"
        level, hint = WARNING, f': mav_use_imu:=false lets {what} tell the scale'
    elif standard == '/ground/imu/data' and not other:
        without = bag_imu.without(standard)
        hint = f': {without} waits for none'
    return Finding(level, f'{topic} is missing ({purpose}){hint}', without)


def _calibration(facts, standard, names, transform):
    image = names.get(standard.replace('camera_info', 'image_raw'), standard)
    command = 'rosrun air_ground publish_calibration --camera-info FILE.yaml' + (f' --transform {transform}' if transform else '') + f' image:={image} camera_info:={standard}'
    if standard != INFO:
        return f': publish it beside the replay: {command}'
    nothing = ', and nothing tells where the camera sits' if transform else ''
    return (f'{nothing}: where there is a file of a calibration (kalibr, EuRoC\'s sensor.yaml, OpenVINS, VINS, ORB-SLAM3 ...),  {import_line(facts, names)}  makes of it all that is needed, and prints '
            f'the command; else publish it beside the replay: {command}')


def undecoded(facts, names):
    """Warnings about the images of no input that the bag holds only as no node decodes them."""
    return [Finding(WARNING, f'{topic} is there as {kind} alone, which no node decodes and nothing here looks at: {republish(facts, topic)}')
            for topic, kind in packets(facts).items() if topic not in names.values()]


def other_depth(facts, topic):
    """Where a bag has depth images beside those of a topic, what to say of it."""
    others = [t for t in bag_guess.kinds(facts, image_topics(facts))[0] if t != raw_name(topic)]
    return f'; the bag has depth on {", ".join(others[:4])}, too (--map TOPIC:=ground_depth)' if others else ''
