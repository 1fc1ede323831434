"""Errors and stated uncertainties of positions in a city, along the way travelled. Free of ROS: arrays in, dictionaries out.

Poses are of base_link in world (east, north, up); states are (x, y, z, yaw) [m, rad], covariances 4x4 in that order.
"""
from dataclasses import dataclass, field, replace

import numpy as np

from . import geometry
from .path_length import distance_travelled

# A fix farther off than this is wrong, whatever it states.
WRONG_POSITION = 2.0  # [m]
WRONG_YAW = np.radians(5.0)
# A reference once a second would leave out nine fixes in ten. Over such a gap an acceleration of 1 m/s^2 makes 0.13 m of position.
FIX_GAP = 1.05  # [s]
STEADY_YAW = np.radians(1.0)  # heading that a change of the turn rate may make in such a gap: a fifth of what is wrong
WAY_STEP = 25.0  # [m]: rows of the table along the way


@dataclass
class Increment:
    """A step of visual odometry: T_previous_current of the body with the covariance of (x, y, z, yaw) (VoIncrement)."""
    previous_stamp: float
    stamp: float
    motion: np.ndarray
    covariance: np.ndarray
    metric: bool = True
    scale_variance: float = 0.0


@dataclass
class Estimated:
    """Poses of one source: stamps [s] (n,), positions (n, 3), yaws (n,) or None, standard deviations of x y z yaw (n, 4) or None."""
    stamps: np.ndarray
    positions: np.ndarray
    yaws: np.ndarray = None
    deviations: np.ndarray = None
    covariances: np.ndarray = None  # (n, 4, 4), for the consistency
    poses: np.ndarray = None  # (n, 4, 4), where the attitude is known

    def __len__(self):
        return len(self.stamps)

    def after(self, stamp):
        """The part from `stamp` on."""
        keep = self.stamps >= stamp
        return Estimated(self.stamps[keep], self.positions[keep], *(None if a is None else a[keep] for a in (
            self.yaws, self.deviations, self.covariances, self.poses)))


def estimated_from_poses(stamps, poses, covariances):
    """Estimated of 4x4 poses with 6x6 covariances (x y z rotX rotY rotZ)."""
    poses, rows = np.asarray(poses, float).reshape(-1, 4, 4), [0, 1, 2, 5]
    covariances = np.asarray(covariances, float).reshape(-1, 6, 6)[:, rows][:, :, rows]
    deviations = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0))
    return Estimated(np.asarray(stamps, float), poses[:, :3, 3], yaw_of(poses), deviations, covariances, poses)


@dataclass
class Noise:
    """What the tracker makes of an increment's covariance: its parameters of the same names."""
    covariance_factor: float = 1.0
    min_translation_stddev: float = 0.001  # added each 1/20 s [m, or the odometry's unit]
    min_yaw_stddev: float = 1e-4  # [rad]

    def of(self, increment):
        steps = 20 * max(0.0, increment.stamp - increment.previous_stamp)
        floor = np.array([self.min_translation_stddev] * 3 + [self.min_yaw_stddev]) ** 2
        return self.covariance_factor * increment.covariance + steps * np.diag(floor)


@dataclass
class Update:
    """A measurement at the tracker (TrackerInnovation)."""
    stamp: float
    result: str
    nis: float = float('nan')
    used: float = None  # stamp of the newest odometry when it came in: from then on it shows [s]


@dataclass
class Fix:
    """An accepted pose of the street-level localizer, of base_link in world."""
    stamp: float
    pose: np.ndarray
    covariance: np.ndarray  # 6x6


@dataclass
class Way:
    """Reference along which errors are measured: stamps, poses and the distance travelled [m]. attitude: false where only the positions of the poses are known."""
    stamps: np.ndarray
    poses: np.ndarray
    attitude: bool = True
    distance: np.ndarray = field(init=False)

    def __post_init__(self):
        self.distance = distance_travelled(self.stamps, self.poses[:, :3, 3]) if len(self.poses) else np.zeros(0)

    def distance_at(self, stamps):
        return np.interp(stamps, self.stamps, self.distance)

    def covers(self, stamps):
        """Mask of the stamps within its time: distance_at() gives its ends beyond."""
        return (stamps >= self.stamps[0] - 1e-6) & (stamps <= self.stamps[-1] + 1e-6)

    def at(self, stamps, max_gap=0.5):
        """Interpolated poses and a mask of the stamps that are covered."""
        return geometry.interpolate_poses(self.stamps, self.poses, stamps, max_gap)

    def heading_known(self, stamps):
        """Mask of the stamps at which interpolation tells the heading: as for at(), and over gaps of up to FIX_GAP where the turn rate before and after says that it is steady."""
        if not self.attitude or len(self.stamps) < 2:
            return np.zeros(len(stamps), bool)
        gaps = np.diff(self.stamps)
        change = np.abs(np.diff(wrapped(np.diff(yaw_of(self.poses))) / gaps))
        change = np.append(change, change[-1:]) if len(change) else np.full(1, np.inf)
        # A turn rate that changes by `change` from gap to gap bends the yaw by an eighth of that, times the gap, off a straight line.
        steady = gaps / 8 * np.maximum(change, np.append(change[:1], change[:-1])) <= STEADY_YAW
        gap = np.clip(np.searchsorted(self.stamps, stamps, side='right') - 1, 0, len(gaps) - 1)
        return self.at(stamps)[1] | self.at(stamps, FIX_GAP)[1] & steady[gap]


