"""Errors of a replay against ground truth. Free of ROS: arrays in, plain dictionaries out.

Trajectories are (stamps (n,), T_map_camera (n, 4, 4)). See docs/experiments.md for the definitions.
"""
import dataclasses
from dataclasses import dataclass
from typing import Optional

import numpy as np

from . import geometry
from .path_length import path_length

STATUS_NAMES = {0: 'SEARCHING', 1: 'AMBIGUOUS', 2: 'DEGENERATE', 3: 'CONVERGED', 4: 'REJECTED'}
STATUS_SEARCHING, STATUS_AMBIGUOUS, STATUS_CONVERGED = 0, 1, 3
STAGE_COARSE, STAGE_REFINED = 0, 1
LEVER_ARM = 0.5  # [m]: weighs rotations against positions when maps are tied to the world


@dataclass
class Track:
    """A trajectory: stamps [s], increasing, and camera poses in a fixed frame. heights: false where they are off by an unknown constant."""
    stamps: np.ndarray
    poses: np.ndarray
    heights: bool = True

    def __len__(self):
        return len(self.stamps)

    def at(self, stamps, max_gap=0.5):
        """Interpolated poses and a mask of the stamps that the track covers."""
        return geometry.interpolate_poses(self.stamps, self.poses, stamps, max_gap)


@dataclass
class Estimate:
    """One AlignmentEstimate: p_ground = scale R p_mav + t with R, t of pose = T_ground_map_mav_map, its status, and the standard deviations (x y z rotX rotY rotZ)."""
    stamp: float
    pose: np.ndarray
    status: int
    stage: int
    deviations: np.ndarray
    reason: str = ''
    iterations: int = 0
    overlap: float = 0.0
    cost: float = 0.0
    spread: float = 0.0
    map_id: int = 0
    scale: float = 1.0
    T_mav_map_camera: Optional[np.ndarray] = None  # of the MAV's camera at the stamp, as it was known then
    ground_map_id: int = 0  # map of the ground robot; 0: not known
    arrived: float = float('nan')  # when it was published, on the bag's clock [s]


def of_metric_map(estimate, T_map_visual, scale):
    """The estimate of a map without scale as one of the metric map: p_map = scale R p_visual + t with R, t of T_map_visual."""
    s = estimate.scale / scale
    pose = estimate.pose.copy()
    pose[:3, :3] = estimate.pose[:3, :3] @ T_map_visual[:3, :3].T
    pose[:3, 3] = estimate.pose[:3, 3] - s * pose[:3, :3] @ T_map_visual[:3, 3]
    return dataclasses.replace(estimate, pose=pose, scale=s)


def moved_by_scale(poses, before, after):
    """Poses of a metric map that was made with the similarity `before` of a map without scale, in the one that `after` makes: each (T_map_visual, scale), as for of_metric_map."""
    turn = after[0][:3, :3] @ before[0][:3, :3].T
    moved = poses.copy()
    moved[..., :3, :3] = turn @ poses[..., :3, :3]
    moved[..., :3, 3] = after[1] / before[1] * (poses[..., :3, 3] - before[0][:3, 3]) @ turn.T + after[0][:3, 3]
    return moved


def read_tum(path):
    """A Track from 'stamp tx ty tz qx qy qz qw' lines; ValueError says which file is wrong."""
    rows = np.loadtxt(path, ndmin=2)
    if rows.size == 0:
        return Track(np.zeros(0), np.zeros((0, 4, 4)))
    if rows.shape[1] != 8 or not np.all(np.isfinite(rows)):
        raise ValueError(f'{path}: expected finite "stamp tx ty tz qx qy qz qw" lines')
    rows = rows[np.argsort(rows[:, 0], kind='stable')]
    rows = rows[np.concatenate([[True], np.diff(rows[:, 0]) > 0])]
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = geometry.matrix_from_quaternion(rows[:, 4:])
    poses[:, :3, 3] = rows[:, 1:4]
    return Track(rows[:, 0], poses)


def tum_unit(path):
    """What one unit of a trajectory is, where the comments before its lines say that it is not the metre ("# unit: ..."); else ''."""
    with open(path, encoding='utf-8', errors='replace') as stream:
        for line in stream:
            if not line.startswith('#'):
                break
            key, _, value = line.lstrip('# ').partition(':')
            if key.strip().lower() == 'unit' and value.strip().lower() not in ('m', 'metre', 'metres', 'meter', 'meters'):
                return value.strip() or 'not known'
    return ''


def write_tum(path, track):
    with open(path, 'w', encoding='utf-8') as stream:
        stream.write('# stamp[s] tx ty tz[m] qx qy qz qw\n')
        for stamp, pose in zip(track.stamps, track.poses):
            values = list(pose[:3, 3]) + list(geometry.quaternion_from_matrix(pose[:3, :3]))
            stream.write(f'{stamp:.9f} ' + ' '.join(f'{v:.9f}' for v in values) + '\n')


def write_alignment(path, estimates):
    with open(path, 'w', encoding='utf-8') as stream:
        stream.write('# p_ground_map = scale R p_mav_map + t: stamp[s] tx ty tz[m] qx qy qz qw status stage sigma_x sigma_y '
                     'sigma_z[m] sigma_rotX sigma_rotY sigma_rotZ[rad] scale\n'
                     '# status: 0 searching, 1 ambiguous, 2 degenerate, 3 converged, 4 rejected; stage: 0 coarse, 1 refined\n')
        for e in estimates:
            values = list(e.pose[:3, 3]) + list(geometry.quaternion_from_matrix(e.pose[:3, :3]))
            stream.write(f'{e.stamp:.9f} ' + ' '.join(f'{v:.9f}' for v in values) + f' {e.status} {e.stage} '
                         + ' '.join(f'{v:.6g}' for v in e.deviations) + f' {e.scale:.9g}\n')


