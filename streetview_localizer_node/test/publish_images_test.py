#!/usr/bin/env python3
"""publish_images says for whom it waits."""
import os
import queue
import subprocess
import tempfile
import threading
import time
import unittest

import cv2
import numpy as np
import rosunit
from roslib.packages import find_node


class PublishImages(unittest.TestCase):
    def test_who_waits_for_a_listener_says_so(self):
        with tempfile.TemporaryDirectory() as folder:
            cv2.imwrite(os.path.join(folder, 'a.png'), np.zeros((48, 64), np.uint8))
            with open(os.path.join(folder, 'cameras.csv'), 'w', encoding='ascii') as stream:
                stream.write('a.png 60 60 32 24\n')
            command = [find_node('air_ground', 'publish_images')[0], '--images', folder, '--cameras', os.path.join(folder, 'cameras.csv'), 'mav/camera/image_raw:=front/image_raw']
            with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=dict(os.environ, ROSCONSOLE_STDOUT_LINE_BUFFERED='1')) as process:
                lines, said, end = queue.Queue(), '', time.monotonic() + 40
                threading.Thread(target=lambda: [lines.put(line) for line in process.stdout], daemon=True).start()
                while 'listens to' not in said and time.monotonic() < end and process.poll() is None:
                    try:
                        said += lines.get(timeout=1)
                    except queue.Empty:
                        continue
                process.terminate()
            self.assertIn('no photograph is played before a node listens to /front/image_raw and /mav/camera/camera_info', said)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'publish_images_test', PublishImages)
