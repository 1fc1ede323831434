#include "air_ground_sim/street/street_paint.h"

#include "air_ground_sim/noise.h"
#include "facade_canvas.h"

namespace air_ground_sim {
namespace {

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
