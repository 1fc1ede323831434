"""Cameras of RGB-D recordings: from --config, from calibration files beside the images, or as published for a known sensor.

An assumed calibration is used at its own image size and, scaled, at sizes of the same proportions; at others it is refused: focal
lengths of another sensor bend the map without a word.
"""
import glob
import json
import os
import re
from dataclasses import dataclass, field
from typing import Optional

import numpy as np
from PIL import Image, UnidentifiedImageError

from . import geometry
from .recording import Camera, DatasetError, camera_from_config, orthonormal_pose

VGA = (640, 480)
NO_DISTORTION = (0.0,) * 5
SAME_PROPORTIONS = 0.01  # relative difference of the two sides' scales
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


@dataclass
class Intrinsics:
    """fx fy cx cy [px] and distortion (k1 k2 p1 p2 k3) of images of `size` (width, height); None: of whatever size the images are."""
    source: str
    size: Optional[tuple]
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple = NO_DISTORTION
    scales: bool = True  # holds for images of other sizes, too


@dataclass
class KnownSensor:
    """What a data set's publishers say of it. The frame of its reference poses: T_reference_camera = pose @ pose_from_camera."""
    colour: Intrinsics
    up: Optional[tuple] = None  # in the frame of the reference poses
    pose_from_camera: np.ndarray = field(default_factory=lambda: np.eye(4))


@dataclass
class Calibration:
    """What the files beside the images say; None where they say nothing."""
    colour: Optional[Intrinsics] = None
    depth: Optional[Intrinsics] = None
    counts_per_metre: Optional[float] = None


@dataclass
class Rig:
    camera: Camera
    depth_camera: Optional[Camera]  # None: depth is registered to colour
    T_depth_colour: np.ndarray
    mirrored: bool                  # fy < 0: y is up in the images' and in the reference poses' frames


def kinect(name, fx, fy, cx, cy, *distortion):
    return Intrinsics(f'{name}, as published', VGA, fx, fy, cx, cy, tuple(distortion) or NO_DISTORTION)


FREIBURG_UP = (0.0, 0.0, 1.0)
# Bonn's poses are those of a marker body in a world whose y is up; its publishers give the camera in it, with a scale of 5 % that no mounting has.
BONN_MARKER_CAMERA = np.array([[-1, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]) @ geometry.orthonormalized(np.array([
    [1.0157, 0.1828, -0.2389, 0.0113], [0.0009, -0.8431, -0.6413, -0.0098], [-0.3009, 0.6147, -0.8085, 0.0111], [0, 0, 0, 1]]))
# By the folder's name. Depth of TUM's and Bonn's recordings is registered to colour, with the published scale already applied.
KNOWN = {
    'freiburg1': KnownSensor(kinect('TUM freiburg1', 517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633), FREIBURG_UP),
    'freiburg2': KnownSensor(kinect('TUM freiburg2', 520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172), FREIBURG_UP),
    'freiburg3': KnownSensor(kinect('TUM freiburg3', 535.4, 539.2, 320.1, 247.6), FREIBURG_UP),
    'rgbd_bonn': KnownSensor(kinect('Bonn RGB-D', 542.822841, 542.576870, 315.593520, 237.756098, 0.039903, -0.099343, -0.000730, -0.000144, 0.0),
                             (0.0, 1.0, 0.0), BONN_MARKER_CAMERA),
}
ICL_NUIM = KnownSensor(kinect('ICL-NUIM', 481.2, -480.0, 319.5, 239.5), (0.0, 1.0, 0.0))
SEVEN_SCENES = Intrinsics("7-Scenes' own advice, colour taken as registered with depth", VGA, 585.0, 585.0, 320.0, 240.0)
FACTORY = Intrinsics("assumed: a Kinect's or Xtion's factory values; --config with colour_camera states others", VGA, 525.0, 525.0, 319.5, 239.5, scales=False)


def known_sensor(folder):
    """By the folder's name or its parent's; None for others."""
    names = os.path.abspath(folder).split(os.sep)[-2:]
    return next((sensor for key, sensor in KNOWN.items() if any(key in name.lower() for name in reversed(names))), None)


def image_size(path):
    """(width, height) [px], without decoding it."""
    try:
        with Image.open(path) as image:
            return image.size
    except (OSError, UnidentifiedImageError) as error:
        raise DatasetError(f'{path}: cannot be read as an image ({error})') from error


def proportional(a, b):
    return abs(a[0] * b[1] / (a[1] * b[0]) - 1) < SAME_PROPORTIONS


# ---- calibration files -----------------------------------------------------------------------------------------------------

def numbers(path):
    """All numbers of a text file, as rows; lines that begin with # left out."""
    try:
        with open(path, encoding='utf-8') as stream:
            return [[float(word) for word in re.split(r'[\s,;]+', line.strip()) if word] for line in stream
                    if line.strip() and not line.lstrip().startswith('#')]
    except (OSError, ValueError) as error:
        raise DatasetError(f'{path}: expected numbers ({error})') from error


def read_calibration_line(path):
    """calibration.txt of ETH3D's and others' recordings: fx fy cx cy, and optionally k1 k2 p1 p2 (k3). None without such a file."""
    if not os.path.isfile(path):
        return None
    values = [value for row in numbers(path) for value in row]
    if len(values) not in (4, 8, 9) or not all(np.isfinite(values)) or values[0] <= 0 or values[1] == 0:
        raise DatasetError(f'{path}: expected "fx fy cx cy" in pixels, or these and "k1 k2 p1 p2" or "k1 k2 p1 p2 k3"')
    return Intrinsics(path, None, *values[:4], tuple((values[4:] + [0.0] * 5)[:5]))


def from_matrix(path, matrix, size=None):
    """Intrinsics of a 3x3 or 4x4 camera matrix."""
    matrix = np.asarray(matrix, float)
    if matrix.ndim != 2 or matrix.shape[0] < 3 or matrix.shape[1] < 3 or not (matrix[0, 0] > 0 and matrix[1, 1] != 0):
        raise DatasetError(f'{path}: expected a 3x3 or 4x4 camera matrix')
    return Intrinsics(path, size, *(float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))))


