#include "pose_solver.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

namespace streetview_localizer::registration {
namespace {

using air_ground_common::Pose;

constexpr int kBins = 720;

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

namespace {

/// The image's sky line where it is known: bins and elevations [rad].
struct SkyOfImage {
  std::vector<int> bin;
  std::vector<float> elevation;
};

SkyOfImage skyOf(const ImageCues& cues) {
  SkyOfImage sky;
  for (int i = 0; i < kBins; ++i) {
    if (std::isnan(cues.tangent[i])) continue;
    sky.bin.push_back(i);
    sky.elevation.push_back(std::atan(std::max(0.0f, cues.tangent[i])));
  }
  return sky;
}

/// Mean truncated difference of the elevations when the image is turned left by `turn` bins. `model`: two rounds of its
/// sky line, so that no bin wraps around.
double difference(const SkyOfImage& image, const std::vector<float>& model, int turn) {
  constexpr double kTruncation = 0.08;  // [rad]
  // A larger yaw looks to a larger azimuth: a smaller bin of the world.
  const float* turned = model.data() + ((-turn % kBins) + kBins) % kBins;
  double sum = 0;
  for (std::size_t i = 0; i < image.bin.size(); ++i)
    sum += std::min(kTruncation, static_cast<double>(std::abs(image.elevation[i] - turned[image.bin[i]])));
  return sum / std::max<std::size_t>(1, image.bin.size());
}

/// Of one place, the best heading and all others that are better than those around them.
void addHeadings(const Candidate& place, const std::vector<double>& costs, int first_turn,
                 std::vector<Candidate>* all) {
  const double bin = 2 * M_PI / kBins;
  const int apart = static_cast<int>(kOtherHeading / bin), count = static_cast<int>(costs.size());
  for (int i = 0; i < count; ++i) {
    const auto better = [&](int j) { return costs[j] < costs[i] || (costs[j] == costs[i] && j < i); };
    bool best = true;
    for (int j = std::max(0, i - apart); best && j < std::min(count, i + apart + 1); ++j) best = !better(j);
    if (!best) continue;
    Candidate candidate = place;
    candidate.cost = costs[i];
    candidate.yaw = (first_turn + i) * bin;
    all->push_back(candidate);
  }
}

/// The best that are no neighbours of a better one. A wider search meets more that look alike.
std::vector<Candidate> bestOf(std::vector<Candidate> all, const RegistrationSettings& settings) {
  const RegistrationSettings usual;
  const double wider = std::sqrt(settings.search_radius / usual.search_radius * settings.search_yaw / usual.search_yaw);
  const std::size_t most = static_cast<std::size_t>(8 * std::clamp(wider, 1.0, 3.0));
  std::sort(all.begin(), all.end(), [](const Candidate& a, const Candidate& b) { return a.cost < b.cost; });
  std::vector<Candidate> best;
  for (const Candidate& candidate : all) {
    const bool near = std::any_of(best.begin(), best.end(), [&](const Candidate& other) {
      return (other.position - candidate.position).head<2>().norm() < 1.3 &&
             std::abs(air_ground_common::wrapAngle(other.yaw - candidate.yaw)) < kOtherHeading;
    });
    if (!near) best.push_back(candidate);
    if (best.size() >= most) break;
  }
  return best;
}

}  // namespace

std::vector<Candidate> searchCandidates(const ModelOutline& model, const std::vector<ModelEdge>& edges,
                                        const ImageCues& cues, const Pose& T_world_geotag,
                                        const RegistrationSettings& settings) {
  constexpr double kGrid = 0.6;
  const double bin = 2 * M_PI / kBins;
  const int shifts = std::min(kBins / 2, static_cast<int>(std::ceil(settings.search_yaw / bin)));
  const double yaw = air_ground_common::yawOf(T_world_geotag.linear());
  // Bin i of the level image looks to azimuth_i + yaw in world: `turn` whole bins and a rest.
  const int cells = static_cast<int>(settings.search_radius / kGrid), whole = static_cast<int>(std::lround(yaw / bin));
  const SkyOfImage image = skyOf(cues);
  std::vector<Candidate> all;
  SkyProfile profile;
  std::vector<float> elevation(2 * kBins);
  std::vector<double> costs(2 * shifts + 1);
  for (int iy = -cells; iy <= cells; ++iy) {
    for (int ix = -cells; ix <= cells; ++ix) {
      if (std::hypot(ix, iy) * kGrid > settings.search_radius) continue;
      Candidate candidate;
      candidate.position = T_world_geotag.translation() + Eigen::Vector3d(ix * kGrid, iy * kGrid, 0);
      const GroundGuess ground = settings.camera_height > 0 ? model.groundGuess(candidate.position) : GroundGuess();
      if (ground.known || ground.guessed) candidate.position.z() = ground.height + settings.camera_height;
      if (model.insideBuilding(candidate.position)) continue;
      ModelOutline::skyProfile(edges, candidate.position, kBins, &profile);
      for (int i = 0; i < kBins; ++i) elevation[i] = elevation[i + kBins] = std::atan(profile.tangent[i]);
      const double distance = std::hypot(ix, iy) * kGrid / settings.geotag_stddev;
      for (int shift = -shifts; shift <= shifts; ++shift) {
        const double off = air_ground_common::wrapAngle((whole + shift) * bin - yaw) / settings.heading_stddev;
        costs[shift + shifts] =
            difference(image, elevation, whole + shift) + 0.0004 * (off * off + distance * distance);
      }
      addHeadings(candidate, costs, whole - shifts, &all);
    }
  }
  return bestOf(std::move(all), settings);
}

}  // namespace streetview_localizer::registration
