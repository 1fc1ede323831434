// Ground, sky, and what moves or grows: the pictures of the street world that are not on buildings.
#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

#include "air_ground_sim/noise.h"
#include "air_ground_sim/street/street_paint.h"

namespace air_ground_sim {
namespace {

using cv::Vec3f;

cv::Vec3b bytes(const Vec3f& c) {
  cv::Vec3b b;
  for (int k = 0; k < 3; ++k) b[k] = static_cast<std::uint8_t>(std::clamp(c[k], 0.0f, 255.0f));
  return b;
}

struct GroundPlace {
  double across = 1e9;  ///< distance from the nearest centre line [m]
  double along = 0;     ///< [m]
  int line = 0;
};

Vec3f roadAt(float x, float y, const GroundPlace& g, double kerb, std::uint32_t s) {
  const float n = fractalNoise(0.5f * x, 0.5f * y, s, 4), fine = fractalNoise(30 * x, 30 * y, s + 1, 3, 0.85f);
  const float repair = fractalNoise(0.22f * x, 0.22f * y, s + 2, 2) > 0.45f ? 0.82f : 1.0f;
  const float crack = std::abs(fractalNoise(0.8f * x, 0.8f * y, s + 3, 5)) < 0.009f ? 0.6f : 1.0f;
  Vec3f c = Vec3f(98, 98, 100) * (repair * crack * (1 + 0.14f * n + 0.16f * fine));
  const double dash = std::fmod(g.along, 6.0);
  if (g.across < 0.06 && dash < 3.0) c = Vec3f(206, 204, 196) * (0.95f + 0.2f * fine);
  if (std::abs(g.across - (kerb - 2.0)) < 0.05) c = Vec3f(190, 188, 180) * (0.9f + 0.2f * fine);  // parking bays
  if (g.across > kerb - 2.0 && std::fmod(g.along + 3, 5.6) < 0.1) c = Vec3f(190, 188, 180) * (0.9f + 0.2f * fine);
  // Manhole covers here and there.
  const int cell = static_cast<int>(std::floor(g.along / 9));
  const float at = 9 * (cell + 0.2f + 0.6f * latticeHash(cell, g.line, 0, s)),
              side = 2.2f * latticeHash(cell, g.line, 1, s);
  const double r = std::hypot(g.along - at, g.across - side);
  if (r < 0.33)
    c = r > 0.29 ? Vec3f(60, 58, 56) : Vec3f(112, 104, 96) * (std::sin(60 * x) * std::sin(60 * y) > 0 ? 1.1f : 0.75f);
  return c;
}

Vec3f sidewalkAt(float x, float y, const GroundPlace& g, double kerb, std::uint32_t s) {
  const float fine = fractalNoise(28 * x, 28 * y, s + 4, 3, 0.85f), slow = fractalNoise(0.9f * x, 0.9f * y, s + 5, 3);
  if (g.across < kerb + 0.14)
    return Vec3f(172, 168, 160) * ((std::fmod(g.along, 1.0) < 0.015 ? 0.6f : 1.0f) * (1 + 0.1f * fine));
  const double u = g.along / 0.5, v = g.across / 0.5;
  const int iu = static_cast<int>(std::floor(u)), iv = static_cast<int>(std::floor(v));
  if (u - iu < 0.03 || v - iv < 0.03) return Vec3f(96, 92, 86);
  const float gum = valueNoise(9 * x, 9 * y, s + 6) > 0.86f ? 0.7f : 1.0f;
  return Vec3f(150, 146, 138) *
         (gum * (0.86f + 0.22f * latticeHash(iu, iv, g.line, s)) * (1 + 0.12f * fine + 0.1f * slow));
}

Vec3f groundBehind(float x, float y, Season season, std::uint32_t s) {
  const float n = fractalNoise(0.4f * x, 0.4f * y, s + 7, 4), fine = fractalNoise(6 * x, 6 * y, s + 8, 3);
  const Vec3f grass = season == Season::kPanoramas ? Vec3f(86, 108, 56) : Vec3f(124, 108, 66);
  return (n > 0 ? grass : Vec3f(134, 126, 112)) * (1 + 0.25f * fine + 0.15f * n);
}

}  // namespace

cv::Mat paintGround(const Street& street, const Patch& patch, Season season) {
  const int w = std::max(4, static_cast<int>(std::lround(patch.width / patch.texel))),
            h = std::max(4, static_cast<int>(std::lround(patch.height / patch.texel)));
  cv::Mat image(h, w, CV_8UC3);
  const StreetConfig& c = street.config;
  const double half = 0.5 * c.width, kerb = half - c.sidewalk;
  const auto s = static_cast<std::uint32_t>(mix(street.seed, 77));
  struct Line {
    Eigen::Vector2d from, d;
    double length;
    int index;
  };
  std::vector<Line> lines;  // those near this patch
  const Eigen::Vector2d middle = patch.point(0.5f, 0.5f).head<2>().cast<double>();
  for (std::size_t i = 0; i < c.lines.size(); ++i) {
    const Eigen::Vector2d d = c.lines[i].to - c.lines[i].from;
    const double t = std::clamp((middle - c.lines[i].from).dot(d) / d.squaredNorm(), 0.0, 1.0);
    if ((c.lines[i].from + t * d - middle).norm() < half + std::hypot(patch.width, patch.height))
      lines.push_back({c.lines[i].from, d.normalized(), d.norm(), static_cast<int>(i)});
  }
  const Eigen::Vector3f origin = patch.point(0, 0), du = patch.point(1, 0) - origin, dv = patch.point(0, 1) - origin;
#pragma omp parallel for schedule(dynamic, 8)
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const Eigen::Vector2d p = (origin + (x + 0.5f) / w * du + (h - y - 0.5f) / h * dv).head<2>().cast<double>();
      GroundPlace g;
      for (const auto& l : lines) {
        const double along = l.d.dot(p - l.from), clamped = std::clamp(along, 0.0, l.length),
                     across = (p - l.from - clamped * l.d).norm();
        if (across < g.across) g = {across, along + 1000, l.index};
      }
      const auto fx = static_cast<float>(p.x()), fy = static_cast<float>(p.y());
      image.at<cv::Vec3b>(y, x) = bytes(g.across < kerb         ? roadAt(fx, fy, g, kerb, s)
                                        : g.across < half + 0.6 ? sidewalkAt(fx, fy, g, kerb, s)
                                                                : groundBehind(fx, fy, season, s));
    }
  return image;
}

