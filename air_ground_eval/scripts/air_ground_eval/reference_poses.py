"""Reference poses of data sets as they are written: files, their frames, and what is up in them."""
import glob
import os
import re

import numpy as np

from . import geometry
from .recording import DatasetError, orthonormal_pose
from .rgbd_cameras import MIRROR, numbers

MOST_FRAMES = 1e6  # stamps that are whole numbers below it count frames
MOST_TILT = np.radians(45)  # between the world's z and what is up for the cameras on average


def frame_rate(config):
    try:
        rate = float(config.get('frame_rate_hz', 30.0))
    except (TypeError, ValueError):
        rate = -1.0
    if not rate > 0:
        raise DatasetError(f'frame_rate_hz = {config.get("frame_rate_hz")}: it must be positive')
    return rate


def count_frames(stamps):
    """Whether stamps are numbers of frames rather than seconds."""
    stamps = np.asarray(stamps, float)
    return len(stamps) > 1 and bool(np.all(stamps == np.rint(stamps)) and np.all((stamps >= 0) & (stamps < MOST_FRAMES)))


def unique_poses(stamps, positions, quaternions, source, notes):
    """(stamps (n,), poses (n, 4, 4)) in increasing order, without repeated stamps and lines that are no pose, which are counted."""
    numeric = np.isfinite(stamps) & np.all(np.isfinite(positions), 1) & np.all(np.isfinite(quaternions), 1)
    good = numeric & (np.linalg.norm(np.where(numeric[:, None], quaternions, 0), axis=1) > 1e-9)
    if not np.all(good):
        text = f'{source}: {np.sum(~good)} of {len(good)} poses have a quaternion that is zero, or numbers that are not finite'
        if 2 * np.sum(good) < len(good):
            raise DatasetError(text)
        notes.append(text + ': left out')
    stamps, positions, quaternions = stamps[good], positions[good], quaternions[good]
    order = np.argsort(stamps, kind='stable')
    order = order[np.concatenate([[True], np.diff(stamps[order]) > 0])]
    poses = np.tile(np.eye(4), (len(order), 1, 1))
    poses[:, :3, :3] = geometry.matrix_from_quaternion(quaternions[order])
    poses[:, :3, 3] = positions[order]
    return stamps[order], poses


def read_trajectory(path, notes):
    """A file in TUM format: stamp tx ty tz qx qy qz qw a line. Returns (stamps (n,), poses (n, 4, 4)), both empty for an empty file."""
    rows = []
    with open(path, encoding='utf-8', errors='replace') as stream:
        for number, line in enumerate(stream, 1):
            if not line.strip() or line.startswith('#'):
                continue
            try:
                rows.append([float(value) for value in line.split()[:8]])
            except ValueError:
                rows.append([])
            if len(rows[-1]) != 8:
                raise DatasetError(f'{path}:{number}: expected "stamp tx ty tz qx qy qz qw"')
    if not rows:
        return np.zeros(0), np.zeros((0, 4, 4))
    rows = np.array(rows)
    return unique_poses(rows[:, 0], rows[:, 1:4], rows[:, 4:8], path, notes)


def read_matrix(path):
    """A file of one 4x4 matrix, camera to world; None where a lost camera left it without finite numbers."""
    try:
        transform = np.array(numbers(path), float)
    except ValueError as error:
        raise DatasetError(f'{path}: expected a 4x4 matrix ({error})') from error
    if transform.shape != (4, 4):
        raise DatasetError(f'{path}: expected a 4x4 matrix, found {transform.shape}')
    return geometry.orthonormalized(transform) if np.all(np.isfinite(transform)) else None


def read_log(path):
    """Redwood's trajectory.log: three whole numbers, then the four rows of the pose. Returns [(place in the sequence, pose)]."""
    rows, poses = numbers(path), []
    if len(rows) % 5:
        raise DatasetError(f'{path}: expected blocks of five lines: three numbers, then a 4x4 matrix')
    for i in range(0, len(rows), 5):
        try:
            transform = np.array(rows[i + 1:i + 5], float).reshape(4, 4)
        except ValueError as error:
            raise DatasetError(f'{path}: block {i // 5}: expected a 4x4 matrix') from error
        if np.all(np.isfinite(transform)):
            poses.append((int(rows[i][0]), geometry.orthonormalized(transform)))
    return poses


