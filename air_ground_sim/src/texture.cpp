#include "air_ground_sim/texture.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>

#include "air_ground_sim/noise.h"
#include "air_ground_sim/random.h"

namespace air_ground_sim {
namespace {

struct Rgb {
  float r, g, b;
};

cv::Scalar scalar(const Rgb& c) { return {c.r, c.g, c.b}; }

std::uint8_t byte(float v) { return static_cast<std::uint8_t>(std::clamp(v, 0.0f, 255.0f)); }

Rgb scaled(const Rgb& c, float f) { return {c.r * f, c.g * f, c.b * f}; }

// Grain that every material carries, so that a corner tracker finds hold everywhere: patches from 30 cm down to 6 mm.
float grain(const Eigen::Vector3f& p, std::uint32_t seed) {
  return 0.5f * fractalNoise(3.3f * p.x(), 3.3f * p.y(), 3.3f * p.z(), seed, 3) +
         0.5f * fractalNoise(28.0f * p.x(), 28.0f * p.y(), 28.0f * p.z(), seed + 77, 3, 0.85f);
}

Rgb concrete(const Eigen::Vector3f& p, std::uint32_t seed) {
  const float n = grain(p, seed);
  // Aggregate: dark and light grains of about 12 mm.
  const float a = valueNoise(85 * p.x(), 85 * p.y(), 85 * p.z(), seed + 5);
  const float speckle = a > 0.62f ? 0.28f : a < -0.66f ? -0.3f : 0.0f;
  // Joints and cracks follow the zero line of a slow noise.
  const float crack =
      std::abs(fractalNoise(0.9f * p.x(), 0.9f * p.y(), 0.9f * p.z(), seed + 31, 5)) < 0.012f ? -0.35f : 0.0f;
  const float f = 1 + 0.30f * n + speckle + crack;
  return scaled({138, 136, 130}, f);
}

Rgb planks(const Eigen::Vector3f& p, std::uint32_t seed) {
  const float width = 0.125f, length = 1.3f;
  const int row = static_cast<int>(std::floor(p.y() / width));
  const float shift = latticeHash(row, 0, 0, seed) * length;
  const int board = static_cast<int>(std::floor((p.x() + shift) / length));
  const float v = p.y() / width - row, u = (p.x() + shift) / length - board;
  const bool gap = v < 0.025f || u < 0.003f;
  const float tint = latticeHash(row, board, 1, seed), hue = latticeHash(row, board, 2, seed);
  const float off = 40 * latticeHash(row, board, 3, seed);
  const float fibre = fractalNoise(5 * p.x() + off, 70 * p.y(), seed + 3, 4, 0.75f);
  const float ring = std::sin(42 * (p.y() + 0.05f * fractalNoise(1.5f * p.x() + off, 6 * p.y(), seed + 4, 2)));
  const float f =
      (0.62f + 0.62f * tint) * (1 + 0.25f * fibre + 0.08f * ring + 0.18f * grain(p, seed)) * (gap ? 0.35f : 1.0f);
  return scaled({176 + 16 * hue, 132 + 8 * hue, 88 - 14 * hue}, f);
}

Rgb tiles(const Eigen::Vector3f& p, std::uint32_t seed) {
  const float size = 0.33f;
  const int ix = static_cast<int>(std::floor(p.x() / size)), iy = static_cast<int>(std::floor(p.y() / size));
  const float u = p.x() / size - ix, v = p.y() / size - iy;
  const float tint = latticeHash(ix, iy, 0, seed), kind = latticeHash(ix, iy, 1, seed);
  const float terrazzo = valueNoise(60 * p.x(), 60 * p.y(), seed + 8);
  const float chips = terrazzo > 0.45f ? 0.35f : terrazzo < -0.5f ? -0.33f : 0.0f;
  const float f = (0.72f + 0.45f * tint) * (1 + chips + 0.25f * grain(p, seed));
  if (u < 0.02f || v < 0.02f) return scaled({96, 94, 90}, 1 + 0.3f * grain(p, seed));
  return scaled(kind < 0.18f ? Rgb{150, 92, 78} : Rgb{152, 150, 142}, f);
}

Rgb gravel(const Eigen::Vector3f& p, std::uint32_t seed) {
  // Pebbles: nearest of jittered lattice points, each with a shade; soil between them.
  const float cell = 0.045f;
  const float x = p.x() / cell, y = p.y() / cell;
  const int ix = static_cast<int>(std::floor(x)), iy = static_cast<int>(std::floor(y));
  float nearest = 9, shade = 0;
  for (int dy = -1; dy <= 1; ++dy)
    for (int dx = -1; dx <= 1; ++dx) {
      const float px = ix + dx + latticeHash(ix + dx, iy + dy, 0, seed),
                  py = iy + dy + latticeHash(ix + dx, iy + dy, 1, seed);
      const float radius = 0.25f + 0.5f * latticeHash(ix + dx, iy + dy, 2, seed);
      const float d = std::hypot(x - px, y - py) / radius;
      if (d < nearest) {
        nearest = d;
        shade = latticeHash(ix + dx, iy + dy, 3, seed);
      }
    }
  const float n = grain(p, seed), slow = fractalNoise(1.1f * p.x(), 1.1f * p.y(), seed + 21, 3);
  if (nearest < 1)
    return scaled({140, 134, 124}, (0.55f + 0.85f * shade) * (1.05f - 0.35f * nearest * nearest) * (1 + 0.2f * n));
  return scaled({112 + 10 * slow, 96 + 14 * slow, 74}, 0.8f * (1 + 0.35f * n + 0.25f * slow));
}

Rgb cardboard(const Eigen::Vector3f& p, float v, std::uint32_t seed) {
  const float flute = 0.035f * std::sin(2 * static_cast<float>(M_PI) * v / 0.007f);
  const float stain = std::max(0.0f, fractalNoise(4 * p.x(), 4 * p.y(), 4 * p.z(), seed + 13, 3) - 0.35f);
  const float tone = 0.82f + 0.36f * latticeHash(0, 0, 0, seed), warm = latticeHash(1, 0, 0, seed);
  const float f = tone * (1 + flute + 0.24f * grain(p, seed) - 0.5f * stain);
  return scaled({176, 136 + 10 * warm, 92 + 16 * warm}, f);
}

Rgb painted(const Eigen::Vector3f& p, std::uint32_t seed) {
  static const Rgb palette[] = {{168, 60, 48}, {52, 92, 150},   {62, 120, 74}, {196, 170, 70},
                                {90, 90, 96},  {205, 200, 190}, {170, 104, 44}};
  const Rgb base = palette[static_cast<int>(latticeHash(3, 1, 4, seed) * 7) % 7];
  const float scuff = fractalNoise(9 * p.x(), 9 * p.y(), 9 * p.z(), seed + 2, 4, 0.75f);
  return scaled(base, (0.85f + 0.3f * latticeHash(5, 9, 2, seed)) * (1 + 0.22f * grain(p, seed) +
                                                                     (scuff > 0.55f   ? 0.4f
                                                                      : scuff < -0.6f ? -0.35f
                                                                                      : 0.0f)));
}

Rgb wood(float u, float v, float length_is_u, std::uint32_t seed) {
  const float along = length_is_u > 0 ? u : v, across = length_is_u > 0 ? v : u;
  const float off = 30 * latticeHash(2, 7, 1, seed);
  const float fibre = fractalNoise(7 * along + off, 90 * across, seed, 4, 0.75f);
  const float knot = fractalNoise(9 * along, 12 * across + off, seed + 6, 2) > 0.72f ? -0.4f : 0.0f;
  return scaled({182, 146, 102}, (0.72f + 0.5f * latticeHash(8, 2, 8, seed)) * (1 + 0.3f * fibre + knot));
}

Rgb plaster(const Eigen::Vector3f& p, std::uint32_t seed) {
  const float dirt = std::max(0.0f, fractalNoise(1.3f * p.x(), 1.3f * p.y(), 1.3f * p.z(), seed + 41, 4) - 0.2f);
  return scaled({188, 184, 174}, 1 + 0.22f * grain(p, seed) - 0.35f * dirt);
}

Rgb rock(const Eigen::Vector3f& p, std::uint32_t seed) {
  const float vein = std::abs(fractalNoise(4 * p.x(), 4 * p.y(), 4 * p.z(), seed + 51, 4)) < 0.03f ? 0.35f : 0.0f;
  const float strata =
      0.15f * std::sin(38 * (p.z() + 0.06f * fractalNoise(5 * p.x(), 5 * p.y(), 5 * p.z(), seed + 3, 2)));
  const float tone = 0.7f + 0.5f * latticeHash(6, 6, 6, seed), warm = latticeHash(4, 4, 4, seed);
  return scaled({132 + 26 * warm, 126 + 8 * warm, 118 - 10 * warm},
                tone * (1 + 0.38f * grain(p, seed) + vein + strata));
}

Rgb albedo(const Patch& patch, const Eigen::Vector3f& p, float u, float v) {
  const auto seed = static_cast<std::uint32_t>(patch.object);
  switch (patch.material) {
    case Material::kConcrete:
      return concrete(p, seed);
    case Material::kPlanks:
      return planks(p, seed);
    case Material::kTiles:
      return tiles(p, seed);
    case Material::kGravel:
      return gravel(p, seed);
    case Material::kCardboard:
      return cardboard(p, v, seed);
    case Material::kPaintedBox:
      return painted(p, seed);
    case Material::kWood:
      return wood(u, v, patch.width > patch.height ? 1.0f : 0.0f, seed);
    case Material::kBrick:
      return scaled({150, 84, 66}, (0.8f + 0.4f * latticeHash(1, 1, 1, seed)) * (1 + 0.4f * grain(p, seed)));
    case Material::kPlaster:
      return plaster(p, seed);
    case Material::kRock:
      return rock(p, seed);
    case Material::kPlain:
      return {150, 148, 142};
    case Material::kPaper:
      break;
  }
  return scaled({225, 222, 214}, 1 + 0.06f * grain(p, seed));
}

std::string randomText(Rng* rng, int length) {
  static const char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 -/.";
  std::string s;
  for (int i = 0; i < length; ++i) s += letters[rng->integer(40)];
  return s;
}

// Draws in texels; lengths in metres are divided by `texel`.
class Printer {
 public:
  Printer(cv::Mat* image, float texel, std::uint64_t seed) : image_(*image), texel_(texel), rng_(seed) {}

