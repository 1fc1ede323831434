"""Rigid transforms as 4x4 arrays, quaternions as (x, y, z, w). T_a_b maps coordinates in frame b to frame a."""
import numpy as np


def quaternion_from_matrix(rotation):
    """Unit quaternion x y z w (w >= 0) of a 3x3 rotation matrix."""
    m = rotation
    candidates = np.array([
        1 + m[0, 0] - m[1, 1] - m[2, 2],
        1 - m[0, 0] + m[1, 1] - m[2, 2],
        1 - m[0, 0] - m[1, 1] + m[2, 2],
        1 + m[0, 0] + m[1, 1] + m[2, 2]])
    i = int(np.argmax(candidates))
    rows = {
        0: (candidates[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[2, 1] - m[1, 2]),
        1: (m[0, 1] + m[1, 0], candidates[1], m[1, 2] + m[2, 1], m[0, 2] - m[2, 0]),
        2: (m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], candidates[2], m[1, 0] - m[0, 1]),
        3: (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], candidates[3])}
    q = np.array(rows[i])
    q /= np.linalg.norm(q)
    return q if q[3] >= 0 else -q


def matrix_from_quaternion(q):
    """Rotation matrices (..., 3, 3) of quaternions (..., 4); they need not be normalised. Zero or NaN raises ValueError."""
    q = np.asarray(q, float)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not np.all(np.isfinite(norm)) or np.any(norm < 1e-9):
        raise ValueError('a quaternion is zero or not finite')
    x, y, z, w = np.moveaxis(q / norm, -1, 0)
    return np.stack([
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], -1),
        np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], -1),
        np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], -1)], -2)


def pose(rotation=None, translation=(0, 0, 0)):
    """4x4 transform from a 3x3 rotation matrix and a translation [m]."""
    transform = np.eye(4)
    if rotation is not None:
        transform[:3, :3] = rotation
    transform[:3, 3] = translation
    return transform


def pose_from_tq(t, q):
    """4x4 transform from a translation [m] and a quaternion x y z w."""
    return pose(matrix_from_quaternion(q), t)


def inverse(transform):
    """Inverse of a rigid 4x4 transform."""
    result = np.eye(4)
    result[:3, :3] = transform[:3, :3].T
    result[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return result


def orthonormalized(transform):
    """The nearest rigid transform (measured poses carry rounding in their rotation)."""
    u, _, vt = np.linalg.svd(transform[:3, :3])
    result = np.array(transform, float)
    result[:3, :3] = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return result


def rotation_angle(rotation):
    """Angle [rad] of a 3x3 rotation, exact near 0 and pi."""
    v = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return float(np.arctan2(np.linalg.norm(v), np.trace(rotation) - 1))


def rotation_z(angle):
    """Rotation by `angle` [rad] about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def leveling_rotation(up):
    """Smallest rotation that takes the direction `up` to +z."""
    up = np.asarray(up, float)
    norm = np.linalg.norm(up)
    if not np.isfinite(norm) or norm < 1e-9:
        raise ValueError('the up direction is zero or not finite')
    up = up / norm
    axis = np.cross(up, [0, 0, 1.0])
    c = up[2]
    if c < -1 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + k + k @ k / (1 + c)


def interpolate_poses(stamps, transforms, query, max_gap=0.5):
    """Poses at `query` stamps: linear positions, normalised linear quaternions between neighbours.

    Returns (poses (n, 4, 4), valid (n,)); invalid outside the range and across gaps longer than max_gap [s].
    """
    stamps = np.asarray(stamps, float)
    query = np.asarray(query, float)
    i = np.clip(np.searchsorted(stamps, query, side='right') - 1, 0, len(stamps) - 2)
    span = stamps[i + 1] - stamps[i]
    s = (query - stamps[i]) / span
    valid = (s >= -1e-9) & (s <= 1 + 1e-9) & (span <= max_gap)
    quaternions = np.array([quaternion_from_matrix(t[:3, :3]) for t in transforms])
    a, b = quaternions[i], quaternions[i + 1]
    b = np.where(np.sum(a * b, axis=1, keepdims=True) < 0, -b, b)
    result = np.tile(np.eye(4), (len(query), 1, 1))
    s = np.clip(s, 0, 1)[:, None]
    result[:, :3, :3] = matrix_from_quaternion((1 - s) * a + s * b)
    positions = np.asarray(transforms)[:, :3, 3]
    result[:, :3, 3] = (1 - s) * positions[i] + s * positions[i + 1]
    return result, valid


def align_points(reference, estimate, with_scale=False):
    """Least-squares scale, R, t with reference ~ scale * R @ estimate + t (Umeyama 1991); (n, 3) arrays, n >= 3."""
    if len(reference) != len(estimate) or len(reference) < 3:
        raise ValueError('aligning trajectories needs three or more corresponding positions')
    mu_r, mu_e = reference.mean(0), estimate.mean(0)
    covariance = (reference - mu_r).T @ (estimate - mu_e) / len(reference)
    u, d, vt = np.linalg.svd(covariance)
    sign = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ sign @ vt
    variance = np.mean(np.sum((estimate - mu_e) ** 2, 1))
    scale = float(np.trace(np.diag(d) @ sign) / variance) if with_scale and variance > 0 else 1.0
    return scale, rotation, mu_r - scale * rotation @ mu_e


# Axes of an optical frame (x right, y down, z forward) in a body frame (x forward, y left, z up).
R_BODY_FORWARD_CAMERA = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
# The same for a camera that looks straight down, its image's top towards the body's front.
R_BODY_DOWN_CAMERA = np.array([[0, -1.0, 0], [-1, 0, 0], [0, 0, -1]])
