// Gauss-Newton refinement of a panorama's pose against the model's outline: sky line, corners of the buildings, level
// lines of the facades, with errors of the model as unknowns beside the pose.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "pose_solver.h"

namespace streetview_localizer::registration {
namespace {

using air_ground_common::Matrix6d;
using air_ground_common::Pose;
using air_ground_common::Vector6d;

constexpr double kInflation = 2.2;   // of the covariance
constexpr double kFootStddev = 0.5;  // of the ground guessed from the walls' feet [m]
constexpr int kOverhang = 6;         // row of the roofs' overhang, after the pose

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

/// What the measurements of one step say beside their residuals.
struct Tally {
  double sky_seen = 0, sky_found = 0;  ///< of the sky line [rad]
  double missing = 0;                  ///< samples of it that the image does not show near their place
  int verticals = 0, verticals_seen = 0, facade = 0, facade_level = 0;
};

/// Pose, overhang of the roofs and four errors (x, y, height, turn) of each building, in steps over shrinking windows.
class PoseRefinement {
 public:
  PoseRefinement(const ModelOutline& model, const std::vector<ModelEdge>& edges, const ImageCues& cues,
                 const Candidate& start, const Pose& T_world_geotag, const RegistrationSettings& settings)
      : model_(model),
        edges_(edges),
        cues_(cues),
        T_world_geotag_(T_world_geotag),
        settings_(settings),
        position_(start.position),
        R_(Eigen::AngleAxisd(start.yaw, Eigen::Vector3d::UnitZ()).matrix()),
        overhang_(settings.roof_overhang) {}

  /// `window`: how far from its predicted place a cue is looked for [rad]. False when the step has no solution.
  bool step(double window) {
    measurements_.clear();
    tally_ = Tally();
    const Outline outline = model_.visible(edges_, position_);
    for (const OutlineSample& sample : outline.samples) measureSky(sample, window);
    for (const OutlineVertical& vertical : outline.verticals) measureVertical(vertical, window);
    for (const Segment& segment : cues_.segments) measureFacade(segment, std::max(0.03, 1.2 * window));
    accumulate();
    addPriors();
    return solve();
  }

  /// After the last step.
  Fit fit() const {
    Fit fit;
    const Eigen::MatrixXd inverse = solver_.solve(Eigen::MatrixXd::Identity(hessian_.rows(), 6));
    // What matches wrongly by a little (a drain pipe for a corner, a ledge for a roof) adds to it; measured.
    fit.covariance = kInflation * inverse.topRows<6>();
    fit.covariance = (0.5 * (fit.covariance + fit.covariance.transpose())).eval();
    fit.cost = cost_ / std::max(1.0, cost_count_);
    fit.sky_angle = tally_.sky_seen;
    fit.sky_ratio = tally_.sky_seen > 0 ? tally_.sky_found / tally_.sky_seen : 0;
    fit.verticals = tally_.verticals;
    fit.verticals_seen = tally_.verticals_seen;
    fit.facade_ratio = tally_.facade > 0 ? static_cast<double>(tally_.facade_level) / tally_.facade : 0;
    fit.T_world_level.linear() = R_;
    fit.T_world_level.translation() = position_;
    fit.valid = fit.covariance.diagonal().minCoeff() > 0;
    return fit;
  }

 private:
  Eigen::Vector4d errorOf(int building) const {
    const auto it = errors_.find(building);
    return it == errors_.end() ? Eigen::Vector4d(Eigen::Vector4d::Zero()) : it->second;
  }
  double pixel() const { return M_PI / cues_.image.rows; }
  Eigen::Vector2d at(const Eigen::Vector3d& ray) const { return pixelOf(ray, cues_.image.cols, cues_.image.rows); }

  void measureSky(const OutlineSample& sample, double window) {
    if (sample.kind != OutlineSample::Kind::kSky) return;
    Eigen::Vector3d out = Eigen::Vector3d::Zero();  // of the wall, towards the camera
    if (sample.eave) {
      out = Eigen::Vector3d(-sample.direction.y(), sample.direction.x(), 0).normalized();
      if (out.dot(sample.point - position_) > 0) out = -out;
    }
    const Eigen::Vector3d p = sample.point + errorOf(sample.building).head<3>() + overhang_ * out - position_;
    const double distance = p.norm();
    Eigen::Vector3d n = p.cross(sample.direction).normalized();
    if (n.dot(sample.outside) < 0) n = -n;
    const Eigen::Vector3d ray = R_.transpose() * p / distance, outside = R_.transpose() * n;
    const Eigen::Vector2d place = at(ray);
    if (!inImage(cues_, place.x(), place.y())) return;
    tally_.sky_seen += sample.weight;
    const double count = sample.weight / 0.035;
    const auto offset = skyOffset(cues_, ray, outside, window);
    if (!offset) {
      tally_.missing += count;
      return;
    }
    Measurement m;
    m.residual = *offset;
    m.sigma = std::hypot(1.0 * pixel(), 0.05 / distance);
    m.kernel = std::max(3.0, 0.7 * window / m.sigma);
    m.count = count;
    m.pose.head<3>() = n / distance;
    m.pose.tail<3>() = (p / distance).cross(n);
    m.building = sample.building;
    m.error.head<3>() = -n / distance;
    m.overhang = -n.dot(out) / distance;
    if (std::abs(*offset) < 0.012) tally_.sky_found += sample.weight;
    measurements_.push_back(m);
  }

