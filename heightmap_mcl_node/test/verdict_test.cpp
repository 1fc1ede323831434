// Each thing that may speak against a place, alone.
#include "verdict.h"

#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <vector>

namespace heightmap_mcl {
namespace {

const VerdictSettings kSettings;

/// Everything exactly as it has to be.
PlaceMeasures justEnough() {
  PlaceMeasures place;
  place.relief = kSettings.min_relief;
  place.raised = kSettings.min_raised;
  place.probe_ratio = kSettings.probe_ratio;
  place.rival_ratio = kSettings.ambiguity_ratio;
  place.agreement = kSettings.min_agreement;
  place.maps = kSettings.min_maps;
  place.evidence = place.guess_evidence = kSettings.min_evidence;
  place.particles_agree = true;
  place.mode_weight = kSettings.min_mode_weight;
  place.mode_spread = kSettings.max_spread;
  place.mode_spread_yaw = kSettings.max_spread_yaw;
  return place;
}

using Change = std::function<void(PlaceMeasures*)>;

TEST(Verdict, JustEnoughIsBelieved) {
  const Verdict verdict = judge(justEnough(), kSettings);
  EXPECT_EQ(verdict.status, Status::kConverged) << verdict.reason;
  EXPECT_FALSE(verdict.guess) << "a guess is what is not believed";
}

TEST(Verdict, EachLackIsRefusedAndNamed) {
  struct Case {
    Change lack;
    Status status;
    std::string reason;
  };
  const std::vector<Case> cases{
      {[](PlaceMeasures* p) { p->relief *= 0.99; }, Status::kDegenerate, "flat"},
      {[](PlaceMeasures* p) { p->raised *= 0.99; }, Status::kDegenerate, "bare"},
      {[](PlaceMeasures* p) {
         p->probe_ratio *= 0.99;
         p->flattest = {0.25, 0, 0.1};
       },
       Status::kDegenerate,
       "moved by (0.25 m, 0.00 m, 5.7 deg) the map costs 1.19 times as much, 1.20 times are needed"},
      {[](PlaceMeasures* p) {
         p->rival_ratio *= 0.99;
         p->rival_distance = 3.5;
       },
       Status::kAmbiguous, "another place 3.50 m away"},
      {[](PlaceMeasures* p) { p->agreement = 0.69; }, Status::kSearching, "69 % agree, 70 % are needed"},
      {[](PlaceMeasures* p) { p->maps = 1; }, Status::kSearching, "1 of 2 aerial maps"},
      {[](PlaceMeasures* p) { p->evidence = 14.9; }, Status::kSearching, "14.9 of 15.0"},
      {[](PlaceMeasures* p) { p->particles_agree = false; }, Status::kSearching, "not gathered"},
      {[](PlaceMeasures* p) { p->mode_weight = 0.69; }, Status::kSearching, "69 % of the particles"},
      {[](PlaceMeasures* p) { p->mode_spread *= 1.01; }, Status::kSearching, "spread"},
      {[](PlaceMeasures* p) { p->mode_spread_yaw *= 1.01; }, Status::kSearching, "spread"},
  };
  for (const Case& c : cases) {
    PlaceMeasures place = justEnough();
    c.lack(&place);
    const Verdict verdict = judge(place, kSettings);
    EXPECT_EQ(verdict.status, c.status) << c.reason;
    EXPECT_NE(verdict.reason.find(c.reason), std::string::npos) << verdict.reason;
  }
}

// Where nothing is fixed nobody asks for rivals, and where there are some not for particles.
TEST(Verdict, TheWorstLackIsNamed) {
  PlaceMeasures place;
  EXPECT_EQ(judge(place, kSettings).status, Status::kDegenerate);
  place = justEnough();
  place.rival_ratio = 1;
  place.particles_agree = false;
  place.maps = 0;
  EXPECT_EQ(judge(place, kSettings).status, Status::kAmbiguous);
}

TEST(Verdict, ParticlesAreNotAskedWhereTwiceTheEvidenceSpeaks) {
  PlaceMeasures place = justEnough();
  place.particles_agree = false;
  place.mode_weight = 0;
  place.mode_spread = place.mode_spread_yaw = 10;
  place.evidence = 1.99 * kSettings.min_evidence;
  EXPECT_EQ(judge(place, kSettings).status, Status::kSearching);
  place.evidence = 2 * kSettings.min_evidence;
  EXPECT_EQ(judge(place, kSettings).status, Status::kConverged);
}

/// Not to be believed, but just enough for a guess.
PlaceMeasures justEnoughForAGuess() {
  PlaceMeasures place = justEnough();
  place.probe_ratio = place.rival_ratio = kSettings.guess_ratio;
  place.agreement = kSettings.guess_agreement;
  place.evidence = 0;
  return place;
}

TEST(Verdict, AGuessNeedsLessButNotNothing) {
  const Verdict guess = judge(justEnoughForAGuess(), kSettings);
  EXPECT_TRUE(guess.guess);
  EXPECT_NE(guess.status, Status::kConverged);
  EXPECT_NE(guess.reason.find("a guess"), std::string::npos);
  const std::vector<Change> lacks{
      [](PlaceMeasures* p) { p->relief *= 0.99; },        [](PlaceMeasures* p) { p->raised *= 0.99; },
      [](PlaceMeasures* p) { p->probe_ratio *= 0.99; },   [](PlaceMeasures* p) { p->rival_ratio *= 0.99; },
      [](PlaceMeasures* p) { p->agreement *= 0.99; },     [](PlaceMeasures* p) { p->maps = 1; },
      [](PlaceMeasures* p) { p->guess_evidence *= 0.99; }};
  for (std::size_t i = 0; i < lacks.size(); ++i) {
    PlaceMeasures place = justEnoughForAGuess();
    lacks[i](&place);
    EXPECT_FALSE(judge(place, kSettings).guess) << i;
  }
}

TEST(Verdict, AMapSpeaksForAPlaceThatIsToldApart) {
  EXPECT_TRUE(speaksFor(justEnough(), kSettings));
  EXPECT_TRUE(speaksForGuess(justEnough(), kSettings));
  EXPECT_FALSE(speaksFor(justEnoughForAGuess(), kSettings));
  EXPECT_TRUE(speaksForGuess(justEnoughForAGuess(), kSettings));
  const std::vector<Change> lacks{
      [](PlaceMeasures* p) { p->relief *= 0.99; }, [](PlaceMeasures* p) { p->raised *= 0.99; },
      [](PlaceMeasures* p) { p->probe_ratio *= 0.99; }, [](PlaceMeasures* p) { p->rival_ratio *= 0.99; },
      [](PlaceMeasures* p) { p->agreement *= 0.99; }};
  for (std::size_t i = 0; i < lacks.size(); ++i) {
    PlaceMeasures place = justEnough();
    lacks[i](&place);
    EXPECT_FALSE(speaksFor(place, kSettings)) << i;
    PlaceMeasures guess = justEnoughForAGuess();
    lacks[i](&guess);
    EXPECT_FALSE(speaksForGuess(guess, kSettings)) << i;
  }
}

}  // namespace
}  // namespace heightmap_mcl
