#!/usr/bin/env python3
"""dataset_to_bag: a drone's video, and the subtitles beside it that say where the drone was."""
import os
import sys
import unittest

import cv2
import numpy as np
import rosunit

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [HERE, os.path.join(HERE, '..', 'scripts')]
from air_ground_eval import calibration, video_telemetry  # noqa: E402
from air_ground_eval.recording import Camera  # noqa: E402
from dataset_to_bag_test import HEIGHT, RATE, WIDTH, convert, messages_of  # noqa: E402
from rgbd_folders_test import RgbdFolders  # noqa: E402


def write_video(path, count=12):
    """Images of one grey each, 20 lighter than the last; 30 a second."""
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*'MJPG'), RATE, (WIDTH, HEIGHT))
    for i in range(count):
        writer.write(np.full((HEIGHT, WIDTH, 3), 20 * i, np.uint8))
    writer.release()


def subtitle(i, text):
    """Of image i."""
    begin, end = (f'00:00:{int(k / RATE):02d},{int(1000 * k / RATE) % 1000:03d}' for k in (i, i + 1))
    return f'{i + 1}\r\n{begin} --> {end}\r\n<font size="28">SrtCnt : {i + 1}, DiffTime : 33ms\r\n2023-06-10 14:21:05.123\r\n[iso : 100] [fnum : 280] {text} </font>\r\n'


class DatasetVideo(unittest.TestCase):
    setUp, inside = RgbdFolders.setUp, RgbdFolders.inside

    def camera(self):
        with open(self.inside('camera.yaml'), 'w', encoding='utf-8') as stream:
            stream.write(calibration.camera_info_yaml(Camera(WIDTH, HEIGHT, 100.0, 101.0, 79.5, 59.5, (-0.1, 0.01, 0.0, 0.0, 0.0)), 'mav'))
        return self.inside('camera.yaml')

    def subtitles(self, name, texts):
        with open(self.inside(name), 'w', encoding='utf-8', newline='') as stream:
            stream.write('\r\n'.join(subtitle(i, text) for i, text in enumerate(texts)))

    def test_video(self):
        """Every second image at half the width; the calibration follows: a ray keeps its place between the image's borders."""
        video, camera, bag = self.inside('flight.avi'), self.camera(), self.inside('flight.bag')
        write_video(video)
        result = convert('--mav', video + '@1-10', '--config', camera, '--mav-width', str(WIDTH // 2), '--mav-rate', '15', '--out', bag)
        self.assertEqual(result.returncode, 0, result.stderr)
        images = messages_of(bag, '/mav/camera/image_raw')
        self.assertEqual([(m.width, m.height, m.encoding) for m in images], [(WIDTH // 2, HEIGHT // 2, 'mono8')] * 5)
        np.testing.assert_allclose([np.frombuffer(m.data, np.uint8).mean() for m in images], [20, 60, 100, 140, 180], atol=2)
        np.testing.assert_allclose(np.diff([m.header.stamp.to_sec() for m in images]), 2 / RATE, atol=2e-3)
        info = messages_of(bag, '/mav/camera/camera_info')[0]
        np.testing.assert_allclose([info.K[0], info.K[4], info.K[2], info.K[5]], [50, 50.5, 39.5, 29.5])
        self.assertEqual(list(info.D), [-0.1, 0.01, 0, 0, 0])
        for arguments, text in [(['--mav', video], '--config cam.yaml'), (['--mav', video, '--config', camera, '--mav-rate', '0'], 'must be positive')]:
            result = convert(*arguments, '--out', bag)
            self.assertEqual(result.returncode, 1)
            self.assertIn(text, result.stderr)

    def test_where_the_drone_was(self):
        """A place that comes with several images is one reading, at the first one's time; zeros stand for no reception."""
        video = self.inside('DJI_0042.avi')
        write_video(video)
        texts = ['[latitude: 0.0] [longitude: 0.0] [rel_alt: 0.0 abs_alt: 0.0]'] * 3
        texts += ['[latitude: 52.5163] [longitude: -13.3777] [rel_alt: 5.300 abs_alt: 71.900]'] * 3 + ['[latitude: 52.5164] [longitude: -13.3777] [rel_alt: 5.300 abs_alt: 72.0]'] * 6
        self.subtitles('DJI_0042.SRT', texts)
        result = convert('--mav', video, '--config', self.camera(), '--out', self.inside('x.bag'))
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn('GPS of DJI_0042.SRT: 2 places', result.stdout + result.stderr)
        fixes = messages_of(self.inside('x.bag'), '/gps/fix')
        np.testing.assert_allclose([(m.latitude, m.longitude, m.altitude) for m in fixes], [(52.5163, -13.3777, 71.9), (52.5164, -13.3777, 72.0)], atol=1e-9)
        images = messages_of(self.inside('x.bag'), '/mav/camera/image_raw')
        np.testing.assert_allclose([m.header.stamp.to_sec() for m in fixes], [images[i].header.stamp.to_sec() for i in (3, 6)], atol=2e-3)
        self.assertEqual(fixes[0].position_covariance[0], 25.0)

    def test_words_of_other_drones(self):
        for text, place in (('[latitude : 31.45] [longtitude : 74.40] [altitude: 219.5]', (31.45, 74.4, 219.5)), ('HOME(149.0,-20.2) GPS(149.0251,-20.2533,16) BAROMETER:1.9', (-20.2533, 149.0251, 16)),
                            ('F/2.8, SS 206.14, ISO 150, EV 0, GPS (8.6499, 53.1407, 19), D 24.6m, H 6.0m', (53.1407, 8.6499, 19)), ('[iso : 100] [fnum : 280]', None), ('GPS(-200.0,10.0,1)', None)):
            self.assertEqual(video_telemetry.place_of(text), place, text)

    def test_subtitles_without_places(self):
        video = self.inside('film.avi')
        write_video(video)
        self.subtitles('film.srt', ['Good evening.'])
        result = convert('--mav', video, '--config', self.camera(), '--out', self.inside('x.bag'))
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn('film.srt beside the video holds no place', result.stdout + result.stderr)
        self.assertEqual(messages_of(self.inside('x.bag'), '/gps/fix'), [])


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'dataset_video_test', DatasetVideo)
