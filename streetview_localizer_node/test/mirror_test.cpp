// Images and views that were flipped left to right.
#include "../src/mirror_check.h"

#include <gtest/gtest.h>

#include <memory>
#include <opencv2/imgproc.hpp>

#include "streetview_localizer/localizer.h"
#include "tiny_city.h"

namespace streetview_localizer {
namespace {

using test::TinyCity;

class MirrorTest : public ::testing::Test {
 protected:
  static cv::Mat flipped(const cv::Mat& image) {
    cv::Mat mirrored;
    cv::flip(image, mirrored, 1);
    return mirrored;
  }
  static void flip(View& view, const BackProjector& projector) {
    view.image = flipped(view.image);
    view.features = extractFeatures(view.image);
    projector.apply(&view);
  }
  LocalizerResult locate(const Pose& T) const {
    return StreetviewLocalizer(database_).localize(city_.photograph(camera_, T), camera_);
  }

  const TinyCity city_{1};
  const std::shared_ptr<StreetviewDatabase> database_ = city_.database();
  const CameraModel camera_ = TinyCity::camera();
  const Pose T_ = TinyCity::look({-4, 1, 4}, M_PI / 2, 0.05);
  const cv::Mat image_ = city_.photograph(camera_, T_);
};

// The check alone, whatever else refuses: features of the image and of its mirror image, each as the query's own.
TEST_F(MirrorTest, TheCheckTellsAnImageFromItsMirrorImage) {
  const StreetviewLocalizerSettings settings;
  const ViewSearch search(*database_, settings);
  const int view = locate(T_).view;
  ASSERT_GE(view, 0);
  MirrorCheck recorded(extractFeatures(image_), search, *database_, settings),
      mirrored(extractFeatures(flipped(image_)), search, *database_, settings);
  EXPECT_EQ(recorded.objection(view, true), "");
  EXPECT_EQ(recorded.objection(view, false), "");
  EXPECT_NE(mirrored.objection(view, true), "");
  // Another view, which shows neither: the one that shows the mirror image is found in the whole database only.
  const LocalizerResult elsewhere = locate(TinyCity::look({3, -1, 6}, -M_PI / 2 + 0.2, -0.15, 0.05));
  ASSERT_TRUE(elsewhere.accepted() && elsewhere.view != view) << elsewhere.reason;
  EXPECT_NE(mirrored.objection(elsewhere.view, false), "");
}

TEST_F(MirrorTest, AMirroredPanoramaMatchesNothing) {
  auto db = std::make_shared<StreetviewDatabase>(*database_);
  const BackProjector projector(db->model);
  for (View& view : db->views) flip(view, projector);
  EXPECT_FALSE(StreetviewLocalizer(db).localize(image_, camera_).accepted());
}

// A facade that stands mirrored across the street, and is seen better there: an image of it is refused, unless
// something else tells that it is as recorded.
TEST_F(MirrorTest, AGyroTellsWhatAMirroredFacadeLeavesOpen) {
  auto db = std::make_shared<StreetviewDatabase>(*database_);
  const int seen = locate(T_).view;
  ASSERT_GE(seen, 0);
  View across = db->views[static_cast<std::size_t>(seen)];
  flip(across, BackProjector(db->model));
  // Of those that showed it as it is, every other feature is gone.
  for (View& view : db->views) {
    View thin = view;
    thin.features = Features();
    thin.points.clear();
    thin.normals.clear();
    for (std::size_t i = 0; i < view.points.size(); i += 2) {
      thin.features.keypoints.push_back(view.features.keypoints[i]);
      thin.features.descriptors.push_back(view.features.descriptors.row(static_cast<int>(i)));
      thin.points.push_back(view.points[i]);
      thin.normals.push_back(view.normals[i]);
    }
    view = thin;
  }
  across.id = static_cast<int>(db->views.size());
  db->views.push_back(across);
  const StreetviewLocalizer localizer(db);
  const LocalizerResult open = localizer.localize(image_, camera_);
  EXPECT_FALSE(open.accepted());
  EXPECT_EQ(open.reason.find("mirrored, the image has "), 0u) << open.reason;
  PosePrior prior;
  prior.not_mirrored = true;
  const LocalizerResult known = localizer.localize(image_, camera_, prior);
  EXPECT_TRUE(known.accepted()) << known.reason;
  EXPECT_LT((known.pose.T_world_camera.translation() - T_.translation()).norm(), 0.2);
}

}  // namespace
}  // namespace streetview_localizer
