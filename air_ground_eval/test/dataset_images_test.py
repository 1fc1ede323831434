#!/usr/bin/env python3
"""dataset_to_bag: depth in floating point or 32 bits, images with a palette, what is no measurement; and no bag is overwritten unasked."""
import os
import resource
import signal
import subprocess
import sys
import unittest
import warnings

import numpy as np
import rosunit
from PIL import Image

HERE = os.path.dirname(os.path.realpath(__file__))
sys.path[:0] = [HERE, os.path.join(HERE, '..', 'scripts')]
from air_ground_eval import datasets, recording, registration  # noqa: E402
from air_ground_eval.recording import DatasetError, read_image  # noqa: E402
from dataset_to_bag_test import convert, messages_of  # noqa: E402
from rgbd_folders_test import RgbdFolders  # noqa: E402

WIDTH, HEIGHT = 64, 48


def ramp(kind, low, high):
    return np.linspace(low, high, WIDTH * HEIGHT).reshape(HEIGHT, WIDTH).astype(kind)


class DatasetImages(unittest.TestCase):
    setUp, inside = RgbdFolders.setUp, RgbdFolders.inside

    def save(self, image, *names):
        os.makedirs(os.path.dirname(self.inside(*names)), exist_ok=True)
        (image if isinstance(image, Image.Image) else Image.fromarray(image)).save(self.inside(*names))
        return self.inside(*names)

    def scene(self, depth, extension):
        """Two images of each, in numbered folders of an ICL-NUIM-like layout without a known unit."""
        for i in range(2):
            self.save(ramp(np.uint8, 0, 255), 'scene', 'rgb', f'{i}.png')
            self.save(depth, 'scene', 'depth', f'{i}.{extension}')
        with open(self.inside('scene', 'calibration.txt'), 'w', encoding='utf-8') as stream:
            stream.write('60 60 31.5 23.5\n')
        return self.inside('scene')

    def config(self, text):
        with open(self.inside('config.yaml'), 'w', encoding='utf-8') as stream:
            stream.write(text)
        return self.inside('config.yaml')

    def test_texts_of_another_encoding_and_layouts_of_no_name(self):
        folder = self.inside('tum')
        self.save(ramp(np.uint8, 0, 255), 'tum', 'rgb', '1.png')
        self.save(ramp(np.uint8, 0, 255), 'tum', 'rgb', '2.png')
        for name, line in (('calibration.txt', b'60 60 31.5 23.5'), ('rgb.txt', b'# K\xfcche\n1.5 rgb/1.png\n2.5 rgb/2.png'), ('groundtruth.txt', b'# K\xfcche\n1.5 1 2 3 0 0 0 1\n2.5 1 2 4 0 0 0 1')):
            with open(self.inside('tum', name), 'wb') as stream:
                stream.write(line + b'\n')
        found = datasets.read_recording(folder, 'auto', {})
        self.assertEqual((len(found.colour), list(found.pose_stamps)), (2, [1.5, 2.5]))
        for layout in ('foo', ['tum'], None):
            with self.assertRaisesRegex(DatasetError, 'layout: .* is not known; known are auto, 7scenes, tum, euroc, numbered, agz'):
                datasets.read_recording(folder, layout, {})

    def millimetres(self, *arguments):
        result = convert('--ground', self.inside('scene'), '--out', self.bag, *arguments)
        self.assertEqual(result.returncode, 0, result.stderr)
        return np.frombuffer(messages_of(self.bag, '/ground/depth/image_raw')[0].data, np.uint16).reshape(HEIGHT, WIDTH)

    def test_depth_in_floating_point_is_in_metres(self):
        """2.37 m were 2 steps of a millimetre, and what is not a number any number."""
        depth = np.full((HEIGHT, WIDTH), 2.37, np.float32)
        depth[0, :6] = np.nan, np.inf, -np.inf, -1, 0, 80
        depth[1, 0] = 0.5
        expected = np.full((HEIGHT, WIDTH), 2370, np.uint16)
        expected[0, :6], expected[1, 0] = 0, 500
        self.scene(depth, 'tif')
        np.testing.assert_array_equal(self.millimetres(), expected)
        self.assertIn('floating point: taken for metres', messages_of(self.bag, '/dataset_info')[0].data)
        with warnings.catch_warnings():
            warnings.simplefilter('error')
            found = datasets.read_recording(self.inside('scene'), 'auto', {})
            np.testing.assert_array_equal(registration.depth_in_millimetres(found, found.depth[0].path), expected)

    def test_depth_in_floating_point_of_another_unit(self):
        """Millimetres in floating point are told by their size, as nothing would be kept of them; --config says so."""
        self.scene(np.full((HEIGHT, WIDTH), 2370, np.float32), 'tif')
        result = convert('--ground', self.inside('scene'), '--out', self.bag)
        self.assertEqual((result.returncode, result.stderr.count('\n')), (1, 1), result.stderr)
        self.assertIn('are they millimetres? Say so by "depth_counts_per_metre: 1000"', result.stderr)
        np.testing.assert_array_equal(self.millimetres('--config', self.config('depth_counts_per_metre: 1000\n')), 2370)

    def test_depth_of_32_bits(self):
        """237000 counts were 40392: 16 bits of them. Those that fit are counts as any; below zero there is no depth."""
        for counts, text in ((237000, 'depth of 237000 counts, of which 16 bits hold 65535: write it as 16-bit PNG'), (65536, '65536 counts')):
            path = self.save(np.full((HEIGHT, WIDTH), counts, np.int32), 'deep.tif')
            with self.assertRaisesRegex(DatasetError, text):
                read_image(path, depth=True)
        depth = np.full((HEIGHT, WIDTH), 2370, np.int32)
        depth[0, 0] = -1
        self.scene(depth, 'tif')
        found = self.millimetres()
        self.assertEqual((found[0, 0], found[1, 1]), (0, 2370))

    def test_a_picture_of_depth_is_none(self):
        palette = Image.fromarray(ramp(np.uint8, 0, 255)).convert('P')
        for picture in (ramp(np.uint8, 0, 255), palette, Image.fromarray(ramp(np.uint8, 0, 255)).convert('1')):
            with self.assertRaisesRegex(DatasetError, 'is a picture of depth, no measurement: give the images that it was made of'):
                read_image(self.save(picture, 'depth.png'), depth=True)
        with self.assertRaisesRegex(DatasetError, 'one channel'):
            read_image(self.save(np.dstack([ramp(np.uint8, 0, 255)] * 3), 'depth.png'), depth=True)

    def test_images_with_a_palette_have_its_colours(self):
        """A pixel of 0 was black, whatever colour stands first in the palette."""
        image = Image.fromarray((np.indices((HEIGHT, WIDTH)).sum(0) % 2).astype(np.uint8), 'P')
        image.putpalette([200, 100, 50, 10, 20, 30])
        found = read_image(self.save(image, 'palette.png'))
        self.assertEqual((found[0, 0].tolist(), found[0, 1].tolist()), ([200, 100, 50], [10, 20, 30]))
        two = Image.fromarray(ramp(np.uint8, 0, 255)).point(lambda value: 255 * (value > 127)).convert('1')
        self.assertEqual(np.unique(read_image(self.save(two, 'two.png'))).tolist(), [0, 255])

    def test_grey_of_32_bits_is_limited(self):
        """As a colour image, and for the scale of all of them."""
        counts = ramp(np.int32, 0, 70000)
        frames = [recording.Frame(i, self.save(counts, f'{i}.tif')) for i in range(2)]
        found = recording.Recording('x', frames, None)
        recording.settle_levels(found)
        self.assertEqual((frames[0].levels.bits, frames[0].read()[-1, -1]), (16, 255))

    def test_a_bag_is_not_overwritten_unasked(self):
        self.scene(np.full((HEIGHT, WIDTH), 2370, np.uint16), 'png')
        with open(self.bag, 'w', encoding='utf-8') as stream:
            stream.write('a flight of mine')
        result = convert('--ground', self.inside('scene'), '--out', self.bag, force=False)
        self.assertEqual(result.returncode, 1)
        self.assertIn(f'--out: {self.bag} exists: name another, or --force overwrites it', result.stderr)
        with open(self.bag, encoding='utf-8') as stream:
            self.assertEqual(stream.read(), 'a flight of mine')
        self.assertTrue(np.all(self.millimetres() == 2370))  # with --force

    def test_a_bag_that_cannot_be_written(self):
        """Said in one line, before anything is read where that is known by then; what lies there stays."""
        self.scene(np.full((HEIGHT, WIDTH), 2370, np.uint16), 'png')
        names = sorted(os.listdir(self.inside()))
        program = [sys.executable, os.path.join(HERE, '..', 'scripts', 'dataset_to_bag'), '--ground', self.inside('scene'), '--out', self.bag]

        def full():
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (10000, 10000))

        result = subprocess.run(program, capture_output=True, text=True, check=False, preexec_fn=full)
        self.assertEqual((result.returncode, result.stderr.strip()), (1, f'dataset_to_bag: --out: {self.bag} cannot be written (File too large)'))
        self.assertEqual(sorted(os.listdir(self.inside())), names)
        os.makedirs(self.bag + '.part')
        result = convert('--ground', self.inside('no such scene'), '--out', self.bag)
        self.assertEqual((result.returncode, result.stderr), (1, f'dataset_to_bag: --out: {self.bag}.part cannot be written (Is a directory)\n'))
        self.assertTrue(os.path.isdir(self.bag + '.part'))


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'dataset_images_test', DatasetImages)
