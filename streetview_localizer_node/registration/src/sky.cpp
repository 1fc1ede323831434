#include "sky.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

#include "air_ground_common/statistics.h"

namespace streetview_localizer::registration {
namespace {

constexpr int kL = 16, kA = 16, kB = 16, kTexture = 4;
constexpr int kBins = kL * kA * kB * kTexture;

int binOf(const cv::Vec3b& lab, int texture) {
  const int l = lab[0] / 16, a = std::clamp((lab[1] - 96) / 4, 0, kA - 1), b = std::clamp((lab[2] - 96) / 4, 0, kB - 1);
  return ((l * kA + a) * kB + b) * kTexture + texture;
}

/// Spreads each count over its neighbours (1 2 1) along one axis.
void smoothAxis(std::vector<float>* histogram, int size, int stride) {
  std::vector<float> old = *histogram;
  for (int i = 0; i < kBins; ++i) {
    const int k = i / stride % size;
    const float low = k > 0 ? old[i - stride] : old[i], high = k + 1 < size ? old[i + stride] : old[i];
    (*histogram)[i] = 0.5f * old[i] + 0.25f * (low + high);
  }
}

struct Columns {  // what the path search needs, rows [0, rows)
  int width = 0, rows = 0;
  std::vector<float> gain;  ///< row-major (rows + 1) x width: benefit of ending the sky at this row
};

/// The best closed path: row of each column; `step` a row of jump costs, at most `limit`.
std::vector<int> bestPath(const Columns& columns, float step, float limit) {
  const int width = columns.width, states = columns.rows + 1;
  std::vector<float> value(states, 0.0f), next(states);
  std::vector<std::int16_t> from(static_cast<std::size_t>(2 * width) * states);
  std::vector<int> origin(states);
  // Twice around: the second lap starts with what the first has learned, and closes the ring.
  for (int lap = 0; lap < 2 * width; ++lap) {
    const int u = lap % width;
    const int best = static_cast<int>(std::max_element(value.begin(), value.end()) - value.begin());
    const float jump = value[best] - limit;
    for (int v = 0; v < states; ++v) origin[v] = v;
    next = value;
    for (int v = 1; v < states; ++v) {
      if (next[v - 1] - step > next[v]) next[v] = next[v - 1] - step, origin[v] = origin[v - 1];
    }
    for (int v = states - 2; v >= 0; --v) {
      if (next[v + 1] - step > next[v]) next[v] = next[v + 1] - step, origin[v] = origin[v + 1];
    }
    std::int16_t* trace = &from[static_cast<std::size_t>(lap) * states];
    for (int v = 0; v < states; ++v) {
      if (jump > next[v]) next[v] = jump, origin[v] = best;
      trace[v] = static_cast<std::int16_t>(origin[v]);
      value[v] = next[v] + columns.gain[static_cast<std::size_t>(v) * width + u];
    }
  }
  std::vector<int> path(width);
  int v = static_cast<int>(std::max_element(value.begin(), value.end()) - value.begin());
  for (int lap = 2 * width - 1; lap >= width / 2; --lap) {
    // The middle of the two laps: away from both ends.
    path[lap % width] = (lap < width + width / 2) || lap >= 2 * width - (width - width / 2) ? v : path[lap % width];
    v = from[static_cast<std::size_t>(lap) * states + v];
  }
  return path;
}

/// Colour and gradient of an image at working size, and what counts as an edge in it.
class SkyImage {
 public:
  static constexpr int kBorder = 8;  // the ring is closed for the filters [px]

  SkyImage(const cv::Mat& bgr, const cv::Mat& mask)
      : width(std::min(1024, bgr.cols)),
        height(width / 2),
        degree(height / 180.0),
        rows(static_cast<int>(92 * degree)) {
    cv::Mat small;
    cv::resize(bgr, small, {width, height}, 0, 0, cv::INTER_AREA);
    if (!mask.empty()) cv::resize(mask, valid_, {width, height}, 0, 0, cv::INTER_AREA);
    cv::copyMakeBorder(small, small, 0, 0, kBorder, kBorder, cv::BORDER_WRAP);
    cv::GaussianBlur(small, small, {0, 0}, 0.7);
    cv::cvtColor(small, lab_, cv::COLOR_BGR2Lab);
    // Change of colour a pixel, in the channel where it is largest.
    gradient_ = cv::Mat::zeros(small.size(), CV_32F);
    std::vector<cv::Mat> channels;
    cv::split(lab_, channels);
    for (const auto& channel : channels) {
      cv::Mat gx, gy, magnitude;
      cv::Scharr(channel, gx, CV_32F, 1, 0, 1.0 / 32);
      cv::Scharr(channel, gy, CV_32F, 0, 1, 1.0 / 32);
      cv::magnitude(gx, gy, magnitude);
      cv::max(gradient_, magnitude, gradient_);
    }
  }

