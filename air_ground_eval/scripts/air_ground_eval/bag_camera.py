"""Checks of the images of a camera and of its calibration: encodings, brightness, depth units, K, P and D."""
import copy
import re

import cv2
import numpy as np

from . import pixel_range, run_lengths
from .bag_finding import ERROR, OK, WARNING, Finding

GREY = ('mono8', 'mono16', *(f'{colours}{bits}' for colours in ('bgr', 'rgb', 'bgra', 'rgba') for bits in (8, 16)), 'yuv422', 'yuv422_yuy2', 'yuyv',
        *(f'bayer_{order}{bits}' for order in ('rggb', 'bggr', 'gbrg', 'grbg') for bits in (8, 16)), '8UC1', '8UC3', '8UC4', '16UC1')
DEPTH = {'16UC1': np.uint16, 'mono16': np.uint16, '32FC1': np.float32}  # encoding: type of a pixel
MODELS = {**dict.fromkeys(('plumb_bob', 'radtan', 'radial_tangential', 'brown_conrady', 'rational_polynomial'), 12), **dict.fromkeys(('equidistant', 'equi', 'fisheye', 'kannala_brandt'), 4),
          **dict.fromkeys(('', 'none', 'pinhole', 'perspective', 'inverse_brown_conrady'), 0)}  # as the nodes take them: how many coefficients each may have
RECTIFIED = re.compile(r'(^|[/_])rect(ified)?([/_]|$)')  # as image_proc and the drivers name them
UNDISTORTED = re.compile('undist')  # as others name them, of which the nodes take K and D
TURNED = 0.3  # [deg]: of a stereo pair's rectification, from which on it matters beside an IMU
FLAT = 5  # [of 255]: spread of the brightness, below which hardly any corner is found
DOUBTFUL, TOO_FAR = 6, 12  # [m]: half of an image's depths beyond this are of few, and of no, RGB-D cameras
FAR = 100  # [m]: half of an image's depths beyond this are of no depth camera


def of_images(info, topic):
    """The calibration of a topic's images, as the nodes take it: of rectified ones P, which says nothing of K and D; P, too, where K is empty."""
    distorted = any(info.D)
    if info.P[0] <= 0 or not (distorted and RECTIFIED.search(topic) or not distorted and not any(info.K)):
        return info
    own = copy.copy(info)
    own.K, own.D, own.distortion_model = [info.P[i] for i in (0, 1, 2, 4, 5, 6, 8, 9, 10)], [], 'plumb_bob'
    return own


def check_info(topic, stream, image):
    """image: the topic that it calibrates."""
    raw = stream.samples[0]
    info = of_images(raw, image)
    result = []
    if info is not raw:
        result.append(Finding(OK, f'{topic}: P is taken, not K and D, ' + (f'for {image} is rectified by its name' if any(raw.D) else 'for K is empty')))
    turn = np.degrees(np.arccos(np.clip((np.trace(np.reshape(raw.R, (3, 3))) - 1) / 2, -1, 1))) if any(raw.R) else 0
    if RECTIFIED.search(image) and turn > TURNED:
        result.append(Finding(WARNING, f'{topic}: rectification turned {image} by {turn:.1f} degrees (R), which the transform to {info.header.frame_id!r} does not tell: '
                              'better take the raw images'))
    if UNDISTORTED.search(image.lower()) and info is raw and any(raw.D):
        result.append(Finding(WARNING, f'{topic}: D is set, though {image} is undistorted by its name: if it is, publish its own calibration, without D, beside the replay under another name: '
                              f'rosrun air_ground publish_calibration --camera-info FILE.yaml image:={image} camera_info:={topic}_undistorted'))
    if not (info.K[0] > 0 and info.K[4] > 0):
        result.append(Finding(ERROR, f'{topic}: fx = {info.K[0]:g}, fy = {info.K[4]:g}: the camera is not calibrated'))
    elif not (0.1 * info.width < info.K[2] < 0.9 * info.width and 0.1 * info.height < info.K[5] < 0.9 * info.height):
        result.append(Finding(WARNING, f'{topic}: principal point ({info.K[2]:.1f}, {info.K[5]:.1f}) is far from the centre of {info.width}x{info.height}'))
    model, count = re.sub('[- ]', '_', info.distortion_model.lower()), len(np.trim_zeros(info.D, 'b'))
    if model not in MODELS:
        result.append(Finding(ERROR, f'{topic}: distortion model {info.distortion_model!r}; the nodes know plumb_bob, rational_polynomial, equidistant: undistort first'))
    elif not MODELS[model] and count:
        result.append(Finding(ERROR, f'{topic}: D is set, but distortion_model {info.distortion_model!r} does not say how it is meant; plumb_bob, for OpenCV\'s five'))
    elif count > MODELS[model]:
        result.append(Finding(ERROR, f'{topic}: {count} coefficients in D; distortion model {info.distortion_model} has at most {MODELS[model]}'))
    return result


