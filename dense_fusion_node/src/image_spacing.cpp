#include "dense_fusion/image_spacing.h"

#include <algorithm>
#include <vector>

#include "air_ground_common/statistics.h"

namespace dense_fusion {

void ImageSpacing::add(double distance) {
  constexpr std::size_t kRecent = 9;
  recent_.push_back(distance);
  if (recent_.size() > kRecent) recent_.pop_front();
}

double ImageSpacing::typical() const {
  return recent_.empty() ? 0 : air_ground_common::median(std::vector<double>(recent_.begin(), recent_.end()));
}

SweepReach sweepReach(double radius, double spacing, double longest) {
  constexpr double kEnough = 2.5, kWanted = 3.5;  // images on each side of the reference view
  SweepReach reach{radius, false};
  if (radius >= kEnough * spacing) return reach;
  reach.radius = std::max(radius, std::min(kWanted * spacing, longest));
  reach.few = reach.radius < kEnough * spacing;
  return reach;
}

}  // namespace dense_fusion
