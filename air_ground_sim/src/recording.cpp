#include "air_ground_sim/recording.h"

#include <cmath>

#include "air_ground_sim/build_world.h"
#include "air_ground_sim/height_lookup.h"
#include "air_ground_sim/rooms/rooms.h"

namespace air_ground_sim {

using air_ground_common::Pose;

Recording::Recording(const SimConfig& config, std::uint64_t seed)
    : config_(config),
      seed_(seed),
      street_(config.hasCity() ? std::make_unique<Street>(planStreet(config.street, seed)) : nullptr),
      world_(street_ ? buildStreetWorld(*street_, Season::kFlight) : buildWorld(config, seed)),
      scene_(std::make_unique<Scene>(world_)),
      mav_exposure_(config.mav_camera),
      ground_exposure_(config.ground_camera),
      mav_imager_(config.mav_camera, mix(seed, 21)),
      ground_imager_(config.ground_camera, mix(seed, 22)) {
  config.faults.validate();
  mav_renderer_ =
      std::make_unique<Renderer>(*scene_, config.mav_camera.camera, config.mav_camera.samples, mix(seed, 13));
  if (config.hasGroundRobot())
    ground_renderer_ =
        std::make_unique<Renderer>(*scene_, config.ground_camera.camera, config.ground_camera.samples, mix(seed, 14));
  planWays();
}

void Recording::planWays() {
  const bool cut = config_.faults.start_in_motion;
  // Longer by what is then cut off: standing still, climbing, setting off.
  const auto plan = [&](double lead, const auto& make) {
    return std::make_unique<BodyTrajectory>(cut ? make(duration() + lead).beginningAt(lead) : make(duration()));
  };
  FlightConfig flight = street_ ? config_.flight : world_.flight;
  const std::unique_ptr<HeightLookup> heights = street_ ? nullptr : std::make_unique<HeightLookup>(scene_->mesh());
  mav_ = plan(flight.stand_still + kClimbTime, [&](double duration) {
    flight.duration = duration;
    if (street_) return makeStreetFlight(*street_, flight, mix(seed_, 11));
    if (!world_.flight_way.empty()) return makeRoomsFlight(flight, world_.flight_way, world_.doors, mix(seed_, 11));
    return makeFlight(flight, world_.mav_start, *heights, mix(seed_, 11));
  });
  if (!config_.hasGroundRobot()) return;
  ground_ = plan(world_.lane.stand_still + kDriveRamp,
                 [&](double duration) { return makeDrive(world_.lane, duration, mix(seed_, 12)); });
}

int Recording::frameCount(const ImagerConfig& camera) const {
  return std::max(0, static_cast<int>(std::floor((duration() - 0.1) * camera.rate)) + 1);
}

std::vector<Pose> Recording::posesOver(const BodyTrajectory& body, const Pose& T_base_camera, double middle,
                                       double exposure, int samples, int height) const {
  const double readout = config_.faults.readout_time;
  std::vector<Pose> poses;
  for (int row = 0; row < (readout > 0 ? height : 1); ++row) {
    const double seen = readout > 0 ? middle + readout * (static_cast<double>(row) / height - 0.5) : middle;
    for (int s = 0; s < samples; ++s)
      poses.push_back(body.pose(seen + exposure * ((s + 0.5) / samples - 0.5)) * T_base_camera);
  }
  return poses;
}

void Recording::mavImage(int i, std::vector<std::uint8_t>* image) {
  const double exposure = mav_exposure_.exposure();
  const ImagerConfig& c = config_.mav_camera;
  mav_renderer_->light(
      posesOver(*mav_, config_.T_mav_base_camera, frameTime(c, i), exposure, c.samples, c.camera.height), 1,
      &mav_light_);
  mav_exposure_.update(mav_imager_.expose(mav_light_, 1, exposure, i, image));
}

void Recording::groundImage(int i, RgbdFrame* frame) {
  const double exposure = ground_exposure_.exposure();
  const ImagerConfig& c = config_.ground_camera;
  const double time = frameTime(c, i);
  ground_renderer_->light(posesOver(*ground_, config_.T_ground_base_camera, time, exposure, c.samples, c.camera.height),
                          3, &ground_light_);
  ground_exposure_.update(ground_imager_.expose(ground_light_, 3, exposure, i, &frame->rgb));
  ground_renderer_->depth(
      posesOver(*ground_, config_.T_ground_base_camera, time + config_.faults.depth_delay, 0, 1, c.camera.height),
      config_.depth.noise ? static_cast<float>(config_.depth.baseline) : 0.0f, &depth_);
  measureDepth(depth_, config_.depth, mix(seed_, 23), i, &frame->depth_mm);
}

void Recording::photograph(const Pose& T_world_camera, const Eigen::Vector3d& velocity, int index,
                           std::vector<std::uint8_t>* image) {
  const ImagerConfig& c = config_.mav_camera;
  ExposureControl control(c);
  for (int round = 0; round < 2;
       ++round) {  // the blur hardly changes the mean: converge, then take it again as it came out
    const double exposure = control.exposure();
    std::vector<Pose> poses;
    for (int s = 0; s < c.samples; ++s) {
      poses.push_back(T_world_camera);
      poses.back().translation() += velocity * exposure * ((s + 0.5) / c.samples - 0.5);
    }
    mav_renderer_->light(poses, 1, &mav_light_);
    for (int i = 0; i < (round ? 1 : 25); ++i)
      control.update(mav_imager_.expose(mav_light_, 1, control.exposure(), index, image));
  }
}

Imu Recording::makeMavImu() const { return Imu(config_.imu, config_.T_mav_base_imu, mix(seed_, 31), config_.faults); }
Imu Recording::makeGroundImu() const {
  return Imu(config_.imu, config_.T_ground_base_imu, mix(seed_, 32), config_.faults);
}

}  // namespace air_ground_sim
