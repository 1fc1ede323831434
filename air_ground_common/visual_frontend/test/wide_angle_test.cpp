// Statistics of pose, point and direction with pixel noise in a fisheye image: what is stretched on the normalised
// plane must be weighted so.
#include <gtest/gtest.h>

#include <Eigen/LU>

#include "synthetic.h"
#include "visual_frontend/bundle_adjustment.h"
#include "visual_frontend/calibration_alignment.h"
#include "visual_frontend/feature_tracker.h"
#include "visual_frontend/pose_solver.h"
#include "visual_frontend/triangulation.h"

namespace visual_frontend {
namespace {

using synthetic::Random;
constexpr double kPixelSigma = 0.6;

CameraModel fisheye() {
  CameraModel c;
  c.width = 752;
  c.height = 480;
  c.fx = c.fy = 287;
  c.cx = 375.5;
  c.cy = 239.5;
  c.setDistortion("equidistant", {-0.012, 0.023, -0.019, 0.005});
  return c;
}

/// Point up to 75 degrees off the axis, uniform over the image circle, 1 to 6 m away; in the camera.
Eigen::Vector3d wideRay(Random& random) {
  const double theta = 75 * M_PI / 180 * std::sqrt(random.uniform(0.01, 1)), phi = random.uniform(-M_PI, M_PI);
  return random.uniform(1, 6) *
         Eigen::Vector3d(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta));
}

Eigen::Vector2d measure(const CameraModel& camera, const Eigen::Vector3d& p_camera, Random& random) {
  return camera.unproject(*camera.project(p_camera) +
                          Eigen::Vector2d(random.gauss(kPixelSigma), random.gauss(kPixelSigma)));
}

PoseCorrespondence correspondence(const CameraModel& camera, const Pose& T, Random& random) {
  const Eigen::Vector3d p = wideRay(random);
  PoseCorrespondence c;
  c.p_map = T * p;
  c.normalized = measure(camera, p, random);
  const NormalizedNoise noise = camera.normalizedNoise(c.normalized, kPixelSigma);
  c.sigma = noise.sigma;
  c.elongation = noise.elongation;
  return c;
}

TEST(WideAngle, ResidualsInSigmasAreThoseOfThePixels) {
  Random random(1);
  const CameraModel camera = fisheye();
  double sum = 0;
  int within = 0;
  constexpr int kTrials = 4000;
  for (int i = 0; i < kTrials; ++i) {
    const Eigen::Vector3d p = wideRay(random);
    const Eigen::Vector2d n = measure(camera, p, random);
    const NormalizedNoise noise = camera.normalizedNoise(n, kPixelSigma);
    const Eigen::Vector2d difference = p.hnormalized() - n;
    const double squared = squaredSigmas(difference, n, noise);
    EXPECT_NEAR(squared, (whitening(n, noise) * difference).squaredNorm(), 1e-9 * (1 + squared));
    sum += squared;
    within += squared < 2.8 * 2.8;
  }
  EXPECT_NEAR(sum / kTrials, 2, 0.15);                                          // two degrees of freedom
  EXPECT_NEAR(double(within) / kTrials, 1 - std::exp(-0.5 * 2.8 * 2.8), 0.01);  // Rayleigh
}

TEST(WideAngle, PoseAndItsCovarianceAreConsistent) {
  Random random(2);
  const CameraModel camera = fisheye();
  double nees = 0, inliers = 0, found = 0;
  constexpr int kTrials = 200, kPoints = 100;
  for (int i = 0; i < kTrials; ++i) {
    const Pose T = synthetic::randomPose(random);
    std::vector<PoseCorrespondence> c;
    for (int k = 0; k < kPoints; ++k) c.push_back(correspondence(camera, T, random));
    const PoseResult start = ransacPose(c, RansacSettings());
    ASSERT_TRUE(start.success) << start.reason;
    found += start.inlier_count;
    const PoseResult r = refinePose(c, start.T_map_camera, RefineSettings());
    ASSERT_TRUE(r.success) << r.reason;
    inliers += r.inlier_count;
    Vector6d e;
    e.head<3>() = r.T_map_camera.translation() - T.translation();
    e.tail<3>() = air_ground_common::logSO3(r.T_map_camera.linear() * T.linear().transpose());
    nees += e.dot(r.covariance.inverse() * e);
  }
  EXPECT_NEAR(nees / kTrials, 6, 0.9);
  EXPECT_GT(inliers / (kTrials * kPoints), 0.96);  // 98 % within 2.8 sigmas
  EXPECT_GT(found / (kTrials * kPoints), 0.7);     // of a minimal sample's pose
}

TEST(WideAngle, PointAndItsCovarianceAreConsistent) {
  Random random(3);
  const CameraModel camera = fisheye();
  double nees = 0;
  int ok = 0;
  constexpr int kTrials = 500;
  for (int i = 0; i < kTrials; ++i) {
    const Eigen::Vector3d p = wideRay(random);
    std::vector<ViewRay> views;
    for (int k = 0; k < 4; ++k) {
      ViewRay v;
      v.T_map_camera.translation() = Eigen::Vector3d(0.1 * k, 0.03 * random.uniform(-1, 1), 0);
      const Eigen::Vector3d q = v.T_map_camera.inverse() * p;
      if (std::atan2(q.head<2>().norm(), q.z()) > 78 * M_PI / 180) continue;
      v.normalized = measure(camera, q, random);
      const NormalizedNoise noise = camera.normalizedNoise(v.normalized, kPixelSigma);
      v.sigma = noise.sigma;
      v.elongation = noise.elongation;
      views.push_back(v);
    }
    TriangulationSettings settings;
    settings.max_residual = 6;
    const auto r = triangulate(views, settings);
    if (!r.ok()) continue;
    ++ok;
    const Eigen::Vector3d e = r.p_map - p;
    nees += e.dot(r.covariance.inverse() * e);
  }
  EXPECT_GT(ok, 0.9 * kTrials);
  EXPECT_NEAR(nees / ok, 3, 0.45);
}

TEST(WideAngle, DirectionOfMotionFromTheWholeView) {
  Random random(4);
  const CameraModel camera = fisheye();
  double inliers = 0, angle = 0;
  constexpr int kTrials = 20, kPoints = 150;
  for (int i = 0; i < kTrials; ++i) {
    Pose T_a_b = Pose::Identity();
    T_a_b.translation() = Eigen::Vector3d(random.uniform(-1, 1), random.uniform(-1, 1), 0.3).normalized() * 0.3;
    T_a_b.linear() = air_ground_common::expSO3(random.vector(0.05));
    std::vector<Eigen::Vector2d> a, b;
    std::vector<NormalizedNoise> noise_a, noise_b;
    while (a.size() < kPoints) {
      const Eigen::Vector3d p = wideRay(random), q = T_a_b.inverse() * p;
      if (std::atan2(q.head<2>().norm(), q.z()) > 78 * M_PI / 180) continue;
      a.push_back(measure(camera, p, random));
      b.push_back(measure(camera, q, random));
      noise_a.push_back(camera.normalizedNoise(a.back(), kPixelSigma));
      noise_b.push_back(camera.normalizedNoise(b.back(), kPixelSigma));
    }
    const double sigma = kPixelSigma / camera.fx;
    const auto r = translationFromKnownRotation(a, b, T_a_b.linear(), sigma, RansacSettings(), noise_a, noise_b);
    ASSERT_TRUE(r.success) << r.reason;
    inliers += r.inlier_count;
    angle += std::acos(std::min(1.0, r.t_a_b.dot(T_a_b.translation().normalized()))) / kTrials;
  }
  EXPECT_GT(inliers / (kTrials * kPoints), 0.97);  // 98.8 % within 2.5 sigmas of one coordinate
  EXPECT_LT(angle, 0.005);
}

TEST(WideAngle, NoFeatureOnTheRimOfTheImageCircle) {
  // A bright circle on black, as lenses leave it: its rim is all corners.
  CameraModel camera = fisheye();
  camera.fx = camera.fy = 140;  // the whole cone within the image
  cv::Mat image(camera.height, camera.width, CV_8UC1, cv::Scalar(0));
  const cv::Mat texture = synthetic::texture(800, 3);
  for (int v = 0; v < image.rows; ++v)
    for (int u = 0; u < image.cols; ++u)
      if (camera.ray({double(u), double(v)}).allFinite()) image.at<std::uint8_t>(v, u) = texture.at<std::uint8_t>(v, u);
  FeatureTracker tracker(camera, TrackerSettings());
  tracker.track(image);
  EXPECT_GT(tracker.replenish(), 100);
  for (const Feature& f : tracker.features()) {
    ASSERT_TRUE(f.normalized.allFinite());
    EXPECT_LT(std::atan(f.normalized.norm()), 80 * M_PI / 180 - 0.5 * tracker.settings().border / 140);
  }
  tracker.track(image);
  EXPECT_GT(tracker.lastSurvival(), 0.9);
}

TEST(WideAngle, RaysStayWhereABetterCalibrationSeesNothing) {
  const CameraModel before = fisheye(), after = withRadial(before, -0.02);  // circles of 399 and 383 px
  const Eigen::Vector2d centre(before.cx, before.cy), rim = centre + 393 * Eigen::Vector2d(0.8, 0.6);
  Map map;
  Keyframe keyframe;
  for (const Eigen::Vector2d& pixel : {Eigen::Vector2d(centre + Eigen::Vector2d(50, 20)), rim}) {
    Observation o;
    o.pixel = pixel;
    o.normalized = before.unproject(pixel);
    keyframe.observations.push_back(o);
    keyframe.orb_pixels.push_back(pixel);
    keyframe.orb_normalized.push_back(o.normalized);
  }
  const KeyframeId id = map.addKeyframe(keyframe);
  const auto still = [](double) { return CameraVelocity{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()}; };
  CalibrationAlignment calibration(before, 0, 0.05, 0);
  CalibrationEstimate estimate;
  estimate.error[0] = -0.02;
  calibration.follow(estimate);
  calibration.recalibrate(still, &map);
  const Keyframe& k = map.keyframe(id);
  ASSERT_TRUE(before.unproject(rim).allFinite() && !after.unproject(rim).allFinite());
  const Eigen::Vector2d moved = after.unproject(k.observations[0].pixel);
  for (const Eigen::Vector2d& n : {k.observations[0].normalized, k.orb_normalized[0]})
    EXPECT_LT((n - moved).norm(), 1e-12);
  EXPECT_GT((moved - keyframe.observations[0].normalized).norm(), 1e-6);
  for (const Eigen::Vector2d& n : {k.observations[1].normalized, k.orb_normalized[1]})
    EXPECT_EQ(n, before.unproject(rim)) << n.transpose();
}

}  // namespace
}  // namespace visual_frontend
