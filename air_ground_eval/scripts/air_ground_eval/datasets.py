"""Readers of recordings in the folder layouts of 7-Scenes, TUM RGB-D, EuRoC MAV and TUM-VI (numbered images: numbered.py; Zurich Urban MAV: zurich_urban.py).

Each reader returns a Recording with every number in metres, seconds and radians, and what is up in the frame of its reference poses.
A folder that does not hold what its layout asks for raises DatasetError, whose message names the file and what was expected.
"""
import csv
import glob
import os
import re

import numpy as np

from . import calibration, calibration_files, geometry, numbered, reference_poses, rgbd_cameras, zurich_urban
from .reference_poses import unique_poses
from .recording import Camera, DatasetError, Frame, Imu, Recording, settle_depth_unit, settle_levels
from .yaml_file import read_mapping

Z_UP = np.array([0.0, 0.0, 1.0])


def detect_layout(folder):
    """'7scenes', 'tum', 'euroc', 'agz' or 'numbered', from the files in the folder."""
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
    if numbered.is_numbered(folder):
        return 'numbered'
    raise DatasetError(f'{folder}: none of the known layouts: 7-Scenes and ScanNet\'s SensReader (frame-000000.color.*), TUM RGB-D (rgb.txt), '
                       'EuRoC MAV (cam0/ or mav0/cam0/), Zurich Urban MAV (Log Files/RawAccel.csv), numbered images (rgb/ or color/, and depth/)')


def read_recording(folder, layout, config, R_base_camera=geometry.R_BODY_FORWARD_CAMERA):
    """The Recording, its world level. R_base_camera, how the camera is carried, tells what is up where nothing states it."""
    readers = {'7scenes': read_7scenes, 'tum': read_tum, 'euroc': read_euroc, 'numbered': numbered.read_numbered,
               'agz': lambda folder, config: (zurich_urban.read_zurich_urban(folder, config), Z_UP, False)}
    if layout == 'auto':
        layout = detect_layout(folder)
    elif not os.path.isdir(folder):
        raise DatasetError(f'{folder}: no such folder')
    elif layout not in list(readers):  # of --config, where anything may stand
        raise DatasetError(f'layout: {layout!r} is not known; known are auto, {", ".join(readers)}')
    recording, up, mirrored = readers[layout](folder, config)
    if not recording.colour and layout != 'agz':
        raise DatasetError(f'{folder}: no images found')
    stamps = np.array([f.stamp for f in recording.colour])
    if np.any(np.diff(stamps) <= 0):
        raise DatasetError(f'{folder}: image stamps do not increase at image {int(np.argmax(np.diff(stamps) <= 0)) + 1}')
    reference_poses.level(recording, up, R_base_camera, mirrored)
    settle_levels(recording)
    settle_depth_unit(recording, config)
    return recording


# ---- 7-Scenes ---------------------------------------------------------------------------------------------------------

def read_7scenes(folder, config):
    """frame-N.color.{png,jpg}, frame-N.depth.{png,pgm} [mm], frame-N.pose.txt (camera to world); stamps from frame_rate_hz.

    ScanNet's SensReader writes the same names, and _info.txt.
    """
    rate, notes = reference_poses.frame_rate(config), []
    colour, depth, stamps, poses = [], [], [], []
    for path in sorted(glob.glob(os.path.join(folder, 'frame-*.color.*'))):
        match = re.search(r'frame-(\d+)\.color\.', path)
        if not match:
            continue
        stem, stamp = os.path.join(folder, 'frame-' + match.group(1)), int(match.group(1)) / rate
        colour.append(Frame(stamp, path))
        depth += [Frame(stamp, stem + '.depth' + kind) for kind in ('.png', '.pgm') if os.path.isfile(stem + '.depth' + kind)][:1]
        pose = reference_poses.read_matrix(stem + '.pose.txt') if os.path.isfile(stem + '.pose.txt') else None
        if pose is not None:
            stamps.append(stamp)
            poses.append(pose)
    if not colour:
        raise DatasetError(f'{folder}: no frame-*.color.* images')
    found = rgbd_cameras.calibration_files(folder, notes)
    if found.colour is None:
        found.depth = rgbd_cameras.SEVEN_SCENES
        if 'colour_camera' not in config:
            notes.append('see config/datasets/redkitchen.yaml for a measured calibration of a 7-Scenes recording')
    rig = rgbd_cameras.rig(config, colour[0].path, depth[0].path if depth else None, found, rgbd_cameras.SEVEN_SCENES, notes)
    recording = Recording(os.path.basename(os.path.normpath(folder)), colour, rig.camera, depth, rig.depth_camera, T_depth_colour=rig.T_depth_colour, notes=notes)
    recording.depth_unit = 1.0 / rgbd_cameras.counts_per_metre(config, found, 1000.0, notes)
    recording.pose_stamps, recording.poses = np.array(stamps), np.array(poses).reshape(-1, 4, 4)
    reference_poses.to_camera(recording, config, rig.T_depth_colour, rig.mirrored)  # they are those of the depth camera
    return recording, reference_poses.stated_up(config, folder, rig.mirrored, None), rig.mirrored


