#include "../src/ros/refine_pace.h"

#include <gtest/gtest.h>

namespace icp_refine {
namespace {

using namespace std::chrono_literals;

TEST(RefinePace, ACloudWaitsForOtherCloudsAlone) {
  RefinePace pace(500ms);
  const auto t = RefinePace::Clock::now();
  const auto at = [&](std::chrono::milliseconds ms) { return t + ms; };
  EXPECT_FALSE(pace.pending());
  pace.add(true, false);  // a correction
  EXPECT_TRUE(pace.pending());
  EXPECT_LE(pace.due(), t) << "the first one at once";
  pace.refined(at(0ms));
  EXPECT_FALSE(pace.pending());
  pace.add(true, false);
  EXPECT_EQ(pace.due(), at(500ms));
  pace.add(true, true);
  EXPECT_LE(pace.due(), at(100ms)) << "a cloud comes to it";
  pace.refined(at(200ms));
  pace.add(true, true);
  EXPECT_EQ(pace.due(), at(700ms)) << "clouds bound the load, too";
  pace.add(true, false);
  EXPECT_EQ(pace.due(), at(700ms));
  pace.refined(at(700ms));
  pace.add(false, false);
  EXPECT_FALSE(pace.pending());
  pace.add(true, false);
  pace.drop();
  EXPECT_FALSE(pace.pending());
}

}  // namespace
}  // namespace icp_refine
