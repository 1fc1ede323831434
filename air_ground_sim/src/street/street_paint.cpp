#include "air_ground_sim/street/street_paint.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "air_ground_sim/noise.h"

namespace air_ground_sim {
namespace {

using cv::Vec3f;

std::uint8_t byte(float v) { return static_cast<std::uint8_t>(std::clamp(v, 0.0f, 255.0f)); }
cv::Vec3b bytes(const Vec3f& c) { return {byte(c[0]), byte(c[1]), byte(c[2])}; }
cv::Scalar scalar(const Vec3f& c) { return {c[0], c[1], c[2]}; }

Vec3f pick(Rng* rng, const std::vector<Vec3f>& palette) {
  Vec3f c = palette[rng->integer(static_cast<int>(palette.size()))];
  const auto f = static_cast<float>(rng->uniform(0.88, 1.1));
  for (int k = 0; k < 3; ++k) c[k] *= f * static_cast<float>(rng->uniform(0.95, 1.05));
  return c;
}

std::string syllables(Rng* rng, int count) {
  static const char* const parts[] = {"BA", "CO", "DI", "FE", "GO",  "HA",  "KI",  "LU",  "MO",  "NE",  "PA",  "RO",
                                      "SA", "TI", "VE", "ZU", "BLU", "CAF", "STO", "BER", "LIN", "MAR", "OPT", "REX"};
  std::string s;
  for (int i = 0; i < count; ++i) s += parts[rng->integer(24)];
  return s;
}

enum class Wall { kPlaster, kRoughPlaster, kBrick, kStone, kPanels, kShingles };

// What the parts of one building share.
struct Style {
  Wall wall;
  Vec3f color, second, trim, frame, base, shutter;
  int mullions, quoins, surround, lintel;
  bool courses, base_stone, shutters;
  std::uint32_t noise;

