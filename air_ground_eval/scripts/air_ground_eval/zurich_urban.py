"""Reader of the Zurich Urban MAV layout (Majdik, Till, Scaramuzza 2017): images of a side-looking camera, the autopilot's logs, Street View.

The folder AGZ holds `MAV Images`, `Log Files`, `Street View Images` and calibration_data.npz; logs alone will do, also without that subfolder.
World is the local frame, true east, north, up, at `origin` of `crs` (of the configuration): those of the Street View database. Without them, near the
first pose, in the ground truth's UTM; with `crs` alone there too, but in that system. What the data set leaves open:

- The IMU's mounting. The readings are the autopilot's, x ahead, y right, z down; the camera looks to the vehicle's left (it flies to the camera's
  right all along). `imu_from_camera` of the calibration file (translation_m, quaternion_xyzw) replaces that.
- Where views of the panoramas look: `left...` to the left of the headings in StreetViewGPS.csv; `view_turn_deg` of the calibration file replaces that.
- Heights of the panoramas: the nearest true position of the MAV less `flight_height_m`.
- The tilts of the Street View images: their sign is not described, so they are left out.
"""
import glob
import os
import re

import numpy as np

from . import geometry
from .city_database import CityError, WorldFrame, converted, origin_text
from .recording import DatasetError, Frame, Gps, Imu, Pressure, Recording, camera_from_config, orthonormal_pose, read_image

CRS = 'EPSG:32632'  # of the ground truth
LV95 = 'EPSG:2056'  # of Zurich's city models
FARTHEST = 100e3  # of the flight from the origin of world [m]
GEOID_UNDULATION = 47.3  # in Zurich [m]: the logs' heights are above the sea
GPS_STDDEV = (5.0, 10.0)  # horizontal, vertical [m], where the log states none
IMAGES, LOGS, PANORAMAS = 'MAV Images', 'Log Files', 'Street View Images'
R_FORWARD_DOWN = np.diag([1.0, -1.0, -1.0])  # x ahead, y right, z down, in x ahead, y left, z up


def log_folder(folder):
    """Where the logs lie, None for another layout."""
    for path in (os.path.join(folder, LOGS), folder):
        if os.path.isfile(os.path.join(path, 'RawAccel.csv')) or os.path.isfile(os.path.join(path, 'GroundTruthAGL.csv')):
            return path
    return None


def read_rows(path, columns):
    """The first columns of a log: numbers, (n, columns). An empty array where there is no such file. Rows end in stray commas."""
    if not os.path.isfile(path):
        return np.zeros((0, columns))
    rows = []
    with open(path, encoding='utf-8', errors='replace') as stream:
        for number, line in enumerate(stream, 1):
            words = [word.strip() for word in line.split(',')]
            if number == 1 or not words[0] or words[0].startswith('#'):
                continue
            try:
                rows.append([float(word) for word in words[:columns]])
            except ValueError as error:
                raise DatasetError(f'{path}:{number}: {error}') from error
            if len(rows[-1]) != columns:
                raise DatasetError(f'{path}:{number}: expected {columns} columns')
    return np.array(rows).reshape(-1, columns)


def increasing(rows, column=0):
    """The rows whose stamp is later than all before."""
    if not len(rows):
        return rows
    before = np.concatenate([[-np.inf], np.maximum.accumulate(rows[:-1, column])])
    return rows[rows[:, column] > before]


def numbered(folder):
    """number -> path of the images in a folder, by the last number in their names."""
    result = {}
    for path in sorted(glob.glob(os.path.join(folder, '*'))):
        match = re.search(r'(\d+)\D*\.(jpg|jpeg|png)$', os.path.basename(path), re.IGNORECASE)
        if match:
            result.setdefault(int(match.group(1)), path)
    return result


