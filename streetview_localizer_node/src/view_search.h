// The views that may show what an image shows: the few of the database that are worth matching one by one.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

/// The `count` features of strongest response (0: all), in their order.
Features strongestFeatures(const Features& features, int count);

/// What the mirror image's features would be, at the places of the image's own: the same numbers in another order.
Features mirroredFeatures(Features features);

struct FoundDescriptors {
  std::vector<int> queried;                      ///< indices of the features that were looked for
  std::vector<std::vector<Neighbor>> neighbors;  ///< of each
};

/// Thread-safe once made.
class ViewSearch {
 public:
  /// Both must outlive it. Reads the descriptors' index from settings.index_file, or builds it and keeps it there.
  ViewSearch(const StreetviewDatabase& database, const StreetviewLocalizerSettings& settings);

  /// The whole database's descriptors that are nearest to an image's strongest ones, and the views that they vote for.
  FoundDescriptors nearest(const Features& query) const;
  std::vector<int> votedBy(const FoundDescriptors& found, const Features& query, int max_views) const;

  /// Views of the nearest panoramas around a predicted pose that show what would be seen from there, those first whose
  /// facade points fall into the predicted image most.
  std::vector<int> byPrior(const CameraModel& camera, const PosePrior& prior, int max_views) const;

  /// Voted by all of the few features of a mirror image.
  std::vector<int> byMirrorImage(const Features& mirrored, int max_views) const;

  /// Where the index came from, for the log.
  const std::string& indexRemark() const { return index_remark_; }

 private:
  void prepareIndex();

  const StreetviewDatabase& database_;
  const StreetviewLocalizerSettings& settings_;
  cv::Mat descriptors_;           // of all views
  std::vector<int> view_of_row_;  // of descriptors_
  std::unique_ptr<DescriptorIndex> index_;
  std::string index_remark_;
};

}  // namespace streetview_localizer
