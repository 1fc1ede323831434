"""Calibrations of camera and IMU as other systems write them: kalibr, OpenVINS, EuRoC, ORB-SLAM3, VINS, SVO, PTAM, Basalt, OCamCalib.

T_a_b takes b to a coordinates. Where camera files tell where the camera is in the body they all take the IMU, or the body that EuRoC's imu0 is told in, for it.
"""
import os
import re
from dataclasses import dataclass, field
from typing import Dict, Optional

import numpy as np

from . import camera_models, geometry
from .calibration import CalibratedCamera, CalibrationError, fitted, load, make_camera, numbers, rigid

KNOWN = ("camchains of kalibr and OpenVINS (cam0: ...), EuRoC's sensor.yaml, ORB-SLAM3's and VINS's settings, rpg's camera files (cameras: ..., cam_model: ...), "
         "PTAM's (Cam_fx: ...), Basalt's calibration.json, OCamCalib's calib_results.txt")
# parameters of mav_vo, densities of white noise and of the biases' random walks -> their keys in IMU files of kalibr, OpenVINS and EuRoC; of ORB-SLAM3; of Basalt.
IMU_NOISE = {'gyro_noise_density': ('gyroscope_noise_density', 'IMU.NoiseGyro', 'gyro_noise_std'),
             'accel_noise_density': ('accelerometer_noise_density', 'IMU.NoiseAcc', 'accel_noise_std'),
             'gyro_bias_walk': ('gyroscope_random_walk', 'IMU.GyroWalk', 'gyro_bias_std'),
             'accel_bias_walk': ('accelerometer_random_walk', 'IMU.AccWalk', 'accel_bias_std')}


@dataclass
class CalibratedImu:
    """noise: parameters of mav_vo."""
    noise: Dict[str, float] = field(default_factory=dict)
    topic: str = ''
    T_body_imu: Optional[np.ndarray] = None  # None: the IMU is the body


def read_camera(path, name='cam0'):
    """The CalibratedCamera `name` (cam0, ...) of a file, the only one of a file that has one; CalibrationError says what is wrong."""
    if _is_ocam(path):
        return _ocam(path, name)
    content = load(path)
    for key, reader in (('T_BS', _euroc), ('camera_model', _euroc), ('cameras', _rpg), ('cam_model', _svo), ('Cam_fx', _ptam), ('Camera1.fx', _orb_slam), ('Camera.fx', _orb_slam),
                        ('projection_parameters', _vins), ('cam0_calib', _vins), ('value0', _basalt)):
        if key in content:
            return reader(path, content, name)
    return _kalibr(path, content, name)


def read_imu(path):
    """The CalibratedImu of an IMU file: kalibr's input or output and OpenVINS's (which have a section imu0), EuRoC's sensor.yaml, ORB-SLAM3's settings."""
    content = load(path)
    section = content.get('imu0', content)
    section = section if isinstance(section, dict) else {}
    noise = _noise(section, path)
    if not noise:
        raise CalibrationError(f'{path}: none of {", ".join(keys[0] for keys in IMU_NOISE.values())}')
    topic, folder = str(section.get('rostopic', '')), os.path.basename(os.path.dirname(os.path.abspath(path)))
    if 'T_BS' not in section:
        return CalibratedImu(noise, topic)
    return CalibratedImu(noise, topic or (f'/{folder}' if re.fullmatch(r'imu\d+', folder) else ''), rigid(numbers(section, 'T_BS', path), f'{path}: T_BS'))


def _noise(section, path):
    found = {}
    for parameter, keys in IMU_NOISE.items():
        for key in (key for key in keys if key in section):
            try:
                found[parameter] = float(np.mean([float(x) for x in np.ravel(section[key])]))
            except (TypeError, ValueError) as error:
                raise CalibrationError(f'{path}: {key} must be a number ({error})') from error
            if not (np.isfinite(found[parameter]) and found[parameter] > 0):
                raise CalibrationError(f'{path}: {parameter} = {found[parameter]}: it must be positive')
    return found