# ---- TUM RGB-D --------------------------------------------------------------------------------------------------------

def read_tum_list(folder, name, rate, notes):
    """The Frames that a list "stamp file" names, but for those that are missing, which are counted. Whole-numbered stamps count frames."""
    path = os.path.join(folder, name)
    if not os.path.isfile(path):
        raise DatasetError(f'{path}: missing; a TUM RGB-D folder has rgb.txt, depth.txt and groundtruth.txt')
    frames, missing = [], []
    with open(path, encoding='utf-8', errors='replace') as stream:
        for number, line in enumerate(stream, 1):
            words = line.split()
            if not words or words[0].startswith('#'):
                continue
            try:
                frame = Frame(float(words[0]), os.path.join(folder, words[1]))
            except (ValueError, IndexError) as error:
                raise DatasetError(f'{path}:{number}: expected "stamp file"') from error
            if os.path.isfile(frame.path):
                frames.append(frame)
            else:
                missing.append(words[1])
    numbered.count_missing(len(missing), missing[0] if missing else None, len(missing) + len(frames), path, notes)
    if reference_poses.count_frames([frame.stamp for frame in frames]):
        for frame in frames:
            frame.stamp /= rate
        notes.append(f'{name}: its stamps are numbers of frames, taken at {rate:g} Hz (frame_rate_hz of --config)')
    return frames


def read_tum(folder, config):
    """rgb.txt, depth.txt (5000 counts a metre, registered to colour unless --config has a depth_camera), calibration.txt, groundtruth.txt (TUM format)."""
    rate, notes = reference_poses.frame_rate(config), []
    colour = read_tum_list(folder, 'rgb.txt', rate, notes)
    if not colour:
        raise DatasetError(f'{folder}/rgb.txt lists no images')
    # ETH3D's monocular recordings have none.
    depth = read_tum_list(folder, 'depth.txt', rate, notes) if os.path.isfile(os.path.join(folder, 'depth.txt')) else []
    truths = [os.path.join(folder, 'groundtruth.txt')] + reference_poses.icl_trajectories(folder)
    icl = rgbd_cameras.ICL_NUIM if len(truths) > 1 else None
    known = icl or rgbd_cameras.known_sensor(folder)
    found = rgbd_cameras.calibration_files(folder, notes)
    rig = rgbd_cameras.rig(config, colour[0].path, depth[0].path if depth else None, found, known.colour if known else rgbd_cameras.FACTORY, notes)
    recording = Recording(os.path.basename(os.path.normpath(folder)), colour, rig.camera, depth, rig.depth_camera, depth_invalid=(0,),
                          T_depth_colour=rig.T_depth_colour, notes=notes)
    recording.depth_unit = 1.0 / rgbd_cameras.counts_per_metre(config, found, 5000.0, notes)
    truth = next((path for path in truths if os.path.isfile(path)), None)
    if truth:
        stamps, recording.poses = reference_poses.read_trajectory(truth, notes)
        recording.pose_stamps = stamps / rate if reference_poses.count_frames(stamps) else stamps
    mirrored = rig.mirrored or icl is not None  # ICL-NUIM's poses are, whatever sign of fy --config states
    if known and 'pose_from_camera' not in config and not np.allclose(known.pose_from_camera, np.eye(4)):
        notes.append('reference poses: those of a marker body; the camera lies in it as published (pose_from_camera of --config states otherwise)')
    reference_poses.to_camera(recording, config, known.pose_from_camera if known else np.eye(4), mirrored)
    return recording, reference_poses.stated_up(config, folder, mirrored, known.up if known else None), mirrored


# ---- EuRoC MAV --------------------------------------------------------------------------------------------------------

