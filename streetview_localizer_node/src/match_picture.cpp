#include "streetview_localizer/match_picture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace streetview_localizer {
namespace {

constexpr int kCaption = 24;  // [px]

cv::Mat colourOf(const cv::Mat& image) {
  if (image.channels() == 3) return image;
  cv::Mat bgr;
  cv::cvtColor(image, bgr, cv::COLOR_GRAY2BGR);
  return bgr;
}

cv::Mat ofHeight(const cv::Mat& image, int height) {
  cv::Mat out;
  const int width = std::max(1, static_cast<int>(std::lround(static_cast<double>(image.cols) * height / image.rows)));
  cv::resize(colourOf(image), out, {width, height}, 0, 0, height < image.rows ? cv::INTER_AREA : cv::INTER_LINEAR);
  return out;
}

}  // namespace

cv::Mat drawMatch(const cv::Mat& image, const StreetviewDatabase& database, const LocalizerResult& result, int height,
                  int max_lines) {
  const cv::Mat left = ofHeight(image, height);
  int shown = result.view;
  if (shown < 0 && !result.views.empty()) shown = result.views.front();
  const cv::Mat view = shown >= 0 ? database.views[static_cast<std::size_t>(shown)].image : cv::Mat();
  const cv::Mat right =
      view.empty() ? cv::Mat(height, left.cols, CV_8UC3, cv::Scalar::all(60)) : ofHeight(view, height);
  cv::Mat canvas(height + kCaption, left.cols + right.cols, CV_8UC3, cv::Scalar::all(0));
  left.copyTo(canvas(cv::Rect(0, 0, left.cols, height)));
  right.copyTo(canvas(cv::Rect(left.cols, 0, right.cols, height)));
  if (!view.empty()) {
    const double scale_left = static_cast<double>(height) / image.rows,
                 scale_right = static_cast<double>(height) / view.rows;
    std::vector<int> good, bad;
    std::size_t next = 0;
    const auto& inliers = result.pose.inliers;  // ascending
    for (std::size_t i = 0; i < result.correspondences.size(); ++i) {
      while (next < inliers.size() && static_cast<std::size_t>(inliers[next]) < i) ++next;
      const bool inlier = next < inliers.size() && static_cast<std::size_t>(inliers[next]) == i;
      if (result.views[i] == shown) (inlier ? good : bad).push_back(static_cast<int>(i));
    }
    const auto draw = [&](const std::vector<int>& indices, const cv::Scalar& colour) {
      const std::size_t step = indices.size() / static_cast<std::size_t>(std::max(1, max_lines)) + 1;
      for (std::size_t k = 0; k < indices.size(); k += step) {
        const Correspondence& c = result.correspondences[static_cast<std::size_t>(indices[k])];
        const cv::Point2d a(scale_left * c.pixel.x(), scale_left * c.pixel.y());
        const cv::Point2d b(left.cols + scale_right * c.view_pixel.x(), scale_right * c.view_pixel.y());
        cv::line(canvas, a, b, colour, 1, cv::LINE_AA);
        cv::circle(canvas, a, 2, colour, cv::FILLED, cv::LINE_AA);
        cv::circle(canvas, b, 2, colour, cv::FILLED, cv::LINE_AA);
      }
    };
    draw(bad, {60, 60, 230});
    draw(good, {60, 220, 60});
  }
  std::string caption = nameOf(result.status);
  if (result.panorama >= 0) caption += ", " + database.panoramas[static_cast<std::size_t>(result.panorama)].id;
  if (result.pose.success) caption += ", " + std::to_string(result.pose.inliers.size()) + " inliers";
  if (!result.accepted()) caption += ": " + result.reason;
  cv::putText(canvas, caption, {6, height + 17}, cv::FONT_HERSHEY_SIMPLEX, 0.5,
              result.accepted() ? cv::Scalar(60, 220, 60) : cv::Scalar(80, 160, 255), 1, cv::LINE_AA);
  return canvas;
}

cv::Mat drawBeside(const cv::Mat& image, const cv::Mat& synthesized) {
  cv::Mat both;
  cv::hconcat(ofHeight(image, synthesized.rows), colourOf(synthesized), both);
  return both;
}

}  // namespace streetview_localizer