  void measureVertical(const OutlineVertical& vertical, double window) {
    const Eigen::Vector4d error = errorOf(vertical.building);
    const Eigen::Vector3d shift(error.x(), error.y(), 0);
    const Eigen::Vector3d foot = R_.transpose() * (vertical.foot + shift - position_);
    const Eigen::Vector3d top = R_.transpose() * (vertical.top + shift - position_);
    const double distance = (vertical.foot + shift - position_).head<2>().norm();
    if (distance > 45 || distance < 1) return;
    const Eigen::Vector2d a = at(top), b = at(foot);
    const int rows = static_cast<int>(b.y() - a.y());
    if (rows * pixel() < 0.06) return;
    int first = static_cast<int>(a.y() + 0.06 * rows) + 1, end = static_cast<int>(b.y() - 0.15 * rows);
    if (!cues_.mask.empty()) {  // of a photograph, the part that it shows
      while (first < end && !inImage(cues_, a.x(), first)) ++first;
      while (first < end && !inImage(cues_, a.x(), end - 1)) --end;
      if ((end - first) * pixel() < 0.06) return;
    }
    ++tally_.verticals_seen;
    const auto offset = verticalOffset(*cues_.evidence, a.x(), first, end, std::max(2.0, window / pixel()));
    if (!offset) return;
    Measurement m;
    m.residual = -offset->columns * 2 * M_PI / cues_.image.cols;  // azimuth falls along the row
    m.sigma = std::hypot(1.0 * pixel(), 0.05 / distance) / std::min(1.0, offset->strength * 1.2);
    m.kernel = std::max(3.0, 0.5 * window / m.sigma);
    m.count = 1;
    const Eigen::Vector3d p = vertical.foot + shift - position_;
    const Eigen::Vector3d n(-p.y() / distance, p.x() / distance, 0);  // towards larger azimuth
    m.pose.head<3>() = n / distance;
    m.pose(5) = 1;
    m.building = vertical.building;
    m.error.head<3>() = -n / distance;
    if (std::abs(m.residual) < 3 * m.sigma) ++tally_.verticals;
    measurements_.push_back(m);
  }

  void measureFacade(const Segment& segment, double turn_window) {
    if (std::abs(segment.normal.z()) < 0.1 || segment.stddev > 0.05) return;  // verticals have given the tilt
    const Eigen::Vector3d d = R_ * segment.middle, n = R_ * segment.normal;
    const auto hit = model_.scene().cast(position_.cast<float>(), d.cast<float>(), 60);
    if (!hit || !model_.solid(hit->triangle) || std::abs(hit->normal.z()) > 0.2f) return;
    const Eigen::Vector3d along = Eigen::Vector3d::UnitZ().cross(hit->normal.cast<double>()).normalized();
    const int building = model_.building(hit->triangle);
    const double slope = n.dot(along), lever = n.cross(along).z();
    if (std::abs(lever) < 0.1) return;  // near the horizon all level lines are alike
    Measurement m;
    m.residual = slope + lever * -errorOf(building).w();
    ++tally_.facade;
    if (std::abs(m.residual) > turn_window) return;
    m.sigma = std::hypot(segment.stddev, 0.006);
    m.kernel = turn_window / m.sigma;
    if (std::abs(m.residual) < 0.03) ++tally_.facade_level;
    m.pose.tail<3>() = n.cross(along);
    m.building = building;
    m.error.w() = -lever;
    m.count = 0.25;
    measurements_.push_back(m);
  }

  /// Normal equations: the pose, the roofs' overhang, then four errors of each building.
  void accumulate() {
    index_.clear();
    for (const Measurement& m : measurements_)
      if (m.building >= 0) index_.emplace(m.building, 0);
    int size = 7;
    for (auto& [building, place] : index_) place = size, size += 4;
    hessian_ = Eigen::MatrixXd::Zero(size, size);
    gradient_ = Eigen::VectorXd::Zero(size);
    cost_ = cost_count_ = tally_.missing;
    for (const Measurement& m : measurements_) {
      const double scaled = m.residual / (m.kernel * m.sigma);
      cost_ += m.count * tukeyCost(scaled);
      cost_count_ += m.count;
      const double w = m.count * tukeyWeight(scaled) / (m.sigma * m.sigma);
      if (w > 0) accumulate(m, w);
    }
  }

