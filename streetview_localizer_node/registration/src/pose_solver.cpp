#include "pose_solver.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <opencv2/imgproc.hpp>

namespace streetview_localizer::registration {
namespace {

using air_ground_common::Matrix6d;
using air_ground_common::Pose;
using air_ground_common::Vector6d;

constexpr int kBins = 720;
constexpr double kInflation = 2.2;   // of the covariance
constexpr double kFootStddev = 0.5;  // of the ground guessed from the walls' feet [m]

/// One scalar measurement, linear in the pose's step and in the errors of one building.
struct Measurement {
  double residual = 0, sigma = 1;
  double kernel = 3;                                ///< of Tukey's biweight, in sigmas
  double count = 1;                                 ///< how many independent measurements it stands for
  Vector6d pose = Vector6d::Zero();                 ///< d residual / d (position, rotation)
  int building = -1;                                ///< -1: none
  Eigen::Vector4d error = Eigen::Vector4d::Zero();  ///< d residual / d (x, y, height, turn) of the building
  double overhang = 0;                              ///< d residual / d overhang of the roofs
};

bool isSky(const ImageCues& cues, double u, double v) {
  const int width = cues.image.cols;
  const int column = ((static_cast<int>(std::lround(u)) % width) + width) % width;
  return v < cues.sky.row[column];
}

/// False outside the picture of a photograph.
bool inImage(const ImageCues& cues, double u, double v) {
  if (cues.mask.empty()) return true;
  return v >= 0 && v < cues.mask.rows &&
         cues.mask.at<std::uint8_t>(static_cast<int>(v), std::clamp(static_cast<int>(u), 0, cues.mask.cols - 1)) == 255;
}

/// Angle from the predicted place of a sky line's sample to where the image has it, along the sample's `outside`.
std::optional<double> skyOffset(const ImageCues& cues, const Eigen::Vector3d& ray, const Eigen::Vector3d& outside,
                                double window) {
  const int width = cues.image.cols, height = cues.image.rows;
  const double step = 0.5 * M_PI / height;
  const int steps = static_cast<int>(window / step);
  double best = std::numeric_limits<double>::infinity();
  bool before = false;
  Eigen::Vector2d previous;
  for (int i = -steps; i <= steps; ++i) {
    const double t = i * step;
    const Eigen::Vector2d p = pixelOf(ray + std::tan(t) * outside, width, height);
    const bool sky = isSky(cues, p.x(), p.y());
    if (i > -steps && sky && !before) {
      // Where the line is nearly level the row is known better than the step.
      double place = t - 0.5 * step;
      const int column = ((static_cast<int>(std::lround(p.x())) % width) + width) % width;
      if (std::abs(p.y() - previous.y()) > 0.3 && std::abs(outside.z()) > 0.7) {
        const double s = (cues.sky.row[column] - previous.y()) / (p.y() - previous.y());
        if (s > -1 && s < 2) place = t - step + s * step;
      }
      if (std::abs(place) < std::abs(best)) best = place;
    }
    before = sky;
    previous = p;
  }
  if (!std::isfinite(best)) return std::nullopt;
  return best;
}

struct VerticalOffset {
  double columns = 0, strength = 0;
};

/// The most convincing vertical line near a predicted one.
std::optional<VerticalOffset> verticalOffset(const VerticalEvidence& evidence, double column, int top, int bottom,
                                             double window) {
  const int centre = static_cast<int>(std::lround(column)), reach = static_cast<int>(std::ceil(window)) + 1;
  std::vector<float> strength(2 * reach + 1);
  for (int i = -reach; i <= reach; ++i) strength[i + reach] = evidence.strength(centre + i, top, bottom);
  VerticalOffset best;
  double best_score = 0;
  for (int i = 1; i < 2 * reach; ++i) {
    const float a = strength[i - 1], b = strength[i], c = strength[i + 1];
    if (b < 0.35f || b < a || b <= c) continue;
    // Strong edges saturate the columns beside them: the middle of the run that is nearly as strong.
    double sum = 0, moment = 0;
    for (const int side : {-1, 1}) {
      for (int k = side < 0 ? i : i + 1; k >= 0 && k <= 2 * reach && strength[k] > 0.6f * b; k += side) {
        sum += strength[k] - 0.5 * b;
        moment += (strength[k] - 0.5 * b) * k;
      }
    }
    const double offset = centre + moment / sum - reach - 0.5 - column;
    const double score = b * std::exp(-0.5 * offset * offset / (window * window) * 2);
    if (std::abs(offset) > window || score < best_score) continue;
    best_score = score;
    best.columns = offset;
    best.strength = b;
  }
  if (best_score <= 0) return std::nullopt;
  return best;
}

double tukeyCost(double r) {
  if (std::abs(r) >= 1) return 1;
  const double q = 1 - r * r;
  return 1 - q * q * q;
}

double tukeyWeight(double r) {
  if (std::abs(r) >= 1) return 0;
  const double q = 1 - r * r;
  return q * q;
}

}  // namespace

ImageCues findCues(const cv::Mat& full, const cv::Mat& full_mask, const Eigen::Matrix3d& R_world_geotag,
                   const RegistrationSettings& settings) {
  cv::Mat bgr = full, mask = full_mask;
  if (full.cols > kLargestWidth) {
    cv::resize(full, bgr, {kLargestWidth, kLargestWidth / 2}, 0, 0, cv::INTER_AREA);
    if (!full_mask.empty()) cv::resize(full_mask, mask, bgr.size(), 0, 0, cv::INTER_AREA);
  }
  // Filters reach over the border of a photograph.
  if (!mask.empty()) {
    cv::Mat inner;
    cv::erode(mask, inner, cv::Mat::ones(13, 13, CV_8U));
    mask = inner;
  }
  ImageCues cues;
  // Up as the geotag has it, then as the vertical lines have it. The heading stays the body's.
  const double yaw = air_ground_common::yawOf(R_world_geotag);
  const Eigen::Matrix3d R_body_guess =
      R_world_geotag.transpose() * Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).matrix();
  const cv::Mat guess = turnPanorama(bgr, R_body_guess, cv::INTER_LINEAR);
  const cv::Mat guess_mask = mask.empty() ? cv::Mat() : turnPanorama(mask, R_body_guess, cv::INTER_LINEAR);
  const Eigen::Vector3d up =
      verticalDirection(findSegments(guess, guess_mask, 1.1), settings.tilt_stddev, &cues.tilt_stddev);
  const Eigen::Matrix3d R_guess_level = air_ground_common::levelingRotation(up).transpose();
  cues.R_body_level = R_body_guess * R_guess_level;
  cues.image = turnPanorama(bgr, cues.R_body_level, cv::INTER_CUBIC);
  if (!mask.empty()) cues.mask = turnPanorama(mask, cues.R_body_level, cv::INTER_LINEAR);
  cues.sky = findSkyLine(cues.image, cues.mask);
  if (!cues.sky.failure.empty()) return cues;
  cues.segments = findSegments(cues.image, cues.mask, 1.1);
  cues.evidence.emplace(cues.image, cues.mask);
  cues.tangent.resize(kBins);
  const int width = cues.image.cols, height = cues.image.rows;
  for (int i = 0; i < kBins; ++i) {
    const double row = cues.sky.row[std::min(width - 1, static_cast<int>((i + 0.5) * width / kBins))];
    cues.tangent[i] = static_cast<float>(std::tan((0.5 - (row + 0.5) / height) * M_PI));
  }
  return cues;
}

