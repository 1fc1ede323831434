"""Colour camera with distortion from feature tracks, depth and reference poses: bundle adjustment on the recording alone.

Corners of every anchor image with a depth are followed to the next anchor. Adjusted are any of f, cx, cy, k1, k2 and the readout
time of the rolling shutter, the relative pose of each pair of images (prior: the reference poses'), and an inverse depth for each
track (prior: the registered depth). Robust Gauss-Newton; the inverse depths are eliminated. The tracks' errors are those of depth and
reference rather than of the image, hence common to many tracks: they are given 4 px, else the reference's turn would not count.
"""
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter
from scipy.spatial.transform import Rotation

from . import geometry, registration
from .recording import DatasetError
from .rgbd_calibration import grey_image

NAMES = ('f_px', 'cx_px', 'cy_px', 'k1', 'k2', 'readout_s')
STEPS = np.array([0.1, 0.1, 0.1, 1e-4, 1e-4, 1e-4])  # of the numeric derivatives
PRIOR_POSITION, PRIOR_ATTITUDE = 0.003, np.radians(0.1)  # of each pose of a pair [m], [rad]
PRIOR_INVERSE_DEPTH = 0.006  # [1/m]
PIXEL_SIGMA, HUBER = 4.0, 2.0  # [px], [standard deviations]
RADIUS = 7  # of the patches [px]
MIN_STRENGTH = 80  # of a corner, as OpenCV scales it: 20 grey levels squared a pixel


@dataclass
class Tracks:
    """Observations: corner `anchor_uv` of image `anchor`, seen at `uv` in image `other`; images count within `frames`."""
    frames: list
    track: np.ndarray     # (n,) index of the track
    anchor: np.ndarray    # (n,)
    other: np.ndarray     # (n,)
    anchor_uv: np.ndarray  # (n, 2) [px]
    uv: np.ndarray        # (n, 2) [px]
    inverse_depth: np.ndarray  # (tracks,) [1/m]


def follow(anchor, image, start, guess):
    """Positions (n, 2) in `image` of corners at `start` in `anchor` (uint8), and which were found (Lucas-Kanade, there and back within 0.5 px)."""
    window = dict(winSize=(2 * RADIUS + 1, 2 * RADIUS + 1), maxLevel=2, flags=cv2.OPTFLOW_USE_INITIAL_FLOW)
    start, guess = (np.ascontiguousarray(p, np.float32).reshape(-1, 1, 2) for p in (start, guess))
    found, there, _ = cv2.calcOpticalFlowPyrLK(anchor, image, start, guess.copy(), **window)
    again, back, _ = cv2.calcOpticalFlowPyrLK(image, anchor, found, start.copy(), **window)
    near = np.abs(again - start).max((1, 2)) < 0.5
    inside = (found > 10).all((1, 2)) & (found < np.array(image.shape[::-1]) - 10).all((1, 2))
    return found.reshape(-1, 2).astype(float), (there.ravel() == 1) & (back.ravel() == 1) & near & inside


def corners(image, usable, cell=24):
    """The strongest corner (smaller eigenvalue of the structure tensor) of each cell, (n, 2)."""
    strength = np.where(usable, cv2.cornerMinEigenVal(image.astype(np.float32), 7), 0)
    found = []
    for top in range(12, image.shape[0] - 12 - cell, cell):
        for left in range(12, image.shape[1] - 12 - cell, cell):
            block = strength[top:top + cell, left:left + cell]
            row, column = np.unravel_index(np.argmax(block), block.shape)
            if block[row, column] > MIN_STRENGTH:
                found.append((left + column, top + row))
    return np.array(found, float).reshape(-1, 2)


def collect(recording, indices, spacing=10, views=1):
    """Tracks from an anchor every `spacing` images, observed at the following `views` multiples of it."""
    indices = list(indices)
    keep = indices[::spacing]
    depth_of = {f.stamp: f for f in recording.depth}
    columns = {name: [] for name in ('track', 'anchor', 'other', 'anchor_uv', 'uv')}
    inverse_depths, live, count = [], [], 0
    for index in range(keep[0], keep[-1] + 1, 2):
        image = grey_image(recording.colour[index].path).astype(np.uint8)
        for group in live:
            group['uv'], found = follow(group['image'], image, group['start'], group['uv'])
            group['alive'] &= found
        if index not in keep:
            continue
        here = keep.index(index)
        for group in live:
            alive = group['alive']
            columns['track'].append(group['ids'][alive])
            columns['anchor'].append(np.full(alive.sum(), group['anchor']))
            columns['other'].append(np.full(alive.sum(), here))
            columns['anchor_uv'].append(group['start'][alive])
            columns['uv'].append(group['uv'][alive])
        live = [g for g in live if here - g['anchor'] < views and g['alive'].any()]
        depth_frame = depth_of.get(recording.colour[index].stamp)
        if depth_frame is None:
            continue
        z = registration.depth_in_millimetres(recording, depth_frame.path) / 1000.0
        near, far = minimum_filter(np.where(z > 0, z, np.inf), 5, mode='constant', cval=np.inf), maximum_filter(z, 5, mode='constant')
        share = uniform_filter((z > 0).astype(float), 5, mode='constant')
        start = corners(image, (share > 0.6) & (far < 1.03 * near) & (far < 3.5))
        column, row = start.astype(int).T
        inverse_depths.append(1.0 / (0.5 * (near + far)[row, column]))
        live.append({'anchor': here, 'start': start, 'uv': start.copy(), 'image': image,
                     'ids': count + np.arange(len(start)), 'alive': np.ones(len(start), bool)})
        count += len(start)
    joined = {name: np.concatenate(value) for name, value in columns.items()}
    return Tracks([recording.colour[i] for i in keep], inverse_depth=np.concatenate(inverse_depths), **joined)