class Surroundings:
    """World of the flight: what turns the data set's coordinates into it."""

    def __init__(self, config, first):
        self.crs = config.get('crs', CRS)
        self.undulation = float(config.get('geoid_undulation_m', GEOID_UNDULATION))
        try:
            import pyproj
            self.origin = [float(x) for x in config['origin']] if 'origin' in config else self.default_origin(first)
            self.frame = WorldFrame(self.crs, self.origin, self.undulation)
            self.to_geodetic = pyproj.Transformer.from_crs(CRS, 'EPSG:4326', always_xy=True)
        except (ImportError, CityError) as error:
            raise DatasetError(f'{self.crs}: {error}') from error
        except (TypeError, ValueError, IndexError) as error:
            raise DatasetError(f'origin: expected easting, northing and height in {self.crs}, as [465666, 5247973, 469] in {CRS}') from error
        away = np.linalg.norm(self.positions(np.array([first]))[0])
        if not away <= FARTHEST:
            raise DatasetError(f'origin {origin_text(self.origin)} of --config lies {away / 1000:.0f} km from the flight: it counts in {self.crs}, '
                               f'where the flight begins at {origin_text(converted(first, CRS, self.crs))}')
        ends = self.positions(np.array([first, first + [0, 1000.0, 0]]))
        east, north = (ends[1] - ends[0])[:2]
        self.convergence = np.arctan2(east, north)  # from true to grid north, clockwise [rad]

    def default_origin(self, first):
        """Whole metres of `crs` near the first position, degrees to 1e-6 where that is geographic."""
        import pyproj
        place = np.array(first if self.crs == CRS else converted(first, CRS, self.crs), float)
        place[:2] = np.floor(place[:2]) if pyproj.CRS(self.crs).is_projected else np.round(place[:2], 6)
        return [float(place[0]), float(place[1]), float(np.floor(place[2]))]

    def description(self):
        """Where world lies, for who builds the database: --origin counts in the city model's system."""
        text = f'origin of world: {origin_text(self.origin)} in {self.crs}'
        if self.crs == LV95:
            return text
        return f'{text}; for a city model in {LV95}: --origin {origin_text(converted(self.origin, self.crs, LV95))}'

    def geodetic(self, positions):
        """(n, 3) latitude, longitude [deg], height above the ellipsoid [m] of positions in CRS, height above the sea."""
        longitude, latitude = self.to_geodetic.transform(positions[:, 0], positions[:, 1])
        return np.stack([latitude, longitude, positions[:, 2] + self.undulation], 1)

    def positions(self, positions):
        """(n, 3) in world."""
        return self.frame.from_geodetic(*self.geodetic(positions).T)

    def poses(self, rows):
        """T_world_camera of rows x, y, z, omega, phi, kappa [m, deg]: R_grid_camera = Rx Ry Rz, camera axes x right, y up, z backwards."""
        rotations = geometry.rotation_from_axes('XYZ', np.radians(rows[:, 3:6])) @ R_FORWARD_DOWN
        poses = np.tile(np.eye(4), (len(rows), 1, 1))
        poses[:, :3, :3] = geometry.rotation_z(-self.convergence) @ rotations
        poses[:, :3, 3] = self.positions(rows[:, :3])
        return poses


def read_camera(folder, config, size):
    """From the calibration file, else from calibration_data.npz: a 3x3 matrix and 4 or 5 coefficients."""
    if 'colour_camera' in config:
        return camera_from_config(config['colour_camera'], 'colour_camera', size)
    path = os.path.join(folder, 'calibration_data.npz')
    try:
        arrays = [np.asarray(a) for a in np.load(path).values()]
        K = next(a for a in arrays if a.shape == (3, 3))
        distortion = next(a.ravel() for a in arrays if a.size in (4, 5))
    except (OSError, ValueError, StopIteration) as error:
        raise DatasetError(f'{path}: no calibration (a 3x3 matrix and 4 or 5 coefficients): give --config with colour_camera') from error
    return camera_from_config({'fx_px': K[0, 0], 'fy_px': K[1, 1], 'cx_px': K[0, 2], 'cy_px': K[1, 2], 'distortion': [*distortion, 0.0][:5]}, path, size)


def read_gps(logs, stamps, truth, world, notes):
    """The receiver's log, else the positions beside the ground truth."""
    found = sorted(glob.glob(os.path.join(logs, 'On*GPS.csv')))
    if found:
        rows = increasing(read_rows(found[0], 10))
        rows = rows[rows[:, 7] >= 3]
        # Its readme has 1e-7 degrees and millimetres; logs in degrees and metres go round, too.
        degree, metre = (1.0, 1.0) if len(rows) and np.median(np.abs(rows[:, 2:4])) <= 180 else (1e-7, 1e-3)
        return Gps(rows[:, 0] * 1e-6, np.column_stack([degree * rows[:, 2:4], metre * rows[:, 4] + world.undulation]), rows[:, 8:10])
    if not len(truth):
        return None
    notes.append(f'no receiver log: GPS is that beside the ground truth, one a second, its standard deviations taken as {GPS_STDDEV[0]:g} and {GPS_STDDEV[1]:g} m')
    return Gps(stamps, world.geodetic(truth[:, 7:10]), np.tile(GPS_STDDEV, (len(truth), 1)))


