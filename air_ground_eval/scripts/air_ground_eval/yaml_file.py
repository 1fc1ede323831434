"""YAML files that people and other programs write."""
import yaml


class _Loader(yaml.SafeLoader):
    """Knows the matrices that OpenCV writes: rows, cols, dt, data."""


_Loader.add_constructor('tag:yaml.org,2002:opencv-matrix', lambda loader, node: loader.construct_mapping(node, deep=True))


def read_mapping(path, error_type, expected):
    """Content of a YAML file of named values. Lines that begin with %, as "%YAML:1.0" of OpenCV and EuRoC, are no YAML.

    error_type(one line) says what is wrong with the file, or that `expected` was not in it.
    """
    try:
        with open(path, encoding='utf-8') as stream:
            content = yaml.load(''.join(line for line in stream if not line.startswith('%')), _Loader)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise error_type(f'{path}: {" ".join(str(error).split())}') from error
    if not isinstance(content, dict):
        raise error_type(f'{path}: expected {expected}')
    return content
