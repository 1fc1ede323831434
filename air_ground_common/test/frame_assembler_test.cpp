// What waits for what, and for how long, before an image is worked on.
#include "air_ground_common/frame_assembler.h"

#include <gtest/gtest.h>

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

}  // namespace
}  // namespace air_ground_common
