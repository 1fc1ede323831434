#include "streetview_localizer/back_projection.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

namespace streetview_localizer {
namespace {

using air_ground_common::CameraModel;

void addQuad(CityModel* m, const std::array<Eigen::Vector3f, 4>& q, Surface surface, int building) {
  const int first = static_cast<int>(m->mesh.vertices.size());
  m->mesh.vertices.insert(m->mesh.vertices.end(), q.begin(), q.end());
  for (const auto& t : {Eigen::Vector3i(0, 1, 2), Eigen::Vector3i(0, 2, 3)}) {
    m->mesh.triangles.push_back(t + Eigen::Vector3i::Constant(first));
    m->surface.push_back(surface);
    m->building.push_back(building);
  }
}

// A facade in the plane y = 12 + 0.1 x (building 0), 10 m high from z = 0; one set back by 3 m right of x = 8 (building
// 1); ground at z = 0. Far from the origin, as cities are.
const Eigen::Vector3f kOffset(800, -600, 40);
CityModel street() {
  CityModel m;
  m.building_ids = {"a", "b"};
  const auto wall = [](float x, float back, float z) {
    return Eigen::Vector3f(Eigen::Vector3f(x, 12 + 0.1f * x + back, z) + kOffset);
  };
  addQuad(&m, {wall(-40, 0, 0), wall(8, 0, 0), wall(8, 0, 10), wall(-40, 0, 10)}, Surface::kWall, 0);
  addQuad(&m, {wall(8, 3, 0), wall(60, 3, 0), wall(60, 3, 10), wall(8, 3, 10)}, Surface::kWall, 1);
  addQuad(&m,
          {Eigen::Vector3f(-100, -100, 0) + kOffset, Eigen::Vector3f(100, -100, 0) + kOffset,
           Eigen::Vector3f(100, 100, 0) + kOffset, Eigen::Vector3f(-100, 100, 0) + kOffset},
          Surface::kGround, -1);
  return m;
}

// Looks north (towards y), 2.5 m above the ground, slightly turned.
View viewOf(double yaw, double pitch) {
  View view;
  view.camera.width = 640;
  view.camera.height = 480;
  view.camera.fx = view.camera.fy = 400;
  view.camera.cx = 319.5;
  view.camera.cy = 239.5;
  view.camera.k1 = -0.05;
  view.T_world_camera.translation() = Eigen::Vector3d(1.5, -2, 2.5) + kOffset.cast<double>();
  view.T_world_camera.linear() = (Eigen::AngleAxisd(M_PI / 2 + yaw, Eigen::Vector3d::UnitZ()) *
                                  Eigen::AngleAxisd(-pitch, Eigen::Vector3d::UnitY()))
                                     .toRotationMatrix() *
                                 air_ground_common::opticalFromForwardBody().transpose();
  return view;
}

void addFeature(View* view, const Eigen::Vector2d& pixel) {
  view->features.keypoints.emplace_back(static_cast<float>(pixel.x()), static_cast<float>(pixel.y()), 5.f);
  view->features.descriptors.push_back(cv::Mat(1, 128, CV_8U, cv::Scalar(double(view->features.size() % 251))));
}

TEST(BackProjection, PointsLieOnTheAnalyticPlaneAndOnTheRay) {
  const CityModel model = street();
  const BackProjector projector(model);
  std::mt19937 rng(5);
  std::uniform_real_distribution<double> u(0, 1);
  const Eigen::Vector3d n = Eigen::Vector3d(0.1, -1, 0).normalized();  // towards the street
  int kept = 0;
  for (const double yaw : {-0.6, 0.0, 0.7}) {
    View view = viewOf(yaw, 0.1);
    for (int i = 0; i < 500; ++i) addFeature(&view, {639 * u(rng), 479 * u(rng)});
    const std::vector<cv::KeyPoint> before = view.features.keypoints;
    const BackProjectionCounts counts = projector.apply(&view);
    EXPECT_EQ(counts.kept + counts.sky + counts.ground + counts.range + counts.grazing + counts.edge, 500);
    EXPECT_GT(counts.sky, 0);
    EXPECT_GT(counts.ground, 0);
    ASSERT_EQ(view.points.size(), view.features.size());
    ASSERT_EQ(view.normals.size(), view.features.size());
    ASSERT_EQ(view.features.descriptors.rows, static_cast<int>(view.features.size()));
    for (std::size_t i = 0; i < view.features.size(); ++i) {
      const Eigen::Vector3d p = view.points[i].cast<double>() - kOffset.cast<double>();
      const double back = p.x() > 8 ? 3 : 0;
      EXPECT_LT(std::abs(n.dot(p - Eigen::Vector3d(0, 12 + back, 0))), 1e-4) << p.transpose();
      EXPECT_LT((view.normals[i].cast<double>() - n).norm(), 1e-4);
      const auto pixel = view.camera.project(view.T_world_camera.inverse() * view.points[i].cast<double>());
      ASSERT_TRUE(pixel);
      EXPECT_LT((*pixel - Eigen::Vector2d(view.features.keypoints[i].pt.x, view.features.keypoints[i].pt.y)).norm(),
                5e-3);
      // The descriptor is still that of its keypoint.
      const auto it = std::find_if(before.begin(), before.end(),
                                   [&](const cv::KeyPoint& k) { return k.pt == view.features.keypoints[i].pt; });
      EXPECT_EQ(view.features.descriptors.at<std::uint8_t>(static_cast<int>(i), 0), (it - before.begin() + 1) % 251);
    }
    kept += counts.kept;
  }
  EXPECT_GT(kept, 400);
}

TEST(BackProjection, DropsEdgesGrazingRaysAndTheFar) {
  const CityModel model = street();
  const BackProjector projector(model);
  const auto pixelOf = [](const View& view, const Eigen::Vector3d& p) {
    return *view.camera.project(view.T_world_camera.inverse() * (p + kOffset.cast<double>()));
  };
  const auto counts = [&](double yaw, const Eigen::Vector3d& point, const Eigen::Vector2d& shift) {
    View view = viewOf(yaw, 0);
    addFeature(&view, pixelOf(view, point) + shift);
    return projector.apply(&view);
  };
  const Eigen::Vector3d step(8, 12.8, 3), eave(2, 12.2, 10), foot(2, 12.2, 0);
  EXPECT_EQ(counts(-0.4, step, {-1.5, 0}).edge, 1);  // 1.5 px beside the step of 3 m
  EXPECT_EQ(counts(-0.4, step, {1.5, 0}).edge, 1);
  EXPECT_EQ(counts(-0.4, step, {-6, 0}).kept, 1);
  EXPECT_EQ(counts(0, eave, {0, 1.5}).edge, 1);
  EXPECT_EQ(counts(0, eave, {0, 6}).kept, 1);
  EXPECT_EQ(counts(0, foot, {0, -1.5}).kept, 1);  // where wall and ground meet, depth is continuous
  EXPECT_EQ(counts(1.2, {-39, 8.1, 3}, {0, 0}).kept, 1);
  BackProjectionSettings narrow;
  narrow.max_incidence = 1.0;  // 57 degrees
  narrow.max_depth = 30;
  const BackProjector strict(model, narrow);
  View view = viewOf(1.2, 0);
  addFeature(&view, pixelOf(view, {-35, 8.5, 3}));     // 38 m
  addFeature(&view, pixelOf(view, {-27, 9.3, 3}));     // 31 m along the ray
  addFeature(&view, pixelOf(view, {-25.5, 9.45, 3}));  // 29 m, 61 degrees from the normal
  addFeature(&view, pixelOf(view, {-20, 10, 3}));      // 55 degrees
  const BackProjectionCounts c = strict.apply(&view);
  EXPECT_EQ(c.range, 2);
  EXPECT_EQ(c.grazing, 1);
  EXPECT_EQ(c.kept, 1);
}

TEST(BackProjection, RenderAgreesWithSingleRaysAndWithThePlane) {
  const CityModel model = street();
  const BackProjector projector(model);
  View view = viewOf(-0.3, 0.05);
  view.camera = view.camera.scaled(0.2);
  const ModelImage image = projector.render(view.camera, view.T_world_camera);
  ASSERT_EQ(image.depth.size(), cv::Size(view.camera.width, view.camera.height));
  int hits = 0;
  for (int y = 0; y < image.depth.rows; ++y)
    for (int x = 0; x < image.depth.cols; ++x) {
      const auto s = projector.cast(view.T_world_camera.translation(),
                                    view.T_world_camera.linear() * view.camera.ray({double(x), double(y)}));
      ASSERT_EQ(s.has_value(), image.triangle.at<int>(y, x) >= 0);
      if (!s) continue;
      ++hits;
      EXPECT_NEAR((view.T_world_camera.inverse() * s->point).z(), image.depth.at<float>(y, x), 1e-3 * s->distance);
    }
  EXPECT_GT(hits, 1000);
}

TEST(BackProjection, RefusesAnEmptyModel) {
  const CityModel model;
  EXPECT_THROW(BackProjector{model}, std::invalid_argument);
}

}  // namespace
}  // namespace streetview_localizer
