"""IMU readings synthesised from reference poses: smoothing splines through position and attitude, differentiated.

Reference poses of recordings without an IMU carry millimetres of noise, which a second derivative blows up to metres per
second squared. The poses are therefore fitted by cubic B-splines (attitude: the quaternion's components), whose knot
spacing is chosen by leaving every other pose out and predicting it.
"""
import numpy as np
from scipy.linalg import solveh_banded

from . import geometry

GRAVITY = 9.81  # [m/s^2]
KNOT_SPACINGS = (0.14, 0.2, 0.28, 0.4)  # candidates [s]; a hand or a robot moves below some 3 Hz
RIDGE = 0.03  # weight of the third differences of the coefficients: covers knots without data, calms the ends
LONGEST_GAP, GAP_STEPS = 0.3, 4  # [s], median steps: reference poses further apart than both have a gap between them
FEWEST_POSES, SHORTEST_PIECE = 8, 4 * KNOT_SPACINGS[0]  # [s]


class CubicSpline:
    """Least-squares uniform cubic B-spline through (n, d) values at n increasing stamps [s]. Memory and time grow with n alone."""

    def __init__(self, stamps, values, spacing):
        self.begin, self.spacing = stamps[0], spacing
        self.count = int(np.ceil((stamps[-1] - stamps[0]) / spacing)) + 3
        first, weights = self._basis(stamps)
        # The normal equations, of which four diagonals are not zero: row k holds the k-th below the main one.
        normal, right = np.zeros((4, self.count)), np.zeros((self.count, values.shape[1]))
        for i in range(4):
            np.add.at(right, first + i, weights[:, i, None] * values)
            for k in range(4 - i):
                np.add.at(normal[k], first + i, weights[:, i] * weights[:, i + k])
        third = np.array([-1.0, 3.0, -3.0, 1.0])
        for i in range(4):
            for k in range(4 - i):
                normal[k, i:self.count - 3 + i] += RIDGE * third[i] * third[i + k]
        self.coefficients = solveh_banded(normal, right, lower=True)

    def _basis(self, stamps, derivative=0):
        """(n,) first of the four coefficients that count at the stamps, and their weights (n, 4) in the value or a derivative."""
        place = np.clip((np.asarray(stamps) - self.begin) / self.spacing, 0, self.count - 3)
        first = np.minimum(place.astype(int), self.count - 4)
        x = place - first
        weights = ((1 - x) ** 3, 3 * x ** 3 - 6 * x ** 2 + 4, -3 * x ** 3 + 3 * x ** 2 + 3 * x + 1, x ** 3)
        if derivative == 1:
            weights = (-3 * (1 - x) ** 2, 9 * x ** 2 - 12 * x, -9 * x ** 2 + 6 * x + 3, 3 * x ** 2)
        elif derivative == 2:
            weights = (6 * (1 - x), 18 * x - 12, 6 - 18 * x, 6 * x)
        return first, np.stack(weights, 1) / (6 * self.spacing ** derivative)

    def __call__(self, stamps, derivative=0):
        """(n, d) values, first or second derivatives at n stamps within the spline's [s]."""
        first, weights = self._basis(stamps, derivative)
        return sum(weights[:, i, None] * self.coefficients[first + i] for i in range(4))


def pieces_of(stamps):
    """Slices of stamps [s] without gaps, and the seconds that lie in none of them: a spline across a gap would invent a motion."""
    steps = np.diff(stamps)
    gap = max(LONGEST_GAP, GAP_STEPS * np.median(steps))
    ends = np.concatenate([[0], np.flatnonzero(steps > gap) + 1, [len(stamps)]])
    pieces = [slice(a, b) for a, b in zip(ends[:-1], ends[1:]) if b - a >= FEWEST_POSES and stamps[b - 1] - stamps[a] >= SHORTEST_PIECE]
    return pieces, float(stamps[-1] - stamps[0] - sum(stamps[p][-1] - stamps[p][0] for p in pieces))


def choose_spacing(stamps, values, pieces):
    """Knot spacing whose splines through every other pose predict the poses left out best; and that error (RMS)."""
    best = None
    longest = max(stamps[p][-1] - stamps[p][0] for p in pieces)
    for spacing in KNOT_SPACINGS:
        if longest / spacing < 4:
            break
        errors = []
        for t, x in ((stamps[p], values[p]) for p in pieces):
            for parity in (0, 1):
                keep = np.arange(len(t)) % 2 == parity
                inside = ~keep & (t >= t[keep][0]) & (t <= t[keep][-1])
                errors.append(np.sum((CubicSpline(t[keep], x[keep], spacing)(t[inside]) - x[inside]) ** 2, axis=1))
        error = float(np.sqrt(np.mean(np.concatenate(errors))))
        if best is None or error < best[1]:
            best = (spacing, error)
    return best


