#!/usr/bin/env python3
"""Replays a small bag through city.launch with the real tracker and a stand-in for odometry and localizer: the report must find
the errors that were put in."""
import os
import sqlite3
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import pyproj
import rosbag
import rospkg
import rostest
import yaml
from sensor_msgs.msg import NavSatFix

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'scripts'))
from air_ground_eval import city_database, demo, evaluation, geometry, messages  # noqa: E402

DURATION = 20.0
UNDULATION = 49.6
GPS_OFFSET = np.array([3.0, 0.0, 4.0])
# Where the grid of EPSG:2056 and the local frame coincide: no convergence, scale 1.
ORIGIN = (2600000.0, 1200000.0, 500.0)


def truth_at(t):
    """2 m/s along an S, body tilted."""
    yaw = 0.4 * np.sin(0.3 * t)
    return geometry.pose(geometry.rotation_z(yaw) @ np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]]),
                         (2 * t, 3 * np.sin(0.3 * t), 5 + np.sin(0.2 * t)))


def write_bag(path):
    to_geodetic = pyproj.Transformer.from_crs('EPSG:2056', 'EPSG:4326', always_xy=True)
    with rosbag.Bag(path, 'w') as bag:
        edges = [('mav_base_link', 'mav_imu_link', np.eye(4))]
        messages.write_latched(bag, '/tf_static', messages.static_transforms(edges, 99.999), 99.999)
        for t in np.arange(0, DURATION, 0.02):
            bag.write('/ground_truth/mav', messages.pose_stamped(truth_at(t), 100 + t, 'world'), messages.stamp(100 + t))
        for t in np.arange(0, DURATION, 0.5):
            p = truth_at(t)[:3, 3] + GPS_OFFSET
            gps = NavSatFix()
            gps.header.stamp = messages.stamp(100 + t)
            gps.longitude, gps.latitude = to_geodetic.transform(ORIGIN[0] + p[0], ORIGIN[1] + p[1])
            gps.altitude = ORIGIN[2] + p[2] + UNDULATION
            gps.position_covariance[0] = gps.position_covariance[4] = 16.0
            gps.position_covariance[8] = 64.0
            bag.write('/gps/fix', gps, gps.header.stamp)
            gps.latitude += 0.01  # of another receiver, whose topic comes first by name
            bag.write('/backup/fix', gps, gps.header.stamp)


def write_database(path):
    """The tables that the report reads of a Street View database: one house on a large meadow, two panoramas."""
    with sqlite3.connect(path) as database:
        database.execute('CREATE TABLE street_view_database (key TEXT, value TEXT)')
        database.executemany('INSERT INTO street_view_database VALUES (?, ?)',
                             [('crs', 'EPSG:2056')] + [(f'origin_{axis}', str(x)) for axis, x in zip('xyz', ORIGIN)])
        database.execute('CREATE TABLE panoramas (x REAL, y REAL, z REAL, views INTEGER)')
        database.executemany('INSERT INTO panoramas VALUES (?, ?, 2.5, 12)', [(0, 0), (12, 0)])
        database.execute('CREATE TABLE buildings (building_id TEXT, vertices BLOB, triangles BLOB)')
        corners = np.array([(0, 8, 0), (30, 8, 0), (30, 16, 0), (0, 16, 0)], '<f4')
        triangles = np.array([(0, 1, 2), (0, 2, 3)], '<i4').tobytes()
        database.executemany('INSERT INTO buildings VALUES (?, ?, ?)', [(None, (10 * corners).tobytes(), triangles), ('house', corners.tobytes(), triangles)])