def numbered_poses(folder, stamp_of, notes):
    """(stamps, poses, name of their source) of a folder of numbered images; stamp_of: number -> stamp [s] of the colour images, in their order.

    Looks for pose(s)/*.txt, trajectory.log, *.gt.freiburg (numbers of frames), groundtruth.txt.
    """
    for name in ('pose', 'poses'):
        files = {int(match.group(1)): path for path in sorted(glob.glob(os.path.join(folder, name, '*.txt')))
                 for match in [re.search(r'(\d+)\D*\.txt$', os.path.basename(path))] if match}
        found = [(stamp_of[number], read_matrix(path)) for number, path in sorted(files.items()) if number in stamp_of]
        found = [(stamp, pose) for stamp, pose in found if pose is not None]
        if found:
            return np.array([f[0] for f in found]), np.array([f[1] for f in found]), name
    log = os.path.join(folder, 'trajectory.log')
    if os.path.isfile(log):
        stamps = list(stamp_of.values())
        found = {stamps[place]: pose for place, pose in read_log(log) if 0 <= place < len(stamps)}
        return np.array(sorted(found)), np.array([found[s] for s in sorted(found)]).reshape(-1, 4, 4), log
    files = icl_trajectories(folder) + sorted(glob.glob(os.path.join(folder, '*.freiburg'))) + [os.path.join(folder, 'groundtruth.txt')]
    for path in files:
        if os.path.isfile(path):
            stamps, poses = read_trajectory(path, notes)
            if count_frames(stamps):
                known = np.array([int(s) in stamp_of for s in stamps])
                stamps, poses = np.array([stamp_of[int(s)] for s in stamps[known]]), poses[known]
            return stamps, poses, path
    return np.zeros(0), np.zeros((0, 4, 4)), None


def icl_trajectories(folder):
    """ICL-NUIM's reference poses, by which its recordings are known."""
    return sorted(glob.glob(os.path.join(folder, '*.gt.freiburg')))


def to_camera(recording, config, T_camera, mirrored):
    """Makes the recording's reference poses its colour camera's: T_camera is that camera in the frame they are of, unless --config states it.

    mirrored: they are of a frame whose y points the other way, in world and camera alike; the reflected ones are of a right-handed world.
    """
    if 'pose_from_camera' in config:
        T_camera = orthonormal_pose(config['pose_from_camera'], 'pose_from_camera')
    if mirrored and len(recording.poses):
        recording.poses = MIRROR @ recording.poses @ MIRROR
        recording.notes.append('fy < 0: the reference poses are reflected, y to -y, in world and camera')
    if len(recording.poses):
        recording.poses = recording.poses @ T_camera


def stated_up(config, folder, mirrored, known):
    """(3,) what is up in the frame of the poses, by gravity_direction of --config, gravity-direction.txt, or as the data set's publishers say; else None."""
    path = os.path.join(folder, 'gravity-direction.txt')
    source = 'gravity_direction in the calibration file'
    if 'gravity_direction' in config:
        up = config['gravity_direction']
    elif os.path.isfile(path):
        up, source = np.array([value for row in numbers(path) for value in row]), path
    elif known is not None:
        return (MIRROR[:3, :3] if mirrored else np.eye(3)) @ known
    else:
        return None
    try:
        up = -np.array(up, float).reshape(-1)
    except (TypeError, ValueError):
        up = np.zeros(0)
    if up.shape != (3,) or not np.all(np.isfinite(up)) or np.linalg.norm(up) < 1e-9:
        raise DatasetError(f'{source}: expected three numbers, which way down is')
    return MIRROR[:3, :3] @ up if mirrored else up


def level(recording, up, R_base_camera, mirrored=False):
    """Turns the reference poses' world so that z is up.

    Without a stated `up`, z is taken for it; but where the robot, whose camera is mounted as R_base_camera says, then lies on its side
    on average, the mean of its own upward direction is the better guess: nobody carries a camera so.
    """
    if not len(recording.poses):
        return
    if up is None:
        mean = np.mean(recording.poses[:, :3, :3] @ R_base_camera.T[:, 2], axis=0)
        length = np.linalg.norm(mean)
        tilt = np.arccos(np.clip(mean[2] / length, -1, 1)) if length > 0.1 else 0.0
        if tilt <= MOST_TILT:
            recording.notes.append('no gravity direction: the frame of the reference poses is taken as z up')
            return
        up = mean / length
        down = -MIRROR[:3, :3] @ up if mirrored else -up  # as --config would state it
        recording.notes.append(f'no gravity direction, and z of the reference poses cannot be up (the robot would be tilted by {np.degrees(tilt):.0f} degrees on average): '
                               f'down is taken as the mean of its own, [{down[0]:.3f}, {down[1]:.3f}, {down[2]:.3f}]; gravity_direction of --config states it better')
    leveling = geometry.pose(geometry.leveling_rotation(up))
    recording.poses = leveling @ recording.poses
