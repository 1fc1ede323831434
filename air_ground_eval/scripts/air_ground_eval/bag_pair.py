"""What check_bag cannot guess of a merged bag: the two robots' own bags tell whose each topic is."""
from . import bag_check, bag_guess, bag_names
from .bag_reader import BagFacts
from .bag_topics import recorded

IMAGES = ('/ground/depth/image_raw', '/ground/rgb/image_raw', '/mav/camera/image_raw')  # by which the others are guessed


def arguments(parts, path):
    """check_bag's arguments by which it takes of a merged bag what it would take of each part alone; those that it guesses by itself are left out. parts: of bag_merge, as they are in
    the bag at `path`."""
    facts, wanted, bases, given = BagFacts(path), {}, {}, {}
    for part in parts:
        names, bases[part.robot] = _of_part(part)
        wanted.update({standard: topic for standard, topic in names.items() if (recorded(facts, topic) or topic) in facts.types})  # a stretch may lack some
    robots = [part.robot for part in parts if bag_guess.CAMERAS[part.robot] in wanted]
    if not robots:
        return []
    bag_names.adopt(facts)
    names = bag_guess.guess(facts, robots=robots)
    for standard in sorted(filter(lambda s: _robot(s) in robots, bag_guess.ARGUMENTS), key=lambda s: s not in IMAGES):
        if names.get(standard) != wanted.get(standard) and (standard in wanted or bag_guess.MAY_LACK.match(standard)):
            given[standard] = wanted.get(standard, bag_guess.NONE)
            names = bag_guess.guess(facts, robots=robots, given=given)
    result = ['--only', *robots] if len(robots) == 1 else []
    for standard, topic in given.items():
        result += ['--map', f'{topic}:={bag_guess.ARGUMENTS[standard]}']
    for robot in robots:
        result += [f'--{robot}-base', bases[robot]] if bases[robot] != _base(facts, robot, names) else []
    return result


def _robot(standard):
    """Whose a standard topic is; None of one that is the city's."""
    return next((robot for robot in bag_guess.CAMERAS if standard.startswith(f'/{robot}/') or standard == f'/ground_truth/{robot}'), None)


def _base(facts, robot, names):
    return bag_guess.guess_base(facts, robot, bag_check.first_frames(facts, names).get(robot), names) or f'{robot}_base_link'


def _of_part(part):
    """(standard topic -> topic, body frame) that are guessed of a robot's own bag, by their names in the merged one."""
    bag_names.adopt(part.facts)
    names = {standard: topic for standard, topic in bag_guess.guess(part.facts, robots=(part.robot,)).items() if _robot(standard) == part.robot}
    if bag_guess.CAMERAS[part.robot] not in names:
        return {}, None
    return {standard: _renamed(part, topic) for standard, topic in names.items()}, part.frame(_base(part.facts, part.robot, names))


def _renamed(part, topic):
    """A topic, of images without the name of their transport, as the merged bag has it."""
    kept = recorded(part.facts, topic) or topic
    moved = part.topic(kept)
    return moved[:len(moved) - len(kept) + len(topic)]
