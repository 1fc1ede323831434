#include "air_ground_sim/config.h"

#include <yaml-cpp/yaml.h>

#include <cmath>
#include <filesystem>
#include <map>
#include <set>
#include <sstream>
#include <stdexcept>

#include "air_ground_common/camera_file.h"

namespace air_ground_sim {
namespace {

// One YAML map: typed, range-checked reads; finish() rejects the keys nobody asked for.
class Section {
 public:
  Section(const YAML::Node& node, std::string where) : node_(node), where_(std::move(where)) {
    if (node_ && !node_.IsNull() && !node_.IsMap()) fail("", "must be a map");
  }

  void number(const char* key, double* value, double low, double high) {
    if (!find(key)) return;
    *value = as<double>(key, "a number");
    if (!(*value >= low && *value <= high)) failRange(key, *value, low, high);
  }
  void integer(const char* key, int* value, int low, int high) {
    if (!find(key)) return;
    *value = as<int>(key, "an integer");
    if (*value < low || *value > high) failRange(key, *value, low, high);
  }
  void flag(const char* key, bool* value) {
    if (find(key)) *value = as<bool>(key, "true or false");
  }
  void point(const char* key, Eigen::Vector2d* value) {
    if (find(key)) *value = toPoint(node_[key], key);
  }
  void place(const char* key, Eigen::Vector2d* value) {
    if (find(key)) *value = toPoint(node_[key], key, 5000);
  }
  void numbers(const char* key, std::vector<double>* value) {
    if (!find(key)) return;
    *value = node_[key].IsScalar() ? std::vector<double>{as<double>(key, "a number or a list of numbers")}
                                   : as<std::vector<double>>(key, "a number or a list of numbers");
  }
  /// A camera_info YAML file, relative to the world's.
  void calibration(const char* key, air_ground_common::CameraModel* value) {
    if (!find(key)) return;
    const std::filesystem::path file = as<std::string>(key, "the name of a file");
    const std::filesystem::path world = where_.substr(0, where_.find(".yaml") + 5);
    *value = air_ground_common::readCameraFile((world.parent_path() / file).string());
  }
  void vector(const char* key, Eigen::Vector3d* value) {
    if (!find(key)) return;
    const auto v = as<std::vector<double>>(key, "a list of three numbers");
    if (v.size() != 3) fail(key, "must be a list of three numbers");
    *value = Eigen::Vector3d(v[0], v[1], v[2]);
    if (!value->allFinite()) fail(key, "must be finite");
  }
  void text(const char* key, std::string* value) {
    if (find(key)) *value = as<std::string>(key, "text");
  }
  void points(const char* key, std::vector<Eigen::Vector2d>* value, double reach = 100) {
    if (!find(key)) return;
    if (!node_[key].IsSequence()) fail(key, "must be a list of [x, y]");
    value->clear();
    for (const auto& p : node_[key]) value->push_back(toPoint(p, key, reach));
  }
  template <class T>
  void choice(const char* key, T* value, const std::map<std::string, T>& options) {
    if (!find(key)) return;
    const auto it = options.find(as<std::string>(key, "text"));
    if (it == options.end()) {
      std::string names;
      for (const auto& option : options) names += (names.empty() ? "" : ", ") + option.first;
      fail(key, "must be one of " + names);
    }
    *value = it->second;
  }
  Section child(const char* key) {
    find(key);
    return Section(node_ && !node_.IsNull() ? node_[key] : YAML::Node(), where_ + "/" + key);
  }
  std::vector<Section> list(const char* key) {
    std::vector<Section> sections;
    if (!find(key)) return sections;
    if (!node_[key].IsSequence()) fail(key, "must be a list");
    for (std::size_t i = 0; i < node_[key].size(); ++i)
      sections.emplace_back(node_[key][i], where_ + "/" + key + "[" + std::to_string(i) + "]");
    return sections;
  }
  void finish() {
    if (!node_ || node_.IsNull()) return;
    for (const auto& entry : node_) {
      const auto key = entry.first.as<std::string>();
      if (!known_.count(key)) fail(key.c_str(), "is not a parameter");
    }
  }
  [[noreturn]] void fail(const std::string& key, const std::string& why) const {
    throw std::invalid_argument(where_ + (key.empty() ? "" : ": '" + key + "'") + " " + why);
  }

