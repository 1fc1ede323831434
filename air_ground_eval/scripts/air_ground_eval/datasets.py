"""Readers of recordings in the folder layouts of 7-Scenes, TUM RGB-D and EuRoC MAV (Zurich Urban MAV: zurich_urban.py).

Each reader returns a Recording with every number in metres, seconds and radians. A folder that does not hold what its
layout asks for raises DatasetError, whose message names the file and what was expected.
"""
import csv
import glob
import os
import re

import numpy as np

from . import geometry, zurich_urban
from .recording import Camera, DatasetError, Frame, Imu, Recording, camera_from_config, orthonormal_pose, read_image
from .yaml_file import read_mapping


def detect_layout(folder):
    """'7scenes', 'tum', 'euroc' or 'agz', from the files in the folder."""
    if not os.path.isdir(folder):
        raise DatasetError(f'{folder}: no such folder')
    if glob.glob(os.path.join(folder, 'frame-*.color.*')):
        return '7scenes'
    if os.path.isfile(os.path.join(folder, 'rgb.txt')):
        return 'tum'
    if os.path.isdir(os.path.join(euroc_root(folder), 'cam0')):
        return 'euroc'
    if zurich_urban.log_folder(folder):
        return 'agz'
    raise DatasetError(f'{folder}: none of the known layouts: 7-Scenes (frame-000000.color.*), TUM RGB-D (rgb.txt), '
                       'EuRoC MAV (cam0/ or mav0/cam0/), Zurich Urban MAV (Log Files/RawAccel.csv)')


def read_recording(folder, layout, config):
    readers = {'7scenes': read_7scenes, 'tum': read_tum, 'euroc': read_euroc, 'agz': zurich_urban.read_zurich_urban}
    if layout == 'auto':
        layout = detect_layout(folder)
    elif not os.path.isdir(folder):
        raise DatasetError(f'{folder}: no such folder')
    recording = readers[layout](folder, config)
    if not recording.colour and layout != 'agz':
        raise DatasetError(f'{folder}: no images found')
    stamps = np.array([f.stamp for f in recording.colour])
    if np.any(np.diff(stamps) <= 0):
        raise DatasetError(f'{folder}: image stamps do not increase at image {int(np.argmax(np.diff(stamps) <= 0)) + 1}')
    return recording


# ---- 7-Scenes ---------------------------------------------------------------------------------------------------------

def read_7scenes(folder, config):
    """frame-N.color.{png,jpg}, frame-N.depth.png [mm], frame-N.pose.txt (camera to world); stamps from frame_rate_hz."""
    rate = float(config.get('frame_rate_hz', 30.0))
    if not rate > 0:
        raise DatasetError(f'frame_rate_hz = {rate}: it must be positive')
    colour, depth, stamps, poses = [], [], [], []
    for path in sorted(glob.glob(os.path.join(folder, 'frame-*.color.*'))):
        match = re.search(r'frame-(\d+)\.color\.', path)
        if not match:
            continue
        stem, index = os.path.join(folder, 'frame-' + match.group(1)), int(match.group(1))
        colour.append(Frame(index / rate, path))
        if os.path.isfile(stem + '.depth.png'):
            depth.append(Frame(index / rate, stem + '.depth.png'))
        if os.path.isfile(stem + '.pose.txt'):
            try:
                transform = np.loadtxt(stem + '.pose.txt')
            except ValueError as error:
                raise DatasetError(f'{stem}.pose.txt: {error}') from error
            if transform.shape != (4, 4):
                raise DatasetError(f'{stem}.pose.txt: expected a 4x4 matrix, found {transform.shape}')
            if np.all(np.isfinite(transform)):
                stamps.append(index / rate)
                poses.append(geometry.orthonormalized(transform))
    if not colour:
        raise DatasetError(f'{folder}: no frame-*.color.* images')
    size = read_image(colour[0].path).shape[1::-1]

    default = {'fx_px': 585.0, 'fy_px': 585.0, 'cx_px': 320.0, 'cy_px': 240.0}
    notes = []
    if 'colour_camera' not in config:
        notes.append('no calibration file: colour taken as registered with depth at f = 585 px (7-Scenes\' own advice); '
                     'see config/datasets/redkitchen.yaml for a measured calibration')
    depth_camera = camera_from_config(config.get('depth_camera', default), 'depth_camera', size)
    camera = camera_from_config(config.get('colour_camera', default), 'colour_camera', size)
    T_depth_colour = np.eye(4)
    if 'depth_from_colour' in config:
        T_depth_colour = orthonormal_pose(config['depth_from_colour'], 'depth_from_colour')
    recording = Recording(os.path.basename(os.path.normpath(folder)), colour, camera, depth, depth_camera,
                          T_depth_colour=T_depth_colour, notes=notes)
    if poses:
        up = None
        gravity_file = os.path.join(folder, 'gravity-direction.txt')
        if 'gravity_direction' in config:
            up = -np.array(config['gravity_direction'], float)
        elif os.path.isfile(gravity_file):
            up = -np.loadtxt(gravity_file).reshape(-1)
        level = np.eye(4)
        if up is None:
            recording.notes.append('no gravity direction: the reference frame is taken as z up')
        else:
            if up.shape != (3,):
                raise DatasetError(f'{gravity_file}: expected three numbers')
            level[:3, :3] = geometry.leveling_rotation(up)
        # The reference poses are those of the depth camera.
        recording.pose_stamps = np.array(stamps)
        recording.poses = np.array([level @ pose @ T_depth_colour for pose in poses])
    return recording