def euroc_root(folder):
    inner = os.path.join(folder, 'mav0')
    return inner if os.path.isdir(inner) else folder


def read_euroc_sensor(path):
    """A sensor.yaml."""
    if not os.path.isfile(path):
        raise DatasetError(f'{path}: missing; a EuRoC folder has cam0/sensor.yaml, cam0/data and imu0/data.csv, TUM-VI\'s dso/camchain.yaml beside mav0')
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
    with open(path, newline='', encoding='utf-8', errors='replace') as stream:
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
    with open(path, newline='', encoding='utf-8', errors='replace') as stream:
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


def read_euroc_camera(root):
    """(Camera, T_body_camera, lines for the user) of cam0/sensor.yaml; where a folder has none, as TUM-VI's, of its dso/camchain.yaml, whose body is the IMU."""
    path = os.path.join(root, 'cam0', 'sensor.yaml')
    chains = [os.path.join(folder, 'dso', 'camchain.yaml') for folder in (os.path.dirname(os.path.abspath(root)), root)]
    chain = next((chain for chain in chains if os.path.isfile(chain)), None)
    if chain and not os.path.isfile(path):
        return _camchain(chain)
    sensor, T_body_camera = read_euroc_sensor(path)
    try:
        fx, fy, cx, cy = (float(v) for v in sensor['intrinsics'])
        distortion = [float(v) for v in sensor['distortion_coefficients']]
        width, height = (int(v) for v in sensor['resolution'])
    except (KeyError, TypeError, ValueError) as error:
        raise DatasetError(f'{path}: intrinsics, distortion_coefficients, resolution needed ({error})') from error
    model = EUROC_MODELS.get(str(sensor.get('distortion_model')))
    if model is None:
        raise DatasetError(f'{path}: distortion model {sensor.get("distortion_model")} is not supported; undistort the images first')
    return Camera(width, height, fx, fy, cx, cy, tuple((distortion + [0.0] * 5)[:5 if model == 'plumb_bob' else 4]), model), T_body_camera, []


def _camchain(path):
    try:
        found = calibration_files.read_camera(path)
    except calibration.CalibrationError as error:
        raise DatasetError(str(error)) from error
    if found.T_camera_body is None:
        raise DatasetError(f'{path}: cam0 has no T_cam_imu, where the camera is beside the IMU')
    late = [f'{path}: timeshift_cam_imu {found.time_offset:.4f} s is not applied; mav_vo finds it'] if found.time_offset else []
    return found.camera, geometry.inverse(found.T_camera_body), [f'calibration: cam0 of {path}', *found.notes, *late]


def read_euroc(folder, config):
    """cam0 (the images of its data.csv), imu0, and a ground truth csv (state_groundtruth_estimate0, groundtruth*, or TUM-VI's mocap0, which is of the IMU)."""
    root = euroc_root(folder)
    camera, T_body_camera, notes = read_euroc_camera(root)
    frames = read_euroc_frames(root, notes)
    recording = Recording(os.path.basename(os.path.normpath(folder)), frames, camera, notes=notes)

    imu_file = os.path.join(root, 'imu0', 'data.csv')
    if os.path.isfile(imu_file):
        described = os.path.isfile(os.path.join(root, 'cam0', 'sensor.yaml'))
        T_body_imu = read_euroc_sensor(os.path.join(root, 'imu0', 'sensor.yaml'))[1] if described else np.eye(4)
        rows = read_csv(imu_file, 7)
        recording.imu = Imu(rows[:, 0], rows[:, 1:4], rows[:, 4:7])
        recording.T_imu_camera = geometry.inverse(T_body_imu) @ T_body_camera
    candidates = [os.path.join(root, 'state_groundtruth_estimate0', 'data.csv')] + sorted(
        glob.glob(os.path.join(root, 'groundtruth*.csv'))) + [os.path.join(root, 'mocap0', 'data.csv')]
    for path in candidates:
        if os.path.isfile(path):
            rows = read_csv(path, 8)  # stamp, p, q as w x y z
            recording.pose_stamps, poses = unique_poses(rows[:, 0], rows[:, 1:4], rows[:, [5, 6, 7, 4]], path, notes)
            recording.poses = poses @ T_body_camera
            break
    # Poses of a motion capture's world: its z is up unless --config states otherwise.
    return recording, reference_poses.stated_up(config, folder, False, Z_UP), False
