#include "mav_vo/bootstrap.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <opengv/relative_pose/CentralRelativeAdapter.hpp>
#include <opengv/sac/Ransac.hpp>
#include <opengv/sac_problems/relative_pose/CentralRelativePoseSacProblem.hpp>
#include <unordered_map>

#include "air_ground_common/geometry.h"
#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"
#include "visual_frontend/bundle_adjustment.h"
#include "visual_frontend/image_memory.h"
#include "visual_frontend/pose_solver.h"
#include "visual_frontend/triangulation.h"

namespace mav_vo {

using visual_frontend::Feature;
using visual_frontend::Pose;
using visual_frontend::TrackId;

namespace {

constexpr double kPatience = 0.6;  // of the parallax of the first views, given up at their greatest age [1]

constexpr double kTurnShare = 0.9;  // of the tracks that fit a motion: if a turn explains as many, it is one
constexpr const char* kTurnReason = "the first views turn rather than move: move the camera sideways";

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

/// How many of the tracks a turn alone explains, to 2.5 `sigma`, of a camera whose rows are read one after the other:
/// there it moves the rays by a share of their height in the image, which five points take for parallax.
int explainedByTurn(const Common& common, const Eigen::Matrix3d& R_a_b_guess, double sigma) {
  using Vector5d = Eigen::Matrix<double, 5, 1>;
  constexpr int kIterations = 6;
  const double width = 2.5 * sigma;
  Eigen::Matrix3d R_b_a = R_a_b_guess.transpose();
  Eigen::Vector2d by_row = Eigen::Vector2d::Zero();
  int explained = 0;
  for (int iteration = 0; iteration <= kIterations; ++iteration) {
    Eigen::Matrix<double, 5, 5> H = 1e-9 * Eigen::Matrix<double, 5, 5>::Identity();
    Vector5d g = Vector5d::Zero();
    explained = 0;
    for (std::size_t i = 0; i < common.a.size(); ++i) {
      const Eigen::Vector3d p = R_b_a * common.a[i].homogeneous();
      if (p.z() < 0.1) continue;
      const Eigen::Vector2d n = p.hnormalized(), error = n + common.b[i].y() * by_row - common.b[i];
      explained += error.norm() < width;
      Eigen::Matrix<double, 2, 5> J;
      J << -n.x() * n.y(), 1 + n.x() * n.x(), -n.y(), common.b[i].y(), 0,  //
          -1 - n.y() * n.y(), n.x() * n.y(), n.x(), 0, common.b[i].y();
      const double weight = 1 / (1 + error.squaredNorm() / (width * width));
      H += weight * J.transpose() * J;
      g += weight * J.transpose() * error;
    }
    const Vector5d step = H.ldlt().solve(-g);
    R_b_a = air_ground_common::expSO3(step.head<3>()) * R_b_a;
    by_row += step.tail<2>();
  }
  return explained;
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
      continue;  // a younger view leaves less of the turn open
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
  constexpr double kMemory = 200e6;  // of the candidates' images, at about the most: large ones are kept less often
  constexpr int kNoLimit = 1000000;
  const double interval =
      std::max(settings_.frame_interval, settings_.max_age / visual_frontend::imagesKept(pyramid, kNoLimit, kMemory));
  if (!result && (views_.empty() || stamp - views_.back().stamp >= interval)) {
    if (current.pyramid.empty())
      for (const cv::Mat& level : pyramid) current.pyramid.push_back(level.clone());
    views_.push_back(std::move(current));
  }
  return result;
}

/// Two views, or three, while they are made a map: the first camera is fixed, the baseline is one.
struct Bootstrap::Attempt {
  Attempt(const BootstrapView& first_, const BootstrapView& last_) : first(first_), last(last_) {}

