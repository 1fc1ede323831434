#!/usr/bin/env python3
"""Kalibr's files, written here with known content, must come out of import_kalibr as camera_info, transforms and parameters of that content."""
import os
import shlex
import subprocess
import sys
import tempfile
import unittest

import numpy as np
import rosbag
import rospy
import rostest
import yaml
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path.insert(0, os.path.join(HERE, '..', 'scripts'))
from air_ground_eval import calibration, calibration_files, geometry, messages  # noqa: E402
from air_ground_eval.recording import Camera  # noqa: E402

# The camera looks down, the IMU's axes are the body's, the camera 10 cm ahead of it: in the camera the IMU lies 10 cm towards +y (the image's
# bottom), since the image's top points ahead.
T_CAM_IMU = [[0.0, -1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.1], [0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
CHAIN = {'cam0': {'T_cam_imu': T_CAM_IMU, 'camera_model': 'pinhole', 'distortion_model': 'radtan', 'distortion_coeffs': [-0.28, 0.07, 0.0002, 1.8e-05],
                  'intrinsics': [458.6, 457.3, 367.2, 248.4], 'resolution': [752, 480], 'rostopic': '/cam0/image_raw', 'timeshift_cam_imu': -8.121e-05},
         'cam1': {'camera_model': 'pinhole', 'distortion_model': 'equidistant', 'distortion_coeffs': [-0.01, 0.02, -0.03, 0.004],
                  'intrinsics': [190.9, 190.8, 254.9, 256.8], 'resolution': [512, 512], 'rostopic': '/cam1/image_raw/compressed', 'timeshift_cam_imu': 0.025},
         'cam2': {'camera_model': 'omni', 'distortion_model': 'equidistant', 'distortion_coeffs': [0, 0, 0, 0], 'intrinsics': [1.2, 600, 600, 300, 300],
                  'resolution': [600, 600]}}
# Of EuRoC's MAV, in its own file and in those of others: where cam0 is in the body, which is the IMU.
EUROC_BODY_CAM = [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975, 0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,
                  -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949, 0.0, 0.0, 0.0, 1.0]
ROWS = '\n'.join(f'    - {EUROC_BODY_CAM[4 * i:4 * i + 4]}' for i in range(4))
MATRIX = f'!!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n   data: {EUROC_BODY_CAM}\n'
ROTATION = [EUROC_BODY_CAM[4 * i + j] for i in range(3) for j in range(3)]
EUROC_TERMS = [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
VINS = f'''%YAML:1.0
imu_topic: "/imu0"
image_topic: "/cam0/image_raw"
model_type: PINHOLE
image_width: 752
image_height: 480
distortion_parameters:
   k1: -0.28340811
   k2: 0.07395907
   p1: 0.00019359
   p2: 1.76187114e-05
projection_parameters:
   fx: 458.654
   fy: 457.296
   cx: 367.215
   cy: 248.375
acc_n: 0.08
td: -0.003
'''
EUROC_FILES = {
    'cam0/sensor.yaml': f'''# General sensor definitions.
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: {EUROC_BODY_CAM}
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: {EUROC_TERMS}
''',
    'openvins.yaml': f'''%YAML:1.0

cam0:
  T_imu_cam: #rotation from camera to IMU R_CtoI, position of camera in IMU p_CinI
{ROWS}
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: {EUROC_TERMS}
  distortion_model: radtan
  intrinsics: [458.654,457.296,367.215,248.375] #fu, fv, cu, cv
  resolution: [752, 480]
  rostopic: /cam0/image_raw
''',
    'orb_slam.yaml': f'''%YAML:1.0
---
Camera.type: "PinHole"
Camera1.fx: 458.654
Camera1.fy: 457.296
Camera1.cx: 367.215
Camera1.cy: 248.375
Camera1.k1: -0.28340811
Camera1.k2: 0.07395907
Camera1.p1: 0.00019359
Camera1.p2: 1.76187114e-05
Camera.width: 752
Camera.height: 480
IMU.T_b_c1: {MATRIX}IMU.NoiseGyro: 1.7e-04
IMU.AccWalk: 3.0000e-03
''',
    'vins.yaml': f'{VINS}extrinsicRotation: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {ROTATION}\n'
                 f'extrinsicTranslation: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: {EUROC_BODY_CAM[3:12:4]}\n',
    'vins_fusion.yaml': f'{VINS}body_T_cam0: {MATRIX}',
    'rpg.yaml': f'''label: euroc
cameras:
- T_B_C: {{cols: 4, rows: 4, data: {EUROC_BODY_CAM}}}
  camera:
    type: pinhole
    image_width: 752
    image_height: 480
    intrinsics: {{cols: 1, rows: 4, data: [458.654, 457.296, 367.215, 248.375]}}
    distortion: {{type: radial-tangential, parameters: {{cols: 1, rows: 4, data: {EUROC_TERMS}}}}}
'''}
IMU = {'accelerometer_noise_density': 2e-3, 'accelerometer_random_walk': 3e-3, 'gyroscope_noise_density': 1.6968e-04, 'gyroscope_random_walk': 1e-05,
       'rostopic': '/imu0', 'update_rate': 200.0}


class ImportKalibr(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory(prefix='a folder with spaces ')
        self.addCleanup(temporary.cleanup)
        self.folder = temporary.name
        for name, content in (('camchain.yaml', CHAIN), ('imu.yaml', IMU)):
            with open(self.path(name), 'w', encoding='utf-8') as stream:
                yaml.safe_dump(content, stream)

    def path(self, *names):
        return os.path.join(self.folder, *names)

    def run_import(self, *arguments):
        return subprocess.run(['/usr/bin/python3', os.path.join(HERE, '..', 'scripts', 'import_kalibr'), self.path('camchain.yaml'), *arguments,
                               '--out', self.path('out')], capture_output=True, text=True, check=False)

    def write(self, name, text):
        os.makedirs(os.path.dirname(self.path(name)), exist_ok=True)
        with open(self.path(name), 'w', encoding='utf-8') as stream:
            stream.write(text)
        return self.path(name)

    def test_one_camera_in_the_files_of_all(self):
        for name, text in EUROC_FILES.items():
            found = calibration_files.read_camera(self.write(name, text))
            self.assertTrue(np.allclose(geometry.inverse(found.T_camera_body), np.reshape(EUROC_BODY_CAM, (4, 4)), atol=1e-6), name)
            camera = found.camera
            self.assertEqual((camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.model), (752, 480, 458.654, 457.296, 367.215, 248.375, 'plumb_bob'), name)
            self.assertTrue(np.allclose(camera.distortion, [*EUROC_TERMS, 0]), name)
            self.assertEqual((found.time_offset, found.imu_topic), (-0.003, '/imu0') if 'vins' in name and name != 'openvins.yaml' else (None, ''), name)
            self.assertEqual(found.topic, '' if name.startswith(('orb', 'rpg')) else '/cam0/image_raw', name)
            self.assertEqual(found.noise, {'gyro_noise_density': 1.7e-4, 'accel_bias_walk': 3e-3} if name == 'orb_slam.yaml' else {})

    def test_eurocs_files_make_a_command(self):
        """T_BS of the IMU counts, too: the camera and it are told in one body."""
        camera = self.write('cam0/sensor.yaml', EUROC_FILES['cam0/sensor.yaml'])
        T_body_imu = geometry.pose(geometry.rotation_z(0.5), (0.3, 0, 0))
        imu = self.write('imu0/sensor.yaml', yaml.safe_dump({'sensor_type': 'imu', 'T_BS': {'cols': 4, 'rows': 4, 'data': T_body_imu.ravel().tolist()}, **IMU, 'rostopic': ''}))
        result = subprocess.run(['/usr/bin/python3', os.path.join(HERE, '..', 'scripts', 'import_kalibr'), camera, imu, '--mount', 'forward', '--out', self.path('out')],
                                capture_output=True, text=True, check=False)
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn('mav_image:=/cam0/image_raw mav_camera_info:=/cam0/camera_info mav_imu:=/imu0', result.stdout)
        distance = np.linalg.norm(np.array(EUROC_BODY_CAM[3:12:4]) - [0.3, 0, 0])
        self.assertIn(f'{distance:.4f} m from the IMU', result.stdout)

    def test_files_that_are_none_of_these_are_named(self):
        for text, line in (('sensor_type: imu\nT_BS: {data: []}\n', "no camera's: name cam0/sensor.yaml first"), ('rate: 3\n', 'has no camera cam0; known are camchains of'),
                           ('cam_model: Polynomial\n', 'Pinhole and ATAN are'), ('Camera.type: Fisheye62\nCamera.fx: 3\n', 'Camera.type Fisheye62 is not known'),
                           ('Camera.type: PinHole\nCamera.fx: 3\n', "width and height (Camera.width, Camera.height) are missing")):
            with self.assertRaises(calibration.CalibrationError) as caught:
                calibration_files.read_camera(self.write('x.yaml', text))
            self.assertIn(line, str(caught.exception))

    def assert_sees(self, found, radius, largest=0.3):
        """An equidistant camera whose pixels lie where radius(theta) [px] of another model has them, within the image, and that says how nearly."""
        camera = found.camera
        self.assertEqual(camera.model, 'equidistant')
        corner = np.hypot(max(camera.cx, camera.width - 1 - camera.cx), max(camera.cy, camera.height - 1 - camera.cy))
        theta = np.linspace(0.01, np.radians(80), 400)
        theta = theta[radius(theta) < corner]
        fitted = camera.fx * theta * (1 + sum(k * theta ** (2 * i + 2) for i, k in enumerate(camera.distortion)))
        self.assertLess(np.abs(fitted - radius(theta)).max(), largest)
        self.assertIn('became equidistant', found.notes[0])

    def test_models_of_other_systems_become_equidistant(self):
        def kalibr(model, intrinsics, distortion='none', coefficients=(), size=(752, 480)):
            text = yaml.safe_dump({'cam0': {'camera_model': model, 'distortion_model': distortion, 'distortion_coeffs': list(coefficients), 'intrinsics': [float(x) for x in intrinsics],
                                            'resolution': list(size)}})
            return calibration_files.read_camera(self.write('other.yaml', text))

        for size, centre, f in (((752, 480), (376, 240), 300), ((512, 512), (255, 256), 190), ((1280, 1024), (640, 520), 500)):
            for w in (0.5, 0.93, 1.1):
                self.assert_sees(kalibr('pinhole', [f, f, *centre], 'fov', [w], size), lambda t, f=f, w=w: f / w * np.arctan(2 * np.tan(t) * np.tan(w / 2)))
            for xi, alpha in ((-0.18, 0.59), (-0.25, 0.565)):
                self.assert_sees(kalibr('ds', [xi, alpha, f, f, *centre], size=size), lambda t, f=f, x=xi, a=alpha: f * np.sin(t) / (
                    a * np.sqrt(np.sin(t) ** 2 + (x + np.cos(t)) ** 2) + (1 - a) * (x + np.cos(t))))
            for alpha, beta in ((0.63, 1.04), (0.5, 1.2)):
                self.assert_sees(kalibr('eucm', [alpha, beta, f, f, *centre], size=size), lambda t, f=f, a=alpha, b=beta: f * np.sin(t) / (
                    a * np.sqrt(b * np.sin(t) ** 2 + np.cos(t) ** 2) + (1 - a) * np.cos(t)))
            for xi, terms in ((0.9, (0, 0, 0, 0)), (1.9, (-0.1, 0.2, 0, 0))):
                def mei(t, f=f, xi=xi, terms=terms):
                    r = np.sin(t) / (np.cos(t) + xi)
                    return f * (1 + xi) * r * (1 + terms[0] * r ** 2 + terms[1] * r ** 4)
                self.assert_sees(kalibr('omni', [xi, f * (1 + xi), f * (1 + xi), *centre], 'radtan', terms, size), mei)
        # No equidistant camera has a lens as crooked as this.
        with self.assertRaisesRegex(calibration.CalibrationError, r'comes no nearer than [0-9.]+ px.*calibrate as pinhole-equi'):
            kalibr('omni', [1.2, 900, 900, 376, 240], 'radtan', [-0.1, 0.05, 0.02, -0.02])

    def test_fov_of_ptam_and_svo_and_the_others(self):
        def fov(f, w):
            return lambda t: f / w * np.arctan(2 * np.tan(t) * np.tan(w / 2))
        files = {'svo.yaml': 'cam_model: ATAN\ncam_width: 752\ncam_height: 480\ncam_fx: 0.509\ncam_fy: 0.797\ncam_cx: 0.496\ncam_cy: 0.513\ncam_d0: 0.93\n',
                 'ptam.yaml': 'ImageSizeX: 752\nImageSizeY: 480\nCam_fx: 0.509\nCam_fy: 0.797\nCam_cx: 0.496\nCam_cy: 0.513\nCam_s: 0.93\n'}
        for name, text in files.items():
            found = calibration_files.read_camera(self.write(name, text))
            self.assertAlmostEqual(found.camera.cx, 0.496 * 752 - 0.5)
            self.assertAlmostEqual(found.camera.fy / found.camera.fx, 0.797 * 480 / (0.509 * 752), places=3)
            self.assert_sees(found, fov(0.509 * 752, 0.93))
        mei = VINS.replace('PINHOLE', 'MEI').replace('fx', 'gamma1').replace('fy', 'gamma2').replace('cx', 'u0').replace('cy', 'v0').replace('-0.283', '0').replace('p1: 0.00019359', 'p1: 0.0')
        found = calibration_files.read_camera(self.write('mei.yaml', f'{mei}mirror_parameters:\n   xi: 1.9\n'))
        self.assertAlmostEqual(found.camera.fx, 458.654 / 2.9, delta=0.5)
        basalt = ('{"value0": {"T_imu_cam": [{"px": 0.1, "py": 0, "pz": 0, "qx": 0, "qy": 0, "qz": 0, "qw": 1}], "resolution": [[512, 512]], "gyro_noise_std": [3e-4, 3e-4, 3e-4], '
                  '"intrinsics": [{"camera_type": "ds", "intrinsics": {"fx": 158, "fy": 158, "cx": 255, "cy": 256, "xi": -0.17, "alpha": 0.59}}]}}')
        found = calibration_files.read_camera(self.write('basalt.json', basalt))
        self.assertAlmostEqual(found.T_camera_body[0, 3], -0.1)
        self.assertAlmostEqual(found.noise['gyro_noise_density'], 3e-4)
        self.assert_sees(found, lambda t: 158 * np.sin(t) / (0.59 * np.sqrt(np.sin(t) ** 2 + (np.cos(t) - 0.17) ** 2) + 0.41 * (np.cos(t) - 0.17)))
        # OCamCalib: rho = 2 f tan(theta / 2), a stereographic lens, is z = rho^2 / (4 f) - f.
        ocam = '#polynomial coefficients for the DIRECT mapping\n\n3 -200 0 0.00125\n\n#inverse\n\n2 1 1\n\n#center\n\n239.5 380\n\n#affine\n\n1 0 0\n\n#size\n\n480 752\n'
        found = calibration_files.read_camera(self.write('calib_results.txt', ocam))
        self.assertEqual((found.camera.width, found.camera.height, found.camera.cx, found.camera.cy), (752, 480, 380, 239.5))
        self.assert_sees(found, lambda t: 400 * np.tan(t / 2))

    def frames_of(self, image_frame, imu_frame):
        """(camera_frame, imu_frame of mav_vo.yaml, children in sensors.launch, printed) for a bag with these frames."""
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            bag.write('/cam0/image_raw', messages.image(np.zeros((480, 752)), 'mono8', 5, image_frame), messages.stamp(5))
            bag.write('/imu0', messages.imu([0, 0, 0], [0, 0, 9.81], 1, 1, 5, imu_frame), messages.stamp(5))
        result = self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag'))
        self.assertEqual(result.returncode, 0, result.stderr)
        with open(self.path('out', 'mav_vo.yaml'), encoding='utf-8') as stream:
            parameters = yaml.safe_load(stream)
        with open(self.path('out', 'sensors.launch'), encoding='utf-8') as stream:
            text = stream.read().replace('&quot;', '"')
        edges = [part.split()[:2] for part in text.split('--transform "')[1:]]
        self.assertEqual([edge[0] for edge in edges], ['mav_base_link'] * 2)
        return parameters['camera_frame'], parameters['imu_frame'], [edge[1] for edge in edges], result.stdout

    def test_frames_that_the_messages_do_not_name_or_share(self):
        for image_frame, imu_frame, camera, imu in (('left_eye', 'imu4', 'left_eye', 'imu4'), ('', 'imu4', 'mav_camera_optical_frame', 'imu4'),
                                                    ('left_eye', '', 'left_eye', 'mav_imu_link'), ('body', 'body', 'mav_camera_optical_frame', 'mav_imu_link'),
                                                    ('left_eye', 'mav_base_link', 'left_eye', 'mav_imu_link')):
            found = self.frames_of(image_frame, imu_frame)
            self.assertEqual(found[:3], (camera, imu, [camera, imu]))
            self.assertIn(f'mav_camera_frame:={camera}' if camera != 'mav_camera_optical_frame' else 'replay.launch', found[3])
            if image_frame == 'body':
                self.assertIn('body is the frame of more than one of camera, IMU and mav_base_link', found[3])

    def test_camera_info_and_parameters(self):
        result = self.run_import(self.path('imu.yaml'))
        self.assertEqual(result.returncode, 0, result.stderr)
        info = calibration.read_camera_info(self.path('out', 'camera_info.yaml'))
        self.assertEqual((info.width, info.height, info.distortion_model), (752, 480, 'plumb_bob'))
        self.assertTrue(np.allclose(info.K, [458.6, 0, 367.2, 0, 457.3, 248.4, 0, 0, 1]))
        self.assertTrue(np.allclose(info.D, [-0.28, 0.07, 0.0002, 1.8e-05, 0]))
        with open(self.path('out', 'mav_vo.yaml'), encoding='utf-8') as stream:
            parameters = yaml.safe_load(stream)
        for name, value in (('gyro_noise_density', 1.6968e-4), ('accel_noise_density', 2e-3), ('gyro_bias_walk', 1e-5), ('accel_bias_walk', 3e-3)):
            self.assertIsInstance(parameters[name], float)
            self.assertAlmostEqual(parameters[name], value, places=9)
        self.assertIn('mav_image:=/cam0/image_raw mav_camera_info:=/cam0/camera_info mav_imu:=/imu0', result.stdout)

    def test_parameters_set_by_hand_are_kept_beside(self):
        """Run again, it writes over nothing: what is otherwise goes into earlier-1, then earlier-2; what is the same stays."""
        def text(*names):
            with open(self.path('out', *names), encoding='utf-8') as stream:
                return stream.read()

        first = self.run_import(self.path('imu.yaml'))
        self.assertNotIn('earlier', first.stdout)
        self.assertNotIn('earlier', self.run_import(self.path('imu.yaml')).stdout)
        written = text('mav_vo.yaml')
        for name in ('earlier-1', 'earlier-2'):
            tuned = written + f'# tuned before {name}\n'
            self.write(os.path.join('out', 'mav_vo.yaml'), tuned)
            result = self.run_import(self.path('imu.yaml'))
            self.assertEqual(result.returncode, 0, result.stderr)
            self.assertIn(f'mav_vo.yaml moved to {self.path("out", name)}: set again what was set there by hand', result.stdout)
            self.assertEqual((os.listdir(self.path('out', name)), text(name, 'mav_vo.yaml'), text('mav_vo.yaml')), (['mav_vo.yaml'], tuned, written))
        self.run_import(self.path('imu.yaml'), '--mount', 'forward')
        self.assertEqual(os.listdir(self.path('out', 'earlier-3')), ['sensors.launch'])

    def test_values_replace_lines_commented_or_not(self):
        text, unknown = calibration.filled_in('# time_offset: 0        # [s] (-0.1..0.1)\nrate: 3\n', {'time_offset': -8.1e-05, 'other': 1.0}, 'x')
        self.assertEqual(yaml.safe_load(text), {'time_offset': -8.1e-05, 'rate': 3})
        self.assertEqual(unknown, ['other'])
        self.assertIn('# [s] (-0.1..0.1)', text)

    def test_fisheye_and_refusals(self):
        result = self.run_import('--camera', 'cam1')
        self.assertEqual(result.returncode, 0, result.stderr)
        info = calibration.read_camera_info(self.path('out', 'camera_info.yaml'))
        self.assertEqual(info.distortion_model, 'equidistant')
        self.assertTrue(np.allclose(info.D, [-0.01, 0.02, -0.03, 0.004]))
        self.assertIn('does not say where the camera is to the IMU', result.stdout)
        self.assertIn('mav_image:=/cam1/image_raw ', result.stdout)
        for camera, text in (('cam2', 'camera model omni with the distortion equidistant'), ('cam7', 'no camera cam7; it has cam0, cam1, cam2')):
            result = self.run_import('--camera', camera)
            self.assertEqual(result.returncode, 1)
            self.assertIn(text, result.stderr)
            self.assertEqual(len(result.stderr.splitlines()), 1, result.stderr)
        with open(self.path('camchain.yaml'), 'w', encoding='utf-8') as stream:
            stream.write('cam0: [\n')
        result = self.run_import()
        self.assertEqual((result.returncode, len(result.stderr.splitlines())), (1, 1), result.stderr)

    def test_the_command_names_the_ground_robots_inputs_too(self):
        """A bag without calibration and mounting of the MAV, and a ground robot of which nothing is as the launch files have it."""
        eye = Camera(64, 48, 60, 60, 32, 24)
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            edges = [('base_footprint', 'base', np.eye(4)), ('base', 'eye', np.eye(4)), ('base', 'depth_eye', np.eye(4))]
            messages.write_latched(bag, '/tf_static', messages.static_transforms(edges, 99), 99)
            for t in np.arange(100, 102, 0.05):
                bag.write('/cam0/image_raw', messages.image(np.zeros((48, 64)), 'mono8', t, 'cam0'), messages.stamp(t))
                for s in t + np.arange(0, 0.05, 0.005):
                    bag.write('/imu0', messages.imu([0.01, 0, 0], [0, 0, 9.81], 1e-6, 1e-4, s, 'imu0'), messages.stamp(s))
                bag.write('/camera/color/image_raw', messages.image(np.zeros((48, 64, 3)), 'rgb8', t, 'eye'), messages.stamp(t))
                bag.write('/camera/depth/image_raw', messages.image(np.full((48, 64), 20000), '16UC1', t, 'depth_eye'), messages.stamp(t))
                for name, frame in (('color', 'eye'), ('depth', 'depth_eye')):
                    bag.write(f'/camera/{name}/camera_info', messages.camera_info(eye, t, frame), messages.stamp(t))
                bag.write('/camera/imu', messages.imu([0.01, 0, 0], [0, 0, 9.81], 1e-6, 1e-4, t, 'floating'), messages.stamp(t))
        result = self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag'))
        self.assertEqual(result.returncode, 0, result.stderr)
        words = shlex.split(result.stdout.splitlines()[-1])
        for word in ('ground_base_frame:=base', 'ground_camera_frame:=eye', 'ground_depth_registered:=false', 'ground_depth_camera_info:=/camera/depth/camera_info',
                     'ground_imu:=none', 'ground_depth_unit:=0.0002', 'mav_imu:=/imu0', 'mav_camera_frame:=cam0'):
            self.assertIn(word, words)
        self.assertFalse([word for word in words if word.startswith(('mav_base_frame', 'mav_use_imu', 'ground_imu:=/'))], words)

    def test_gravity_tells_which_way_the_camera_looks(self):
        """The IMU's axes are the camera's: x right, y down, z ahead."""
        self.write('camchain.yaml', yaml.safe_dump({'cam0': {**CHAIN['cam0'], 'T_cam_imu': np.eye(4).tolist()}}))
        for below, looks, ahead in ((25, 'forward', [1, 0, 0]), (60, 'down', [0, 0, -1])):
            up = [0, -np.cos(np.radians(below)), -np.sin(np.radians(below))]
            with rosbag.Bag(self.path('x.bag'), 'w') as bag:
                bag.write('/cam0/image_raw', messages.image(np.zeros((480, 752)), 'mono8', 5, 'eye'), messages.stamp(5))
                bag.write('/imu0', messages.imu([0, 0, 0], [9.81 * x for x in up], 1, 1, 5, 'imu'), messages.stamp(5))
            result = self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag'))
            self.assertIn(f'looks {looks} ({below} degrees below', result.stdout, result.stderr)
            with open(self.path('out', 'sensors.launch'), encoding='utf-8') as stream:
                numbers = [float(x) for x in stream.read().split('mav_base_link eye ')[1].split('"')[0].split()]
            np.testing.assert_allclose(geometry.pose_from_tq(numbers[:3], numbers[3:])[:3, 2], ahead, atol=1e-6)
        self.assertIn('looks down\n', self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag'), '--mount', 'down').stdout)
        self.assertIn('taken to look down; --mount forward', self.run_import(self.path('imu.yaml')).stdout)

    def test_what_the_ground_robot_needs_beside_the_replay_is_printed_too(self):
        """The mounting that nothing tells, once, as check_bag prints it: without it the ground robot has no pose."""
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            for t in np.arange(100, 102, 0.05):
                bag.write('/cam0/image_raw', messages.image(np.zeros((48, 64)), 'mono8', t, 'cam0'), messages.stamp(t))
                bag.write('/imu0', messages.imu([0.01, 0, 0], [0, 0, 9.81], 1e-6, 1e-4, t, 'imu0'), messages.stamp(t))
                bag.write('/camera/color/image_raw', messages.image(np.zeros((48, 64, 3)), 'rgb8', t, 'eye'), messages.stamp(t))
                bag.write('/camera/color/camera_info', messages.camera_info(Camera(64, 48, 60, 60, 32, 24), t, 'eye'), messages.stamp(t))
                bag.write('/camera/aligned_depth_to_color/image_raw', messages.image(np.full((48, 64), 1500), '16UC1', t, 'eye'), messages.stamp(t))
        lines = self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag')).stdout.splitlines()[-3:]
        self.assertEqual([shlex.split(line, comments=True)[0] for line in lines], ['roslaunch', 'rosrun', 'roslaunch'], lines)
        self.assertEqual(shlex.split(lines[1], comments=True)[1:], ['air_ground', 'publish_calibration', '--transform', 'ground_base_link eye 0 0 0 -0.5 0.5 -0.5 0.5', '&'])

    def test_what_is_the_mavs_is_not_the_ground_robots(self):
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            for t in (5, 6):
                for topic, kind, shape in (('/cam0/image_raw', 'mono8', (48, 64)), ('/cam0/depth', '16UC1', (48, 64))):
                    bag.write(topic, messages.image(np.full(shape, 1500 if kind == '16UC1' else 0), kind, t, 'left_eye'), messages.stamp(t))
                bag.write('/imu0', messages.imu([0, 0, 0], [0, 0, 9.81], 1, 1, t, 'imu_of_mine'), messages.stamp(t))
        words = shlex.split(self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag')).stdout.splitlines()[-1])
        self.assertIn('rgbd_slam:=false', words)
        self.assertFalse([word for word in words if word.startswith('ground_')], words)

    def test_a_recorded_camera_info_stays_alone_on_its_topic(self):
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            bag.write('/cam0/image_raw', messages.image(np.zeros((480, 752)), 'mono8', 5, 'left_eye'), messages.stamp(5))
            bag.write('/cam0/camera_info', CameraInfo(width=752, height=480, K=[400, 0, 376, 0, 400, 240, 0, 0, 1]), messages.stamp(5))
            bag.write('/imu0', messages.imu([0, 0, 0], [0, 0, 9.81], 1, 1, 5, 'imu_of_mine'), messages.stamp(5))
        result = self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag'))
        self.assertEqual(result.returncode, 0, result.stderr)
        self.assertIn('mav_camera_info:=/cam0/camera_info_kalibr', shlex.split(result.stdout.splitlines()[-1]))
        with open(self.path('out', 'sensors.launch'), encoding='utf-8') as stream:
            self.assertIn('to="/cam0/camera_info_kalibr"', stream.read())

    def test_launch_file_publishes_transforms_and_camera_info(self):
        with rosbag.Bag(self.path('x.bag'), 'w') as bag:
            bag.write('/cam0/image_raw', messages.image(np.zeros((480, 752)), 'mono8', 5, 'left_eye'), messages.stamp(5))
            bag.write('/imu0', messages.imu([0, 0, 0], [0, 0, 9.81], 1, 1, 5, 'imu_of_mine'), messages.stamp(5))
        result = self.run_import(self.path('imu.yaml'), '--bag', self.path('x.bag'))
        self.assertEqual(result.returncode, 0, result.stderr)
        words = shlex.split(result.stdout.splitlines()[-1])
        self.assertEqual(words[:2], ['roslaunch', '--wait'], 'the first command starts the master')
        for word in (f'bag:={self.path("x.bag")}', 'mav_image:=/cam0/image_raw', 'mav_camera_info:=/cam0/camera_info', 'mav_imu:=/imu0',
                     'mav_camera_frame:=left_eye', 'rgbd_slam:=false', f'mav_vo_config:={self.path("out", "mav_vo.yaml")}'):
            self.assertIn(word, words)
        rospy.init_node('import_kalibr_test', anonymous=True)
        infos, edges = [], {}
        rospy.Subscriber('/cam0/camera_info', CameraInfo, infos.append)
        rospy.Subscriber('/tf_static', TFMessage, lambda m: edges.update({e.child_frame_id: e for e in m.transforms}))
        images, jpegs = rospy.Publisher('/cam0/image_raw', Image, queue_size=5), rospy.Publisher('/cam0/image_raw/compressed', CompressedImage, queue_size=5)
        process = subprocess.Popen(['roslaunch', self.path('out', 'sensors.launch')], stdout=subprocess.DEVNULL)

        def publish_until(done, publish):
            for i in range(200):
                if done():
                    break
                publish(i)
                rospy.rostime.wallsleep(0.1)

        try:
            publish_until(lambda: len(edges) == 2 and infos, lambda i: jpegs.publish(CompressedImage(header=Header(stamp=messages.stamp(50 + 0.1 * i), frame_id='left_eye'), format='jpeg')))
            self.assertLess(infos[0].header.stamp.to_sec(), 100, 'of compressed images alone')
            publish_until(lambda: infos[-1].header.stamp.to_sec() >= 100, lambda i: images.publish(messages.image(np.zeros((480, 752)), 'mono8', 100 + i, 'left_eye')))
            publish_until(lambda: jpegs.get_num_connections() == 0, lambda i: None)
            self.assertEqual(jpegs.get_num_connections(), 0, 'nobody needs them beside the raw ones')
        finally:
            process.terminate()
            process.wait(30)
        self.assertEqual(infos[-1].header.frame_id, 'left_eye')
        self.assertGreaterEqual(infos[-1].header.stamp.to_sec(), 100)
        self.assertEqual(infos[0].width, 752)
        t = edges['left_eye'].transform.translation
        self.assertEqual(edges['left_eye'].header.frame_id, 'mav_base_link')
        self.assertTrue(np.allclose([t.x, t.y, t.z], [0.1, 0, 0], atol=1e-8), t)
        t, q = edges['imu_of_mine'].transform.translation, edges['imu_of_mine'].transform.rotation
        self.assertTrue(np.allclose(geometry.pose_from_tq([t.x, t.y, t.z], [q.x, q.y, q.z, q.w]), np.eye(4), atol=1e-8))


if __name__ == '__main__':
    rostest.rosrun('air_ground', 'import_kalibr_test', ImportKalibr)
