#include "relocalizer.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "air_ground_common/statistics.h"
#include "visual_frontend/image_noise.h"

namespace mav_vo {

namespace {

constexpr int kPlaceEvery = 5;         // images between searches for a known place ...
constexpr double kPlaceSeconds = 0.5;  // or so long, where they come slowly [s]
constexpr double kLongestGap = 1;      // between images, of which it is known what the camera saw [s]
constexpr int kNearImages = 10;        // in which the camera is looked for near its last pose ...
constexpr double kNearLeast = 0.5;     // or so long, where they come fast ... [s]
constexpr double kNearSeconds = 0.7;   // and so long at the most [s]
constexpr double kNearRadius = 25;     // of the search about where a landmark should be, at least ...
constexpr double kMostRadius = 60;     // ... and at the most [px]
constexpr double kSpeedChange = 0.25;  // of the speed, that may have come about unseen
constexpr double kAtPlaceRadius = 15;  // likewise once a place is recognised [px]
constexpr int kSteadyImages = 5;       // that a corner must have lived to begin a map with

/// Corners too faint to be described may begin a map, where the camera moves: a lens in the grass does not.
bool couldBegin(const std::vector<visual_frontend::Feature>& features, const OdometrySettings& settings) {
  std::vector<double> steps;
  for (const auto& f : features)
    if (f.age >= kSteadyImages) steps.push_back((f.pixel - f.previous_pixel).norm());
  return static_cast<int>(steps.size()) >= settings.bootstrap.min_common &&
         air_ground_common::median(std::move(steps)) > settings.standstill.pixels;
}

}  // namespace

void Relocalizer::begin(double stamp) {
  lost_since_ = last_ = last_image_ = last_search_ = stamp;
  strange_for_ = unsearched_ = could_begin_for_ = 0;
  frames_lost_ = 0;
  reason_.clear();
}

visual_frontend::ReobservationSettings Relocalizer::within(double search_radius) const {
  visual_frontend::ReobservationSettings how = settings_.reobservation;
  how.search_radius = search_radius;
  return how;
}

// How far a landmark may be from where it would be had the camera flown on as it did.
double Relocalizer::nearRadius(double stamp, const PoseTracker& pose) const {
  const double strayed = kSpeedChange * pose.speed() * (stamp - pose.locatedStamp());
  return std::min(kNearRadius + camera_.fx * strayed / pose.sceneDistance(), kMostRadius);
}

bool Relocalizer::find(double stamp, const cv::Mat& gray, const visual_frontend::Map& map,
                       const visual_frontend::RelocalizationGate& gate, const std::optional<double>& turn_sigma,
                       PoseTracker& pose) {
  ++frames_lost_;
  visual_frontend::FeatureTracker& tracker = pose.tracker();
  if (tracker.features().size() < 0.5 * settings_.tracker.max_features) tracker.replenish();
  if (const double gap = stamp - std::exchange(last_image_, stamp); gap <= kLongestGap) {
    unsearched_ += gap;
    if (couldBegin(tracker.features(), settings_)) could_begin_for_ += gap;
  }
  if ((frames_lost_ <= kNearImages || stamp - lost_since_ < kNearLeast) && stamp - pose.locatedStamp() < kNearSeconds) {
    if (frames_lost_ > 1) pose.coast(stamp - last_);
    last_ = stamp;
    pose.reobserve(within(nearRadius(stamp, pose)));
    if (pose.locate(turn_sigma)) {
      reason_.clear();
      return true;
    }
  }
  if ((frames_lost_ - 1) % kPlaceEvery != 0 && stamp - last_search_ < kPlaceSeconds) return false;
  visual_frontend::Keyframe query;
  query.stamp = stamp;
  visual_frontend::describeKeyframe(gray, camera_, settings_.place, query);
  last_search_ = stamp;
  const double since = std::exchange(unsearched_, 0), begins = std::exchange(could_begin_for_, 0);
  if (!visual_frontend::isNoise(gray))
    strange_for_ += query.orb_pixels.size() >= 2u * settings_.place.min_inliers ? since : begins;
  const auto match = visual_frontend::relocalize(map, camera_, query, gate, settings_.place);
  if (!match.success) {
    reason_ = "lost: no known place recognised (" + match.reason + "); show the camera what it has seen before";
    return false;
  }
  pose.beginAround(map.keyframe(match.keyframe).T_map_camera * match.T_place_query, gray, within(kAtPlaceRadius));
  const bool found = pose.locate(std::nullopt);
  reason_ = found ? "" : "lost: a known place was recognised, but " + pose.result().reason;
  tracker.replenish();
  return found;
}

}  // namespace mav_vo