def readings(times, position, attitude):
    """Gyro (n, 3) [rad/s] and accelerometer (n, 3) [m/s^2] without noise at `times`, from splines of position [m] and quaternion."""
    q, dq = attitude(times), attitude(times, 1)
    # omega = 2 Im(conj(q) dq) / |q|^2, which holds without normalising q.
    v, w, dv, dw = q[:, :3], q[:, 3:], dq[:, :3], dq[:, 3:]
    gyro = 2 * (w * dv - dw * v - np.cross(v, dv)) / np.sum(q * q, 1, keepdims=True)
    specific_force = position(times, 2) + np.array([0, 0, GRAVITY])
    return gyro, np.einsum('nji,nj->ni', geometry.matrix_from_quaternion(q), specific_force)


def synthesize(stamps, T_world_imu, rate=200.0, noise=1.0, seed=1):
    """Readings of an IMU that moved along `T_world_imu` ((n, 4, 4), world z up) at `stamps` [s].

    noise scales the white noise of a consumer MEMS unit (gyro 1.7e-4 rad/s/sqrt(Hz), accelerometer 2e-3 m/s^2/sqrt(Hz)).
    Where the poses have gaps (more than 0.3 s, and four times their median distance), there are no readings.
    Returns a dict: stamps (m,), gyro (m, 3) [rad/s], accel (m, 3) [m/s^2, specific force], and the splines' fit:
    position_spacing, attitude_spacing [s], position_rms [m], attitude_rms [rad]; pieces (their number), left_out [s].
    """
    stamps = np.asarray(stamps, float)
    if len(stamps) < FEWEST_POSES or np.any(np.diff(stamps) <= 0):
        raise ValueError(f'synthesising an IMU needs at least {FEWEST_POSES} reference poses with increasing stamps')
    pieces, left_out = pieces_of(stamps)
    if not pieces:
        raise ValueError(f'no stretch of the reference poses without a gap lasts {SHORTEST_PIECE:g} s and has {FEWEST_POSES} of them: too short to synthesise an IMU')
    positions = T_world_imu[:, :3, 3]
    quaternions = geometry.quaternion_from_matrix(T_world_imu[:, :3, :3])
    turned = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    quaternions[1:] *= np.where(np.cumsum(turned) % 2, -1, 1)[:, None]  # neighbours on the same side
    position_spacing, _ = choose_spacing(stamps, positions, pieces)
    attitude_spacing, _ = choose_spacing(stamps, quaternions, pieces)

    times, gyro, accel, distances, angles = [], [], [], [], []
    for piece in pieces:
        t = stamps[piece]
        position, attitude = CubicSpline(t, positions[piece], position_spacing), CubicSpline(t, quaternions[piece], attitude_spacing)
        # The grid of the first pose: readings of all pieces are whole periods apart.
        ticks = np.arange(np.ceil((t[0] - stamps[0]) * rate - 1e-6), np.floor((t[-1] - stamps[0]) * rate + 1e-6) + 1)
        times.append(np.clip(stamps[0] + ticks / rate, t[0], t[-1]))
        turn, force = readings(times[-1], position, attitude)
        gyro.append(turn)
        accel.append(force)
        distances.append(np.linalg.norm(position(t) - positions[piece], axis=1))
        angles.append(geometry.rotation_angle(np.swapaxes(geometry.matrix_from_quaternion(attitude(t)), 1, 2) @ T_world_imu[piece, :3, :3]))

    random = np.random.default_rng(seed)
    gyro, accel = np.concatenate(gyro), np.concatenate(accel)
    gyro = gyro + noise * 1.7e-4 * np.sqrt(rate) * random.standard_normal(gyro.shape)
    accel = accel + noise * 2e-3 * np.sqrt(rate) * random.standard_normal(accel.shape)
    return {
        'stamps': np.concatenate(times), 'gyro': gyro, 'accel': accel,
        'position_spacing': position_spacing, 'attitude_spacing': attitude_spacing, 'pieces': len(pieces), 'left_out': left_out,
        'position_rms': float(np.sqrt(np.mean(np.square(np.concatenate(distances))))),
        'attitude_rms': float(np.sqrt(np.mean(np.square(np.concatenate(angles)))))}
