// What fills the openings of a facade: doors, shop windows, windows of rooms.
#include "air_ground_sim/noise.h"
#include "air_ground_sim/street/street_paint.h"
#include "facade_canvas.h"

namespace air_ground_sim {
namespace {

void paintDoor(Canvas* c, const Building& b, const Opening& o, std::uint32_t seed, std::uint32_t mirror, Rng* rng) {
  const Style s(b);
  const double w = c->width(), h = c->height();
  Rng leaf(mix(mix(b.seed, 60), o.column));
  const Vec3f color =
      pick(&leaf, {{96, 62, 42}, {60, 84, 70}, {120, 40, 36}, {64, 70, 84}, {150, 120, 86}, {44, 44, 48}});
  c->fill([&](float x, float z) {
    return color * (1 + 0.10f * fractalNoise(60 * x, 4 * z, seed, 3) + 0.05f * fractalNoise(30 * x, 30 * z, seed, 2));
  });
  const bool glazed = b.shop || leaf.chance(0.4);
  if (glazed) {
    c->box(0.12, 0.5, w - 0.12, h - 0.15, {46, 50, 54});
    c->change(0.12, 0.5, w - 0.12, h - 0.15, [&](float x, float z, const Vec3f& old) {
      return old * (1 + 0.6f * fractalNoise(2 * x, 1.3f * z, mirror, 3));
    });
    poster(c, rng, 0.2, 1.2, 0.35 * w, 0.4);
  } else {
    for (double z = 0.15; z < h - 0.5; z += 0.62)
      for (const double x : {0.1, 0.5 * w + 0.05}) {
        c->frame(x + 0.03, z + 0.03, x + 0.5 * w - 0.18, z + 0.5, 0.025, color * 0.55f);
        c->line(x + 0.03, z + 0.03, x + 0.5 * w - 0.18, z + 0.03, 0.02, color * 1.35f);
      }
  }
  c->box(w - 0.14, 1.0, w - 0.08, 1.16, {196, 180, 120});
  c->frame(0.05, 0.02, w - 0.05, h - 0.05, 0.05, s.frame * 0.8f);
  c->text(std::to_string(1 + leaf.integer(98)), 0.4 * w, h - 0.3, 0.14, {230, 226, 210}, kFonts[1]);
}

// Dark room, mirrored sky and houses from across.
void paintGlass(Canvas* c, int index, Season season, std::uint32_t mirror) {
  const double h = c->height();
  const float tone = season == Season::kPanoramas ? 1.0f : 0.8f;
  c->fill([&](float x, float z) {
    const float n = fractalNoise(1.1f * x + 3.1f * index, 0.8f * z, mirror, 3),
                blocks = latticeHash(static_cast<int>(x / 0.21f), static_cast<int>(z / 0.3f), 0, mirror);
    return Vec3f(58, 66, 76) * (tone * (1 + 0.45f * n + 0.25f * (blocks - 0.5f) + 0.25f * z / static_cast<float>(h)));
  });
}

// Goods, sheets, lettering. `fixed` does not change with the day.
void paintShopWindow(Canvas* c, const Style& s, std::uint32_t seed, Rng* fixed, Rng* rng) {
  const double w = c->width(), h = c->height();
  c->change(0, 0, w, h, [&](float x, float z, const Vec3f& old) {
    return old * (1.1f + 0.2f * fractalNoise(3 * x, 3 * z, seed, 3));
  });
  double x = 0.1;
  while (x < w - 0.3) {  // goods on the floor and on shelves
    const double gw = rng->uniform(0.12, 0.4), gh = rng->uniform(0.2, 0.9);
    const Vec3f color = pick(rng, {{190, 60, 50},
                                   {60, 100, 160},
                                   {220, 200, 120},
                                   {230, 228, 222},
                                   {90, 140, 90},
                                   {120, 80, 130},
                                   {60, 56, 54},
                                   {210, 130, 60}});
    if (rng->chance(0.5))
      cv::ellipse(c->image(), c->at(x + 0.5 * gw, 0.5 * gh), {c->px(0.5 * gw), c->px(0.5 * gh)}, 0, 0, 360,
                  scalar(color), cv::FILLED, cv::LINE_AA);
    else
      c->box(x, 0, x + gw, gh, color);
    if (rng->chance(0.4))
      c->text(std::to_string(rng->integer(99)), x + 0.02, 0.3 * gh, 0.1, {240, 240, 236}, kFonts[1]);
    if (rng->chance(0.6)) c->box(x, h - 0.6, x + 0.8 * gw, h - 0.6 + rng->uniform(0.1, 0.3), color * 0.8f);
    x += gw + rng->uniform(0.02, 0.25);
  }
  c->line(0, h - 0.62, w, h - 0.62, 0.03, {120, 110, 100});
  const int sheets = 1 + rng->integer(3);
  for (int i = 0; i < sheets; ++i)
    poster(c, rng, rng->uniform(0.05, w - 0.5), rng->uniform(0.3, h - 0.9), rng->uniform(0.25, 0.5),
           rng->uniform(0.3, 0.6));
  if (fixed->chance(0.6))
    c->text(syllables(fixed, 2), 0.15, h - 0.35, 0.22, {236, 232, 220}, kFonts[fixed->integer(5)]);
  c->frame(0.06, 0.06, w - 0.06, h - 0.06, 0.06, s.frame * 0.8f);
  const int bars = std::max(1, static_cast<int>(w / 1.6));
  for (int i = 1; i < bars; ++i) c->box(w * i / bars - 0.03, 0, w * i / bars + 0.03, h, s.frame * 0.8f);
}

// What stands behind the pane of a room.
void paintRoom(Canvas* c, std::uint32_t seed, Rng* rng) {
  const double w = c->width(), h = c->height();
  const int kind = rng->integer(6);
  const float cloth = static_cast<float>(rng->uniform(120, 190));
  const auto curtain = [&](double x0, double x1, double z0) {
    c->change(x0, z0, x1, h, [&](float x, float z, const Vec3f&) {
      const float fold = std::sin(45 * x + 4 * fractalNoise(2 * x, z, seed, 2)) + 0.6f * std::sin(23 * x + 1.3f * z);
      return Vec3f(cloth, cloth * 0.97f, cloth * 0.92f) * (0.85f + 0.12f * fold);
    });
  };
  if (kind == 0) curtain(0, w, 0);
  if (kind == 1 || kind == 2) {
    const double share = rng->uniform(0.15, 0.35);
    curtain(0, share * w, 0);
    curtain((1 - share) * w, w, 0);
  }
  if (kind == 3) {  // blinds let down part of the way
    const double z0 = h * rng->uniform(0.0, 0.7);
    c->box(0, z0, w, h, {178, 172, 160});
    for (double z = z0; z < h; z += 0.055) c->line(0, z, w, z, 0.014, {112, 106, 98});
  }
  if (kind == 4)  // plants on the sill
    for (int i = 0; i < 4; ++i) {
      const double x = rng->uniform(0.15, w - 0.15);
      for (int k = 0; k < 26; ++k)
        cv::circle(c->image(), c->at(x + 0.08 * rng->gaussian(), 0.12 + 0.25 * rng->uniform()),
                   c->px(rng->uniform(0.012, 0.035)),
                   scalar(Vec3f(50, 90, 44) * static_cast<float>(rng->uniform(0.6, 1.4))), cv::FILLED);
      c->box(x - 0.09, 0.05, x + 0.09, 0.18, {150, 86, 60});
    }
  if (kind == 5) {  // a lamp, shelves
    cv::circle(c->image(), c->at(rng->uniform(0.3, 0.7) * w, 0.72 * h), c->px(0.11), {232, 214, 160}, cv::FILLED,
               cv::LINE_AA);
    for (int i = 0; i < 7; ++i)
      c->box(0.1 + 0.1 * i, 0.25, 0.17 + 0.1 * i, 0.25 + rng->uniform(0.15, 0.3),
             pick(rng, {{150, 60, 50}, {70, 90, 130}, {170, 160, 110}}));
  }
}

void paintWindowFrame(Canvas* c, const Style& s) {
  const double w = c->width(), h = c->height();
  const double bar = 0.055;
  c->frame(bar, bar, w - bar, h - bar, bar, s.frame);
  c->frame(bar + 0.01, bar + 0.01, w - bar - 0.01, h - bar - 0.01, 0.012, s.frame * 0.6f);
  const auto vertical = [&](double x) { c->box(x - 0.5 * bar, 0, x + 0.5 * bar, h, s.frame); };
  const auto horizontal = [&](double z) { c->box(0, z - 0.4 * bar, w, z + 0.4 * bar, s.frame); };
  if (s.mullions != 3) vertical(0.5 * w);
  if (s.mullions == 1) horizontal(0.7 * h);
  if (s.mullions == 2) {
    horizontal(0.36 * h);
    horizontal(0.68 * h);
  }
}

}  // namespace

cv::Mat paintPane(const Building& b, int index, Season season, double texel) {
  const Style s(b);
  const Opening& o = b.openings[index];
  Canvas c(o.width, o.height, texel);
  // Two fifths of the panes look different on the other day.
  Rng fixed(mix(mix(b.seed, 50), index)), day(mix(mix(b.seed, 51 + static_cast<int>(season)), index));
  const bool changes = fixed.chance(0.4);
  Rng& rng = changes ? day : fixed;
  const auto seed = static_cast<std::uint32_t>(rng.next()), mirror = static_cast<std::uint32_t>(day.next());
  if (o.kind == OpeningKind::kDoor) {
    paintDoor(&c, b, o, seed, mirror, &rng);
    return c.image();
  }
  paintGlass(&c, index, season, mirror);
  if (o.kind == OpeningKind::kShopWindow) {
    paintShopWindow(&c, s, seed, &fixed, &rng);
    return c.image();
  }
  paintRoom(&c, seed, &rng);
  paintWindowFrame(&c, s);
  return c.image();
}

}  // namespace air_ground_sim
