#!/usr/bin/env python3
"""Documentation against code: arguments, topics, services and parameters that are described exist, and those that exist are described."""
import glob
import os
import re
import shlex
import subprocess
import sys
import tempfile
import unittest
import unittest.mock
import xml.etree.ElementTree as ElementTree

import rospkg
import roslaunch.config
import rosunit
import yaml
from roslib.packages import find_node

ROOT = rospkg.RosPack().get_path('air_ground')
sys.path.insert(0, os.path.join(ROOT, 'air_ground_eval', 'scripts'))
from air_ground_eval import own_outputs  # noqa: E402

NODES = ('mav_vo', 'rgbd_slam', 'dense_fusion', 'heightmap_mcl', 'view_match', 'icp_refine', 'streetview_localizer', 'ekf_tracker')
LAUNCH_FILES = ('mav.launch', 'ground.launch', 'air_ground.launch', 'replay.launch', 'tracker.launch', 'city_localizer.launch', 'city.launch')
# What city.launch sets itself in the files that it includes.
SET_BY_CITY = {'database', 'bag', 'rviz', 'rviz_config', 'rate', 'start', 'images', 'camera', 'cameras', 'period', 'mav_camera_frame', 'tracker_name', 'localizer_required', 'player_waits', 'respawn'}
SET_BY_REPLAY = {'player_waits', 'respawn'}


def read(*path):
    with open(os.path.join(ROOT, *path), encoding='utf-8') as stream:
        return stream.read()


def sources(node):
    paths = [path for kind in ('cpp', 'h') for path in glob.glob(os.path.join(ROOT, f'{node}_node', 'src', '**', f'*.{kind}'), recursive=True)]
    if node in ('mav_vo', 'rgbd_slam'):
        paths += [os.path.join(ROOT, 'air_ground_common', 'src', 'ros', f'estimator_{part}.cpp') for part in ('shell', 'services')]
    return '\n'.join(read(path) for path in paths)


IN_CODE = r'(?:advertise<[\w:]+>|subscribe(?:<[\w:]+>)?)\(\s*"([^"~]+)"'
# What rviz shows of programs whose topics are no arguments: the report's, the second tracker's, height_map_cloud's; and of a tracker that may run beside.
NOT_REMAPPED = {'tracked_magnetometer/path', 'alignment/height_map_air_cloud', 'alignment/height_map_ground_cloud'} | {f'report/{name}_path' for name in ('vo', 'gps', 'truth')}
SHOWN = {'air_ground.launch': ('air_ground.rviz', NOT_REMAPPED), 'city.launch': ('city_tracking.rviz', NOT_REMAPPED), 'city_localizer.launch': ('city.rviz', {'tracked/path'})}


def used_topics(launch, kind):
    """Relative topics of a program that a launch file starts: as its source names them; rviz: as its configuration does."""
    name = kind.replace('_node', '')
    if name in NODES:
        return set(re.findall(IN_CODE, sources(name)))
    if kind == 'height_map_cloud':
        return set(re.findall(r'relay\(&node, "([^"]+)"', read('air_ground_eval', 'tools', f'{kind}.cpp')))
    if kind in ('replay_report', 'city_report'):
        names = re.findall(r"(?:Subscriber|resolve_name)\('([^'/][^']*)'", read('air_ground_eval', 'scripts', kind))
        return {name for name in names if name.split('/')[0] not in NODES}  # a node's services
    if kind == 'rviz':
        config, others = SHOWN[launch]
        return set(re.findall(r'Topic: (\S+)', read('config', 'rviz', config))) - others
    return set()


def arguments(launch):
    """name -> default (None without) of a launch file."""
    root = ElementTree.fromstring(read('launch', launch))
    return {arg.get('name'): arg.get('default') for arg in root.findall('arg')}


