"""Mountings that a bag holds under other names than those by which the nodes look for them: on /tf_static of a namespace, or with a prefix (tf_prefix)."""
from collections import Counter

import numpy as np

from . import messages
from .bag_finding import OK, WARNING, Finding, quoted
from .bag_frames import publish
from .bag_topics import IMAGE_TYPES, with_slash


def adopt(facts):
    """Takes such mountings as publish_calibration says them beside a replay; findings that print its commands. Before topics and bases are guessed."""
    sensors = {}  # frame -> topics
    for topic in facts.of_type(*IMAGE_TYPES, 'sensor_msgs/Imu'):
        if facts.frame(topic):
            sensors.setdefault(facts.frame(topic), []).append(topic)
    return [finding for space in facts.elsewhere for finding in _namespace(facts, space, sensors)] + _prefixes(facts, set(sensors))


def _frames(edges):
    return {frame for edge in edges for frame in edge}


def _namespace(facts, space, sensors):
    """The chains that connect sensors with the roots of a namespace's tree. A frame that other trees have, too, has the namespace before its name, but
    for those that images and IMUs name."""
    parents = {child: (parent, transform) for (parent, child), transform in facts.elsewhere[space].items()}
    own = set(sensors) & set(parents) - {child for _, child in facts.edges}
    if not own:
        return [Finding(OK, f'tf of {space} is heard by no node, and tells of no camera or IMU that /tf_static does not')]
    others = _frames(facts.edges) | _frames(edge for other, edges in facts.elsewhere.items() if other != space for edge in edges)
    shared = {frame for frame in own if any(frame == child for other, edges in facts.elsewhere.items() if other != space for _, child in edges)}
    text = f'tf of {space} says where {quoted(own)} {"is" if len(own) == 1 else "are"}'
    if shared:
        return [Finding(WARNING, f'{text}, as another namespace does of {quoted(shared)}, and a frame has one place: of the bags that each robot recorded, rosrun air_ground merge_bags FLIGHT.bag '
                        'GROUND.bag BOTH.bag names the frames apart; else have each publish its own (tf_prefix)')]
    kept = own | {frame for frame, topics in sensors.items() if any(with_slash(t).startswith(f'{space}/') for t in topics)}
    names = {frame: frame if frame in kept or frame not in others else f'{space[1:]}/{frame}' for frame in _frames(facts.elsewhere[space])}
    edges = {}
    for frame in sorted(own):
        while frame in parents and frame not in edges:
            parent, transform = parents[frame]
            edges[frame] = names[parent], names[frame], transform
            frame = parent
    return [_taken(facts, edges.values(), f'{text}, and the nodes hear /tf_static and /tf alone: needed beside the replay (and live) is')]


def _prefixes(facts, sensors):
    """Frames of sensors that are those of transforms but for a prefix."""
    known = _frames(facts.edges)
    alike = {frame: sorted(k for k in known - sensors if k.endswith(f'/{frame}') or frame.endswith(f'/{k}')) for frame in sorted(sensors - known)}
    uses = Counter(k for found in alike.values() for k in found)
    result = []
    for frame, found in alike.items():
        text = f'{frame!r} of images or IMU is in no transform, {", ".join(map(repr, found))} {"is" if len(found) == 1 else "are"}: by a tf_prefix?'
        if len(found) == 1 and uses[found[0]] == 1:
            result.append(_taken(facts, [(found[0], frame, np.eye(4))], f'{text} Taken for the same, which needs, beside the replay (and live),'))
        elif found:
            result.append(Finding(WARNING, f'{text} Which one is it? rosrun air_ground publish_calibration --transform "ONE {frame} 0 0 0 0 0 0 1" beside the replay says so'))
    return result


def _taken(facts, edges, text):
    command = publish(edges)
    facts.add_static(messages.static_transforms(edges, facts.begin))
    return Finding(WARNING, f'{text}  {command}', beside=command)
