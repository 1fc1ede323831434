// What waits for what, and for how long, before an image is worked on.
#include "air_ground_common/frame_assembler.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>
#include <vector>

#include "air_ground_common/frame_pairer.h"

namespace air_ground_common {
namespace {

struct Sample {
  double stamp;
};
using Assembler = FrameAssembler<int, Sample>;

TEST(FrameAssembler, AnImageWaitsForTheImuUpToItsStamp) {
  Assembler assembler({});
  EXPECT_FALSE(assembler.ready(0));
  assembler.addImage(1.00, 1, 0);
  for (const double t : {0.97, 0.98, 0.99}) assembler.addImu({t});
  EXPECT_FALSE(assembler.ready(100)) << "the IMU may only be late";
  for (const double t : {1.005, 1.01, 1.02}) assembler.addImu({t});
  ASSERT_TRUE(assembler.ready(0));
  const auto frame = assembler.pop();
  EXPECT_EQ(frame.image, 1);
  ASSERT_EQ(frame.imu.size(), 4u);
  EXPECT_DOUBLE_EQ(frame.imu.back().stamp, 1.005) << "one beyond the image";
  assembler.addImage(1.05, 2, 0);
  EXPECT_FALSE(assembler.ready(0));
  assembler.addImu({1.05});
  ASSERT_TRUE(assembler.ready(0));
  EXPECT_DOUBLE_EQ(assembler.pop().imu.front().stamp, 1.01) << "goes on where the last frame ended";
}

// The IMU's clock runs 20 ms ahead: what belongs to an image has later stamps.
TEST(FrameAssembler, AnImageWaitsForTheImuUpToTheLead) {
  Assembler assembler({});
  assembler.setImuLead(0.02);
  assembler.addImage(1.00, 1, 0);
  for (const double t : {1.00, 1.01}) assembler.addImu({t});
  EXPECT_FALSE(assembler.ready(0));
  for (const double t : {1.025, 1.03}) assembler.addImu({t});
  ASSERT_TRUE(assembler.ready(0));
  const auto frame = assembler.pop();
  ASSERT_EQ(frame.imu.size(), 3u);
  EXPECT_DOUBLE_EQ(frame.imu.back().stamp, 1.025);
}

TEST(FrameAssembler, WithoutImuItGoesOnWhenNewerImagesHaveSettled) {
  FrameAssemblerSettings settings;
  settings.imu_wait = 0.5;
  settings.settle = 0.3;
  Assembler assembler(settings);
  assembler.addImage(1.0, 1, 10.0);
  assembler.addImage(1.5, 2, 10.5);
  EXPECT_FALSE(assembler.ready(20)) << "0.5 s newer is not yet more than 0.5 s";
  assembler.addImage(1.6, 3, 10.6);
  EXPECT_FALSE(assembler.hasImu()) << "nobody need be told that images wait for it";
  EXPECT_FALSE(assembler.ready(10.85)) << "the IMU's topic may only be behind the images'";
  ASSERT_TRUE(assembler.ready(10.91));
  EXPECT_EQ(assembler.pop().image, 1);
  EXPECT_FALSE(assembler.ready(20));
  settings.use_imu = false;
  Assembler alone(settings);
  alone.addImage(1.0, 1, 10.0);
  EXPECT_TRUE(alone.ready(10.0));
}

/// Images at 30 Hz from `begin` on: the longest that one waits [s].
double longestWait(Assembler* assembler, double begin, int images) {
  double longest = 0;
  for (int ms = 0; ms < 1000 * images / 30; ++ms) {
    const double now = begin + 0.001 * ms;
    if (ms % 33 == 0) assembler->addImage(now, 0, now);
    while (assembler->ready(now)) longest = std::max(longest, now - assembler->pop().stamp);
  }
  return longest;
}

TEST(FrameAssembler, ASilentImuHoldsUpAFewImagesOnly) {
  FrameAssemblerSettings settings;
  settings.max_latency = 2;  // live
  Assembler assembler(settings);
  EXPECT_NEAR(longestWait(&assembler, 10, 60), 0.83, 0.04) << "it may be late";
  EXPECT_EQ(longestWait(&assembler, 12, 60), 0) << "it never came";
  assembler.addImu({13.99});
  EXPECT_NEAR(longestWait(&assembler, 14, 60), 0.83, 0.04) << "it is there again: waited for";
  EXPECT_EQ(longestWait(&assembler, 16, 60), 0) << "it died";
  assembler.clear();
  EXPECT_NEAR(longestWait(&assembler, 10, 60), 0.83, 0.04) << "a jump of time";
  // A sample that comes late shows that they come.
  Assembler late(settings);
  for (int i = 0; i < 60; ++i) {
    late.addImu({1 + 0.03 * i});
    late.addImage(10 + 0.03 * i, i, 10 + 0.03 * i);
    while (late.ready(10 + 0.03 * i)) EXPECT_GT(0.03 * (i - late.pop().image), 0.7);
  }
  // In a replay topics may be out of step by more than some images.
  settings.max_latency = 0;
  Assembler replay(settings);
  longestWait(&replay, 10, 60);
  EXPECT_NEAR(longestWait(&replay, 12, 60), 0.83, 0.04);
}

TEST(FrameAssembler, OverloadedItCatchesUpWithoutHoles) {
  FrameAssemblerSettings settings;
  settings.use_imu = false;
  settings.max_latency = 1;
  Assembler assembler(settings);
  const double period = 0.033, work = 0.04;
  double lag = 0, done = 0;
  int added = 0, taken = 0, last = -1, hole = 0;
  std::size_t dropped = 0;
  for (int ms = 0; ms < 60000; ++ms) {
    const double now = 0.001 * ms;
    if (ms % 33 == 0) assembler.addImage(now, added++, now);
    dropped += assembler.dropLate();
    EXPECT_LE(assembler.lag(), 1 + 1e-9);
    if (now < done || !assembler.ready(now)) continue;
    if (now > 10) lag += work * assembler.lag() / 50;  // the mean of 50 s
    const int image = assembler.pop().image;
    hole = std::max(hole, image - last);
    last = image;
    done = now + work;
    ++taken;
  }
  EXPECT_LT(lag, 0.8);
  EXPECT_LE(hole * period, 0.14);
  EXPECT_EQ(taken + dropped + assembler.waiting(), static_cast<std::size_t>(added));
  EXPECT_GT(taken, 60 / work - 30) << "it works on, as fast as it can";
}

// What waits for a late IMU is not late by the node's fault: the IMU would never be waited for.
TEST(FrameAssembler, CatchingUpLeavesImagesThatAwaitTheImu) {
  FrameAssemblerSettings settings;
  settings.max_latency = 1;
  Assembler assembler(settings);
  for (int i = 0; i < 15; ++i) assembler.addImage(0.2 * i, i, 0);
  assembler.addImu({3});
  EXPECT_GT(assembler.dropLate(), 5u);
  for (; assembler.waiting() > 0; assembler.dropLate()) assembler.pop();
  int taken = 0;
  for (int i = 100; i < 200; ++i) {
    assembler.addImu({0.03 * (i - 200)});
    assembler.addImage(0.03 * i, i, 0.03 * i);
    EXPECT_EQ(assembler.dropLate(), 0u);
    for (; assembler.ready(0.03 * i); ++taken) assembler.pop();
  }
  EXPECT_GT(taken, 60);
}

TEST(FrameAssembler, DropsTheOldestWhenTooFarBehind) {
  FrameAssemblerSettings settings;
  settings.use_imu = false;
  settings.max_latency = 0.5;
  Assembler assembler(settings);
  for (int i = 0; i < 21; ++i) assembler.addImage(0.1 * i, i, 0);
  for (int i = 0; i < 200; ++i) assembler.addImu({0.01 * i});
  EXPECT_NEAR(assembler.lag(), 2.0, 1e-9);
  EXPECT_EQ(assembler.dropLate(), 15u);
  EXPECT_NEAR(assembler.lag(), 0.5, 1e-9);
  EXPECT_EQ(assembler.dropLate(), 0u);
  const auto frame = assembler.pop();
  EXPECT_EQ(frame.image, 15);
  EXPECT_DOUBLE_EQ(frame.imu.front().stamp, 0) << "no IMU sample is lost with an image";
  // A replay loses nothing.
  settings.max_latency = 0;
  Assembler replay(settings);
  for (int i = 0; i < 100; ++i) replay.addImage(i, i, 0);
  EXPECT_EQ(replay.dropLate(), 0u);
  EXPECT_EQ(replay.pop().image, 0);
}

TEST(FrameAssembler, IsBoundedAndForgets) {
  FrameAssemblerSettings settings;
  settings.images.count = 3;
  Assembler assembler(settings);
  for (int i = 0; i < 5; ++i) assembler.addImage(i, i, 0);
  EXPECT_EQ(assembler.waiting(), 3u);
  EXPECT_EQ(assembler.overflow().by_count, 2u);
  EXPECT_EQ(assembler.overflow().by_bytes, 0u);
  assembler.addImu({10});
  EXPECT_EQ(assembler.pop().image, 2);
  assembler.clear();
  EXPECT_EQ(assembler.waiting(), 0u);
  assembler.addImage(1, 1, 0);
  EXPECT_FALSE(assembler.ready(100)) << "samples from before a jump of time say nothing";
  EXPECT_EQ(assembler.lag(), 0);
}

TEST(FrameAssembler, LargeImagesAreBoundedByWhatTheyTake) {
  FrameAssemblerSettings settings;
  settings.use_imu = false;
  settings.images.bytes = 100;
  Assembler assembler(settings);
  for (int i = 0; i < 5; ++i) assembler.addImage(i, i, 0, 30);
  EXPECT_EQ(assembler.waiting(), 3u);
  EXPECT_EQ(assembler.waitingBytes(), 90u);
  EXPECT_EQ(assembler.overflow().by_bytes, 2u);
  EXPECT_EQ(assembler.overflow().by_count, 0u);
  EXPECT_EQ(assembler.pop().image, 2);
  assembler.addImage(5, 5, 0, 40);
  EXPECT_EQ(assembler.waiting(), 3u) << "100 bytes are no more than 100";
  assembler.addImage(6, 6, 0, 1000);
  EXPECT_EQ(assembler.waiting(), 1u) << "the newest stays, whatever its size";
  EXPECT_EQ(assembler.pop().image, 6);
  EXPECT_EQ(assembler.waitingBytes(), 0u);
  assembler.addImage(7, 7, 0, 30);
  assembler.clear();
  EXPECT_EQ(assembler.waitingBytes(), 0u);
}

TEST(FramePairer, BoundsEachStreamByWhatItTakes) {
  FramePairer<int> pairer(0.02, 1.0, 0.3, {100, 50});
  for (int i = 0; i < 4; ++i) pairer.addDepth(i, i, 0, 20);
  for (int i = 0; i < 4; ++i) pairer.addColour(i, i, 0, 25);
  EXPECT_EQ(pairer.overflow().by_bytes, 4u);
  EXPECT_EQ(pairer.overflow().by_count, 0u);
  ASSERT_TRUE(pairer.front(0));
  const auto pair = pairer.pop();
  EXPECT_EQ(pair.colour, 2);
  EXPECT_EQ(pair.depth, 2);
  EXPECT_EQ(pair.bytes, 45u);
}

TEST(FramePairer, PairsTheNearestAndDropsTheRest) {
  FramePairer<int> pairer(0.02, 1.0, 0.3, {100});
  pairer.addDepth(0.005, 0, 0);
  pairer.addColour(0.0, 0, 0);
  pairer.addColour(0.1, 1, 0);
  ASSERT_TRUE(pairer.front(0));
  EXPECT_EQ(pairer.pop().depth, 0);
  EXPECT_FALSE(pairer.front(0));  // waits for depth
  pairer.addDepth(0.085, 1, 0);
  pairer.addDepth(0.101, 2, 0);
  ASSERT_TRUE(pairer.front(0));
  EXPECT_EQ(pairer.pop().depth, 2);
  EXPECT_EQ(pairer.unmatchedDepth(), 1u);
  pairer.addColour(0.2, 2, 0);
  pairer.addDepth(0.29, 3, 0);
  EXPECT_FALSE(pairer.front(0));
  EXPECT_EQ(pairer.unmatchedColour(), 1u);
  ASSERT_TRUE(pairer.closestMiss());
  EXPECT_NEAR(*pairer.closestMiss(), 0.09, 1e-9);
  pairer.addColour(0.45, 3, 0);  // depth is behind
  EXPECT_FALSE(pairer.front(0));
  EXPECT_NEAR(*pairer.closestMiss(), -0.16, 1e-9);
  pairer.addDepth(0.5, 4, 0);
  EXPECT_FALSE(pairer.front(0));
  EXPECT_NEAR(*pairer.closestMiss(), 0.05, 1e-9) << "the nearer of both sides";
  pairer.clear();
  EXPECT_FALSE(pairer.closestMiss());
  // Without any depth, colour images give up after a while: not at once, as all depth images may come after all colour
  // images.
  FramePairer<int> alone(0.02, 1.0, 0.3, {100});
  for (int i = 0; i < 30; ++i) alone.addColour(0.1 * i, i, 50);
  EXPECT_FALSE(alone.front(50.2));
  EXPECT_EQ(alone.unmatchedColour(), 0u);
  EXPECT_FALSE(alone.overtaken(0.0, 0.5, 50.2));
  EXPECT_TRUE(alone.overtaken(0.0, 0.5, 50.4));
  EXPECT_FALSE(alone.overtaken(2.5, 0.5, 50.4));
  EXPECT_FALSE(alone.front(50.4));
  EXPECT_GT(alone.unmatchedColour(), 15u);
  EXPECT_FALSE(alone.closestMiss());
  alone.addColour(0.5, 99, 50.4);  // out of order
  EXPECT_EQ(alone.outOfOrder(), 1u);
  EXPECT_EQ(alone.overflow().by_count, 0u);
}

using Stamps = std::vector<double>;

/// `count` stamps of this rate [Hz] from `begin` on, but those of `lost`.
Stamps stampsOf(double rate, int count, double begin = 100, const std::vector<int>& lost = {}) {
  Stamps stamps;
  for (int i = 0; i < count; ++i)
    if (std::find(lost.begin(), lost.end(), i) == lost.end()) stamps.push_back(begin + i / rate);
  return stamps;
}

struct Paired {
  double colour, depth, late;  ///< late: after the later of both came [s]
};

/// What is paired when images come `colour_late` or `depth_late` after their stamps and the streams end.
std::vector<Paired> pairUp(FramePairer<double>* pairer, const Stamps& colour, const Stamps& depth,
                           double colour_late = 0, double depth_late = 0) {
  std::vector<std::pair<double, std::function<void(double)>>> events;
  for (const double stamp : colour)
    events.emplace_back(stamp + colour_late, [=](double now) { pairer->addColour(stamp, stamp, now); });
  for (const double stamp : depth)
    events.emplace_back(stamp + depth_late, [=](double now) { pairer->addDepth(stamp, stamp, now); });
  std::stable_sort(events.begin(), events.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  events.emplace_back(events.back().first + 1.01, [](double) {});  // patience
  std::vector<Paired> pairs;
  for (const auto& [now, event] : events) {
    event(now);
    while (pairer->front(now)) {
      const auto pair = pairer->pop();
      pairs.push_back({pair.colour, pair.depth, now - std::max(pair.colour + colour_late, pair.depth + depth_late)});
    }
  }
  return pairs;
}

/// Pairs of streams of these stamps, the same in whatever order they come: how many, all apart by `apart` (+-1e-6 s).
std::size_t countPairs(const Stamps& colour, const Stamps& depth, double apart, double tolerance = 0.02) {
  std::size_t count = 0;
  for (const double late : {0.0, 0.004, 0.1, 0.9}) {
    for (const bool colour_late : {false, true}) {
      FramePairer<double> pairer(tolerance, 1.0, 0.3, {1000});
      const auto pairs = pairUp(&pairer, colour, depth, colour_late ? late : 0, colour_late ? 0 : late);
      for (const Paired& pair : pairs) EXPECT_NEAR(pair.depth - pair.colour, apart, 1e-6) << pair.colour - colour[0];
      if (late == 0 && !colour_late) count = pairs.size();
      EXPECT_EQ(pairs.size(), count) << late << colour_late;
      EXPECT_EQ(pairs.size() + pairer.unmatchedColour() + pairer.waiting(), colour.size());
    }
  }
  return count;
}

TEST(FramePairer, ALostImageShiftsNoOther) {
  const Stamps all = stampsOf(60, 60), lossy = stampsOf(60, 60, 100, {20});
  EXPECT_EQ(countPairs(all, lossy, 0), 59u);
  EXPECT_EQ(countPairs(lossy, all, 0), 59u);
  const Stamps slow = stampsOf(30, 60), slow_lossy = stampsOf(30, 60, 100, {20, 21, 40});
  EXPECT_EQ(countPairs(slow, slow_lossy, 0, 0.04), 57u);
  EXPECT_EQ(countPairs(slow_lossy, slow, 0, 0.04), 57u);
  EXPECT_EQ(countPairs(slow, stampsOf(30, 60, 100.01, {20}), 0.01, 0.04), 59u) << "apart by a third of the period";
}

TEST(FramePairer, OfAFasterStreamTheNearestIsTaken) {
  EXPECT_EQ(countPairs(stampsOf(60, 60), stampsOf(30, 30), 0), 30u);
  EXPECT_EQ(countPairs(stampsOf(30, 30), stampsOf(60, 60), 0), 30u);
  EXPECT_EQ(countPairs(stampsOf(60, 60), stampsOf(30, 30, 100.005), 0.005), 30u);
}

TEST(FramePairer, AConstantOffsetCostsLessThanAFrame) {
  for (const double offset : {0.015, -0.015, 0.003, -0.003}) {
    EXPECT_EQ(countPairs(stampsOf(30, 30), stampsOf(30, 30, 100 + offset), offset), 30u);
    FramePairer<double> pairer(0.02, 1.0, 0.3, {1000});
    auto pairs = pairUp(&pairer, stampsOf(30, 30), stampsOf(30, 30, 100 + offset));
    ASSERT_EQ(pairs.size(), 30u);
    pairs.pop_back();  // nothing came after it
    for (const Paired& pair : pairs) EXPECT_LT(pair.late, std::abs(offset) < 0.004 ? 1e-6 : 0.02) << offset;
  }
}

// Near half a period the next image is nearer as jitter has it: to change partners would lose one each time.
TEST(FramePairer, JitterChangesNoPartners) {
  Stamps depth = stampsOf(30, 60, 100.016);
  for (std::size_t i = 0; i < depth.size(); ++i) depth[i] += i % 3 == 0 ? 0.0015 : -0.0005;
  FramePairer<double> pairer(0.02, 1.0, 0.3, {1000});
  EXPECT_EQ(pairUp(&pairer, stampsOf(30, 60), depth).size(), 60u);
}

TEST(FramePairer, TheEndOfAStreamLeavesNoPairBehind) {
  for (const double offset : {0.015, -0.015}) {
    FramePairer<int> pairer(0.02, 1.0, 0.3, {100});
    pairer.addColour(1, 1, 50);
    pairer.addDepth(1 + offset, 1, 50.1);
    EXPECT_FALSE(pairer.front(51.05)) << "a nearer one may come";
    EXPECT_EQ(pairer.waiting(), 0u) << "it has its depth image: nobody need be told that it lacks one";
    ASSERT_TRUE(pairer.front(51.15));
    EXPECT_EQ(pairer.pop().depth, 1);
    // The other stream goes on.
    pairer.addColour(2, 2, 51);
    pairer.addDepth(2 + offset, 2, 51);
    for (int i = 0; i < 20; ++i) {
      const double stamp = 2.1 + 0.1 * i;
      offset > 0 ? pairer.addDepth(stamp, 3, 51) : pairer.addColour(stamp, 3, 51);
    }
    ASSERT_TRUE(pairer.front(52.05));
    EXPECT_EQ(pairer.pop().colour, 2);
  }
}

}  // namespace
}  // namespace air_ground_common
