#!/usr/bin/env python3
"""Replays a small bag through replay.launch with a stand-in for the nodes whose errors are known: the report must find them."""
import os
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import rosbag
import rospkg
import rostest
import yaml

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'scripts'))
from air_ground_eval import demo, evaluation, geometry, messages, ply  # noqa: E402

sys.path.insert(0, HERE)
DURATION = 6.0


def write_bag(path, truth=True):
    """A MAV that flies a helix and a ground robot that drives an arc; ground truth only."""
    with rosbag.Bag(path, 'w') as bag:
        edges = [('mav_base_link', 'mav_camera_optical_frame', geometry.pose(geometry.R_BODY_DOWN_CAMERA, (0.05, 0, -0.02))),
                 ('ground_base_link', 'ground_camera_optical_frame', geometry.pose(geometry.R_BODY_FORWARD_CAMERA, (0.1, 0, 0.4)))]
        messages.write_latched(bag, '/tf_static', messages.static_transforms(edges, 99.999), 99.999)
        for t in np.arange(0, DURATION, 0.02):
            mav = geometry.pose(geometry.rotation_z(0.6 * t), (np.cos(t), np.sin(t), 1.5 + 0.1 * t))
            ground = geometry.pose(geometry.rotation_z(0.3 * t), (2 * np.cos(0.3 * t), 2 * np.sin(0.3 * t), 0.05 * np.sin(t)))
            for name, pose in (('mav', mav), ('ground', ground)):
                topic = f'/ground_truth/{name}' if truth else f'/hidden/{name}'
                bag.write(topic, messages.pose_stamped(pose, 100 + t, 'world'), messages.stamp(100 + t))
    vertices = [(-3, -3, 0), (3, -3, 0), (3, 3, 0), (-3, 3, 0)]
    with open(os.path.splitext(path)[0] + '.world.ply', 'wb') as stream:
        stream.write(b'ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n'
                     b'element face 2\nproperty list uchar int vertex_indices\nend_header\n')
        stream.write(np.array(vertices, '<f4').tobytes())
        for face in ((0, 1, 2), (0, 2, 3)):
            stream.write(b'\x03' + np.array(face, '<i4').tobytes())


def replay(folder, stand_in, *arguments):
    """Runs replay.launch with the stand-in; returns its output."""
    launch = os.path.join(folder, 'stand_in_replay.launch')
    package = rospkg.RosPack().get_path('air_ground')
    params = ''.join(f'<param name="{k}" value="{v}"/>' for k, v in stand_in.items())
    with open(launch, 'w', encoding='utf-8') as stream:
        stream.write('<launch><arg name="truth" default="/ground_truth"/><arg name="bag"/><arg name="out"/>'
                     f'<node pkg="air_ground" type="stand_in_pipeline.py" name="stand_in_pipeline">{params}'
                     '<remap from="ground_truth/mav" to="$(arg truth)/mav"/><remap from="ground_truth/ground" to="$(arg truth)/ground"/></node>'
                     f'<include file="{package}/launch/replay.launch" pass_all_args="true"><arg name="wait_for" value="stand_in_pipeline"/>'
                     + ''.join(f'<arg name="{n}" value="false"/>' for n in ('mav_vo', 'rgbd_slam', 'dense_fusion', 'heightmap_mcl', 'icp_refine'))
                     + '</include></launch>')
    port = demo.free_port()
    environment = dict(os.environ, ROS_MASTER_URI=f'http://localhost:{port}')
    result = subprocess.run(['roslaunch', '-p', str(port), launch, f'bag:={folder}/x.bag', f'out:={folder}/out', *arguments],
                            env=environment, capture_output=True, text=True, timeout=160, check=False)
    return result.stdout + result.stderr


class ReplayReport(unittest.TestCase):
    def run_replay(self, stand_in, truth=True):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        write_bag(os.path.join(folder.name, 'x.bag'), truth)
        output = replay(folder.name, stand_in, *([] if truth else ['truth:=/hidden']))
        out = os.path.join(folder.name, 'out')
        self.assertTrue(os.path.isfile(os.path.join(out, 'report.yaml')), output)
        with open(os.path.join(out, 'report.yaml'), encoding='utf-8') as stream:
            return out, yaml.safe_load(stream), output

    def test_known_errors_are_found(self):
        out, values, output = self.run_replay({'refined_error': 0.05, 'refined_error_yaw': 0.02, 'vo_scale': 1.0})
        self.assertTrue(values['alignment_accepted'])
        self.assertLess(values['vo_ate_rmse_m'], 1e-3)
        self.assertLess(values['slam_ate_rmse_m'], 1e-3)
        self.assertAlmostEqual(values['refined_error_m'], 0.05, delta=2e-3)
        self.assertAlmostEqual(values['refined_error_deg'], np.degrees(0.02), delta=0.05)
        self.assertAlmostEqual(values['coarse_error_m'][0], 0.8, delta=5e-3)
        self.assertAlmostEqual(values['coarse_error_m'][3], 0.2, delta=5e-3)
        self.assertAlmostEqual(values['coarse_error_yaw_deg'][0], np.degrees(0.1), delta=0.05)
        self.assertAlmostEqual(values['ground_surface_error_median_m'], 0.0, delta=2e-3)
        self.assertAlmostEqual(values['aerial_surface_error_median_m'], 0.02, delta=2e-3)
        self.assertAlmostEqual(values['added_area_m2'], 4.0, delta=0.4)
        self.assertEqual(len(ply.read_points(os.path.join(out, 'augmented_map.ply'))), values['augmented_map_points'])
        self.assertGreater(os.path.getsize(os.path.join(out, 'report.png')), 20000)
        rows = np.loadtxt(os.path.join(out, 'alignment.txt'))
        self.assertEqual(rows.shape[1], 16)
        self.assertTrue(np.allclose(rows[:, 10:], 0.01, atol=1e-6))
        track = evaluation.read_tum(os.path.join(out, 'mav_trajectory.txt'))
        self.assertGreater(len(track), 0.9 * DURATION / 0.02)
        self.assertIn('refined error', output)

    def test_scale_error_and_refusal(self):
        out, values, output = self.run_replay({'vo_scale': 1.05, 'status': 2})
        self.assertAlmostEqual(values['vo_scale_error_percent'], 5.0, delta=0.1)
        self.assertGreater(values['vo_ate_rmse_m'], 0.02)
        self.assertFalse(values['alignment_accepted'])
        self.assertNotIn('refined_error_m', values)
        self.assertIn('DEGENERATE', values['alignment_verdict'])
        self.assertIn('no alignment accepted', output)
        self.assertFalse(os.path.exists(os.path.join(out, 'augmented_map.ply')))

    def test_without_ground_truth(self):
        out, values, _ = self.run_replay({}, truth=False)
        self.assertFalse(values['ground_truth_in_bag'])
        self.assertNotIn('vo_ate_rmse_m', values)
        self.assertNotIn('refined_error_m', values)
        self.assertGreater(values['vo_estimated_path_length_m'], 5.0)
        self.assertTrue(values['alignment_accepted'])
        self.assertGreater(values['augmented_map_points'], 1000)
        self.assertNotIn('map_surface_error_median_m', values)
        self.assertTrue(os.path.isfile(os.path.join(out, 'report.png')))


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'replay_report_test', ReplayReport)
