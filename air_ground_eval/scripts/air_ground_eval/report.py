"""Turns what was recorded during a replay into report.yaml; report_table.py prints it, figures.py draws it."""
import os
import subprocess
from dataclasses import dataclass, field
from typing import Dict, List, Optional, Tuple

import numpy as np
import yaml

from . import evaluation, figures, geometry, ply, report_table
from .evaluation import STAGE_COARSE, STAGE_REFINED, STATUS_CONVERGED, STATUS_NAMES, STATUS_SEARCHING, Track
from .path_length import path_length


@dataclass
class Recorded:
    """Inputs of a report. Tracks hold camera poses; truths are in the frame world, estimates in their maps."""
    out: str
    bag: str
    begin: float  # of the part that was played [s]
    end: float
    mav: Track
    ground: Track
    estimates: List[evaluation.Estimate]
    mav_truth: Optional[Track] = None
    ground_truth: Optional[Track] = None
    truths: Dict[str, str] = field(default_factory=dict)  # robot -> what its truth is, in words
    units: Dict[str, str] = field(default_factory=dict)  # robot -> the unit of its map, where that is not the metre
    mesh: Optional[str] = None           # PLY of the true surface, in world
    evaluate_map: str = 'evaluate_map'   # the program
    has_map: bool = False                # augmented_map.ply was written
    wall_time: float = 0.0
    held: float = 0.0                    # the player, so that the nodes could keep up [s]
    cores: List[Tuple[float, Dict[str, float]]] = field(default_factory=list)  # (time of the bag [s], node -> cores that it kept busy)
    pose_latencies: Dict[str, List[float]] = field(default_factory=dict)  # robot -> from each image to its pose [s]
    latencies: List[Tuple[float, float, float]] = field(default_factory=list)  # (stamp of a dense cloud, from its last image to it, to the refined pose) [s]
    late_clouds: int = 0                 # those that the nodes were asked for after the bag's end, without delays
    ground_map_id: int = 0               # of the ground robot's map that was saved; 0: not known
    delays: Dict[str, float] = field(default_factory=dict)  # robot -> the bag's clock less that of its images' stamps [s]
    spans: Dict[str, Tuple[float, float]] = field(default_factory=dict)  # robot -> stamps of its first and its last image [s]; else the bag's begin and end
    first_poses: Dict[str, float] = field(default_factory=dict)  # robot -> stamp of its first metric pose, of whichever map [s]
    switched_off: List[str] = field(default_factory=list)  # robots that were not to give poses
    states: Dict[str, dict] = field(default_factory=dict)  # what the odometry nodes said about themselves
    tf_publishers: Dict[str, set] = field(default_factory=dict)  # 'parent -> child': nodes that publish the transform
    notes: List[str] = field(default_factory=list)


