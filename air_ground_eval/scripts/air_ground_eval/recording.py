"""What a reader of a data set returns: images, inertial samples, reference poses and calibration, in metres, seconds and radians."""
import contextlib
import os
from dataclasses import dataclass, field
from typing import List, Optional

import numpy as np
from PIL import Image, UnidentifiedImageError

from . import geometry, pixel_range
from .yaml_file import read_mapping

LOOKED_AT = 20  # images of 16 bits, for the scale of all


class DatasetError(Exception):
    """The input cannot be converted; the message says what to change."""


@dataclass
class Camera:
    """Pinhole with distortion as camera_info names it: plumb_bob (k1 k2 p1 p2 k3) or equidistant (k1 k2 k3 k4)."""
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple = (0.0, 0.0, 0.0, 0.0, 0.0)
    model: str = 'plumb_bob'

    def __post_init__(self):
        for name in ('width', 'height', 'fx', 'fy'):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise DatasetError(f'camera {name} = {value}: it must be positive')

    def resized(self, width):
        """The camera of the same images at this width [px]; centres of pixels have whole coordinates."""
        height = max(1, round(self.height * width / self.width))
        sx, sy = width / self.width, height / self.height
        return Camera(width, height, self.fx * sx, self.fy * sy, (self.cx + 0.5) * sx - 0.5, (self.cy + 0.5) * sy - 0.5, self.distortion, self.model)


@dataclass
class Frame:
    stamp: float  # [s]
    path: str
    levels: Optional[pixel_range.Levels] = None  # of 16-bit grey

    def read(self):
        """Its colour or grey image, as read_image gives it."""
        return read_image(self.path, levels=self.levels)


@dataclass
class Imu:
    stamps: np.ndarray  # (n,) [s]
    gyro: np.ndarray    # (n, 3) [rad/s]
    accel: np.ndarray   # (n, 3) [m/s^2], specific force


@dataclass
class Gps:
    stamps: np.ndarray      # (n,) [s]
    places: np.ndarray      # (n, 3) latitude, longitude [deg], height above the ellipsoid [m]
    deviations: np.ndarray  # (n, 2) horizontal, vertical [m]


@dataclass
class Pressure:
    stamps: np.ndarray  # (n,) [s]
    pascal: np.ndarray  # (n,)


@dataclass
class Recording:
    name: str
    colour: List[Frame]
    camera: Optional[Camera]                                   # of the colour (or grey) images
    depth: List[Frame] = field(default_factory=list)
    depth_camera: Optional[Camera] = None            # None: depth is registered to colour
    depth_unit: float = 0.001                        # metres per count
    float_depth_unit: float = 1.0                    # metres per unit of depth in floating point
    depth_invalid: tuple = (0, 65535)
    T_depth_colour: np.ndarray = field(default_factory=lambda: np.eye(4))
    pose_stamps: np.ndarray = field(default_factory=lambda: np.zeros(0))
    poses: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 4)))  # T_world_camera, world z up
    imu: Optional[Imu] = None
    T_imu_camera: np.ndarray = field(default_factory=lambda: np.eye(4))
    gps: Optional[Gps] = None
    pressure: Optional[Pressure] = None
    city: Optional[dict] = None                      # content of city.yaml: where world lies, and the panoramas
    geotags: List[str] = field(default_factory=list)  # lines of geotags.csv
    notes: List[str] = field(default_factory=list)


