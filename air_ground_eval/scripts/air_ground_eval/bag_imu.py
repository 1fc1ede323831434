"""Checks of the messages of an IMU: units, axes, what is measured."""
import numpy as np

from .bag_finding import ERROR, WARNING, Finding, quoted

FASTEST = 4  # [rad/s]: half of a recording's turn rates beyond this are of no robot whose images can be followed
VANISHING = 0.3  # of a reading's size: vibration without gravity has a smaller mean, a robot that stays upright one of about 1
REST = 0.02  # [rad/s]: spread of the turn rate's means over 0.1 s, above the noise of consumer gyros and below any motion of a hand or a robot

LEAST_RANGE = {'accelerations': (18.0, 'm/s^2'), 'turn rates': (2.0, 'rad/s')}  # no accelerometer's range ends below 2 g, no gyro's below 125 deg/s

SLOWEST = 25  # [Hz]: as in ImuCoverage of air_ground_common; what comes less often serves no image


def without(standard):
    """The launch argument that does without an IMU; '' for what is none."""
    return {'/mav/imu/data': 'mav_use_imu:=false', '/ground/imu/data': 'ground_imu:=none'}.get(standard, '')


def too_slow(standard, topic, rate):
    """What a rate [Hz] below SLOWEST means."""
    lost, instead = (('its map would never become metric', ': the alignment with the ground map (in the city, the localizer) then tells the scale') if standard.startswith('/mav') else
                     ('it tells neither turns nor the vertical', ''))
    return Finding(WARNING, f'{topic}: {rate:.1f} Hz; less than {SLOWEST} Hz leave gaps that no node bridges, so that {lost}: raise the rate of its driver to 100 Hz and record again, or replay '
                   f'with {without(standard)}{instead}', without(standard))


def unite(gyro, accelerometer):
    """Gives a gyro's stream the accelerations of an accelerometer's own, where there is one, at its stamps."""
    if gyro and accelerometer and accelerometer.accel:
        gyro.accel = np.column_stack([np.interp(gyro.stamps, accelerometer.stamps, column) for column in np.array(accelerometer.accel).T])


def cut_off(readings, least):
    """Where the range of a sensor ends, as its readings (N x 3) show: what lies beyond is read as one number again and again, and hardly anything just below
    it (as RangeEnd of air_ground_common). None where it was not reached."""
    for axis in np.abs(readings).T:
        end = axis.max()
        at = np.count_nonzero(axis >= (1 - 1e-4) * end)
        if end >= least and at >= 10 and at > np.count_nonzero(axis >= 0.98 * end) - at:
            return end, at
    return None


def _gyro_alone(standard, topic):
    """What it means that an IMU measures no acceleration: a ground robot's map is levelled by surfaces, but nothing else tells a MAV's vertical and scale."""
    accel = standard.replace('data', 'accel')
    named = f'where the accelerometer has a topic of its own, name it ({accel[1:].split("/")[0]}_imu_accel:=, here --map TOPIC:={accel})'
    if standard.startswith('/ground'):
        return Finding(WARNING, f'{topic}: there is no acceleration in it: {named}; else the gyro alone tells turns, and the map is levelled by what lies flat in it; {without(standard)} does without')
    return Finding(ERROR, f'{topic}: there is no acceleration in it: {named}; or replay with {without(standard)}', without(standard))


