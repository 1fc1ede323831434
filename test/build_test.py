#!/usr/bin/env python3
"""Building as other people do it: inside a catkin workspace, below a folder with a space in its name, beside ROS Noetic of Ubuntu."""
import os
import shutil
import subprocess
import tempfile
import unittest

ROOT = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))


def run(command, folder, **variables):
    """(exit status, what it said)"""
    environment = {**{name: value for name, value in os.environ.items() if not name.startswith(('MAKE', 'MFLAGS'))}, **variables}
    result = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    return result.returncode, result.stdout


class Build(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.folder = temporary.name

    def test_catkin_workspace(self):
        """There the project is one of several below another's CMakeLists.txt, as catkin_make has it."""
        os.makedirs(os.path.join(self.folder, 'src'))
        os.symlink(ROOT, os.path.join(self.folder, 'src', 'air_ground'))
        status, said = run(['catkin_init_workspace', 'src'], self.folder)
        self.assertEqual(status, 0, said)
        status, said = run(['cmake', '-S', 'src', '-B', 'build', '-G', 'Ninja', '-DPYTHON_EXECUTABLE=/usr/bin/python3', f'-DCATKIN_DEVEL_PREFIX={self.folder}/devel',
                            '-DCATKIN_ENABLE_TESTING=ON', '-DAIR_GROUND_BENCHMARKS=ON', '-Wno-dev'], self.folder)
        self.assertEqual(status, 0, said[-3000:])
        status, said = run(['ctest', '-N', '-V'], os.path.join(self.folder, 'build'))
        self.assertEqual(status, 0, said)
        self.assertIn('rostest_documentation', said)
        missing = {word for line in said.splitlines() if 'Test command:' in line for word in line.split('"')[1::2] if word.startswith(f'{self.folder}/src/') and not os.path.exists(word)}
        self.assertEqual(missing, set())

    def test_a_space_in_the_path_is_refused(self):
        """Split there, the path would have make clean remove the folder above it."""
        clone = os.path.join(self.folder, 'my clone')
        os.mkdir(clone)
        shutil.copy(os.path.join(ROOT, 'Makefile'), clone)
        for command, folder in ((['make', '-n', 'clean'], clone), (['make', '-n', '-f', os.path.join(clone, 'Makefile'), 'clean'], self.folder)):
            status, said = run(command, folder)
            self.assertNotEqual(status, 0, said)
            self.assertIn('space in the path', said)
            self.assertNotIn('rm -rf', said)

    def test_beside_noetic_the_tools_come_from_the_archive(self):
        """rosdep knows what package.xml names, not what builds and draws: without Ninja nothing is configured."""
        stubs = os.path.join(self.folder, 'bin')
        os.mkdir(stubs)
        for name, script in (('dpkg-query', 'exit 1'), ('sudo', 'exec "$@"'), ('apt-get', 'echo apt-get "$@"'), ('rosdep', 'echo rosdep "$@"')):
            with open(os.path.join(stubs, name), 'w', encoding='ascii') as stream:
                stream.write(f'#!/bin/sh\n{script}\n')
            os.chmod(os.path.join(stubs, name), 0o755)
        status, said = run([os.path.join(ROOT, 'tools', 'install_packages'), 'doxygen'], self.folder, NOETIC=self.folder, PATH=f'{stubs}:{os.environ["PATH"]}')
        self.assertEqual(status, 0, said)
        installed = next(line for line in said.splitlines() if line.startswith('apt-get install')).split()
        for package in ('ninja-build', 'xvfb', 'doxygen'):
            self.assertIn(package, installed)
        for package in ('ros-base-dev', 'libembree-dev'):  # of Debian's ROS, and what rosdep installs
            self.assertNotIn(package, installed)
        self.assertIn('rosdep install --from-paths', said)


if __name__ == '__main__':
    unittest.main()
