"""How far the clock of reference poses is from that of the images: a motion capture's computer, or an IMU's clock where images are stamped by their camera's.

Compared with the odometry's poses, which have the images' stamps: what a constant shift of time explains of how fast both turn (or, of positions, move).
"""
import numpy as np

from . import geometry

WIDEST = 0.3  # [s] either way
SPAN = 0.12  # [s] that a motion is taken over: longer than the interval of slow references, shorter than motions are
FEWEST = 100  # motions that both know: some seconds of a flight
LEAST = 0.003  # [s]: less is what stamps may differ by for other reasons (exposure, rows), and moves a robot by millimetres
# What is left of the difference of the motions must fall to this share: a robot that goes straight on tells no time.
EXPLAINED = 0.8


def _turns(poses, first, last):
    return geometry.rotation_angle(np.swapaxes(poses[first, :3, :3], 1, 2) @ poses[last, :3, :3])


def _ways(poses, first, last):
    return np.linalg.norm(poses[last, :3, 3] - poses[first, :3, 3], axis=1)


def clock_shift(reference, estimate, attitude):
    """Seconds to be added to the stamps of `reference` so that it moves as `estimate` does (both Tracks; of any two bodies that are fixed to each other); 0.0 where the motion does not tell.

    attitude: angles of turns are compared, which need no mounting; else ways, the unit of the estimate free.
    """
    stamps = estimate.stamps
    first = np.arange(len(stamps))
    last = np.searchsorted(stamps, stamps + SPAN)
    pairs = last < len(stamps)
    first, last = first[pairs], last[pairs]
    near = stamps[last] - stamps[first] < 2 * SPAN
    first, last = first[near], last[near]
    motion = _turns if attitude else _ways
    own = motion(estimate.poses, first, last)

    def left(shift):
        """Root mean square of what both motions differ by with the reference's stamps moved by `shift`."""
        poses, known = reference.at(stamps - shift)
        both = known[first] & known[last]
        if np.count_nonzero(both) < FEWEST:
            return np.inf
        a, b = own[both], motion(poses, first, last)[both]
        if not attitude:
            a = a * (a @ b / max(a @ a, 1e-12))
        return float(np.sqrt(np.mean((a - b) ** 2)))

    before, best, step = left(0.0), 0.0, 0.02
    if not np.isfinite(before):
        return 0.0
    grid = np.arange(-WIDEST, WIDEST + step / 2, step)
    while step > 2e-4:
        best = float(grid[int(np.argmin([left(shift) for shift in grid]))])
        grid, step = best + step * np.linspace(-1, 1, 11), step / 5
    settled = abs(best) < WIDEST  # at the rim it is of something else
    return best if settled and abs(best) >= LEAST and left(best) < EXPLAINED * before else 0.0