def read_matrix(path):
    if not os.path.isfile(path):
        return None
    try:
        return from_matrix(path, numbers(path))
    except ValueError as error:
        raise DatasetError(f'{path}: expected a 3x3 or 4x4 camera matrix ({error})') from error


def read_info(path, notes):
    """_info.txt of ScanNet's and 3RScan's SensReader: lines "m_name = value"."""
    with open(path, encoding='utf-8', errors='replace') as stream:
        entries = dict((part.strip() for part in line.split('=', 1)) for line in stream if '=' in line)
    found = Calibration()
    try:
        for kind in ('Color', 'Depth'):
            size = tuple(int(entries[f'm_{kind.lower()}{side}']) for side in ('Width', 'Height'))
            matrix = np.array(entries[f'm_calibration{kind}Intrinsic'].split(), float)
            intrinsics = from_matrix(path, matrix.reshape(-1, 4), size)
            if kind == 'Color':
                found.colour = intrinsics
            else:
                found.depth = intrinsics
            extrinsic = np.array(entries.get(f'm_calibration{kind}Extrinsic', '').split(), float)
            if extrinsic.size and not np.allclose(extrinsic, np.eye(4).ravel()[:extrinsic.size]):
                notes.append(f'{path}: m_calibration{kind}Extrinsic is no identity and not used: state depth_from_colour in --config')
        found.counts_per_metre = float(entries.get('m_depthShift', 1000))
    except (KeyError, ValueError) as error:
        raise DatasetError(f'{path}: expected the lines of ScanNet\'s SensReader ({error})') from error
    return found


def read_json(path):
    """Open3D's camera file: width, height, intrinsic_matrix column by column. None for another file."""
    try:
        with open(path, encoding='utf-8') as stream:
            content = json.load(stream)
        return from_matrix(path, np.array(content['intrinsic_matrix'], float).reshape(3, 3).T, (int(content['width']), int(content['height'])))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def calibration_files(folder, notes):
    """What a folder's files say: _info.txt, intrinsic/intrinsic_*.txt, calibration.txt, camera*.json."""
    info = os.path.join(folder, '_info.txt')
    if os.path.isfile(info):
        return read_info(info, notes)
    exported = [read_matrix(os.path.join(folder, 'intrinsic', f'intrinsic_{kind}.txt')) for kind in ('color', 'depth')]
    if exported[0] is not None:
        return Calibration(*exported)
    line = read_calibration_line(os.path.join(folder, 'calibration.txt'))
    if line is not None:
        return Calibration(line)
    return Calibration(next((c for c in map(read_json, sorted(glob.glob(os.path.join(folder, '*.json')))) if c is not None), None))


# ---- the cameras -----------------------------------------------------------------------------------------------------------

def camera_of(intrinsics, size, what):
    """The camera of images of `size` (width, height) by `intrinsics`, scaled where their size is another of the same proportions."""
    own = intrinsics.size or size
    if own != size and not intrinsics.scales:
        raise DatasetError(f'{what} is {size[0]}x{size[1]}, and nothing states its calibration (a Kinect\'s would be assumed at 640x480 alone): {HOW_TO_STATE}')
    if not proportional(own, size):
        raise DatasetError(f'{what} is {size[0]}x{size[1]}, its calibration ({intrinsics.source}) of {own[0]}x{own[1]}: {HOW_TO_STATE}')
    camera = Camera(*own, intrinsics.fx, abs(intrinsics.fy), intrinsics.cx, intrinsics.cy, tuple(intrinsics.distortion))
    if not (0.1 < camera.cx / own[0] < 0.9 and 0.1 < camera.cy / own[1] < 0.9):
        raise DatasetError(f'{what} is {own[0]}x{own[1]}, but the principal point of {intrinsics.source} lies at ({camera.cx:g}, {camera.cy:g}): '
                           f'it is of another size; {HOW_TO_STATE}')
    return scaled(camera, size)


