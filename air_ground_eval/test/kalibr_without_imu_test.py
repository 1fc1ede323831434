#!/usr/bin/env python3
"""import_kalibr for a camera that was calibrated by itself, of a MAV that has no IMU, or one of another name."""
import os
import shlex
import sys
import unittest

import numpy as np
import rosbag
import rosunit
import yaml

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [HERE, os.path.join(HERE, '..', 'scripts')]
from air_ground_eval import calibration, calibration_files, messages  # noqa: E402
from air_ground_eval.recording import Camera  # noqa: E402
from import_kalibr_test import CHAIN, EUROC_FILES, ImportKalibr  # noqa: E402


class KalibrWithoutImu(unittest.TestCase):
    setUp, path, write, run_import = ImportKalibr.setUp, ImportKalibr.path, ImportKalibr.write, ImportKalibr.run_import

    def test_words_where_named_values_belong(self):
        """One line that names file and key; an empty matrix of a camera_info file is as none."""
        chain = yaml.safe_dump({'cam0': {**CHAIN['cam0'], 'camera_model': []}})
        vins = EUROC_FILES['vins.yaml'].replace('distortion_parameters:\n', 'distortion_parameters: abc\nmore:\n')
        rpg = EUROC_FILES['rpg.yaml'][:EUROC_FILES['rpg.yaml'].index('    distortion:')] + '    distortion: abc\n'
        for text, line in ((chain, 'cam0 has the camera model []'), (vins, "distortion_parameters must be named values, not 'abc'"), (rpg, "cam0: distortion must be named values, not 'abc'")):
            with self.assertRaises(calibration.CalibrationError) as caught:
                calibration_files.read_camera(self.write('x.yaml', text))
            self.assertIn(line, str(caught.exception))
            self.assertIn(self.path('x.yaml'), str(caught.exception))
        whole = yaml.safe_load(calibration.camera_info_yaml(Camera(640, 480, 500, 501, 320, 240), 'cam'))
        info = calibration.read_camera_info(self.write('x.yaml', yaml.safe_dump({**whole, 'rectification_matrix': None, 'projection_matrix': None})))
        self.assertEqual((list(info.R), list(info.P)), ([1, 0, 0, 0, 1, 0, 0, 0, 1], [500, 0, 320, 0, 0, 501, 240, 0, 0, 0, 1, 0]))
        for broken in ({'rectification_matrix': 'abc'}, {'projection_matrix': {'data': [1, 2]}}, {'camera_matrix': {'data': []}}):
            with self.assertRaises(calibration.CalibrationError):
                calibration.read_camera_info(self.write('x.yaml', yaml.safe_dump({**whole, **broken})))

    def without_imu(self, *arguments, image_frame='left_eye', edges=()):
        """(status, what it said, words of its last line, of a bag with images alone where --bag is among them), of a camera that was calibrated by itself."""
        self.write('camchain.yaml', yaml.safe_dump({'cam0': {key: value for key, value in CHAIN['cam0'].items() if key not in ('T_cam_imu', 'timeshift_cam_imu')}}))
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            if edges:
                messages.write_latched(bag, '/tf_static', messages.static_transforms([(*edge, np.eye(4)) for edge in edges], 5), 5)
            for t in (5, 6):
                bag.write('/cam0/image_raw', messages.image(np.zeros((480, 752)), 'mono8', t, image_frame), messages.stamp(t))
        result = self.run_import(*arguments)
        return result.returncode, result.stdout + result.stderr, shlex.split(result.stdout.splitlines()[-1]) if result.stdout else []

    def test_a_mav_without_imu(self):
        """Its camera is its base, as check_bag has it, or what the bag says; --mount says otherwise."""
        bag = ('--bag', self.path('x.bag'))
        for arguments, edges, frame, base in (((), (), 'mav_camera_optical_frame', 'mav_camera_optical_frame'), (bag, (), 'left_eye', 'left_eye'), (bag, [('body', 'left_eye')], 'left_eye', 'body'),
                                              ((*bag, '--mount', 'forward'), (), 'left_eye', None), (('--mount', 'down'), (), 'mav_camera_optical_frame', None)):
            status, said, words = self.without_imu(*arguments, edges=edges)
            self.assertEqual(status, 0, said)
            self.assertIn('taken for a MAV without IMU', said)
            self.assertIn('mav_use_imu:=false', words)
            self.assertFalse([word for word in words if word.startswith('mav_imu:=')], words)
            named = dict(word.split(':=') for word in words if ':=' in word)
            self.assertEqual(named.get('mav_base_frame', 'mav_base_link'), base or 'mav_base_link', words)
            self.assertEqual(named.get('mav_camera_frame', 'mav_camera_optical_frame'), frame, words)
            with open(self.path('out', 'mav_vo.yaml'), encoding='utf-8') as stream:
                self.assertEqual(yaml.safe_load(stream).get('camera_frame'), frame)
            with open(self.path('out', 'sensors.launch'), encoding='utf-8') as stream:
                edge = stream.read().replace('&quot;', '"').split('--transform "')[1:]
            self.assertEqual([text.split('"')[0].split()[:5] for text in edge], [] if base else [['mav_base_link', frame, '0.000000000', '0.000000000', '0.000000000']])
        for frame, camera in (('', 'mav_camera_optical_frame'), ('mav_base_link', 'mav_base_link')):
            words = self.without_imu(*bag, image_frame=frame)[2]
            self.assertIn(f'mav_camera_frame:={camera}' if frame else f'mav_base_frame:={camera}', words)

    def test_an_imu_of_another_name_is_not_left_out(self):
        self.without_imu()
        with rosbag.Bag(self.path('x.bag'), 'a') as bag:
            for t in (5 + 0.01 * i for i in range(100)):
                bag.write('/imu0', messages.imu([0.01, 0, 0], [0, 0, 9.81], 1, 1, t, 'imu'), messages.stamp(t))
        for named in ((), ('--imu-topic', '/imu0')):
            result = self.run_import('--bag', self.path('x.bag'), *named)
            self.assertEqual(result.returncode, 0, result.stderr)
            self.assertEqual('/imu0 is taken for mav_imu, as check_bag guesses' in result.stdout, not named, result.stdout)
            self.assertIn('mav_imu:=/imu0', result.stdout)
            self.assertNotIn('mav_use_imu', result.stdout)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'kalibr_without_imu_test', KalibrWithoutImu)
