"""Which reference poses of a bag are a robot's: a motion capture tells of all bodies in its room."""
import functools
import re

import numpy as np
import rospy

from .bag_reader import POSE_TYPES, POSITION_TYPES, open_bag
from .bag_robots import common, drives, flies, has

TRUTH_WORDS = re.compile(r'truth|vicon|vrpn|mocap|leica|optitrack|qualisys|natnet|(?<![a-z])gt(?![a-z])')
ANY_ROBOTS = re.compile(r'(mav|uav|ground|base|link|footprint|body|frame|optical|imu|cam(era)?)\d*')  # words of frames that tell nothing of whose they are
LOOKS, LOOK = 20, 1.0  # so many looks at the recording, each as long as this at most [s]
STILL = 0.02  # [m], and of the numbers of a quaternion: what moves less all along is furniture, or a wand that was put down


@functools.lru_cache(maxsize=16)  # asked for again with each guess
def moving(facts, topics):
    """Those of the topics (a tuple) whose body moves; all, where none does. By a message of each at some times: a motion capture sends hundreds a second."""
    seen = {topic: [] for topic in topics}
    with open_bag(facts.path) as bag:
        for begin in np.linspace(facts.begin, facts.end, LOOKS, endpoint=False):
            waiting = set(topics)
            for topic, message, _ in bag.read_messages(list(topics), rospy.Time(begin), rospy.Time(begin + LOOK)):
                if topic in waiting:
                    waiting.remove(topic)
                    seen[topic].append(_numbers(message))
                if not waiting:
                    break
    finite = {topic: [row for row in rows if np.all(np.isfinite(row))] for topic, rows in seen.items()}  # of a body out of sight it sends NaN
    return [topic for topic, rows in finite.items() if rows and np.max(np.ptp(rows, axis=0)) > STILL] or list(topics)


def _numbers(message):
    """Position [m] and quaternion, whose sign is free, of a message."""
    p, q = POSE_TYPES[message._type](message)
    turn = np.array([q.x, q.y, q.z, q.w]) if q else np.zeros(4)
    return [p.x, p.y, p.z, *np.abs(turn)]


def candidates(facts, robot, image, others):
    """Topics of reference poses that may be a robot's, whose images are `image`; others: those of other robots, where there are any. Poses that say of neither are nobody's."""
    own, theirs = (flies, drives) if robot == 'mav' else (drives, flies)
    found = [t for t in facts.of_type(*POSE_TYPES) if has(t, TRUTH_WORDS) and facts.counts[t] > 1 and t not in facts.foreign and not (others and theirs(facts, t))
             and (not others or own(facts, t) or common(t, image) > max(common(t, other) for other in others))]
    return moving(facts, tuple(found)) if len(found) > 1 else found


def _words(name):
    return {word for word in re.split('[^a-z0-9]+', name.lower()) if word}


def rank(facts, robot, base, topics):
    """How likely a reference is a robot's, as a key: poses before positions, then by the name of its base frame (None: not known), by what it says, and by the names of its topics."""
    own = flies if robot == 'mav' else drives
    base, named = {word for word in _words(base or '') if not ANY_ROBOTS.fullmatch(word)}, set().union(*map(_words, topics))
    return lambda t: (facts.types[t] not in POSITION_TYPES, len(base & _words(t)), own(facts, t), len(named & _words(t)))