  int px(double metres) const { return std::max(1, static_cast<int>(std::lround(metres / texel_))); }

  void text(cv::Mat& on, const std::string& s, cv::Point at, double height_m, const cv::Scalar& ink) {
    const int fonts[] = {cv::FONT_HERSHEY_SIMPLEX, cv::FONT_HERSHEY_DUPLEX, cv::FONT_HERSHEY_COMPLEX};
    const double scale = height_m / texel_ / 21.0;  // Hershey capitals are about 21 px high at scale 1
    cv::putText(on, s, at, fonts[rng_.integer(3)], scale, ink, std::max(1, static_cast<int>(2.6 * scale)), cv::LINE_AA);
  }

  // A sheet of paper with print, a bar code or a picture, turned by any angle, blended over the image.
  void sheet(cv::Point2f center, double w_m, double h_m, double angle_deg) {
    const int w = px(w_m), h = px(h_m);
    if (w < 12 || h < 12) return;
    cv::Mat sheet(h, w, CV_8UC3);
    const double white = rng_.uniform(185, 235);
    sheet.setTo(cv::Scalar(white, white * 0.985, white * 0.95));
    const int kind = rng_.integer(3);
    const cv::Scalar ink(rng_.uniform(15, 60), rng_.uniform(15, 60), rng_.uniform(20, 80));
    if (kind == 0) {
      const double line = rng_.uniform(0.012, 0.03);
      for (int y = px(1.6 * line); y < h - 2; y += px(1.7 * line))
        text(sheet, randomText(&rng_, 4 + rng_.integer(22)), {px(0.01), y}, line, ink);
    } else if (kind == 1) {
      picture(sheet, cv::Rect(px(0.006), px(0.006), std::max(4, w - 2 * px(0.006)), std::max(4, h - 2 * px(0.006))));
    } else {
      text(sheet, randomText(&rng_, 8), {px(0.01), h / 3}, 0.2 * h_m, ink);
      for (int x = px(0.015); x < w - px(0.02);) {  // bar code
        const int bar = px(rng_.uniform(0.003, 0.009));
        cv::rectangle(sheet, {x, h / 2}, {x + bar, h - px(0.015)}, ink, cv::FILLED);
        x += bar + px(rng_.uniform(0.003, 0.01));
      }
    }
    blend(sheet, center, angle_deg);
  }

