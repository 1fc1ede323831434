"""What a check of a bag found."""
from collections import namedtuple

ERROR, WARNING, OK = 'ERROR', 'WARNING', 'ok'
# argument: what the launch command needs because of it; beside: a command to run beside that one
Finding = namedtuple('Finding', 'level text argument beside', defaults=('', ''))


def quoted(frames):
    return ', '.join(repr(f) for f in sorted(frames))
