"""Reader of RGB-D recordings in folders of numbered images: ICL-NUIM, ScanNet as its exporter writes it, Redwood, RGB-D Scenes v2, Open3D.

  rgb | color | colour | image(s)/N.*, depth/N.*, or N-color.*, N-depth.* in one folder
  pose(s)/N.txt (4x4, camera to world), trajectory.log, *.gt.freiburg or groundtruth.txt
  intrinsic/intrinsic_color.txt and intrinsic_depth.txt, calibration.txt, or Open3D's camera.json

N is the number of the frame, frame_rate_hz of --config (30) makes it a stamp; N-MICROSECONDS, as Redwood names its images, is one. Where
associations.txt lists images by pairs, it decides which are taken.
"""
import glob
import os
import re

import numpy as np

from . import reference_poses, rgbd_cameras
from .recording import DatasetError, Frame, Recording

COLOUR_FOLDERS = ('rgb', 'color', 'colour', 'image', 'images')
EXTENSIONS = r'\.(png|jpg|jpeg|bmp|ppm|pgm|tif|tiff)$'


def images_in(folder, suffix=''):
    """number -> path of the images of a folder whose names are a number and `suffix`."""
    result = {}
    for path in sorted(glob.glob(os.path.join(folder, '*'))):
        match = re.fullmatch(r'\D*?(\d+)(-\d{12})?' + suffix + EXTENSIONS, os.path.basename(path), re.IGNORECASE)
        if match:
            result.setdefault(int(match.group(1)), path)
    return dict(sorted(result.items()))


def find_images(folder):
    """(colour, depth), each number -> path; both empty for a folder of another layout."""
    for name in COLOUR_FOLDERS:
        colour = images_in(os.path.join(folder, name))
        if colour and os.path.isdir(os.path.join(folder, 'depth')):
            return colour, images_in(os.path.join(folder, 'depth'))
    colour = images_in(folder, r'[-_.]colou?r')
    return (colour, images_in(folder, r'[-_.]depth')) if colour else ({}, {})


def is_numbered(folder):
    return bool(find_images(folder)[0])


def stamp_of(number, path, rate):
    """[s]: of the number, or of the microseconds that Redwood's names end in."""
    match = re.search(r'-(\d{12})\.\w+$', path)
    return int(match.group(1)) * 1e-6 if match else number / rate


def associated(folder, colour, depth, notes):
    """The images that associations.txt pairs, "N file N file" a line, colour and depth in either order; all where there is no such file."""
    path = os.path.join(folder, 'associations.txt')
    if not os.path.isfile(path):
        return colour, depth
    chosen, missing, first = ({}, {}), 0, None
    with open(path, encoding='utf-8', errors='replace') as stream:
        for number, line in enumerate(stream, 1):
            words = line.split()
            if not words or words[0].startswith('#'):
                continue
            files = [re.search(r'(\d+)\D*$', os.path.basename(name)) for name in words[1:4:2]]
            if len(words) != 4 or None in files or sum('depth' in name for name in words[1:4:2]) != 1:
                raise DatasetError(f'{path}:{number}: expected "number depth/file number rgb/file"')
            for name, match in zip(words[1:4:2], files):
                full = os.path.join(folder, name)
                if os.path.isfile(full):
                    chosen['depth' in name][int(match.group(1))] = full
                else:
                    missing, first = missing + 1, first or name
    count_missing(missing, first, missing + sum(map(len, chosen)), path, notes)
    return tuple(dict(sorted(images.items())) for images in chosen)


def count_missing(missing, first, total, source, notes):
    """Says how many of the images that `source` names are missing; an error where these are most."""
    if missing:
        text = f'{missing} of {total} images named in {source} are missing (the first: {first})'
        if 2 * missing > total:
            raise DatasetError(text + ': is the data set unpacked whole?')
        notes.append(text)


def read_numbered(folder, config):
    """(Recording, what is up in the frame of its poses, whether they are mirrored); its world is not level yet."""
    rate, notes = reference_poses.frame_rate(config), []
    colour, depth = associated(folder, *find_images(folder), notes)
    if not colour:
        raise DatasetError(f'{folder}: no numbered images in {", ".join(COLOUR_FOLDERS)}')
    icl = rgbd_cameras.ICL_NUIM if reference_poses.icl_trajectories(folder) else None
    known = icl or rgbd_cameras.known_sensor(folder)
    found = rgbd_cameras.calibration_files(folder, notes)
    rig = rgbd_cameras.rig(config, next(iter(colour.values())), next(iter(depth.values()), None), found, known.colour if known else rgbd_cameras.FACTORY, notes)
    frames, depths = ([Frame(stamp_of(number, path, rate), path) for number, path in images.items()] for images in (colour, depth))
    recording = Recording(os.path.basename(os.path.normpath(folder)), frames, rig.camera, depths, rig.depth_camera, T_depth_colour=rig.T_depth_colour, notes=notes)
    recording.depth_unit = 1.0 / rgbd_cameras.counts_per_metre(config, found, 5000.0 if icl else 1000.0, notes)
    notes.append(f'stamps: numbers of the frames at {rate:g} Hz (frame_rate_hz of --config)' if '-' not in os.path.basename(frames[0].path)
                 else f'stamps: as the files are named, else {rate:g} Hz')
    numbers = dict(zip(colour, (frame.stamp for frame in frames)))
    recording.pose_stamps, recording.poses, source = reference_poses.numbered_poses(folder, numbers, notes)
    notes.append(f'reference poses: {source}' if source else 'no reference poses')
    mirrored = rig.mirrored or icl is not None  # ICL-NUIM's poses are, whatever sign of fy --config states
    reference_poses.to_camera(recording, config, known.pose_from_camera if known else np.eye(4), mirrored)
    up = reference_poses.stated_up(config, folder, mirrored, known.up if known else None)
    return recording, up, mirrored