def pairs(tracks, recording, chosen, max_error=12.0):
    """Tracks, camera poses (2k, 4, 4) and velocities (2k, 6) of the chosen pairs of neighbouring anchors, each pair on its own.

    chosen(i) says whether pair i belongs; tracks further than max_error [px] from the reference's prediction are left out.
    """
    indices = [int(np.argmin(np.abs(recording.pose_stamps - f.stamp))) for f in tracks.frames]
    T = recording.poses[indices]
    c = recording.camera
    p = np.array([c.fx, c.cx, c.cy, c.distortion[0], c.distortion[1], 0.0])
    every = Adjustment(tracks, T, np.zeros((len(T), 6)), c.height, np.zeros(6))
    r = every.residuals(p)
    rows, anchors, others, poses, twists = [], [], [], [], []
    for i in filter(chosen, range(len(T) - 1)):
        mine = np.flatnonzero((tracks.anchor == i) & (tracks.other == i + 1))
        # The reference's error moves all tracks of a pair together.
        mine = mine[np.linalg.norm(r[mine] - np.median(r[mine], 0), axis=1) < max_error] if len(mine) else mine
        if len(mine) < 20:
            continue
        k = len(poses)
        rows.append(mine)
        anchors.append(np.full(len(mine), k))
        others.append(np.full(len(mine), k + 1))
        poses += [np.eye(4), geometry.inverse(T[i]) @ T[i + 1]]
        twists += [twist(recording, indices[i]), twist(recording, indices[i + 1])]
    if not rows:
        raise DatasetError('no pair of images shares 20 tracks with depth')
    rows = np.concatenate(rows)
    used, track = np.unique(tracks.track[rows], return_inverse=True)
    return (Tracks([None] * len(poses), track, np.concatenate(anchors), np.concatenate(others), tracks.anchor_uv[rows],
                   tracks.uv[rows], tracks.inverse_depth[used]), np.array(poses), np.array(twists))


def twist(recording, index, reach=3):
    """Velocity of the camera (6,), in its own frame [m/s], [rad/s], from the reference poses `reach` before and after."""
    low, high = max(0, index - reach), min(len(recording.poses) - 1, index + reach)
    motion = geometry.inverse(recording.poses[low]) @ recording.poses[high]
    return np.concatenate([motion[:3, 3], logmap(motion[None, :3, :3])[0]]) / (recording.pose_stamps[high] - recording.pose_stamps[low])


def undistort(uv, p):
    """Normalised rays (n, 2) of pixels for parameters p (NAMES)."""
    target = (uv - p[1:3]) / p[0]
    ray = target.copy()
    for _ in range(12):
        r2 = (ray ** 2).sum(1, keepdims=True)
        ray = target / (1 + p[3] * r2 + p[4] * r2 * r2)
    return ray


def expmap(w):
    """Rotation matrices (n, 3, 3) of rotation vectors (n, 3)."""
    return geometry.matrix_from_rotations(Rotation.from_rotvec(w))


def logmap(R):
    return geometry.rotations_from_matrix(R).as_rotvec()