std::vector<Candidate> searchCandidates(const ModelOutline& model, const std::vector<ModelEdge>& edges,
                                        const ImageCues& cues, const Pose& T_world_geotag,
                                        const RegistrationSettings& settings) {
  constexpr double kGrid = 0.6, kTruncation = 0.08;
  const double bin = 2 * M_PI / kBins;
  const int shifts = static_cast<int>(std::ceil(settings.search_yaw / bin));
  const double yaw = air_ground_common::yawOf(T_world_geotag.linear());
  // Bin i of the level image looks to azimuth_i + yaw in world: `turn` whole bins and a rest.
  const int cells = static_cast<int>(settings.search_radius / kGrid);
  std::vector<float> image(kBins);
  for (int i = 0; i < kBins; ++i)
    image[i] = std::isnan(cues.tangent[i]) ? cues.tangent[i] : std::atan(std::max(0.0f, cues.tangent[i]));
  std::vector<Candidate> all;
  SkyProfile profile;
  std::vector<float> elevation(kBins);
  for (int iy = -cells; iy <= cells; ++iy) {
    for (int ix = -cells; ix <= cells; ++ix) {
      if (std::hypot(ix, iy) * kGrid > settings.search_radius) continue;
      Candidate candidate;
      candidate.position = T_world_geotag.translation() + Eigen::Vector3d(ix * kGrid, iy * kGrid, 0);
      const GroundGuess ground = settings.camera_height > 0 ? model.groundGuess(candidate.position) : GroundGuess();
      if (ground.known || ground.guessed) candidate.position.z() = ground.height + settings.camera_height;
      if (model.insideBuilding(candidate.position)) continue;
      ModelOutline::skyProfile(edges, candidate.position, kBins, &profile);
      for (int i = 0; i < kBins; ++i) elevation[i] = std::atan(profile.tangent[i]);
      const int whole = static_cast<int>(std::lround(yaw / bin));
      candidate.cost = std::numeric_limits<double>::infinity();
      for (int shift = -shifts; shift <= shifts; ++shift) {
        double sum = 0;
        int count = 0;
        for (int i = 0; i < kBins; ++i) {
          if (std::isnan(image[i])) continue;
          // A larger yaw looks to a larger azimuth: a smaller bin of the world.
          const int j = (((i - whole - shift) % kBins) + kBins) % kBins;
          sum += std::min(kTruncation, static_cast<double>(std::abs(image[i] - elevation[j])));
          ++count;
        }
        const double turned = (whole + shift) * bin;
        const double off = air_ground_common::wrapAngle(turned - yaw) / settings.heading_stddev;
        const double distance = std::hypot(ix, iy) * kGrid / settings.geotag_stddev;
        const double cost = sum / std::max(1, count) + 0.0004 * (off * off + distance * distance);
        if (cost < candidate.cost) candidate.cost = cost, candidate.yaw = turned;
      }
      all.push_back(candidate);
    }
  }
  std::sort(all.begin(), all.end(), [](const Candidate& a, const Candidate& b) { return a.cost < b.cost; });
  std::vector<Candidate> best;
  for (const Candidate& candidate : all) {
    const bool near = std::any_of(best.begin(), best.end(), [&](const Candidate& other) {
      return (other.position - candidate.position).head<2>().norm() < 1.3;
    });
    if (!near) best.push_back(candidate);
    if (best.size() >= 8) break;
  }
  return best;
}

