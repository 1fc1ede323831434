"""What the report of a city replay takes from the Street View database: where world lies, the panoramas, the buildings.

Reads the GeoPackage with sqlite alone; a PostGIS database has to be exported first (ogr2ogr).
"""
import os
import sqlite3
from dataclasses import dataclass, field

import numpy as np

from .yaml_file import read_mapping


UNKNOWN_UNDULATION = -1000.0  # of ekf_tracker's parameter geoid_undulation [m]
SAME_ORIGIN = 0.05  # [m]
# Name in a city file, parameter of ekf_tracker, what becomes of the tracker without.
FACTS = (('geoid_undulation', 'geoid_undulation', 'GPS is used in plan only'), ('magnetic_declination', 'declination', 'the magnetometer is not used'))


class CityError(Exception):
    """One line that says what is wrong with a database or a city file."""


@dataclass
class City:
    """crs: projected system ('' for a local frame); origin: of world, in it; lengths in metres, coordinates in world."""
    crs: str = ''
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    panoramas: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    triangles: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3)))  # of all buildings, not of the terrain


def read_city(path):
    """City of a database that build_streetview_db made. CityError when it is none."""
    if path.startswith('PG:'):
        raise CityError('a PostGIS database is not read here: export it with ogr2ogr to a .gpkg')
    if not os.path.isfile(path):
        raise CityError(f'{path}: no such database')
    try:
        with sqlite3.connect(f'file:{path}?mode=ro', uri=True) as database:
            info = dict(database.execute('SELECT key, value FROM street_view_database'))
            panoramas = list(database.execute('SELECT x, y, z FROM panoramas WHERE views > 0'))
            triangles = [np.frombuffer(vertices, '<f4').reshape(-1, 3)[np.frombuffer(indices, '<i4').reshape(-1, 3)]
                         for vertices, indices in database.execute('SELECT vertices, triangles FROM buildings WHERE building_id IS NOT NULL')]
        origin = np.array([float(info[f'origin_{axis}']) for axis in 'xyz'])
    except (sqlite3.Error, KeyError, ValueError) as error:
        raise CityError(f'{path} is no complete Street View database: {error}') from error
    return City(info.get('crs', ''), origin, np.array(panoramas, float).reshape(-1, 3),
                np.concatenate(triangles).astype(float) if triangles else np.zeros((0, 3, 3)))


class WorldFrame:
    """WGS 84 to the world frame: true east, north, up at `origin` of `crs`, as air_ground_common/geodesy.h defines it.

    geoid_undulation: ellipsoidal height minus the height used in `origin` [m]; UNKNOWN_UNDULATION: heights pass as they are.
    """

    def __init__(self, crs, origin, geoid_undulation=0.0):
        try:
            import pyproj
        except ImportError as error:
            raise CityError('GPS is not drawn: python3-pyproj is not installed') from error
        try:
            to_geodetic = pyproj.Transformer.from_crs(crs, 'EPSG:4979', always_xy=True)
            longitude, latitude = to_geodetic.transform(origin[0], origin[1])
            self.to_cartesian = pyproj.Transformer.from_crs('EPSG:4979', 'EPSG:4978', always_xy=True)
        except pyproj.exceptions.ProjError as error:
            raise CityError(f'PROJ knows no coordinate system {crs}: {error}') from error
        self.undulation = 0.0 if geoid_undulation == UNKNOWN_UNDULATION else geoid_undulation
        self.height = origin[2]
        self.centre = np.array(self.to_cartesian.transform(longitude, latitude, 0.0))
        l, p = np.radians(longitude), np.radians(latitude)
        self.rotation = np.array([[-np.sin(l), np.cos(l), 0],
                                  [-np.sin(p) * np.cos(l), -np.sin(p) * np.sin(l), np.cos(p)],
                                  [np.cos(p) * np.cos(l), np.cos(p) * np.sin(l), np.sin(p)]])

    def from_geodetic(self, latitude, longitude, ellipsoidal_height):
        """Coordinates in world [m] of degrees and metres; arrays (n,) in, (n, 3) out."""
        ground = np.array(self.to_cartesian.transform(longitude, latitude, np.zeros_like(np.asarray(latitude, float)))).T
        result = (ground - self.centre) @ self.rotation.T
        result[..., 2] += np.asarray(ellipsoidal_height) - self.undulation - self.height
        return result


def converted(point, crs, other):
    """Easting and northing [m], or longitude and latitude [deg], of `point` of the system `crs` in the system `other`; its height passes as it is."""
    try:
        import pyproj
        east, north = pyproj.Transformer.from_crs(crs, other, always_xy=True).transform(point[0], point[1], errcheck=True)
    except ImportError as error:
        raise CityError(f'{crs} and {other} cannot be compared: python3-pyproj is not installed') from error
    except pyproj.exceptions.ProjError as error:
        raise CityError(f'PROJ does not lead {point[0]:.10g} {point[1]:.10g} from {crs} to {other}: {error}') from error
    return [float(east), float(north), float(point[2])]


def origin_text(origin):
    """As the option --origin takes it, to a millimetre."""
    return ' '.join(f'{x:.3f}'.rstrip('0').rstrip('.') for x in origin)


def is_same_origin(origin, crs, other_origin, other_crs):
    """True when two origins, each in its system, are one place to SAME_ORIGIN: so are the worlds, east-north-up frames there."""
    if crs == other_crs and np.abs(np.subtract(origin, other_origin)).max() <= 1e-3:
        return True
    try:
        longitude, latitude, height = converted(other_origin, other_crs, 'EPSG:4979')
        return bool(np.linalg.norm(WorldFrame(crs, origin).from_geodetic(latitude, longitude, height)) <= SAME_ORIGIN)
    except CityError:
        if crs == other_crs:  # outside its area
            return False
        raise


def read_city_file(path):
    """Content of a city's YAML file, as `simulate` writes beside a street bag; CityError says what is wrong with it."""
    facts = read_mapping(path, CityError, 'lines such as "crs: EPSG:2056"')
    for name, _, _ in FACTS:
        if name in facts and not isinstance(facts[name], (int, float)):
            raise CityError(f'{path}: {name} must be a number')
    return facts


def tracker_parameters(city, facts):
    """Parameters of ekf_tracker_node: where the world of `city` (None without a database) lies, and what the city's file adds.

    CityError when the two disagree on the origin; they may name one place in two coordinate systems.
    """
    crs = city.crs if city is not None else facts.get('crs', '')
    origin = [float(x) for x in (city.origin if city is not None else facts.get('origin', (0, 0, 0)))]
    result = {}
    if crs:
        given = facts.get('origin', origin if facts.get('crs') == crs else None)
        if 'crs' in facts and given is None:
            raise CityError(f'the database is in {crs}, the city file in {facts["crs"]} without an origin: give the city file one')
        if 'crs' in facts and not is_same_origin(origin, crs, given, facts['crs']):
            raise CityError(f'the database has its origin at {origin_text(origin)} in {crs}, the city file at {origin_text(given)} in {facts["crs"]}: '
                            f'build the database with --origin {origin_text(converted(given, facts["crs"], crs))}')
        result.update({'origin_crs': crs, 'origin': origin})
    for name, parameter, _ in FACTS:
        if name in facts:
            result[parameter] = float(facts[name])
    return result


def what_is_unknown(parameters):
    """A line for each of the `parameters` of ekf_tracker that nobody has named: what follows, and what to do."""
    return [f'{parameter} is not known, so {then}: name it in the --city file, as {name}' for name, parameter, then in FACTS if parameter not in parameters]