def depths(image):
    """Its depths in metres (32FC1) or steps, where it has any; None of an image that cannot be read."""
    if image._type == 'sensor_msgs/CompressedImage':
        steps = picture(image)
        if steps is None or steps.dtype != np.uint16:
            return None
        if not image.format.startswith('32FC1; compressedDepth'):
            return steps
        a, b = np.frombuffer(image.data[4:12], '<f4')  # steps = a / depth + b
        return np.where(steps > 0, a / np.maximum(steps - b, 1e-6), np.nan).astype(np.float32)
    if image.encoding not in DEPTH:
        return None
    return None if _broken(image) else _rows(image, DEPTH[image.encoding], image.width)


def _rows(image, kind, count):
    """The first numbers (height, count) of this type in each row of a raw image."""
    dtype = np.dtype(kind).newbyteorder('>' if image.is_bigendian else '<')
    rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)[:, :count * dtype.itemsize]
    return np.ascontiguousarray(rows).view(dtype)


def _values_a_row(image):
    """Without what fills up the rows of a raw image."""
    generic = re.fullmatch(r'\d+[USF]C(\d*)', image.encoding)
    named = {'rgb': 3, 'bgr': 3, 'rgba': 4, 'bgra': 4, 'yuv': 2}.get(re.match('[a-z]*', image.encoding).group(), 1)
    return image.width * (int(generic.group(1) or 1) if generic else named)


def _broken(image):
    """Why the bytes of a raw image are not its pixels; '' where they are."""
    if not (image.width and image.height):
        return f'{image.width}x{image.height} pixels'
    if len(image.data) != image.step * image.height:
        return f'{len(image.data)} bytes for {image.height} rows of {image.step}'
    if image.step < image.width * np.dtype(DEPTH.get(image.encoding, np.uint8)).itemsize:
        return f'rows of {image.step} bytes are too short for {image.width} pixels of {image.encoding}'
    return ''


def known(depth):
    """Where an image of metres or steps has a depth: as the nodes, 0 and the last step of 16 bits are none."""
    return np.isfinite(depth) & (depth > 0) & ((depth != 65535) | (depth.dtype.kind == 'f'))


def check_depth(topic, images, instead=''):
    """What is wrong with a topic's depth images: `images` from all over the recording, since its first may look at a wall; `instead`: what may be taken in their place."""
    images = [depth for depth in map(depths, images) if depth is not None and depth.ndim == 2]
    valid = [depth[known(depth)] for depth in images]
    shares = [len(v) / max(1, d.size) for v, d in zip(valid, images)]
    if images and not any(shares):
        return [Finding(ERROR, f'{topic}: none of {len(images)} images from all over the recording has any depth (projector off? lens covered?){instead}')]
    if images and np.median(shares) < 0.02:
        return [Finding(WARNING, f'{topic}: {100 * np.median(shares):.1f} % of an image has a depth, which is too few to map by{instead}')]
    medians = [np.median(v) for v in valid if len(v)]
    if not medians:
        return []
    typical, far = np.median(medians), np.percentile(medians, 75)
    if images[0].dtype.kind == 'f':
        return [Finding(ERROR, f'{topic}: median depth {typical:.0f}; 32FC1 is read as metres: are these millimetres?')] if typical > FAR else []
    if typical > 1000 * TOO_FAR:
        return [Finding(WARNING, f'{topic}: median depth {typical:.0f} steps, {typical / 1000:.1f} m if they are millimetres: taken for 5000 a metre, as TUM\'s PNG images have it; '
                        'else set ground_depth_unit', 'ground_depth_unit:=0.0002')]
    if far > 1000 * DOUBTFUL:
        return [Finding(WARNING, f'{topic}: of every fourth image, half lies beyond {far / 1000:.1f} m if its steps are millimetres: if what is seen is nearer, set ground_depth_unit '
                        '(0.0002: TUM\'s PNG images)')]
    return []


