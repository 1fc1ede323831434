"""Which counts of 16-bit images are black and white: by the rule of the nodes (PixelRange of air_ground_common), of several images at once."""
from dataclasses import dataclass

import numpy as np

BITS = (10, 12, 14, 16)    # that cameras have
HOT = 1e-4                 # of the pixels, at least one, may lie beyond the camera's bits
TAIL, MARGIN = 0.005, 0.1  # of the pixels, left out at each end; of what is left, room on either side
NARROW, EVEN = 1 / 4, 1 / 256  # of the range: what uses less is stretched; what uses less is noise


@dataclass
class Levels:
    """low becomes 0, high 256."""
    bits: int = 16
    low: float = 0.0
    high: float = 65536.0

    def narrow(self):
        """Whether the camera's range is stretched."""
        return self.high - self.low < 1 << self.bits

    def grey(self, counts):
        """uint8 of uint16."""
        return np.clip((counts - self.low) * (256 / (self.high - self.low)), 0, 255).astype(np.uint8)


def levels(images):
    """The Levels that all of the images (uint16) can be seen with. Images of one even grey have no say."""
    brightest, used = 0, []
    for image in images:
        histogram = np.bincount(np.ravel(image), minlength=65536)
        below, count = np.cumsum(histogram), np.size(image)
        brightest = max(brightest, int(np.searchsorted(below, count - max(1, int(HOT * count)), side='left')))
        low, high = np.searchsorted(below, np.array([TAIL, 1 - TAIL]) * (count - 1), side='right')
        used.append((low, high + 1))
    if brightest == 0:
        return Levels()
    bits = next(bits for bits in BITS if brightest >> bits == 0)
    used = [(low, high) for low, high in used if high - low >= EVEN * (1 << bits)]
    low, high = (min(low for low, _ in used), max(high for _, high in used)) if used else (0, 1 << bits)
    if high - low >= NARROW * (1 << bits):
        return Levels(bits, 0.0, float(1 << bits))
    margin = MARGIN * (high - low)
    return Levels(bits, float(low - margin), float(high + margin))