def wrapped(angles):
    """Angles in (-pi, pi]."""
    return -((-np.asarray(angles) + np.pi) % (2 * np.pi) - np.pi)


def yaw_of(poses):
    return np.arctan2(poses[..., 1, 0], poses[..., 0, 0])


def _tilt_of(rotation):
    return geometry.rotation_z(-np.arctan2(rotation[1, 0], rotation[0, 0])) @ rotation


class Updates:
    """What became of each measurement: a revised result replaces the one told before."""

    def __init__(self):
        self._items = []  # Update, in order of arrival

    def add(self, update, revised=False):
        if revised:
            for i, item in enumerate(self._items):  # the first of its stamp: later ones are refused duplicates
                if abs(item.stamp - update.stamp) < 1e-6:
                    self._items[i] = update
                    return
        self._items.append(update)

    def __iter__(self):
        return iter(self._items)

    def __len__(self):
        return len(self._items)


def unbroken(increments, start_stamp):
    """The increments from `start_stamp` on up to where one does not begin at the end of the one before, since odometry was lost meanwhile, and that gap:
    its begin and its length [s], or None."""
    after = [step for step in increments if step.stamp > start_stamp + 1e-6]
    for i in range(1, len(after)):
        if abs(after[i].previous_stamp - after[i - 1].stamp) > 1e-3:
            return after[:i], (after[i - 1].stamp, after[i].stamp - after[i - 1].stamp)
    return after, None


def dead_reckoning(increments, start_stamp, start, start_covariance, scale=1.0, attitudes=None, scale_stddev=0.0, noise=None):
    """Pure visual odometry: the increments from `start` (x y z yaw) at `start_stamp` on, with nothing to correct them.

    The tracker's own prediction (paper B, equations 2, 5, 7, 8): an increment is levelled by the roll and pitch of
    `attitudes` (stamp -> rotation of the body in a level frame) and turned by the yaw; those that are not metric are
    multiplied by `scale`. `noise` gives their covariances. The relative error of the scale, common to all increments, adds its
    share; that it drifts is left out.
    """
    noise_of = (noise or Noise()).of
    state, covariance = np.array(start, float), np.array(start_covariance, float)
    by_scale = np.zeros(4)  # derivative of the state by a relative error of the scale
    stamps, states, covariances = [start_stamp], [state.copy()], [covariance.copy()]
    attitudes = attitudes or {}
    spread = scale_stddev ** 2
    for step in increments:
        if step.stamp <= start_stamp + 1e-6:
            continue
        rotation = step.motion[:3, :3]
        attitude = attitudes.get(step.stamp)
        level = _tilt_of(attitude @ rotation.T) if attitude is not None else np.eye(3)
        factor = 1.0 if step.metric else scale
        local = factor * level @ step.motion[:3, 3]
        levelled = level @ rotation
        c, s = np.cos(state[3]), np.sin(state[3])
        turn = np.eye(4)
        turn[:2, :2] = [[c, -s], [s, c]]
        state[:3] += turn[:3, :3] @ local
        state[3] = wrapped(state[3] + np.arctan2(levelled[1, 0], levelled[0, 0]))
        by_state = np.eye(4)
        by_state[:2, 3] = [-s * local[0] - c * local[1], c * local[0] - s * local[1]]
        # The floors hold in the levelled frame, as in the tracker.
        tilted = np.eye(4)
        tilted[:3, :3] = level
        levelled_step = replace(step, covariance=tilted @ step.covariance @ tilted.T)
        by_step = np.eye(4)
        by_step[:3, :3] = factor * turn[:3, :3]
        covariance = by_state @ covariance @ by_state.T + by_step @ noise_of(levelled_step) @ by_step.T
        by_scale = by_state @ by_scale
        by_scale[:3] += turn[:3, :3] @ local
        stamps.append(step.stamp)
        states.append(state.copy())
        if step.metric and step.scale_variance > 0:
            spread = step.scale_variance
        covariances.append(covariance + spread * np.outer(by_scale, by_scale))
    states, covariances = np.array(states), np.array(covariances)
    return Estimated(np.array(stamps), states[:, :3], states[:, 3],
                     np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0)), covariances)


def errors(way, estimated):
    """Position errors (n, 3) and yaw errors (n,) (None where either has no attitude) at the stamps that the way covers, and their mask."""
    reference, valid = way.at(estimated.stamps)
    offset = estimated.positions[valid] - reference[valid][:, :3, 3]
    yaw = None if estimated.yaws is None or not way.attitude else wrapped(estimated.yaws[valid] - yaw_of(reference[valid]))
    return offset, yaw, valid