def trajectory_error(truth, estimate):
    """Absolute trajectory error of camera positions after a rigid least-squares alignment, and the scale error apart.

    Returns None when fewer than 10 poses have a truth, else a dict of rmse_m, max_m, rmse_percent, path_length_m,
    scale_error_percent (positive: the estimate is too large), rmse_with_scale_m and metres_per_unit of a similarity alignment,
    poses, and for figures stamps, errors_m, errors_with_scale_m, T_world_map.
    """
    reference, valid = truth.at(estimate.stamps)
    if np.count_nonzero(valid) < 10:
        return None
    r, e = reference[valid, :3, 3], estimate.poses[valid, :3, 3]
    _, rotation, translation = geometry.align_points(r, e)
    errors = np.linalg.norm(e @ rotation.T + translation - r, axis=1)
    scale, rotation_s, translation_s = geometry.align_points(r, e, with_scale=True)
    errors_s = np.linalg.norm(scale * e @ rotation_s.T + translation_s - r, axis=1)
    length = path_length(estimate.stamps[valid], r)
    rmse = float(np.sqrt(np.mean(errors ** 2)))
    return {
        'rmse_m': rmse, 'max_m': float(errors.max()), 'path_length_m': length,
        'rmse_percent': 100 * rmse / length if length > 0 else float('nan'),
        'scale_error_percent': 100 * (1 / scale - 1) if scale > 0 else float('nan'),
        'rmse_with_scale_m': float(np.sqrt(np.mean(errors_s ** 2))), 'metres_per_unit': scale,
        'poses': int(np.count_nonzero(valid)),
        'stamps': estimate.stamps[valid], 'errors_m': errors, 'errors_with_scale_m': errors_s, 'T_world_map': geometry.pose(rotation, translation)}


def tie_to_world(truth, estimate, lever_arm=LEVER_ARM):
    """T_world_map that best fits all poses: positions and orientations (each as three points `lever_arm` from the camera).

    Positions alone leave the tilt of a map poorly known when the robot drove along a line. None without overlap.
    """
    reference, valid = truth.at(estimate.stamps)
    if np.count_nonzero(valid) < 3:
        return None
    corners = np.concatenate([np.zeros((1, 3)), lever_arm * np.eye(3)])

    def points(poses):
        return (poses[:, None, :3, 3] + np.einsum('nij,kj->nki', poses[:, :3, :3], corners)).reshape(-1, 3)

    _, rotation, translation = geometry.align_points(points(reference[valid]), points(estimate.poses[valid]))
    return geometry.pose(rotation, translation)


def tie_through_first_pose(truth, estimate):
    """T_world_map through the first estimated pose that has a truth; None without."""
    reference, valid = truth.at(estimate.stamps)
    if not np.any(valid):
        return None
    i = int(np.argmax(valid))
    return reference[i] @ geometry.inverse(estimate.poses[i])


def alignment_error(estimate, T_ground_map_world, mav_truth):
    """Error of an alignment at the MAV: where it puts the MAV's camera in the ground map against where that was.

    Returns (position [m], horizontal position [m], rotation [rad], yaw [rad]) or None when a pose at the stamp is missing.
    """
    if estimate.T_mav_map_camera is None:
        return None
    reference, valid = mav_truth.at(np.array([estimate.stamp]))
    if not valid[0]:
        return None
    truth = T_ground_map_world @ reference[0]
    camera = estimate.T_mav_map_camera.copy()
    camera[:3, 3] *= estimate.scale
    placed = estimate.pose @ camera
    offset = placed[:3, 3] - truth[:3, 3]
    rotation = placed[:3, :3] @ truth[:3, :3].T
    yaw = np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
    return (float(np.linalg.norm(offset)), float(np.linalg.norm(offset[:2])), geometry.rotation_angle(rotation), float(abs(yaw)))


def alignment_errors(estimates, T_ground_map_world, mav_truth, heights=True):
    """Dicts of the errors of those estimates that claim a pose (coarse: also the best of several) and have a truth; position_m in plan where heights are not to be compared."""
    rows = []
    for estimate in estimates:
        claims = (STATUS_CONVERGED, STATUS_AMBIGUOUS) if estimate.stage == STAGE_COARSE else (STATUS_CONVERGED,)
        if estimate.status not in claims:
            continue
        error = alignment_error(estimate, T_ground_map_world, mav_truth)
        if error is not None:
            rows.append({'estimate': estimate, 'stamp_s': estimate.stamp, 'height_maps': estimate.iterations, 'overlap': estimate.overlap, 'status': estimate.status,
                         'position_m': error[0 if heights else 1], 'horizontal_m': error[1], 'rotation_deg': float(np.degrees(error[2])),
                         'yaw_deg': float(np.degrees(error[3]))})
    return rows


def alignment_scale_error(scale, mav_error_percent, ground_error_percent):
    """Error [%] of an alignment's scale (ground-map length per length of the MAV's map), given by how much [%] either map is too large."""
    return 100 * (scale * (1 + mav_error_percent / 100) / (1 + ground_error_percent / 100) - 1)


def coverage(stamps, begin, end, max_gap=0.5):
    """Share of [begin, end] during which the stamps have gaps of at most max_gap [s]."""
    if len(stamps) < 2 or end <= begin:
        return 0.0
    gaps = np.diff(stamps)
    return float(np.clip(np.sum(gaps[gaps <= max_gap]) / (end - begin), 0, 1))
