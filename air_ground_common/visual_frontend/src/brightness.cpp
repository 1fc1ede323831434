#include "brightness.h"

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "air_ground_common/statistics.h"

namespace visual_frontend {
namespace {

constexpr double kLeap = 0.08;  // logarithm
constexpr double kDark = 4;     // [grey levels]; the brightness of a darker image is noise

bool leaps(double ratio) { return std::abs(std::log(ratio)) >= kLeap; }

}  // namespace

double brightnessLeap(const cv::Mat& before, const cv::Mat& now) {
  const double mean_before = cv::mean(before)[0], mean_now = cv::mean(now)[0];
  if (mean_before < kDark || mean_now < kDark || !leaps(mean_now / mean_before)) return 1;
  const cv::Size parts(32, 24);
  cv::Mat parts_before, parts_now;
  cv::resize(before, parts_before, parts, 0, 0, cv::INTER_AREA);
  cv::resize(now, parts_now, parts, 0, 0, cv::INTER_AREA);
  std::vector<double> ratios;
  for (int i = 0; i < parts.area(); ++i) ratios.push_back((1.0 + parts_now.data[i]) / (1.0 + parts_before.data[i]));
  const double leap = air_ground_common::median(std::move(ratios));
  return leaps(leap) ? leap : 1;
}

}  // namespace visual_frontend