Fit refinePose(const ModelOutline& model, const std::vector<ModelEdge>& edges, const ImageCues& cues,
               const Candidate& start, const Pose& T_world_geotag, const RegistrationSettings& settings) {
  const int width = cues.image.cols, height = cues.image.rows;
  const double pixel = M_PI / height;
  Eigen::Vector3d position = start.position;
  Eigen::Matrix3d R = Eigen::AngleAxisd(start.yaw, Eigen::Vector3d::UnitZ()).matrix();
  std::map<int, Eigen::Vector4d> errors;
  double overhang = settings.roof_overhang;
  Fit fit;

  const double windows[] = {0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.012, 0.012, 0.012};
  for (const double& window : windows) {
    const bool last = &window == &windows[std::size(windows) - 1];
    std::vector<Measurement> measurements;
    double sky_seen = 0, sky_found = 0, missing = 0;
    int verticals = 0, verticals_seen = 0, facade = 0, facade_level = 0;
    const Outline outline = model.visible(edges, position);
    for (const OutlineSample& sample : outline.samples) {
      if (sample.kind != OutlineSample::Kind::kSky) continue;
      const Eigen::Vector4d error = errors.count(sample.building) ? errors[sample.building] : Eigen::Vector4d::Zero();
      Eigen::Vector3d out = Eigen::Vector3d::Zero();  // of the wall, towards the camera
      if (sample.eave) {
        out = Eigen::Vector3d(-sample.direction.y(), sample.direction.x(), 0).normalized();
        if (out.dot(sample.point - position) > 0) out = -out;
      }
      const Eigen::Vector3d p = sample.point + error.head<3>() + overhang * out - position;
      const double distance = p.norm();
      Eigen::Vector3d n = p.cross(sample.direction).normalized();
      if (n.dot(sample.outside) < 0) n = -n;
      const Eigen::Vector3d ray = R.transpose() * p / distance, outside = R.transpose() * n;
      const Eigen::Vector2d at = pixelOf(ray, width, height);
      if (!inImage(cues, at.x(), at.y())) continue;
      sky_seen += sample.weight;
      const double count = sample.weight / 0.035;
      const auto offset = skyOffset(cues, ray, outside, window);
      if (!offset) {
        missing += count;
        continue;
      }
      Measurement m;
      m.residual = *offset;
      m.sigma = std::hypot(1.0 * pixel, 0.05 / distance);
      m.kernel = std::max(3.0, 0.7 * window / m.sigma);
      m.count = count;
      m.pose.head<3>() = n / distance;
      m.pose.tail<3>() = (p / distance).cross(n);
      m.building = sample.building;
      m.error.head<3>() = -n / distance;
      m.overhang = -n.dot(out) / distance;
      if (std::abs(*offset) < 0.012) sky_found += sample.weight;
      measurements.push_back(m);
    }
    for (const OutlineVertical& vertical : outline.verticals) {
      const Eigen::Vector4d error =
          errors.count(vertical.building) ? errors[vertical.building] : Eigen::Vector4d::Zero();
      const Eigen::Vector3d shift(error.x(), error.y(), 0);
      const Eigen::Vector3d foot = R.transpose() * (vertical.foot + shift - position);
      const Eigen::Vector3d top = R.transpose() * (vertical.top + shift - position);
      const double distance = (vertical.foot + shift - position).head<2>().norm();
      if (distance > 45 || distance < 1) continue;
      const Eigen::Vector2d a = pixelOf(top, width, height), b = pixelOf(foot, width, height);
      const int rows = static_cast<int>(b.y() - a.y());
      if (rows * pixel < 0.06) continue;
      int first = static_cast<int>(a.y() + 0.06 * rows) + 1, end = static_cast<int>(b.y() - 0.15 * rows);
      if (!cues.mask.empty()) {  // of a photograph, the part that it shows
        while (first < end && !inImage(cues, a.x(), first)) ++first;
        while (first < end && !inImage(cues, a.x(), end - 1)) --end;
        if ((end - first) * pixel < 0.06) continue;
      }
      ++verticals_seen;
      const auto offset = verticalOffset(*cues.evidence, a.x(), first, end, std::max(2.0, window / pixel));
      if (!offset) continue;
      Measurement m;
      m.residual = -offset->columns * 2 * M_PI / width;  // azimuth falls along the row
      m.sigma = std::hypot(1.0 * pixel, 0.05 / distance) / std::min(1.0, offset->strength * 1.2);
      m.kernel = std::max(3.0, 0.5 * window / m.sigma);
      m.count = 1;
      const Eigen::Vector3d p = vertical.foot + shift - position;
      const Eigen::Vector3d n(-p.y() / distance, p.x() / distance, 0);  // towards larger azimuth
      m.pose.head<3>() = n / distance;
      m.pose(5) = 1;
      m.building = vertical.building;
      m.error.head<3>() = -n / distance;
      if (std::abs(m.residual) < 3 * m.sigma) ++verticals;
      measurements.push_back(m);
    }
    const double turn_window = std::max(0.03, 1.2 * window);
    for (const Segment& segment : cues.segments) {
      if (std::abs(segment.normal.z()) < 0.1 || segment.stddev > 0.05) continue;  // verticals have given the tilt
      const Eigen::Vector3d d = R * segment.middle, n = R * segment.normal;
      const auto hit = model.scene().cast(position.cast<float>(), d.cast<float>(), 60);
      if (!hit || !model.solid(hit->triangle) || std::abs(hit->normal.z()) > 0.2f) continue;
      const Eigen::Vector3d along = Eigen::Vector3d::UnitZ().cross(hit->normal.cast<double>()).normalized();
      const int building = model.building(hit->triangle);
      const double turn = errors.count(building) ? errors[building].w() : 0;
      const double slope = n.dot(along), lever = n.cross(along).z();
      if (std::abs(lever) < 0.1) continue;  // near the horizon all level lines are alike
      Measurement m;
      m.residual = slope + lever * -turn;
      ++facade;
      if (std::abs(m.residual) > turn_window) continue;
      m.sigma = std::hypot(segment.stddev, 0.006);
      m.kernel = turn_window / m.sigma;
      if (std::abs(m.residual) < 0.03) ++facade_level;
      m.pose.tail<3>() = n.cross(along);
      m.building = building;
      m.error.w() = -lever;
      m.count = 0.25;
      measurements.push_back(m);
    }

    // Normal equations: the pose, the roofs' overhang, then four errors of each building.
    std::map<int, int> index;
    for (const Measurement& m : measurements) {
      if (m.building >= 0) index.emplace(m.building, 0);
    }
    constexpr int kOverhang = 6;
    int size = 7;
    for (auto& [building, place] : index) place = size, size += 4;
    Eigen::MatrixXd hessian = Eigen::MatrixXd::Zero(size, size);
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(size);
    double cost = missing, cost_count = missing;
    for (const Measurement& m : measurements) {
      const double scaled = m.residual / (m.kernel * m.sigma);
      cost += m.count * tukeyCost(scaled);
      cost_count += m.count;
      const double w = m.count * tukeyWeight(scaled) / (m.sigma * m.sigma);
      if (w <= 0) continue;
      hessian.topLeftCorner<6, 6>() += w * m.pose * m.pose.transpose();
      gradient.head<6>() += w * m.residual * m.pose;
      hessian(kOverhang, kOverhang) += w * m.overhang * m.overhang;
      hessian.block<6, 1>(0, kOverhang) += w * m.overhang * m.pose;
      hessian.block<1, 6>(kOverhang, 0) += w * m.overhang * m.pose.transpose();
      gradient(kOverhang) += w * m.residual * m.overhang;
      if (m.building < 0) continue;
      const int k = index[m.building];
      hessian.block<6, 4>(0, k) += w * m.pose * m.error.transpose();
      hessian.block<4, 6>(k, 0) += w * m.error * m.pose.transpose();
      hessian.block<4, 4>(k, k) += w * m.error * m.error.transpose();
      gradient.segment<4>(k) += w * m.residual * m.error;
      hessian.block<4, 1>(k, kOverhang) += w * m.overhang * m.error;
      hessian.block<1, 4>(kOverhang, k) += w * m.overhang * m.error.transpose();
    }
    auto prior = [&](int at, double value, double sigma) {
      hessian(at, at) += 1 / (sigma * sigma);
      gradient(at) += value / (sigma * sigma);
    };
    prior(kOverhang, overhang - settings.roof_overhang, settings.roof_overhang_stddev);
    for (const auto& [building, k] : index) {
      const Eigen::Vector4d error = errors.count(building) ? errors[building] : Eigen::Vector4d::Zero();
      prior(k, error.x(), settings.model_lateral_stddev);
      prior(k + 1, error.y(), settings.model_lateral_stddev);
      prior(k + 2, error.z(), settings.model_height_stddev);
      prior(k + 3, error.w(), 0.14 * settings.model_lateral_stddev);
    }
    const Eigen::Vector3d off = position - T_world_geotag.translation();
    prior(0, off.x(), settings.geotag_stddev);
    prior(1, off.y(), settings.geotag_stddev);
    const GroundGuess ground = settings.camera_height > 0 ? model.groundGuess(position) : GroundGuess();
    if (ground.known || ground.guessed) {
      prior(2, position.z() - ground.height - settings.camera_height,
            ground.known ? settings.camera_height_stddev : std::hypot(settings.camera_height_stddev, kFootStddev));
    } else {
      prior(2, off.z(), settings.height_stddev);
    }
    const Eigen::Vector3d up = R.col(2);  // turns by d rot x up = (rotY, -rotX)
    prior(3, -up.y(), cues.tilt_stddev);
    prior(4, up.x(), cues.tilt_stddev);
    prior(5,
          air_ground_common::wrapAngle(air_ground_common::yawOf(R) - air_ground_common::yawOf(T_world_geotag.linear())),
          settings.heading_stddev);

    const Eigen::LDLT<Eigen::MatrixXd> solver(hessian);
    Eigen::VectorXd step = -solver.solve(gradient);
    if (!step.allFinite()) return fit;
    const double longest = step.head<3>().norm();
    if (longest > 1.5) step *= 1.5 / longest;
    position += step.head<3>();
    R = air_ground_common::expSO3(step.segment<3>(3)) * R;
    overhang += step(kOverhang);
    for (const auto& [building, k] : index) {
      Eigen::Vector4d& error = errors.emplace(building, Eigen::Vector4d::Zero()).first->second;
      error += step.segment<4>(k);
    }
    if (last) {
      const Eigen::MatrixXd inverse = solver.solve(Eigen::MatrixXd::Identity(size, 6));
      // What matches wrongly by a little (a drain pipe for a corner, a ledge for a roof) adds to it; measured.
      fit.covariance = kInflation * inverse.topRows<6>();
      fit.covariance = (0.5 * (fit.covariance + fit.covariance.transpose())).eval();
      fit.cost = cost / std::max(1.0, cost_count);
      fit.sky_angle = sky_seen;
      fit.sky_ratio = sky_seen > 0 ? sky_found / sky_seen : 0;
      fit.verticals = verticals;
      fit.verticals_seen = verticals_seen;
      fit.facade_ratio = facade > 0 ? static_cast<double>(facade_level) / facade : 0;
      fit.T_world_level.linear() = R;
      fit.T_world_level.translation() = position;
      fit.valid = fit.covariance.diagonal().minCoeff() > 0;
    }
  }
  return fit;
}

}  // namespace streetview_localizer::registration