  explicit Style(const Building& b) {
    Rng rng(mix(b.seed, 1));
    wall = static_cast<Wall>(std::min(5, rng.integer(8) % 7));
    color = pick(&rng, {{206, 196, 172},
                        {188, 176, 150},
                        {202, 168, 124},
                        {168, 176, 170},
                        {196, 190, 186},
                        {176, 136, 112},
                        {150, 158, 168},
                        {210, 186, 148}});
    if (wall == Wall::kBrick) color = pick(&rng, {{146, 84, 66}, {160, 110, 84}, {122, 74, 62}, {176, 150, 116}});
    if (wall == Wall::kStone) color = pick(&rng, {{164, 156, 140}, {140, 136, 128}, {176, 160, 132}});
    if (wall == Wall::kShingles) color = pick(&rng, {{134, 98, 70}, {110, 92, 78}, {150, 126, 96}});
    second = pick(&rng, {{150, 140, 124}, {120, 112, 104}, {170, 160, 146}, {132, 106, 88}});
    trim = pick(&rng, {{216, 212, 202}, {176, 168, 152}, {150, 142, 132}, {120, 84, 66}});
    frame = pick(&rng, {{224, 222, 216}, {210, 206, 196}, {92, 66, 48}, {64, 70, 76}, {70, 88, 78}});
    base = pick(&rng, {{120, 116, 110}, {136, 128, 116}, {104, 100, 98}});
    shutter = pick(&rng, {{62, 96, 70}, {96, 60, 46}, {70, 84, 112}, {128, 118, 100}, {150, 60, 50}});
    mullions = rng.integer(4);
    quoins = rng.integer(3);
    surround = rng.integer(4);
    lintel = rng.integer(3);
    courses = rng.chance(0.6);
    base_stone = rng.chance(0.6);
    shutters = !b.shop ? rng.chance(0.6) : rng.chance(0.35);
    noise = static_cast<std::uint32_t>(mix(b.seed, 2));
  }
};

// Unit-free wall surface: colour at (x right, z up) [m].
Vec3f wallAt(const Style& s, Wall wall, const Vec3f& color, float x, float z) {
  const float fine = fractalNoise(26 * x, 26 * z, s.noise + 7, 3, 0.85f),
              slow = fractalNoise(1.1f * x, 1.1f * z, s.noise + 3, 4, 0.7f);
  float f = 1 + 0.09f * slow;
  switch (wall) {
    case Wall::kPlaster:
      return color * (f * (1 + 0.10f * fine));
    case Wall::kRoughPlaster: {
      const float pit = valueNoise(48 * x, 48 * z, s.noise + 9);
      return color * (f * (1 + 0.16f * fine + (pit > 0.5f ? 0.16f : pit < -0.55f ? -0.22f : 0)));
    }
    case Wall::kBrick: {
      const float h = 0.077f, l = 0.26f;
      const int row = static_cast<int>(std::floor(z / h));
      const float shifted = x / l + 0.5f * (row & 1);
      const int brick = static_cast<int>(std::floor(shifted));
      if (z / h - row < 0.16f || shifted - brick < 0.05f) return Vec3f(168, 160, 148) * (f * (1 + 0.12f * fine));
      return color * (f * (0.68f + 0.55f * latticeHash(row, brick, 0, s.noise)) * (1 + 0.14f * fine));
    }
    case Wall::kStone: {
      const float h = 0.36f;
      const int row = static_cast<int>(std::floor(z / h));
      const float l = 0.55f + 0.35f * latticeHash(row, 0, 5, s.noise),
                  shifted = x / l + latticeHash(row, 1, 5, s.noise);
      const int block = static_cast<int>(std::floor(shifted));
      if (z / h - row < 0.045f || shifted - block < 0.03f) return color * (0.62f * f);
      const float vein = std::abs(fractalNoise(5 * x, 5 * z, s.noise + 40 + row, 4)) < 0.02f ? -0.14f : 0;
      return color * (f * (0.80f + 0.36f * latticeHash(row, block, 2, s.noise)) * (1 + 0.16f * fine + vein));
    }
    case Wall::kPanels: {
      const float w = 1.2f + 0.8f * latticeHash(1, 2, 3, s.noise), h = 0.7f + 0.5f * latticeHash(3, 2, 1, s.noise);
      const int column = static_cast<int>(std::floor(x / w)), row = static_cast<int>(std::floor(z / h));
      const float u = x - column * w, v = z - row * h;
      if (u < 0.018f || v < 0.018f) return color * (0.45f * f);
      const bool rivet = std::hypot(u - 0.08f, v - 0.08f) < 0.018f || std::hypot(u - w + 0.08f, v - 0.08f) < 0.018f;
      return color *
             (f * (rivet ? 0.6f : 1.0f) * (0.90f + 0.18f * latticeHash(column, row, 0, s.noise)) * (1 + 0.08f * fine));
    }
    case Wall::kShingles: {
      const float h = 0.16f, l = 0.13f;
      const int row = static_cast<int>(std::floor(z / h));
      const float shifted = x / l + 0.5f * (row & 1) + 0.3f * latticeHash(row, 7, 7, s.noise);
      const int one = static_cast<int>(std::floor(shifted));
      const float v = z / h - row;
      const float edge = v < 0.12f ? 0.55f : shifted - one < 0.08f ? 0.7f : 1.0f;
      return color * (f * edge * (0.7f + 0.5f * latticeHash(row, one, 0, s.noise)) * (1 + 0.14f * fine));
    }
  }
  return color;
}

// Draws in facade metres, z up.
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

// A printed sheet: text lines, or fields of colour like a photograph.
void poster(Canvas* c, Rng* rng, double x, double z, double w, double h) {
  const Vec3f paper =
      pick(rng, {{226, 222, 210}, {228, 206, 90}, {206, 70, 58}, {80, 130, 190}, {230, 228, 226}, {96, 160, 104}});
  const Vec3f ink = pick(rng, {{30, 30, 36}, {150, 30, 30}, {30, 50, 120}, {236, 232, 226}});
  c->box(x, z, x + w, z + h, paper);
  if (rng->chance(0.6)) {
    const auto seed = static_cast<std::uint32_t>(rng->next());
    const Vec3f a = pick(rng, {{60, 60, 80}, {190, 150, 110}, {220, 200, 60}}),
                b = pick(rng, {{200, 80, 60}, {70, 130, 80}, {40, 40, 50}, {220, 220, 216}});
    c->change(x + 0.06 * w, z + 0.4 * h, x + 0.94 * w, z + 0.95 * h, [&](float u, float v, const Vec3f& old) {
      const float k = static_cast<float>(3.0 / h);
      const float n = fractalNoise(k * u, k * v, seed, 4), m = fractalNoise(2 * k * u, 2 * k * v, seed + 1, 3);
      return n > 0.15f ? a * (0.9f + 0.4f * m) : n < -0.15f ? b * (0.9f + 0.4f * m) : old;
    });
    c->text(syllables(rng, 2), x + 0.08 * w, z + 0.22 * h, 0.13 * h, ink, kFonts[rng->integer(3)]);
    c->text(std::to_string(rng->integer(9000)), x + 0.1 * w, z + 0.06 * h, 0.08 * h, ink, kFonts[0]);
  } else {
    double line = h * rng->uniform(0.08, 0.2);
    for (double y = z + h - 1.5 * line; y > z + 0.05 * h; y -= 1.5 * line, line = h * rng->uniform(0.06, 0.12))
      c->text(syllables(rng, 1 + rng->integer(4)), x + 0.06 * w, y, line, ink, kFonts[rng->integer(3)]);
  }
}

// Rain streaks below a ledge.
void streaks(Canvas* c, Rng* rng, double x0, double x1, double z, double reach, float strength) {
  const auto seed = static_cast<std::uint32_t>(rng->next());
  c->change(x0, z - reach, x1, z, [&](float x, float y, const Vec3f& old) {
    const float d = static_cast<float>((z - y) / reach);
    const float n = fractalNoise(11 * x, 1.1f * y, seed, 3, 0.8f);
    return old * (1 - std::max(0.0f, n) * strength * (1 - d));
  });
}

void wear(Canvas* c, const Building& b, const Style& s, Rng* rng) {
  // Repairs of another colour, stains, cracks.
  const int patches = 2 + rng->integer(5);
  for (int i = 0; i < patches; ++i) {
    const double x = rng->uniform(0, b.width), z = rng->uniform(b.street_level, b.eaves), r = rng->uniform(0.15, 0.8);
    const auto seed = static_cast<std::uint32_t>(rng->next());
    const float tone = static_cast<float>(rng->uniform(0.8, 1.12));
    c->change(x - 1.5 * r, z - 1.5 * r, x + 1.5 * r, z + 1.5 * r, [&](float u, float v, const Vec3f& old) {
      const float dx = static_cast<float>((u - x) / r), dz = static_cast<float>((v - z) / r);
      const float d = std::sqrt(dx * dx + dz * dz) + 0.5f * fractalNoise(1.5f * dx, 1.5f * dz, seed, 4);
      return d < 1 ? old * (d > 0.93f ? 0.8f * tone : tone) : old;
    });
  }
  const int cracks = 2 + rng->integer(4);
  for (int i = 0; i < cracks; ++i) {
    double x = rng->uniform(0, b.width), z = rng->uniform(b.street_level, b.eaves), angle = rng->uniform(0, 2 * M_PI);
    for (int k = 0; k < 14; ++k) {
      angle += 0.5 * rng->gaussian();
      const double nx = x + 0.12 * std::cos(angle), nz = z + 0.12 * std::sin(angle);
      c->line(x, z, nx, nz, 0.008, s.color * 0.5f);
      x = nx;
      z = nz;
    }
  }
  // Splash water at the foot.
  const auto seed = static_cast<std::uint32_t>(rng->next());
  c->change(0, 0, b.width, b.street_level + 0.9, [&](float x, float z, const Vec3f& old) {
    const float d = static_cast<float>((z - b.street_level) / 0.9) + 0.4f * fractalNoise(2 * x, 2 * z, seed, 4);
    return old * (1 - 0.4f * std::clamp(1 - d, 0.0f, 1.0f));
  });
}

// Tags, notices, boxes: nothing of it repeats.
void clutter(Canvas* c, const Building& b, Season season, Rng* rng, Rng* changing) {
  const auto covered = [&](double x, double z, double w, double h) {
    for (const auto& o : b.openings)
      if (x < o.x + o.width && o.x < x + w && z < o.z + o.height && o.z < z + h) return true;
    return false;
  };
  const int posters = 2 + static_cast<int>(b.width / 3);
  for (int i = 0; i < posters; ++i) {
    const double w = rng->uniform(0.25, 0.8), h = w * rng->uniform(1.1, 1.5), x = rng->uniform(0.1, b.width - w - 0.1),
                 z = b.street_level + rng->uniform(0.9, 2.0);
    // A third of them is pasted over between the two days.
    Rng own(rng->next()), other(changing->next());
    if (!covered(x, z, w, h)) poster(c, i % 3 == 0 ? &other : &own, x, z, w, h);
  }
  const int tags = rng->integer(4);
  for (int i = 0; i < tags; ++i) {
    const Vec3f color = pick(rng, {{30, 30, 34}, {40, 60, 150}, {160, 40, 60}, {60, 120, 70}, {220, 220, 220}});
    c->text(syllables(rng, 2), rng->uniform(0, b.width - 1.5), b.street_level + rng->uniform(0.5, 1.6),
            rng->uniform(0.2, 0.5), color, cv::FONT_HERSHEY_SCRIPT_COMPLEX, 0.16);
  }
  for (int i = 0; i < 5; ++i) {  // vents, meter boxes, lamps
    const double x = rng->uniform(0.2, b.width - 0.6), z = rng->uniform(b.street_level + 0.4, b.eaves - 0.6),
                 w = rng->uniform(0.15, 0.4), h = rng->uniform(0.15, 0.5);
    if (covered(x - 0.1, z - 0.1, w + 0.2, h + 0.2)) continue;
    const Vec3f color = pick(rng, {{90, 90, 92}, {190, 186, 178}, {120, 104, 88}});
    c->box(x, z, x + w, z + h, color);
    c->frame(x + 0.015, z + 0.015, x + w - 0.015, z + h - 0.015, 0.012, color * 0.6f);
    for (double y = z + 0.05; y < z + h - 0.04 && i < 3; y += 0.045)
      c->line(x + 0.03, y, x + w - 0.03, y, 0.012, color * 0.55f);
  }
  if (rng->chance(0.75)) {  // down pipe with clamps
    const double x = rng->chance(0.5) ? 0.18 : b.width - 0.18;
    const Vec3f color = pick(rng, {{112, 88, 70}, {128, 132, 134}, {90, 96, 92}});
    c->box(x - 0.05, b.street_level, x + 0.05, b.eaves, color);
    c->box(x - 0.015, b.street_level, x + 0.01, b.eaves, color * 1.25f);
    for (double z = b.street_level + 1; z < b.eaves; z += rng->uniform(1.7, 2.2))
      c->box(x - 0.075, z, x + 0.075, z + 0.04, color * 0.6f);
  }
  for (int i = 0; i < 2; ++i) {  // cables
    const double z = rng->uniform(b.street_level + 2.5, b.eaves - 0.5), x0 = rng->uniform(0, 0.4 * b.width),
                 x1 = rng->uniform(0.5 * b.width, b.width);
    c->line(x0, z, x1, z + rng->uniform(-0.05, 0.05), 0.015, {50, 50, 52});
    c->line(x1, z, x1, z - rng->uniform(0.3, 2), 0.015, {50, 50, 52});
  }
  if (season == Season::kFlight)  // damp from the autumn rain
    streaks(c, changing, 0, b.width, b.eaves, 2.5, 0.35f);
}

}  // namespace

Vec3f wallColor(const Building& b) { return Style(b).color; }
Vec3f trimColor(const Building& b) { return Style(b).trim; }

cv::Mat paintFacade(const Building& b, Season season, double texel) {
  const Style s(b);
  Rng rng(mix(b.seed, 3)), changing(mix(b.seed, 4 + static_cast<int>(season)));
  Canvas c(b.width, b.eaves, texel);
  const float first = static_cast<float>(b.street_level + b.shop_height - 0.25),
              foot = static_cast<float>(b.street_level + 0.5);
  c.fill([&](float x, float z) {
    if (z < foot) return wallAt(s, Wall::kRoughPlaster, s.base, x, z);
    if (z < first && s.base_stone) return wallAt(s, Wall::kStone, s.second, x, z);
    return wallAt(s, s.wall, s.color, x, z);
  });
  wear(&c, b, s, &rng);
  if (s.courses)
    for (int f = 0; f < b.floors; ++f) {
      const double z = b.street_level + b.shop_height + f * b.floor_height - 0.18;
      c.box(0, z, b.width, z + 0.16, s.trim);
      c.line(0, z, b.width, z, 0.02, s.trim * 0.55f);
      if (f % 2 == 0)  // dentils
        for (double x = 0.1; x < b.width; x += 0.24) c.box(x, z + 0.04, x + 0.1, z + 0.1, s.trim * 0.7f);
      streaks(&c, &rng, 0, b.width, z, 0.7, 0.3f);
    }
  if (s.quoins)
    for (int i = 0; i * 0.34 + b.street_level < b.eaves; ++i)
      for (const bool right : {false, true}) {
        const double w = (i & 1) ? 0.30 : 0.48, z = b.street_level + 0.34 * i, x = right ? b.width - w : 0;
        c.box(x, z + 0.012, x + w, z + 0.33, s.trim * static_cast<float>(rng.uniform(0.85, 1.05)));
        c.frame(x + 0.01, z + 0.02, x + w - 0.01, z + 0.32, 0.01, s.trim * 0.6f);
      }
  for (const auto& o : b.openings) {
    if (o.kind == OpeningKind::kShopWindow) {
      c.frame(o.x, o.z, o.x + o.width, o.z + o.height, 0.07, s.trim * 0.6f);
      continue;
    }
    if (s.surround) c.frame(o.x, o.z, o.x + o.width, o.z + o.height, 0.08 + 0.03 * s.surround, s.trim);
    if (s.surround == 2)
      for (double z = o.z; z < o.z + o.height; z += 0.3)
        for (const double x : {o.x - 0.13, o.x + o.width + 0.01}) c.line(x, z, x + 0.12, z, 0.015, s.trim * 0.6f);
    if (s.lintel == 1) {  // keystone and gable over the window
      c.box(o.x - 0.2, o.z + o.height + 0.12, o.x + o.width + 0.2, o.z + o.height + 0.24, s.trim);
      c.line(o.x - 0.2, o.z + o.height + 0.12, o.x + o.width + 0.2, o.z + o.height + 0.12, 0.02, s.trim * 0.5f);
      c.box(o.x + 0.5 * o.width - 0.09, o.z + o.height, o.x + 0.5 * o.width + 0.09, o.z + o.height + 0.28,
            s.trim * 0.85f);
    }
    if (s.shutters && o.kind == OpeningKind::kWindow && o.floor > 0) {
      const double w = std::min(0.45, 0.45 * o.width);
      for (const double x : {o.x - w - 0.09, o.x + o.width + 0.09}) {
        c.box(x, o.z, x + w, o.z + o.height, s.shutter);
        c.frame(x + 0.05, o.z + 0.05, x + w - 0.05, o.z + o.height - 0.05, 0.02, s.shutter * 0.7f);
        for (double z = o.z + 0.1; z < o.z + o.height - 0.08; z += 0.06)
          c.line(x + 0.06, z, x + w - 0.06, z, 0.018, s.shutter * 0.55f);
      }
    }
    if (o.floor > 0) streaks(&c, &rng, o.x - 0.1, o.x + o.width + 0.1, o.z - 0.02, rng.uniform(0.4, 1.3), 0.55f);
  }
  clutter(&c, b, season, &rng, &changing);
  return c.image();
}

cv::Mat paintPane(const Building& b, int index, Season season, double texel) {
  const Style s(b);
  const Opening& o = b.openings[index];
  Canvas c(o.width, o.height, texel);
  const double w = c.width(), h = c.height();
  // Two fifths of the panes look different on the other day.
  Rng fixed(mix(mix(b.seed, 50), index)), day(mix(mix(b.seed, 51 + static_cast<int>(season)), index));
  const bool changes = fixed.chance(0.4);
  Rng& rng = changes ? day : fixed;
  const auto seed = static_cast<std::uint32_t>(rng.next()), mirror = static_cast<std::uint32_t>(day.next());
  if (o.kind == OpeningKind::kDoor) {
    Rng leaf(mix(mix(b.seed, 60), o.column));
    const Vec3f color =
        pick(&leaf, {{96, 62, 42}, {60, 84, 70}, {120, 40, 36}, {64, 70, 84}, {150, 120, 86}, {44, 44, 48}});
    c.fill([&](float x, float z) {
      return color * (1 + 0.10f * fractalNoise(60 * x, 4 * z, seed, 3) + 0.05f * fractalNoise(30 * x, 30 * z, seed, 2));
    });
    const bool glazed = b.shop || leaf.chance(0.4);
    if (glazed) {
      c.box(0.12, 0.5, w - 0.12, h - 0.15, {46, 50, 54});
      c.change(0.12, 0.5, w - 0.12, h - 0.15, [&](float x, float z, const Vec3f& old) {
        return old * (1 + 0.6f * fractalNoise(2 * x, 1.3f * z, mirror, 3));
      });
      poster(&c, &rng, 0.2, 1.2, 0.35 * w, 0.4);
    } else {
      for (double z = 0.15; z < h - 0.5; z += 0.62)
        for (const double x : {0.1, 0.5 * w + 0.05}) {
          c.frame(x + 0.03, z + 0.03, x + 0.5 * w - 0.18, z + 0.5, 0.025, color * 0.55f);
          c.line(x + 0.03, z + 0.03, x + 0.5 * w - 0.18, z + 0.03, 0.02, color * 1.35f);
        }
    }
    c.box(w - 0.14, 1.0, w - 0.08, 1.16, {196, 180, 120});
    c.frame(0.05, 0.02, w - 0.05, h - 0.05, 0.05, s.frame * 0.8f);
    c.text(std::to_string(1 + leaf.integer(98)), 0.4 * w, h - 0.3, 0.14, {230, 226, 210}, kFonts[1]);
    return c.image();
  }
  // Glass: dark room, mirrored sky and houses from across.
  const float tone = season == Season::kPanoramas ? 1.0f : 0.8f;
  c.fill([&](float x, float z) {
    const float n = fractalNoise(1.1f * x + 3.1f * index, 0.8f * z, mirror, 3),
                blocks = latticeHash(static_cast<int>(x / 0.21f), static_cast<int>(z / 0.3f), 0, mirror);
    return Vec3f(58, 66, 76) * (tone * (1 + 0.45f * n + 0.25f * (blocks - 0.5f) + 0.25f * z / static_cast<float>(h)));
  });
  if (o.kind == OpeningKind::kShopWindow) {
    c.change(0, 0, w, h, [&](float x, float z, const Vec3f& old) {
      return old * (1.1f + 0.2f * fractalNoise(3 * x, 3 * z, seed, 3));
    });
    double x = 0.1;
    while (x < w - 0.3) {  // goods on the floor and on shelves
      const double gw = rng.uniform(0.12, 0.4), gh = rng.uniform(0.2, 0.9);
      const Vec3f color = pick(&rng, {{190, 60, 50},
                                      {60, 100, 160},
                                      {220, 200, 120},
                                      {230, 228, 222},
                                      {90, 140, 90},
                                      {120, 80, 130},
                                      {60, 56, 54},
                                      {210, 130, 60}});
      if (rng.chance(0.5))
        cv::ellipse(c.image(), c.at(x + 0.5 * gw, 0.5 * gh), {c.px(0.5 * gw), c.px(0.5 * gh)}, 0, 0, 360, scalar(color),
                    cv::FILLED, cv::LINE_AA);
      else
        c.box(x, 0, x + gw, gh, color);
      if (rng.chance(0.4)) c.text(std::to_string(rng.integer(99)), x + 0.02, 0.3 * gh, 0.1, {240, 240, 236}, kFonts[1]);
      if (rng.chance(0.6)) c.box(x, h - 0.6, x + 0.8 * gw, h - 0.6 + rng.uniform(0.1, 0.3), color * 0.8f);
      x += gw + rng.uniform(0.02, 0.25);
    }
    c.line(0, h - 0.62, w, h - 0.62, 0.03, {120, 110, 100});
    const int sheets = 1 + rng.integer(3);
    for (int i = 0; i < sheets; ++i)
      poster(&c, &rng, rng.uniform(0.05, w - 0.5), rng.uniform(0.3, h - 0.9), rng.uniform(0.25, 0.5),
             rng.uniform(0.3, 0.6));
    if (fixed.chance(0.6))
      c.text(syllables(&fixed, 2), 0.15, h - 0.35, 0.22, {236, 232, 220}, kFonts[fixed.integer(5)]);
    c.frame(0.06, 0.06, w - 0.06, h - 0.06, 0.06, s.frame * 0.8f);
    const int bars = std::max(1, static_cast<int>(w / 1.6));
    for (int i = 1; i < bars; ++i) c.box(w * i / bars - 0.03, 0, w * i / bars + 0.03, h, s.frame * 0.8f);
    return c.image();
  }
  const int kind = rng.integer(6);
  const float cloth = static_cast<float>(rng.uniform(120, 190));
  const auto curtain = [&](double x0, double x1, double z0) {
    c.change(x0, z0, x1, h, [&](float x, float z, const Vec3f&) {
      const float fold = std::sin(45 * x + 4 * fractalNoise(2 * x, z, seed, 2)) + 0.6f * std::sin(23 * x + 1.3f * z);
      return Vec3f(cloth, cloth * 0.97f, cloth * 0.92f) * (0.85f + 0.12f * fold);
    });
  };
  if (kind == 0) curtain(0, w, 0);
  if (kind == 1 || kind == 2) {
    const double share = rng.uniform(0.15, 0.35);
    curtain(0, share * w, 0);
    curtain((1 - share) * w, w, 0);
  }
  if (kind == 3) {  // blinds let down part of the way
    const double z0 = h * rng.uniform(0.0, 0.7);
    c.box(0, z0, w, h, {178, 172, 160});
    for (double z = z0; z < h; z += 0.055) c.line(0, z, w, z, 0.014, {112, 106, 98});
  }
  if (kind == 4)  // plants on the sill
    for (int i = 0; i < 4; ++i) {
      const double x = rng.uniform(0.15, w - 0.15);
      for (int k = 0; k < 26; ++k)
        cv::circle(c.image(), c.at(x + 0.08 * rng.gaussian(), 0.12 + 0.25 * rng.uniform()),
                   c.px(rng.uniform(0.012, 0.035)),
                   scalar(Vec3f(50, 90, 44) * static_cast<float>(rng.uniform(0.6, 1.4))), cv::FILLED);
      c.box(x - 0.09, 0.05, x + 0.09, 0.18, {150, 86, 60});
    }
  if (kind == 5) {  // a lamp, shelves
    cv::circle(c.image(), c.at(rng.uniform(0.3, 0.7) * w, 0.72 * h), c.px(0.11), {232, 214, 160}, cv::FILLED,
               cv::LINE_AA);
    for (int i = 0; i < 7; ++i)
      c.box(0.1 + 0.1 * i, 0.25, 0.17 + 0.1 * i, 0.25 + rng.uniform(0.15, 0.3),
            pick(&rng, {{150, 60, 50}, {70, 90, 130}, {170, 160, 110}}));
  }
  const double bar = 0.055;
  c.frame(bar, bar, w - bar, h - bar, bar, s.frame);
  c.frame(bar + 0.01, bar + 0.01, w - bar - 0.01, h - bar - 0.01, 0.012, s.frame * 0.6f);
  const auto vertical = [&](double x) { c.box(x - 0.5 * bar, 0, x + 0.5 * bar, h, s.frame); };
  const auto horizontal = [&](double z) { c.box(0, z - 0.4 * bar, w, z + 0.4 * bar, s.frame); };
  if (s.mullions != 3) vertical(0.5 * w);
  if (s.mullions == 1) horizontal(0.7 * h);
  if (s.mullions == 2) {
    horizontal(0.36 * h);
    horizontal(0.68 * h);
  }
  return c.image();
}

cv::Mat paintPlain(const Vec3f& color, double width, double height, double texel, std::uint64_t seed) {
  Canvas c(width, height, texel);
  const auto s = static_cast<std::uint32_t>(seed);
  c.fill([&](float x, float z) {
    return color *
           (1 + 0.10f * fractalNoise(24 * x, 24 * z, s, 3, 0.85f) + 0.12f * fractalNoise(1.2f * x, 1.2f * z, s + 5, 4));
  });
  return c.image();
}

cv::Mat paintSign(const Building& b, int shop, bool blade, double width, double height, double texel) {
  Rng rng(mix(mix(b.seed, 70), shop));
  Canvas c(width, height, texel);
  const Vec3f board = pick(
      &rng, {{40, 44, 50}, {150, 34, 34}, {30, 70, 120}, {28, 90, 62}, {222, 214, 196}, {220, 170, 40}, {90, 60, 44}});
  const bool dark = board[0] + board[1] + board[2] < 380;
  const Vec3f ink = dark ? Vec3f(240, 236, 224) : Vec3f(40, 36, 34);
  const int font = kFonts[rng.integer(4)];
  const std::string name = syllables(&rng, 2 + rng.integer(2));
  c.fill([&](float x, float z) {
    return board * (1 + 0.06f * fractalNoise(20 * x, 20 * z, static_cast<std::uint32_t>(b.seed), 3));
  });
  c.frame(0.03, 0.03, width - 0.03, height - 0.03, 0.02, ink * 0.8f);
  if (blade) {
    cv::circle(c.image(), c.at(0.5 * width, 0.62 * height), c.px(0.27 * std::min(width, height)), scalar(ink),
               c.px(0.035), cv::LINE_AA);
    c.text(name.substr(0, 1 + rng.integer(2)), 0.33 * width, 0.53 * height, 0.2 * height, ink, font);
    c.text(name.substr(0, 5), 0.12 * width, 0.12 * height, 0.13 * height, ink, kFonts[1]);
    return c.image();
  }
  const double letters = 0.5 * height;
  double x = rng.uniform(0.15, 0.4);
  const double w = c.textWidth(name, letters, font);
  if (w < width) x = rng.uniform(0.1, std::max(0.11, width - w - 0.1));
  c.text(name, x, 0.27 * height, letters, ink, font);
  if (x > 0.9)
    cv::circle(c.image(), c.at(0.45, 0.5 * height), c.px(0.3 * height),
               scalar(pick(&rng, {{220, 170, 40}, {200, 60, 50}, {240, 240, 240}, {60, 140, 90}})), cv::FILLED,
               cv::LINE_AA);
  if (x + w + 1.2 < width)
    c.text("Tel " + std::to_string(10 + rng.integer(89)) + " " + std::to_string(100 + rng.integer(899)), x + w + 0.25,
           0.3 * height, 0.22 * height, ink, kFonts[0]);
  return c.image();
}

cv::Mat paintRailing(const Building& b, int index, Season season, double width, double height, double texel) {
  Rng rng(mix(b.seed, 80)), own(mix(mix(b.seed, 81), index));
  Canvas c(width, height, texel);
  const Vec3f color = pick(&rng, {{60, 62, 66}, {214, 210, 200}, {110, 76, 50}, {84, 104, 96}});
  const int kind = rng.integer(3);
  const auto seed = static_cast<std::uint32_t>(own.next());
  c.fill([&](float x, float z) {
    return (kind == 0 ? Vec3f(46, 46, 50) : color) * (1 + 0.12f * fractalNoise(15 * x, 15 * z, seed, 3));
  });
  if (kind == 0)
    for (double x = 0.03; x < width; x += 0.11) c.box(x, 0.05, x + 0.03, height, color * 1.3f);
  if (kind == 1)
    for (double x = 0; x < width; x += 0.18) c.line(x, 0, x, height, 0.012, color * 0.6f);
  if (kind == 2)
    for (double x = 0.1; x < width; x += 0.3)
      cv::ellipse(c.image(), c.at(x, 0.5 * height), {c.px(0.08), c.px(0.32 * height)}, 0, 0, 360, scalar(color * 0.6f),
                  c.px(0.025), cv::LINE_AA);
  c.box(0, height - 0.07, width, height, color * 0.9f);
  c.box(0, 0, width, 0.07, color * 0.7f);
  if (own.chance(season == Season::kPanoramas ? 0.6 : 0.25)) {  // flower boxes
    Rng flowers(mix(own.next(), static_cast<int>(season)));
    const Vec3f bloom = pick(&flowers, {{200, 50, 60}, {220, 180, 60}, {180, 80, 160}, {230, 225, 220}});
    for (int i = 0; i < static_cast<int>(60 * width); ++i)
      cv::circle(c.image(), c.at(flowers.uniform(0, width), height - 0.12 + 0.07 * flowers.gaussian()),
                 c.px(flowers.uniform(0.012, 0.035)),
                 scalar(flowers.chance(0.3) && season == Season::kPanoramas
                            ? bloom
                            : Vec3f(54, 92, 46) * static_cast<float>(flowers.uniform(0.6, 1.4))),
                 cv::FILLED);
  }
  return c.image();
}

cv::Mat paintAwning(const Building& b, int shop, double width, double height, double texel) {
  Rng rng(mix(mix(b.seed, 90), shop));
  const Vec3f a = pick(&rng, {{170, 40, 40}, {40, 90, 60}, {40, 60, 120}, {200, 150, 60}}), white(226, 222, 212);
  const float stripe = static_cast<float>(rng.uniform(0.12, 0.35));
  Canvas c(width, height, texel);
  c.fill([&](float x, float z) {
    return (static_cast<int>(x / stripe) & 1 ? a : white) *
           (1 + 0.08f * fractalNoise(9 * x, 9 * z, static_cast<std::uint32_t>(b.seed), 3));
  });
  return c.image();
}

cv::Mat paintRoof(const Building& b, double width, double height, double texel) {
  Rng rng(mix(b.seed, 95));
  const Vec3f color = b.roof == RoofKind::kFlat
                          ? Vec3f(110, 106, 100)
                          : pick(&rng, {{150, 82, 62}, {120, 70, 56}, {92, 86, 84}, {136, 96, 74}});
  const auto s = static_cast<std::uint32_t>(b.seed);
  Canvas c(width, height, texel);
  c.fill([&](float x, float z) {
    const float n = 1 + 0.18f * fractalNoise(1.3f * x, 1.3f * z, s, 5);
    if (b.roof == RoofKind::kFlat) return color * (n * (1 + 0.25f * valueNoise(22 * x, 22 * z, s)));
    const int row = static_cast<int>(z / 0.34f);
    const float shifted = x / 0.24f + 0.5f * (row & 1);
    const float edge = z / 0.34f - row < 0.15f ? 0.55f : shifted - std::floor(shifted) < 0.12f ? 0.7f : 1.0f;
    return color * (n * edge * (0.75f + 0.5f * latticeHash(row, static_cast<int>(shifted), 1, s)));
  });
  return c.image();
}

}  // namespace air_ground_sim