def _camera(where, name, section, model, distortion, intrinsics, coefficients, size, **more):
    """A CalibratedCamera. intrinsics, coefficients, size: keys of `section`, or lists of keys, one a number."""
    def taken(keys):
        if isinstance(keys, str):
            return numbers(section, keys, where)
        return [number for key in keys for number in numbers(section, key, where)]
    if len(taken(size)) != 2:
        raise CalibrationError(f'{where}: the images\' width and height ({size if isinstance(size, str) else ", ".join(size)}) are missing')
    camera, line = make_camera(model, distortion, taken(intrinsics), taken(coefficients), [int(x) for x in taken(size)], where)
    more['notes'] = (*more.get('notes', ()), *((line,) if line else ()))
    return CalibratedCamera(name, camera, **more)


def _body_to_camera(section, key, where):
    """T_camera_body of where the camera is in the body; None without."""
    return geometry.inverse(rigid(numbers(section, key, where), f'{where}: {key}')) if key in section else None


def _mapping(section, key, where):
    """The named values under `key`; none without."""
    value = section.get(key) or {}
    if not isinstance(value, dict):
        raise CalibrationError(f'{where}: {key} must be named values, not {value!r}')
    return value


def _kalibr(path, chain, name):
    section = chain.get(name)
    if not isinstance(section, dict):
        cameras = [key for key in chain if re.fullmatch(r'cam\d+', str(key))]
        raise CalibrationError(f'{path} has no camera {name}; ' + (f'it has {", ".join(cameras)}: choose one with --camera' if cameras else f'known are {KNOWN}'))
    where = f'{path}: {name}'
    T = rigid(numbers(section, 'T_cam_imu', where), f'{where}: T_cam_imu') if 'T_cam_imu' in section else _body_to_camera(section, 'T_imu_cam', where)
    offset = numbers(section, 'timeshift_cam_imu', where)
    return _camera(where, name, section, section.get('camera_model'), section.get('distortion_model'), 'intrinsics', 'distortion_coeffs', 'resolution',
                   topic=str(section.get('rostopic', '')), T_camera_body=T, time_offset=offset[0] if offset else None)


def _euroc(path, sensor, name):
    folder = os.path.basename(os.path.dirname(os.path.abspath(path)))
    if 'intrinsics' not in sensor:
        raise CalibrationError(f'{path} is no camera\'s: name cam0/sensor.yaml first, imu0/sensor.yaml second')
    return _camera(path, name, sensor, sensor.get('camera_model'), sensor.get('distortion_model'), 'intrinsics', 'distortion_coefficients', 'resolution',
                   topic=f'/{folder}/image_raw' if re.fullmatch(r'cam\d+', folder) else '', T_camera_body=_body_to_camera(sensor, 'T_BS', path))


def _orb_slam(path, content, name):
    prefix = 'Camera1' if 'Camera1.fx' in content else 'Camera'
    kind = str(content.get('Camera.type', 'PinHole'))
    distortion = {'PinHole': 'radtan', 'Rectified': 'none', 'KannalaBrandt8': 'equidistant'}.get(kind)
    if distortion is None:
        raise CalibrationError(f'{path}: Camera.type {kind} is not known: PinHole, Rectified, KannalaBrandt8 are')
    terms = {'radtan': ('k1', 'k2', 'p1', 'p2', 'k3'), 'equidistant': ('k1', 'k2', 'k3', 'k4'), 'none': ()}[distortion]
    return _camera(path, name, content, 'pinhole', distortion, [f'{prefix}.{x}' for x in ('fx', 'fy', 'cx', 'cy')], [f'{prefix}.{x}' for x in terms],
                   ['Camera.width', 'Camera.height'], T_camera_body=_body_to_camera(content, 'IMU.T_b_c1' if 'IMU.T_b_c1' in content else 'Tbc', path), noise=_noise(content, path))


