// A facade is often its own mirror image: an image that was flipped finds a place too, but has fewer clear matches
// there than its mirror image has with the view that shows it.
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "view_search.h"

namespace streetview_localizer {

/// Of one image, for all poses that are found for it: what was searched and matched once is kept.
class MirrorCheck {
 public:
  /// `features`: of the image as recorded, without its virtual views. The others must outlive it.
  MirrorCheck(const Features& features, const ViewSearch& search, const StreetviewDatabase& database,
              const StreetviewLocalizerSettings& settings);

  /// Why an image whose pose rests on `view` is taken for a mirrored one; empty if it is not. Views where the mirror
  /// image may belong are looked for in the whole database, unless `near_prediction`: what led to the prediction has
  /// been tested so.
  std::string objection(int view, bool near_prediction);

 private:
  std::size_t clearMatches(const Features& features, int view) const;

  const Features straight_, mirrored_;
  const ViewSearch& search_;
  const StreetviewDatabase& database_;
  PairwiseSettings pairwise_;
  std::optional<std::size_t> elsewhere_;  // clear matches of the mirror image with the view that it resembles most
  std::map<int, std::pair<std::size_t, std::size_t>> here_;  // the image's and its mirror image's with a view
};

}  // namespace streetview_localizer
