"""Checks of how far depth images reach."""
import numpy as np

from . import bag_camera
from .bag_finding import OK, WARNING, Finding

MAX_RANGE = 4.5  # [m]: depth_max_range of rgbd_slam, as it is unless told otherwise
MOST, SOME = 0.5, 0.1  # shares of the depths beyond it that are a warning, and worth a word


def check_range(topic, images, arguments=()):
    """What share of the depths rgbd_slam leaves out. `images` from all over the recording; `arguments`: of the launch command, which may tell the unit of a step."""
    unit = next((float(a.partition(':=')[2]) for a in arguments if a.startswith('ground_depth_unit:=')), 1e-3)
    beyond = count = 0
    for depth in map(bag_camera.depths, images):
        if depth is not None and depth.ndim == 2:
            metres = depth[bag_camera.known(depth)] * (1 if depth.dtype.kind == 'f' else unit)
            beyond, count = beyond + np.count_nonzero(metres > MAX_RANGE), count + metres.size
    if beyond <= SOME * count:
        return []
    text = f'{topic}: {100 * beyond / count:.0f} % of its depths lie beyond {MAX_RANGE:g} m, where rgbd_slam takes none for landmarks'
    if beyond <= MOST * count:
        return [Finding(OK, f'{text} (depth_max_range)')]
    return [Finding(WARNING, f'{text}: where the camera sees so far, set depth_max_range in a copy of config/rgbd_slam.yaml, and replay with rgbd_slam_config:=COPY')]
