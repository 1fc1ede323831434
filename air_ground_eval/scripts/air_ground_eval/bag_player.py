"""Plays a bag to nodes, its static transforms whole, and without what the nodes publish themselves.

`rosbag play` publishes /tf_static as it was recorded: of several latched messages a node that connects late gets the last, of others none. So
the union of all of them is published here, latched, for as long as the player lives, and the player's own goes where nobody listens. The same
holds for those on /tf that never change. What else is on /tf is handed on but for the edges that say where a frame is that a node, or the static
transforms, say otherwise: a frame with two parents leaves tf in pieces. A recorded /clock is left out.
"""
import subprocess
import time

import rospy
from roslib.packages import find_node
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage


class BagPlayer:
    """`rosbag play` as a child of this node, under its own node name. bag: BagFacts; owned: frames whose place nodes publish."""

    def __init__(self, bag, name='player', rate=1.0, start=0.0, delay=0.0, paused=True, owned=()):
        self.static = None
        static = bag.static_transforms(owned)
        if static.transforms:
            self.static = rospy.Publisher('/tf_static', TFMessage, queue_size=1, latch=True)
            self.static.publish(static)
        self.name = rospy.resolve_name(name)
        command = find_node('rosbag', 'play')[:1] + ['--quiet', '--clock', '--hz=200', '--queue=2000', f'--rate={rate}', f'--start={start}']
        command += (['--pause'] if paused else []) + ([f'--delay={delay}'] if delay else [])
        command += ['--topics'] + sorted(set(bag.types) - {'/clock'}) + ['--bags', bag.path] if '/clock' in bag.types else [bag.path]
        command += ['/tf_static:=/tf_static_of_bag', f'__name:={name}']
        if '/tf' in bag.types:
            command.append('/tf:=/tf_of_bag')
            self.others = {*owned, *(edge.child_frame_id for edge in static.transforms)}
            self.left_out = set()
            self.moving = rospy.Publisher('/tf', TFMessage, queue_size=100)
            self.relay = rospy.Subscriber('/tf_of_bag', TFMessage, self._hand_on, queue_size=1000)
        self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        rospy.on_shutdown(self.stop)

    def _hand_on(self, message):
        kept = [edge for edge in message.transforms if edge.child_frame_id.lstrip('/') not in self.others]
        new = {edge.child_frame_id.lstrip('/') for edge in message.transforms} & self.others - self.left_out
        if new:
            self.left_out |= new
            rospy.loginfo('/tf of the bag: what it says of %s is left out, since nodes or the static transforms say so', ', '.join(sorted(new)))
        if kept:
            self.moving.publish(TFMessage(kept))

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
