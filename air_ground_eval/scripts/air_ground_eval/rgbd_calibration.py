"""Calibration of a colour camera against a depth camera from a recording alone, without a target.

Where the depth image jumps, the colour image has an edge. The colour camera's parameters (f, cx, cy, baseline tx ty, roll) are
moved until the near sides of all jumps lie on the strongest edges. Over a hundred frames at 0.5-4 m this fixes focal length
against baseline, as the latter's shift falls with distance. The photometric error between frames with reference poses does not:
with the small rotations between views of one place, it cannot tell a baseline from an error of the poses. It serves as the check.
"""
import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from . import geometry, registration
from .recording import Camera, read_image

NAMES = ('f_px', 'cx_px', 'cy_px', 'tx_m', 'ty_m', 'roll_rad')
FIRST_STEPS = np.array([4.0, 2.0, 2.0, 0.004, 0.004, 0.004])


def blur(image, sigma):
    """Gaussian blur of a float image."""
    return cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)


def sample(image, u, v):
    """Bilinear samples; coordinates are clamped to the image."""
    return map_coordinates(image, [v, u], order=1, mode='nearest')


def grey_image(path):
    image = read_image(path)
    return (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image).astype(np.float32)


def depth_jumps(depth):
    """Near sides of depth jumps: rows of u, v [px, between the two pixels], z [m], axis (1: along u)."""
    rows = []
    for axis in (0, 1):
        for side in (1, -1):
            beyond, beyond2, before = (np.roll(depth, -side * n, axis) for n in (1, 2, -1))
            with np.errstate(invalid='ignore'):
                jump = ((beyond - depth > 0.10 * depth) & (np.abs(before - depth) < 0.03 * depth) & (np.abs(beyond2 - beyond) < 0.10 * beyond))
            jump[:20], jump[-20:], jump[:, :20], jump[:, -20:] = False, False, False, False
            v, u = np.nonzero(jump)
            rows.append(np.stack([u + 0.5 * side * axis, v + 0.5 * side * (1 - axis), depth[v, u], np.full(len(u), axis)], 1))
    return np.concatenate(rows)


class EdgeObjective:
    """Mean contrast-normalised gradient of the colour images across the depth images' jumps."""

    def __init__(self, recording, frames):
        self.depth_camera, self.frames = recording.depth_camera, []
        depth_of = {f.stamp: f for f in recording.depth}
        for frame in frames:
            depth = registration.metres(recording, depth_of[frame.stamp].path)
            depth[depth > 5] = np.nan
            smooth = blur(grey_image(frame.path), 1.2)
            gradients = [np.abs(np.gradient(smooth, axis=axis)) for axis in (0, 1)]
            self.frames.append(([g / (blur(g, 15) + 1) for g in gradients], depth_jumps(depth)))

    def __call__(self, p):
        total, count = 0.0, 0
        for gradients, jumps in self.frames:
            x = (jumps[:, 0] - self.depth_camera.cx) / self.depth_camera.fx
            y = (jumps[:, 1] - self.depth_camera.cy) / self.depth_camera.fy
            u = p[0] * (x - p[3] / jumps[:, 2] - p[5] * y) + p[1]
            v = p[0] * (y - p[4] / jumps[:, 2] + p[5] * x) + p[2]
            height, width = gradients[0].shape
            inside = (u > 2) & (u < width - 3) & (v > 2) & (v < height - 3)
            for axis in (0, 1):
                use = inside & (jumps[:, 3] == axis)
                total += np.minimum(sample(gradients[axis], u[use], v[use]), 6).sum()
                count += np.count_nonzero(use)
        return total / max(count, 1)


def maximise(objective, start):
    """Coordinate search with halving steps, down to 1/16 of the first; returns the parameters and the objective there."""
    p, steps = np.array(start, float), FIRST_STEPS.copy()
    best = objective(p)
    while steps[0] >= FIRST_STEPS[0] / 16:
        improved = False
        for k in range(len(p)):
            for sign in (1, -1):
                trial = p.copy()
                trial[k] += sign * steps[k]
                value = objective(trial)
                if value > best + 1e-7:
                    p, best, improved = trial, value, True
                    break
        if not improved:
            steps /= 2
    return p, best


def apply(recording, p):
    """Sets the recording's colour camera and extrinsics from the parameters."""
    size = recording.camera.width, recording.camera.height
    recording.camera = Camera(*size, p[0], p[0], p[1], p[2])
    recording.T_depth_colour = geometry.pose(geometry.rotation_z(-p[5]), (p[3], p[4], 0))


def photometric_error(recording, T_world_depth, pairs):
    """Median over pairs (i, j) of the median grey difference of frame i's points seen from frame j, mean grey removed.

    T_world_depth: poses of the depth camera, one a colour frame.
    """
    errors = []
    depth_of = {f.stamp: f for f in recording.depth}
    camera = recording.camera
    for i, j in pairs:
        depth = registration.depth_in_millimetres(recording, depth_of[recording.colour[i].stamp].path) / 1000.0
        v, u = np.nonzero((depth > 0.4) & (depth < 3.5))
        v, u = v[::7], u[::7]
        z = depth[v, u]
        points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z, np.ones_like(z)])
        T_j_i = (geometry.inverse(T_world_depth[j] @ recording.T_depth_colour) @ T_world_depth[i] @ recording.T_depth_colour)
        seen = (T_j_i @ points)[:3]
        x, y = camera.fx * seen[0] / seen[2] + camera.cx, camera.fy * seen[1] / seen[2] + camera.cy
        inside = (seen[2] > 0.3) & (x > 2) & (x < camera.width - 3) & (y > 2) & (y < camera.height - 3)
        if np.count_nonzero(inside) < 500:
            continue
        difference = (sample(grey_image(recording.colour[j].path), x[inside], y[inside])
                      - grey_image(recording.colour[i].path)[v[inside], u[inside]])
        errors.append(np.median(np.abs(difference - np.median(difference))))
    return float(np.median(errors)) if errors else float('nan')
