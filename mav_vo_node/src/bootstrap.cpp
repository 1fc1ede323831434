#include "mav_vo/bootstrap.h"

#include <algorithm>
#include <cmath>
#include <opengv/relative_pose/CentralRelativeAdapter.hpp>
#include <opengv/sac/Ransac.hpp>
#include <opengv/sac_problems/relative_pose/CentralRelativePoseSacProblem.hpp>
#include <unordered_map>

#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"
#include "visual_frontend/bundle_adjustment.h"
#include "visual_frontend/pose_solver.h"
#include "visual_frontend/triangulation.h"

namespace mav_vo {

using visual_frontend::Feature;
using visual_frontend::Pose;
using visual_frontend::TrackId;

namespace {

constexpr double kPatience = 0.6;  // of the parallax of the first views, given up at their greatest age [1]

using air_ground_common::median;

Eigen::Vector3d ray(const Eigen::Vector2d& normalized) { return normalized.homogeneous().normalized(); }

double parallaxAngle(const Eigen::Vector2d& a, const Eigen::Vector2d& b, const Eigen::Matrix3d& R_a_b) {
  return std::asin(std::min(1.0, ray(a).cross(R_a_b * ray(b)).norm()));
}

struct Common {
  std::vector<TrackId> track;
  std::vector<Eigen::Vector2d> a, b;
};

Common commonTracks(const std::vector<Feature>& a, const std::vector<Feature>& b) {
  std::unordered_map<TrackId, const Feature*> by_id;
  for (const Feature& f : a) by_id[f.id] = &f;
  Common common;
  for (const Feature& f : b) {
    const auto it = by_id.find(f.id);
    if (it == by_id.end()) continue;
    common.track.push_back(f.id);
    common.a.push_back(it->second->normalized);
    common.b.push_back(f.normalized);
  }
  return common;
}

}  // namespace

std::optional<Pose> fivePointPose(const std::vector<Eigen::Vector2d>& a, const std::vector<Eigen::Vector2d>& b,
                                  double sigma, std::vector<unsigned char>* inliers) {
  inliers->assign(a.size(), 0);
  if (a.size() < 8 || a.size() != b.size()) return std::nullopt;
  opengv::bearingVectors_t rays_a, rays_b;
  for (std::size_t i = 0; i < a.size(); ++i) {
    rays_a.push_back(ray(a[i]));
    rays_b.push_back(ray(b[i]));
  }
  using Problem = opengv::sac_problems::relative_pose::CentralRelativePoseSacProblem;
  opengv::relative_pose::CentralRelativeAdapter adapter(rays_a, rays_b);
  opengv::sac::Ransac<Problem> ransac;
  ransac.sac_model_ = std::make_shared<Problem>(adapter, Problem::NISTER, false);  // false: a fixed seed
  // OpenGV adds 1 - cos of the reprojection angle of both views.
  ransac.threshold_ = 2.0 * (1.0 - std::cos(2.5 * sigma));
  ransac.max_iterations_ = 300;
  if (!ransac.computeModel() || ransac.inliers_.size() < 8) return std::nullopt;
  opengv::transformation_t model;
  ransac.sac_model_->optimizeModelCoefficients(ransac.inliers_, ransac.model_coefficients_, model);
  if (!model.allFinite() || model.col(3).norm() < 1e-9) return std::nullopt;
  for (const int i : ransac.inliers_) (*inliers)[i] = 1;
  Pose T_a_b = Pose::Identity();
  T_a_b.linear() = model.leftCols<3>();
  T_a_b.translation() = model.col(3).normalized();
  return air_ground_common::normalized(T_a_b);
}

Bootstrap::Bootstrap(const visual_frontend::CameraModel& camera, const BootstrapSettings& settings)
    : camera_(camera), settings_(settings) {
  camera_.validate();
}

void Bootstrap::reset() {
  views_.clear();
  reason_ = "no image yet";
}

std::optional<BootstrapResult> Bootstrap::add(double stamp, const std::vector<Feature>& features,
                                              const visual_frontend::ImagePyramid& pyramid, const GyroRotations& gyro) {
  while (!views_.empty() && views_.front().stamp < stamp - settings_.max_age) views_.pop_front();
  BootstrapView current;
  current.stamp = stamp;
  current.features = features;

  // The oldest view that still shares enough tracks has the widest baseline.
  std::optional<BootstrapResult> result;
  std::size_t texture = features.size();
  for (const BootstrapView& view : views_) texture = std::max(texture, view.features.size());
  needed_ = std::clamp(static_cast<int>(settings_.min_common_share * static_cast<double>(texture)),
                       settings_.min_common / 2, settings_.min_common);
  reason_ = "too few corners stay in view to compare images (" + std::to_string(features.size()) + " now, " +
            std::to_string(needed_) + " must stay): more light or texture, or slower turns";
  for (const BootstrapView& first : views_) {
    const Common common = commonTracks(first.features, features);
    if (static_cast<int>(common.track.size()) < needed_) continue;
    const auto turn = gyro ? gyro(first.stamp, stamp) : std::nullopt;
    if (turn && turn->sigma > settings_.max_gyro_sigma) {
      reason_ = "estimating the gyro's bias: keep the camera moving over texture";
      break;
    }
    const Eigen::Matrix3d R = turn ? turn->R_a_b : Eigen::Matrix3d::Identity();
    std::vector<double> angles;
    for (std::size_t i = 0; i < common.a.size(); ++i) angles.push_back(parallaxAngle(common.a[i], common.b[i], R));
    // Who moves slowly gets there slowly: less is asked of views far apart.
    const double parallax = settings_.min_parallax * (1 - kPatience * (stamp - first.stamp) / settings_.max_age);
    if (median(angles) < parallax) {
      reason_ = air_ground_common::formatted("move the camera sideways: parallax is %.1f of %.1f degrees",
                                             median(angles) * 180 / M_PI, parallax * 180 / M_PI);
      break;
    }
    for (const cv::Mat& level : pyramid) current.pyramid.push_back(level.clone());
    result = attempt(first, current, gyro, turn);
    break;
  }
  if (!result && (views_.empty() || stamp - views_.back().stamp >= settings_.frame_interval)) {
    if (current.pyramid.empty())
      for (const cv::Mat& level : pyramid) current.pyramid.push_back(level.clone());
    views_.push_back(std::move(current));
  }
  return result;
}

std::optional<BootstrapResult> Bootstrap::attempt(const BootstrapView& first, const BootstrapView& last,
                                                  const GyroRotations& gyro, const std::optional<GyroRotation>& turn) {
  const double gyro_sigma = turn ? std::hypot(settings_.gyro_sigma, turn->sigma) : 0;
  const double sigma = settings_.pixel_sigma / (0.5 * (camera_.fx + camera_.fy));
  const Common common = commonTracks(first.features, last.features);
  Pose T_first_last = Pose::Identity();
  std::vector<unsigned char> inliers;
  const auto noiseOf = [this](const std::vector<Eigen::Vector2d>& normalized) {
    std::vector<visual_frontend::NormalizedNoise> noise;
    for (const auto& n : normalized) noise.push_back(camera_.normalizedNoise(n, settings_.pixel_sigma));
    return noise;
  };
  const auto noise_a = noiseOf(common.a), noise_b = noiseOf(common.b);
  if (turn) {
    T_first_last.linear() = turn->R_a_b;
    visual_frontend::RansacSettings ransac;
    // The gyro's error moves the rays by more than the pixel noise.
    ransac.threshold = 2.5 * std::hypot(sigma, gyro_sigma) / sigma;
    ransac.seed = settings_.seed;
    const bool wide = camera_.model != air_ground_common::DistortionModel::kPlumbBob;
    using Noise = std::vector<visual_frontend::NormalizedNoise>;
    const auto direction = visual_frontend::translationFromKnownRotation(
        common.a, common.b, T_first_last.linear(), sigma, ransac, wide ? noise_a : Noise(), wide ? noise_b : Noise());
    if (!direction.success) {
      reason_ = "two-point start: " + direction.reason;
      return std::nullopt;
    }
    T_first_last.translation() = direction.t_a_b;
    inliers = direction.inliers;
  } else {
    const auto pose = fivePointPose(common.a, common.b, sigma, &inliers);
    if (!pose) {
      reason_ = "five-point start found no motion";
      return std::nullopt;
    }
    T_first_last = *pose;
  }
  // A third view from the middle settles what two views leave open.
  const BootstrapView* middle = nullptr;
  for (const BootstrapView& view : views_) {
    if (view.stamp <= first.stamp) continue;
    if (!middle || std::abs(view.stamp - 0.5 * (first.stamp + last.stamp)) <
                       std::abs(middle->stamp - 0.5 * (first.stamp + last.stamp)))
      middle = &view;
  }

  visual_frontend::TriangulationSettings triangulation;
  triangulation.min_parallax = 0.2 * settings_.min_parallax;
  triangulation.max_residual = 4.0 * std::hypot(sigma, turn ? gyro_sigma : sigma) / sigma;
  triangulation.min_depth = 0.2;
  triangulation.max_depth = 300;  // baselines
  BootstrapResult result;
  visual_frontend::BundleProblem problem;
  problem.cameras.resize(2);
  problem.cameras[0].fixed = true;
  problem.cameras[1].T_map_camera = T_first_last;
  std::unordered_map<TrackId, int> index;
  for (std::size_t i = 0; i < common.track.size(); ++i) {
    if (!inliers[i]) continue;
    const auto &na = noise_a[i], &nb = noise_b[i];
    const auto point = visual_frontend::triangulate({{Pose::Identity(), common.a[i], na.sigma, 0, 0, na.elongation},
                                                     {T_first_last, common.b[i], nb.sigma, 0, 0, nb.elongation}},
                                                    triangulation);
    if (!point.ok()) continue;
    const int k = static_cast<int>(problem.points.size());
    index[common.track[i]] = k;
    result.points.push_back({common.track[i], point.p_map});
    problem.points.push_back(point.p_map);
    problem.measurements.push_back({0, k, common.a[i], na.sigma, 0, 0, na.elongation});
    problem.measurements.push_back({1, k, common.b[i], nb.sigma, 0, 0, nb.elongation});
  }
  const auto enough = [&](std::size_t count) {
    return static_cast<int>(count) * settings_.min_common >= settings_.min_inliers * needed_ &&
           static_cast<double>(count) >= settings_.min_inlier_share * static_cast<double>(common.track.size());
  };
  if (!enough(result.points.size())) {
    reason_ = std::to_string(result.points.size()) + " of " + std::to_string(common.track.size()) +
              " tracks fit one motion of the camera; much of the view moves by itself, or the calibration is off";
    return std::nullopt;
  }
  if (middle) {
    std::vector<visual_frontend::PoseCorrespondence> seen;
    std::vector<int> point_of;
    for (const Feature& f : middle->features) {
      const auto it = index.find(f.id);
      if (it == index.end()) continue;
      const auto noise = camera_.normalizedNoise(f.normalized, settings_.pixel_sigma);
      seen.push_back({problem.points[it->second], f.normalized, noise.sigma, 0, 0, noise.elongation});
      point_of.push_back(it->second);
    }
    Pose start = air_ground_common::interpolate(Pose::Identity(), T_first_last,
                                                (middle->stamp - first.stamp) / (last.stamp - first.stamp));
    const auto middle_turn = turn ? gyro(first.stamp, middle->stamp) : std::nullopt;
    if (middle_turn) start.linear() = middle_turn->R_a_b;
    visual_frontend::RefineSettings refine;
    refine.loss = visual_frontend::RobustLoss::kCauchy;
    const auto pose = visual_frontend::refinePose(seen, start, refine);
    if (pose.success && 2 * pose.inlier_count * settings_.min_common >= settings_.min_inliers * needed_) {
      problem.cameras.emplace_back();
      problem.cameras.back().T_map_camera = pose.T_map_camera;
      if (middle_turn) problem.priors.push_back({0, 2, Pose(middle_turn->R_a_b), gyro_sigma, -1});
      for (std::size_t i = 0; i < seen.size(); ++i)
        problem.measurements.push_back({2, point_of[i], seen[i].normalized, seen[i].sigma, 0, 0, seen[i].elongation});
    } else {
      middle = nullptr;
    }
  }
  if (turn) problem.priors.push_back({0, 1, Pose(T_first_last.linear()), gyro_sigma, -1});
  visual_frontend::BundleSettings bundle;
  bundle.max_iterations = 25;
  bundle.loss = visual_frontend::RobustLoss::kCauchy;
  const auto solved = visual_frontend::solveBundle(problem, bundle);
  std::vector<unsigned char> good(problem.points.size(), 1);
  for (const int m : solved.outliers) good[problem.measurements[m].point] = 0;
  const Pose& T_last = problem.cameras[1].T_map_camera;
  std::vector<double> depths, angles;
  for (std::size_t i = 0; i < good.size(); ++i) {
    const Eigen::Vector3d& p = problem.points[i];
    const double z_last = (T_last.inverse() * p).z();
    if (!(p.z() > 0) || !(z_last > 0)) good[i] = 0;
    if (!good[i]) continue;
    depths.push_back(p.z());
    angles.push_back(std::atan2(p.cross(p - T_last.translation()).norm(), p.dot(p - T_last.translation())));
  }
  if (!solved.usable || solved.rms > settings_.max_rms || !enough(depths.size())) {
    reason_ = "bundle adjustment of the first views keeps " + std::to_string(depths.size()) + " points, rms " +
              std::to_string(solved.rms) + " sigma";
    return std::nullopt;
  }
  result.median_parallax = median(angles);
  if (result.median_parallax < 0.5 * (1 - kPatience) * settings_.min_parallax) {
    reason_ = "first views turn rather than move";
    return std::nullopt;
  }
  const double unit = 1.0 / median(depths);
  std::vector<BootstrapResult::Point> points;
  for (std::size_t i = 0; i < good.size(); ++i)
    if (good[i]) points.push_back({result.points[i].track, unit * problem.points[i]});
  result.points = std::move(points);
  result.views.push_back(first);
  if (middle) {
    result.views.push_back(*middle);
    result.views.back().T_first_camera = problem.cameras[2].T_map_camera;
  }
  result.views.push_back(last);
  result.views.back().T_first_camera = T_last;
  result.views.front().T_first_camera = Pose::Identity();
  for (auto& view : result.views) view.T_first_camera.translation() *= unit;
  result.rms = solved.rms;
  result.rotation_from_gyro = turn.has_value();
  reason_.clear();
  return result;
}

}  // namespace mav_vo
