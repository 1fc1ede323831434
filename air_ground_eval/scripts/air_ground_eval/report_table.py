"""The printed table of a replay."""

COVERED = 90  # [% of the recording]: the errors of a trajectory that covers less say little of it


def table(v, notes):
    """The figures of report.yaml as text, beside the paper's."""
    rows = []

    def add(label, ours, paper=''):
        rows.append((label, ours, paper))

    def odometry(prefix, label, paper):
        if v.get(f'{prefix}_switched_off'):
            return add(label, 'switched off')
        if f'{prefix}_ate_rmse_m' in v:
            add(f'{label} ATE RMSE', f'{v[f"{prefix}_ate_rmse_m"]:.3f} m = {v[f"{prefix}_ate_rmse_percent_of_path"]:.2f} % of '
                f'{v[f"{prefix}_path_length_m"]:.1f} m', paper)
            add(f'{label} scale error', f'{v[f"{prefix}_scale_error_percent"]:+.2f} %')
        elif f'{prefix}_unit' in v:
            if f'{prefix}_ate_rmse_scale_corrected_m' in v:
                error, length = v[f'{prefix}_ate_rmse_scale_corrected_m'], v[f'{prefix}_path_length_m']
                add(f'{label} ATE RMSE, scale unknown', f'{error:.3f} m = {100 * error / max(length, 1e-9):.2f} % of {length:.1f} m')
            add(f'{label} path', f'{v[f"{prefix}_estimated_path_length_units"]:.2f} of its map\'s unit, scale unknown, {v[f"{prefix}_poses"]} poses')
        else:
            add(f'{label} path', f'{v[f"{prefix}_estimated_path_length_m"]:.2f} m, {v[f"{prefix}_poses"]} poses')
        if v.get(f'{prefix}_coverage_percent', 100) < COVERED:
            lost = v.get(f'{prefix}_lost_frames', 0)
            add(f'{label} covers', f'{v[f"{prefix}_coverage_percent"]:.0f} % of the recording, and its errors are of that'
                f'{f"; {lost} images lost" if lost else ""}')
        if v.get(f'{prefix}_final_state', 'TRACKING') != 'TRACKING':
            add(f'{label} state at the end', f'{v[f"{prefix}_final_state"]}: {v[f"{prefix}_final_reason"]}')
        if f'{prefix}_processing_time_mean_ms' in v:
            add(f'{label} time a frame', f'{v[f"{prefix}_processing_time_mean_ms"]:.1f} ms', {'vo': '14 ms', 'slam': '15 ms'}[prefix])
        if f'{prefix}_latency_median_s' in v:
            add(f'{label} image to pose', f'median {v[f"{prefix}_latency_median_s"]:.2f} s, 95 % {v[f"{prefix}_latency_95_percent_s"]:.2f} s')

    odometry('vo', 'MAV odometry', '0.012 m over 23 m')
    odometry('slam', 'RGB-D SLAM', '0.038 m over 7.7 m')
    counts = v.get('coarse_error_height_maps', [])
    shown = [c for c in (1, 4) if c in counts] or counts[:1]
    for count in dict.fromkeys(shown + counts[-1:]):
        i = len(counts) - 1 if count == counts[-1] else counts.index(count)  # maps are compared again where the ground map changes
        add(f'coarse error after height map {count}', f'{v["coarse_error_m"][i]:.3f} m, {v["coarse_error_yaw_deg"][i]:.1f} deg '
            f'({v["coarse_error_status"][i]})', {1: '< 0.5 m in 65 %', 4: '< 0.25 m in 89 %'}.get(count, ''))
    if 'refined_error_m' in v:
        add('refined error' + (' in plan' if v.get('alignment_errors_in_plan') else ''), f'{v["refined_error_m"]:.3f} m, {v["refined_error_deg"]:.2f} deg', '0.08 m, 3.0 deg')
        if 'refined_scale_error_percent' in v:
            add('  scale between the maps', f'{v["refined_scale_error_percent"]:+.2f} %')
        add('  tied through the first pose', f'{v["refined_error_through_first_pose_m"]:.3f} m, '
            f'{v["refined_error_through_first_pose_deg"]:.2f} deg')
    add('status', f'coarse {v.get("coarse_status", "NONE")}, refined {v["refined_status"]}')
    if 'refined_sigma_m_m_m_rad_rad_rad' in v:
        add('1 sigma of the refined pose', ', '.join(f'{x:.3f}' for x in v['refined_sigma_m_m_m_rad_rad_rad']) + ' (m, rad)')
    else:
        add('alignment', v['alignment_verdict'])
    if 'refined_latency_median_s' in v:
        late = f', {v["latency_clouds_left_out"]} asked for at the end left out' if 'latency_clouds_left_out' in v else ''
        add('last image of a cloud to refined pose', f'median {v["refined_latency_median_s"]:.2f} s, 95 % {v["refined_latency_95_percent_s"]:.2f} s ({v["latency_clouds"]} clouds{late})')
        add('  of that until the cloud is there', f'median {v["cloud_latency_median_s"]:.2f} s, 95 % {v["cloud_latency_95_percent_s"]:.2f} s')
    if 'cpu_cores_mean' in v:
        add('processor cores in use', f'{sum(v["cpu_cores_mean"].values()):.2f} on average')
    if 'augmented_map_points' in v:
        add('augmented map', f'{v["augmented_map_points"]} points ({v["augmented_map_ground_points"]} ground, '
            f'{v["augmented_map_aerial_points"]} aerial)')
        for part, label in (('map', 'surface error'), ('ground', '  ground points'), ('aerial', '  aerial points')):
            if f'{part}_surface_error_median_m' in v:
                add(label, f'median {v[f"{part}_surface_error_median_m"]:.3f} m, 95 % {v[f"{part}_surface_error_95_percent_m"]:.3f} m')
        add('area seen by the ground robot', f'{v["ground_area_m2"]:.1f} m^2')
        add('area added by the aerial view', f'{v["added_area_m2"]:.1f} m^2')
    width = max(len(row[0]) for row in rows) + 2
    middle = max(52, max(len(row[1]) for row in rows if row[2]) + 2 if any(row[2] for row in rows) else 0)
    lines = [f'{v["bag"]}: {v["bag_duration_s"]:.0f} s of data in {v["wall_time_s"]:.0f} s',
             f'{"":{width}}{"here":{middle}}Forster et al. 2013']
    lines += [f'{label:{width}}{ours:{middle}}{paper}'.rstrip() for label, ours, paper in rows]
    lines += [f'note: {note}' for note in notes]
    return '\n'.join(lines)
