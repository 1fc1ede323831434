"""YAML files that people and other programs write."""
import yaml


def read_mapping(path, error_type, expected):
    """Content of a YAML file of named values. Lines that begin with %, as "%YAML:1.0" of OpenCV and EuRoC, are no YAML.

    error_type(one line) says what is wrong with the file, or that `expected` was not in it.
    """
    try:
        with open(path, encoding='utf-8') as stream:
            content = yaml.safe_load(''.join(line for line in stream if not line.startswith('%')))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise error_type(f'{path}: {" ".join(str(error).split())}') from error
    if not isinstance(content, dict):
        raise error_type(f'{path}: expected {expected}')
    return content