  /// The noise of the smooth half of the upper image sets what counts as an edge. False: too little to tell.
  bool measureNoise() {
    std::vector<float> sample;
    for (int v = static_cast<int>(5 * degree); v < rows; v += 2)
      for (int u = 0; u < width; u += 2)
        if (isValid(v, u)) sample.push_back(gradient(v, u));
    if (sample.size() < 500) return false;
    noise = std::max(0.7f, air_ground_common::quantile(std::move(sample), 0.25));
    return true;
  }

  bool isValid(int v, int u) const { return valid_.empty() || valid_.at<std::uint8_t>(v, u) == 255; }
  float gradient(int v, int u) const { return gradient_.at<float>(v, u + kBorder); }

  /// Of colour and texture, for each pixel of the upper rows.
  std::vector<int> bins() const {
    std::vector<int> bins(static_cast<std::size_t>(rows) * width);
    for (int v = 0; v < rows; ++v)
      for (int u = 0; u < width; ++u) {
        const float g = gradient(v, u) / noise;
        const int texture = g < 2 ? 0 : g < 4 ? 1 : g < 8 ? 2 : 3;
        bins[static_cast<std::size_t>(v) * width + u] = binOf(lab_.at<cv::Vec3b>(v, u + kBorder), texture);
      }
    return bins;
  }

  const int width, height;
  const double degree;  ///< [px]
  const int rows;       ///< down to 2 degrees below the horizon
  float noise = 0;      ///< of the gradient

