"""Results of an earlier run make room for those of this one, and stay."""
import glob
import itertools
import os


def move_aside(folder, names):
    """Makes the folder. Files of these names (or patterns), of an earlier run, go into a new one in it: earlier-1, or the first number that is free. Returns that one, or None."""
    os.makedirs(folder, exist_ok=True)
    old = sorted({path for name in names for path in glob.glob(os.path.join(glob.escape(folder), name))})
    if not old:
        return None
    earlier = next(path for path in (os.path.join(folder, f'earlier-{i}') for i in itertools.count(1)) if not os.path.exists(path))
    os.mkdir(earlier)
    for path in old:
        os.rename(path, os.path.join(earlier, os.path.basename(path)))
    return earlier
