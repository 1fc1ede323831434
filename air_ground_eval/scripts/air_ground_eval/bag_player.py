"""Plays a bag to nodes, its static transforms whole.

`rosbag play` publishes /tf_static as it was recorded: of several latched messages a node that connects late gets the last, of others none. So
the union of all of them is published here, latched, for as long as the player lives, and the player's own goes where nobody listens.
"""
import subprocess
import time

import rospy
from roslib.packages import find_node
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage


class BagPlayer:
    """`rosbag play` as a child of this node, under its own node name. bag: BagFacts."""

    def __init__(self, bag, name='player', rate=1.0, start=0.0, delay=0.0, paused=True):
        self.static = None
        if bag.static:
            self.static = rospy.Publisher('/tf_static', TFMessage, queue_size=1, latch=True)
            self.static.publish(TFMessage(list(bag.static.values())))
        self.name = rospy.resolve_name(name)
        command = find_node('rosbag', 'play')[:1] + ['--quiet', '--clock', '--hz=200', '--queue=2000', f'--rate={rate}', f'--start={start}']
        command += (['--pause'] if paused else []) + ([f'--delay={delay}'] if delay else [])
        self.process = subprocess.Popen(command + [bag.path, '/tf_static:=/tf_static_of_bag', f'__name:={name}'], stdin=subprocess.DEVNULL,
                                        stdout=subprocess.DEVNULL)
        rospy.on_shutdown(self.stop)

    def running(self):
        return self.process.poll() is None

    def pause(self, pause):
        """False when the player has ended."""
        try:
            rospy.ServiceProxy(self.name + '/pause_playback', SetBool)(pause)
            return True
        except (rospy.ServiceException, rospy.ROSException):
            return False

    def wait_until_ready(self, timeout=60.0):
        """Until it has opened the bag and advertised its topics."""
        end = time.monotonic() + timeout
        while self.running() and time.monotonic() < end and not rospy.is_shutdown():
            try:
                rospy.wait_for_service(self.name + '/pause_playback', timeout=1.0)
                return True
            except rospy.ROSException:
                continue
        return False

    def stop(self):
        if self.running():
            self.process.terminate()
            try:
                self.process.wait(5)
            except subprocess.TimeoutExpired:
                self.process.kill()
