"""Reference poses of a recording as those of a camera: through static transforms, or, where nothing connects the two, by one constant mounting that the odometry tells.

World w of the reference, map m of the estimate, camera c, body b whose poses the reference tells. T_a_b takes b to a coordinates.
"""
import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from . import geometry, reference_faults
from .evaluation import LEVER_ARM, Track
from .path_length import noise
from .reference_clock import WIDEST, clock_shift

FEWEST, MOST = 20, 1000  # poses with a reference that a mounting is estimated from
# A lever arm along a direction shows as far as turns move its end in ways that no other place of the map would: so much [m], root mean square, for each metre of it.
LEAST_SHOWN = 0.05
SAME_PLACE, SAME_TURN = 0.05, 0.035  # between the mounting estimated and that of base_link, whose poses the reference then tells [m], [rad]

LEAST_APART, UPWARDS = 0.02, 0.9  # [m] from one frame to another; cosine

UP = np.array([0.0, 0.0, 1.0])
REST = 0.02  # [m], root mean square, or three standard deviations of the noise: what moves less does not move
STEADY, TURNED = np.radians(0.5), np.radians(5.0)  # attitudes that never turn, of a body that did
# Positions so near to a line (root mean square, m, or times what odometry and reference differ by; and a share of its length) do not tell how the map is turned about it.
OFF_LINE, OFF_BY_ERRORS, SLENDER = 0.04, 10.0, 0.25


@dataclass
class Reference:
    """Poses of a body: stamps [s], T_w_b (n, 4, 4). attitude: false where the recording tells positions alone. frame: its name, '' where the recording has none.
    left_out: how many more were told that the body cannot have had (reference_faults)."""
    stamps: np.ndarray
    poses: np.ndarray
    attitude: bool = True
    frame: str = ''
    left_out: int = 0


@dataclass
class Mounting:
    """T_b_c; without attitudes the body's axes are the camera's. free: directions of the lever arm (rows) that the motion leaves open: 0 along them.
    T_w_m and scale: p_w = scale R p_m + t. vertical: positions on a line left a turn about it open, and z of the map was taken to be up as that of the world is."""
    T_b_c: np.ndarray
    T_w_m: np.ndarray
    scale: float
    free: np.ndarray
    vertical: bool = False


def _residuals(x, camera, body, attitude, arms, line):
    """Distances [m] of camera positions, and rotations times LEVER_ARM, of map and reference; x: rotation vector and translation of T_w_m, logarithm of the scale,
    lever arm along the rows of `arms`, rotation vector of R_b_c. line: None, or an axis about which the verticals of map and world shall not be turned."""
    R = geometry.matrix_from_rotations(Rotation.from_rotvec(x[:3]))
    lever = x[7:7 + len(arms)] @ arms
    placed = np.exp(x[6]) * camera[:, :3, 3] @ R.T + x[3:6]
    turned = R @ camera[:, :3, :3]
    if not attitude:  # p_b = p_c - R_w_c lever
        leaning = [] if line is None else [np.sqrt(len(body)) * LEVER_ARM * (line @ np.cross(R[:, 2], UP))]
        return np.concatenate([(placed - turned @ lever - body[:, :3, 3]).ravel(), leaning])
    R_b_c = geometry.matrix_from_rotations(Rotation.from_rotvec(x[7 + len(arms):]))
    difference = geometry.rotations_from_matrix(np.swapaxes(body[:, :3, :3] @ R_b_c, 1, 2) @ turned).as_rotvec()
    return np.concatenate([placed - body[:, :3, 3] - body[:, :3, :3] @ lever, LEVER_ARM * difference]).ravel()


def _rotvec(rotation):
    return geometry.rotations_from_matrix(rotation[None]).as_rotvec()[0]


def _mean_rotation(rotations):
    u, _, vt = np.linalg.svd(rotations.sum(0))
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt


