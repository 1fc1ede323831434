"""Whether depth is as the colour camera sees it, by sizes, frames and calibrations."""
import re

import numpy as np

from . import bag_camera
from .bag_finding import ERROR, OK, WARNING, Finding, quoted

REGISTERED = re.compile(r'aligned|(?<!un)registered|depth_to_(rgb|colou?r)')  # so by its driver's name for it
FOCAL, CENTRE = 0.03, 0.02  # relative, and of the image's width: calibrations further apart are of two cameras


def pinhole(info):
    """(fx, fy, cx, cy) [px] of the images that a camera_info describes, integers at pixel centres: K is that of the whole sensor."""
    bins, whole = (max(1, info.binning_x), max(1, info.binning_y)), 0 in (info.roi.width, info.roi.height)
    begin = (0, 0) if whole else (info.roi.x_offset, info.roi.y_offset)
    return (info.K[0] / bins[0], info.K[4] / bins[1], *((c - start + 0.5) / n - 0.5 for c, start, n in zip((info.K[2], info.K[5]), begin, bins)))


def differences(colour, depth):
    """What tells the calibration of depth from that of the colour camera, scaled to the latter's size; empty where they are one, or one of them says nothing.

    colour, depth: CameraInfo as bag_camera.of_images has it.
    """
    sizes = bag_camera.stated_size(colour), bag_camera.stated_size(depth)
    ours, theirs = np.array(pinhole(colour)), np.array(pinhole(depth))
    if min(*sizes[0], *sizes[1], *ours[:2], *theirs[:2]) <= 0:
        return ''
    scale = np.array(sizes[0]) / sizes[1]
    theirs = np.concatenate([theirs[:2] * scale, (theirs[2:] + 0.5) * scale - 0.5])
    if np.abs(theirs[:2] / ours[:2] - 1).max() > FOCAL or np.abs(theirs[2:] - ours[2:]).max() > CENTRE * sizes[0][0]:
        return (f'differ in their calibration (at {sizes[0][0]}x{sizes[0][1]} f {theirs[0]:.1f} and {ours[0]:.1f} px, centre ({theirs[2]:.1f}, {theirs[3]:.1f}) and '
                f'({ours[2]:.1f}, {ours[3]:.1f}))')
    return ''


def _same_proportions(a, b):
    return abs(a[0] * b[1] / (a[1] * b[0]) - 1) < 0.01


class Registration:
    """What images and calibrations of depth and colour say of each other.

    images: (depth, colour), their first messages; frames: the sets of their frame ids; infos: their first camera_info, None where one has none of its own;
    topics: their names.
    """

    def __init__(self, images, frames, infos, topics):
        self.sizes = [bag_camera.image_size(image) for image in images]
        self.frames = frames
        known = [info and bag_camera.of_images(info, topic) for info, topic in zip(infos, topics)]
        self.calibrated = infos[0] is not None
        self.differences = differences(known[1], known[0]) if all(known) else ''
        self.named = REGISTERED.search(topics[0].lower()) is not None

    def mismatch(self):
        """By what depth images show that another camera than the colour camera took them; empty where nothing does."""
        same_frame = self.frames[0] == self.frames[1]
        if None not in self.sizes and self.sizes[0] != self.sizes[1] and not (same_frame and _same_proportions(*self.sizes)):
            return 'differ in size'
        if not same_frame:
            return f'are in frames {quoted(self.frames[0])} and {quoted(self.frames[1])}'
        return '' if self.named else self.differences

    def check(self, depth, colour):
        """Findings. depth, colour: the topics."""
        mismatch = self.mismatch()
        if mismatch and self.calibrated:
            why = ''
            if self.frames[0] == self.frames[1]:
                why = (f'. Both are in frame {quoted(self.frames[0])}, so that the distance between the two cameras counts as zero: a few centimetres are told by base_depth in a copy of '
                       'config/rgbd_slam.yaml (rgbd_slam_config:=COPY), or by a frame of its own for depth')
            return [Finding(WARNING, f'{depth} and {colour} {mismatch}: depth seems not to be registered to colour: replay with ground_depth_registered:=false, or record the '
                            f'registered one (aligned_depth_to_color, depth_registered){why}')]
        if mismatch:
            return [Finding(ERROR, f'{depth} and {colour} {mismatch}: depth seems not to be registered to colour, and the depth camera\'s calibration is missing: record it '
                            '(camera_info beside the images), or the registered depth (aligned_depth_to_color, depth_registered)')]
        result = []
        if self.differences:
            result.append(Finding(WARNING, f'{depth} and {colour} {self.differences}, though its name says that depth is registered: taken for registered, since drivers have published the '
                                  'depth camera\'s calibration beside it (realsense-ros of 2018); if edges in depth lie beside those in colour, replay with ground_depth_registered:=false'))
        if None not in self.sizes and self.sizes[0] != self.sizes[1]:
            result.append(Finding(OK, f'{depth} is {colour} at another resolution: the colour camera\'s calibration serves, scaled'))
        return result