def statistics(way, estimated):
    """What is reported of a source: errors against the way, stated standard deviations, and their consistency.

    nees_mean: normalised estimation error squared of (x, y, z, yaw), 4 on average for a consistent estimate.
    """
    result = {'poses': int(len(estimated))}
    if estimated.deviations is not None and len(estimated):
        for i, axis in enumerate('xyz'):
            result[f'stated_sigma_{axis}_mean_m'] = float(np.mean(estimated.deviations[:, i]))
        if estimated.yaws is not None:
            result['stated_sigma_yaw_mean_deg'] = float(np.degrees(np.mean(estimated.deviations[:, 3])))
            result['stated_sigma_yaw_max_deg'] = float(np.degrees(np.max(estimated.deviations[:, 3])))
    if way is None or len(estimated) < 2:
        return result
    offset, yaw, valid = errors(way, estimated)
    if not len(offset):
        return result
    distance = np.linalg.norm(offset, axis=1)
    result.update({
        'poses_compared': int(len(offset)),
        'position_error_mean_m': float(np.mean(distance)), 'position_error_rms_m': float(np.sqrt(np.mean(distance ** 2))),
        'position_error_median_m': float(np.median(distance)), 'position_error_95_percent_m': float(np.quantile(distance, 0.95)),
        'position_error_max_m': float(np.max(distance)), 'position_error_at_end_m': float(distance[-1]),
        'horizontal_error_mean_m': float(np.mean(np.linalg.norm(offset[:, :2], axis=1)))})
    for i, axis in enumerate('xyz'):
        result[f'error_{axis}_rms_m'] = float(np.sqrt(np.mean(offset[:, i] ** 2)))
    if yaw is not None:
        result.update({'yaw_error_mean_deg': float(np.degrees(np.mean(np.abs(yaw)))),
                       'yaw_error_rms_deg': float(np.degrees(np.sqrt(np.mean(yaw ** 2)))),
                       'yaw_error_max_deg': float(np.degrees(np.max(np.abs(yaw))))})
    if estimated.covariances is not None and yaw is not None:
        e = np.column_stack([offset, yaw])
        try:
            nees = np.einsum('ni,ni->n', e, np.linalg.solve(estimated.covariances[valid], e[:, :, None])[:, :, 0])
            result['nees_mean'] = float(np.mean(nees))
        except np.linalg.LinAlgError:
            pass
    return result


def fix_errors(way, fixes):
    """Rows of the localizer's fixes that have a truth: stamp, position and yaw error, normalised error squared, wrong or not. Yaw and normalised error are NaN where the truth tells no heading."""
    rows = []
    if way is None or not fixes:
        return rows
    stamps = np.array([f.stamp for f in fixes])
    reference, valid = way.at(stamps, FIX_GAP)
    index = [0, 1, 2, 5]
    for fix, truth, known, turn_known in zip(fixes, reference, valid, way.heading_known(stamps)):
        if not known:
            continue
        offset = fix.pose[:3, 3] - truth[:3, 3]
        yaw = float(wrapped(yaw_of(fix.pose) - yaw_of(truth))) if turn_known else float('nan')
        e = np.append(offset, yaw)
        try:
            normalised = float(e @ np.linalg.solve(fix.covariance[np.ix_(index, index)], e))
        except np.linalg.LinAlgError:
            normalised = float('nan')
        position = float(np.linalg.norm(offset))
        rows.append({'stamp': fix.stamp, 'position_m': position, 'yaw_rad': abs(yaw), 'normalised': normalised,
                     'wrong': position > WRONG_POSITION or abs(yaw) > WRONG_YAW})
    return rows


def along_the_way(way, sources, step=WAY_STEP):
    """Mean error [m] and mean stated uncertainty (root of the sum of the variances of x, y, z) in pieces of the way.

    Returns the pieces' ends [m] and {name: (errors, deviations)}; NaN where a source says nothing.
    """
    ends = np.arange(step, way.distance[-1] + step, step) if len(way.distance) and way.distance[-1] > 0 else np.zeros(0)
    table = {}
    for name, estimated in sources.items():
        offset, _, valid = errors(way, estimated) if len(estimated) > 1 else (np.zeros((0, 3)), None, np.zeros(len(estimated), bool))
        at = way.distance_at(estimated.stamps[valid])
        distance = np.linalg.norm(offset, axis=1)
        stated = None if estimated.deviations is None else np.linalg.norm(estimated.deviations[valid, :3], axis=1)
        rows = []
        for end in ends:
            inside = (at > end - step) & (at <= end)
            some = np.any(inside)
            rows.append((float(np.mean(distance[inside])) if some else float('nan'),
                         float(np.mean(stated[inside])) if some and stated is not None else float('nan')))
        table[name] = tuple(np.array(rows).reshape(-1, 2).T)
    return ends, table
