"""Calibrations: what is known of a camera and an IMU, ROS camera_info files written and read, parameter files filled in. Free of ROS nodes."""
import re
from dataclasses import dataclass, field
from typing import Dict, Optional

import numpy as np
import yaml
from sensor_msgs.msg import CameraInfo

from . import camera_models, geometry
from .recording import Camera, DatasetError
from .yaml_file import read_mapping

# Distortions by the names that other systems have for them -> of camera_info.
DISTORTIONS = {'radtan': 'plumb_bob', 'radial-tangential': 'plumb_bob', 'radial_tangential': 'plumb_bob', 'plumb_bob': 'plumb_bob', 'none': 'plumb_bob', '': 'plumb_bob',
               'equidistant': 'equidistant', 'equi': 'equidistant', 'kannala_brandt': 'equidistant', 'fov': 'fov', 'atan': 'fov', 'fisheye': 'fov'}
MODELS = {'pinhole': 4, 'omni': 5, 'ds': 6, 'eucm': 6, 'ucm': 5}  # camera models: numbers in `intrinsics`, in kalibr's order
COEFFICIENTS = {'plumb_bob': 5, 'equidistant': 4, 'rational_polynomial': 8}


class CalibrationError(Exception):
    """One line: file, and what is wrong with it."""


@dataclass
class CalibratedCamera:
    """T_camera_body takes body (the IMU, where the file does not tell them apart) to camera coordinates; t_imu = t_camera + time_offset, of one instant on both
    clocks [s]. noise: parameters of mav_vo, where the camera's file has the IMU's, too. notes: lines for the user."""
    name: str
    camera: Camera
    topic: str = ''
    T_camera_body: Optional[np.ndarray] = None
    time_offset: Optional[float] = None
    noise: Dict[str, float] = field(default_factory=dict)
    imu_topic: str = ''
    notes: tuple = ()


def load(path):
    return read_mapping(path, CalibrationError, 'named values')


def make_camera(model, distortion, intrinsics, coefficients, size, where):
    """(Camera, a line about how its model was found or None) of kalibr's intrinsics and distortion coefficients; `where` names them in errors.

    Models that camera_info has no name for become `equidistant`, as near as camera_models.fit_equidistant comes.
    """
    kind = DISTORTIONS.get(str(distortion or '').lower())
    if not isinstance(model, str) or model not in MODELS:
        raise CalibrationError(f'{where} has the camera model {model}; known are {", ".join(MODELS)}: calibrate as pinhole-equi for wide lenses')
    if kind is None:
        raise CalibrationError(f'{where} has the distortion model {distortion}; known are radtan, equidistant and fov')
    if model != 'pinhole' and kind != 'plumb_bob' or model in ('ds', 'eucm', 'ucm') and any(coefficients):
        raise CalibrationError(f'{where} has the camera model {model} with the distortion {distortion}: no such combination is known')
    if len(intrinsics) != MODELS[model] or len(size) != 2:
        raise CalibrationError(f'{where}: {model} needs {MODELS[model]} intrinsics (found {len(intrinsics)}) and the images\' width and height')
    fx, fy, cx, cy = intrinsics[-4:]
    try:
        if model == 'pinhole' and kind in COEFFICIENTS:
            count = COEFFICIENTS[kind]
            return Camera(*size, fx, fy, cx, cy, tuple((list(coefficients) + [0.0] * count)[:count]), kind), None
        if kind == 'fov' and (len(coefficients) != 1 or not 1e-3 < coefficients[0] < 3.1):
            raise CalibrationError(f'{where}: fov needs one coefficient, w, in radians')
        project = {'pinhole': lambda: camera_models.fov(intrinsics, coefficients[0]), 'omni': lambda: camera_models.omni(intrinsics[1:], intrinsics[0], coefficients),
                   'ds': lambda: camera_models.double_sphere(intrinsics[2:], *intrinsics[:2]), 'ucm': lambda: camera_models.extended_unified(intrinsics[1:], intrinsics[0], 1.0),
                   'eucm': lambda: camera_models.extended_unified(intrinsics[2:], *intrinsics[:2])}[model]()
        return fitted(*camera_models.seen_by(project, *size), size, cx, cy, 'fov' if kind == 'fov' else model)
    except (DatasetError, camera_models.FitError) as error:
        raise CalibrationError(f'{where}: {error}') from error


