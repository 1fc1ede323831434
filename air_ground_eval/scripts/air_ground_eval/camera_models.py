"""Camera models of other systems, and the `equidistant` model that sees what they see: no node of ours knows them.

A projection takes rays (n, 3), x right, y down, z ahead, to pixels (n, 2); not a number where the model sees nothing.
"""
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

LARGEST_ANGLE = np.radians(80.0)  # from the optical axis: no node uses what lies beyond (CameraModel::kMaxHalfAngle)
LARGEST_RESIDUAL = 0.3  # [px] of a fit: well below what a feature is tracked to (pixel_sigma 0.6)


class FitError(Exception):
    """One line: why no equidistant camera sees what the model does."""


@dataclass
class Fit:
    """Equidistant: radius = f theta (1 + k1 theta^2 + ... + k4 theta^8)."""
    fx: float
    fy: float
    coefficients: tuple  # k1 .. k4
    residual: float      # largest, over the image [px]
    angle: float         # up to which it was looked at [rad]


def radtan(points, coefficients):
    """Points (n, 2) at z = 1 with the distortion k1 k2 p1 p2 (k3) of Brown 1966."""
    k1, k2, p1, p2, k3 = (list(coefficients) + [0.0] * 5)[:5]
    x, y = points.T
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack([x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], 1)


def _pinhole(points, intrinsics):
    fx, fy, cx, cy = intrinsics
    return points * [fx, fy] + [cx, cy]


def _divided(rays, depth, seen=True):
    """x and y over a model's depth, where it is positive and the model sees."""
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.where((seen & (depth > 1e-9))[:, None], rays[:, :2] / depth[:, None], np.nan)


def fov(intrinsics, w):
    """Field of view model: r_d = atan(2 r_u tan(w/2)) / w (Devernay & Faugeras 2001, eq. 13); kalibr's fov, ATAN of PTAM and SVO. intrinsics: fx fy cx cy."""
    def project(rays):
        points = _divided(rays, rays[:, 2])
        r = np.linalg.norm(points, axis=1)
        factor = np.where(r > 1e-9, np.arctan(2 * r * np.tan(w / 2)) / (w * np.maximum(r, 1e-9)), 2 * np.tan(w / 2) / w)
        return _pinhole(points * factor[:, None], intrinsics)
    return project


def double_sphere(intrinsics, xi, alpha):
    """Usenko, Demmel & Cremers 2018, eq. 40 to 45."""
    def project(rays):
        x2, z = np.sum(rays[:, :2] ** 2, 1), rays[:, 2]
        d1 = np.sqrt(x2 + z * z)
        shifted = xi * d1 + z
        d2 = np.sqrt(x2 + shifted * shifted)
        w1 = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
        w2 = (w1 + xi) / np.sqrt(2 * w1 * xi + xi * xi + 1)
        return _pinhole(_divided(rays, alpha * d2 + (1 - alpha) * shifted, z > -w2 * d1), intrinsics)
    return project


def extended_unified(intrinsics, alpha, beta):
    """Khomutenko, Garcia & Martinet 2016: depth alpha sqrt(beta (x^2 + y^2) + z^2) + (1 - alpha) z; with beta = 1 the unified model (Usenko et al. 2018, eq. 10)."""
    def project(rays):
        d = np.sqrt(beta * np.sum(rays[:, :2] ** 2, 1) + rays[:, 2] ** 2)
        w = alpha / (1 - alpha) if alpha <= 0.5 else (1 - alpha) / alpha
        return _pinhole(_divided(rays, alpha * d + (1 - alpha) * rays[:, 2], rays[:, 2] > -w * d), intrinsics)
    return project


def omni(intrinsics, xi, distortion=()):
    """Mei & Rives 2007: onto the unit sphere, from its point xi behind the centre onto a plane, distorted there; kalibr's omni-radtan, MEI of VINS."""
    def project(rays):
        d = np.linalg.norm(rays, axis=1)
        behind = xi if xi <= 1 else 1 / xi
        return _pinhole(radtan(_divided(rays, rays[:, 2] + xi * d, rays[:, 2] > -behind * d), distortion), intrinsics)
    return project


def seen_by(project, width, height, angles=100, directions=48):
    """(rays, pixels) that a projection shows in an image of this size, up to LARGEST_ANGLE from the optical axis.

    Along each direction up to where the radius stops growing or the image ends: what a model says beyond is not of this lens.
    """
    theta = np.linspace(0, LARGEST_ANGLE, angles + 1)[1:]
    rays, pixels = [], []
    centre = project(np.array([[0.0, 0.0, 1.0]]))[0]
    for phi in np.linspace(0, 2 * np.pi, directions, endpoint=False):
        line = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)
        image = project(line)
        steps = np.diff(np.linalg.norm(image - centre, axis=1), prepend=0)
        with np.errstate(invalid='ignore'):
            inside = np.all((image >= -0.5) & (image <= [width - 0.5, height - 0.5]), 1) & (steps > 0)
        count = len(inside) if inside.all() else int(np.argmin(inside))
        rays.append(line[:count])
        pixels.append(image[:count])
    return np.concatenate(rays), np.concatenate(pixels)


def fit_equidistant(rays, pixels, cx, cy):
    """The Fit (centre kept) to where a camera shows rays; FitError where it is off by more than LARGEST_RESIDUAL."""
    if len(rays) < 50:
        raise FitError('the model shows next to nothing of what lies before the camera: check its figures, and their order')
    theta = np.arctan2(np.linalg.norm(rays[:, :2], axis=1), rays[:, 2])
    direction = rays[:, :2] / np.maximum(np.linalg.norm(rays[:, :2], axis=1), 1e-12)[:, None]
    offsets = pixels - [cx, cy]
    powers = theta[:, None] ** np.arange(1, 10, 2)  # theta, theta^3 .. theta^9
    along = np.sum(offsets * direction, 1)
    start = np.linalg.lstsq(powers, along, rcond=None)[0]

    def differences(x):
        return (offsets - (powers @ np.concatenate([[1.0], x[2:]]))[:, None] * direction * x[:2]).ravel()

    solution = least_squares(differences, [start[0], start[0], *(start[1:] / start[0])], method='lm').x
    residual = np.linalg.norm(differences(solution).reshape(-1, 2), axis=1).max()
    angle = theta.max()
    slopes = 1 + sum((2 * i + 3) * k * np.linspace(0, angle, 200) ** (2 * i + 2) for i, k in enumerate(solution[2:]))
    if not residual <= LARGEST_RESIDUAL or not slopes.min() > 0 or min(solution[:2]) <= 0:
        raise FitError(f'the model equidistant comes no nearer than {residual:.2f} px to it (up to {np.degrees(angle):.0f} degrees; {LARGEST_RESIDUAL} px is asked for): '
                       'undistort the images, or calibrate as pinhole-equi')
    return Fit(float(solution[0]), float(solution[1]), tuple(float(k) for k in solution[2:]), float(residual), float(angle))
