"""Recordings in parts, as rosbag record --split leaves them: prefix_2026-11-30-10-00-00_0.bag, or name_0.bag."""
import glob
import os
import re
import shlex

from .bag_reader import BagError, open_bag

PART = re.compile(r'(?P<prefix>.*?)(?P<time>_\d{4}(-\d\d){5})?_(?P<number>\d+)\.bag')
PAUSE = 2.0  # [s] at the most from one part to the next


def _span(path):
    """When a bag begins and ends [s]; None where it cannot be read."""
    try:
        with open_bag(path) as bag:
            return bag.get_start_time(), bag.get_end_time()
    except BagError:
        return None


def parts_beside(path):
    """Paths of the parts of the recording that the bag at `path` is one of, in order; empty where it is whole. Bags of other recordings may have the same names and numbers: parts
    follow each other in time."""
    folder, match = os.path.dirname(path), PART.fullmatch(os.path.basename(path))
    if match is None:
        return []
    numbered, spans = {}, {path: _span(path)}
    for other in sorted(glob.glob(os.path.join(glob.escape(folder), glob.escape(match['prefix']) + '_*.bag'))):
        its = PART.fullmatch(os.path.basename(other))
        if its is not None and its['prefix'] == match['prefix'] and (its['time'] is None) == (match['time'] is None):
            numbered.setdefault(int(its['number']), []).append(other)

    def next_to(part, number, edge):
        """The bag of that number that begins (edge 1) where `part` ends, or ends (0) where it begins; None where there is none."""
        for other in numbered.get(number, []) if spans[part] else []:
            if other not in spans:
                spans[other] = _span(other)
            if spans[other] and abs(spans[part][edge] - spans[other][1 - edge]) < PAUSE:
                return other
        return None

    number, parts = int(match['number']), [path]
    first = last = number
    while before := next_to(parts[0], first - 1, 0):
        parts, first = [before, *parts], first - 1
    while after := next_to(parts[-1], last + 1, 1):
        parts, last = [*parts, after], last + 1
    return parts if len(parts) > 1 else []


def advice(path):
    """What to do with one part of a recording: one line, or none where the bag is whole."""
    parts = parts_beside(path)
    if not parts:
        return []
    whole = os.path.join(os.path.dirname(path), PART.fullmatch(os.path.basename(path))['prefix'] + '.bag')
    return [f'{os.path.basename(path)} is one of {len(parts)} parts of a recording (rosbag record --split), and what is latched or sent once is in the first alone:  '
            f'rosrun air_ground join_bags {" ".join(map(shlex.quote, parts))} {shlex.quote(whole)}  makes one bag of them']
