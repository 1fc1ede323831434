#!/usr/bin/env python3
"""make test must end with the cases that were skipped and why: GoogleTest and ctest count them as passed."""
import importlib.machinery
import importlib.util
import os
import unittest

import rospkg
import rosunit

loader = importlib.machinery.SourceFileLoader('run_tests', os.path.join(rospkg.RosPack().get_path('air_ground'), 'tools', 'run_tests'))
run_tests = importlib.util.module_from_spec(importlib.util.spec_from_loader('run_tests', loader))
loader.exec_module(run_tests)

LOG = '''3/4 Testing: agz_test
Output:
[ RUN      ] Agz.Drift
/src/agz_test.cpp:31: Skipped
the logs are not there

[  SKIPPED ] Agz.Drift (0 ms)
[ RUN      ] Agz.Other
/src/agz_test.cpp:40: Skipped
the logs are not there

[  SKIPPED ] Agz.Other (0 ms)
[ RUN      ] Agz.Unit
[       OK ] Agz.Unit (3 ms)
[  SKIPPED ] 2 tests, listed below:
[  SKIPPED ] Agz.Drift
[  SKIPPED ] Agz.Other
4/4 Testing: other_test
[ RUN      ] Index/All.Search/1
[  SKIPPED ] Index/All.Search/1: built without it
'''


class RunTests(unittest.TestCase):
    def test_skipped_cases_are_counted_with_their_reason(self):
        text = run_tests.summary(run_tests.skipped_cases(LOG.splitlines(True)))
        self.assertEqual(text.splitlines(), ['3 test cases were SKIPPED and prove nothing:', '  agz_test: 2: the logs are not there',
                                             '  other_test: 1: built without it'])

    def test_none_is_said_too(self):
        self.assertEqual(run_tests.summary(run_tests.skipped_cases(['1/1 Testing: a\n', '[       OK ] A.B (3 ms)\n'])), 'no test case was skipped')


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'run_tests_test', RunTests)
