"""Reference poses that tell nothing of the body: of a motion capture that lost it and repeats its last pose with new stamps, writes zeros, or leaps elsewhere.

A body moves on from one pose to the next: what is suddenly faster than it ever moves, and than a neighbouring step, is a leap. A body that stands exactly still, as simulated ones do,
is told from one that is held by how it goes on: by no leap.
"""
import numpy as np

from . import geometry

FASTER = 5.0  # times the speed that nine tenths of the steps stay below
QUICKEST = (30.0, 300.0)  # [m/s^2], [rad/s^2]: a hand's quick motion
LEAST = (0.02, 0.1)  # [m], [rad]: less does no harm, and vibration reaches it
HELD_TIMES, HELD = 5, 0.2  # a pose is held when it is repeated so many times, over so long [s]: less is what a publisher does that is faster than its source
STARTING = 5.0  # [m/s^2]: a body comes to rest, and sets out, no faster
ISLAND = 0.5  # [s]: what lies between two leaps for less is no place where the body was
GAP = 0.5  # [s] without poses: how a pose that is held goes on is not told


def _leaps(steps, durations, quickest, least):
    """Which of the steps [m] or [rad], each taking so long [s], are leaps."""
    speeds = steps / durations
    around = np.concatenate([[np.inf], speeds, [np.inf]])
    sudden = steps - np.minimum(around[:-2], around[2:]) * durations if len(steps) > 1 else np.zeros(len(steps))
    return (speeds > FASTER * np.quantile(speeds, 0.9)) & (sudden > np.maximum(quickest * durations ** 2, least))


def _short_parts(leaps, begins, ends):
    """Which of the poses lie between leaps in a part shorter than ISLAND; the longest part never does."""
    parts = np.split(np.arange(len(begins)), np.flatnonzero(leaps) + 1)
    lengths = np.array([ends[part[-1]] - begins[part[0]] for part in parts])
    short = (lengths < ISLAND) & (np.arange(len(parts)) != np.argmax(lengths))
    return np.repeat(short, [len(part) for part in parts])


def believable(stamps, positions, quaternions):
    """Which poses the body can have had (n,), bool. stamps (n,) [s], increasing; positions (n, 3) [m]; quaternions (n, 4), all of them 0 where attitudes are not known."""
    poses = np.hstack([positions, quaternions])
    first = np.flatnonzero(np.concatenate([[True], np.any(poses[1:] != poses[:-1], axis=1)]))  # of each run of equal poses
    last = np.append(first[1:], len(stamps)) - 1
    if len(first) < 3:
        return np.ones(len(stamps), bool)
    begins, ends, repeated = stamps[first], stamps[last], last - first
    held = (repeated >= np.maximum(HELD_TIMES, 3 * np.median(repeated + 1))) & (ends - begins >= HELD)
    intervals = begins[1:] - np.where(held, ends, begins)[:-1]
    durations = np.maximum(intervals, np.median(intervals))
    moved = np.diff(positions[first], axis=0)
    steps = np.linalg.norm(moved, axis=1)
    leaps = _leaps(steps, durations, np.where(held[:-1], STARTING, QUICKEST[0]), LEAST[0])
    if np.any(quaternions):
        rotations = geometry.matrix_from_quaternion(quaternions[first])
        leaps |= _leaps(geometry.rotation_angle(np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]), durations, QUICKEST[1], LEAST[1])
    # Held as long as poses come: by a leap to it, or while it moved, which steps of a few last digits do not tell.
    speeds, digit = steps / durations, np.min(np.abs(moved[moved != 0]), initial=np.inf)
    at_speed = np.concatenate([[False], leaps | ((speeds > np.median(speeds) / 2) & (speeds > STARTING * durations) & (steps > 3 * digit))])
    lost = held & (np.append(leaps, False) | (np.append(intervals > np.maximum(GAP, 5 * np.median(intervals)), True) & at_speed))
    lost |= _short_parts(leaps, begins, ends)
    return np.repeat(~lost, repeated + 1)


def said(topic, left_out, total):
    """Notes on the poses of a topic that are left out: none, or one."""
    if not left_out:
        return []
    return [f'{topic}: {left_out} of {total} reference poses are left out, which its body cannot have had: one that is repeated while it moves, zeros or leaps, as where a motion capture '
            'loses it']