cv::Mat paintThing(Thing thing, std::uint64_t seed, Season season, double width, double height, double texel) {
  const int w = std::max(4, static_cast<int>(std::lround(width / texel))),
            h = std::max(4, static_cast<int>(std::lround(height / texel)));
  cv::Mat image(h, w, CV_8UC3);
  Rng rng(mix(seed, 5));
  const auto s = static_cast<std::uint32_t>(rng.next());
  static const Vec3f paint[] = {{36, 38, 42},  {200, 202, 204}, {150, 152, 156}, {160, 34, 32},
                                {36, 60, 110}, {220, 218, 212}, {60, 84, 70},    {90, 94, 100}};
  static const Vec3f cloth[] = {{40, 44, 60},   {120, 40, 44}, {180, 176, 166}, {60, 90, 70},
                                {70, 100, 150}, {30, 30, 32},  {200, 170, 70},  {140, 110, 84}};
  Vec3f color(200, 160, 130);
  if (thing == Thing::kCarBody || thing == Thing::kCarGlass) color = paint[rng.integer(8)];
  if (thing == Thing::kClothes) color = cloth[rng.integer(8)];
  if (thing == Thing::kBark) color = {84, 72, 60};
  if (thing == Thing::kLeaves) {
    color = season == Season::kPanoramas ? Vec3f(62, 92, 42)
            : rng.chance(0.5)            ? Vec3f(160, 110, 44)
                                         : Vec3f(126, 78, 42);
    color *= static_cast<float>(rng.uniform(0.85, 1.15));
  }
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x) {
      const float u = (x + 0.5f) / w, v = 1 - (y + 0.5f) / h, px = static_cast<float>(u * width),
                  pz = static_cast<float>(v * height);
      Vec3f c = color;
      switch (thing) {
        case Thing::kCarBody:
          c *= 0.8f + 0.35f * v + 0.05f * valueNoise(3 * px, 5 * pz, s);
          if (width > 2.5 && (std::abs(u - 0.35f) < 0.003f || std::abs(u - 0.62f) < 0.003f)) c *= 0.4f;  // door gaps
          if (width > 2.5 && std::abs(v - 0.68f) < 0.03f &&
              (std::abs(u - 0.42f) < 0.025f || std::abs(u - 0.69f) < 0.025f))
            c *= 0.5f;  // handles
          if (width > 2.5 &&
              (std::hypot(px - 0.18 * width, pz - 0.05) < 0.33 || std::hypot(px - 0.8 * width, pz - 0.05) < 0.33))
            c = std::hypot(px - 0.18 * width, pz - 0.05) < 0.2 || std::hypot(px - 0.8 * width, pz - 0.05) < 0.2
                    ? Vec3f(140, 142, 144)
                    : Vec3f(26, 26, 28);                                                                  // wheels
          if (width < 2.5 && (u < 0.18f || u > 0.82f) && v > 0.5f && v < 0.8f) c = Vec3f(210, 200, 190);  // lamps
          if (width < 2.5 && std::abs(u - 0.5f) < 0.15f && std::abs(v - 0.35f) < 0.09f)
            c = Vec3f(226, 224, 216);  // number plate
          break;
        case Thing::kCarGlass:
          if (std::abs(u - 0.5f) > 0.46f || std::abs(v - 0.45f) > 0.4f || std::abs(u - 0.5f) < 0.02f) break;
          c = Vec3f(40, 46, 54) * (1.1f + 0.5f * fractalNoise(2 * px, 2 * pz, s, 3));
          break;
        case Thing::kLeaves: {
          const float a = fractalNoise(7 * px, 7 * pz, s, 4, 0.85f);
          c *= a < -0.35f ? 0.4f : 1 + 0.7f * a;
          break;
        }
        case Thing::kBark:
          c *= 1 + 0.35f * fractalNoise(20 * px, 5 * pz, s, 3);
          break;
        default:
          c *= 1 + 0.2f * fractalNoise(6 * px, 4 * pz, s, 3);
      }
      image.at<cv::Vec3b>(y, x) = bytes(c);
    }
  return image;
}

