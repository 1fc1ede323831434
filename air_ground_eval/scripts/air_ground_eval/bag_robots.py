"""Whose a topic of a bag is: by what merge_bags wrote before it, by names, by what sits on one body."""
import re

from .bag_topics import IMAGE_TYPES, recorded, with_slash

# What topics say of whom they are: whole words, or beginnings of words, where a part of another word would mean something else (stairs, quadruped, background).
MAV_WORDS = re.compile(r'drone|copter|quadrotor|multirotor|hummingbird|firefly|bebop|anafi|(?<![a-z])((mav|uav|dji|px4|airsim)|(quad|air|aerial|fly|flying|iris|tello)(?![a-z]))')
GROUND_WORDS = re.compile(r'robot|husky|jackal|turtlebot|summit|pioneer|kinect|realsense|(?<![a-z])(ground|ugv|rover|tb3)')
EYES = re.compile(r'/?(ir|infra(red)?_?\d?|(depth|rgb|ir)_to_(depth|rgb|ir))/')  # a depth camera's images of other kinds, in no folder of its driver (Azure Kinect)
MERGED_TOPIC, MERGED_FRAME = re.compile('/(mav|ground)/'), re.compile('(mav|ground)(?!_?truth)[_/]')  # as merge_bags, and this project, name them
WORLDS = re.compile(r'(^|[/_])(map|odom|world|earth|global|local|enu|ned|utm|origin|vicon|mocap|optitrack)')  # what robots move in, not what moves
BODIES = re.compile('base|body|foot')


def has(topic, words):
    """Whether a topic's name says one of the words; ground_truth is no ground robot."""
    return words.search(re.sub('ground_?truth', 'truth', topic.lower())) is not None


def common(a, b):
    """How many words of two topics agree from the front."""
    count = 0
    for x, y in zip(a.strip('/').split('/'), b.strip('/').split('/')):
        if x != y:
            break
        count += 1
    return count


def above(facts, frame):
    """A frame and those above it, on /tf_static and on /tf."""
    parents, result = {**{child: parent for parent, child in facts.edges}, **facts.moving}, [frame]
    while (parent := parents.get(result[-1])) is not None and parent not in result:
        result.append(parent)
    return result


def frame_of(facts, topic):
    """Of the messages of a topic, whatever its transport; '' without one."""
    return facts.frame(recorded(facts, topic) or topic) or ''


def owner(facts, topic):
    """'mav' or 'ground', as the beginning of the topic says, or of the next frame with such a beginning that its own hangs on; None where none does."""
    found = MERGED_TOPIC.match(with_slash(topic)) or next(filter(None, map(MERGED_FRAME.match, above(facts, frame_of(facts, topic)))), None)
    return found and found[1]


def flies(facts, topic):
    """Whether a topic is the MAV's, as it says."""
    named = owner(facts, topic)
    return named == 'mav' if named else has(topic, MAV_WORDS)


def drives(facts, topic):
    """Whether a topic is the ground robot's, as it says. That it is a robot's tells nothing where other topics are another robot's (/robot1, /robot2)."""
    named = owner(facts, topic)
    if named or not has(topic, GROUND_WORDS):
        return named == 'ground'
    spaces = {with_slash(t).split('/')[1] for t in facts.of_type(*IMAGE_TYPES, 'sensor_msgs/Imu')}
    return sum('robot' in space.lower() for space in spaces) < 2 or has(topic.lower().replace('robot', ''), GROUND_WORDS)


def joined(facts, a, b):
    """Whether two frames are of one robot: a static transform connects them, or the transforms of one that moves its limbs; None where those do not know both."""
    if facts.static_transform(a, b) is not None:
        return True
    over = above(facts, b)
    meeting = next((frame for frame in above(facts, a) if frame in over), None)
    if meeting is not None and not WORLDS.search(meeting.lower()) and (meeting != over[-1] or BODIES.search(meeting.lower())):
        return True
    known = {frame for edge in [*facts.edges, *facts.moving.items()] for frame in edge}
    return False if {a, b} <= known else None


def on_one_body(facts, a, b):
    """joined() of two topics."""
    frames = frame_of(facts, a), frame_of(facts, b)
    return joined(facts, *frames) if all(frames) else None


def may_fly(facts, topic, ground):
    """Whether a camera may be the MAV's, beside that of the ground robot's images (None: there is none): not one that sits on it, by transforms or, without them, by the folder of
    their driver, nor another eye of it where the driver has no folder."""
    if owner(facts, topic) or ground is None:
        return owner(facts, topic) != 'ground'
    if drives(facts, topic):
        return False
    connected = on_one_body(facts, topic, ground)
    return flies(facts, topic) or (not connected if connected is not None else common(topic, ground) == 0 and not EYES.match(topic))