 private:
  bool find(const char* key) {
    known_.insert(key);
    return node_ && !node_.IsNull() && node_[key];
  }
  template <class T>
  T as(const char* key, const char* what) {
    try {
      return node_[key].as<T>();
    } catch (const YAML::Exception&) {
      fail(key, std::string("must be ") + what);
    }
  }
  Eigen::Vector2d toPoint(const YAML::Node& node, const char* key, double reach = 100) const {
    try {
      if (node.IsSequence() && node.size() == 2) {
        const Eigen::Vector2d p(node[0].as<double>(), node[1].as<double>());
        if (p.allFinite() && p.norm() < reach) return p;
      }
    } catch (const YAML::Exception&) {
    }
    fail(key, "must be [x, y] in metres, within " + std::to_string(static_cast<int>(reach)) + " m");
  }
  void failRange(const char* key, double value, double low, double high) const {
    std::ostringstream s;
    s << "= " << value << " is outside [" << low << ", " << high << "]";
    fail(key, s.str());
  }

  YAML::Node node_;
  std::string where_;
  std::set<std::string> known_;
};

void read(Section s, RoomsConfig* r) {
  s.number("size_x", &r->size_x, 8, 14);
  s.number("size_y", &r->size_y, 6.5, 14);
  s.number("wall_thickness", &r->wall_thickness, 0.05, 0.4);
  s.number("door_width", &r->door_width, 0.8, 1.4);
  s.number("door_height", &r->door_height, 1.9, 2.4);
  s.finish();
}

void read(Section s, WorldConfig* w) {
  s.choice<WorldKind>("kind", &w->kind,
                      {{"indoor", WorldKind::kIndoor},
                       {"rubble", WorldKind::kRubble},
                       {"flat", WorldKind::kFlat},
                       {"grid", WorldKind::kGrid},
                       {"street", WorldKind::kStreet},
                       {"rooms", WorldKind::kRooms}});
  s.choice<FloorStyle>("floor", &w->floor,
                       {{"concrete", FloorStyle::kConcrete},
                        {"planks", FloorStyle::kPlanks},
                        {"tiles", FloorStyle::kTiles},
                        {"gravel", FloorStyle::kGravel},
                        {"plain", FloorStyle::kPlain}});
  s.number("floor_size", &w->floor_size, 8, 40);
  s.number("texel", &w->texel, 0.001, 0.05);
  s.number("room_height", &w->room_height, 0, 10);
  s.flag("vary_layout", &w->vary_layout);
  s.integer("rocks", &w->rocks, 0, 1000);
  s.number("relief", &w->relief, 0, 1);
  s.integer("grid_rows", &w->grid_rows, 1, 20);
  s.integer("grid_columns", &w->grid_columns, 1, 20);
  s.number("grid_spacing", &w->grid_spacing, 0.3, 5);
  s.number("grid_box", &w->grid_box, 0.1, 2);
  read(s.child("rooms"), &w->rooms);
  for (Section& c : s.list("clusters")) {
    ClusterConfig cluster;
    c.point("center", &cluster.center);
    c.number("radius", &cluster.radius, 0.2, 5);
    c.integer("boxes", &cluster.boxes, 0, 200);
    c.integer("pallets", &cluster.pallets, 0, 20);
    c.integer("debris", &cluster.debris, 0, 200);
    c.number("max_height", &cluster.max_height, 0.1, 3);
    c.finish();
    w->clusters.push_back(cluster);
  }
  for (Section& c : s.list("walls")) {
    WallConfig wall;
    c.point("from", &wall.from);
    c.point("to", &wall.to);
    c.number("height", &wall.height, 0.1, 3);
    c.finish();
    w->walls.push_back(wall);
  }
  s.finish();
}

void read(Section s, FlightConfig* f) {
  s.number("stand_still", &f->stand_still, 0.5, 10);
  s.number("duration", &f->duration, 8, 3600);
  s.number("speed", &f->speed, 0.1, 5);
  s.number("min_height", &f->min_height, 0.5, 30);
  s.number("max_height", &f->max_height, 0.5, 30);
  if (f->max_height < f->min_height) s.fail("max_height", "is below min_height");
  s.number("clearance", &f->clearance, 0.2, 5);
  s.number("loop_x", &f->loop_x, 0.3, 10);
  s.number("loop_y", &f->loop_y, 0.3, 10);
  s.point("center", &f->center);
  s.number("start_radius", &f->start_radius, 0.5, 10);
  s.number("sway", &f->sway, 0, 0.5);
  s.number("sway_period", &f->sway_period, 1, 10);
  s.number("camera_tilt", &f->camera_tilt, 0, 1.4);
  s.finish();
}

void read(Section s, LaneConfig* l, bool planned) {
  s.points("points", &l->points);
  if (planned && !l->points.empty()) s.fail("points", "are not a parameter of rooms: the way follows from their plan");
  if (!planned && l->points.size() < 3)
    s.fail("points", "must list at least three [x, y] points for the ground robot's way");
  s.point("look_at", &l->look_at);
  s.number("stand_still", &l->stand_still, 0.2, 10);
  s.number("heading_swing", &l->heading_swing, 0, 1.5);
  s.number("half_width", &l->half_width, 0.2, 2);
  s.finish();
}

void read(Section s, ImagerConfig* c) {
  s.calibration("calibration", &c->camera);
  s.number("rate", &c->rate, 1, 60);
  s.integer("samples", &c->samples, 1, 64);
  s.number("target_mean", &c->target_mean, 0.05, 0.9);
  s.number("min_exposure", &c->min_exposure, 1e-5, 0.05);
  s.number("max_exposure", &c->max_exposure, 1e-5, 0.05);
  if (c->max_exposure < c->min_exposure) s.fail("max_exposure", "is below min_exposure");
  s.number("sensitivity", &c->sensitivity, 1, 1e5);
  s.number("response", &c->response, 0.3, 1);
  s.number("vignetting", &c->vignetting, 0, 0.9);
  s.number("full_well", &c->full_well, 100, 1e6);
  s.number("read_noise", &c->read_noise, 0, 1000);
  s.finish();
}

void read(Section s, DepthConfig* d) {
  s.number("min_range", &d->min_range, 0.1, 10);
  s.number("max_range", &d->max_range, 0.2, 20);
  s.number("focal", &d->focal, 50, 5000);
  s.number("baseline", &d->baseline, 0.01, 1);
  s.number("subpixel", &d->subpixel, 1, 64);
  s.number("lateral", &d->lateral, 0, 5);
  s.number("dropout", &d->dropout, 0, 0.5);
  s.flag("noise", &d->noise);
  s.finish();
}

void read(Section s, ImuConfig* i) {
  s.number("rate", &i->rate, 20, 2000);
  s.number("gyro_noise", &i->gyro_noise, 0, 0.1);
  s.number("accel_noise", &i->accel_noise, 0, 1);
  s.number("gyro_bias_walk", &i->gyro_bias_walk, 0, 0.1);
  s.number("accel_bias_walk", &i->accel_bias_walk, 0, 1);
  s.number("gyro_bias", &i->gyro_bias, 0, 1);
  s.number("accel_bias", &i->accel_bias, 0, 5);
  s.number("mag_rate", &i->mag_rate, 1, 200);
  s.number("mag_noise", &i->mag_noise, 0, 1e-4);
  s.number("mag_disturbance", &i->mag_disturbance, 0, 1e-4);
  s.flag("ground_magnetometer", &i->ground_magnetometer);
  s.finish();
}

void read(Section s, StreetConfig* c) {
  s.text("crs", &c->crs);
  s.vector("origin", &c->origin);
  s.number("geoid_undulation", &c->geoid_undulation, -120, 100);
  for (Section& l : s.list("lines")) {
    StreetLineConfig line;
    l.place("from", &line.from);
    l.place("to", &line.to);
    l.flag("panoramas", &line.panoramas);
    if ((line.to - line.from).norm() < 20) l.fail("to", "must lie at least 20 m from 'from'");
    l.finish();
    c->lines.push_back(line);
  }
  s.number("width", &c->width, 8, 40);
  s.number("sidewalk", &c->sidewalk, 0.5, 6);
  if (c->sidewalk > 0.5 * c->width - 2) s.fail("sidewalk", "leaves no road: the street is too narrow for it");
  s.number("grade", &c->grade, -0.15, 0.15);
  s.number("relief", &c->relief, 0, 3);
  s.number("texel", &c->texel, 0.004, 0.05);
  s.text("facade_images", &c->facade_images);
  s.number("cars", &c->cars, 0, 30);
  s.number("people", &c->people, 0, 100);
  s.number("trees", &c->trees, 0, 20);
  s.points("route", &c->route, 5000);
  s.number("route_offset", &c->route_offset, -6, 6);
  s.choice<bool>("camera_side", &c->camera_looks_left, {{"left", true}, {"right", false}});
  s.number("camera_pitch", &c->camera_pitch, -1.2, 1.2);
  s.number("panorama_spacing", &c->panorama_spacing, 2, 100);
  s.number("panorama_height", &c->panorama_height, 1, 5);
  s.integer("panorama_width", &c->panorama_width, 512, 8192);
  if (c->panorama_width % 8) s.fail("panorama_width", "must be a multiple of 8");
  s.integer("panorama_samples", &c->panorama_samples, 1, 16);
  s.number("geotag_position_error", &c->geotag_position_error, 0, 20);
  s.number("geotag_orientation_error", &c->geotag_orientation_error, 0, 0.5);
  s.number("geotag_correlation", &c->geotag_correlation, 0, 1);
  s.number("model_lateral_stddev", &c->model_lateral_stddev, 0, 5);
  s.number("model_height_stddev", &c->model_height_stddev, 0, 5);
  s.finish();
}

void read(Section s, GpsConfig* g) {
  s.number("rate", &g->rate, 0, 20);
  s.number("horizontal_stddev", &g->horizontal_stddev, 0, 50);
  s.number("vertical_stddev", &g->vertical_stddev, 0, 50);
  s.number("correlation_time", &g->correlation_time, 0.1, 1000);
  s.number("jump_interval", &g->jump_interval, 0.1, 1e6);
  s.number("jump_stddev", &g->jump_stddev, 0, 50);
  s.number("noise", &g->noise, 0, 50);
  s.number("stated_stddev", &g->stated_stddev, 0.1, 50);
  s.finish();
}

void read(Section s, BarometerConfig* b) {
  s.number("rate", &b->rate, 0, 200);
  s.number("noise", &b->noise, 0, 100);
  s.number("drift", &b->drift, 0, 100);
  s.number("weather_stddev", &b->weather_stddev, 0, 3000);
  s.finish();
}

void read(Section s, FaultsConfig* f) {
  constexpr double kAny = 1e9;  // the ranges are validate()'s: the command line sets the same fields
  s.number("time_offset", &f->time_offset, -kAny, kAny);
  s.number("readout_time", &f->readout_time, -kAny, kAny);
  s.number("vibration", &f->vibration, -kAny, kAny);
  s.numbers("gyro_bias", &f->gyro_bias);
  s.numbers("accel_bias", &f->accel_bias);
  s.flag("start_in_motion", &f->start_in_motion);
  s.integer("jpeg_quality", &f->jpeg_quality, 0, 100);
  s.number("radial_error", &f->radial_error, -kAny, kAny);
  s.number("focal_error", &f->focal_error, -kAny, kAny);
  s.number("lost_images", &f->lost_images, -kAny, kAny);
  s.number("clock_offset", &f->clock_offset, -kAny, kAny);
  s.number("depth_delay", &f->depth_delay, -kAny, kAny);
  s.choice<StaticTransforms>("tf_static", &f->tf_static,
                             {{"latched", StaticTransforms::kLatched},
                              {"split", StaticTransforms::kSplit},
                              {"publishers", StaticTransforms::kPublishers}});
  s.finish();
  try {
    f->validate();
  } catch (const std::invalid_argument& e) {
    s.fail("", std::string(": ") + e.what());
  }
}

// Optical axis along +y (left) or -y of the base, raised by `pitch`; optical y points down.
air_ground_common::Pose sideCameraMount(bool left, double pitch) {
  air_ground_common::Pose T = air_ground_common::Pose::Identity();
  const double side = left ? 1 : -1;
  T.linear().col(0) = Eigen::Vector3d(side, 0, 0);
  T.linear().col(2) = Eigen::Vector3d(0, side * std::cos(pitch), std::sin(pitch));
  T.linear().col(1) = T.linear().col(2).cross(T.linear().col(0));
  T.translation() = Eigen::Vector3d(0.02, side * 0.06, -0.02);
  return T;
}

}  // namespace

SimConfig SimConfig::defaults() {
  SimConfig c;
  auto& mav = c.mav_camera;
  mav.camera.width = 752;
  mav.camera.height = 480;
  mav.camera.fx = 420.6;
  mav.camera.fy = 420.1;
  mav.camera.cx = 371.2;
  mav.camera.cy = 243.7;
  mav.camera.k1 = -0.200;
  mav.camera.k2 = 0.035;
  mav.camera.p1 = 3.1e-4;
  mav.camera.p2 = -2.2e-4;
  auto& ground = c.ground_camera;
  ground.camera.width = 640;
  ground.camera.height = 480;
  ground.camera.fx = 525.3;
  ground.camera.fy = 525.8;
  ground.camera.cx = 319.1;
  ground.camera.cy = 240.6;
  ground.rate = 15;
  ground.max_exposure = 0.016;
  ground.sensitivity = 150;
  ground.response = 0.55;
  ground.vignetting = 0.2;

  // MAV: optical x = -y_base, optical y = -x_base, optical z = -z_base (looking straight down).
  Eigen::Matrix3d R_down;
  R_down << 0, -1, 0, -1, 0, 0, 0, 0, -1;
  c.T_mav_base_camera.linear() = R_down;
  c.T_mav_base_camera.translation() = Eigen::Vector3d(0.05, 0, -0.03);
  // Ground robot: looking ahead, 17 degrees down.
  Eigen::Matrix3d R_forward;
  R_forward << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  c.T_ground_base_camera.linear() = Eigen::AngleAxisd(17.0 * M_PI / 180, Eigen::Vector3d::UnitY()) * R_forward;
  c.T_ground_base_camera.translation() = Eigen::Vector3d(0.15, 0, 0.5);
  c.T_ground_base_imu.translation() = Eigen::Vector3d(0.05, 0, 0.15);
  return c;
}

SimConfig loadSimConfig(const std::string& yaml_path) {
  YAML::Node root;
  try {
    root = YAML::LoadFile(yaml_path);
  } catch (const YAML::Exception& e) {
    throw std::invalid_argument("cannot read world file '" + yaml_path + "': " + e.what());
  }
  SimConfig config = SimConfig::defaults();
  Section s(root, yaml_path);
  read(s.child("world"), &config.world);
  read(s.child("flight"), &config.flight);
  if (config.hasGroundRobot()) read(s.child("lane"), &config.lane, config.world.kind == WorldKind::kRooms);
  if (config.flight.camera_tilt != 0)
    config.T_mav_base_camera.linear() =
        Eigen::AngleAxisd(-config.flight.camera_tilt, Eigen::Vector3d::UnitY()) * config.T_mav_base_camera.linear();
  if (config.hasCity()) {
    read(s.child("street"), &config.street);
    if (config.street.lines.empty())
      throw std::invalid_argument(yaml_path + "/street: 'lines' must name at least one street");
    const auto& c = config.street;
    config.T_mav_base_camera = sideCameraMount(c.camera_looks_left, c.camera_pitch);
  }
  read(s.child("mav_camera"), &config.mav_camera);
  read(s.child("ground_camera"), &config.ground_camera);
  read(s.child("depth"), &config.depth);
  read(s.child("imu"), &config.imu);
  read(s.child("gps"), &config.gps);
  read(s.child("barometer"), &config.barometer);
  read(s.child("faults"), &config.faults);
  s.finish();
  const auto slash = yaml_path.find_last_of('/');
  config.name = yaml_path.substr(slash == std::string::npos ? 0 : slash + 1);
  config.name = config.name.substr(0, config.name.rfind(".yaml"));
  return config;
}

}  // namespace air_ground_sim
