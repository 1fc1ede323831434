"""What the demonstrations share: worlds rendered into the cache, roslaunch on a master of its own, rviz on a virtual display."""
import os
import random
import re
import shutil
import socket
import subprocess
import sys
import tempfile

INTERRUPTED = 130  # exit status after Ctrl-C, as shells have it


def cache_folder():
    return os.path.abspath(os.environ.get('AIR_GROUND_CACHE') or os.path.expanduser('~/.cache/air_ground'))


def package_file(name):
    import rospkg  # not where this is read without ROS
    return os.path.join(rospkg.RosPack().get_path('air_ground'), name)


def find_program(name):
    """Path of a program of this package: beside the scripts, in the package's lib folder, or on PATH. In the workspace that was
    sourced: rosrun asks which one is meant where a second one lies below the package (make test SANITIZE=...)."""
    scripts = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    candidates = [os.path.join(scripts, name)]
    for prefix in os.environ.get('CMAKE_PREFIX_PATH', '').split(os.pathsep):
        candidates.append(os.path.join(prefix, 'lib', 'air_ground', name))
    candidates.append(package_file(os.path.join('..', '..', 'lib', 'air_ground', name)))
    for candidate in candidates:
        if os.access(candidate, os.X_OK):
            return candidate
    return shutil.which(name) or name


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
    command = [find_program('simulate'), '--world', world, '--seed', str(seed), '--cache', os.path.join(cache_folder(), 'bags')] + extra
    result = subprocess.run(command, check=False, stdout=subprocess.PIPE, text=True)
    bag = result.stdout.strip().splitlines()[-1] if result.stdout.strip() else ''
    if result.returncode != 0 or not os.path.isfile(bag):
        sys.exit(f'{program}: rendering failed; the lines above say why. Command: {" ".join(command)}')
    return bag


def _wait(process, timeout):
    """Until it has ended; whether Ctrl-C asked for that: the process has had the signal, too, and has nodes and a master to stop, for longer than subprocess.run would wait."""
    interrupted = False
    while True:
        try:
            process.wait(timeout)
            return interrupted
        except KeyboardInterrupt:
            interrupted = True
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise


def run_replay(command, environment, timeout=None, **how):
    """Runs roslaunch with a replay; returns the status that its report ended with: roslaunch's own is 0 whatever happens. 1 if it never ended, INTERRUPTED after Ctrl-C. timeout [s]: see subprocess.run."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, 'status')
        if _wait(subprocess.Popen(command, env=dict(environment, AIR_GROUND_REPLAY_STATUS=path), **how), timeout):
            return INTERRUPTED
        try:
            with open(path, encoding='ascii') as stream:
                return int(stream.read())
        except (OSError, ValueError):
            return 1


# A launch-prefix: lets all others have the processor first. Kernels that group processes by sessions weigh the groups (autogroup).
BEHIND_ALL = """sh -c '{ echo 19 > /proc/self/autogroup; } 2> /dev/null; exec nice -n 19 "$0" "$@"'"""


def unwatched(rviz_config, folder):
    """A copy of rviz's configuration for a display that nobody looks at: drawn by the processor, ten pictures a second would take more of it than
    any node."""
    with open(rviz_config, encoding='utf-8') as stream:
        text, found = re.subn(r'Frame Rate: \d+', 'Frame Rate: 1', stream.read())
    if found != 1:
        raise ValueError(f'{rviz_config}: {found} lines with a frame rate instead of one')
    path = os.path.join(folder, os.path.basename(rviz_config))
    with open(path, 'w', encoding='utf-8') as stream:
        stream.write(text)
    return path


def _report_of(out):
    """What tells a folder's report from another one; None without."""
    try:
        found = os.stat(os.path.join(out, 'report.yaml'))
        return found.st_ino, found.st_mtime_ns
    except OSError:
        return None


def launch(program, file, arguments, out, rviz_config, bear_failure=False, **how):
    """Runs a launch file of the package, which must write report.yaml into `out`; exits when it does not, or (unless bear_failure) says that
    the replay failed. `rviz_config`: a file, or None for a replay without rviz. `how` goes to subprocess.Popen."""
    with tempfile.TemporaryDirectory() as folder:
        launch_in(folder, program, file, arguments, out, rviz_config, bear_failure, **how)


def launch_in(folder, program, file, arguments, out, rviz_config, bear_failure, **how):
    environment = dict(os.environ)
    port = free_port()  # a master of its own: one that runs already is left alone
    environment['ROS_MASTER_URI'] = f'http://localhost:{port}'
    rviz = rviz_config is not None and shutil.which('rviz') is not None
    command = ['roslaunch', '-p', str(port), 'air_ground', file] + arguments + [f'out:={out}']
    if rviz and not environment.get('DISPLAY'):
        if shutil.which('xvfb-run'):
            environment.update(LIBGL_ALWAYS_SOFTWARE='1', LP_NUM_THREADS='1')
            environment.pop('WAYLAND_DISPLAY', None)
            command = ['xvfb-run', '-a', '-s', '-screen 0 1600x1000x24 +extension GLX'] + command
            # It has crashed while starting, on such a display, and nobody is there to start it again.
            command += [f'rviz_config:={unwatched(rviz_config, folder)}', 'rviz_respawn:=true', f'rviz_prefix:={BEHIND_ALL}']
        else:
            rviz = False
            print('-- no display and no xvfb-run (package xvfb): the replay runs without rviz', flush=True)
    command.append(f'rviz:={"true" if rviz else "false"}')
    before = _report_of(out)
    status = run_replay(command, environment, **how)
    if status == INTERRUPTED:
        sys.exit(status)
    if _report_of(out) in (None, before):
        sys.exit(f'{program}: the replay ended without a report; the first error among the lines above says why')
    if status and not bear_failure:
        sys.exit(f'{program}: the replay failed; the last error among the lines above says in what')
