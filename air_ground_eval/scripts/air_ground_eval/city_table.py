"""The printed table of a city replay, beside the paper's figures."""
import numpy as np

PAPER = {'stated_sigma_x_mean_m': '4.2 m', 'stated_sigma_y_mean_m': '4.3 m', 'stated_sigma_z_mean_m': '3.6 m',
         'stated_sigma_yaw_mean_deg': '7.5 deg', 'stated_sigma_yaw_max_deg': '12.2 deg'}
NAMES = {'vo': 'pure VO', 'gps': 'GPS', 'tracker': 'tracker', 'magnetometer': 'with magnetometer'}


def table(v, sources, scale, along, notes):
    """The figures of report.yaml as text. sources: what was compared; scale: the end of the line on the tracker's start; along: name -> (error, stated)
    for each stretch of the way."""
    head = f'{v["bag"]}: {v["bag_duration_s"]:.0f} s of data in {v["wall_time_s"]:.0f} s'
    if 'way_length_m' in v:
        head += f', {v["way_length_m"]:.0f} m travelled'
    lines = [head]
    names = [name for name in NAMES if name in sources]
    if not names:
        lines.append(f'the tracker never started: {v["fixes"]} fixes from {v["images_tried"]} images')
    else:
        lines.append(f'tracker started after {v.get("tracker_start_after_m", 0):.1f} m' + scale + f'; it covers {v["tracker_coverage_since_start_percent"]:.0f} % of the time since')
        lines.append(f'{"":30}' + ''.join(f'{NAMES[name]:>19}' for name in names) + '   Majdik et al. 2014')
        rows = [('position error, mean', 'position_error_mean_m', 'm'), ('  95 %', 'position_error_95_percent_m', 'm'),
                ('  at the end', 'position_error_at_end_m', 'm'), ('yaw error, mean', 'yaw_error_mean_deg', 'deg'),
                ('  greatest', 'yaw_error_max_deg', 'deg'), ('stated 1 sigma, mean: x', 'stated_sigma_x_mean_m', 'm'),
                ('  y', 'stated_sigma_y_mean_m', 'm'), ('  z', 'stated_sigma_z_mean_m', 'm'), ('  yaw', 'stated_sigma_yaw_mean_deg', 'deg'),
                ('  yaw, greatest', 'stated_sigma_yaw_max_deg', 'deg'), ('NEES (4 if consistent)', 'nees_mean', '')]
        for label, key, unit in rows:
            if any(f'{name}_{key}' in v for name in names):
                cells = ''.join(f'{v[f"{name}_{key}"]:>15.2f} {unit:3}' if f'{name}_{key}' in v else f'{"":19}' for name in names)
                lines.append(f'{label:30}{cells}   {PAPER.get(key, "")}'.rstrip())
        lines += _along(v, names, along)
        lines += [f'GPS: {v["gps_topic"]}'] if 'gps' in sources else []
    lines += _localizer_lines(v)
    if 'vo_from_true_start_position_error_mean_m' in v:
        lines.append(f'pure VO from the true pose at its start: {v["vo_from_true_start_position_error_mean_m"]:.2f} m mean, '
                     f'{v["vo_from_true_start_position_error_at_end_m"]:.2f} m at the end')
    return '\n'.join(lines + [f'note: {note}' for note in notes])


def _along(v, names, along):
    lines = []
    if not v.get('along_way_end_m'):
        return lines
    lines.append('along the way, mean error / stated 1 sigma [m]')
    begin = 0.0
    for i, end in enumerate(v['along_way_end_m']):
        cells = ''
        for name in names:
            error, stated = along[name][0][i], along[name][1][i]
            cell = '' if np.isnan(error) else f'{error:.2f}' + ('' if np.isnan(stated) else f' / {stated:.2f}')
            cells += f'{cell:>19}'
        lines.append(f'  {begin:5.0f} to {min(end, v["way_length_m"]):.0f} m'.ljust(30) + cells)
        begin = end
    return lines


def _localizer_lines(v):
    text = f'images tried {v["images_tried"]}, fixes {v["fixes"]}'
    if 'fix_position_error_median_m' in v:
        yaw = f', yaw median {v["fix_yaw_error_median_deg"]:.1f} deg' if 'fix_yaw_error_median_deg' in v else ''
        text += (f'; their error: median {v["fix_position_error_median_m"]:.2f} m, 95 % {v["fix_position_error_95_percent_m"]:.2f} m, greatest '
                 f'{v["fix_position_error_max_m"]:.2f} m{yaw}; wrong: {v["fixes_wrong"]} of {v["fixes_compared"]} compared, headings of {v["fixes_heading_compared"]}')
    elif v['fixes'] and 'fixes_compared' in v:
        text += '; none compared: the ground truth tells nothing at their times'
    lines = [text]
    if 'tracker_fixes_fused' in v:
        text = f'fused {v["tracker_fixes_fused"]}, refused {v["tracker_fixes_refused"]}'
        if 'tracker_wrong_fixes_fused' in v:
            text += f', wrong ones fused {v["tracker_wrong_fixes_fused"]}'
        if 'tracker_distance_between_updates_mean_m' in v:
            text += (f'; an update every {v["tracker_distance_between_updates_mean_m"]:.1f} m (paper: 6.5 m), at most '
                     f'{v["tracker_distance_between_updates_max_m"]:.1f} m apart')
        lines.append(text)
    if 'localizer_time_an_image_mean_s' in v:
        lines.append(f'localizer: {v["localizer_time_an_image_mean_s"]:.2f} s an image, at most {v["localizer_time_an_image_max_s"]:.2f} s '
                     '(paper: 3.2 s for steps 1, 4, 5)')
    return lines
