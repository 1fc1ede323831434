// Both robots in one world: trajectories and every sensor's readings over time, without ROS.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "air_ground_sim/config.h"
#include "air_ground_sim/renderer.h"
#include "air_ground_sim/scene.h"
#include "air_ground_sim/sensors.h"
#include "air_ground_sim/street/street.h"
#include "air_ground_sim/trajectory.h"
#include "air_ground_sim/world.h"

namespace air_ground_sim {

struct RgbdFrame {
  std::vector<std::uint8_t> rgb;        ///< R G B, row by row
  std::vector<std::uint16_t> depth_mm;  ///< registered to rgb, `depth_delay` later; 0 = no measurement
};

class Recording {
 public:
  /// Builds the world, bakes its light, plans both ways. Same config and seed, same data, for any number of threads.
  Recording(const SimConfig& config, std::uint64_t seed);

  const SimConfig& config() const { return config_; }
  std::uint64_t seed() const { return seed_; }
  const World& world() const { return world_; }
  const Scene& scene() const { return *scene_; }
  const BodyTrajectory& mav() const { return *mav_; }
  const BodyTrajectory& ground() const { return *ground_; }    ///< only where config().hasGroundRobot()
  const Street& street() const { return *street_; }            ///< only where config().hasCity()
  double duration() const { return config_.flight.duration; }  ///< [s]

  /// Time of frame i of a camera: the middle of its middle row's exposure [s].
  static double frameTime(const ImagerConfig& camera, int i) { return 0.05 + i / camera.rate; }
  int frameCount(const ImagerConfig& camera) const;

  /// The MAV's next image, mono8; call for i = 0, 1, ... (the exposure control has memory). One thread may call
  /// mavImage() while another calls groundImage().
  void mavImage(int i, std::vector<std::uint8_t>* image);
  void groundImage(int i, RgbdFrame* frame);

  /// A picture the MAV's camera takes from anywhere, well exposed; `index` selects the noise. `velocity` of the camera
  /// in world [m/s].
  void photograph(const air_ground_common::Pose& T_world_camera, const Eigen::Vector3d& velocity, int index,
                  std::vector<std::uint8_t>* image);

  Imu makeMavImu() const;
  Imu makeGroundImu() const;

 private:
  /// Poses of a camera while it takes a frame: each sample's of the exposure, for all rows or row by row as its shutter
  /// rolls. `samples` 1 and exposure 0: at the rows' middle.
  std::vector<air_ground_common::Pose> posesOver(const BodyTrajectory& body,
                                                 const air_ground_common::Pose& T_base_camera, double middle,
                                                 double exposure, int samples, int height) const;
  void planWays();
  SimConfig config_;
  std::uint64_t seed_;
  std::unique_ptr<Street> street_;
  World world_;
  std::unique_ptr<Scene> scene_;
  std::unique_ptr<BodyTrajectory> mav_, ground_;
  std::unique_ptr<Renderer> mav_renderer_, ground_renderer_;
  ExposureControl mav_exposure_, ground_exposure_;
  Imager mav_imager_, ground_imager_;
  std::vector<float> mav_light_, ground_light_;
  DepthImage depth_;
};

}  // namespace air_ground_sim