  const BootstrapView &first, &last;
  const BootstrapView* middle = nullptr;
  std::optional<GyroRotation> turn;  ///< between first and last
  double sigma = 0;                  ///< of a ray
  double gyro_sigma = 0;             ///< of the turn [rad]
  std::vector<visual_frontend::NormalizedNoise> noise_a, noise_b;
  Common common;
  std::vector<unsigned char> inliers;  ///< of the common tracks
  Pose T_first_last = Pose::Identity();
  visual_frontend::BundleProblem problem;
  std::vector<TrackId> tracks;  ///< of the problem's points
  std::unordered_map<TrackId, int> point_of;
};

std::size_t Bootstrap::leastPoints(const Attempt& a) const {
  const double by_texture = static_cast<double>(settings_.min_inliers * needed_) / settings_.min_common;
  const double by_share = settings_.min_inlier_share * static_cast<double>(a.common.track.size());
  return static_cast<std::size_t>(std::ceil(std::max(by_texture, by_share)));
}

bool Bootstrap::findMotion(Attempt* a) {
  if (!a->turn) {
    const auto pose = fivePointPose(a->common.a, a->common.b, a->sigma, &a->inliers);
    if (!pose) {
      reason_ = "five-point start found no motion";
      return false;
    }
    const auto moved = std::count(a->inliers.begin(), a->inliers.end(), 1);
    if (explainedByTurn(a->common, pose->linear(), a->sigma) >= kTurnShare * static_cast<double>(moved)) {
      reason_ = kTurnReason;
      return false;
    }
    a->T_first_last = *pose;
    return true;
  }
  a->T_first_last.linear() = a->turn->R_a_b;
  visual_frontend::RansacSettings ransac;
  // The gyro's error moves the rays by more than the pixel noise.
  ransac.threshold = 2.5 * std::hypot(a->sigma, a->gyro_sigma) / a->sigma;
  ransac.seed = settings_.seed;
  const bool wide = camera_.model != air_ground_common::DistortionModel::kPlumbBob;
  using Noise = std::vector<visual_frontend::NormalizedNoise>;
  const auto direction =
      visual_frontend::translationFromKnownRotation(a->common.a, a->common.b, a->turn->R_a_b, a->sigma, ransac,
                                                    wide ? a->noise_a : Noise(), wide ? a->noise_b : Noise());
  if (!direction.success) {
    reason_ = "two-point start: " + direction.reason;
    return false;
  }
  a->T_first_last.translation() = direction.t_a_b;
  a->inliers = direction.inliers;
  return true;
}

bool Bootstrap::findPoints(Attempt* a) {
  visual_frontend::TriangulationSettings triangulation;
  triangulation.min_parallax = 0.2 * settings_.min_parallax;
  triangulation.max_residual = 4.0 * std::hypot(a->sigma, a->turn ? a->gyro_sigma : a->sigma) / a->sigma;
  triangulation.min_depth = 0.2;
  triangulation.max_depth = 300;  // baselines
  auto& problem = a->problem;
  problem.cameras.resize(2);
  problem.cameras[0].fixed = true;
  problem.cameras[1].T_map_camera = a->T_first_last;
  for (std::size_t i = 0; i < a->common.track.size(); ++i) {
    if (!a->inliers[i]) continue;
    const auto &na = a->noise_a[i], &nb = a->noise_b[i];
    const auto point = visual_frontend::triangulate({{Pose::Identity(), a->common.a[i], na.sigma, 0, 0, na.elongation},
                                                     {a->T_first_last, a->common.b[i], nb.sigma, 0, 0, nb.elongation}},
                                                    triangulation);
    if (!point.ok()) continue;
    const int k = static_cast<int>(problem.points.size());
    a->point_of[a->common.track[i]] = k;
    a->tracks.push_back(a->common.track[i]);
    problem.points.push_back(point.p_map);
    problem.measurements.push_back({0, k, a->common.a[i], na.sigma, 0, 0, na.elongation});
    problem.measurements.push_back({1, k, a->common.b[i], nb.sigma, 0, 0, nb.elongation});
  }
  if (a->tracks.size() >= leastPoints(*a)) return true;
  reason_ = std::to_string(a->tracks.size()) + " of " + std::to_string(a->common.track.size()) +
            " tracks fit one motion of the camera; much of the view moves by itself, or the calibration is off";
  return false;
}

// A third view from the middle settles what two views leave open.
void Bootstrap::addMiddleView(const GyroRotations& gyro, Attempt* a) const {
  const double half_way = 0.5 * (a->first.stamp + a->last.stamp);
  const BootstrapView* middle = nullptr;
  for (const BootstrapView& view : views_) {
    if (view.stamp <= a->first.stamp) continue;
    if (!middle || std::abs(view.stamp - half_way) < std::abs(middle->stamp - half_way)) middle = &view;
  }
  if (!middle) return;
  auto& problem = a->problem;
  std::vector<visual_frontend::PoseCorrespondence> seen;
  std::vector<int> points;
  for (const Feature& f : middle->features) {
    const auto it = a->point_of.find(f.id);
    if (it == a->point_of.end()) continue;
    const auto noise = camera_.normalizedNoise(f.normalized, settings_.pixel_sigma);
    seen.push_back({problem.points[it->second], f.normalized, noise.sigma, 0, 0, noise.elongation});
    points.push_back(it->second);
  }
  Pose start = air_ground_common::interpolate(Pose::Identity(), a->T_first_last,
                                              (middle->stamp - a->first.stamp) / (a->last.stamp - a->first.stamp));
  const auto turn = a->turn ? gyro(a->first.stamp, middle->stamp) : std::nullopt;
  if (turn) start.linear() = turn->R_a_b;
  visual_frontend::RefineSettings refine;
  refine.loss = visual_frontend::RobustLoss::kCauchy;
  const auto pose = visual_frontend::refinePose(seen, start, refine);
  if (!pose.success || 2 * pose.inlier_count * settings_.min_common < settings_.min_inliers * needed_) return;
  a->middle = middle;
  problem.cameras.emplace_back();
  problem.cameras.back().T_map_camera = pose.T_map_camera;
  if (turn)
    problem.priors.push_back({0, 2, Pose(turn->R_a_b), visual_frontend::sqrtRotationInformation(a->gyro_sigma)});
  for (std::size_t i = 0; i < seen.size(); ++i)
    problem.measurements.push_back({2, points[i], seen[i].normalized, seen[i].sigma, 0, 0, seen[i].elongation});
}

std::optional<BootstrapResult> Bootstrap::adjust(Attempt* a) {
  auto& problem = a->problem;
  if (a->turn)
    problem.priors.push_back(
        {0, 1, Pose(a->T_first_last.linear()), visual_frontend::sqrtRotationInformation(a->gyro_sigma)});
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
  if (!solved.usable || solved.rms > settings_.max_rms || depths.size() < leastPoints(*a)) {
    reason_ = solved.usable && solved.rms <= settings_.max_rms
                  ? std::to_string(depths.size()) + " points of the first views have a sure depth, " +
                        std::to_string(leastPoints(*a)) + " needed: go on moving sideways, over more texture"
                  : "the first views do not fit one rigid scene: keep what moves by itself out of view, check the "
                    "calibration (camera_info) and whether the shutter rolls (readout_time)";
    return std::nullopt;
  }
  BootstrapResult result;
  result.rms = solved.rms;
  result.rotation_from_gyro = a->turn.has_value();
  result.median_parallax = median(angles);
  if (result.median_parallax < 0.5 * (1 - kPatience) * settings_.min_parallax) {
    reason_ = kTurnReason;
    return std::nullopt;
  }
  const double unit = 1.0 / median(depths);
  for (std::size_t i = 0; i < good.size(); ++i)
    if (good[i]) result.points.push_back({a->tracks[i], unit * problem.points[i]});
  const auto addView = [&](const BootstrapView& view, const Pose& T_first_camera) {
    result.views.push_back(view);
    result.views.back().T_first_camera = T_first_camera;
    result.views.back().T_first_camera.translation() *= unit;
  };
  addView(a->first, Pose::Identity());
  if (a->middle) addView(*a->middle, problem.cameras[2].T_map_camera);
  addView(a->last, T_last);
  reason_.clear();
  return result;
}

std::optional<BootstrapResult> Bootstrap::attempt(const BootstrapView& first, const BootstrapView& last,
                                                  const GyroRotations& gyro, const std::optional<GyroRotation>& turn) {
  Attempt a(first, last);
  a.turn = turn;
  a.gyro_sigma = turn ? std::hypot(settings_.gyro_sigma, turn->sigma) : 0;
  a.sigma = settings_.pixel_sigma / (0.5 * (camera_.fx + camera_.fy));
  a.common = commonTracks(first.features, last.features);
  for (const auto& n : a.common.a) a.noise_a.push_back(camera_.normalizedNoise(n, settings_.pixel_sigma));
  for (const auto& n : a.common.b) a.noise_b.push_back(camera_.normalizedNoise(n, settings_.pixel_sigma));
  if (!findMotion(&a) || !findPoints(&a)) return std::nullopt;
  addMiddleView(gyro, &a);
  return adjust(&a);
}

}  // namespace mav_vo