  void accumulate(const Measurement& m, double w) {
    hessian_.topLeftCorner<6, 6>() += w * m.pose * m.pose.transpose();
    gradient_.head<6>() += w * m.residual * m.pose;
    hessian_(kOverhang, kOverhang) += w * m.overhang * m.overhang;
    hessian_.block<6, 1>(0, kOverhang) += w * m.overhang * m.pose;
    hessian_.block<1, 6>(kOverhang, 0) += w * m.overhang * m.pose.transpose();
    gradient_(kOverhang) += w * m.residual * m.overhang;
    if (m.building < 0) return;
    const int k = index_.at(m.building);
    hessian_.block<6, 4>(0, k) += w * m.pose * m.error.transpose();
    hessian_.block<4, 6>(k, 0) += w * m.error * m.pose.transpose();
    hessian_.block<4, 4>(k, k) += w * m.error * m.error.transpose();
    gradient_.segment<4>(k) += w * m.residual * m.error;
    hessian_.block<4, 1>(k, kOverhang) += w * m.overhang * m.error;
    hessian_.block<1, 4>(kOverhang, k) += w * m.overhang * m.error.transpose();
  }

  void addPrior(int at, double value, double sigma) {
    hessian_(at, at) += 1 / (sigma * sigma);
    gradient_(at) += value / (sigma * sigma);
  }

  void addPriors() {
    addPrior(kOverhang, overhang_ - settings_.roof_overhang, settings_.roof_overhang_stddev);
    for (const auto& [building, k] : index_) {
      const Eigen::Vector4d error = errorOf(building);
      addPrior(k, error.x(), settings_.model_lateral_stddev);
      addPrior(k + 1, error.y(), settings_.model_lateral_stddev);
      addPrior(k + 2, error.z(), settings_.model_height_stddev);
      addPrior(k + 3, error.w(), 0.14 * settings_.model_lateral_stddev);
    }
    const Eigen::Vector3d off = position_ - T_world_geotag_.translation();
    addPrior(0, off.x(), settings_.geotag_stddev);
    addPrior(1, off.y(), settings_.geotag_stddev);
    const GroundGuess ground = settings_.camera_height > 0 ? model_.groundGuess(position_) : GroundGuess();
    if (ground.known || ground.guessed) {
      const double stddev =
          ground.known ? settings_.camera_height_stddev : std::hypot(settings_.camera_height_stddev, kFootStddev);
      addPrior(2, position_.z() - ground.height - settings_.camera_height, stddev);
    } else {
      addPrior(2, off.z(), settings_.height_stddev);
    }
    const Eigen::Vector3d up = R_.col(2);  // turns by d rot x up = (rotY, -rotX)
    addPrior(3, -up.y(), cues_.tilt_stddev);
    addPrior(4, up.x(), cues_.tilt_stddev);
    const double yaw = air_ground_common::yawOf(R_), yaw_geotag = air_ground_common::yawOf(T_world_geotag_.linear());
    addPrior(5, air_ground_common::wrapAngle(yaw - yaw_geotag), settings_.heading_stddev);
  }

  bool solve() {
    solver_.compute(hessian_);
    Eigen::VectorXd step = -solver_.solve(gradient_);
    if (!step.allFinite()) return false;
    const double longest = step.head<3>().norm();
    if (longest > 1.5) step *= 1.5 / longest;
    position_ += step.head<3>();
    R_ = air_ground_common::expSO3(step.segment<3>(3)) * R_;
    overhang_ += step(kOverhang);
    for (const auto& [building, k] : index_)
      errors_.emplace(building, Eigen::Vector4d::Zero()).first->second += step.segment<4>(k);
    return true;
  }

  const ModelOutline& model_;
  const std::vector<ModelEdge>& edges_;
  const ImageCues& cues_;
  const Pose T_world_geotag_;
  const RegistrationSettings& settings_;

  Eigen::Vector3d position_;               ///< in world
  Eigen::Matrix3d R_;                      ///< R_world_level
  double overhang_;                        ///< of the roofs [m]
  std::map<int, Eigen::Vector4d> errors_;  ///< by building: x, y, height [m], turn [rad]

  // Of the present step.
  std::vector<Measurement> measurements_;
  Tally tally_;
  std::map<int, int> index_;  ///< by building: first row of its errors
  Eigen::MatrixXd hessian_;
  Eigen::VectorXd gradient_;
  Eigen::LDLT<Eigen::MatrixXd> solver_;
  double cost_ = 0, cost_count_ = 0;
};

}  // namespace

Fit refinePose(const ModelOutline& model, const std::vector<ModelEdge>& edges, const ImageCues& cues,
               const Candidate& start, const Pose& T_world_geotag, const RegistrationSettings& settings) {
  PoseRefinement refinement(model, edges, cues, start, T_world_geotag, settings);
  for (const double window : {0.06, 0.05, 0.04, 0.03, 0.025, 0.02, 0.015, 0.012, 0.012, 0.012})
    if (!refinement.step(window)) return {};
  return refinement.fit();
}

}  // namespace streetview_localizer::registration