def _line(reference, estimated, aligned):
    """Direction (3,) of the line that positions (n, 3) lie on too nearly to tell how the map is turned about it; None where they tell, or a vertical line's does not either.
    aligned: scale, R, t that take the estimated ones to the reference's."""
    scale, R, t = aligned
    off = np.sqrt(np.mean(np.sum((scale * estimated @ R.T + t - reference) ** 2, 1)))
    _, spread, axes = np.linalg.svd((reference - reference.mean(0)) / np.sqrt(len(reference)), full_matrices=False)
    told = spread[1] > min(max(OFF_LINE, OFF_BY_ERRORS * off), SLENDER * spread[0])
    return None if told or abs(axes[0] @ UP) > UPWARDS else axes[0]


def _upright(R, line):
    """R turned about `line` so that its z is as near to up as it can be."""
    z = R[:, 2]
    angle = np.arctan2(line @ np.cross(z, UP), z @ UP - (line @ z) * (line @ UP))
    return geometry.matrix_from_rotations(Rotation.from_rotvec(angle * line)) @ R


def estimate_mounting(reference, estimate):
    """The Mounting with which the reference's camera is nearest to the estimated one, a similarity between their frames free; None with fewer than FEWEST common poses.

    Least squares from the alignment of the positions. Directions of the lever arm in which it hardly shows (LEAST_SHOWN) are left at 0: they would be noise.
    """
    camera, known = estimate.at(reference.stamps)
    if np.count_nonzero(known) < FEWEST:
        return None
    chosen = np.flatnonzero(known)[::max(1, np.count_nonzero(known) // MOST)]
    camera, body = camera[chosen], reference.poses[chosen]
    scale, R, t = aligned = geometry.align_points(body[:, :3, 3], camera[:, :3, 3], with_scale=True)
    if not scale > 0:
        return None
    line = None if reference.attitude else _line(body[:, :3, 3], camera[:, :3, 3], aligned)
    if line is not None:
        R = _upright(R, line)
        t = body[:, :3, 3].mean(0) - scale * R @ camera[:, :3, 3].mean(0)
    turn = _rotvec(_mean_rotation(np.swapaxes(body[:, :3, :3], 1, 2) @ R @ camera[:, :3, :3])) if reference.attitude else np.zeros(0)
    arms, free = np.eye(3), np.zeros((0, 3))
    while True:
        start = np.concatenate([_rotvec(R), t, [np.log(scale)], np.zeros(len(arms)), turn])
        solution = least_squares(_residuals, start, x_scale='jac', args=(camera, body, reference.attitude, arms, line))
        lever = slice(7, 7 + len(arms))
        others = np.delete(solution.jac, np.arange(lever.start, lever.stop), axis=1)
        own = solution.jac[:, lever]
        own = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]  # what nothing else explains
        shown, axes = np.linalg.eigh(own.T @ own / len(camera))
        hidden = shown < LEAST_SHOWN ** 2
        if len(free) or not np.any(hidden):
            break
        free, arms = axes.T[hidden] @ arms, axes.T[~hidden] @ arms
    x = solution.x
    R_b_c = geometry.matrix_from_rotations(Rotation.from_rotvec(x[lever.stop:])) if reference.attitude else np.eye(3)
    T_w_m = geometry.pose(geometry.matrix_from_rotations(Rotation.from_rotvec(x[:3])), x[3:6])
    return Mounting(geometry.pose(R_b_c, x[lever] @ arms), T_w_m, float(np.exp(x[6])), free, line is not None)


def agrees(mounting, T_base_camera):
    """Whether the estimated mounting is that of base_link, as far as the motion tells it."""
    arm = T_base_camera[:3, 3] - mounting.T_b_c[:3, 3]
    arm = arm - mounting.free.T @ (mounting.free @ arm)
    return np.linalg.norm(arm) < SAME_PLACE and geometry.rotation_angle(mounting.T_b_c[:3, :3].T @ T_base_camera[:3, :3]) < SAME_TURN


def _like_base(bag, mounting, base, T_base_camera):
    """Frames beside `base` (base_footprint under it) whose mounting agrees as well, and lies elsewhere along what the motion does not tell."""
    result = []
    for frame in sorted({frame for edge in bag.edges for frame in edge} - {base}):
        T_frame_base = bag.static_transform(frame, base)
        if T_frame_base is not None and agrees(mounting, T_frame_base @ T_base_camera) and np.linalg.norm(mounting.free @ T_frame_base[:3, 3]) > LEAST_APART:
            result.append(frame)
    return result


def _open_upwards(reference, mounting):
    """Whether one of the directions in which the lever arm is not known is up, on average."""
    return reference.attitude and bool(np.any(np.abs(np.mean(reference.poses[:, 2, :3] @ mounting.free.T, axis=0)) > UPWARDS))


def mounted(reference, mounting, estimate):
    """Track of the camera by the reference; of positions alone with the attitudes of the estimate, where that is known."""
    if reference.attitude:
        return Track(reference.stamps, reference.poses @ mounting.T_b_c)
    camera, known = estimate.at(reference.stamps)
    poses = reference.poses.copy()
    poses[:, :3, :3] = mounting.T_w_m[:3, :3] @ camera[:, :3, :3]
    poses[:, :3, 3] += poses[:, :3, :3] @ mounting.T_b_c[:3, 3]
    return Track(reference.stamps[known], poses[known])


def _on_the_images_clock(reference, estimate, topic, robot):
    """(reference with the stamps that the images would have had, what was done to them, notes)."""
    shift = clock_shift(Track(reference.stamps, reference.poses), estimate, reference.attitude)
    if shift is None:
        return reference, '', [f'{topic} does not move as {robot} does, at whatever shift of time within {WIDEST:g} s: a clock further off than that, another body, or an odometry that is wrong; '
                               'errors are with its stamps as they are']
    if shift == 0:
        return reference, '', []
    moved = f'{1e3 * abs(shift):.0f} ms {"later" if shift > 0 else "earlier"}'
    said = (f'{topic} moves as {robot} does when its poses are taken as {moved} than stamped: another clock than that of the images, whose stamps the odometry has, or another instant of their exposure; '
            'errors are with them so')
    return dataclasses.replace(reference, stamps=reference.stamps + shift), f', {moved}', [said]


def _together(a, b):
    """Which of the stamps `a` lie in the time of `b`."""
    return (a >= b[0]) & (a <= b[-1]) if len(b) else np.zeros(len(a), bool)


def _most_turned(poses):
    """Greatest turn from the first of the poses (n, 4, 4) [rad]."""
    return float(geometry.rotation_angle(poses[:1, :3, :3].swapaxes(1, 2) @ poses[:, :3, :3]).max()) if len(poses) else 0.0


def _rests(reference, estimate):
    """Whether a reference does not move in the time of the estimate, but for its noise."""
    known = _together(reference.stamps, estimate.stamps)
    if np.count_nonzero(known) < FEWEST:
        return False
    poses = reference.poses[known]
    spread = np.sqrt(np.sum(np.var(poses[:, :3, 3], axis=0)))
    return spread < max(REST, 3 * noise(reference.stamps[known], poses[:, :3, 3])) and not (reference.attitude and _most_turned(poses) > TURNED)


def _that_turn(reference, estimate, topic, robot):
    """(reference, notes): of positions alone where its attitudes do not turn and the odometry's do, as where a receiver's or a total station's positions are published as poses."""
    known, own = _together(reference.stamps, estimate.stamps), _together(estimate.stamps, reference.stamps)
    turned = _most_turned(estimate.poses[own])
    if not reference.attitude or not np.any(known) or _most_turned(reference.poses[known]) > STEADY or turned < TURNED:
        return reference, []
    said = (f'{topic}: its attitudes never turn, while those of {robot} do, by up to {np.degrees(turned):.0f} degrees: taken for positions alone, as of a receiver or a total station; '
            f'where they are right, {robot} turned by that much of which its errors contain nothing')
    return dataclasses.replace(reference, attitude=False), [said]


def camera_track(bag, topic, robot, base, T_base_camera, estimate):
    """(Track of a robot's camera by the reference on a topic, or None; what that is, in words; notes). bag: its static transforms and reference(topic).

    Poses without a frame of their own on /ground_truth/<robot> are those of `base`: our recordings' and dataset_to_bag's.
    """
    reference = bag.reference(topic)
    if reference is None:
        return None, '', []
    notes = reference_faults.said(topic, reference.left_out, reference.left_out + len(reference.stamps))
    rests = _rests(reference, estimate)
    if not rests:
        reference, said = _that_turn(reference, estimate, topic, robot)
        notes += said
    frame = reference.frame or (base if reference.attitude and topic.endswith(f'/ground_truth/{robot}') else '')
    T_frame_base = bag.static_transform(frame, base) if frame and reference.attitude else None
    kind = f'{"poses" if reference.attitude else "positions"} of {frame or "a body that is not named"}'
    if T_frame_base is None and rests:
        return None, f'{kind}; no comparison', notes + [f'{topic} tells {kind}, which does not move while {robot} gives poses: no errors. Where {robot} moved, the topic is of another body']
    reference, moved, said = _on_the_images_clock(reference, estimate, topic, robot)
    notes += said
    if T_frame_base is not None:
        return Track(reference.stamps, reference.poses @ T_frame_base @ T_base_camera), kind + moved, notes
    if not len(estimate):
        return None, f'{kind}; no pose to compare', notes
    mounting = estimate_mounting(reference, estimate)
    if mounting is None:
        return None, f'{kind}; no comparison', notes + [f'{topic} tells {kind}, and fewer than {FEWEST} poses of {robot} are of its time: no errors']
    open_axes = ' and '.join('(' + ' '.join(f'{x:.2f}' for x in axis) + ')' for axis in mounting.free)
    if reference.attitude and 0 < len(mounting.free) < 3 and agrees(mounting, T_base_camera):
        said = f'{topic} tells {kind}, which moves as {base} does: taken for that; the motion turns too little to tell how far they are apart along {open_axes}'
        others = _like_base(bag, mounting, base, T_base_camera)
        if others:
            said += f'; {", ".join(others)} would do as well'
        heights = not (others and _open_upwards(reference, mounting))
        return Track(reference.stamps, reference.poses @ T_base_camera, heights), f'poses of {base}, by its motion{moved}', notes + [said]
    place = ' '.join(f'{x:.3f}' for x in mounting.T_b_c[:3, 3])
    if reference.attitude:
        turn = ' '.join(f'{x:.4f}' for x in geometry.quaternion_from_matrix(mounting.T_b_c[:3, :3]))
        found = f'the camera in it was estimated from the odometry, x y z {place} m, qx qy qz qw {turn}'
    else:
        found = f'the camera to it was estimated from the odometry, {place} m along the camera\'s axes; its attitudes are the odometry\'s own'
    if len(mounting.free):
        found += f'; the motion turns too little to tell {"any" if len(mounting.free) == 3 else "all"} of the lever arm: 0 along {open_axes}'
    if mounting.vertical:
        found += '; its positions lie so nearly on a line that they do not tell how the map is turned about it: z of the map is taken to be up, as that of the reference'
    outcome = f'errors of {robot}, and those of the alignment, contain what it is along these' if len(mounting.free) else f'errors of {robot} contain none of it'
    track = dataclasses.replace(mounted(reference, mounting, estimate), heights=not _open_upwards(reference, mounting))
    return track, f'{kind}, mounting estimated{moved}', notes + [f'{topic} tells {kind}, which no static transform connects to {base}: {found}; {outcome}']