  // Photo-like: smooth colour fields with sharp borders.
  void picture(cv::Mat& on, cv::Rect where) {
    where &= cv::Rect(0, 0, on.cols, on.rows);
    const auto seed = static_cast<std::uint32_t>(rng_.next());
    const float scale = 5.0f / static_cast<float>(std::max(where.width, where.height));
    Rgb colors[4];
    for (auto& c : colors)
      c = {static_cast<float>(rng_.uniform(25, 225)), static_cast<float>(rng_.uniform(25, 215)),
           static_cast<float>(rng_.uniform(25, 205))};
    for (int y = 0; y < where.height; ++y)
      for (int x = 0; x < where.width; ++x) {
        const float n = fractalNoise(scale * x, scale * y, seed, 4),
                    m = fractalNoise(2.3f * scale * x, 2.3f * scale * y, seed + 1, 3);
        const Rgb& c = colors[(n > 0.1f) + 2 * (m > 0)];
        const float f = 0.85f + 0.35f * m;
        on.at<cv::Vec3b>(where.y + y, where.x + x) = {byte(c.r * f), byte(c.g * f), byte(c.b * f)};
      }
  }

  void tape(cv::Point a, cv::Point b, double width_m, const cv::Scalar& color, double alpha) {
    cv::Mat over = image_.clone();
    cv::line(over, a, b, color, px(width_m), cv::LINE_AA);
    cv::addWeighted(over, alpha, image_, 1 - alpha, 0, image_);
  }

