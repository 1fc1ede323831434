#include "gone_points.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

namespace rgbd_slam {

namespace {

constexpr int kLooks = 4;                // images in turn that see through a point, none that sees it between
constexpr std::size_t kWorthwhile = 50;  // points
constexpr double kClearance = 0.05;      // behind a point and the noise: poses of keyframes err a little [m]
constexpr float kFarther = 2;            // than the keyframe saw it: thin things are seen no more [1]
constexpr double kAround = 1 / 128.0;    // of an image: the rim of a thing that stands may lie beside its place [1]

enum class Sight { kUnknown, kThere, kThrough };

Sight sightAt(const cv::Mat& depth, int u, int v, float expected, float clearance, const DepthModel& model,
              const CloudSettings& settings) {
  if (u < 0 || v < 0 || u >= depth.cols || v >= depth.rows) return Sight::kUnknown;
  const float z = depth.at<float>(v, u);
  if (!std::isfinite(z) || z <= 0) return Sight::kUnknown;
  const float beyond = z - expected, noise = static_cast<float>(settings.gate * model.sigma(z));
  if (beyond > noise + clearance) return Sight::kThrough;
  return beyond > -noise - clearance ? Sight::kThere : Sight::kUnknown;  // something nearer only hides it
}

/// Through where the point should be and all that is known about it, most of what there is.
bool seesThrough(const cv::Mat& depth, int u, int v, float expected, float clearance, const DepthModel& model,
                 const CloudSettings& settings) {
  const int step = std::max(1, static_cast<int>(std::lround(kAround * depth.cols)));
  int through = 0;
  for (int k = 0; k < 9; ++k) {
    const Sight sight =
        sightAt(depth, u + (k % 3 - 1) * step, v + (k / 3 - 1) * step, expected, clearance, model, settings);
    if (sight == Sight::kThere) return false;
    through += sight == Sight::kThrough;
  }
  return through >= 6;
}

}  // namespace

void GonePoints::look(const air_ground_common::CameraModel& camera, const std::vector<KeyframeDepth::Point>& points,
                      const cv::Mat& depth, const air_ground_common::Pose& T_frame_keyframe, const DepthModel& model,
                      const CloudSettings& settings, const visual_frontend::RollingShutter& rows) {
  seen_through_.resize(points.size(), 0);
  const Eigen::Matrix3f R = T_frame_keyframe.linear().cast<float>();
  const Eigen::Vector3f t = T_frame_keyframe.translation().cast<float>();
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (seen_through_[i] >= kLooks) continue;
    const Eigen::Vector3f p = R * points[i].position + t;
    if (!(p.z() > model.min_range && p.z() < kFarther * points[i].position.z())) continue;
    Eigen::Vector3d seen = p.cast<double>();
    auto pixel = camera.project(seen);
    if (pixel && rows.active()) {
      seen = rows.pointFromMiddleRow(pixel->y(), seen);
      pixel = camera.project(seen);
    }
    if (!pixel) continue;
    const int u = static_cast<int>(std::lround(pixel->x())), v = static_cast<int>(std::lround(pixel->y()));
    const auto expected = static_cast<float>(seen.z());
    // The surface may rise within the pixel.
    const auto clearance = static_cast<float>(kClearance + 1.5 * expected / camera.fx);
    const Sight sight = sightAt(depth, u, v, expected, clearance, model, settings);
    if (sight == Sight::kThere) seen_through_[i] = 0;
    if (sight != Sight::kThrough || !seesThrough(depth, u, v, expected, clearance, model, settings)) continue;
    gone_ += ++seen_through_[i] == kLooks;
  }
}

KeyframePoints GonePoints::left(const std::vector<KeyframeDepth::Point>& points) {
  if (gone_ < kWorthwhile) return nullptr;
  auto left = std::make_shared<std::vector<KeyframeDepth::Point>>();
  std::vector<std::uint8_t> seen_through;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (seen_through_[i] >= kLooks) continue;
    left->push_back(points[i]);
    seen_through.push_back(seen_through_[i]);
  }
  seen_through_ = std::move(seen_through);
  gone_ = 0;
  return left;
}

}  // namespace rgbd_slam