def scaled(camera, size):
    """The camera of the same images at `size` (width, height), whose proportions may differ by a rounded pixel; centres of pixels have whole coordinates."""
    sx, sy = size[0] / camera.width, size[1] / camera.height
    return Camera(*size, camera.fx * sx, camera.fy * sy, (camera.cx + 0.5) * sx - 0.5, (camera.cy + 0.5) * sy - 0.5, camera.distortion, camera.model)


HOW_TO_STATE = 'give --config with "colour_camera: {fx_px: ..., fy_px: ..., cx_px: ..., cy_px: ..., distortion: [k1, k2, p1, p2, k3]}"'


def stated_camera(config, name, size):
    """(camera, fy < 0) of a section of --config."""
    section = config[name]
    if not isinstance(section, dict):
        raise DatasetError(f'{name} in the calibration file: expected named values: fx_px, fy_px, cx_px, cy_px')
    try:
        mirrored = float(section.get('fy_px', 1)) < 0
        camera = camera_from_config({**section, 'fy_px': abs(float(section['fy_px']))} if 'fy_px' in section else section, name, size)
    except (TypeError, ValueError) as error:
        raise DatasetError(f'{name} in the calibration file: {error}') from error
    if (camera.width, camera.height) != tuple(size):
        raise DatasetError(f'{name} in the calibration file is of {camera.width}x{camera.height}, the images are {size[0]}x{size[1]}')
    return camera, mirrored


def rig(config, colour_path, depth_path, found, assumed, notes):
    """The Rig of a recording whose first images lie at these paths (depth_path None: no depth).

    --config goes before `found`, the Calibration in its files, and that before `assumed`, Intrinsics of the sensor that it is taken for.
    """
    size = image_size(colour_path)
    if 'colour_camera' in config:
        camera, mirrored = stated_camera(config, 'colour_camera', size)
    else:
        intrinsics = found.colour or assumed
        camera, mirrored = camera_of(intrinsics, size, colour_path), intrinsics.fy < 0
        notes.append(f'colour camera: {intrinsics.source}: f {camera.fx:.1f} {camera.fy:.1f}, centre {camera.cx:.1f} {camera.cy:.1f} px'
                     + (f', scaled to {size[0]}x{size[1]}' if intrinsics.size not in (None, size) else ''))
    T_depth_colour = orthonormal_pose(config['depth_from_colour'], 'depth_from_colour') if 'depth_from_colour' in config else np.eye(4)
    depth_camera = depth_camera_of(config, camera, depth_path, found, notes) if depth_path else None
    if depth_camera is None and not np.allclose(T_depth_colour, np.eye(4)):
        depth_camera = camera  # apart from the colour camera, but of its intrinsics
    return Rig(camera, depth_camera, T_depth_colour, mirrored)


def depth_camera_of(config, camera, path, found, notes):
    """None where depth is registered to colour."""
    size, colour_size = image_size(path), (camera.width, camera.height)
    if 'depth_camera' in config:
        return stated_camera(config, 'depth_camera', size)[0]
    if found.depth is not None:
        return camera_of(found.depth, size, path)
    if size == colour_size:
        return None
    if not proportional(size, colour_size):
        raise DatasetError(f'{path} is {size[0]}x{size[1]}, colour {colour_size[0]}x{colour_size[1]}, and nothing says how the one looks at the other: give '
                           '--config with "depth_camera: {fx_px: ..., fy_px: ..., cx_px: ..., cy_px: ...}" and '
                           '"depth_from_colour: {translation_m: [x, y, z], quaternion_xyzw: [x, y, z, w]}"')
    notes.append(f'depth is {size[0]}x{size[1]}, of colour\'s proportions: taken as registered to it')
    return scaled(camera, size)


def counts_per_metre(config, found, default, notes):
    """What a count of the depth images is, by --config, the calibration files, or as usual in the layout."""
    if 'depth_counts_per_metre' in config:
        counts, source = config['depth_counts_per_metre'], '--config'
    elif found.counts_per_metre:
        counts, source = found.counts_per_metre, '_info.txt'
    else:
        counts, source = default, 'usual in this layout; depth_counts_per_metre of --config states another'
    try:
        counts = float(counts)
    except (TypeError, ValueError):
        counts = -1.0
    if not (np.isfinite(counts) and counts > 0):
        raise DatasetError(f'depth_counts_per_metre: {counts:g} must be a positive number')
    notes.append(f'depth: {counts:g} counts a metre ({source})')
    return counts
