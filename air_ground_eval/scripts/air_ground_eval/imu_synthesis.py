"""IMU readings synthesised from reference poses: smoothing splines through position and attitude, differentiated.

Reference poses of recordings without an IMU carry millimetres of noise, which a second derivative blows up to metres per
second squared. The poses are therefore fitted by cubic B-splines (attitude: the quaternion's components), whose knot
spacing is chosen by leaving every other pose out and predicting it.
"""
import numpy as np
from scipy.interpolate import BSpline

from . import geometry

GRAVITY = 9.81  # [m/s^2]
KNOT_SPACINGS = (0.14, 0.2, 0.28, 0.4)  # candidates [s]; a hand or a robot moves below some 3 Hz
RIDGE = 0.03  # weight of the third differences of the coefficients: covers knots without data, calms the ends


class CubicSpline:
    """Least-squares uniform cubic B-spline through (n, d) values at n increasing stamps [s]."""

    def __init__(self, stamps, values, spacing):
        count = int(np.ceil((stamps[-1] - stamps[0]) / spacing)) + 3
        self.knots = stamps[0] + spacing * np.arange(-3, count + 1)
        basis = BSpline.design_matrix(np.clip(stamps, self.knots[3], self.knots[count]), self.knots, 3).toarray()
        difference = np.diff(np.eye(count), 3, axis=0)
        normal = basis.T @ basis + RIDGE * difference.T @ difference
        self.spline = BSpline(self.knots, np.linalg.solve(normal, basis.T @ values), 3)

    def __call__(self, stamps, derivative=0):
        return self.spline(stamps, derivative)


def choose_spacing(stamps, values):
    """Knot spacing whose spline through every other pose predicts the poses left out best; and that error (RMS)."""
    best = None
    for spacing in KNOT_SPACINGS:
        if (stamps[-1] - stamps[0]) / spacing < 4:
            break
        errors = []
        for parity in (0, 1):
            keep = np.arange(len(stamps)) % 2 == parity
            spline = CubicSpline(stamps[keep], values[keep], spacing)
            inside = ~keep & (stamps >= stamps[keep][0]) & (stamps <= stamps[keep][-1])
            errors.append(np.sum((spline(stamps[inside]) - values[inside]) ** 2, axis=1))
        error = float(np.sqrt(np.mean(np.concatenate(errors))))
        if best is None or error < best[1]:
            best = (spacing, error)
    if best is None:
        raise ValueError('the reference poses span less than 0.3 s: too short to synthesise an IMU')
    return best


def synthesize(stamps, T_world_imu, rate=200.0, noise=1.0, seed=1):
    """Readings of an IMU that moved along `T_world_imu` ((n, 4, 4), world z up) at `stamps` [s].

    noise scales the white noise of a consumer MEMS unit (gyro 1.7e-4 rad/s/sqrt(Hz), accelerometer 2e-3 m/s^2/sqrt(Hz)).
    Returns a dict: stamps (m,), gyro (m, 3) [rad/s], accel (m, 3) [m/s^2, specific force], and the splines' fit:
    position_spacing, attitude_spacing [s], position_rms [m], attitude_rms [rad].
    """
    stamps = np.asarray(stamps, float)
    if len(stamps) < 8 or np.any(np.diff(stamps) <= 0):
        raise ValueError('synthesising an IMU needs at least 8 reference poses with increasing stamps')
    positions = T_world_imu[:, :3, 3]
    quaternions = geometry.quaternion_from_matrix(T_world_imu[:, :3, :3])
    for i in range(1, len(quaternions)):
        if quaternions[i] @ quaternions[i - 1] < 0:
            quaternions[i] *= -1
    position_spacing, _ = choose_spacing(stamps, positions)
    attitude_spacing, _ = choose_spacing(stamps, quaternions)
    position = CubicSpline(stamps, positions, position_spacing)
    attitude = CubicSpline(stamps, quaternions, attitude_spacing)

    times = stamps[0] + np.arange(int(np.floor((stamps[-1] - stamps[0]) * rate)) + 1) / rate
    q, dq = attitude(times), attitude(times, 1)
    R_world_imu = geometry.matrix_from_quaternion(q)
    # omega = 2 Im(conj(q) dq) / |q|^2, which holds without normalising q.
    v, w, dv, dw = q[:, :3], q[:, 3:], dq[:, :3], dq[:, 3:]
    gyro = 2 * (w * dv - dw * v - np.cross(v, dv)) / np.sum(q * q, 1, keepdims=True)
    specific_force = position(times, 2) + np.array([0, 0, GRAVITY])
    accel = np.einsum('nji,nj->ni', R_world_imu, specific_force)

    random = np.random.default_rng(seed)
    gyro = gyro + noise * 1.7e-4 * np.sqrt(rate) * random.standard_normal(gyro.shape)
    accel = accel + noise * 2e-3 * np.sqrt(rate) * random.standard_normal(accel.shape)

    fitted = geometry.matrix_from_quaternion(attitude(stamps))
    angles = geometry.rotation_angle(np.swapaxes(fitted, 1, 2) @ T_world_imu[:, :3, :3])
    return {
        'stamps': times, 'gyro': gyro, 'accel': accel,
        'position_spacing': position_spacing, 'attitude_spacing': attitude_spacing,
        'position_rms': float(np.sqrt(np.mean(np.sum((position(stamps) - positions) ** 2, 1)))),
        'attitude_rms': float(np.sqrt(np.mean(np.square(angles))))}
