"""How far the clock of reference poses is from that of the images: a motion capture's computer, or an IMU's clock where images are stamped by their camera's.

Compared with the odometry's poses, which have the images' stamps: what a constant shift of time explains of how fast both turn (or, of positions, move).
"""
import numpy as np

from . import geometry

WIDEST = 2.0  # [s] either way
SPAN = 0.12  # [s] that a motion is taken over: longer than the interval of slow references, shorter than motions are
FEWEST, MOST = 100, 500  # motions that both know: some seconds of a flight; and what is enough
LEAST = 0.003  # [s]: less is what stamps may differ by for other reasons (exposure, rows), and moves a robot by millimetres
# What is left of the difference of the motions must fall to this share: a robot that goes straight on tells no time.
EXPLAINED = 0.8
# Motions that repeat themselves (circles, figures of eight) agree at other shifts, too, but worse: beyond NEAR [s] no more than this share of their spread may be left.
NEAR, UNLIKE = 0.3, 0.25
# Between two noisy poses the mean of both is less noisy than either, and a shift that leads there would seem to explain something: motions are
# averaged over these shares of the reference's interval, after which the noise is the same wherever stamps lie between its poses (to 2 %).
TAPS = (-0.75, -0.25, 0.25, 0.75)


def _turns(poses, first, last):
    return geometry.rotation_angle(np.swapaxes(poses[first, :3, :3], 1, 2) @ poses[last, :3, :3])


def _ways(poses, first, last):
    return np.linalg.norm(poses[last, :3, 3] - poses[first, :3, 3], axis=1)


def _pairs(stamps):
    """(first, last): indices of poses about SPAN apart, MOST of them at the most."""
    first = np.arange(len(stamps))
    last = np.searchsorted(stamps, stamps + SPAN)
    inside = last < len(stamps)
    first, last = first[inside], last[inside]
    near = stamps[last] - stamps[first] < 2 * SPAN
    step = max(1, np.count_nonzero(near) // MOST)
    return first[near][::step], last[near][::step]


def clock_shift(reference, estimate, attitude):
    """Seconds to be added to the stamps of `reference` so that it moves as `estimate` does (both Tracks; of any two bodies that are fixed to each other); 0.0 where the motion does not tell;
    None where they move unlike each other, at whatever shift within WIDEST.

    attitude: angles of turns are compared, which need no mounting; else ways, the unit of the estimate free.
    """
    first, last = _pairs(estimate.stamps)
    if len(first) < FEWEST or len(reference.stamps) < 2:
        return 0.0
    motion = _turns if attitude else _ways
    own = motion(estimate.poses, first, last)
    stamps = np.concatenate([estimate.stamps[first], estimate.stamps[last]])
    begins, ends = np.split(np.arange(len(stamps)), 2)
    interpolator = geometry.PoseInterpolator(reference.stamps, reference.poses)
    interval = float(np.median(np.diff(reference.stamps)))

    def left(shift):
        """Root mean square of what both motions differ by with the reference's stamps moved by `shift`."""
        moved, both = 0.0, np.ones(len(begins), bool)
        for tap in TAPS:
            poses, known = interpolator.at(stamps - shift + tap * interval)
            both &= known[begins] & known[ends]
            moved = moved + motion(poses, begins, ends) / len(TAPS)
        if np.count_nonzero(both) < FEWEST:
            return np.inf
        a, b = own[both], moved[both]
        if not attitude:
            a = a * (a @ b / max(a @ a, 1e-12))
        return float(np.sqrt(np.mean((a - b) ** 2)))

    before, step = left(0.0), 0.04
    if not np.isfinite(before):
        return 0.0
    grid = step * np.arange(-round(WIDEST / step), round(WIDEST / step) + 1)
    best = float(grid[int(np.argmin([left(shift) for shift in grid]))])
    for width in (2 * step, step / 2):  # parabolas: a noisy reference's residuals are rough from one of its intervals to the next
        offsets = width * np.linspace(-1, 1, 9)
        squares = np.square([left(best + offset) for offset in offsets])
        if np.all(np.isfinite(squares)):
            curvature, slope, _ = np.polyfit(offsets, squares, 2)
            best += float(np.clip(-slope / (2 * curvature), -width, width)) if curvature > 0 else 0.0
    if abs(best) < LEAST or not left(best) < EXPLAINED * before:
        return 0.0
    return best if abs(best) < NEAR or (abs(best) < WIDEST and left(best) < UNLIKE * np.std(own)) else None
