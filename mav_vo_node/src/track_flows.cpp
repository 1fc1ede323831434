#include "mav_vo/track_flows.h"

#include <utility>

#include "air_ground_common/statistics.h"
#include "visual_frontend/feature_tracker.h"

namespace mav_vo {

namespace {

constexpr double kLongest = 0.25;  // between two images that tell how a track moves [s]
constexpr double kChange =
    5;  // of a track against the others from one image to the next, beyond which it is wrong [sigmas]

}  // namespace

void TrackFlows::add(double stamp, const std::vector<visual_frontend::Feature>& features) {
  const double dt = last_stamp_ >= 0 ? stamp - last_stamp_ : 0;
  last_stamp_ = stamp;
  const auto before = std::exchange(tracks_, {});
  std::vector<std::pair<Track*, Eigen::Vector2d>> changes;  // of the mean flow
  std::vector<double> changes_x, changes_y;
  for (const auto& f : features) {
    Track& track = tracks_[f.id];
    track.ray = f.normalized;
    const auto last = before.find(f.id);
    if (last == before.end() || !(dt > 0 && dt < kLongest)) continue;
    track.mean = (f.normalized - last->second.ray) / dt;
    if (!last->second.mean) continue;
    const Eigen::Vector2d change = *track.mean - *last->second.mean;
    changes.emplace_back(&track, change);
    changes_x.push_back(change.x());
    changes_y.push_back(change.y());
  }
  if (changes.empty()) return;
  // A camera that speeds up changes the flow of all tracks alike: what the images so far show of it is half an interval
  // old.
  const Eigen::Vector2d common(air_ground_common::median(std::move(changes_x)),
                               air_ground_common::median(std::move(changes_y)));
  for (const auto& [track, change] : changes)
    if ((change - common).norm() * dt < kChange * sigma_) track->flow = *track->mean + 0.5 * common;
}

const Eigen::Vector2d* TrackFlows::steadyFlow(visual_frontend::TrackId id) const {
  const auto track = tracks_.find(id);
  return track != tracks_.end() && track->second.flow ? &*track->second.flow : nullptr;
}

void TrackFlows::clear() {
  last_stamp_ = -1;
  tracks_.clear();
}

}  // namespace mav_vo
