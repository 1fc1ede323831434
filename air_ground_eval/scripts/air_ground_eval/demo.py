"""What the demonstrations share: worlds rendered into the cache, roslaunch on a master of its own, rviz on a virtual display."""
import os
import random
import shutil
import socket
import subprocess
import sys
import tempfile


def cache_folder():
    return os.path.abspath(os.environ.get('AIR_GROUND_CACHE') or os.path.expanduser('~/.cache/air_ground'))


def free_port():
    """Below those that the system hands out, lest another process gets it before the master does."""
    while True:
        port = random.randrange(20000, 30000)
        with socket.socket() as s:
            try:
                s.bind(('127.0.0.1', port))
                return port
            except OSError:
                continue


def rendered_bag(program, world, seed, extra):
    """Path of the world's bag: `simulate` takes it from the cache when it was rendered before. Exits when that fails."""
    print(f'-- world {world}, seed {seed}: rendering its sensors, unless the cache has them (minutes)', flush=True)
    command = ['rosrun', 'air_ground', 'simulate', '--world', world, '--seed', str(seed), '--cache', os.path.join(cache_folder(), 'bags')] + extra
    result = subprocess.run(command, check=False, stdout=subprocess.PIPE, text=True)
    bag = result.stdout.strip().splitlines()[-1] if result.stdout.strip() else ''
    if result.returncode != 0 or not os.path.isfile(bag):
        sys.exit(f'{program}: rendering failed; the lines above say why. Command: {" ".join(command)}')
    return bag


def run_replay(command, environment, **how):
    """Runs roslaunch with a replay; returns the status that its report ended with: roslaunch's own is 0 whatever happens. 1 if it never ended."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, 'status')
        subprocess.run(command, env=dict(environment, AIR_GROUND_REPLAY_STATUS=path), check=False, **how)
        try:
            with open(path, encoding='ascii') as stream:
                return int(stream.read())
        except (OSError, ValueError):
            return 1


def launch(program, file, arguments, out, with_rviz, bear_failure=False, **how):
    """Runs a launch file of the package, which must write report.yaml into `out`; exits when it does not, or (unless bear_failure) says that
    the replay failed. `how` goes to subprocess.run."""
    environment = dict(os.environ)
    port = free_port()  # a master of its own: one that runs already is left alone
    environment['ROS_MASTER_URI'] = f'http://localhost:{port}'
    rviz = with_rviz and shutil.which('rviz') is not None
    command = ['roslaunch', '-p', str(port), 'air_ground', file] + arguments + [f'out:={out}']
    if rviz and not environment.get('DISPLAY'):
        if shutil.which('xvfb-run'):
            environment.update(LIBGL_ALWAYS_SOFTWARE='1', LP_NUM_THREADS='1')
            environment.pop('WAYLAND_DISPLAY', None)
            command = ['xvfb-run', '-a', '-s', '-screen 0 1600x1000x24 +extension GLX'] + command
        else:
            rviz = False
            print('-- no display and no xvfb-run (package xvfb): the replay runs without rviz', flush=True)
    command.append(f'rviz:={"true" if rviz else "false"}')
    report = os.path.join(out, 'report.yaml')
    if os.path.exists(report):
        os.remove(report)
    status = run_replay(command, environment, **how)
    if not os.path.isfile(report):
        sys.exit(f'{program}: the replay ended without a report; the first error among the lines above says why')
    if status and not bear_failure:
        sys.exit(f'{program}: the replay failed; the last error among the lines above says in what')
