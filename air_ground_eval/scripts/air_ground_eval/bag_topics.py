"""Image topics of a bag, whatever their transport."""

IMAGE_TYPES = ('sensor_msgs/Image', 'sensor_msgs/CompressedImage')
TRANSPORTS = ('compressedDepth', 'compressed')  # the better first: the second may be a JPEG, of depth too
# Of images that no node decodes: message type -> (transport, the package whose plugin does)
PACKETS = {'theora_image_transport/Packet': ('theora', 'ros-noetic-image-transport-plugins'), 'h264_image_transport/H264Packet': ('h264', 'h264_image_transport'),
           'ffmpeg_image_transport_msgs/FFMPEGPacket': ('ffmpeg', 'ffmpeg_image_transport')}


def with_slash(topic):
    """As nodes without namespace resolve what was recorded, or given, without one."""
    return '/' + topic.lstrip('/')


def raw_name(topic):
    """The image topic that a compressed one belongs to."""
    parent, _, last = topic.rpartition('/')
    return parent if last in TRANSPORTS else topic


def image_topics(facts):
    """Image topics, raw or compressed, under the raw name; of a bag without, those that no node decodes."""
    return sorted({raw_name(t) for t in facts.of_type(*IMAGE_TYPES)} or packets(facts))


def packets(facts):
    """Raw name -> recorded topic, of the images that are there only as no node decodes them."""
    names = [transport for transport, _ in PACKETS.values()]
    found = {t.rpartition('/')[0]: t for t, kind in facts.types.items() if kind in PACKETS or t.rpartition('/')[2] in names and kind not in IMAGE_TYPES}
    return {raw: topic for raw, topic in found.items() if raw and not transport(facts, raw)}


def republish(facts, topic):
    """What to do about such a topic, of this raw name."""
    kept = packets(facts)[topic]
    name = kept.rpartition('/')[2]
    package = next((package for known, package in PACKETS.values() if known == name), 'its plugin of image_transport')
    return (f'on a machine with {package}, rosrun image_transport republish {name} in:={topic} compressed out:={topic}  beside the bag\'s player, and record {topic}/compressed '
            'with the rest')


def transport(facts, topic):
    """'raw', 'compressed' or None, as an image topic is in the bag."""
    if facts.types.get(topic) in IMAGE_TYPES:
        return 'raw' if facts.types[topic] == IMAGE_TYPES[0] else 'compressed'
    return 'compressed' if any(f'{topic}/{kind}' in facts.types for kind in TRANSPORTS) else None


def recorded(facts, topic):
    """The topic under which the bag holds an image topic: itself, or compressed; None without."""
    return topic if facts.types.get(topic) in IMAGE_TYPES else next((f'{topic}/{t}' for t in TRANSPORTS if f'{topic}/{t}' in facts.types), None)
