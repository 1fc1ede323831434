"""The figure of a replay: trajectories, errors, and the augmented map seen from above."""
import matplotlib
matplotlib.use('Agg')
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

MAV_COLOUR, GROUND_COLOUR = '#1f4fd8', '#2a9d2a'  # blue and green, as in the paper's figure 5


def draw_report(path, data):
    """data: the dict built by report.Report.figure_data(); absent parts leave their panel with a line that says so."""
    figure, axes = plt.subplots(2, 4, figsize=(25, 11.5), constrained_layout=True)
    figure.suptitle(data['title'], fontsize=13)
    _trajectories(axes[0, 0], data)
    _errors_over_time(axes[0, 1], data)
    _alignment(axes[0, 2], data)
    _map_from_above(axes[1, 0], data)
    _map_error(axes[1, 1], data)
    _error_distribution(axes[1, 2], data)
    _processor(axes[0, 3], data)
    _latency(axes[1, 3], data)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _empty(axis, text):
    axis.text(0.5, 0.5, text, ha='center', va='center', transform=axis.transAxes, color='0.4', wrap=True)
    axis.set_xticks([])
    axis.set_yticks([])


def _trajectories(axis, data):
    axis.set_title('Trajectories in the ground map, from above')
    drawn = False
    for name, colour in (('mav', MAV_COLOUR), ('ground', GROUND_COLOUR)):
        for kind, style in (('truth', dict(color='0.55', lw=1, ls='--')), ('estimate', dict(color=colour, lw=1.6))):
            points = data.get(f'{name}_{kind}')
            if points is not None and len(points):
                label = f'{"MAV" if name == "mav" else "ground robot"}' if kind == 'estimate' else None
                axis.plot(points[:, 0], points[:, 1], label=label, **style)
                drawn = True
    if not drawn:
        return _empty(axis, 'no trajectory')
    axis.plot([], [], color='0.55', ls='--', label='ground truth')
    if data.get('mav_in_own_map'):
        axis.set_title('Trajectories from above (no alignment: the MAV in its own map)')
    axis.set_aspect('equal', 'datalim')
    axis.set_xlabel('x [m]')
    axis.set_ylabel('y [m]')
    axis.legend(fontsize=9)
    axis.grid(alpha=0.3)


def _errors_over_time(axis, data):
    axis.set_title('Trajectory error after alignment (rigid where the scale is known)')
    drawn = False
    for name, label, colour in (('mav', 'visual odometry', MAV_COLOUR), ('ground', 'RGB-D SLAM', GROUND_COLOUR)):
        error = data.get(f'{name}_error')
        if error is not None:
            axis.plot(error['stamps'] - data['begins'][name], 100 * error['errors_m'], color=colour, lw=1,
                      label=f'{label}: RMSE {100 * error["rmse_m"]:.1f} cm')
            drawn = True
    if not drawn:
        return _empty(axis, 'no ground truth in the bag')
    axis.set_xlabel('time [s]')
    axis.set_ylabel('position error [cm]')
    axis.set_ylim(bottom=0)
    axis.legend(fontsize=9)
    axis.grid(alpha=0.3)


def _alignment(axis, data):
    coarse, refined = data.get('coarse') or [], data.get('refined') or []
    axis.set_title('Alignment error at the MAV')
    if not coarse and not refined:
        return _empty(axis, data.get('no_alignment', 'no alignment'))
    time = [row['stamp_s'] - data['begins']['mav'] for row in coarse]
    axis.semilogy(time, [max(row['position_m'], 1e-3) for row in coarse], 'o-', color='#c77800', ms=4, lw=1, label='coarse, each height map')
    time = [row['stamp_s'] - data['begins']['mav'] for row in refined]
    axis.semilogy(time, [max(row['position_m'], 1e-3) for row in refined], 's-', color='#8a1a8a', ms=5, lw=1, label='refined')
    for level, text in ((0.5, 'paper: 65 % after 1'), (0.25, 'paper: 89 % after 4'), (0.08, 'paper: refined')):
        axis.axhline(level, color='0.6', lw=0.8, ls=':')
        axis.text(1.0, level, text, ha='right', va='bottom', fontsize=8, color='0.4', transform=axis.get_yaxis_transform())
    axis.set_xlabel('time [s]')
    axis.set_ylabel('position error [m]')
    axis.legend(fontsize=9, loc='upper left')
    axis.grid(alpha=0.3, which='both')


