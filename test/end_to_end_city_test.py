#!/usr/bin/env python3
"""A rendered street through roslaunch: simulator, database, odometry, localizer, tracker, report. Parameters: see end_to_end.py."""
import os
import re
import subprocess
import sys

import cv2
import numpy as np
import rosbag
import rostest
import yaml

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))

from end_to_end import DemonstrationTest, find_program  # noqa: E402


class EndToEndCity(DemonstrationTest):
    program = 'run_city_demo'

    def transforms(self):
        return {'world -> mav_map', 'mav_map -> mav_odom', 'mav_odom -> mav_base_link'}, set()

    def test_tracker(self):
        r = self.report
        self.assertTrue(r['tracker_started'])
        self.assertLess(r['tracker_position_error_mean_m'], 1.0)
        self.assertLess(r['tracker_position_error_max_m'], 4.0)
        self.assertLess(r['tracker_yaw_error_mean_deg'], 3.0)
        self.assertLess(r['tracker_position_error_mean_m'], r['gps_position_error_mean_m'])
        # What it states must fit its errors: 4 if consistent; a short flight's errors are few and alike.
        self.assertGreater(r['tracker_nees_mean'], 0.1)
        self.assertLess(r['tracker_nees_mean'], 15.0)
        self.assertLess(r['tracker_stated_sigma_x_mean_m'], 1.0)
        self.assertGreater(r['way_length_m'] - r['tracker_start_after_m'], 15.0)

    def test_fixes(self):
        self.assertGreater(self.report['tracker_fixes_fused'], 3)
        self.assertEqual(self.report['fixes_wrong'], 0)
        self.assertEqual(self.report['tracker_wrong_fixes_fused'], 0)
        self.assertEqual(self.report['tracker_recoveries'], 0)

    def test_tracker_with_magnetometer(self):
        self.assertLess(self.report['magnetometer_position_error_mean_m'], 1.0)
        self.assertLess(self.report['magnetometer_yaw_error_mean_deg'], 3.0)

    def test_the_example_locates_photographs_of_the_flight(self):
        path, database = re.search(r'^-- replay of (\S+) against (\S+),', self.output, re.M).groups()
        images, truth, camera = {}, {}, None
        with rosbag.Bag(path) as bag:
            begin, end = bag.get_start_time(), bag.get_end_time()
            wanted = [begin + share * (end - begin) for share in (0.4, 0.6, 0.8)]
            for topic, message, _ in bag.read_messages(['/mav/camera/image_raw', '/mav/camera/camera_info', '/ground_truth/mav']):
                stamp = message.header.stamp.to_sec()
                if topic.endswith('camera_info'):
                    camera = message
                elif topic.startswith('/ground_truth'):
                    p = message.pose.position
                    truth[stamp] = np.array((p.x, p.y, p.z))
                elif wanted and stamp >= wanted[0]:
                    images[stamp] = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)[:, :message.width]
                    wanted.pop(0)
        self.assertEqual(len(images), 3)
        calibration = os.path.join(self.folder.name, 'camera.yaml')
        with open(calibration, 'w', encoding='utf-8') as stream:
            yaml.safe_dump({'image_width': camera.width, 'image_height': camera.height, 'distortion_model': camera.distortion_model,
                            'camera_matrix': {'rows': 3, 'cols': 3, 'data': list(camera.K)},
                            'distortion_coefficients': {'rows': 1, 'cols': len(camera.D), 'data': list(camera.D)}}, stream)
        found = []
        for stamp, image in images.items():
            photograph = os.path.join(self.folder.name, 'photograph.png')
            cv2.imwrite(photograph, image)
            result = subprocess.run([find_program('03_locate_photograph'), database, photograph, calibration], capture_output=True, text=True, check=False)
            if result.returncode == 0:
                nearest = truth[min(truth, key=lambda t: abs(t - stamp))]
                found.append(np.linalg.norm(np.array(result.stdout.splitlines()[-1].split(), float) - nearest))
        self.assertGreaterEqual(len(found), 2)
        self.assertLess(max(found), 1.5, found)

    def test_files(self):
        for name in ('vo', 'gps', 'tracker', 'tracker_with_magnetometer', 'truth'):
            rows = np.loadtxt(os.path.join(self.out, f'{name}_trajectory.txt'), ndmin=2)
            self.assertEqual(rows.shape[1], 8, name)
            self.assertTrue(np.all(np.isfinite(rows)), name)
        for name in ('trajectories.png', 'uncertainty.png'):
            self.assertGreater(os.path.getsize(os.path.join(self.out, name)), 20000)


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'end_to_end_city_test', EndToEndCity, sys.argv)