  void stain(cv::Point2f center, double radius_m, float strength) {
    const auto seed = static_cast<std::uint32_t>(rng_.next());
    const int r = px(1.6 * radius_m);
    const float R = static_cast<float>(px(radius_m));
    for (int y = std::max(0, static_cast<int>(center.y) - r); y < std::min(image_.rows, static_cast<int>(center.y) + r);
         ++y)
      for (int x = std::max(0, static_cast<int>(center.x) - r);
           x < std::min(image_.cols, static_cast<int>(center.x) + r); ++x) {
        const float dx = (x - center.x) / R, dy = (y - center.y) / R;
        const float d = std::sqrt(dx * dx + dy * dy) + 0.35f * fractalNoise(2 * dx, 2 * dy, seed, 4);
        if (d >= 1) continue;
        const float f = 1 - strength * (d > 0.85f ? 1.0f : 0.75f);
        auto& c = image_.at<cv::Vec3b>(y, x);
        for (int k = 0; k < 3; ++k) c[k] = byte(c[k] * f);
      }
  }

  void blend(const cv::Mat& sheet, cv::Point2f center, double angle_deg) {
    cv::Mat M = cv::getRotationMatrix2D({0.5f * sheet.cols, 0.5f * sheet.rows}, angle_deg, 1.0);
    const double reach = 0.5 * std::hypot(sheet.cols, sheet.rows) + 2;
    const cv::Rect box = cv::Rect(static_cast<int>(center.x - reach), static_cast<int>(center.y - reach),
                                  static_cast<int>(2 * reach), static_cast<int>(2 * reach)) &
                         cv::Rect(0, 0, image_.cols, image_.rows);
    if (box.empty()) return;
    M.at<double>(0, 2) += center.x - 0.5 * sheet.cols - box.x;
    M.at<double>(1, 2) += center.y - 0.5 * sheet.rows - box.y;
    cv::Mat target = image_(box);
    cv::warpAffine(sheet, target, M, box.size(), cv::INTER_LINEAR, cv::BORDER_TRANSPARENT);
  }

