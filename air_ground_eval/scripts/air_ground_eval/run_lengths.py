"""Depth images as compressed_depth_image_transport writes them with format "rvl": Wilson, Fast Lossless Depth Image Compression, ISS 2017."""
import numpy as np


def decode(data):
    """(H, W) uint16 of bytes: width and height, then in turn the length of a run of zeros, that of a run of others, and the differences of these, in groups of three
    bits, the lowest first, whose fourth bit says that more follow; eight groups in a word. None where they do not make up an image."""
    width, height = (int(n) for n in np.frombuffer(data[:8], '<u4')) if len(data) >= 12 else (0, 0)
    if not 0 < width * height < 1 << 26:
        return None
    words = np.frombuffer(data[8:len(data) // 4 * 4], '<u4')
    groups = ((words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32)) & 15).ravel().astype(np.int64)
    last = groups < 8
    number = np.concatenate([[0], np.cumsum(last)[:-1]])  # that a group is of
    first = np.flatnonzero(np.concatenate([[True], last[:-1]]))
    numbers = np.zeros(number[-1] + 1, np.int64)
    np.add.at(numbers, number, (groups & 7) << np.minimum(3 * (np.arange(len(groups)) - first[number]), 33))
    depths, at, k, before = np.zeros(width * height, np.int64), 0, 0, 0
    while at < len(depths):
        if k + 1 >= len(numbers):
            return None
        zeros, others = numbers[k:k + 2]
        at, k = at + zeros, k + 2
        if at + others > len(depths) or k + others > len(numbers):
            return None
        folded = numbers[k:k + others]  # 0, -1, 1, -2, 2 ... as 0, 1, 2, 3, 4
        depths[at:at + others] = before + np.cumsum(np.where(folded % 2, -(folded + 1) // 2, folded // 2))
        before = depths[at + others - 1] if others else before
        at, k = at + others, k + others
    return depths.astype(np.uint16).reshape(height, width)