cv::Mat paintSky(Season season, std::uint64_t seed) {
  const int n = 512;
  cv::Mat image(n, n, CV_8UC3);
  const auto s = static_cast<std::uint32_t>(mix(seed, 88 + static_cast<int>(season)));
  const bool summer = season == Season::kPanoramas;
#pragma omp parallel for schedule(dynamic, 16)
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x) {
      const float a = 2 * (x + 0.5f) / n - 1, b = 2 * (y + 0.5f) / n - 1,
                  z = std::max(0.02f, 1 - std::abs(a) - std::abs(b));
      const float px = 0.9f * a / (z + 0.12f), py = 0.9f * b / (z + 0.12f);  // clouds lie in a plane
      const float cloud =
          std::clamp((fractalNoise(px, py, s, 6, 0.6f) - (summer ? 0.1f : -0.5f)) * (summer ? 2.2f : 1.2f), 0.0f, 1.0f);
      const float up = std::clamp(z * 1.6f, 0.0f, 1.0f);
      const Vec3f blue = summer ? Vec3f(206 - 110 * up, 222 - 66 * up, 240 - 22 * up)
                                : Vec3f(190 - 60 * up, 200 - 48 * up, 214 - 30 * up);
      const Vec3f white = summer ? Vec3f(246, 246, 246) : Vec3f(196, 198, 202);
      image.at<cv::Vec3b>(y, x) = bytes(blue * (1 - cloud) + white * cloud);
    }
  return image;
}

}  // namespace air_ground_sim
