"""The ground truth of a flight in the city: where base_link is in world, by the reference on a topic of the bag. Errors are without alignment, so what is not of base_link or not in world is named."""
from . import reference_faults
from .bag_reader import POSE_TYPES
from .evaluation import Track


def doubts(facts, topic, base, world='world', attitude=None):
    """Lines about what a reference is taken for: the frame that its messages are in, and the body that they are of. facts: of the bag, which holds a message on the topic. attitude: whether its poses have one; by the
    first message where that is not told."""
    message = facts.first_message(topic)
    frame, body = message.header.frame_id.lstrip('/'), getattr(message, 'child_frame_id', '').lstrip('/')
    result = [] if frame == world else [f'{topic} is in frame {frame!r}, and is taken for one in {world!r}: errors contain how the two lie to each other']
    if attitude is None:
        q = POSE_TYPES[facts.types[topic]](message)[1]
        attitude = q is not None and any((q.x, q.y, q.z, q.w))
    if not attitude:
        result.append(f'{topic} tells positions alone, taken for those of {base}: errors contain how far off it they are, and there are none of the heading')
    elif body and facts.static_transform(body, base) is None:
        result.append(f'{topic} tells where {body} is, which no static transform connects with {base}, and is taken for that: publish where {base} is in it, '
                      f'rosrun air_ground publish_calibration --transform "{body} {base} X Y Z QX QY QZ QW"')
    return result


def _nothing(bag, topic):
    """Why a topic gives no reference."""
    kind = bag.types.get(topic)
    if kind is None:
        return f'the bag has no {topic}: mav_truth:= names the reference'
    if kind not in POSE_TYPES:
        return f'{topic} is of type {kind}; a reference is of {", ".join(POSE_TYPES)}'
    return f'{topic} holds fewer than two poses that have a stamp and finite numbers'


def base_track(bag, topic, base, world):
    """(Track of `base` in `world`, or None; whether its attitudes are known; notes). bag: its static transforms and reference(topic)."""
    reference = bag.reference(topic)
    if reference is None:
        return None, False, [f'no errors: {_nothing(bag, topic)}']
    T_body_base = bag.static_transform(reference.frame, base) if reference.frame and reference.attitude else None
    poses = reference.poses if T_body_base is None else reference.poses @ T_body_base
    said = reference_faults.said(topic, reference.left_out, reference.left_out + len(reference.stamps))
    return Track(reference.stamps, poses), reference.attitude, said + doubts(bag, topic, base, world, reference.attitude)
