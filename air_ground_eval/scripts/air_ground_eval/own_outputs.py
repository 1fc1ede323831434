"""What the nodes of the suite publish themselves. A bag that was recorded while they ran holds it, too: played beside them, that run's results would pass for this one's."""
import rospy

from .bag_finding import OK, Finding

# Node -> its topics, as they are named unless an argument of the launch files says otherwise.
OUTPUTS = {
    'mav_vo': ('mav/odometry', 'mav/path', 'mav/sparse_cloud', 'mav/posed_image', 'mav/corrected_path', 'mav/vo_increment', 'mav/vo_status', 'mav/track_image', 'mav/map_scale'),
    'rgbd_slam': ('ground/odometry', 'ground/path', 'ground/map_cloud', 'ground/slam_status', 'ground/keyframe_image', 'ground/map_keyframes'),
    'dense_fusion': ('mav/depth_map', 'mav/dense_cloud', 'mav/cloud_corrections', 'mav/distance_field'),
    'heightmap_mcl': ('alignment/height_map_air', 'alignment/height_map_ground', 'alignment/costmap', 'alignment/particles', 'alignment/coarse'),
    'view_match': ('alignment/views',),
    'icp_refine': ('alignment/refined', 'mav/pose_in_ground_map', 'augmented_map'),
    'streetview_localizer': ('streetview/match', 'streetview/pose', 'streetview/match_image', 'streetview/synthesized_view', 'streetview/textured_model', 'streetview/panoramas',
                             'streetview/cameras'),
    'ekf_tracker': ('tracked/odometry', 'tracked/path', 'tracked/innovation', 'tracked/geodetic'),
    'ekf_tracker_magnetometer': ('tracked_magnetometer/odometry', 'tracked_magnetometer/path', 'tracked_magnetometer/innovation', 'tracked_magnetometer/geodetic'),
    'height_map_cloud': ('alignment/height_map_air_cloud', 'alignment/height_map_ground_cloud'),
    'city_report': ('report/vo_path', 'report/gps_path', 'report/truth_path')}
ALL = frozenset(f'/{topic}' for topics in OUTPUTS.values() for topic in topics)
OF_ALL_NODES = ('/diagnostics', '/rosout', '/rosout_agg')


def running():
    """Node -> topics that it publishes in this run. By the launch file's parameters ~outputs/NODE, there for each node that is not switched off: who asks the master hears
    nothing of a node that starts slowly or has died."""
    return {node: [rospy.resolve_name(topic) for topic in topics.split()] for node, topics in rospy.get_param('~outputs', {}).items()}


def published(nodes):
    """All topics of such nodes. With none of them, what every node publishes is the recording's own."""
    return {topic for topics in nodes.values() for topic in topics} | set(OF_ALL_NODES if nodes else ())


def chains(nodes):
    """Frames whose transforms such nodes publish on /tf, parent before child; with `odom_from_tf` odom -> base is another's."""
    def parameters(node, **defaults):
        return [rospy.get_param(f'{node}/{name}', default) for name, default in defaults.items()]

    result = []
    for robot, node in (('mav', 'mav_vo'), ('ground', 'rgbd_slam')):
        result.append((node, parameters(node, map_frame=f'{robot}_map', odom_frame=f'{robot}_odom', base_frame=f'{robot}_base_link')))
        if rospy.get_param(f'{node}/odom_from_tf', False):
            result[-1][1].pop()
    alignment = parameters('icp_refine', ground_map_frame='ground_map', mav_map_frame='mav_map')
    result.append(('icp_refine', alignment[::-1] if rospy.get_param('icp_refine/inverse_tf', False) else alignment))
    result.append(('ekf_tracker', parameters('ekf_tracker', world_frame='world', map_frame='mav_map')))
    return [frames for node, frames in result if node in nodes and rospy.get_param(f'{node}/publish_tf', True)]


def check(facts):
    """A finding where a bag holds results of an earlier run."""
    found = sorted(topic for topic in facts.types if f'/{topic.lstrip("/")}' in ALL)
    return [Finding(OK, f'the bag holds results of an earlier run of the suite, which a replay leaves out where it runs the node that publishes them: {", ".join(found)}')] if found else []