# ---- TUM RGB-D --------------------------------------------------------------------------------------------------------

def read_tum_list(folder, name):
    path = os.path.join(folder, name)
    if not os.path.isfile(path):
        raise DatasetError(f'{path}: missing; a TUM RGB-D folder has rgb.txt, depth.txt and groundtruth.txt')
    frames = []
    with open(path, encoding='utf-8') as stream:
        for number, line in enumerate(stream, 1):
            words = line.split()
            if not words or words[0].startswith('#'):
                continue
            try:
                frames.append(Frame(float(words[0]), os.path.join(folder, words[1])))
            except (ValueError, IndexError) as error:
                raise DatasetError(f'{path}:{number}: expected "stamp file"') from error
    return frames


def read_tum(folder, config):
    """rgb.txt, depth.txt (5000 counts a metre, registered to colour), groundtruth.txt (TUM format, world z up)."""
    colour, depth = read_tum_list(folder, 'rgb.txt'), read_tum_list(folder, 'depth.txt')
    if not colour:
        raise DatasetError(f'{folder}/rgb.txt lists no images')
    size = read_image(colour[0].path).shape[1::-1]
    notes = []
    if 'colour_camera' in config:
        camera = camera_from_config(config['colour_camera'], 'colour_camera', size)
    else:
        camera = Camera(size[0], size[1], 525.0, 525.0, 319.5, 239.5)
        notes.append('no calibration file: the ROS default of TUM RGB-D (f = 525 px) is used')
    recording = Recording(os.path.basename(os.path.normpath(folder)), colour, camera, depth, None,
                          depth_unit=1.0 / float(config.get('depth_counts_per_metre', 5000.0)), depth_invalid=(0,), notes=notes)
    truth = os.path.join(folder, 'groundtruth.txt')
    if os.path.isfile(truth):
        rows = []
        with open(truth, encoding='utf-8') as stream:
            for number, line in enumerate(stream, 1):
                if line.strip() and not line.startswith('#'):
                    values = line.split()
                    try:
                        rows.append([float(v) for v in values[:8]])
                        assert len(rows[-1]) == 8
                    except (ValueError, AssertionError) as error:
                        raise DatasetError(f'{truth}:{number}: expected "stamp tx ty tz qx qy qz qw"') from error
        rows = np.array(rows)
        if len(rows):
            recording.pose_stamps, recording.poses = unique_poses(rows[:, 0], rows[:, 1:4], rows[:, 4:8], truth)
    return recording


