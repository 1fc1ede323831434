"""Reader of a video file as a recording: of a drone whose camera writes nothing else, but for subtitles that say where it is. Its calibration comes
from a camera_info file."""
import os
from dataclasses import dataclass

import cv2
import numpy as np

from . import calibration, video_telemetry
from .recording import Camera, DatasetError, Frame, Recording, camera_from_config

EXTENSIONS = ('.mp4', '.mov', '.avi', '.mkv', '.m4v', '.webm', '.mpg', '.mpeg', '.ts', '.mts')


def is_video(path):
    return os.path.isfile(path) and path.lower().endswith(EXTENSIONS)


class Video:
    """A file's images in their order; earlier ones than the last are found by beginning again."""

    def __init__(self, path):
        self.path = path
        self.begin_again()

    def begin_again(self):
        self.capture = cv2.VideoCapture(self.path)
        if not self.capture.isOpened():
            raise DatasetError(f'{self.path}: cannot be read as a video; another container or codec may help (ffmpeg -i IN -c:v libx264 OUT.mp4)')
        self.next = 0

    def skip(self):
        """Whether there was another image."""
        if not self.capture.grab():
            return False
        self.next += 1
        return True

    def stamps(self):
        """Of all images [s]: the file's own, or where it has none by its rate."""
        result = []
        while self.skip():
            result.append(1e-3 * self.capture.get(cv2.CAP_PROP_POS_MSEC))
        rate = self.capture.get(cv2.CAP_PROP_FPS)
        if np.any(np.diff(result) <= 0):
            if not rate > 0:
                raise DatasetError(f'{self.path}: has neither stamps nor a rate')
            result = [i / rate for i in range(len(result))]
        self.begin_again()
        return result

    def image(self, index):
        """uint8 (h, w, 3), red first."""
        if index < self.next:
            self.begin_again()
        while self.next < index and self.skip():
            pass
        known, array = self.capture.read()
        if not known:
            raise DatasetError(f'{self.path}: image {index} cannot be decoded')
        self.next += 1
        return cv2.cvtColor(array, cv2.COLOR_BGR2RGB)


@dataclass
class VideoFrame(Frame):
    """path: the video's, with the image's number."""
    video: Video = None
    index: int = 0

    def read(self):
        return self.video.image(self.index)


def camera_of(path, config, config_path):
    """From a camera_info file, or colour_camera of a data set's calibration."""
    if not config:
        raise DatasetError(f'{path}: a video does not say how its camera projects: give --config cam.yaml, the camera_info file of a calibration '
                           'at this resolution (camera_calibration writes one; import_kalibr, too)')
    if 'colour_camera' in config:
        return camera_from_config(config['colour_camera'], 'colour_camera', (0, 0))
    try:
        info = calibration.read_camera_info(config_path)
    except calibration.CalibrationError as error:
        raise DatasetError(str(error)) from error
    return Camera(info.width, info.height, info.K[0], info.K[4], info.K[2], info.K[5], tuple(info.D), info.distortion_model)


def read_video(path, config, config_path):
    camera, video = camera_of(path, config, config_path), Video(path)
    frames = [VideoFrame(stamp, f'{path}, image {index}', video=video, index=index) for index, stamp in enumerate(video.stamps())]
    notes = ['a video: no IMU; replay it with mav_use_imu:=false, its scale comes from the ground map, or in a city from the fixes']
    telemetry = video_telemetry.path_beside(path)
    gps = video_telemetry.read_gps(telemetry, notes) if telemetry else None
    return Recording(os.path.basename(path), frames, camera, gps=gps, notes=notes)