def settle_levels(recording):
    """One scale for all grey images of 16 bits, by some from all over the recording: brightness keeps its meaning from image to image."""
    frames = [frame for frame in recording.colour if os.path.isfile(frame.path)]
    if not frames or not _mode(frames[0].path).startswith('I'):
        return
    chosen = frames[::-(-len(frames) // LOOKED_AT)]
    found = pixel_range.levels(_sixteen_bits(frame.path) for frame in chosen)
    for frame in recording.colour:
        frame.levels = found
    recording.notes.append(f'images of 16 bits: counts {found.low:.0f} to {found.high:.0f} become 0 to 255, in all of them, by {len(chosen)} from all over the recording')


def settle_depth_unit(recording, config):
    """Depth in floating point is in metres, as in ROS, whatever a count is in this layout, unless --config says how many of its units are a metre."""
    if 'depth_counts_per_metre' in config:
        recording.float_depth_unit = recording.depth_unit
    elif recording.depth and _mode(recording.depth[0].path).startswith('F'):
        recording.notes.append('depth images in floating point: taken for metres; depth_counts_per_metre of --config states another unit')


def _mode(path):
    """Of Pillow: 'I...' of more than 8 bits, 'F' of floating point."""
    try:
        with Image.open(path) as image:
            return image.mode
    except (OSError, UnidentifiedImageError):
        return ''  # who reads it says why


def _counts(image):
    return np.clip(np.asarray(image), 0, 65535).astype(np.uint16)


def _sixteen_bits(path):
    """Grey in 16 bits, as counts."""
    with _opened(path) as image:
        return _counts(image)


@contextlib.contextmanager
def _opened(path):
    """DatasetError for what is none, or is cut short, as its pixels are read."""
    try:
        with Image.open(path) as image:
            yield image
    except (OSError, UnidentifiedImageError) as error:
        raise DatasetError(f'{path}: cannot be read as an image ({error})') from error


def read_image(path, depth=False, levels=None):
    """The image as an array: uint8 (h, w, 3), uint8 (h, w), or when depth uint16 (h, w) of counts, float32 (h, w) of what is stored so. levels: of grey in 16 bits; None: the image's own."""
    with _opened(path) as image:
        if depth:
            return _depth(path, image)
        if image.mode.startswith('I'):
            counts = _counts(image)
            return (levels or pixel_range.levels([counts])).grey(counts)
        if image.mode.startswith('P'):  # its pixels are places in a palette
            image = image.convert('RGB')
        array = np.asarray(image)
        if array.ndim == 3:
            return np.asarray(image.convert('RGB'))
        return array.astype(np.uint8) if array.dtype == np.uint8 else np.asarray(image.convert('L'))


def _depth(path, image):
    array = np.asarray(image)
    if array.ndim != 2:
        raise DatasetError(f'{path}: a depth image must have one channel, this has shape {array.shape}')
    if array.dtype.kind == 'f':
        return array.astype(np.float32)
    if image.mode.startswith('P') or array.dtype.itemsize == 1:
        raise DatasetError(f'{path}: depth of 8 bits ({image.mode}) is a picture of depth, no measurement: give the images that it was made of, 16-bit PNG of counts or TIFF of floats in metres')
    if array.max(initial=0) > 65535:
        raise DatasetError(f'{path}: depth of {array.max()} counts, of which 16 bits hold 65535: write it as 16-bit PNG in a unit that fits (depth_counts_per_metre of --config names it), or '
                           'as TIFF of floats in metres')
    return _counts(array)


def load_config(path):
    """The calibration file of a data set (config/datasets/*.yaml); an empty dict without one."""
    return read_mapping(path, DatasetError, 'named values as in config/datasets/redkitchen.yaml') if path else {}


def camera_from_config(section, name, size):
    try:
        return Camera(section.get('width_px', size[0]), section.get('height_px', size[1]),
                      float(section['fx_px']), float(section['fy_px']), float(section['cx_px']), float(section['cy_px']),
                      tuple(float(k) for k in section.get('distortion', [0.0] * 5)))
    except KeyError as error:
        raise DatasetError(f'{name} in the calibration file lacks {error}') from error


def orthonormal_pose(section, name):
    """4x4 transform of a section with translation_m and quaternion_xyzw."""
    try:
        return geometry.pose_from_tq(section['translation_m'], section['quaternion_xyzw'])
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f'{name}: translation_m and quaternion_xyzw are needed ({error})') from error
