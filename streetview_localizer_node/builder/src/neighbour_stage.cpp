#include "neighbour_stage.h"

#include <algorithm>

#include "streetview_localizer/neighbour_check.h"

namespace streetview_localizer {
namespace {

using Kind = NeighbourOutcome::Kind;

NeighbourImage neighbourOf(const BuildItem& item, bool fixed) {
  const Panorama& p = item.panorama;
  NeighbourImage image;
  image.name = p.id;
  image.load = [path = item.path] { return readStored(path); };
  if (!p.equirectangular) image.camera = item.camera;
  image.T_world_image = p.T_world_panorama;
  image.registered = p.registered;
  image.fixed = fixed;
  image.position_stddev = p.position_stddev;
  image.orientation_stddev = p.orientation_stddev;
  return image;
}

void adopt(const NeighbourOutcome& outcome, const BuildSettings& settings, BuildItem* item, BuildReport* report) {
  Panorama& p = item->panorama;
  if (outcome.kind == Kind::kKept) return;
  if (outcome.kind == Kind::kRefused) {
    p.registered = false;
    placeAtGeotag(settings, item);
    p.remark = "pose not corrected: " + outcome.remark;
    return;
  }
  p.registered = true;
  p.T_world_panorama = outcome.T_world_image;
  p.position_stddev = outcome.position_stddev;
  p.orientation_stddev = outcome.orientation_stddev;
  p.remark = outcome.kind == Kind::kDoubtful ? outcome.remark : "";
  if (outcome.kind == Kind::kAnew) report->corrected_anew.push_back({p.id, outcome.remark});
  if (outcome.kind == Kind::kGained) ++report->gained;
}

}  // namespace

void compareNeighbours(const BuildSettings& settings, const BackProjector& projector,
                       const std::function<bool(const BuildItem&)>& stored,
                       const std::function<void(const std::string&, int, int)>& tell, std::vector<BuildItem>* items,
                       BuildReport* report) {
  if (!settings.check_neighbours || !settings.register_panoramas || !settings.poses.empty()) return;
  std::vector<NeighbourImage> images;
  std::vector<BuildItem*> item_of;
  for (BuildItem& item : *items) {
    const bool fixed = stored(item);
    if (!item.readable || (fixed && !item.panorama.registered)) continue;
    images.push_back(neighbourOf(item, fixed));
    item_of.push_back(&item);
  }
  if (std::all_of(images.begin(), images.end(), [](const NeighbourImage& i) { return i.fixed; })) return;
  const RegistrationSettings registration = registrationOf(settings);
  const std::vector<NeighbourEdge> edges =
      measureNeighbours(images, projector, settings.neighbours, registration.threads,
                        [&](int done, int all) { tell("comparing neighbours", done, all); });
  report->neighbour_pairs = static_cast<int>(edges.size());
  const std::vector<NeighbourOutcome> outcomes =
      settleNeighbours(images, judgeNeighbours(images, edges, settings.neighbours), projector.model(), registration,
                       settings.neighbours, [&](int done, int all) { tell("correcting again", done, all); });
  for (std::size_t i = 0; i < outcomes.size(); ++i) adopt(outcomes[i], settings, item_of[i], report);
}

}  // namespace streetview_localizer
