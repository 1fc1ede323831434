"""What a check of a bag found."""
from collections import namedtuple

ERROR, WARNING, OK = 'ERROR', 'WARNING', 'ok'
Finding = namedtuple('Finding', 'level text argument', defaults=('',))  # argument: what the launch command needs because of it


def quoted(frames):
    return ', '.join(repr(f) for f in sorted(frames))