def read_geotags(folder, logs, truth, config, notes):
    """Lines of the CSV that build_streetview_db reads."""
    rows = read_rows(os.path.join(logs, 'StreetViewGPS.csv'), 3)
    if not len(rows) or not len(truth):
        return []
    world = Surroundings({'origin': truth[0, 1:4]}, truth[0, 1:4])
    around = world.positions(np.concatenate([truth[:, 1:3], truth[:, 3:4]], 1))
    places = world.frame.from_geodetic(rows[:, 0], rows[:, 1], np.full(len(rows), truth[0, 3] + world.undulation))
    images = numbered(os.path.join(folder, PANORAMAS))
    sides = {os.path.basename(image).lower()[:4] for image in images.values()}
    turn = float(config.get('view_turn_deg', 90.0 if sides == {'left'} else -90.0 if sides == {'righ'} else 0.0))  # to the left
    if turn:
        notes.append(f'{PANORAMAS} taken to look {abs(turn):g} degrees to the {"left" if turn > 0 else "right"} of the headings in StreetViewGPS.csv, as their names say '
                     '(view_turn_deg of --config states another angle to the left). Views are no panoramas: give build_streetview_db their calibration (--camera), and --keep-unregistered where it cannot correct their poses')
    lines = ['image,lat,lon,alt,heading_deg']
    for i, (row, place) in enumerate(zip(rows, places), 1):
        near = np.argmin(np.linalg.norm(around[:, :2] - place[:2], axis=1))
        height = truth[near, 3] - float(config.get('flight_height_m', 7.5))
        image = os.path.basename(images[i]) if i in images else f'{i:03d}.jpg'
        lines.append(f'{image},{row[0]:.7f},{row[1]:.7f},{height:.2f},{(row[2] - turn) % 360:.2f}')
    return lines


def read_zurich_urban(folder, config):
    """The Recording; images are optional."""
    logs = log_folder(folder)
    if logs is None:
        raise DatasetError(f'{folder}: neither {LOGS}/RawAccel.csv nor {LOGS}/GroundTruthAGL.csv')
    recording = Recording(os.path.basename(os.path.normpath(folder)), [], None)
    notes = recording.notes
    times = read_rows(os.path.join(logs, 'GroundTruthAGM.csv'), 2)
    stamp_of = {int(image): stamp * 1e-6 for stamp, image in increasing(times)}
    if len(stamp_of) < len(times):
        notes.append(f'{len(times) - len(stamp_of)} images whose stamp is not later than the one before are left out')
    images = numbered(os.path.join(folder, IMAGES))
    recording.colour = [Frame(stamp, images[number]) for number, stamp in stamp_of.items() if number in images]
    if recording.colour:
        recording.camera = read_camera(folder, config, read_image(recording.colour[0].path).shape[1::-1])
        if len(recording.colour) < len(stamp_of):
            notes.append(f'{len(stamp_of) - len(recording.colour)} of {len(stamp_of)} images named in GroundTruthAGM.csv are missing')
    else:
        notes.append(f'no images in {os.path.join(folder, IMAGES)}: logs alone')

    accel, gyro = (increasing(read_rows(os.path.join(logs, f'Raw{name}.csv'), 5)) for name in ('Accel', 'Gyro'))
    if len(accel) and len(gyro):
        stamps = accel[:, 0] * 1e-6
        turn = np.stack([np.interp(stamps, gyro[:, 0] * 1e-6, gyro[:, axis]) for axis in (2, 3, 4)], 1)
        recording.imu = Imu(stamps, turn, accel[:, 2:5])
        notes.append(f'IMU: {1 / np.median(np.diff(stamps)):.0f} Hz')
    if 'imu_from_camera' in config:
        recording.T_imu_camera = orthonormal_pose(config['imu_from_camera'], 'imu_from_camera')
    else:  # the camera looks to the left
        recording.T_imu_camera = geometry.pose(R_FORWARD_DOWN @ geometry.rotation_z(np.pi / 2) @ geometry.R_BODY_FORWARD_CAMERA)
        notes.append('mounting of the IMU (imu_from_camera of --config) unknown: camera taken as looking to the left of the autopilot\'s x axis')
    barometer = increasing(read_rows(os.path.join(logs, 'BarometricPressure.csv'), 2))
    if len(barometer):
        recording.pressure = Pressure(barometer[:, 0] * 1e-6, 100 * barometer[:, 1])

    truth = read_rows(os.path.join(logs, 'GroundTruthAGL.csv'), 10)
    truth = truth[[int(number) in stamp_of for number in truth[:, 0]]] if len(truth) else truth
    if len(truth):
        world = Surroundings(config, truth[0, 1:4])
        recording.pose_stamps = np.array([stamp_of[int(number)] for number in truth[:, 0]])
        recording.poses = world.poses(truth[:, 1:7])
        recording.gps = read_gps(logs, recording.pose_stamps, truth, world, notes)
        notes.append(world.description())
        recording.city = {'crs': world.crs, 'origin': world.origin, 'geoid_undulation': world.undulation, 'geotags': 'geotags.csv',
                          'heading_reference': 'true_north', 'panoramas': os.path.abspath(os.path.join(folder, PANORAMAS))}
        recording.geotags = read_geotags(folder, logs, truth, config, notes)
    return recording
