"""Figures 7 and 8 of Majdik et al. 2014, redrawn: uncertainty along the way, trajectories from above and from the side."""
import matplotlib
matplotlib.use('Agg')
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.collections import PolyCollection  # noqa: E402

# The paper's colours: VO magenta, GPS green, tracker blue with squares, with magnetometer red with circles.
# Name: label, colour, mark of an update and its size, width of the line; in the order of drawing, wide below narrow.
STYLES = {'gps': ('GPS', '#2a9d2a', None, 0, 1.4), 'vo': ('pure visual odometry', '#d81bd8', None, 0, 1.4),
          'magnetometer': ('tracker with magnetometer', '#d01c1c', 'o', 10, 3.2), 'tracker': ('tracker', '#1f4fd8', 's', 6, 1.3)}


def draw_trajectories(path, data):
    """data: sources {name: Estimated}, updates {name: stamps}, way (or None), triangles, panoramas, distance_at, title."""
    figure, (above, side) = plt.subplots(2, 1, figsize=(15, 14), constrained_layout=True, gridspec_kw={'height_ratios': [2.4, 1]})
    figure.suptitle(data['title'], fontsize=13)
    # Walls collapse to lines in plan, roofs and floors fill the footprint.
    if len(data['triangles']):
        above.add_collection(PolyCollection(data['triangles'][:, :, :2], facecolors='0.86', edgecolors='0.86', linewidths=0.3, zorder=0))
    if len(data['panoramas']):
        above.plot(data['panoramas'][:, 0], data['panoramas'][:, 1], 'o', mfc='none', mec='k', ms=7, label='Street View cameras', zorder=3)
    if data['way'] is not None:
        truth = data['way'].poses[:, :3, 3]
        above.plot(truth[:, 0], truth[:, 1], color='0.25', lw=2.2, ls='--', label='ground truth', zorder=2)
        side.plot(data['way'].distance, truth[:, 2], color='0.25', lw=2.2, ls='--')
    for name, (label, colour, marker, size, width) in STYLES.items():
        estimated = data['sources'].get(name)
        if estimated is None or not len(estimated):
            continue
        p, travelled = estimated.positions, data['distance_at'](estimated.stamps)
        above.plot(p[:, 0], p[:, 1], color=colour, lw=width, label=label, zorder=4)
        side.plot(travelled, p[:, 2], color=colour, lw=width)
        stamps = data['updates'].get(name, [])
        if marker and len(stamps):
            i = np.clip(np.searchsorted(estimated.stamps, stamps, side='right'), 0, len(estimated) - 1)
            above.plot(p[i, 0], p[i, 1], marker, mfc='none', mec=colour, ms=size, label=f'{label}: updates', zorder=5)
            side.plot(travelled[i], p[i, 2], marker, mfc='none', mec=colour, ms=size)
    above.set_aspect('equal', 'datalim')
    centre = data['way'].poses[:, :2, 3] if data['way'] is not None else next((e.positions[:, :2] for e in data['sources'].values() if len(e)), None)
    if centre is not None:
        low, high = centre.min(0) - 25, centre.max(0) + 25
        above.set_xlim(low[0], high[0])
        above.set_ylim(low[1], high[1])
    above.set_title('From above, over the footprints of the city model (figure 8 a)')
    above.set_xlabel('east [m]')
    above.set_ylabel('north [m]')
    above.legend(fontsize=9, loc='best')
    above.grid(alpha=0.3)
    side.set_title('Height along the way travelled (figure 8 b)')
    side.set_xlabel('travelled distance [m]')
    side.set_ylabel('up [m]')
    side.grid(alpha=0.3)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def draw_uncertainty(path, data):
    """Standard deviations of x, y, z [m] and yaw [deg] over the distance, with the updates; thin: the error's size."""
    figure, axes = plt.subplots(4, 1, figsize=(13, 13), constrained_layout=True, sharex=True)
    figure.suptitle(data['title'], fontsize=13)
    papers = (4.2, 4.3, 3.6, 7.5)
    for i, (axis, quantity) in enumerate(zip(axes, ('x [m]', 'y [m]', 'z [m]', 'yaw [deg]'))):
        unit = 180 / np.pi if i == 3 else 1.0
        for name in ('magnetometer', 'tracker'):
            estimated = data['sources'].get(name)
            if estimated is None or not len(estimated):
                continue
            label, colour, marker, size, width = STYLES[name]
            travelled = data['distance_at'](estimated.stamps)
            axis.plot(travelled, unit * estimated.deviations[:, i], color=colour, lw=width, label=f'{label}: stated 1 sigma')
            stamps = data['updates'].get(name, [])
            if len(stamps):
                at = np.clip(np.searchsorted(estimated.stamps, stamps, side='right'), 0, len(estimated) - 1)
                axis.plot(travelled[at], unit * estimated.deviations[at, i], marker, mfc='none', mec=colour, ms=0.7 * size)
            if name in data['errors'] and (i < 3 or data['errors'][name][2] is not None):
                valid, offset, yaw = data['errors'][name]
                axis.plot(travelled[valid], unit * np.abs(yaw if i == 3 else offset[:, i]), color=colour, lw=0.7, alpha=0.6, label=f'{label}: error')
        axis.axhline(papers[i], color='0.6', lw=0.8, ls=':')
        axis.text(0.0, papers[i], ' paper: mean uncertainty', ha='left', va='bottom', fontsize=8, color='0.4', transform=axis.get_yaxis_transform())
        axis.set_ylabel(quantity)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
    axes[0].set_title('Uncertainty along the way (figure 7); marks: updates')
    axes[0].legend(fontsize=9, loc='upper right')
    axes[3].set_xlabel('travelled distance [m]')
    figure.savefig(path, dpi=80)
    plt.close(figure)
