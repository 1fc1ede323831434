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
    """Paths of the parts of the recording that the bag at `path` is one of, in order; empty where it is whole. Bags of other recordings may be numbered, too: parts follow each other in time."""
    folder, match = os.path.dirname(path), PART.fullmatch(os.path.basename(path))
    if match is None:
        return []
    numbered = {}
    for other in glob.glob(os.path.join(glob.escape(folder), glob.escape(match['prefix']) + '_*.bag')):
        its = PART.fullmatch(os.path.basename(other))
        if its is not None and its['prefix'] == match['prefix'] and (its['time'] is None) == (match['time'] is None):
            numbered.setdefault(int(its['number']), other)
    number, spans = int(match['number']), {}
    numbered[number] = path

    def follows(first):
        for n in (first, first + 1):
            if n in numbered and n not in spans:
                spans[n] = _span(numbered[n])
        return spans.get(first) is not None and spans.get(first + 1) is not None and abs(spans[first + 1][0] - spans[first][1]) < PAUSE

    begin = end = number
    while follows(begin - 1):
        begin -= 1
    while follows(end):
        end += 1
    return [numbered[n] for n in range(begin, end + 1)] if end > begin else []


def advice(path):
    """What to do with one part of a recording; '' where the bag is whole."""
    parts = parts_beside(path)
    if not parts:
        return ''
    whole = os.path.join(os.path.dirname(path), PART.fullmatch(os.path.basename(path))['prefix'] + '.bag')
    return (f'{os.path.basename(path)} is one of {len(parts)} parts of a recording (rosbag record --split), and what is latched or sent once is in the first alone:  '
            f'rosrun air_ground join_bags {" ".join(map(shlex.quote, parts))} {shlex.quote(whole)}  makes one bag of them')
