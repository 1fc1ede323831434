"""Ways travelled by positions that may be noisy: the sum of all steps is that of the noise (647 m instead of 150 for 1 cm at 200 Hz)."""
import math

import numpy as np

NOISE_STEPS = 10.0  # standard deviations of the noise: a body at rest makes no such step
SLOWEST, FASTEST = 10.0, 20.0  # [Hz]: noise is told from motion by rates from the one on, and looked for down to the other, since a filtered reference's is smooth at its full rate
ORDER = 4  # of the differences that noise is told by: motion is smooth enough to have next to none


def noise(stamps, positions):
    """Standard deviation [m] of the noise of positions (n, 3) along each axis; 0 where there is none, or the rate is too low to tell it from motion.

    Differences of noise grow with their order, those of a motion fall.
    """
    interval = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    found, lag = 0.0, 1
    while interval > 0 and (lag == 1 and interval * SLOWEST < 1.01 or lag * interval * FASTEST < 1.01) and len(stamps) > 4 * lag * ORDER:
        differences = positions
        for _ in range(ORDER):
            differences = differences[lag:] - differences[:-lag]
        spread, next_spread = np.median(np.abs(differences)), np.median(np.abs(differences[lag:] - differences[:-lag]))
        if next_spread > spread:
            found = max(found, 1.4826 * spread / math.sqrt(math.comb(2 * ORDER, ORDER)))
        lag *= 2
    return float(found)


def distance_travelled(stamps, positions):
    """Way [m] travelled at each stamp (n,) [s] along positions (n, 3): a step counts once the body has moved by more than its noise from where the last one ended."""
    if len(stamps) < 2:
        return np.zeros(len(stamps))
    deviation = noise(stamps, positions)
    sideways = 4 * deviation ** 2  # of a step, squared: both ends, two axes
    points = positions.tolist()
    ends, way = [0], [0.0]
    for i, point in enumerate(points):
        step = math.dist(point, points[ends[-1]])
        if step > NOISE_STEPS * deviation or (i == len(points) - 1 and i > ends[-1]):
            ends.append(i)
            way.append(way[-1] + math.sqrt(max(0.0, step ** 2 - sideways)))
    return np.interp(np.arange(len(points)), ends, way)


def path_length(stamps, positions):
    """The whole of it [m]."""
    return float(distance_travelled(stamps, positions)[-1]) if len(stamps) else 0.0
