"""For tests: a program of ../scripts as a module."""
import importlib.machinery
import importlib.util
import os
import sys
from unittest import mock

SCRIPTS = os.path.join(os.path.dirname(os.path.realpath(__file__)), '..', 'scripts')


def load(name):
    """Under another name than the modules that it imports, and without leaving a .pyc beside it."""
    loader = importlib.machinery.SourceFileLoader(f'program_{name}', os.path.join(SCRIPTS, name))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(loader.name, loader))
    with mock.patch.object(sys, 'dont_write_bytecode', True):
        loader.exec_module(module)
    return module
