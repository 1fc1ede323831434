#include "brightness.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "air_ground_common/statistics.h"

namespace visual_frontend {
namespace {

using air_ground_common::median;

constexpr double kLeap = 0.08;           // logarithm
constexpr double kDark = 4;              // [grey levels]; the brightness of a darker image is noise
constexpr int kBands = 24, kParts = 32;  // of an image's rows, and of such a band
constexpr double kChi2OfBands = 51.2;    // kBands degrees of freedom, 99.9 %
constexpr double kNormalMad = 1.4826;    // standard deviation over median absolute deviation
constexpr double kMedianNoise = 1.2533;  // standard deviation of a median over that of a mean
constexpr double kLeastNoise = 0.01;     // of a part's logarithm

struct Spread {
  double middle, sigma;  ///< of the middle
};

Spread medianOf(const std::vector<double>& values) {
  const double middle = median(values);
  std::vector<double> distances;
  for (const double v : values) distances.push_back(std::abs(v - middle));
  const double sigma = std::max(kLeastNoise, kNormalMad * median(std::move(distances)));
  return {middle, kMedianNoise * sigma / std::sqrt(static_cast<double>(values.size()))};
}

/// Less noise, hardly less amplitude: what smoothing takes away is added once.
cv::Mat smoothed(const cv::Mat& bands) {
  cv::Mat once, twice;
  const auto smooth = [](const cv::Mat& from, cv::Mat* to) {
    cv::GaussianBlur(from, *to, cv::Size(1, 3), 0, 0.85, cv::BORDER_REPLICATE);
  };
  smooth(bands, &once);
  smooth(once, &twice);
  return 2 * once - twice;
}

}  // namespace

cv::Mat brightnessLeap(const cv::Mat& before, const cv::Mat& now) {
  if (cv::mean(before)[0] < kDark || cv::mean(now)[0] < kDark) return {};
  const cv::Size parts(kParts, kBands);
  cv::Mat parts_before, parts_now;
  cv::resize(before, parts_before, parts, 0, 0, cv::INTER_AREA);
  cv::resize(now, parts_now, parts, 0, 0, cv::INTER_AREA);
  std::vector<double> all;
  for (int i = 0; i < parts.area(); ++i)
    all.push_back(std::log((1.0 + parts_now.data[i]) / (1.0 + parts_before.data[i])));
  const double whole = median(all);
  cv::Mat bands(kBands, 1, CV_32F, cv::Scalar(whole));
  double chi2 = 0;
  for (int b = 0; b < kBands; ++b) {
    const Spread band = medianOf({all.begin() + b * kParts, all.begin() + (b + 1) * kParts});
    chi2 += (band.middle - whole) * (band.middle - whole) / (band.sigma * band.sigma);
    bands.at<float>(b) = static_cast<float>(band.middle);
  }
  if (chi2 < kChi2OfBands) bands = whole;  // the rows do not differ
  bands = smoothed(bands);
  if (cv::norm(bands, cv::NORM_INF) < kLeap) return {};
  cv::Mat rows(now.rows, 1, CV_32F);
  for (int r = 0; r < rows.rows; ++r) {
    const float at = (static_cast<float>(r) + 0.5f) * kBands / static_cast<float>(rows.rows) - 0.5f;
    const int b = std::clamp(static_cast<int>(at), 0, kBands - 2);
    const float share = at - static_cast<float>(b);  // beyond the outermost bands' middles as between the last two
    rows.at<float>(r) = std::exp((1 - share) * bands.at<float>(b) + share * bands.at<float>(b + 1));
  }
  return rows;
}

cv::Mat brightened(const cv::Mat& image, const cv::Mat& gain_of_rows) {
  cv::Mat result(image.size(), CV_8U);
  for (int r = 0; r < image.rows; ++r) image.row(r).convertTo(result.row(r), CV_8U, gain_of_rows.at<float>(r));
  return result;
}

}  // namespace visual_frontend
