#include "rgbd_slam/depth_model.h"

#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"

namespace rgbd_slam {

void DepthModel::validate() const {
  if (!(sigma_base > 0)) throw std::invalid_argument("DepthModel::sigma_base must be positive");
  if (!(sigma_quadratic >= 0)) throw std::invalid_argument("DepthModel::sigma_quadratic must not be negative");
  if (!(min_range > 0 && max_range > min_range))
    throw std::invalid_argument("DepthModel needs 0 < min_range < max_range");
}

std::optional<double> sampleDepth(const cv::Mat& depth, const Eigen::Vector2d& pixel, const DepthModel& model) {
  const int u = static_cast<int>(std::lround(pixel.x())), v = static_cast<int>(std::lround(pixel.y()));
  if (u < 1 || v < 1 || u >= depth.cols - 1 || v >= depth.rows - 1) return std::nullopt;
  float values[9];
  int count = 0;
  for (int y = v - 1; y <= v + 1; ++y) {
    const float* row = depth.ptr<float>(y);
    for (int x = u - 1; x <= u + 1; ++x) {
      if (!std::isfinite(row[x]) || row[x] <= 0) continue;
      int i = count++;  // insertion: the list stays sorted
      for (; i > 0 && values[i - 1] > row[x]; --i) values[i] = values[i - 1];
      values[i] = row[x];
    }
  }
  if (count < 5) return std::nullopt;
  const double z = values[count / 2];
  if (z < model.min_range || z > model.max_range) return std::nullopt;
  if (values[count - 1] - values[0] > 4 * model.sigma(z) + 0.02 * z) return std::nullopt;
  return z;
}

double medianDepth(const cv::Mat& depth) {
  constexpr int kStride = 7;
  constexpr std::size_t kEnough = 50;
  std::vector<float> known;
  for (int v = 0; v < depth.rows; v += kStride)
    for (int u = 0; u < depth.cols; u += kStride)
      if (const float z = depth.at<float>(v, u); isKnown(z)) known.push_back(z);
  if (known.size() < kEnough) return std::numeric_limits<double>::quiet_NaN();
  return air_ground_common::median(std::move(known));
}

std::string unitProblem(double median) {
  constexpr double kNear = 0.03, kFar = 100;  // [m]; a wrong unit is wrong by a thousand
  if (std::isnan(median) || (median > kNear && median < kFar)) return "";
  return air_ground_common::formatted(
      "the depth images are in a wrong unit: their median is %.4g m; 32FC1 must hold metres, 16UC1 millimetres or "
      "steps "
      "of depth_unit",
      median);
}

}  // namespace rgbd_slam