 private:
  cv::Mat lab_, gradient_, valid_;
};

/// First guess: the sky reaches down to the first strong edge of a column.
std::vector<int> firstEdges(const SkyImage& image) {
  std::vector<int> path(image.width);
  for (int u = 0; u < image.width; ++u) {
    int v = static_cast<int>(8 * image.degree);
    while (v < image.rows && (!image.isValid(v, u) || image.gradient(v, u) < 6 * image.noise + 3)) ++v;
    path[u] = std::min(v, static_cast<int>(85 * image.degree));
  }
  return path;
}

/// Logarithm of how much likelier each bin is above the path than below it; empty where there is next to nothing above
/// it.
std::vector<float> likelihoodRatio(const SkyImage& image, const std::vector<int>& bins, const std::vector<int>& path) {
  std::vector<float> sky(kBins, 0.0f), other(kBins, 0.0f);
  for (int v = 0; v < image.rows; ++v) {
    // Rows near the poles hold many pixels of little area.
    const float area = static_cast<float>(std::max(0.05, std::sin((v + 0.5) / image.height * M_PI)));
    for (int u = 0; u < image.width; ++u)
      if (image.isValid(v, u)) (v < path[u] ? sky : other)[bins[static_cast<std::size_t>(v) * image.width + u]] += area;
  }
  double sky_sum = 0, other_sum = 0;
  for (auto* histogram : {&sky, &other}) {
    smoothAxis(histogram, kB, kTexture);
    smoothAxis(histogram, kA, kTexture * kB);
    smoothAxis(histogram, kL, kTexture * kB * kA);
    double& sum = histogram == &sky ? sky_sum : other_sum;
    for (const float count : *histogram) sum += count;
  }
  if (sky_sum < 500 * image.degree) return {};
  std::vector<float> ratio(kBins);
  for (int i = 0; i < kBins; ++i) {
    const double s = (sky[i] + 0.3) / (sky_sum + 0.3 * kBins), o = (other[i] + 0.3) / (other_sum + 0.3 * kBins);
    ratio[i] = static_cast<float>(std::clamp(std::log(s / o), -2.5, 2.5));
  }
  return ratio;
}

/// Benefit of ending the sky at each row: colours above it, and the edge that lies there.
Columns gains(const SkyImage& image, const std::vector<int>& bins, const std::vector<float>& ratio) {
  Columns columns;
  columns.width = image.width;
  columns.rows = image.rows;
  columns.gain.assign(static_cast<std::size_t>(image.rows + 1) * image.width, 0.0f);
  for (int u = 0; u < image.width; ++u) {
    float sum = 0;
    for (int v = 0; v <= image.rows; ++v) {
      // An edge is worth as much as a few pixels of colour.
      const int at = std::min(v, image.rows - 1);
      const float g = image.gradient(at, u);
      const float edge = std::min(1.0f, std::max(0.0f, g / (8 * image.noise) - 0.3f));
      // The ridge of the gradient, not its flanks: the line must not keep away from the roof.
      const bool ridge = at > 0 && g >= image.gradient(at - 1, u) && g >= image.gradient(at + 1, u);
      columns.gain[static_cast<std::size_t>(v) * image.width + u] =
          image.isValid(at, u) ? sum + (ridge ? 7 : 4) * edge : 0;
      if (v < image.rows && image.isValid(v, u)) sum += ratio[bins[static_cast<std::size_t>(v) * image.width + u]];
    }
  }
  return columns;
}

/// The sky of the columns that the image shows reaches down by 8 degrees on the average.
bool reachesDown(const SkyImage& image, const std::vector<int>& path) {
  double area = 0;
  int columns_valid = 0;
  for (int u = 0; u < image.width; ++u) {
    if (!image.isValid(std::min(path[u], image.height - 1), u)) continue;
    ++columns_valid;
    area += path[u] / image.degree;
  }
  return columns_valid > 0 && area / columns_valid >= 8;
}

/// Row, with a fraction, of the strongest change of colour along a column of the full image, within `reach` of
/// `centre`.
double refinedRow(const cv::Mat& lab, int u, double centre, int reach, float noise) {
  const int low = std::max(1, static_cast<int>(centre) - reach);
  const int high = std::min(lab.rows - 3, static_cast<int>(centre) + reach + 1);
  std::vector<float> change(std::max(0, high - low + 1));
  int best = -1;
  for (int v = low; v <= high; ++v) {
    const auto& a = lab.at<cv::Vec3b>(v, u);
    const auto& b = lab.at<cv::Vec3b>(v + 1, u);
    float sum = 0;
    for (int c = 0; c < 3; ++c) sum += std::abs(static_cast<float>(a[c]) - b[c]);
    change[v - low] = sum;
    if (best < 0 || sum > change[best]) best = v - low;
  }
  if (best <= 0 || best + 1 >= static_cast<int>(change.size()) || change[best] <= 3 * noise) return centre;
  const float a = change[best - 1], b = change[best], c = change[best + 1], curvature = a + c - 2 * b;
  return low + best + 0.5 + (curvature < 0 ? 0.5f * (a - c) / curvature : 0.0f);
}

/// To the full resolution, within a pixel and a half of the small image.
std::vector<float> atFullSize(const cv::Mat& bgr, const SkyImage& image, const std::vector<int>& path) {
  const double factor = static_cast<double>(bgr.cols) / image.width;
  cv::Mat lab;
  cv::cvtColor(bgr, lab, cv::COLOR_BGR2Lab);
  cv::GaussianBlur(lab, lab, {0, 0}, 0.6);
  std::vector<float> row(bgr.cols, std::numeric_limits<float>::quiet_NaN());
  for (int u = 0; u < bgr.cols; ++u) {
    const int us = std::min(image.width - 1, static_cast<int>((u + 0.5) / factor));
    // Of a photograph: where no sky is seen above it, the line lies beyond the image.
    if (!image.isValid(std::min(path[us], image.height - 1), us) || !image.isValid(std::max(0, path[us] - 3), us))
      continue;
    const double centre = path[us] * factor - 0.5;  // the line runs between two pixels
    const int reach = static_cast<int>(std::ceil(3 * factor));
    row[u] = static_cast<float>(refinedRow(lab, u, centre, reach, image.noise));
  }
  return row;
}

}  // namespace

SkyLine findSkyLine(const cv::Mat& bgr, const cv::Mat& mask) {
  SkyLine result;
  SkyImage image(bgr, mask);
  if (!image.measureNoise()) {
    result.failure = "too little of the image lies above the horizon";
    return result;
  }
  const std::vector<int> bins = image.bins();
  std::vector<int> path = firstEdges(image);
  for (int round = 0; round < 4; ++round) {
    const std::vector<float> ratio = likelihoodRatio(image, bins, path);
    if (ratio.empty()) {
      result.failure = "no sky found";
      return result;
    }
    path = bestPath(gains(image, bins, ratio), 0.4f, 25.0f);
  }
  if (!reachesDown(image, path)) {
    result.failure = "no sky found";
    return result;
  }
  result.row = atFullSize(bgr, image, path);
  return result;
}

}  // namespace streetview_localizer::registration
