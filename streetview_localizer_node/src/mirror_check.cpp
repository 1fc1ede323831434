#include "mirror_check.h"

#include <algorithm>

namespace streetview_localizer {
namespace {

constexpr int kFeatures = 1000, kSearched = 500, kViews = 2;
constexpr double kClearRatio = 0.75;  // of a match that hardly arises by chance

}  // namespace

MirrorCheck::MirrorCheck(const Features& features, const ViewSearch& search, const StreetviewDatabase& database,
                         const StreetviewLocalizerSettings& settings)
    : straight_(strongestFeatures(features, kFeatures)),
      mirrored_(mirroredFeatures(straight_)),
      search_(search),
      database_(database),
      pairwise_(settings.pairwise) {
  pairwise_.max_ratio = std::min(pairwise_.max_ratio, kClearRatio);
}

std::size_t MirrorCheck::clearMatches(const Features& features, int view) const {
  return matchPairwise(features, database_.views[static_cast<std::size_t>(view)].features, pairwise_).size();
}

std::string MirrorCheck::objection(int view, bool near_prediction) {
  if (!near_prediction && !elsewhere_) {
    elsewhere_ = 0;
    for (const int v : search_.byMirrorImage(strongestFeatures(mirrored_, kSearched), kViews))
      elsewhere_ = std::max(*elsewhere_, clearMatches(mirrored_, v));
  }
  const auto [it, is_new] = here_.try_emplace(view);
  if (is_new) it->second = {clearMatches(straight_, view), clearMatches(mirrored_, view)};
  const auto [as_it_is, flipped] = it->second;
  const std::size_t as_mirrored = std::max(flipped, elsewhere_.value_or(0));
  if (as_mirrored <= as_it_is) return "";  // of two explanations the one with more matches
  return "mirrored, the image has " + std::to_string(as_mirrored) + " clear matches with a view, as it is " +
         std::to_string(as_it_is);
}

}  // namespace streetview_localizer