def check(standard, topic, stream, apart):
    accel, gyro = np.array(stream.accel), np.array(stream.gyro)
    instead = without(standard)
    result = []
    refused = [what for what, field in (('turn rates', 'angular_velocity_covariance'), ('accelerations', 'linear_acceleration_covariance'))
               if stream.samples and getattr(stream.samples[0], field)[0] == -1]
    if refused and not apart:
        result.append(Finding(ERROR, f'{topic}: its messages say that {" and ".join(refused)} are not measured (first covariance -1), so no node uses them: '
                              f'take another topic of this IMU, or write 0 (unknown) there; or replay with {instead}', instead))
    if not (np.all(np.isfinite(accel)) and np.all(np.isfinite(gyro))):
        bad = np.count_nonzero(~np.isfinite(accel).all(1) | ~np.isfinite(gyro).all(1))
        result.append(Finding(WARNING, f'{topic}: {bad} readings are not finite'))
        finite = np.isfinite(accel).all(1) & np.isfinite(gyro).all(1)
        accel, gyro = accel[finite], gyro[finite]
    if len(accel) == 0:
        return result + [Finding(ERROR, f'{topic}: no finite reading')]
    norm, mean = np.median(np.linalg.norm(accel, axis=1)), np.linalg.norm(accel.mean(0))
    if norm == 0 and not gyro.any() and not apart:
        return result + [Finding(WARNING, f'{topic}: turn rates and accelerations are all zero, an attitude alone helps no node: take another topic of this IMU, or replay '
                                 f'with {instead}', instead)]
    if norm == 0:
        result.append(_gyro_alone(standard, topic))
    elif 0.9 < norm < 1.1 and mean > VANISHING * norm:
        result.append(Finding(ERROR, f'{topic}: the acceleration is about {norm:.2f}: it is in g; m/s^2 are needed: convert it, or replay with {instead}', instead))
    elif norm < 2 or norm < 8.5 and mean < VANISHING * norm:
        result.append(Finding(ERROR, f'{topic}: the acceleration is about {norm:.2f} m/s^2, its mean {mean:.2f}: gravity was removed; specific force is needed: take another topic of '
                              f'this IMU (imu/data_raw, say), or replay with {instead}', instead))
    elif not 8.5 < norm < 11.5:
        result.append(Finding(WARNING, f'{topic}: the acceleration is about {norm:.2f} m/s^2, not 9.81'))
    rate = np.median(np.linalg.norm(gyro, axis=1))
    if np.max(np.abs(gyro)) > 35 or rate > FASTEST:
        result.append(Finding(ERROR, f'{topic}: turn rates up to {np.max(np.abs(gyro)):.0f}, their median {rate:.1f}: they seem to be in degrees; rad/s are needed: convert them, '
                              f'or replay with {instead}', instead))
    elif not gyro.any():
        result.append(Finding(WARNING, f'{topic}: the turn rate is always zero, an accelerometer alone helps no node: replay with {instead}', instead))
    for what, readings in (('accelerations', accel), ('turn rates', gyro)):
        least, unit = LEAST_RANGE[what]
        clipped = cut_off(readings, least)
        if clipped:
            result.append(Finding(WARNING, f'{topic}: {clipped[1]} {what} are cut off at {clipped[0]:.3g} {unit}, the end of the sensor\'s range: scale, vertical and turns '
                                  'err; set a wider range in its driver, or damp its mount, and record again'))
    return result


def gravity_and_start(topic, stream, facts, base):
    """Whether the mean specific force points up in the body frame, and whether the recording begins at rest."""
    accel, gyro, stamps = np.array(stream.accel), np.array(stream.gyro), np.array(stream.stamps)
    finite = np.isfinite(accel).all(1) & np.isfinite(gyro).all(1)
    accel, gyro, stamps = accel[finite], gyro[finite], stamps[finite]
    result = []
    if len(accel) < 20:
        return result
    frame = sorted(stream.frames)[0].lstrip('/')
    T_base_imu = facts.static_transform(base, frame)
    mean = accel.mean(0)
    if T_base_imu is not None and frame != base and np.linalg.norm(mean) > 0:
        up = T_base_imu[:3, :3] @ mean / np.linalg.norm(mean)
        if up[2] < np.cos(np.radians(45)):
            sign = ', or it has the sign of gravity (at rest it must be +9.81 along the axis that points up)' if up[2] < -np.cos(np.radians(45)) else ''
            result.append(Finding(WARNING, f'{topic}: its mean acceleration points along ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}) of {base}, which is not up: '
                                  f'the mounting {base} -> {quoted(stream.frames)} or the order of the axes is wrong (or {base} is not z up){sign}'))
    first = (stamps >= stamps[0]) & (stamps < stamps[0] + 1.0)
    bins = ((stamps[first] - stamps[0]) / 0.1).astype(int)
    means = np.array([gyro[first][bins == b].mean(0) for b in np.unique(bins)])
    # White noise is what differs from one reading to the next: a noisy gyro's means spread without any motion.
    noise = np.diff(gyro[first], axis=0).var(0).sum() / 2 / max(1, np.median(np.bincount(bins)))
    if len(means) > 4 and means.var(0).sum() > REST ** 2 + 2 * noise:  # that of ten means scatters by a quarter
        result.append(Finding(WARNING, f'{topic}: the recording begins in motion; gyro bias and gravity are known later than after a second at rest'))
    return result
