"""What a guess of whose images are whose rests on, and what it might have been instead."""
from . import bag_guess, bag_robots
from .bag_topics import image_topics

MAV, GROUND = (bag_guess.CAMERAS[robot] for robot in ('mav', 'ground'))
MOST = 6  # topics that are named


def notes(facts, names, given, only=None, city=False):
    """Lines about the images. given: standard topics that somebody named; only: the robot that the bag was said to be of."""
    mav, ground, result = names.get(MAV), names.get(GROUND), []
    others = [t for t in bag_guess.kinds(facts, image_topics(facts))[1] if t not in names.values()]
    if not city and not only and MAV not in given and GROUND not in given:
        result = _robots(facts, mav, ground, names.get('/mav/imu/data'), others)
    if others and (mav or ground):
        standards = ' or '.join(bag_guess.ARGUMENTS[standard] for standard in (MAV, GROUND) if names.get(standard))
        result.append(f'other images: {_named(others)}: --map TOPIC:={standards} takes one of them instead')
    return result + [line for robot in bag_guess.CAMERAS for line in _references(facts, names, given, robot)]


def _named(topics):
    return ', '.join(topics[:MOST]) + (' ...' if len(topics) > MOST else '')


def _references(facts, names, given, robot):
    """Of several bodies that a motion capture tells of, one was taken for the robot."""
    standard = f'/ground_truth/{robot}'
    taken = names.get(standard)
    if taken in (None, standard) or standard in given or not names.get(bag_guess.CAMERAS[robot]):
        return []
    others = [t for t in bag_guess.references(facts, names, robot) if t not in names.values()]
    return [f'other reference poses than {taken}: {_named(others)}: --map TOPIC:={bag_guess.ARGUMENTS[standard]} takes one of them instead'] if others else []


def _robots(facts, mav, ground, imu, others):
    """Which robots the bag is taken to be of, where that is not said."""
    if mav and not ground:
        return [] if bag_robots.flies(facts, mav) else ["no depth images, without which there is no ground robot: taken for the MAV's"]
    if ground and not mav:
        strangers = [t for t in others if not bag_robots.common(t, ground) and not bag_robots.on_one_body(facts, t, ground)]
        if strangers:
            return [f"the depth camera is taken for the ground robot's, and no camera for the MAV's: where it is one of those below, --map TOPIC:=mav_image; --only mav takes {ground} for the MAV's"]
        return ["the bag is of one robot, with a depth camera: taken for the ground robot's; --only mav takes it for the MAV's"]
    if mav and not (mav == MAV or bag_robots.flies(facts, mav) or imu and bag_robots.flies(facts, imu) and bag_robots.on_one_body(facts, imu, mav) or _two_bodies(facts, mav, ground)):
        return [f"{mav} is taken for the MAV's, though nothing says so: where it is on the ground robot, --only ground"]
    return []


def _two_bodies(facts, *topics):
    """Whether the cameras sit on bodies of their own, by transforms that tell of both."""
    above = [bag_robots.above(facts, bag_robots.frame_of(facts, topic)) for topic in topics]
    return bag_robots.on_one_body(facts, *topics) is False and all(any(map(bag_robots.BODIES.search, map(str.lower, frames[1:]))) for frames in above)
