"""report.yaml and trajectories of a city replay; city_table.py prints it, city_figures.py draws it. Free of ROS."""
import os
from dataclasses import dataclass, field
from typing import Optional

import numpy as np
import yaml

from . import city_evaluation as evaluate
from . import city_figures, city_table
from .city_database import City
from .city_evaluation import Estimated, Noise, Way
from .evaluation import Track, coverage, write_tum
from .geometry import pose, rotation_z

FUSED, REFUSED, INITIALISED, RECOVERED, AGREED = 'fused', 'refused', 'initialised', 'recovered', 'agreed'
UPDATING = (FUSED, INITIALISED, RECOVERED)  # change the pose when they come in
CORRECTING = UPDATING + (AGREED,)  # are part of it


@dataclass
class Recorded:
    """What a replay left behind. truth: Track of base_link in world, or None. begin, end: of the bag [s]; delay: of its clock after that of the stamps [s]."""
    out: str
    bag: str
    begin: float
    end: float
    tracker: Estimated
    updates: list  # Update of the fixes at the tracker, in order of arrival: the last word on each
    magnetometer: Optional[Estimated] = None  # tracker with magnetometer
    magnetometer_updates: list = field(default_factory=list)
    increments: list = field(default_factory=list)
    attitudes: dict = field(default_factory=dict)  # stamp -> T_map_base of mav/odometry
    start_scale: float = 1.0  # of odometry that is not metric, as the tracker found it at its start
    start_scale_stddev: float = 0.0
    noise: Noise = field(default_factory=Noise)  # by which the tracker predicts
    fixes: list = field(default_factory=list)
    matches: dict = field(default_factory=dict)  # status -> number of images
    match_times: list = field(default_factory=list)  # [s]
    gps: Optional[Estimated] = None
    gps_topic: str = ''
    truth: Optional[Track] = None
    truth_attitude: bool = True  # false: positions alone
    delay: float = 0.0
    city: City = field(default_factory=City)
    states: dict = field(default_factory=dict)
    tf_publishers: dict = field(default_factory=dict)
    wall_time: float = 0.0
    notes: list = field(default_factory=list)


def track_of(estimated):
    """Track for the TUM format; level where only a heading is known, without turn where not even that."""
    if estimated.poses is not None:
        return Track(estimated.stamps, estimated.poses)
    yaws = estimated.yaws if estimated.yaws is not None else np.zeros(len(estimated))
    poses = [pose(rotation_z(yaw), p) for yaw, p in zip(yaws, estimated.positions)]
    return Track(estimated.stamps, np.array(poses).reshape(-1, 4, 4))


