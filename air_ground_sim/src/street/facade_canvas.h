// What the facades' painters share: a building's style, a canvas in metres, posters, streaks.
#pragma once

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "air_ground_sim/street/street.h"

namespace air_ground_sim {

using cv::Vec3f;

inline std::uint8_t byte(float v) { return static_cast<std::uint8_t>(std::clamp(v, 0.0f, 255.0f)); }
inline cv::Vec3b bytes(const Vec3f& c) { return {byte(c[0]), byte(c[1]), byte(c[2])}; }
inline cv::Scalar scalar(const Vec3f& c) { return {c[0], c[1], c[2]}; }

/// One of the colours, varied a little.
Vec3f pick(Rng* rng, const std::vector<Vec3f>& palette);

/// A word of so many syllables.
std::string syllables(Rng* rng, int count);

enum class Wall { kPlaster, kRoughPlaster, kBrick, kStone, kPanels, kShingles };

/// What the parts of one building share.
struct Style {
  Wall wall;
  Vec3f color, second, trim, frame, base, shutter;
  int mullions, quoins, surround, lintel;
  bool courses, base_stone, shutters;
  std::uint32_t noise;

  explicit Style(const Building& building);
};

/// Draws in facade metres, z up.
class Canvas {
 public:
  Canvas(double width, double height, double texel)
      : texel_(texel),
        image_(std::max(4, static_cast<int>(std::lround(height / texel))),
               std::max(4, static_cast<int>(std::lround(width / texel))), CV_8UC3) {}

  cv::Mat& image() { return image_; }
  int px(double metres) const { return std::max(1, static_cast<int>(std::lround(metres / texel_))); }
  cv::Point at(double x, double z) const {
    return {static_cast<int>(std::lround(x / texel_)), image_.rows - 1 - static_cast<int>(std::lround(z / texel_))};
  }
  double width() const { return image_.cols * texel_; }
  double height() const { return image_.rows * texel_; }

  template <class F>  // F(x, z) -> colour
  void fill(const F& f) {
#pragma omp parallel for schedule(dynamic, 16)
    for (int y = 0; y < image_.rows; ++y)
      for (int x = 0; x < image_.cols; ++x)
        image_.at<cv::Vec3b>(y, x) =
            bytes(f(static_cast<float>((x + 0.5) * texel_), static_cast<float>((image_.rows - y - 0.5) * texel_)));
  }
  template <class F>  // F(x, z, old) -> colour, within a rectangle [m]
  void change(double x0, double z0, double x1, double z1, const F& f) {
    const cv::Point a = at(x0, z1), b = at(x1, z0);
    for (int y = std::max(0, a.y); y <= std::min(image_.rows - 1, b.y); ++y)
      for (int x = std::max(0, a.x); x <= std::min(image_.cols - 1, b.x); ++x) {
        auto& p = image_.at<cv::Vec3b>(y, x);
        p = bytes(f(static_cast<float>((x + 0.5) * texel_), static_cast<float>((image_.rows - y - 0.5) * texel_),
                    Vec3f(p[0], p[1], p[2])));
      }
  }
  void box(double x0, double z0, double x1, double z1, const Vec3f& color) {
    cv::rectangle(image_, at(x0, z1), at(x1, z0), scalar(color), cv::FILLED);
  }
  void frame(double x0, double z0, double x1, double z1, double width, const Vec3f& color) {
    box(x0 - width, z0 - width, x1 + width, z0, color);
    box(x0 - width, z1, x1 + width, z1 + width, color);
    box(x0 - width, z0, x0, z1, color);
    box(x1, z0, x1 + width, z1, color);
  }
  void line(double x0, double z0, double x1, double z1, double width, const Vec3f& color) {
    cv::line(image_, at(x0, z0), at(x1, z1), scalar(color), px(width), cv::LINE_AA);
  }
  void text(const std::string& s, double x, double z, double height, const Vec3f& color, int font,
            double weight = 0.13) {
    const double scale = height / texel_ / 21.0;
    cv::putText(image_, s, at(x, z), font, scale, scalar(color),
                std::max(1, static_cast<int>(weight * height / texel_)), cv::LINE_AA);
  }
  double textWidth(const std::string& s, double height, int font) const {
    return cv::getTextSize(s, font, height / texel_ / 21.0, 2, nullptr).width * texel_;
  }

 private:
  double texel_;
  cv::Mat image_;
};

constexpr int kFonts[] = {cv::FONT_HERSHEY_SIMPLEX, cv::FONT_HERSHEY_DUPLEX, cv::FONT_HERSHEY_COMPLEX,
                          cv::FONT_HERSHEY_TRIPLEX, cv::FONT_HERSHEY_SCRIPT_COMPLEX};

/// A printed sheet: text lines, or fields of colour like a photograph.
void poster(Canvas* canvas, Rng* rng, double x, double z, double w, double h);

/// Rain streaks below a ledge.
void streaks(Canvas* canvas, Rng* rng, double x0, double x1, double z, double reach, float strength);

}  // namespace air_ground_sim
