#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "streetview_localizer/neighbour_check.h"

namespace streetview_localizer {
namespace {

using air_ground_common::Pose;
using Kind = NeighbourVerdict::Kind;

double apart(const Pose& a, const Pose& b) { return (a.translation() - b.translation()).head<2>().norm(); }

/// Where a neighbour places an image, and how well that is known without the image's own pose.
struct Prediction {
  int from = 0;
  Pose T_world = Pose::Identity();
  Eigen::Matrix2d in_plan = Eigen::Matrix2d::Zero();  ///< covariance [m^2]
  double angle_variance = 0;                          ///< [rad^2]
};

class Jury {
 public:
  Jury(const std::vector<NeighbourImage>& images, const std::vector<NeighbourEdge>& edges, const NeighbourSettings& s)
      : images_(images),
        edges_(edges),
        s_(s),
        edges_of_(images.size()),
        heard_(images.size()),
        opinions_(images.size()),
        margins_(images.size(), 0) {
    for (std::size_t i = 0; i < images.size(); ++i) heard_[i] = images[i].registered;
    for (std::size_t e = 0; e < edges.size(); ++e)
      for (const int i : {edges[e].a, edges[e].b}) edges_of_[i].push_back(static_cast<int>(e));
  }

  std::vector<NeighbourVerdict> judge() {
    const int count = static_cast<int>(images_.size());
    std::vector<NeighbourVerdict> verdicts(images_.size());
    for (int i = 0; i < count; ++i) hear(i);
    for (int worst = mostContradicted(); worst >= 0; worst = mostContradicted()) {
      verdicts[worst] = opinions_[worst].verdict;
      verdicts[worst].kind = Kind::kContradicted;
      heard_[worst] = false;
      margins_[worst] = 0;
      for (const int e : edges_of_[worst]) hear(edges_[e].a == worst ? edges_[e].b : edges_[e].a);
    }
    for (int i = 0; i < count; ++i) {
      if (images_[i].fixed || verdicts[i].kind == Kind::kContradicted) continue;
      const Opinion o = opinionOf(i, s_.sigmas_alone);
      const int against = static_cast<int>(o.verdict.witnesses.size());
      if (images_[i].registered ? against <= o.supporters : against < 2) continue;
      verdicts[i] = o.verdict;
      verdicts[i].kind = images_[i].registered ? Kind::kDoubtful : Kind::kPlaced;
    }
    return verdicts;
  }

 private:
  struct Opinion {
    NeighbourVerdict verdict;  ///< of the most that place it elsewhere and agree among themselves
    int supporters = 0;
  };

  /// Standard deviations of an image's position [m] and angles [rad]: what is stated, but no less than the floors.
  std::pair<double, double> knownTo(const NeighbourImage& image) const {
    return {std::max(s_.position_floor, image.position_stddev), std::max(s_.angle_floor, image.orientation_stddev)};
  }

  std::vector<Prediction> predictionsOf(int image) const {
    std::vector<Prediction> predictions;
    for (const int e : edges_of_[image]) {
      const NeighbourEdge& edge = edges_[e];
      const bool forward = edge.b == image;
      Prediction p;
      p.from = forward ? edge.a : edge.b;
      if (!heard_[p.from]) continue;
      const NeighbourImage& other = images_[p.from];
      p.T_world = other.T_world_image * (forward ? edge.T_a_b : edge.T_a_b.inverse());
      const Eigen::Matrix3d R = (forward ? other.T_world_image : p.T_world).linear();  // of a, whose axes the edge has
      p.in_plan = (R * edge.covariance.topLeftCorner<3, 3>() * R.transpose()).topLeftCorner<2, 2>();
      const auto [own, own_angle] = knownTo(other);
      const double baseline = apart(p.T_world, other.T_world_image),
                   turn = edge.covariance.bottomRightCorner<3, 3>().trace() / 3 + s_.measured_angle * s_.measured_angle;
      p.in_plan += Eigen::Matrix2d::Identity() * (own * own + s_.measured_position * s_.measured_position +
                                                  baseline * baseline * (own_angle * own_angle + turn));
      p.angle_variance = own_angle * own_angle + turn;
      predictions.push_back(p);
    }
    return predictions;
  }

