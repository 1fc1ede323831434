"""Depth images registered to the colour camera."""
import cv2
import numpy as np

from .recording import DatasetError, read_image

FARTHEST = 65.535  # [m]: what 16 bits of millimetres hold


def distort(x, y, distortion):
    """Distorted image coordinates of normalised ones (plumb bob, k1 k2 p1 p2 k3), and where the model still increases outwards."""
    k1, k2, p1, p2, k3 = (tuple(distortion) + (0.0,) * 5)[:5]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    increasing = 1 + r2 * (3 * k1 + r2 * (5 * k2 + 7 * r2 * k3)) > 0
    return (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y, increasing)


def register_depth(depth, depth_camera, colour_camera, T_depth_colour):
    """Depth [m] (h, w; NaN invalid) seen from the colour camera: the nearest surface in each of its pixels, NaN for none.

    The depth camera's distortion (k1 k2 p1 p2 k3) is taken out of its pixels, the colour camera's is applied where it is monotonic.
    """
    v, u = np.nonzero(np.isfinite(depth))
    z = depth[v, u]
    rays = np.stack([(u - depth_camera.cx) / depth_camera.fx, (v - depth_camera.cy) / depth_camera.fy], 1)
    if np.any(depth_camera.distortion) and len(rays):
        rays = cv2.undistortPoints(rays[:, None], np.eye(3), np.array(depth_camera.distortion, float))[:, 0]
    points = np.column_stack([rays * z[:, None], z])
    points = (points - T_depth_colour[:3, 3]) @ T_depth_colour[:3, :3]
    points = points[points[:, 2] > 0.05]
    z = points[:, 2]
    x, y, valid = distort(points[:, 0] / z, points[:, 1] / z, colour_camera.distortion)
    x, y, z = colour_camera.fx * x[valid] + colour_camera.cx, colour_camera.fy * y[valid] + colour_camera.cy, z[valid]
    result = np.full((colour_camera.height, colour_camera.width), np.inf)
    # A depth pixel that covers more than a colour pixel fills its neighbours, else the image would get holes.
    grow = int(np.ceil(max(colour_camera.fx / depth_camera.fx, colour_camera.fy / depth_camera.fy) - 1 - 1e-6))
    base_x, base_y = (np.floor(x).astype(int), np.floor(y).astype(int)) if grow > 0 else (
        np.rint(x).astype(int), np.rint(y).astype(int))
    for dy in range(grow + 1):
        for dx in range(grow + 1):
            cx, cy = base_x + dx, base_y + dy
            inside = (cx >= 0) & (cx < colour_camera.width) & (cy >= 0) & (cy < colour_camera.height)
            np.minimum.at(result, (cy[inside], cx[inside]), z[inside])
    result[np.isinf(result)] = np.nan
    return result


def metres(recording, path):
    """A depth image of a recording as its own camera sees it, float [m], NaN where it is invalid."""
    raw = read_image(path, depth=True)
    if raw.dtype.kind == 'f':
        return np.where(np.isfinite(raw) & (raw > 0), raw * recording.float_depth_unit, np.nan)
    return np.where(np.isin(raw, recording.depth_invalid), np.nan, raw * recording.depth_unit)


def check_unit(recording, path):
    """DatasetError where depth in floating point, taken for metres, is so far that nothing of it is kept."""
    if read_image(path, depth=True).dtype.kind == 'f':
        depth = metres(recording, path)
        if np.any(np.isfinite(depth)) and np.nanmin(depth) >= FARTHEST:
            raise DatasetError(f'{path}: its depths begin at {np.nanmin(depth):.0f}, farther than {FARTHEST:.0f} m if they are metres: are they millimetres? Say so by '
                               '"depth_counts_per_metre: 1000" in --config')


def depth_in_millimetres(recording, path):
    """The depth image of a recording, registered to its colour camera, uint16 [mm], 0 invalid."""
    depth = metres(recording, path)
    camera = recording.depth_camera or recording.camera
    if depth.shape != (camera.height, camera.width):
        raise DatasetError(f'{path}: is {depth.shape[1]}x{depth.shape[0]}, its camera {camera.width}x{camera.height}')
    if recording.depth_camera is not None:
        depth = register_depth(depth, recording.depth_camera, recording.camera, recording.T_depth_colour)
    millimetres = np.rint(depth * 1000)
    return np.where(np.isfinite(millimetres) & (millimetres > 0) & (millimetres < 65535), millimetres, 0).astype(np.uint16)
