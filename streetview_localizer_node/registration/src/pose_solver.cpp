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

}  // namespace streetview_localizer::registration