class Documentation(unittest.TestCase):
    def test_arguments_are_documented(self):
        page = read('docs', 'frames_and_topics.md')
        documented = dict(re.findall(r'^\| `(\w+)` \| (?:`([^`]*)`)?', page, re.M))
        existing = {}
        for launch in reversed(LAUNCH_FILES):
            existing.update(arguments(launch))
        self.assertEqual(sorted(existing), sorted(documented))
        for name, default in documented.items():
            if default and existing[name] is not None and '$(' not in existing[name]:
                self.assertEqual(default, existing[name], f'default of {name}')

    def test_launch_files_agree(self):
        replay, both = arguments('replay.launch'), arguments('air_ground.launch')
        for name, default in both.items():
            if name not in SET_BY_REPLAY:
                self.assertEqual(replay.get(name), default, f'{name} in replay.launch')
        for part in ('mav.launch', 'ground.launch'):
            for name, default in arguments(part).items():
                self.assertEqual(both.get(name), default, f'{name} in {part} and air_ground.launch')
        city = arguments('city.launch')
        for part in ('mav.launch', 'tracker.launch', 'city_localizer.launch'):
            for name, default in arguments(part).items():
                if name not in SET_BY_CITY:
                    self.assertEqual(city.get(name), default, f'{name} in {part} and city.launch')

    def test_topics_of_the_nodes_are_arguments(self):
        """Every relative topic in a node's source is remapped by an argument of the same default, and documented."""
        page = read('docs', 'frames_and_topics.md')
        defaults = set(arguments('air_ground.launch').values()) | set(arguments('city.launch').values())
        for node in NODES:
            topics = set(re.findall(IN_CODE, sources(node)))
            self.assertTrue(topics, node)
            for topic in topics:
                self.assertIn(topic, defaults, f'{node}: no launch argument for the topic {topic}')
                self.assertIn(f'`{topic}`', page, f'{node}: {topic} is not documented')
        for launch in ('mav.launch', 'ground.launch', 'tracker.launch', 'city_localizer.launch'):
            for node in ElementTree.fromstring(read('launch', launch)).findall('node'):
                name = node.get('type').replace('_node', '')
                for remap in node.findall('remap') if name in NODES else ():
                    self.assertIn(f'"{remap.get("from")}"', sources(name), f'{launch}: {name} does not use the topic')

    def test_each_node_has_its_own_remaps(self):
        """A topic that a node uses is remapped in that node, once: elsewhere an argument would do nothing, and nobody would say so."""
        seen = set()
        for launch in LAUNCH_FILES:
            for node in ElementTree.fromstring(read('launch', launch)).iter('node'):
                remapped = [remap.get('from') for remap in node.findall('remap')]
                self.assertEqual(len(remapped), len(set(remapped)), f'{launch}: {node.get("type")} has a remap twice')
                for topic in used_topics(launch, node.get('type')):
                    self.assertIn(topic, remapped, f'{launch}: {node.get("type")} uses {topic}, which nothing remaps')
                    seen.add(node.get('type'))
        self.assertEqual(seen, {f'{node}_node' for node in NODES} | {'replay_report', 'city_report', 'rviz', 'height_map_cloud'})

    def test_a_replay_knows_what_its_nodes_publish(self):
        """For each node that a launch file runs beside a player: the topics that it advertises, under the names that its arguments give them."""
        for node in NODES:
            text = sources(node)
            advertised = set(re.findall(r'advertise<[\w:]+>\(\s*"([^"~]+)"', text))
            self.assertLessEqual(advertised, set(own_outputs.OUTPUTS[node]), node)
            for topic in own_outputs.OUTPUTS[node]:
                self.assertIn(f'"{topic}"', text, node)
                self.assertNotRegex(text, rf'subscribe(?:<[\w:]+>)?\(\s*"{topic}"', node)
        self.assertEqual({f'{topic}_cloud' for topic in used_topics('', 'height_map_cloud')}, set(own_outputs.OUTPUTS['height_map_cloud']))
        bag = {'bag': 'x.bag', 'db': 'x.gpkg', 'database': 'x.gpkg', 'compare_magnetometer': 'true', 'rviz': 'true'}
        for launch, player, nodes in (('replay.launch', 'replay_report', {*NODES[:6], 'height_map_cloud'}), ('city_localizer.launch', 'play_bag', {'streetview_localizer'}),
                                      ('city.launch', 'city_report', {'mav_vo', 'streetview_localizer', 'ekf_tracker', 'ekf_tracker_magnetometer', 'city_report'})):
            known = arguments(launch)
            given = [f'{name}:={value}' for name, value in bag.items() if name in known]
            for name, topic in known.items():  # each has another name
                given += [f'{name}:=/other/{topic}'] if f'/{topic}' in own_outputs.ALL else []
            config = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', launch), given)], 11999)
            told = {name.rsplit('/', 1)[-1]: set(p.value.split()) for name, p in config.params.items() if name.startswith(f'/{player}/outputs/')}
            self.assertEqual(set(told), nodes, launch)
            for node, topics in told.items():
                fixed = node in ('height_map_cloud', 'ekf_tracker_magnetometer', 'city_report')
                self.assertEqual(topics, {topic if fixed else f'/other/{topic}' for topic in own_outputs.OUTPUTS[node]}, f'{launch}: {node}')
            for node in nodes & {node for node in known if node in own_outputs.OUTPUTS}:
                off = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', launch), [*given, f'{node}:=false'])], 11999)
                self.assertNotIn(f'/{player}/outputs/{node}', off.params, launch)

    def test_services_are_documented(self):
        page = read('docs', 'frames_and_topics.md')
        for node in NODES:
            services = re.findall(r'advertiseService\("(\w+)"', sources(node))
            self.assertTrue(services, f'{node} seems to have no service: does this test still find them?')
            for service in services:
                self.assertTrue(f'`{node}/{service}`' in page or service == 'reset', f'{node}/{service} is not documented')

    def test_parameters(self):
        """config/<node>.yaml is what the node writes of the parameters it declares (tools/write_parameters); icp_refine's chain stands below."""
        for node in NODES:
            program = find_node('air_ground', f'{node}_node')[0]
            written = subprocess.run([program, '--parameters'], check=True, capture_output=True, text=True).stdout
            text = read('config', f'{node}.yaml')
            below = ''
            if node == 'icp_refine':
                text, below = re.split(r'\n(?=# ---- The ICP chain)', text)
                self.assertEqual(list(yaml.safe_load(below)), ['chain'])
            self.assertEqual(text, written.replace('index: flann ', 'index: hnsw  '), f'{node}: run tools/write_parameters')  # flann: built without hnswlib
            self.assertTrue(yaml.safe_load(written), node)

    def test_all_configuration_loads(self):
        files = glob.glob(os.path.join(ROOT, 'config', '**', '*.yaml'), recursive=True) + glob.glob(os.path.join(ROOT, 'config', 'rviz', '*.rviz'))
        self.assertGreater(len(files), 7)
        for path in files:
            self.assertIsInstance(yaml.safe_load(read(path)), dict, path)

    def test_diagnostics_of_each_node_fall_into_one_group(self):
        """As GenericAnalyzer of diagnostic_aggregator matches names, in namespaces, too."""
        rules = yaml.safe_load(read('config', 'diagnostics.yaml'))['analyzers']
        for rule in rules.values():
            self.assertLessEqual(set(rule), {'type', 'path', 'regex', 'timeout', 'discard_stale'}, 'this test knows no other rule')

        def groups(name):
            return [group for group, rule in rules.items() if re.fullmatch(rule['regex'], name)]

        for node in NODES + ('ekf_tracker_magnetometer',):
            for space in ('', 'uav1/', 'fleet/uav1/'):
                city = node.startswith(('streetview', 'ekf'))
                self.assertEqual(groups(f'{space}{node}: state'), ['city' if city else 'indoors'])
        for other in ('camera_driver: state', 'mav_voltage: battery', 'mav_vo/battery: state', 'my_icp_refine: state'):
            self.assertEqual(groups(other), [], other)

    def test_rviz_shows_existing_topics(self):
        aerial, city = arguments('air_ground.launch'), arguments('city.launch')
        shown = {'air_ground.rviz': (aerial['ground_map_frame'], set(aerial.values()) | {'alignment/height_map_air_cloud', 'alignment/height_map_ground_cloud'})}
        shown['base_station.rviz'] = shown['air_ground.rviz']
        topics = set(city.values()) | {'tracked_magnetometer/path'} | {f'report/{name}_path' for name in ('vo', 'gps', 'truth')}
        shown['city.rviz'] = shown['city_tracking.rviz'] = (city['world_frame'], topics)
        for name, (frame, known) in shown.items():
            rviz = yaml.safe_load(read('config', 'rviz', name))
            self.assertEqual(rviz['Visualization Manager']['Global Options']['Fixed Frame'], frame, name)
            for display in rviz['Visualization Manager']['Displays']:
                for key in ('Topic', 'Image Topic', 'Marker Topic'):
                    if key in display:
                        self.assertIn(display[key], known, f'{name}: {display["Name"]}')

    def test_launch_files_resolve(self):
        """roslaunch accepts each file, and every node in it is a program of its package."""
        self.check_launch_files()

    def test_launch_files_resolve_without_shell(self):
        """The same from a systemd unit, where nothing says which folder is the user's."""
        with unittest.mock.patch.dict(os.environ):
            os.environ.pop('PWD', None)
            self.check_launch_files()

    def check_launch_files(self):
        for launch, given in (('mav.launch', []), ('ground.launch', []), ('mav.launch', ['respawn:=false']), ('tracker.launch', ['respawn:=false']), ('air_ground.launch', ['rviz:=true']), ('replay.launch', ['bag:=x.bag', 'out:=/tmp/x']),
                              ('tracker.launch', []), ('city_localizer.launch', ['database:=x.gpkg', 'rviz:=true']), ('city.launch', ['db:=x.gpkg']),
                              ('city.launch', ['db:=x.gpkg', 'bag:=x.bag', 'out:=/tmp/x', 'rviz:=true'])):
            config = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', launch), given)], 11999)
            self.assertEqual(config.config_errors, [], launch)
            # Nodes run in another folder: what the user names from here must reach them as a path from the root.
            for name, parameter in config.params.items():
                if name.rsplit('/', 1)[-1] in ('bag', 'out', 'database') and parameter.value:
                    self.assertTrue(str(parameter.value).startswith('/'), f'{launch}: {name} = {parameter.value}')
            for node in config.nodes:
                if node.package == 'air_ground':
                    self.assertTrue(find_node('air_ground', node.type), f'{launch}: no program {node.type}')

    def test_names_in_the_home_folder(self):
        """No shell opens up the ~ of bag:=~/x.bag: the launch files, or the scripts that read it, do."""
        with unittest.mock.patch.dict(os.environ, HOME=tempfile.gettempdir()):
            with tempfile.NamedTemporaryFile('w', suffix='.yaml') as file:
                file.write('declination: 2.5\n')
                file.flush()
                home, world = os.environ['HOME'], f'world_config:=~/{os.path.basename(file.name)}'
                for launch, given in (('replay.launch', ['bag:=~/x', 'out:=~/x', 'mesh:=~/x']), ('city.launch', ['bag:=~/x', 'out:=~/x', 'db:=~/x', world]),
                                      ('city_localizer.launch', ['database:=~/x', 'bag:=~/x']), ('tracker.launch', [world])):
                    config = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', launch), given)], 11999)
                    paths = {name: p.value for name, p in config.params.items() if name.rsplit('/', 1)[-1] in ('bag', 'out', 'mesh', 'database')}
                    for name, path in paths.items():
                        self.assertEqual(os.path.expanduser(path), f'{home}/x', f'{launch}: {name}')
                        if name == '/streetview_localizer/database':  # its reader is C++
                            self.assertEqual(path, f'{home}/x', launch)
                    self.assertTrue(world not in given or config.params['/ekf_tracker/declination'].value == 2.5, launch)
            for images in (['cameras:=~/x.csv'], ['camera:=~/x.yaml']):
                config = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', 'city_localizer.launch'), ['database:=x.gpkg', 'images:=~/x', *images])], 11999)
                words = shlex.split(next(node for node in config.nodes if node.type == 'publish_images').args)
                option, path = images[0].split(':=~')
                self.assertEqual([words[words.index(name) + 1] for name in ('--images', f'--{option}')], [f'{home}/x', home + path])

    def test_empty_arguments_leave_what_the_yaml_says(self):
        said = {'publish_tf': False, 'accel_topic': 'mav/accel', 'image_transport': 'compressed', 'depth_transport': 'compressed', 'depth_registered': False}
        with tempfile.NamedTemporaryFile('w', suffix='.yaml') as file:
            yaml.safe_dump(said, file)
            file.flush()
            for launch, given, names in (('tracker.launch', [f'ekf_tracker_config:={file.name}'], ('publish_tf', 'accel_topic')),
                                         ('city_localizer.launch', ['database:=x.gpkg', f'streetview_localizer_config:={file.name}'], ('image_transport',)),
                                         ('mav.launch', [f'mav_vo_config:={file.name}'], ('accel_topic', 'image_transport')),
                                         ('ground.launch', [f'rgbd_slam_config:={file.name}'], ('accel_topic', 'image_transport', 'depth_transport', 'depth_registered'))):
                self.assertEqual(self.parameters(launch, given, names), {name: said[name] for name in names}, launch)
            given = [f'rgbd_slam_config:={file.name}', 'ground_depth_registered:=true', 'ground_depth_transport:=raw', 'ground_image_transport:=raw', 'ground_imu_accel:=/accel']
            given += [f'mav_vo_config:={file.name}', 'mav_image_transport:=raw', 'mav_imu_accel:=/accel']
            for launch, names in (('ground.launch', ('depth_registered', 'depth_transport', 'image_transport', 'accel_topic')), ('mav.launch', ('image_transport', 'accel_topic'))):
                known = [word for word in given if word.partition(':=')[0] in arguments(launch)]
                self.assertEqual(self.parameters(launch, known, names), {name: {'depth_registered': True, 'accel_topic': '/accel'}.get(name, 'raw') for name in names}, launch)

    def test_a_launch_forgets_what_the_one_before_was_told(self):
        """On a master that goes on, mav_use_imu:=false of the launch before would hold where this one does not say."""
        needed = {'bag': 'x.bag', 'db': 'x.gpkg', 'database': 'x.gpkg', 'compare_magnetometer': 'true'}
        for launch in LAUNCH_FILES:
            given = [f'{name}:={value}' for name, value in needed.items() if name in arguments(launch)]
            config = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', launch), given)], 11999)
            started = {f'/{node.name}/' for node in config.nodes if node.type.replace('_node', '') in NODES}
            self.assertTrue(started, launch)
            self.assertEqual(started - set(config.clear_params), set(), launch)

    def test_frames_whose_names_are_numbers(self):
        """As drivers of depth cameras have had them ('0'): a node that asks for a name finds a number, and ends."""
        needed = {'bag': 'x.bag', 'db': 'x.gpkg', 'database': 'x.gpkg', 'images': '/photographs', 'camera': '/camera.yaml', 'compare_magnetometer': 'true'}
        for launch in LAUNCH_FILES:
            known = arguments(launch)
            frames = {name: str(number) for number, name in enumerate(sorted(name for name in known if name.endswith('_frame')))}
            given = [f'{name}:={value}' for name, value in {**needed, **frames}.items() if name in known]
            config = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', launch), given)], 11999)
            told = {name: p.value for name, p in config.params.items() if name.endswith('_frame') and str(p.value).isdigit()}
            self.assertEqual({name: value for name, value in told.items() if not isinstance(value, str)}, {}, launch)
            words = [word for node in config.nodes if node.type == 'publish_images' for word in node.args.split()]
            passed = {word for option, word in zip(words, words[1:]) if option in ('--frame', '--base-frame')}
            self.assertEqual(set(told.values()) | passed, set(frames.values()), launch)

    def parameters(self, launch, given, names):
        """Of the first node that a launch file starts with these."""
        config = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', launch), given)], 11999)
        return {name: next(p.value for key, p in config.params.items() if key.rsplit('/', 1)[-1] == name) for name in names}

    def test_folders_with_spaces(self):
        """roslaunch splits a node's args as a shell does: paths in them must be quoted."""
        config = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', 'city_localizer.launch'),
                                                        ['database:=x.gpkg', 'images:=/my photographs', 'cameras:=/my cameras.csv'])], 11999)
        node = next(node for node in config.nodes if node.type == 'publish_images')
        words = shlex.split(node.args)
        self.assertEqual(words[words.index('--images') + 1], '/my photographs')
        self.assertEqual(words[words.index('--cameras') + 1], '/my cameras.csv')
        for launch, given in (('air_ground.launch', []), ('city.launch', ['db:=x.gpkg']), ('city_localizer.launch', ['database:=x.gpkg'])):
            config = roslaunch.config.load_config_default([(os.path.join(ROOT, 'launch', launch), [*given, 'rviz:=true', 'rviz_config:=/my views/x.rviz'])], 11999)
            rviz = next(node for node in config.nodes if node.type == 'rviz')
            self.assertEqual(shlex.split(rviz.args), ['-d', '/my views/x.rviz'], launch)


if __name__ == '__main__':
    rosunit.unitrun('air_ground', 'documentation_test', Documentation)