class CityReport(unittest.TestCase):
    def run_replay(self, **stand_in):
        folder = tempfile.TemporaryDirectory(prefix='a folder with spaces ')
        self.addCleanup(folder.cleanup)
        package = rospkg.RosPack().get_path('air_ground')

        def path(name):
            return os.path.join(folder.name, name)

        write_bag(path('x.bag'))
        write_database(path('x.gpkg'))
        with open(path('city.yaml'), 'w', encoding='utf-8') as stream:
            yaml.safe_dump({'geoid_undulation': UNDULATION, 'magnetic_declination': 3.0}, stream)
        with open(path('world.yaml'), 'w', encoding='utf-8') as stream:
            subprocess.run([demo.find_program('city_parameters'), '--database', path('x.gpkg'), '--city', path('city.yaml')], stdout=stream, check=True)
        params = ''.join(f'<param name="{k}" value="{v}"/>' for k, v in stand_in.items())
        with open(path('x.launch'), 'w', encoding='utf-8') as stream:
            stream.write('<launch><arg name="bag"/><arg name="db"/><arg name="out"/><arg name="world_config"/>'
                         f'<node pkg="air_ground" type="stand_in_city.py" name="stand_in_city">{params}</node>'
                         f'<include file="{package}/launch/city.launch" pass_all_args="true"><arg name="wait_for" value="stand_in_city"/>'
                         '<arg name="mav_vo" value="false"/><arg name="streetview_localizer" value="false"/><arg name="compare_magnetometer" value="false"/>'
                         '<arg name="vo_covariance_factor" value="1"/></include></launch>')
        port = demo.free_port()
        result = subprocess.run(['roslaunch', '-p', str(port), path('x.launch'), f'bag:={path("x.bag")}', f'db:={path("x.gpkg")}',
                                 f'world_config:={path("world.yaml")}', f'out:={path("out")}'],
                                env=dict(os.environ, ROS_MASTER_URI=f'http://localhost:{port}'), capture_output=True, text=True, timeout=240, check=False)
        output = result.stdout + result.stderr
        self.assertTrue(os.path.isfile(path('out/report.yaml')), output)
        with open(path('out/report.yaml'), encoding='utf-8') as stream:
            return path('out'), yaml.safe_load(stream), output

    def test_known_errors_are_found(self):
        drift = 0.01
        out, values, output = self.run_replay(yaw_drift=drift, fix_sigma=0.1, wrong_every=5)
        length = values['way_length_m'] - values['tracker_start_after_m']
        self.assertAlmostEqual(values['way_length_m'], sum(np.linalg.norm(truth_at(t + 0.02)[:3, 3] - truth_at(t)[:3, 3]) for t in np.arange(0, DURATION, 0.02)), delta=0.2)
        # A yaw that drifts with the way carries the odometry off by half of drift times the squared length, if the way is straight.
        self.assertGreater(values['vo_from_true_start_position_error_at_end_m'], 0.25 * drift * length ** 2)
        self.assertLess(values['vo_from_true_start_position_error_at_end_m'], 0.75 * drift * length ** 2)
        self.assertAlmostEqual(values['vo_from_true_start_yaw_error_max_deg'], np.degrees(drift * length), delta=1.0)
        self.assertAlmostEqual(values['gps_position_error_mean_m'], 5.0, delta=0.01)
        self.assertEqual(values['gps_topic'], '/gps/fix')
        self.assertAlmostEqual(values['gps_error_x_rms_m'], 3.0, delta=0.01)
        self.assertAlmostEqual(values['gps_stated_sigma_z_mean_m'], 8.0, delta=1e-6)
        self.assertLess(values['tracker_position_error_mean_m'], 0.5)
        self.assertLess(values['tracker_error_over_vo_error'], 0.5)
        self.assertGreater(values['tracker_fixes_fused'], 10)
        self.assertEqual(values['fixes_wrong'], values['fixes'] // 5)
        self.assertEqual(values['tracker_wrong_fixes_fused'], 0)
        self.assertEqual(values['tracker_fixes_refused'], values['fixes_wrong'])
        # All others are part of the pose, the first as well, which waited for the second.
        self.assertEqual(values['tracker_fixes_fused'], values['fixes'] - values['fixes_wrong'])
        self.assertEqual(values['tracker_fixes_other'], 0)
        self.assertLess(values['fix_position_error_median_m'], 0.4)
        self.assertEqual(values['tf_publishers']['world -> mav_map'], ['ekf_tracker'])
        self.assertIn('Majdik', output)
        self.assertIn(f'replay complete: results in {out}', output)
        self.assertNotIn('has died', output)
        for name in ('trajectories.png', 'uncertainty.png'):
            self.assertGreater(os.path.getsize(os.path.join(out, name)), 20000)
        for name in ('tracker', 'vo', 'gps', 'truth'):
            self.assertGreater(len(evaluation.read_tum(os.path.join(out, f'{name}_trajectory.txt'))), 20)

    def test_the_terrain_is_no_building(self):
        with tempfile.TemporaryDirectory() as folder:
            write_database(os.path.join(folder, 'x.gpkg'))
            self.assertEqual(city_database.read_city(os.path.join(folder, 'x.gpkg')).triangles.max(), 30)

    def test_tracker_that_never_starts(self):
        _, values, output = self.run_replay(fix_period=1000.0, fix_delay=1000.0)
        self.assertFalse(values['tracker_started'])
        self.assertNotIn('tracker_position_error_mean_m', values)
        self.assertIn('never started', output)
        self.assertNotIn('has died', output)


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'city_report_test', CityReport)
