"""Rigid transforms as 4x4 arrays, quaternions as (x, y, z, w). T_a_b maps coordinates in frame b to frame a."""
import numpy as np
from scipy.spatial.transform import Rotation, Slerp


def rotations_from_matrix(matrix):
    """Rotation of matrices (..., 3, 3); SciPy before 1.4, as Ubuntu 20.04 has it, knows it by another name."""
    return (Rotation.from_matrix if hasattr(Rotation, 'from_matrix') else Rotation.from_dcm)(matrix)


def matrix_from_rotations(rotations):
    """Matrices (..., 3, 3) of a Rotation; the same."""
    return rotations.as_matrix() if hasattr(rotations, 'as_matrix') else rotations.as_dcm()


def quaternion_from_matrix(rotation):
    """Unit quaternions x y z w (w >= 0) of rotation matrices (..., 3, 3)."""
    rotation = np.asarray(rotation, float)
    q = rotations_from_matrix(rotation.reshape(-1, 3, 3)).as_quat().reshape(rotation.shape[:-2] + (4,))
    return np.where(q[..., 3:] < 0, -q, q)


def matrix_from_quaternion(q):
    """Rotation matrices (..., 3, 3) of quaternions (..., 4); they need not be normalised. Zero or NaN raises ValueError."""
    q = np.asarray(q, float)
    norm = np.linalg.norm(q, axis=-1)
    if not np.all(np.isfinite(norm)) or np.any(norm < 1e-9):
        raise ValueError('a quaternion is zero or not finite')
    return matrix_from_rotations(Rotation.from_quat(q.reshape(-1, 4))).reshape(q.shape[:-1] + (3, 3))


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


def is_rigid(transform, tolerance):
    """Whether a 4x4 matrix is finite and its upper left 3x3 a rotation, up to rounding."""
    rotation = transform[:3, :3]
    return bool(np.all(np.isfinite(transform)) and np.abs(rotation @ rotation.T - np.eye(3)).max() <= tolerance and np.linalg.det(rotation) >= 0)


def orthonormalized(transform):
    """The nearest rigid transform (measured poses carry rounding in their rotation)."""
    u, _, vt = np.linalg.svd(transform[:3, :3])
    result = np.array(transform, float)
    result[:3, :3] = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return result


def rotation_angle(rotation):
    """Angles [rad] of rotation matrices (..., 3, 3)."""
    return np.linalg.norm(rotations_from_matrix(rotation).as_rotvec(), axis=-1)


def rotation_z(angle):
    """Rotation by `angle` [rad] about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def rotation_from_axes(axes, angles):
    """Rotations (n, 3, 3) about the moving axes named in turn ('XYZ': Rx Ry Rz) by angles (n, len(axes)) [rad]."""
    return matrix_from_rotations(Rotation.from_euler(axes, angles))


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


class PoseInterpolator:
    """Poses between those at increasing stamps (n,): positions linear, attitudes at constant turn rate between neighbours.

    at(query): (poses (m, 4, 4), valid (m,)); invalid outside the range, with fewer than two stamps, and across gaps longer than max_gap [s], but where a neighbour is so near that
    an acceleration of 1 m/s^2 in between makes less than 25 mm: poses once a second are references for what lies within 0.05 s of them.
    """

    def __init__(self, stamps, transforms, max_gap=0.5):
        self.stamps, self.transforms, self.max_gap = np.asarray(stamps, float), np.asarray(transforms, float), max_gap
        self.turns = Slerp(self.stamps, rotations_from_matrix(self.transforms[:, :3, :3])) if len(self.stamps) > 1 else None

    def at(self, query):
        stamps, query = self.stamps, np.asarray(query, float)
        result = np.tile(np.eye(4), (len(query), 1, 1))
        if self.turns is None or not len(query):
            return result, np.zeros(len(query), bool)
        i = np.clip(np.searchsorted(stamps, query, side='right') - 1, 0, len(stamps) - 2)
        gap = stamps[i + 1] - stamps[i]
        near = np.minimum(query - stamps[i], stamps[i + 1] - query) * gap <= 0.05  # [s^2]: twice 25 mm over 1 m/s^2
        valid = (query >= stamps[0] - 1e-9) & (query <= stamps[-1] + 1e-9) & ((gap <= self.max_gap) | near)
        inside = np.clip(query, stamps[0], stamps[-1])
        result[:, :3, :3] = matrix_from_rotations(self.turns(inside))
        result[:, :3, 3] = np.stack([np.interp(inside, stamps, self.transforms[:, axis, 3]) for axis in range(3)], 1)
        return result, valid


def interpolate_poses(stamps, transforms, query, max_gap=0.5):
    """PoseInterpolator's, once."""
    return PoseInterpolator(stamps, transforms, max_gap).at(query)


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