def _vins(path, content, name):
    """VINS-Mono's file, or VINS-Fusion's, which names that of each camera."""
    if 'projection_parameters' not in content:
        part = load(os.path.join(os.path.dirname(os.path.abspath(path)), str(content.get(f'{name}_calib', f'{name}_calib'))))
        content = {**content, **part}
    flat = {}
    for part in ('projection_parameters', 'distortion_parameters', 'mirror_parameters'):
        flat.update(_mapping(content, part, path))
    flat.update({key: content[key] for key in ('image_width', 'image_height') if key in content})
    kind, size = str(content.get('model_type')).upper(), ['image_width', 'image_height']
    T, notes = None, ()
    if content.get('estimate_extrinsic') != 2:  # else they are a guess, or nothing
        pose = f'body_T_{name}'
        if 'extrinsicRotation' in content:
            R, t = numbers(content, 'extrinsicRotation', path), numbers(content, 'extrinsicTranslation', path)
            if len(R) != 9 or len(t) != 3:
                raise CalibrationError(f'{path}: extrinsicRotation needs 9 numbers, extrinsicTranslation 3')
            T = geometry.inverse(rigid(geometry.pose(np.reshape(R, (3, 3)), t), f'{path}: extrinsicRotation'))
        else:
            T = _body_to_camera(content, pose, path)
    if 'acc_n' in content:
        notes += ("VINS's noise of the IMU (acc_n, gyr_n, ...) is tuned for its filter and not taken: name an IMU file, or have mav_vo's defaults",)
    offset = numbers(content, 'td', path)
    more = {'topic': str(content.get('image_topic' if 'image_topic' in content else f'image{name[3:]}_topic', '')), 'imu_topic': str(content.get('imu_topic', '')), 'T_camera_body': T,
            'time_offset': offset[0] if offset else None, 'notes': notes}
    if kind == 'PINHOLE':
        return _camera(path, name, flat, 'pinhole', 'radtan', ['fx', 'fy', 'cx', 'cy'], ['k1', 'k2', 'p1', 'p2'], size, **more)
    if kind == 'MEI':
        return _camera(path, name, flat, 'omni', 'radtan', ['xi', 'gamma1', 'gamma2', 'u0', 'v0'], ['k1', 'k2', 'p1', 'p2'], size, **more)
    if kind == 'KANNALA_BRANDT':
        return _camera(path, name, flat, 'pinhole', 'equidistant', ['mu', 'mv', 'u0', 'v0'], ['k2', 'k3', 'k4', 'k5'], size, **more)
    raise CalibrationError(f'{path}: model_type {kind} is not known: PINHOLE, MEI, KANNALA_BRANDT are; of OCamCalib name its calib_results.txt')


def _rpg(path, content, name):
    """The camera files of rpg's SVO Pro and vikit, in which "fisheye" is ATAN (Devernay & Faugeras 2001)."""
    try:
        entry = content['cameras'][int(name[3:])]
        camera, distortion = entry['camera'], _mapping(entry['camera'], 'distortion', f'{path}: {name}')
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise CalibrationError(f'{path}: cameras holds no {name} ({error})') from error
    if camera.get('type') != 'pinhole':
        raise CalibrationError(f'{path}: {name} has the type {camera.get("type")}; pinhole is known; of OCamCalib name its calib_results.txt')
    flat = {**camera, 'coefficients': distortion.get('parameters')}
    return _camera(f'{path}: {name}', name, flat, 'pinhole', distortion.get('type'), 'intrinsics', 'coefficients', ['image_width', 'image_height'],
                   T_camera_body=_body_to_camera(entry, 'T_B_C', path))


def _svo(path, content, name):
    """SVO's: that of ATAN is PTAM's."""
    kind = str(content['cam_model']).lower()
    keys = [f'cam_{x}' for x in ('fx', 'fy', 'cx', 'cy')]
    if kind == 'atan':
        return _atan(path, content, name, keys, 'cam_d0', ['cam_width', 'cam_height'])
    if kind != 'pinhole':
        raise CalibrationError(f'{path}: cam_model {content["cam_model"]} is not known: Pinhole and ATAN are; of OCamCalib name its calib_results.txt')
    return _camera(path, name, content, 'pinhole', 'radtan', keys, [f'cam_d{i}' for i in range(4)], ['cam_width', 'cam_height'])


def _ptam(path, content, name):
    return _atan(path, content, name, [f'Cam_{x}' for x in ('fx', 'fy', 'cx', 'cy')], 'Cam_s', ['ImageSizeX', 'ImageSizeY'])