  bool contradicts(const Prediction& p, const NeighbourImage& image, double sigmas) const {
    const auto [own, own_angle] = knownTo(image);
    const Eigen::Vector2d off = (p.T_world.translation() - image.T_world_image.translation()).head<2>();
    const Eigen::Matrix2d covariance = p.in_plan + own * own * Eigen::Matrix2d::Identity();
    const double turn = air_ground_common::rotationAngle(p.T_world.linear(), image.T_world_image.linear());
    return (off.norm() > s_.position && off.dot(covariance.ldlt().solve(off)) > sigmas * sigmas) ||
           (turn > s_.angle && turn > sigmas * std::sqrt(p.angle_variance + own_angle * own_angle));
  }

  /// Asks the neighbours of an image that has a say.
  void hear(int image) {
    if (!heard_[image]) return;
    opinions_[image] = opinionOf(image, s_.sigmas);
    const int against = static_cast<int>(opinions_[image].verdict.witnesses.size());
    margins_[image] = against < 2 ? 0 : std::max(0, against - opinions_[image].supporters - 1);
  }

  /// -1 where none is. A witness that is contradicted as much is none: between two equally wrong ones stands a right
  /// one.
  int mostContradicted() const {
    int worst = -1, largest = 0;
    for (int i = 0; i < static_cast<int>(images_.size()); ++i) {
      if (images_[i].fixed || margins_[i] <= largest) continue;
      const std::vector<int>& witnesses = opinions_[i].verdict.witnesses;
      const auto credible = static_cast<int>(
          std::count_if(witnesses.begin(), witnesses.end(), [&](int w) { return margins_[w] < margins_[i]; }));
      if (credible < 2 || credible <= opinions_[i].supporters + 1) continue;
      worst = i, largest = margins_[i];
    }
    return worst;
  }

  Opinion opinionOf(int image, double sigmas) const {
    const NeighbourImage& own = images_[image];
    Opinion opinion;
    std::vector<Prediction> against;
    for (const Prediction& p : predictionsOf(image)) {
      if (!own.registered || contradicts(p, own, sigmas))
        against.push_back(p);
      else if (agrees(p.T_world, own.T_world_image, s_))
        ++opinion.supporters;
    }
    std::vector<Prediction> most;
    for (const Prediction& centre : against) {
      std::vector<Prediction> group;
      for (const Prediction& p : against)
        if (apart(p.T_world, centre.T_world) < s_.position &&
            air_ground_common::rotationAngle(p.T_world.linear(), centre.T_world.linear()) < 2 * s_.angle)
          group.push_back(p);
      if (group.size() > most.size()) most = group;
    }
    if (most.empty()) return opinion;
    Eigen::Vector3d place = Eigen::Vector3d::Zero(), turn = Eigen::Vector3d::Zero();
    for (const Prediction& p : most) {
      opinion.verdict.witnesses.push_back(p.from);
      place += p.T_world.translation() / static_cast<double>(most.size());
      turn += air_ground_common::logSO3(p.T_world.linear() * most[0].T_world.linear().transpose()) /
              static_cast<double>(most.size());
    }
    opinion.verdict.T_world_image.translation() = place;
    opinion.verdict.T_world_image.linear() = air_ground_common::expSO3(turn) * most[0].T_world.linear();
    return opinion;
  }

  const std::vector<NeighbourImage>& images_;
  const std::vector<NeighbourEdge>& edges_;
  const NeighbourSettings& s_;
  std::vector<std::vector<int>> edges_of_;
  std::vector<bool> heard_;        ///< registered, and not contradicted
  std::vector<Opinion> opinions_;  ///< of those
  std::vector<int> margins_;       ///< by how many votes they are contradicted; 0 where they are not
};

}  // namespace

bool agrees(const Pose& T_world_a, const Pose& T_world_b, const NeighbourSettings& settings) {
  return apart(T_world_a, T_world_b) < settings.position &&
         air_ground_common::rotationAngle(T_world_a.linear(), T_world_b.linear()) < settings.angle;
}

std::vector<NeighbourVerdict> judgeNeighbours(const std::vector<NeighbourImage>& images,
                                              const std::vector<NeighbourEdge>& edges,
                                              const NeighbourSettings& settings) {
  return Jury(images, edges, settings).judge();
}

RegistrationSettings aroundNeighbours(RegistrationSettings r, const NeighbourSettings& settings) {
  r.search_radius = settings.search_radius;
  r.search_yaw = settings.search_yaw;
  r.geotag_stddev = std::min(r.geotag_stddev, 0.25);
  r.height_stddev = std::min(r.height_stddev, 0.5);
  r.heading_stddev = std::min(r.heading_stddev, settings.angle);
  r.tilt_stddev = std::min(r.tilt_stddev, settings.angle);
  return r;
}

}  // namespace streetview_localizer