class Adjustment:
    """The bundle adjustment; `free` says which of NAMES move."""

    def __init__(self, tracks, T_world_camera, twists, height, free):
        self.t, self.reference, self.height = tracks, T_world_camera, height
        self.twists = twists  # (frames, 6) camera-frame velocity: m/s, rad/s
        self.free = np.flatnonzero(free)
        self.R, self.c = T_world_camera[:, :3, :3].copy(), T_world_camera[:, :3, 3].copy()
        self.rho = tracks.inverse_depth.copy()

    def residuals(self, p, da=0, dj=0, drho=0):
        """Reprojection errors (n, 2) [px]; da, dj: perturbations (n, 6) of the anchor's and the other pose."""
        t = self.t

        def posed(index, uv, d):
            twist = self.twists[index] * (p[5] * ((uv[:, 1] + 0.5) / self.height - 0.5))[:, None] + d
            R = self.R[index]
            return R @ expmap(twist[:, 3:]), self.c[index] + (R @ twist[:, :3, None])[..., 0]
        Ra, ca = posed(t.anchor, t.anchor_uv, da)
        Rj, cj = posed(t.other, t.uv, dj)
        rho = (self.rho[t.track] + drho)[:, None]
        ray = np.concatenate([undistort(t.anchor_uv, p), np.ones((len(rho), 1))], 1)
        point = (Ra @ ray[..., None])[..., 0] + rho * (ca - cj)
        q = (np.swapaxes(Rj, 1, 2) @ point[..., None])[..., 0]
        x = q[:, :2] / np.maximum(q[:, 2:], 0.05)
        r2 = (x ** 2).sum(1, keepdims=True)
        return p[0] * x * (1 + p[3] * r2 + p[4] * r2 * r2) + p[1:3] - t.uv

    def solve(self, p, iterations=12):
        """Adjusted parameters, their standard deviations, RMS of the inliers [px]."""
        t, frames, k = self.t, len(self.t.frames), len(self.free)
        p = np.array(p, float)
        for _ in range(iterations):
            r = self.residuals(p)
            norm = np.linalg.norm(r, axis=1) / PIXEL_SIGMA
            w = np.sqrt(np.where(norm < HUBER, 1, HUBER / np.maximum(norm, 1e-9)) * (norm < 12))[:, None] / PIXEL_SIGMA
            blocks = []
            for name in ('da', 'dj'):
                for axis in range(6):
                    d = np.zeros((len(r), 6))
                    d[:, axis] = 1e-5
                    blocks.append((self.residuals(p, **{name: d}) - r) / 1e-5 * w)
            pose_jacobian = np.stack(blocks, 2)  # (n, 2, 12)
            shared = np.stack([(self.residuals(p + STEPS * (np.arange(6) == i)) - r) / STEPS[i] * w for i in self.free], 2)
            rho_jacobian = (self.residuals(p, drho=1e-5) - r) / 1e-5 * w
            r = r * w
            size = k + 6 * frames
            columns = np.concatenate([np.broadcast_to(np.arange(k), (len(r), k)), k + 6 * t.anchor[:, None] + np.arange(6),
                                      k + 6 * t.other[:, None] + np.arange(6)], 1)
            J = np.concatenate([shared, pose_jacobian], 2)
            normal, right = np.zeros((size, size)), np.zeros(size)
            np.add.at(normal, (columns[:, :, None], columns[:, None, :]), np.einsum('nia,nib->nab', J, J))
            np.add.at(right, columns, -np.einsum('nia,ni->na', J, r))
            # Priors of the poses.
            rotation = logmap(np.swapaxes(self.reference[:, :3, :3], 1, 2) @ self.R)
            shift = (np.swapaxes(self.R, 1, 2) @ (self.c - self.reference[:, :3, 3])[..., None])[..., 0]
            offset = np.concatenate([shift / PRIOR_POSITION ** 2, rotation / PRIOR_ATTITUDE ** 2], 1).reshape(-1)
            normal[np.arange(k, size), np.arange(k, size)] += np.tile(
                [PRIOR_POSITION ** -2] * 3 + [PRIOR_ATTITUDE ** -2] * 3, frames)
            right[k:] -= offset
            # Inverse depths, each coupled to its own observations only.
            W = np.zeros((len(self.rho), size))
            np.add.at(W, (t.track[:, None], columns), np.einsum('nia,ni->na', J, rho_jacobian))
            h = np.full(len(self.rho), PRIOR_INVERSE_DEPTH ** -2)
            g = -(self.rho - t.inverse_depth) * PRIOR_INVERSE_DEPTH ** -2
            np.add.at(h, t.track, (rho_jacobian ** 2).sum(1))
            np.add.at(g, t.track, -(rho_jacobian * r).sum(1))
            reduced = normal - W.T @ (W / h[:, None])
            step = np.linalg.solve(reduced, right - W.T @ (g / h))
            self.rho = np.maximum(self.rho + (g - W @ step) / h, 0.02)
            p[self.free] += step[:k]
            d = step[k:].reshape(frames, 6)
            self.c += (self.R @ d[:, :3, None])[..., 0]
            self.R = self.R @ expmap(d[:, 3:])
            if np.abs(step[:k] / STEPS[self.free]).max() < 0.05:
                break
        stddev = np.zeros(6)
        stddev[self.free] = np.sqrt(np.diag(np.linalg.inv(reduced))[:k])
        final = np.linalg.norm(self.residuals(p), axis=1)
        inliers = final[final < 12 * PIXEL_SIGMA]
        return p, stddev, float(np.sqrt(np.mean(inliers ** 2)))