  Rng& rng() { return rng_; }
  cv::Mat& image() { return image_; }

 private:
  cv::Mat& image_;
  float texel_;
  Rng rng_;
};

void printBox(const Patch& patch, cv::Mat* image) {
  Printer p(image, patch.texel, mix(patch.seed, 5));
  Rng& rng = p.rng();
  const int w = image->cols, h = image->rows;
  const double dark = rng.uniform(25, 80);
  const cv::Scalar ink = rng.chance(0.7) ? cv::Scalar(dark, dark * 0.9, dark * 0.8)
                                         : scalar(rng.chance(0.5) ? Rgb{150, 40, 34} : Rgb{36, 60, 130});
  const int stains = 1 + rng.integer(3);
  for (int i = 0; i < stains; ++i)
    p.stain({static_cast<float>(rng.uniform(0, w)), static_cast<float>(rng.uniform(0, h))}, rng.uniform(0.02, 0.09),
            static_cast<float>(rng.uniform(0.1, 0.3)));
  if (patch.top) {  // flaps meet along the middle, under tape
    p.tape({0, h / 2}, {w, h / 2}, 0.05, rng.chance(0.6) ? cv::Scalar(206, 178, 128) : cv::Scalar(120, 88, 50), 0.8);
    cv::line(*image, {0, h / 2}, {w, h / 2}, cv::Scalar(60, 45, 30), 1);
  }
  const int lines = 1 + rng.integer(3);
  for (int i = 0; i < lines; ++i)
    p.text(*image, randomText(&rng, 3 + rng.integer(8)),
           {static_cast<int>(rng.uniform(0.02, 0.4) * w), static_cast<int>(rng.uniform(0.2, 0.95) * h)},
           rng.uniform(0.03, 0.09), ink);
  if (rng.chance(0.5)) {  // "this side up": arrows over a bar
    const cv::Point at(static_cast<int>(rng.uniform(0.15, 0.8) * w), static_cast<int>(rng.uniform(0.4, 0.8) * h));
    for (int k = 0; k < 2; ++k)
      cv::arrowedLine(*image, at + cv::Point(p.px(0.04) * k, 0), at + cv::Point(p.px(0.04) * k, -p.px(0.09)), ink,
                      p.px(0.008), cv::LINE_AA, 0, 0.35);
    cv::line(*image, at + cv::Point(-p.px(0.02), p.px(0.012)), at + cv::Point(p.px(0.06), p.px(0.012)), ink,
             p.px(0.008));
  }
  if (rng.chance(0.35))
    cv::circle(*image, {static_cast<int>(rng.uniform(0.2, 0.8) * w), static_cast<int>(rng.uniform(0.2, 0.8) * h)},
               p.px(rng.uniform(0.03, 0.07)), ink, p.px(0.008), cv::LINE_AA);
  const int labels = rng.integer(3);
  for (int i = 0; i < labels; ++i)
    p.sheet({static_cast<float>(rng.uniform(0.2, 0.8) * w), static_cast<float>(rng.uniform(0.2, 0.8) * h)},
            rng.uniform(0.08, 0.2), rng.uniform(0.06, 0.15), rng.chance(0.7) ? rng.uniform(-4, 4) : 90);
  // Worn edges.
  cv::rectangle(*image, {0, 0}, {w - 1, h - 1}, cv::Scalar(98, 76, 52), 1);
}

void printFloor(const Patch& patch, cv::Mat* image) {
  Printer p(image, patch.texel, mix(patch.seed, 6));
  Rng& rng = p.rng();
  const auto anywhere = [&] {
    return cv::Point2f(static_cast<float>(rng.uniform(0, image->cols)),
                       static_cast<float>(rng.uniform(0, image->rows)));
  };
  for (int i = 0; i < 45; ++i)
    p.stain(anywhere(), rng.uniform(0.04, 0.35), static_cast<float>(rng.uniform(0.08, 0.35)));
  for (int i = 0; i < 7; ++i) {  // marking tape
    const cv::Point2f a = anywhere();
    const double angle = rng.uniform(0, 2 * M_PI), length = rng.uniform(0.3, 1.6) / patch.texel;
    const cv::Scalar color = rng.chance(0.5)   ? cv::Scalar(205, 170, 50)
                             : rng.chance(0.5) ? cv::Scalar(40, 40, 44)
                                               : cv::Scalar(210, 208, 200);
    cv::line(
        *image, a,
        cv::Point(static_cast<int>(a.x + length * std::cos(angle)), static_cast<int>(a.y + length * std::sin(angle))),
        color, p.px(0.05), cv::LINE_AA);
  }
  for (int i = 0; i < 120; ++i) {  // scuffs
    const cv::Point2f a = anywhere();
    const double angle = rng.uniform(0, 2 * M_PI), length = rng.uniform(0.03, 0.3) / patch.texel;
    cv::line(
        *image, a,
        cv::Point(static_cast<int>(a.x + length * std::cos(angle)), static_cast<int>(a.y + length * std::sin(angle))),
        rng.chance(0.6) ? cv::Scalar(62, 58, 54) : cv::Scalar(190, 186, 178), p.px(rng.uniform(0.003, 0.012)),
        cv::LINE_AA);
  }
  for (int i = 0; i < 46; ++i) {  // sheets of paper and posters left on the floor
    const bool poster = rng.chance(0.2);
    p.sheet(anywhere(), poster ? rng.uniform(0.4, 0.6) : 0.21, poster ? rng.uniform(0.3, 0.5) : 0.297,
            rng.uniform(0, 360));
  }
}

void printWall(const Patch& patch, cv::Mat* image) {
  Printer p(image, patch.texel, mix(patch.seed, 7));
  Rng& rng = p.rng();
  const int posters = std::max(1, static_cast<int>(patch.width * patch.height));
  for (int i = 0; i < posters; ++i)
    p.sheet({static_cast<float>(rng.uniform(0, image->cols)), static_cast<float>(rng.uniform(0, image->rows))},
            rng.uniform(0.2, 0.6), rng.uniform(0.2, 0.5), rng.uniform(-5, 5));
}

}  // namespace

cv::Mat paintPatch(const Patch& patch) {
  if (patch.painter) return patch.painter(patch);
  const int w = std::max(4, static_cast<int>(std::lround(patch.width / patch.texel)));
  const int h = std::max(4, static_cast<int>(std::lround(patch.height / patch.texel)));
  cv::Mat image(h, w, CV_8UC3);
  // Boxes carry their texture with them: noise in face coordinates. Floors and rocks: noise in space, so that seams
  // vanish.
  const bool in_space = patch.columns > 1 || patch.material == Material::kConcrete ||
                        patch.material == Material::kPlanks || patch.material == Material::kTiles ||
                        patch.material == Material::kGravel || patch.material == Material::kPlaster;
  const float offset = static_cast<float>(patch.seed % 9973);
#pragma omp parallel for schedule(dynamic, 16)
  for (int y = 0; y < h; ++y) {
    auto* row = image.ptr<cv::Vec3b>(y);
    for (int x = 0; x < w; ++x) {
      const float u = (x + 0.5f) / w, v = (y + 0.5f) / h;
      const Eigen::Vector3f p =
          in_space ? patch.point(u, v) : Eigen::Vector3f(u * patch.width + 0.37f * offset, v * patch.height, 0.1f);
      const Rgb c = albedo(patch, p, u * patch.width, v * patch.height);
      row[x] = {byte(c.r), byte(c.g), byte(c.b)};
    }
  }
  if (!patch.printed) return image;
  cv::flip(image, image, 0);  // print upright: v grows upwards, image rows downwards
  switch (patch.material) {
    case Material::kCardboard:
    case Material::kPaintedBox:
      printBox(patch, &image);
      break;
    case Material::kPlaster:
      printWall(patch, &image);
      break;
    default:
      printFloor(patch, &image);
      break;
  }
  cv::flip(image, image, 0);
  return image;
}

}  // namespace air_ground_sim
