#include "air_ground_common/trajectory.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iomanip>
#include <sstream>
#include <stdexcept>

#include "air_ground_common/atomic_file.h"
#include "air_ground_common/statistics.h"

namespace air_ground_common {
namespace {

const std::string kUnit = "# unit: ", kStamp = "# stamp[s]";  // begins of files that writeTum writes

bool beginsWithUnit(const std::string& path) {
  std::string line;
  std::ifstream file(path);
  return std::getline(file, line) && line.rfind(kUnit, 0) == 0;
}

}  // namespace

Trajectory readTum(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot open trajectory " + path);
  Trajectory trajectory;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    const auto start = line.find_first_not_of(" \t\r");
    if (start == std::string::npos || line[start] == '#') continue;
    std::istringstream fields(line);
    double s, x, y, z, qx, qy, qz, qw;
    const std::string where = path + ":" + std::to_string(number);
    if (!(fields >> s >> x >> y >> z >> qx >> qy >> qz >> qw))
      throw std::runtime_error(where + ": expected 'stamp tx ty tz qx qy qz qw'");
    Eigen::Quaterniond q(qw, qx, qy, qz);
    if (std::abs(q.norm() - 1) > 0.01) throw std::runtime_error(where + ": the quaternion is not of unit length");
    if (!trajectory.empty() && s <= trajectory.back().stamp) throw std::runtime_error(where + ": stamps must increase");
    StampedPose p;
    p.stamp = s;
    p.T_map_body.linear() = q.normalized().toRotationMatrix();
    p.T_map_body.translation() << x, y, z;
    trajectory.push_back(p);
  }
  return trajectory;
}

void writeTum(const std::string& path, const Trajectory& trajectory, const std::string& unit) {
  const std::string header =
      unit.empty() ? kStamp + " tx ty tz[m] qx qy qz qw\n" : kUnit + unit + "\n" + kStamp + " tx ty tz qx qy qz qw\n";
  const auto body = [&](std::ostream& file) {
    file << header << std::fixed << std::setprecision(9);
    for (const auto& p : trajectory) {
      const Eigen::Quaterniond q(p.T_map_body.linear());
      const Eigen::Vector3d t = p.T_map_body.translation();
      file << p.stamp << ' ' << t.x() << ' ' << t.y() << ' ' << t.z() << ' ' << q.x() << ' ' << q.y() << ' ' << q.z()
           << ' ' << q.w() << '\n';
    }
  };
  writeAtomically(path, body, beginsWithUnit(path) ? kUnit : kStamp);
}

std::optional<Pose> poseAt(const Trajectory& trajectory, double stamp, double max_gap) {
  const auto after = std::lower_bound(trajectory.begin(), trajectory.end(), stamp,
                                      [](const StampedPose& p, double s) { return p.stamp < s; });
  if (after == trajectory.end()) return std::nullopt;
  if (after->stamp == stamp) return after->T_map_body;
  if (after == trajectory.begin()) return std::nullopt;
  const auto before = std::prev(after);
  const double gap = after->stamp - before->stamp;
  if (gap > max_gap) return std::nullopt;
  return interpolate(before->T_map_body, after->T_map_body, (stamp - before->stamp) / gap);
}

double pathLength(const Trajectory& trajectory) {
  double length = 0;
  for (std::size_t i = 1; i < trajectory.size(); ++i)
    length += (trajectory[i].T_map_body.translation() - trajectory[i - 1].T_map_body.translation()).norm();
  return length;
}

Similarity alignPoints(const std::vector<Eigen::Vector3d>& reference, const std::vector<Eigen::Vector3d>& estimate,
                       Alignment alignment) {
  Similarity result;
  if (reference.size() != estimate.size()) throw std::invalid_argument("alignPoints: the point lists differ in size");
  if (alignment == Alignment::kNone) return result;
  const std::size_t least = alignment == Alignment::kYawTranslation ? 2 : 3;
  if (reference.size() < least) throw std::invalid_argument("alignPoints: too few points");
  const double n = static_cast<double>(reference.size());
  Eigen::Vector3d mean_r = Eigen::Vector3d::Zero(), mean_e = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < reference.size(); ++i) {
    mean_r += reference[i] / n;
    mean_e += estimate[i] / n;
  }
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  double variance_e = 0;
  for (std::size_t i = 0; i < reference.size(); ++i) {
    covariance += (reference[i] - mean_r) * (estimate[i] - mean_e).transpose() / n;
    variance_e += (estimate[i] - mean_e).squaredNorm() / n;
  }
  if (alignment == Alignment::kYawTranslation) {
    const double yaw = std::atan2(covariance(1, 0) - covariance(0, 1), covariance(0, 0) + covariance(1, 1));
    result.R = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  } else {
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(covariance, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Eigen::Vector3d sign(1, 1, 1);
    if (svd.matrixU().determinant() * svd.matrixV().determinant() < 0) sign.z() = -1;
    result.R = svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
    if (alignment == Alignment::kSimilarity && variance_e > 0)
      result.scale = svd.singularValues().dot(sign) / variance_e;
  }
  result.t = mean_r - result.scale * result.R * mean_e;
  return result;
}

TrajectoryError absoluteTrajectoryError(const Trajectory& reference, const Trajectory& estimate, Alignment alignment) {
  std::vector<Eigen::Vector3d> r, e;
  for (const auto& p : estimate)
    if (const auto T = poseAt(reference, p.stamp)) {
      r.push_back(T->translation());
      e.push_back(p.T_map_body.translation());
    }
  if (r.size() < 3) throw std::invalid_argument("absoluteTrajectoryError: fewer than 3 poses overlap in time");
  TrajectoryError error;
  error.pairs = r.size();
  error.reference_from_estimate = alignPoints(r, e, alignment);
  std::vector<double> distances(r.size());
  double sum = 0, sum2 = 0;
  for (std::size_t i = 0; i < r.size(); ++i) {
    distances[i] = (r[i] - error.reference_from_estimate * e[i]).norm();
    sum += distances[i];
    sum2 += distances[i] * distances[i];
    if (i > 0) error.path_length += (r[i] - r[i - 1]).norm();
  }
  error.mean = sum / r.size();
  error.rmse = std::sqrt(sum2 / r.size());
  error.median = median(distances);
  error.max = *std::max_element(distances.begin(), distances.end());
  return error;
}

}  // namespace air_ground_common
