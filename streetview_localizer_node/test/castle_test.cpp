// Real photographs of a real courtyard: every second one is the database, the others are located. The queries' own
// poses are read by the test alone.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>

#include <opencv2/core.hpp>

#include "air_ground_common/statistics.h"
#include "castle.h"
#include "streetview_localizer/localizer.h"

namespace streetview_localizer {
namespace {

using air_ground_common::median;
using test::castleAvailable;

class CastleTest : public ::testing::TestWithParam<int> {};

TEST_P(CastleTest, LocatesTheOtherHalf) {
  if (!castleAvailable())
    GTEST_SKIP() << "no photographs at " << test::strechaFolder()
                 << " (AIR_GROUND_SHARED names the folder above data/)";
  const test::Castle castle = test::makeCastle(GetParam());
  const StreetviewLocalizer localizer(castle.database);
  std::vector<double> errors, turns;
  int queries = 0;
  for (std::size_t i = static_cast<std::size_t>(1 - GetParam()); i < castle.photos.size(); i += 2) {
    const cv::Mat image = castle.image(i);
    const LocalizerResult result = localizer.localize(image, test::cameraOf(castle.photos[i], image));
    ++queries;
    const auto T = test::truth(castle, i);
    const double error = (result.pose.T_world_camera.translation() - T.translation()).norm();
    const double turn = air_ground_common::rotationAngle(result.pose.T_world_camera.linear(), T.linear()) * 180 / M_PI;
    const auto& e = result.acceptance.evidence;
    std::printf("%s %-8s error %7.3f m %6.2f deg; %4d features %4d matches %4zu inliers; %.2f s (",
                castle.photos[i].image.c_str(), nameOf(result.status), error, turn, result.features, result.matches,
                result.pose.inliers.size(), result.total_time);
    for (const double t : result.times) std::printf(" %.2f", t);
    std::printf(") score %.3f share %.2f rival %.2f range %.1f rms %.2f margin %.1f sd %.3f m; %s\n",
                result.acceptance.score, e.inlier_share, e.competitor_share, e.range, e.rms, e.alternative_margin,
                e.position_stddev, result.reason.c_str());
    if (!result.accepted()) continue;
    errors.push_back(error);
    turns.push_back(turn);
    EXPECT_LT(error, 1) << castle.photos[i].image;
    EXPECT_LT(turn, 3) << castle.photos[i].image;
  }
  EXPECT_GE(static_cast<double>(errors.size()), 0.9 * queries);
  ASSERT_FALSE(errors.empty());
  std::printf("half %d: %zu of %d located; median %.3f m, %.3f deg; largest %.3f m\n", GetParam(), errors.size(),
              queries, median(errors), median(turns), *std::max_element(errors.begin(), errors.end()));
  EXPECT_LT(median(errors), 0.05);
  EXPECT_LT(median(turns), 0.1);
}

// Photographs of other places, mirrored ones and such without content: no accepted match in any.
TEST(CastleRefusals, NothingIsFoundWhereNothingIs) {
  if (!castleAvailable()) GTEST_SKIP() << "no photographs at " << test::strechaFolder();
  const test::Castle castle = test::makeCastle(0);
  const StreetviewLocalizer localizer(castle.database);
  const auto refuse = [&](const std::string& name, const cv::Mat& image) {
    ASSERT_FALSE(image.empty()) << name;
    const LocalizerResult r = localizer.localize(image, test::cameraOf(castle.photos[0], image));
    std::printf("%-28s %-8s score %.3f, %3zu inliers: %s\n", name.c_str(), nameOf(r.status), r.acceptance.score,
                r.pose.inliers.size(), r.reason.c_str());
    EXPECT_FALSE(r.accepted()) << name;
    EXPECT_FALSE(r.reason.empty()) << name;
  };
  // fountain-P11 is no other place: the fountain stands at a wall of this courtyard.
  for (const char* other :
       {"Herz-Jesus-P25/images/0003.jpg", "Herz-Jesus-P25/images/0012.jpg", "Herz-Jesus-P25/images/0021.jpg"})
    refuse(other, cv::imread(test::strechaFolder() + "/" + other));
  for (const std::size_t i : {1u, 9u, 13u, 15u, 21u}) {  // 13: two facades that mirror each other
    cv::Mat mirrored;
    cv::flip(castle.image(i), mirrored, 1);
    refuse("mirrored " + castle.photos[i].image, mirrored);
  }
  refuse("black", cv::Mat::zeros(640, 960, CV_8UC3));
  refuse("blank wall", cv::Mat(640, 960, CV_8UC3, cv::Scalar(170, 180, 190)));
}

INSTANTIATE_TEST_SUITE_P(Halves, CastleTest, ::testing::Values(0, 1));

}  // namespace
}  // namespace streetview_localizer
