#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "air_ground_common/text.h"
#include "streetview_localizer/neighbour_check.h"

namespace streetview_localizer {
namespace {

using air_ground_common::formatted;
using air_ground_common::Pose;
using Verdict = NeighbourVerdict::Kind;
using Outcome = NeighbourOutcome::Kind;

/// "its neighbours a.jpg, b.jpg place it 1.2 m east of where its outline fits".
std::string sayingOf(const std::vector<NeighbourImage>& images, int image, const NeighbourVerdict& verdict,
                     const NeighbourSettings& s) {
  constexpr std::size_t kNamed = 3;
  static const char* const kWinds[] = {"east", "north-east", "north", "north-west",
                                       "west", "south-west", "south", "south-east"};
  const std::size_t count = verdict.witnesses.size();
  std::string text = count == 1 ? "its neighbour" : "its neighbours";
  for (std::size_t i = 0; i < std::min(kNamed, count); ++i)
    text += (i == 0 ? " " : ", ") + images[verdict.witnesses[i]].name;
  if (count > kNamed) text += formatted(" and %zu more", count - kNamed);
  const Pose& own = images[image].T_world_image;
  const Eigen::Vector2d off = (verdict.T_world_image.translation() - own.translation()).head<2>();
  if (off.norm() > s.position) {
    const auto wind = static_cast<int>(std::lround(std::atan2(off.y(), off.x()) / (M_PI / 4))) & 7;
    return text + formatted(" %s it %.1f m %s of where its outline fits", count == 1 ? "places" : "place", off.norm(),
                            kWinds[wind]);
  }
  const double turn = air_ground_common::rotationAngle(own.linear(), verdict.T_world_image.linear());
  return text + formatted(" %s it by %.1f degrees from how its outline fits", count == 1 ? "turns" : "turn",
                          turn * 180 / M_PI);
}

/// One of two is wrong by what is between them, either as likely.
void doubt(const Pose& T_world_other, NeighbourOutcome* outcome) {
  const double off = (T_world_other.translation() - outcome->T_world_image.translation()).head<2>().norm(),
               turn = air_ground_common::rotationAngle(T_world_other.linear(), outcome->T_world_image.linear());
  outcome->position_stddev = std::hypot(outcome->position_stddev, off / std::sqrt(2.0));
  outcome->orientation_stddev = std::hypot(outcome->orientation_stddev, turn / std::sqrt(2.0));
}

}  // namespace

std::vector<NeighbourOutcome> settleNeighbours(const std::vector<NeighbourImage>& images,
                                               const std::vector<NeighbourVerdict>& verdicts, const CityModel& model,
                                               const RegistrationSettings& registration,
                                               const NeighbourSettings& settings,
                                               const std::function<void(int, int)>& progress) {
  std::vector<NeighbourOutcome> outcomes(images.size());
  std::vector<RegistrationInput> inputs;
  std::vector<int> input_of;
  for (int i = 0; i < static_cast<int>(images.size()); ++i) {
    NeighbourOutcome& outcome = outcomes[i];
    outcome.T_world_image = images[i].T_world_image;
    outcome.position_stddev = images[i].position_stddev;
    outcome.orientation_stddev = images[i].orientation_stddev;
    if (verdicts[i].kind == Verdict::kUnopposed) continue;
    if (verdicts[i].kind == Verdict::kDoubtful) {
      outcome.kind = Outcome::kDoubtful;
      outcome.remark = sayingOf(images, i, verdicts[i], settings) + "; which is right cannot be told";
      doubt(verdicts[i].T_world_image, &outcome);
      continue;
    }
    inputs.push_back({images[i].load, images[i].camera, verdicts[i].T_world_image, true});
    input_of.push_back(i);
  }
  if (inputs.empty()) return outcomes;
  const PanoramaRegistrar registrar(model, aroundNeighbours(registration, settings));
  const auto results = registrar.registerPanoramas(inputs, [&](std::size_t done) {
    if (progress) progress(static_cast<int>(done), static_cast<int>(inputs.size()));
  });
  for (std::size_t k = 0; k < results.size(); ++k) {
    const int i = input_of[k];
    NeighbourOutcome& outcome = outcomes[i];
    const bool fits = results[k].accepted && agrees(results[k].T_world_panorama, verdicts[i].T_world_image, settings);
    if (verdicts[i].kind == Verdict::kContradicted) {
      outcome.kind = fits ? Outcome::kAnew : Outcome::kRefused;
      outcome.remark = sayingOf(images, i, verdicts[i], settings);
    } else if (fits) {
      outcome.kind = Outcome::kGained;
    }
    if (!fits) continue;
    outcome.T_world_image = results[k].T_world_panorama;
    outcome.position_stddev = results[k].position_stddev;
    outcome.orientation_stddev = results[k].orientation_stddev;
  }
  return outcomes;
}

}  // namespace streetview_localizer