def rounded(value):
    """Plain Python numbers with 6 significant digits, for YAML."""
    if isinstance(value, dict):
        return {k: rounded(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(v) for v in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        return float(f'{value:.6g}')
    return value


class Report:
    def __init__(self, recorded):
        self.r = recorded
        self.values = {}
        self.begins = {robot: recorded.begin - recorded.delays.get(robot, 0.0) for robot in ('mav', 'ground')}  # of the bag, by the stamps of each robot
        self.figure = {'begins': self.begins, 'title': os.path.basename(recorded.bag)}
        self.T_ground_map_world = None

    def build(self):
        """Computes everything, writes alignment.txt, report.yaml and report.png; returns the dict of report.yaml."""
        r = self.r
        self.values.update({
            'bag': os.path.basename(r.bag), 'bag_duration_s': r.end - r.begin, 'wall_time_s': r.wall_time, 'player_held_s': r.held,
            'ground_truth_in_bag': r.mav_truth is not None or r.ground_truth is not None})
        self._odometry('vo', 'mav', r.mav, r.mav_truth)
        self._odometry('slam', 'ground', r.ground, r.ground_truth)
        self._alignment()
        self._load()
        self._map()
        self.values['tf_publishers'] = {edge: sorted(nodes) for edge, nodes in sorted(r.tf_publishers.items())}
        for edge, nodes in sorted(r.tf_publishers.items()):
            if len(nodes) > 1:
                r.notes.append(f'the transform {edge} has several publishers: {", ".join(sorted(nodes))}')
        if r.notes:
            self.values['notes'] = list(r.notes)
        self._figure_tracks()
        evaluation.write_alignment(os.path.join(r.out, 'alignment.txt'), r.estimates)
        figures.draw_report(os.path.join(r.out, 'report.png'), self.figure)
        self.values = rounded(self.values)
        with open(os.path.join(r.out, 'report.yaml'), 'w', encoding='utf-8') as stream:
            stream.write('# Figures of one replay; units are in the names. Definitions: docs/experiments.md\n')
            yaml.safe_dump(self.values, stream, sort_keys=False, allow_unicode=True)
        return self.values

    def _odometry(self, prefix, robot, track, truth):
        v = self.values
        if robot in self.r.switched_off:
            v[f'{prefix}_switched_off'] = True
            return
        v[f'{prefix}_poses'] = len(track)
        unit = self.r.units.get(robot, '')
        length = path_length(track.stamps, track.poses[:, :3, 3])
        if unit:
            v[f'{prefix}_unit'] = unit
            v[f'{prefix}_estimated_path_length_units'] = length
            self.r.notes.append(f'{robot}: scale unknown (unit of its trajectory: {unit}): its ATE is what a similarity alignment leaves, and it has no error of scale')
        else:
            v[f'{prefix}_estimated_path_length_m'] = length
        begin, end = self.r.spans.get(robot, (self.begins[robot], self.r.end - self.r.delays.get(robot, 0.0)))
        v[f'{prefix}_coverage_percent'] = 100 * evaluation.coverage(track.stamps, begin, end, max_gap=1.0)
        if len(track):  # less where maps ended before the one that was saved
            first = min(self.r.first_poses.get(robot, track.stamps[0]), track.stamps[0])
            v[f'{prefix}_coverage_since_first_pose_percent'] = 100 * evaluation.coverage(track.stamps, first, end, max_gap=1.0)
        state = self.r.states.get(robot, {})
        if state:
            v[f'{prefix}_final_state'] = state['state']
            v[f'{prefix}_final_reason'] = state['reason']
            v[f'{prefix}_processing_time_mean_ms'] = state['processing_ms']
            v[f'{prefix}_lost_frames'] = state['lost']
        if self.r.truths.get(robot):
            v[f'{prefix}_truth'] = self.r.truths[robot]
        if truth is None or len(track) < 10:
            return
        error = evaluation.trajectory_error(truth, track)
        if error is None:
            self.r.notes.append(f'{prefix}: fewer than 10 poses have a ground truth')
            return
        names = {'path_length_m': 'path_length_m', 'rmse_with_scale_m': 'ate_rmse_scale_corrected_m', 'poses': 'poses_compared'}
        if unit:
            names['metres_per_unit'] = 'metres_per_unit'
            error = {**error, 'rmse_m': error['rmse_with_scale_m'], 'errors_m': error['errors_with_scale_m']}
        else:
            names = {'rmse_m': 'ate_rmse_m', 'rmse_percent': 'ate_rmse_percent_of_path', 'max_m': 'ate_max_m', 'path_length_m': 'path_length_m',
                     'scale_error_percent': 'scale_error_percent', **names}
        for key, name in names.items():
            v[f'{prefix}_{name}'] = error[key]
        self.figure[f'{robot}_error'] = error

    def _alignment(self):
        r, v = self.r, self.values
        coarse = [e for e in r.estimates if e.stage == STAGE_COARSE]
        refined = [e for e in r.estimates if e.stage == STAGE_REFINED]
        converged = [e for e in refined if e.status == STATUS_CONVERGED]
        v['alignment_coarse_estimates'] = len(coarse)
        v['alignment_refined_estimates'] = len(refined)
        v['alignment_refined_converged'] = len(converged)
        v['alignment_refined_converged_clouds'] = len({e.stamp for e in converged})  # one is refined again where the ground map changes
        if coarse:
            v['coarse_status'] = STATUS_NAMES.get(coarse[-1].status, str(coarse[-1].status))
            v['coarse_reason'] = coarse[-1].reason
        v['alignment_accepted'] = bool(converged)
        v['refined_status'] = STATUS_NAMES.get(refined[-1].status, str(refined[-1].status)) if refined else 'NONE'
        v['refined_reason'] = refined[-1].reason if refined else 'no refinement was published'
        if not converged:
            v['alignment_verdict'] = 'no alignment accepted: ' + self.refusal()
            self.figure['no_alignment'] = 'no alignment accepted'
        if converged:
            v['alignment_accepted_after_s'] = converged[0].arrived - r.begin
        of_saved_map = [e for e in converged if self._in_saved_map(e)]
        self.final = of_saved_map[-1] if of_saved_map else None
        ended = len(converged) - len(of_saved_map)
        if ended:
            v['refined_of_ended_ground_maps'] = ended
            r.notes.append(f'{ended} of {len(converged)} accepted poses are in a ground map that ended, and are not compared')
        if self.final is not None:
            v['T_ground_map_mav_map_translation_m'] = list(self.final.pose[:3, 3])
            v['T_ground_map_mav_map_quaternion_xyzw'] = list(geometry.quaternion_from_matrix(self.final.pose[:3, :3]))
            self._state_quality(self.final)
        elif converged:
            v['alignment_verdict'] = 'accepted in a ground map that ended alone, not in the last one'
        self._alignment_errors([e for e in coarse if self._in_saved_map(e)], of_saved_map)

    def _in_saved_map(self, estimate):
        """Not of a ground map that ended: its frame is another than that of the trajectory that was saved."""
        return 0 in (estimate.ground_map_id, self.r.ground_map_id) or estimate.ground_map_id == self.r.ground_map_id

    def _state_quality(self, estimate):
        self.values['refined_sigma_m_m_m_rad_rad_rad'] = list(estimate.deviations)
        self.values['refined_overlap'] = estimate.overlap
        self.values['refined_rms_residual_m'] = estimate.cost

    def _alignment_errors(self, coarse, converged):
        """Errors of coarse estimates and of accepted poses, all in the ground map that was saved."""
        r, v = self.r, self.values
        if r.ground_truth is None or r.mav_truth is None or len(r.ground) < 3:
            return
        T_world_ground_map = evaluation.tie_to_world(r.ground_truth, r.ground)
        first = evaluation.tie_through_first_pose(r.ground_truth, r.ground)
        if T_world_ground_map is None:
            return
        self.T_ground_map_world = geometry.inverse(T_world_ground_map)
        heights = r.ground_truth.heights and r.mav_truth.heights
        if not heights:
            v['alignment_errors_in_plan'] = True
            r.notes.append('errors of the alignment are in plan: how high a camera is above the body of its reference poses is not known, as said of them')
        rows = evaluation.alignment_errors(coarse, self.T_ground_map_world, r.mav_truth, heights)
        if rows:
            v['coarse_error_height_maps'] = [row['height_maps'] for row in rows]
            v['coarse_error_overlap'] = [row['overlap'] for row in rows]
            v['coarse_error_m'] = [row['position_m'] for row in rows]
            v['coarse_error_horizontal_m'] = [row['horizontal_m'] for row in rows]
            v['coarse_error_yaw_deg'] = [row['yaw_deg'] for row in rows]
            v['coarse_error_status'] = [STATUS_NAMES.get(row['status'], str(row['status'])) for row in rows]
        self.figure['coarse'] = rows
        rows = evaluation.alignment_errors(converged, self.T_ground_map_world, r.mav_truth, heights)
        missing = len(converged) - len(rows)
        if missing:
            v['refined_without_truth'] = missing
            r.notes.append(f'{missing} of {len(converged)} accepted poses have no truth at their time, and are not compared')
        if rows:
            compared = rows[-1]['estimate']
            self._state_quality(compared)
            v['refined_error_m'] = rows[-1]['position_m']
            v['refined_error_deg'] = rows[-1]['rotation_deg']
            if 'vo_scale_error_percent' in v and 'slam_scale_error_percent' in v:
                v['refined_scale_error_percent'] = evaluation.alignment_scale_error(
                    compared.scale, v['vo_scale_error_percent'], v['slam_scale_error_percent'])
            v['refined_error_median_m'] = float(np.median([row['position_m'] for row in rows]))
            v['refined_error_median_deg'] = float(np.median([row['rotation_deg'] for row in rows]))
            v['refined_errors_stamp_s'] = [row['stamp_s'] - self.begins['mav'] for row in rows]
            v['refined_errors_m'] = [row['position_m'] for row in rows]
            v['refined_errors_deg'] = [row['rotation_deg'] for row in rows]
            alternative = evaluation.alignment_errors(converged, geometry.inverse(first), r.mav_truth, heights)
            v['refined_error_through_first_pose_m'] = alternative[-1]['position_m']
            v['refined_error_through_first_pose_deg'] = alternative[-1]['rotation_deg']
        self.figure['refined'] = rows

    def _load(self):
        """Processor and delay: whether the nodes would keep up with two robots."""
        r, v = self.r, self.values
        names = sorted({name for _, cores in r.cores for name in cores})
        if names:
            curves = {name: np.array([cores.get(name, 0.0) for _, cores in r.cores]) for name in names}
            v['cpu_cores_mean'] = {name: float(curve.mean()) for name, curve in curves.items()}
            self.figure['cores'] = (np.array([now for now, _ in r.cores]) - r.begin, curves)
        for robot, name in (('mav', 'vo'), ('ground', 'slam')):
            if r.pose_latencies.get(robot):
                v[f'{name}_latency_median_s'] = float(np.median(r.pose_latencies[robot]))
                v[f'{name}_latency_95_percent_s'] = float(np.quantile(r.pose_latencies[robot], 0.95))
        if r.late_clouds:
            v['latency_clouds_left_out'] = r.late_clouds
        if r.latencies:
            v['latency_clouds'] = len(r.latencies)
            self.figure['latencies'] = np.array(r.latencies) - [self.begins['mav'], 0, 0]
            v['latency_of_clouds_s'] = [[round(float(x), 3) for x in row] for row in self.figure['latencies']]  # time in the bag, to the cloud, to the pose
            for name, delays in zip(('cloud', 'refined'), self.figure['latencies'][:, 1:].T):
                v[f'{name}_latency_median_s'] = float(np.median(delays))
                v[f'{name}_latency_95_percent_s'] = float(np.quantile(delays, 0.95))

    def refusal(self):
        """Why nothing was accepted, in one line."""
        if self.r.switched_off and not self.r.estimates:
            return f'{" and ".join(self.r.switched_off)} switched off'
        refined = [e for e in self.r.estimates if e.stage == STAGE_REFINED]
        coarse = [e for e in self.r.estimates if e.stage == STAGE_COARSE]
        waiting = refined and refined[-1].status == STATUS_SEARCHING  # for the coarse stage, whose reason then is the one that counts
        stages = [('coarse localization', coarse), ('refinement', refined)]
        for stage, estimates in stages if waiting else reversed(stages):
            if estimates:
                last = estimates[-1]
                return f'{stage} says {STATUS_NAMES.get(last.status, last.status)}: {last.reason or "no reason given"}'
        return 'no estimate was published (were both maps built? see the states of the nodes)'

    def _map(self):
        r, v = self.r, self.values
        path = os.path.join(r.out, 'augmented_map.ply')
        if not r.has_map:
            self.figure['no_map'] = 'no augmented map (no alignment accepted)' if self.final is None else 'no augmented map'
            return
        command = [r.evaluate_map, path]
        distances = os.path.join(r.out, '.distances.bin')
        if r.mesh and self.T_ground_map_world is not None:
            T = geometry.inverse(self.T_ground_map_world)
            pose = list(T[:3, 3]) + list(geometry.quaternion_from_matrix(T[:3, :3]))
            command += ['--mesh', r.mesh, '--distances', distances, '--transform'] + [f'{x:.9g}' for x in pose]
        try:
            result = subprocess.run(command, check=True, capture_output=True, text=True)
            sizes = yaml.safe_load(result.stdout)
            self.figure['map'] = ply.read_points(path)
            if os.path.exists(distances):
                self.figure['distances'] = np.fromfile(distances, '<f4')
        except subprocess.CalledProcessError as error:
            r.notes.append(f'evaluate_map failed: {error.stderr.strip()}')
            return
        except (OSError, ValueError) as error:
            r.notes.append(f'the augmented map could not be evaluated: {error}')
            return
        finally:
            if os.path.exists(distances):
                os.remove(distances)
        v['augmented_map_points'] = sizes['points']
        v['augmented_map_ground_points'] = sizes['ground_points']
        v['augmented_map_aerial_points'] = sizes['aerial_points']
        for key in ('ground_area_m2', 'aerial_area_m2', 'added_area_m2'):
            v[key] = sizes[key]
        for part in ('map', 'ground', 'aerial'):
            for key in ('surface_error_median_m', 'surface_error_95_percent_m'):
                if f'{part}_{key}' in sizes:
                    v[f'{part}_{key}'] = sizes[f'{part}_{key}']

    def _figure_tracks(self):
        r = self.r
        T = self.final.pose if self.final is not None else np.eye(4)
        self.figure['mav_in_own_map'] = self.final is None
        for robot, track, transform in (('mav', r.mav, T), ('ground', r.ground, np.eye(4))):
            if len(track):
                self.figure[f'{robot}_estimate'] = (transform @ track.poses)[:, :3, 3]
        if self.T_ground_map_world is not None:
            for robot, truth in (('mav', r.mav_truth), ('ground', r.ground_truth)):
                if truth is not None and (robot == 'ground' or self.final is not None):
                    self.figure[f'{robot}_truth'] = (self.T_ground_map_world @ truth.poses)[:, :3, 3]

    def table(self):
        return report_table.table(self.values, self.r.notes)