class Report:
    def __init__(self, recorded):
        self.r = recorded
        self.values = {}
        self.sources = {}
        self.table_along = {}

    def build(self):
        r, v = self.r, self.values
        v.update({'bag': os.path.basename(r.bag), 'bag_duration_s': r.end - r.begin, 'wall_time_s': r.wall_time,
                  'ground_truth_in_bag': r.truth is not None, 'tracker_started': len(r.tracker) > 0})
        way = Way(r.truth.stamps, r.truth.poses, r.truth_attitude) if r.truth is not None else None
        self._gather(way)
        line = way or (Way(r.tracker.stamps, r.tracker.poses) if len(r.tracker) > 1 else None)
        self.distance_at = line.distance_at if line is not None else np.zeros_like
        if line is not None:
            v['way_length_m'] = float(line.distance[-1])
            if len(r.tracker):
                v['tracker_start_after_m'] = float(self.distance_at(r.tracker.stamps[:1])[0])
        for name, estimated in self.sources.items():
            v.update({f'{name}_{key}': value for key, value in evaluate.statistics(way, estimated).items()})
        if way is not None and len(r.tracker):
            self._say_what_is_compared(way)
        self._ratios()
        self._updates(line)
        self._fixes(way)
        if way is not None:
            ends, self.table_along = evaluate.along_the_way(way, self.sources)
            v['along_way_end_m'] = [float(e) for e in ends]
            for name, (error, stated) in self.table_along.items():
                v[f'{name}_error_along_way_m'] = [float(e) for e in error]
                if name != 'gps':
                    v[f'{name}_stated_sigma_along_way_m'] = [float(s) for s in stated]
        for robot, state in r.states.items():
            v[f'{robot}_final_state'], v[f'{robot}_final_reason'] = state['state'], state['reason']
            v[f'{robot}_processing_time_mean_ms'], v[f'{robot}_lost_images'] = state['processing_ms'], int(state['lost'])
        v['tf_publishers'] = {edge: sorted(nodes) for edge, nodes in r.tf_publishers.items()}
        self._draw(way)
        v['notes'] = list(r.notes)
        self._write()
        return v

    def _gather(self, way):
        """All sources over the same stretch: from the tracker's first pose on, pure VO as far as it goes."""
        r = self.r
        if not len(r.tracker):
            return
        start = r.tracker.stamps[0]
        first = np.append(r.tracker.positions[0], r.tracker.yaws[0])
        # Without mav/odometry (a MAV without IMU) as the tracker levels it.
        attitudes = {stamp: T[:3, :3] for stamp, T in (r.attitudes.items() if r.attitudes else zip(r.tracker.stamps, r.tracker.poses))}
        self.values['tracker_coverage_since_start_percent'] = 100 * coverage(r.tracker.stamps, start, r.end - r.delay)
        increments, gap = evaluate.unbroken(r.increments, start)
        if gap:
            self.values['vo_ends_after_s'] = float(gap[0] - start)
            r.notes.append(f'odometry was lost {gap[0] - start:.0f} s after the start of the tracker, for {gap[1]:.1f} s: pure VO is that of before, its errors those up to there')

        def reckon(state, covariance):
            return evaluate.dead_reckoning(increments, start, state, covariance, r.start_scale, attitudes, r.start_scale_stddev, r.noise)

        self.sources['vo'] = reckon(first, r.tracker.covariances[0])
        if way is not None and way.attitude:
            truth, valid = way.at(np.array([start]))
            if valid[0]:  # what the odometry alone is worth: no error at its start
                ideal = reckon(np.append(truth[0, :3, 3], evaluate.yaw_of(truth)[0]), np.zeros((4, 4)))
                self.values.update({f'vo_from_true_start_{k}': x for k, x in evaluate.statistics(way, ideal).items()})
        if r.gps is not None and len(r.gps):
            self.sources['gps'] = r.gps.after(start)
            self.values['gps_topic'] = r.gps_topic
        self.sources['tracker'] = r.tracker
        if r.magnetometer is not None and len(r.magnetometer):
            self.sources['magnetometer'] = r.magnetometer.after(start)

    def _say_what_is_compared(self, way):
        compared, spacing = self.values.get('tracker_poses_compared', 0), float(np.median(np.diff(way.stamps))) if len(way.stamps) > 1 else 0.0
        if not compared:
            self.r.notes.append(f'no errors: of the {len(way.stamps)} ground truth poses, {spacing:.2g} s apart, none is near a pose of the tracker in time')
        elif compared < 0.5 * len(self.r.tracker):
            self.r.notes.append(f'errors are of the {compared} of {len(self.r.tracker)} poses of the tracker that are near one of the ground truth, which has one every {spacing:.2g} s')

    def _ratios(self):
        v = self.values
        for name in ('vo', 'vo_from_true_start', 'gps'):
            if v.get(f'{name}_position_error_mean_m') and 'tracker_position_error_mean_m' in v:
                v[f'tracker_error_over_{name}_error'] = v['tracker_position_error_mean_m'] / v[f'{name}_position_error_mean_m']

    def _updates(self, line):
        """What became of the fixes at the trackers. line: the Way that distances between them are taken along, or None."""
        r, v = self.r, self.values
        for name, updates in (('tracker', r.updates), ('magnetometer', r.magnetometer_updates)):
            if name not in self.sources:
                continue
            results = [u.result for u in updates]
            v[f'{name}_fixes_fused'] = sum(x in CORRECTING for x in results)
            v[f'{name}_fixes_refused'] = results.count(REFUSED)
            v[f'{name}_fixes_other'] = len(results) - v[f'{name}_fixes_fused'] - v[f'{name}_fixes_refused']
            v[f'{name}_recoveries'] = results.count(RECOVERED)
            nis = [u.nis for u in updates if u.result == FUSED and np.isfinite(u.nis)]
            if nis:
                v[f'{name}_nis_mean'] = float(np.mean(nis))
            stamps = np.array([u.stamp for u in updates if u.result in UPDATING])
            steps = np.diff(np.sort(line.distance_at(stamps[line.covers(stamps)]))) if line is not None else ()
            if len(steps):
                v[f'{name}_distance_between_updates_mean_m'] = float(np.mean(steps))
                v[f'{name}_distance_between_updates_max_m'] = float(np.max(steps))

    def _fixes(self, way):
        r, v = self.r, self.values
        v['images_tried'] = int(sum(r.matches.values()))
        for status, count in sorted(r.matches.items()):
            v[f'images_{status}'] = int(count)
        v['fixes'] = len(r.fixes)
        if r.match_times:
            v['localizer_time_an_image_mean_s'] = float(np.mean(r.match_times))
            v['localizer_time_an_image_max_s'] = float(np.max(r.match_times))
        if way is None:
            return
        rows = evaluate.fix_errors(way, r.fixes)
        headings = [row for row in rows if np.isfinite(row['yaw_rad'])]
        v['fixes_compared'], v['fixes_heading_compared'] = len(rows), len(headings)
        if not rows:
            return
        position = np.array([row['position_m'] for row in rows])
        v.update({'fix_position_error_median_m': float(np.median(position)), 'fix_position_error_95_percent_m': float(np.quantile(position, 0.95)),
                  'fix_position_error_max_m': float(position.max()), 'fixes_wrong': int(sum(row['wrong'] for row in rows))})
        if headings:
            yaw = np.degrees([row['yaw_rad'] for row in headings])
            v.update({'fix_yaw_error_median_deg': float(np.median(yaw)), 'fix_yaw_error_max_deg': float(yaw.max()),
                      'fix_normalised_error_squared_mean': float(np.nanmean([row['normalised'] for row in headings]))})
        wrong = {row['stamp'] for row in rows if row['wrong']}
        for name, updates in (('tracker', r.updates), ('magnetometer', r.magnetometer_updates)):
            if name in self.sources:
                v[f'{name}_wrong_fixes_fused'] = sum(u.result in CORRECTING and any(abs(u.stamp - s) < 1e-4 for s in wrong) for u in updates)

    def _draw(self, way):
        r = self.r
        updates = {name: np.array([u.used for u in list_ if u.result in UPDATING])
                   for name, list_ in (('tracker', r.updates), ('magnetometer', r.magnetometer_updates))}
        data = {'title': f'{os.path.basename(r.bag)}: {self.values.get("way_length_m", 0):.0f} m', 'sources': self.sources, 'updates': updates, 'way': way,
                'triangles': r.city.triangles, 'panoramas': r.city.panoramas, 'distance_at': self.distance_at, 'errors': {}}
        if way is not None:
            for name in ('tracker', 'magnetometer'):
                if len(self.sources.get(name, ())) > 1:
                    offset, yaw, valid = evaluate.errors(way, self.sources[name])
                    data['errors'][name] = (valid, offset, yaw)
        city_figures.draw_trajectories(os.path.join(r.out, 'trajectories.png'), data)
        city_figures.draw_uncertainty(os.path.join(r.out, 'uncertainty.png'), data)

    def _write(self):
        r = self.r
        for name, file in (('vo', 'vo'), ('gps', 'gps'), ('tracker', 'tracker'), ('magnetometer', 'tracker_with_magnetometer')):
            if name in self.sources:
                write_tum(os.path.join(r.out, f'{file}_trajectory.txt'), track_of(self.sources[name]))
        if r.truth is not None:
            write_tum(os.path.join(r.out, 'truth_trajectory.txt'), r.truth)
        path = os.path.join(r.out, 'report.yaml')
        with open(path + '.part', 'w', encoding='utf-8') as stream:
            stream.write('# Positions of base_link in world, from the start of the tracker on; definitions: docs/experiments.md\n')
            yaml.safe_dump(self.values, stream, sort_keys=False, default_flow_style=None, width=140)
        os.replace(path + '.part', path)

    def table(self):
        unscaled = any(not i.metric and i.stamp > self.r.tracker.stamps[0] for i in self.r.increments) if len(self.r.tracker) else False
        scale = f'; the scale of its odometry came from two fixes: {self.r.start_scale:.3f}' if unscaled else '; its odometry was metric'
        return city_table.table(self.values, list(self.sources), scale, self.table_along, self.r.notes)
