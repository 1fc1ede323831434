#include "streetview_localizer/features.h"

#include <algorithm>
#include <cmath>
#include <opencv2/features2d.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "halved_features.h"

namespace streetview_localizer {
namespace {

constexpr int kMinimumSize = 32;  // [px]; OpenCV's SIFT has no octave left below

// OpenCV's SIFT always detects in the doubled image, made by a bilinear resize that puts pixel x at 2 x + 0.5, yet
// divides the keypoints' coordinates by 2: they come out a quarter of a pixel too far right and down.
constexpr float kDoublingShift = 0.25f;

cv::Mat toGrey(const cv::Mat& image) {
  if (image.empty() || image.type() == CV_8UC1) return image;
  if (image.type() != CV_8UC3)
    throw std::invalid_argument("extractFeatures: the image must have 8 bits and 1 or 3 channels");
  cv::Mat grey;
  cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

/// SIFT of `grey`, whose pixel x is pixel scale * x + (scale - 1) / 2 of the image that the keypoints are for.
Features detect(const cv::Mat& grey, const cv::Mat& mask, const FeatureSettings& settings, float scale) {
  Features features;
  features.descriptors = cv::Mat(0, 128, CV_8U);
  if (std::min(grey.rows, grey.cols) < kMinimumSize) return features;
  const auto sift = cv::SIFT::create(settings.max_features, 3, settings.contrast_threshold, settings.edge_threshold);
  cv::Mat descriptors;
  sift->detectAndCompute(grey, mask, features.keypoints, descriptors);
  const float shift = (scale - 1) / 2 - scale * kDoublingShift;
  for (cv::KeyPoint& k : features.keypoints) {
    k.pt = cv::Point2f(k.pt.x * scale + shift, k.pt.y * scale + shift);
    k.size *= scale;
  }
  features.descriptors = rootSift(descriptors);
  return features;
}

}  // namespace

cv::Mat rootSift(const cv::Mat& sift) {
  if (sift.empty()) return cv::Mat(0, 128, CV_8U);
  if (sift.type() != CV_32F || sift.cols != 128)
    throw std::invalid_argument("rootSift: descriptors must be n x 128, CV_32F");
  cv::Mat out(sift.rows, sift.cols, CV_8U);
  for (int i = 0; i < sift.rows; ++i) {
    const float* in = sift.ptr<float>(i);
    unsigned char* row = out.ptr<unsigned char>(i);
    float sum = 0;
    for (int j = 0; j < sift.cols; ++j) sum += in[j];
    const float scale = sum > 0 ? 512.f * 512.f / sum : 0.f;
    for (int j = 0; j < sift.cols; ++j)
      row[j] = static_cast<unsigned char>(std::min(255.f, std::sqrt(in[j] * scale) + 0.5f));
  }
  return out;
}

Features extractFeatures(const cv::Mat& image, const FeatureSettings& settings, const cv::Mat& mask) {
  if (!mask.empty() && (mask.type() != CV_8UC1 || mask.size() != image.size()))
    throw std::invalid_argument("extractFeatures: the mask must be CV_8U and as large as the image");
  const cv::Mat grey = toGrey(image);
  if (settings.double_image || std::min(grey.rows, grey.cols) < 2 * kMinimumSize)
    return detect(grey, mask, settings, 1);
  cv::Mat half, half_mask;
  cv::resize(grey, half, cv::Size(grey.cols / 2, grey.rows / 2), 0, 0, cv::INTER_AREA);
  if (!mask.empty()) cv::resize(mask, half_mask, half.size(), 0, 0, cv::INTER_NEAREST);
  return extractHalvedFeatures(half, settings, half_mask);
}

Features extractHalvedFeatures(const cv::Mat& half, const FeatureSettings& settings, const cv::Mat& half_mask) {
  return detect(half, half_mask, settings, 2);
}

}  // namespace streetview_localizer