def unique_poses(stamps, positions, quaternions, source):
    """Stamped poses in increasing order, without repeated stamps."""
    order = np.argsort(stamps, kind='stable')
    order = order[np.concatenate([[True], np.diff(stamps[order]) > 0])]
    try:
        rotations = geometry.matrix_from_quaternion(quaternions[order])
    except ValueError as error:
        raise DatasetError(f'{source}: {error}') from error
    poses = np.tile(np.eye(4), (len(order), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = positions[order]
    return stamps[order], poses


# ---- EuRoC MAV --------------------------------------------------------------------------------------------------------

def euroc_root(folder):
    inner = os.path.join(folder, 'mav0')
    return inner if os.path.isdir(inner) else folder


def read_euroc_sensor(path):
    """A sensor.yaml."""
    if not os.path.isfile(path):
        raise DatasetError(f'{path}: missing; a EuRoC folder has cam0/sensor.yaml, cam0/data and imu0/data.csv')
    sensor = read_mapping(path, DatasetError, 'a EuRoC sensor description')
    try:
        transform = np.array(sensor['T_BS']['data'], float).reshape(4, 4)
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f'{path}: not a EuRoC sensor description ({error})') from error
    if not geometry.is_rigid(transform, 1e-2):
        raise DatasetError(f'{path}: the upper left 3x3 of T_BS is no rotation')
    return sensor, geometry.orthonormalized(transform)


def read_csv(path, columns):
    rows = []
    with open(path, newline='', encoding='utf-8') as stream:
        for number, row in enumerate(csv.reader(stream), 1):
            if not row or row[0].strip().startswith('#'):
                continue
            try:
                rows.append([int(row[0]) * 1e-9] + [float(v) for v in row[1:columns]])
            except ValueError as error:
                raise DatasetError(f'{path}:{number}: {error}') from error
            if len(rows[-1]) != columns:
                raise DatasetError(f'{path}:{number}: expected {columns} columns')
    if not rows:
        raise DatasetError(f'{path}: no data rows')
    return np.array(rows)


def read_euroc_frames(root, notes):
    """Images that cam0/data.csv names (stamp [ns], file in cam0/data or relative to cam0); without it those in cam0/data named by their stamp."""
    camera = os.path.join(root, 'cam0')
    path, frames, missing = os.path.join(camera, 'data.csv'), [], []
    if not os.path.isfile(path):
        for image in sorted(glob.glob(os.path.join(camera, 'data', '*'))):
            stem, extension = os.path.splitext(os.path.basename(image))
            if extension.lower() not in ('.png', '.jpg', '.jpeg', '.bmp', '.tif', '.tiff', '.pgm'):
                continue
            if not stem.isdigit():
                raise DatasetError(f'{image}: without cam0/data.csv images are named by their stamp in nanoseconds')
            frames.append(Frame(int(stem) * 1e-9, image))
        return frames
    with open(path, newline='', encoding='utf-8') as stream:
        for number, row in enumerate(csv.reader(stream), 1):
            if not row or row[0].strip().startswith('#'):
                continue
            try:
                stamp, name = int(row[0]) * 1e-9, row[1].strip()
            except (ValueError, IndexError) as error:
                raise DatasetError(f'{path}:{number}: expected "stamp [ns],file"') from error
            found = [p for p in (os.path.join(camera, 'data', name), os.path.join(camera, name)) if os.path.isfile(p)]
            if found:
                frames.append(Frame(stamp, found[0]))
            else:
                missing.append(name)
    if missing:
        text = f'{len(missing)} of {len(missing) + len(frames)} images named in {path} are missing (the first: {missing[0]})'
        if not frames:
            raise DatasetError(text)
        notes.append(text)
    return sorted(frames, key=lambda frame: frame.stamp)


EUROC_MODELS = {'radial-tangential': 'plumb_bob', 'radtan': 'plumb_bob', 'plumb_bob': 'plumb_bob', 'equidistant': 'equidistant'}


def read_euroc(folder, config):
    """cam0 (the images of its data.csv), imu0, and a ground truth csv (state_groundtruth_estimate0 or groundtruth*)."""
    root = euroc_root(folder)
    sensor, T_body_camera = read_euroc_sensor(os.path.join(root, 'cam0', 'sensor.yaml'))
    notes = []
    frames = read_euroc_frames(root, notes)
    try:
        fx, fy, cx, cy = (float(v) for v in sensor['intrinsics'])
        distortion = [float(v) for v in sensor['distortion_coefficients']]
        width, height = (int(v) for v in sensor['resolution'])
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f'{root}/cam0/sensor.yaml: intrinsics, distortion_coefficients, resolution needed ({error})') from error
    model = EUROC_MODELS.get(sensor.get('distortion_model'))
    if model is None:
        raise DatasetError(f'{root}/cam0/sensor.yaml: distortion model {sensor.get("distortion_model")} is not supported; '
                           'undistort the images first')
    camera = Camera(width, height, fx, fy, cx, cy, tuple((distortion + [0.0] * 5)[:5 if model == 'plumb_bob' else 4]), model)
    recording = Recording(os.path.basename(os.path.normpath(folder)), frames, camera, notes=notes)

    imu_file = os.path.join(root, 'imu0', 'data.csv')
    if os.path.isfile(imu_file):
        _, T_body_imu = read_euroc_sensor(os.path.join(root, 'imu0', 'sensor.yaml'))
        rows = read_csv(imu_file, 7)
        recording.imu = Imu(rows[:, 0], rows[:, 1:4], rows[:, 4:7])
        recording.T_imu_camera = geometry.inverse(T_body_imu) @ T_body_camera
    candidates = [os.path.join(root, 'state_groundtruth_estimate0', 'data.csv')] + sorted(
        glob.glob(os.path.join(root, 'groundtruth*.csv')))
    for path in candidates:
        if os.path.isfile(path):
            rows = read_csv(path, 8)  # stamp, p, q as w x y z
            recording.pose_stamps, poses = unique_poses(rows[:, 0], rows[:, 1:4], rows[:, [5, 6, 7, 4]], path)
            recording.poses = poses @ T_body_camera
            break
    return recording
