#include "facade_canvas.h"

#include "air_ground_sim/noise.h"

namespace air_ground_sim {

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

Style::Style(const Building& b) {
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

void streaks(Canvas* c, Rng* rng, double x0, double x1, double z, double reach, float strength) {
  const auto seed = static_cast<std::uint32_t>(rng->next());
  c->change(x0, z - reach, x1, z, [&](float x, float y, const Vec3f& old) {
    const float d = static_cast<float>((z - y) / reach);
    const float n = fractalNoise(11 * x, 1.1f * y, seed, 3, 0.8f);
    return old * (1 - std::max(0.0f, n) * strength * (1 - d));
  });
}

}  // namespace air_ground_sim