def _map_from_above(axis, data):
    axis.set_title('Augmented map from above: ground robot red, MAV greyscale')
    points = data.get('map')
    if points is None or not len(points):
        return _empty(axis, data.get('no_map', 'no augmented map'))
    # The ground robot's points over the MAV's, each from low to high: they would vanish under the aerial view of the same floor.
    points = points[np.lexsort((points['z'], points['source'] == 0))]
    colours = np.stack([points['red'], points['green'], points['blue']], 1) / 255.0
    axis.scatter(points['x'], points['y'], c=colours, s=1.2, linewidths=0, rasterized=True)
    for name, colour in (('mav', MAV_COLOUR), ('ground', GROUND_COLOUR)):
        track = data.get(f'{name}_estimate')
        if name == 'mav' and data.get('mav_in_own_map'):
            continue  # where it flew in the ground map is not known
        if track is not None and len(track):
            axis.plot(track[:, 0], track[:, 1], color=colour, lw=1)
    axis.set_aspect('equal', 'datalim')
    axis.set_xlabel('x [m]')
    axis.set_ylabel('y [m]')


def _map_error(axis, data):
    axis.set_title("Augmented map: distance to the world's surface")
    points, distances = data.get('map'), data.get('distances')
    if points is None or distances is None:
        return _empty(axis, 'no mesh of the world to compare with')
    order = np.argsort(points['z'], kind='stable')
    shown = axis.scatter(points['x'][order], points['y'][order], c=100 * distances[order], s=1.2, linewidths=0, cmap='turbo', vmin=0, vmax=10,
                         rasterized=True)
    axis.figure.colorbar(shown, ax=axis, label='distance [cm], cut at 10', shrink=0.8)
    axis.set_aspect('equal', 'datalim')
    axis.set_xlabel('x [m]')
    axis.set_ylabel('y [m]')


def _error_distribution(axis, data):
    axis.set_title("Share of map points nearer to the world's surface than")
    points, distances = data.get('map'), data.get('distances')
    if points is None or distances is None:
        return _empty(axis, 'no mesh of the world to compare with')
    for source, label, colour in ((0, 'ground robot', '#d01c1c'), (1, 'MAV', '0.35')):
        values = np.sort(distances[points['source'] == source])
        if len(values):
            axis.plot(100 * values, 100 * np.arange(1, len(values) + 1) / len(values), color=colour,
                      label=f'{label}: median {100 * np.median(values):.1f} cm, 95 % {100 * np.quantile(values, 0.95):.1f} cm')
    axis.set_xlim(0, 20)
    axis.set_ylim(0, 100)
    axis.set_xlabel('distance [cm]')
    axis.set_ylabel('share of points [%]')
    axis.legend(fontsize=9, loc='lower right')
    axis.grid(alpha=0.3)


def _processor(axis, data):
    axis.set_title('Processor by node')
    if 'cores' not in data:
        return _empty(axis, 'the nodes ran on another machine')
    time, curves = data['cores']
    axis.stackplot(time, list(curves.values()), labels=[f'{name}: {curve.mean():.2f}' for name, curve in curves.items()])
    axis.set_xlabel('time [s]')
    axis.set_ylabel('cores in use')
    axis.legend(fontsize=9, loc='upper left', title='mean')
    axis.grid(alpha=0.3)


def _latency(axis, data):
    axis.set_title('From the last image of a dense cloud to the pose refined with it')
    if 'latencies' not in data:
        return _empty(axis, data.get('no_alignment', 'no refined pose'))
    time, cloud, pose = data['latencies'].T
    axis.plot(time, pose, 's-', color='#8a1a8a', ms=5, lw=1, label='pose')
    axis.plot(time, cloud, 's-', color='#d09ad0', ms=4, lw=1, label='cloud alone')
    axis.legend(fontsize=9)
    axis.set_xlabel('time [s]')
    axis.set_ylabel('delay [s]')
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
