#include "gone_points.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

namespace rgbd_slam {

namespace {

constexpr int kLooks = 4;          // images in turn that see through a point, none that sees it between
constexpr int kThroughWeight = 2;  // of one that sees something beyond, for one that sees nothing at all
constexpr int kGone = kLooks * kThroughWeight;
constexpr std::size_t kWorthwhile = 50;  // points
constexpr double kClearance = 0.05;      // behind a point and the noise: poses of keyframes err a little [m]
constexpr float kFarther = 2;            // than the keyframe saw it: thin things are seen no more [1]
constexpr double kAround = 1 / 128.0;    // of an image: the rim of a thing that stands may lie beside its place [1]
constexpr float kAlikeDistance = 1.25f;  // what gave a depth gives it again, from that much nearer or farther [1]
constexpr float kAlikeCosine = 0.966f;   // and turned by 15 degrees [1]
constexpr double kStands = 0.25;         // of the points that should be seen: else the camera is covered [1]

enum class Sight : std::uint8_t { kUnknown, kThere, kThrough, kMissing };

Sight sightAt(const cv::Mat& depth, int u, int v, float expected, float clearance, const DepthModel& model,
              const CloudSettings& settings) {
  if (u < 0 || v < 0 || u >= depth.cols || v >= depth.rows) return Sight::kUnknown;
  const float z = depth.at<float>(v, u);
  if (!isKnown(z)) return Sight::kMissing;
  const float beyond = z - expected, noise = static_cast<float>(settings.gate * model.sigma(z));
  if (beyond > noise + clearance) return Sight::kThrough;
  return beyond > -noise - clearance ? Sight::kThere : Sight::kUnknown;  // something nearer only hides it
}

/// Of a point that is not there itself. Through where that holds for most of what lies about it, missing where next to
/// nothing of it gives a nearer depth; unknown where any of it is there.
Sight sightAbout(const cv::Mat& depth, int u, int v, float expected, float clearance, const DepthModel& model,
                 const CloudSettings& settings) {
  const int step = std::max(1, static_cast<int>(std::lround(kAround * depth.cols)));
  int through = 0, missing = 0;
  for (int k = 0; k < 9; ++k) {
    const Sight sight =
        sightAt(depth, u + (k % 3 - 1) * step, v + (k / 3 - 1) * step, expected, clearance, model, settings);
    if (sight == Sight::kThere) return Sight::kUnknown;
    through += sight == Sight::kThrough;
    missing += sight == Sight::kMissing;
  }
  if (through >= 6) return Sight::kThrough;
  return through + missing >= 8 ? Sight::kMissing : Sight::kUnknown;
}

}  // namespace

void GonePoints::look(const air_ground_common::CameraModel& camera, const std::vector<KeyframeDepth::Point>& points,
                      const cv::Mat& depth, const air_ground_common::Pose& T_frame_keyframe, const DepthModel& model,
                      const CloudSettings& settings, const visual_frontend::RollingShutter& rows) {
  seen_through_.resize(points.size(), 0);
  const Eigen::Matrix3f R = T_frame_keyframe.linear().cast<float>();
  const Eigen::Vector3f t = T_frame_keyframe.translation().cast<float>();
  const auto sightOf = [&](const Eigen::Vector3f& point) {
    const Eigen::Vector3f p = R * point + t;
    if (!(p.z() > model.min_range && p.z() < kFarther * point.z())) return Sight::kUnknown;
    Eigen::Vector3d seen = p.cast<double>();
    auto pixel = camera.project(seen);
    if (pixel && rows.active()) {
      seen = rows.pointFromMiddleRow(pixel->y(), seen);
      pixel = camera.project(seen);
    }
    if (!pixel) return Sight::kUnknown;
    const int u = static_cast<int>(std::lround(pixel->x())), v = static_cast<int>(std::lround(pixel->y()));
    const auto expected = static_cast<float>(seen.z());
    // The surface may rise within the pixel.
    const auto clearance = static_cast<float>(kClearance + 1.5 * expected / camera.fx);
    const Sight sight = sightAt(depth, u, v, expected, clearance, model, settings);
    if (sight == Sight::kThere || sight == Sight::kUnknown) return sight;
    const Sight about = sightAbout(depth, u, v, expected, clearance, model, settings);
    if (about != Sight::kMissing) return about;
    const float near = point.norm(), now = p.norm();
    const bool alike =
        now < kAlikeDistance * near && near < kAlikeDistance * now && (R * point).dot(p) > kAlikeCosine * near * now;
    return alike ? Sight::kMissing : Sight::kUnknown;
  };
  std::vector<Sight> sights(points.size());
  std::size_t there = 0, missing = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    sights[i] = sightOf(points[i].position);
    there += sights[i] == Sight::kThere;
    missing += sights[i] == Sight::kMissing;
  }
  const bool covered = static_cast<double>(there) < kStands * static_cast<double>(there + missing);
  for (std::size_t i = 0; i < points.size(); ++i) {
    std::uint8_t& seen = seen_through_[i];
    if (seen >= kGone) continue;
    if (sights[i] == Sight::kThere) seen = 0;
    if (sights[i] == Sight::kThrough) seen = static_cast<std::uint8_t>(seen + kThroughWeight);
    if (sights[i] == Sight::kMissing && !covered) ++seen;
    gone_ += seen >= kGone;
  }
}

KeyframePoints GonePoints::left(const std::vector<KeyframeDepth::Point>& points) {
  if (gone_ < kWorthwhile) return nullptr;
  auto left = std::make_shared<std::vector<KeyframeDepth::Point>>();
  std::vector<std::uint8_t> seen_through;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (seen_through_[i] >= kGone) continue;
    left->push_back(points[i]);
    seen_through.push_back(seen_through_[i]);
  }
  seen_through_ = std::move(seen_through);
  gone_ = 0;
  return left;
}

}  // namespace rgbd_slam