def _atan(path, content, name, keys, w, size):
    """Focal lengths and centre in parts of the image, whose first pixel begins at 0 (Klein & Murray 2007)."""
    parts, extent = [numbers(content, key, path) for key in keys], [numbers(content, key, path) for key in size]
    if not all(len(x) == 1 for x in parts + extent):
        raise CalibrationError(f'{path}: {", ".join(keys + size)} are needed, a number each')
    width, height = (x[0] for x in extent)
    flat = {**content, 'intrinsics': np.array(parts).ravel() * [width, height, width, height] - [0, 0, 0.5, 0.5]}
    return _camera(path, name, flat, 'pinhole', 'fov', 'intrinsics', w, size)


def _basalt(path, content, name):
    try:
        value, index = content['value0'], int(name[3:])
        entry, size = value['intrinsics'][index], value['resolution'][index]
        p = value['T_imu_cam'][index] if 'T_imu_cam' in value else None
        T = None if p is None else geometry.inverse(geometry.pose_from_tq([p['px'], p['py'], p['pz']], [p['qx'], p['qy'], p['qz'], p['qw']]))
        kind, flat = str(entry['camera_type']), {**entry['intrinsics'], 'size': size}
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise CalibrationError(f'{path}: value0 holds no whole {name} (intrinsics, resolution, T_imu_cam): {error}') from error
    centre = ['fx', 'fy', 'cx', 'cy']
    keys, terms, model = {'pinhole': (centre, [], 'pinhole'), 'kb4': (centre, ['k1', 'k2', 'k3', 'k4'], 'pinhole'), 'ds': (['xi', 'alpha', *centre], [], 'ds'),
                          'eucm': (['alpha', 'beta', *centre], [], 'eucm'), 'ucm': (['alpha', *centre], [], 'ucm'), 'fov': (centre, ['w'], 'pinhole')}.get(kind, ([], [], kind))
    notes = ('cam_time_offset_ns is not taken: mav_vo finds it, or set time_offset',) if value.get('cam_time_offset_ns') else ()
    return _camera(f'{path}: {name}', name, flat, model, {'kb4': 'equidistant', 'fov': 'fov'}.get(kind, 'none'), keys, terms, 'size', T_camera_body=T, noise=_noise(value, path),
                   notes=notes)


# ---- OCamCalib --------------------------------------------------------------------------------------------------------

def _is_ocam(path):
    try:
        with open(path, encoding='utf-8', errors='replace') as stream:
            return 'polynomial coefficients' in stream.readline()
    except OSError:
        return False  # load() says why


def _ocam(path, name):
    """calib_results.txt (Scaramuzza, Martinelli & Siegwart 2006): the ray of a pixel is (A^-1 (row - xc, column - yc), f(rho)), rho its distance from the centre.

    Its first axis is down, its second to the right, and its third points back at the camera: f is negative.
    """
    with open(path, encoding='utf-8', errors='replace') as stream:
        lines = [line.split() for line in stream if line.strip() and not line.startswith('#')]
    try:
        direct, _, centre, affine, size = ([float(x) for x in line] for line in lines[:5])
        polynomial, (xc, yc), (c, d, e), (height, width) = direct[1:1 + int(direct[0])], centre, affine, (int(x) for x in size)
    except ValueError as error:
        raise CalibrationError(f'{path}: not a calib_results.txt of OCamCalib, which holds two polynomials, centre, affine parameters and image size ({error})') from error
    u, v = np.meshgrid(np.linspace(0, width - 1, 60), np.linspace(0, height - 1, 60))
    pixels = np.stack([u.ravel(), v.ravel()], 1)
    flat = np.linalg.solve(np.array([[c, d], [e, 1.0]]), np.stack([pixels[:, 1] - xc, pixels[:, 0] - yc]))
    rays = np.stack([flat[1], flat[0], -np.polynomial.polynomial.polyval(np.linalg.norm(flat, axis=0), polynomial)], 1)
    ahead = np.arctan2(np.linalg.norm(rays[:, :2], axis=1), rays[:, 2]) <= camera_models.LARGEST_ANGLE
    try:
        camera, line = fitted(rays[ahead], pixels[ahead], (width, height), yc, xc, 'OCamCalib\'s model')
    except camera_models.FitError as error:
        raise CalibrationError(f'{path}: {error}') from error
    return CalibratedCamera(name, camera, notes=(line,))