def fitted(rays, pixels, size, cx, cy, name):
    """The equidistant (Camera, line about the fit) to where a camera of the model `name` shows rays."""
    fit = camera_models.fit_equidistant(rays, pixels, cx, cy)
    return (Camera(*size, fit.fx, fit.fy, cx, cy, fit.coefficients, 'equidistant'),
            f'{name} became equidistant: the two differ by {fit.residual:.3f} px at most, up to {np.degrees(fit.angle):.0f} degrees from the axis')


def numbers(section, key, where):
    """The list of numbers under `key`, be it OpenCV's matrix or a plain list; none without."""
    value = section.get(key)
    value = value.get('data') if isinstance(value, dict) else value
    try:
        found = [float(x) for x in np.array([] if value is None else value, dtype=object).ravel()]
    except (TypeError, ValueError) as error:
        raise CalibrationError(f'{where}: {key} must be numbers ({error})') from error
    if not np.all(np.isfinite(found)):
        raise CalibrationError(f'{where}: {key} must be finite')
    return found


def rigid(rows, name):
    """A 4x4 rigid transform, its rounding removed."""
    try:
        matrix = np.array(rows, float).reshape(4, 4)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f'{name}: expected a 4x4 matrix') from error
    if not geometry.is_rigid(matrix, 1e-3) or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise CalibrationError(f'{name} is no rigid transform')
    return geometry.orthonormalized(matrix)


def camera_info_yaml(camera, name):
    """Text of a camera_info file as camera_calibration writes it."""
    def matrix(rows, columns, data):
        return {'rows': rows, 'cols': columns, 'data': [float(x) for x in data]}
    return yaml.safe_dump({
        'image_width': camera.width, 'image_height': camera.height, 'camera_name': name,
        'camera_matrix': matrix(3, 3, [camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1]),
        'distortion_model': camera.model, 'distortion_coefficients': matrix(1, len(camera.distortion), camera.distortion),
        'rectification_matrix': matrix(3, 3, np.eye(3).ravel()),
        'projection_matrix': matrix(3, 4, [camera.fx, 0, camera.cx, 0, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0])}, sort_keys=False, default_flow_style=None, width=120)


def read_camera_info(path):
    """sensor_msgs/CameraInfo of a camera_info file."""
    content = load(path)
    try:
        info = CameraInfo(width=int(content['image_width']), height=int(content['image_height']), distortion_model=content['distortion_model'])
        info.D = [float(x) for x in content['distortion_coefficients']['data']]
        info.K = [float(x) for x in content['camera_matrix']['data']]
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f'{path}: not a camera_info file (camera_calibration writes one): {error}') from error
    info.R = numbers(content, 'rectification_matrix', path) or [float(x) for x in np.eye(3).ravel()]
    info.P = numbers(content, 'projection_matrix', path) or [x for row in range(3) for x in (*info.K[3 * row:3 * row + 3], 0.0)]
    if len(info.K) != 9 or len(info.R) != 9 or len(info.P) != 12:
        raise CalibrationError(f'{path}: camera_matrix needs 9 numbers, rectification_matrix 9, projection_matrix 12')
    return info


def filled_in(text, values, source):
    """The parameter file `text` with these values (numbers and words), its comments kept; and the names that it does not describe."""
    unknown = []
    for name, value in values.items():
        # YAML 1.1 takes 1e-05 for a word.
        number = f'"{value}"' if isinstance(value, str) else re.sub(r'^(-?\d+)e', r'\1.0e', f'{value:.6g}')
        text, count = re.subn(rf'^#? ?({re.escape(name)}:)[ ]*\S+', lambda match: f'{match.group(1)} {number}', text, count=1, flags=re.M)
        if not count:
            unknown.append(name)
    return f'# With the values of {source}: {", ".join(n for n in values if n not in unknown)}.\n{text}', unknown
