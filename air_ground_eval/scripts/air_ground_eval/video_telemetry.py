"""Reader of the telemetry that DJI's drones leave beside a video as subtitles (.SRT): where GPS had them, line by line."""
import glob
import os
import re

import numpy as np

from .recording import Gps

DEVIATIONS = (5.0, 50.0)  # horizontal, vertical [m]; what abs_alt counts from differs from drone to drone by tens of metres
TIME = re.compile(r'(\d+):(\d+):(\d+)[,.](\d+)\s*-->')
NUMBER = r'\s*(-?\d+(?:\.\d+)?)'
LATITUDE = re.compile(r'latitude\s*:' + NUMBER, re.IGNORECASE)
LONGITUDE = re.compile(r'longt?itude\s*:' + NUMBER, re.IGNORECASE)  # 'longtitude' in some firmware
HEIGHT = re.compile(r'(?:abs_alt|altitude)\s*:' + NUMBER, re.IGNORECASE)
OLDER = re.compile(r'GPS\s*\(' + NUMBER + r'\s*,' + NUMBER + r'\s*(?:,' + NUMBER + r')?', re.IGNORECASE)  # longitude first


def path_beside(video):
    """The .srt of the video's name, in whatever case; None where there is none."""
    stem = glob.escape(os.path.splitext(video)[0])
    return next(iter(sorted(path for path in glob.glob(stem + '.*') if path.lower().endswith('.srt'))), None)


def place_of(block):
    """Latitude, longitude [deg] and height [m], or None: no such line, or zeros, which stand for no reception."""
    latitude, longitude, height = LATITUDE.search(block), LONGITUDE.search(block), HEIGHT.search(block)
    if latitude and longitude:
        place = float(latitude.group(1)), float(longitude.group(1)), float(height.group(1)) if height else 0.0
    elif older := OLDER.search(block):
        place = float(older.group(2)), float(older.group(1)), float(older.group(3) or 0)
    else:
        return None
    known = abs(place[0]) <= 90 and abs(place[1]) <= 180 and place[:2] != (0.0, 0.0)
    return place if known else None


def read_gps(path, notes):
    """recording.Gps on the video's time line, or None; appends to notes. A place that stays is one reading: lines come with each image, GPS does not."""
    with open(path, encoding='utf-8', errors='replace') as stream:
        blocks = re.split(r'\r?\n\s*\r?\n', stream.read())
    stamps, places = [], []
    for block in blocks:
        time, place = TIME.search(block), place_of(block)
        if time is None or place is None or (places and places[-1] == place):
            continue
        hours, minutes, seconds = (int(group) for group in time.groups()[:3])
        stamp = 3600 * hours + 60 * minutes + seconds + float('0.' + time.group(4))
        if not stamps or stamp > stamps[-1]:
            stamps.append(stamp)
            places.append(place)
    name = os.path.basename(path)
    if not stamps:
        notes.append(f'{name} beside the video holds no place that could be read: no GPS')
        return None
    notes.append(f'GPS of {name}: {len(stamps)} places, taken to be known to {DEVIATIONS[0]:g} m; their heights count from where the drone says, and tell little')
    return Gps(np.array(stamps), np.array(places), np.tile(DEVIATIONS, (len(stamps), 1)))
