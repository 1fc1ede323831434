"""Calibrations: kalibr's files read, ROS camera_info files written and read, parameter files filled in. Free of ROS nodes."""
import re
from dataclasses import dataclass
from typing import Optional

import numpy as np
import yaml
from sensor_msgs.msg import CameraInfo

from . import geometry
from .recording import Camera, DatasetError
from .yaml_file import read_mapping

MODELS = {'radtan': 'plumb_bob', 'none': 'plumb_bob', 'equidistant': 'equidistant'}  # of kalibr's pinhole -> of camera_info
COEFFICIENTS = {'plumb_bob': 5, 'equidistant': 4, 'rational_polynomial': 8}
# Keys of kalibr's IMU files -> parameters of mav_vo; both are densities of white noise, and of the biases' random walks.
IMU_NOISE = {'gyroscope_noise_density': 'gyro_noise_density', 'accelerometer_noise_density': 'accel_noise_density',
             'gyroscope_random_walk': 'gyro_bias_walk', 'accelerometer_random_walk': 'accel_bias_walk'}


class CalibrationError(Exception):
    """One line: file, and what is wrong with it."""


@dataclass
class KalibrCamera:
    """A camera of a camchain. T_camera_imu takes IMU to camera coordinates; t_imu = t_camera + time_offset, of one instant on both clocks [s]."""
    name: str
    camera: Camera
    topic: str = ''
    T_camera_imu: Optional[np.ndarray] = None
    time_offset: Optional[float] = None


def load(path):
    return read_mapping(path, CalibrationError, 'named values')


def read_kalibr_camera(path, name):
    """Camera `name` (cam0, ...) of kalibr's camchain; CalibrationError for a model that no node knows."""
    chain = load(path)
    section = chain.get(name)
    if not isinstance(section, dict):
        raise CalibrationError(f'{path} has no camera {name}; it has {", ".join(k for k in chain if str(k).startswith("cam")) or "none"}')
    model, distortion = section.get('camera_model'), section.get('distortion_model')
    if model != 'pinhole':
        raise CalibrationError(f'{path}: {name} has the camera model {model}; known is pinhole: calibrate as pinhole-equi for wide lenses')
    if distortion not in MODELS:
        raise CalibrationError(f'{path}: {name} has the distortion model {distortion}; known are radtan and equidistant')
    try:
        fx, fy, cx, cy = (float(x) for x in section['intrinsics'])
        width, height = (int(x) for x in section['resolution'])
        coefficients = [float(x) for x in section.get('distortion_coeffs') or []]
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f'{path}: {name} needs intrinsics [fx, fy, cx, cy], resolution [width, height], distortion_coeffs ({error})') from error
    count = COEFFICIENTS[MODELS[distortion]]
    try:
        camera = Camera(width, height, fx, fy, cx, cy, tuple((coefficients + [0.0] * count)[:count]), MODELS[distortion])
    except DatasetError as error:
        raise CalibrationError(f'{path}: {name}: {error}') from error
    result = KalibrCamera(name, camera, str(section.get('rostopic', '')))
    if 'T_cam_imu' in section:
        result.T_camera_imu = rigid(section['T_cam_imu'], f'{path}: {name}: T_cam_imu')
    if 'timeshift_cam_imu' in section:
        result.time_offset = float(section['timeshift_cam_imu'])
    return result


def rigid(rows, name):
    """A 4x4 rigid transform, its rounding removed."""
    try:
        matrix = np.array(rows, float).reshape(4, 4)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f'{name}: expected a 4x4 matrix') from error
    if not geometry.is_rigid(matrix, 1e-3) or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise CalibrationError(f'{name} is no rigid transform')
    return geometry.orthonormalized(matrix)


def read_kalibr_imu(path):
    """(parameters of mav_vo, topic) of an IMU file, kalibr's input or output (which has a section imu0)."""
    content = load(path)
    section = content.get('imu0', content)
    found = {parameter: float(section[key]) for key, parameter in IMU_NOISE.items() if key in section}
    if not found:
        raise CalibrationError(f'{path}: none of {", ".join(IMU_NOISE)}')
    for parameter, value in found.items():
        if not (np.isfinite(value) and value > 0):
            raise CalibrationError(f'{path}: {parameter} = {value}: it must be positive')
    return found, str(section.get('rostopic', ''))


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
        info.R = [float(x) for x in content.get('rectification_matrix', {}).get('data', np.eye(3).ravel())]
        info.P = [float(x) for x in content.get('projection_matrix', {}).get('data', [info.K[0], 0, info.K[2], 0, 0, info.K[4], info.K[5], 0, 0, 0, 1, 0])]
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f'{path}: not a camera_info file (camera_calibration writes one): {error}') from error
    if len(info.K) != 9 or len(info.R) != 9 or len(info.P) != 12:
        raise CalibrationError(f'{path}: camera_matrix needs 9 numbers, rectification_matrix 9, projection_matrix 12')
    return info


def filled_in(text, values, source):
    """The parameter file `text` with these values, its comments kept; and the names that it does not describe."""
    unknown = []
    for name, value in values.items():
        number = re.sub(r'^(-?\d+)e', r'\1.0e', f'{value:.6g}')  # YAML 1.1 takes 1e-05 for a word
        text, count = re.subn(rf'^#? ?({re.escape(name)}:)[ ]*\S+', lambda match: f'{match.group(1)} {number}', text, count=1, flags=re.M)
        if not count:
            unknown.append(name)
    return f'# With the values of {source}: {", ".join(n for n in values if n not in unknown)}.\n{text}', unknown