def check_image(topic, stream, encodings, instead=''):
    """What is wrong with a topic's images. encodings: GREY or DEPTH; instead: as check_depth() has it."""
    image = stream.samples[0]
    result = check_depth(topic, stream.spread, instead) if encodings is DEPTH else []
    if image._type == 'sensor_msgs/CompressedImage':
        decoded = list(map(picture, stream.samples))
        pixels = next((found for found in decoded if found is not None), None)
        if pixels is None:
            return [Finding(ERROR, f'{topic}: the first images cannot be decoded (format {image.format!r})')]
        broken = sum(found is None for found in decoded)
        if broken:
            result.append(Finding(WARNING, f'{topic}: {broken} of the first {len(decoded)} images cannot be decoded: the nodes leave such out'))
        if encodings is DEPTH and (pixels.dtype != np.uint16 or pixels.ndim != 2):
            result.append(Finding(ERROR, f'{topic}: its images ({image.format}) are of {8 * pixels.itemsize} bits, which hold no depth: record {topic.rsplit("/", 1)[0]}/compressedDepth, '
                                  'or the raw images'))
        return result
    sound, faults = {i: sample for i, sample in enumerate(stream.samples, 1) if not _broken(sample)}, list(filter(None, map(_broken, stream.samples)))
    image = next(iter(sound.values()), image)
    if image.encoding not in encodings:
        result.append(Finding(ERROR, f'{topic}: encoding {image.encoding!r}; expected one of {", ".join(encodings)}'))
    if faults:
        result.append(Finding(WARNING if sound else ERROR, f'{topic}: {len(faults)} of the first {len(stream.samples)} images are broken ({faults[0]}): the nodes leave such out'))
    if sound and encodings is GREY:
        if '16' in image.encoding and 'a16' not in image.encoding:  # the nodes stretch none with an alpha channel
            counts = [_rows(sample, np.uint16, _values_a_row(sample)) for sample in sound.values()]
            levels = pixel_range.levels(counts)
            grey = levels.grey(counts[-1])
            if levels.narrow():
                result.append(Finding(OK, f'{topic}: its pixels use counts {levels.low:.0f} to {levels.high:.0f} of {1 << levels.bits}: the nodes stretch them, following slowly'))
            elif levels.bits < 16:
                result.append(Finding(OK, f'{topic}: its pixels use {levels.bits} of 16 bits: the nodes move them up'))
        else:
            grey = _rows(sound[max(sound)], np.uint8, _values_a_row(sound[max(sound)]))
        if grey.std() < FLAT:
            result.append(Finding(WARNING, f'{topic}: image {max(sound)} is flat (brightness {grey.mean():.0f} +- {grey.std():.1f} of 255): a covered lens? '
                                  'too dark?'))
    return result


def picture(message):
    """The pixels of a compressed image, None where they cannot be decoded. A compressedDepth image begins with 12 bytes of its own."""
    data = np.frombuffer(message.data, np.uint8)
    if 'compressedDepth rvl' in message.format:
        return run_lengths.decode(data[12:].tobytes())
    try:
        return cv2.imdecode(data[12:] if 'compressedDepth' in message.format else data, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None


def image_size(message):
    """(width, height) of a raw or compressed image; None where that cannot be told, or it has no pixels."""
    if message._type == 'sensor_msgs/Image':
        return (message.width, message.height) if message.width and message.height else None
    pixels = picture(message)
    return None if pixels is None else pixels.shape[1::-1]


def stated_size(info):
    """(width, height) of the images that a camera_info describes: width and height are the sensor's."""
    whole = 0 in (info.roi.width, info.roi.height)
    width, height = (info.width, info.height) if whole else (info.roi.width, info.roi.height)
    return width // max(1, info.binning_x), height // max(1, info.binning_y)


def resized(info, size):
    """What to do about images of another size than their calibration's."""
    scale = size[0] / max(1, info.width)
    if info.width and info.height and info.binning_x < 2 and not info.roi.width and abs(size[1] / info.height - scale) < 0.01 * scale:
        how = f': resized? Then fx, fy, cx, cy and size are to be multiplied by {scale:g} (D stays)'
    else:
        how = ': cut out, or of another mode of the camera? Calibrate it at this size'
    return how + '; publish that under another name (rosrun air_ground publish_calibration) and replay with it'
