// Noise of the cameras, the satellite receiver, barometer and magnetometer against the formulas they are documented
// with.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "air_ground_sim/positioning.h"
#include "air_ground_sim/sensors.h"

namespace air_ground_sim {
namespace {

DepthImage plane(float z, float cosine) {
  DepthImage d;
  d.width = 320;
  d.height = 240;
  d.depth.assign(320 * 240, z);
  d.cosine.assign(320 * 240, cosine);
  d.lit.assign(320 * 240, 1);
  return d;
}

TEST(KinectDepth, ErrorHasTheFormulasSpread) {
  DepthConfig c;
  for (const float z : {0.8f, 1.5f, 2.5f, 4.0f}) {
    std::vector<std::uint16_t> mm;
    measureDepth(plane(z, 1.0f), c, 1, 0, &mm);
    double sum = 0, sum2 = 0;
    int n = 0;
    for (const auto m : mm)
      if (m) {
        const double e = 0.001 * m - z;
        sum += e;
        sum2 += e * e;
        ++n;
      }
    const double step = z * z / (c.focal * c.baseline * c.subpixel), sigma = kinectAxialSigma(z, 0);
    EXPECT_NEAR(sigma, 0.0012 + 0.0019 * (z - 0.4) * (z - 0.4), 1e-9);
    // Rounding to a step that is not small against sigma adds between none and step^2 / 4 to the variance.
    EXPECT_GT(std::sqrt(sum2 / n), 0.8 * sigma);
    EXPECT_LT(std::sqrt(sum2 / n), std::sqrt(sigma * sigma + step * step / 4) + 0.0006);
    EXPECT_LT(std::abs(sum / n), 0.5 * step + 0.0006);
    EXPECT_NEAR(1 - n / (320.0 * 240), c.dropout, 0.002 + (z >= 4 ? 0.01 : 0));
  }
}

TEST(KinectDepth, ValuesAreQuantisedInDisparity) {
  DepthConfig c;
  std::vector<std::uint16_t> mm;
  measureDepth(plane(3.0f, 1.0f), c, 1, 0, &mm);
  const double steps = c.focal * c.baseline * c.subpixel;
  std::set<std::uint16_t> values;
  for (const auto m : mm)
    if (m) values.insert(m);
  EXPECT_LT(values.size(), 8u);
  for (const auto m : values) {
    const double disparity = steps / (0.001 * m);
    EXPECT_NEAR(disparity, std::round(disparity), 0.03);
  }
}

TEST(KinectDepth, LosesWhatAKinectLoses) {
  DepthConfig c;
  std::vector<std::uint16_t> mm;
  const auto share = [&](const DepthImage& d) {
    measureDepth(d, c, 1, 0, &mm);
    return std::count_if(mm.begin(), mm.end(), [](std::uint16_t m) { return m > 0; }) / static_cast<double>(mm.size());
  };
  EXPECT_GT(share(plane(2, 0.9f)), 0.99);
  EXPECT_EQ(share(plane(2, 0.03f)), 0) << "grazing";
  EXPECT_GT(share(plane(2, 0.11f)), 0.2);
  EXPECT_LT(share(plane(2, 0.11f)), 0.8);
  EXPECT_EQ(share(plane(0.4f, 1)), 0) << "too near";
  EXPECT_EQ(share(plane(4.8f, 1)), 0) << "too far";
  DepthImage dark = plane(2, 1);
  dark.lit.assign(dark.lit.size(), 0);
  EXPECT_EQ(share(dark), 0) << "in the projector's shadow";
  DepthImage step = plane(1, 1);
  for (int y = 0; y < step.height; ++y)
    for (int x = 160; x < step.width; ++x) step.depth[y * step.width + x] = 2;
  share(step);
  int at_edge = 0;
  for (int y = 0; y < step.height; ++y)
    for (int x = 158; x < 162; ++x) at_edge += mm[y * step.width + x] > 0;
  EXPECT_LT(at_edge, 0.65 * 4 * step.height);
}

TEST(KinectDepth, NoiseCanBeSwitchedOff) {
  DepthConfig c;
  c.noise = false;
  std::vector<std::uint16_t> mm;
  measureDepth(plane(1.2345f, 0.5f), c, 1, 0, &mm);
  for (const auto m : mm) EXPECT_EQ(m, 1235);  // 1234.5 rounds away from zero; float holds 1.23450005
}

ImagerConfig plainImager() {
  ImagerConfig c = SimConfig::defaults().mav_camera;
  c.response = 1;
  c.sensitivity = 100;
  return c;
}

TEST(Imager, VignettingDarkensTheCorners) {
  ImagerConfig c = plainImager();
  c.read_noise = 0;
  c.full_well = 1e6;
  const Imager imager(c, 1);
  EXPECT_NEAR(imager.vignette(371, 244), 1, 1e-3);
  std::vector<std::uint8_t> image;
  imager.expose(std::vector<float>(752 * 480, 0.8f), 1, 0.01, 0, &image);
  double corner = 0, center = 0;
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 8; ++x) {
      corner += image[y * 752 + x];
      center += image[(240 + y) * 752 + 368 + x];
    }
  EXPECT_NEAR(corner / center, imager.vignette(4, 4), 0.01);
  EXPECT_NEAR(imager.vignette(0, 479), 1 - c.vignetting, 0.03);
}

TEST(Imager, NoiseIsShotPlusRead) {
  ImagerConfig c = plainImager();
  c.vignetting = 0;
  for (const float light : {0.1f, 0.4f, 0.8f}) {
    std::vector<std::uint8_t> image;
    Imager(c, 3).expose(std::vector<float>(752 * 480, light), 1, 0.01, 0, &image);
    double sum = 0, sum2 = 0;
    for (const auto v : image) {
      sum += v;
      sum2 += static_cast<double>(v) * v;
    }
    const double n = image.size(), mean = sum / n, variance = sum2 / n - mean * mean;
    const double electrons = light * c.full_well;
    const double expected =
        255 * 255 * (electrons + c.read_noise * c.read_noise) / (c.full_well * c.full_well) + 1 / 12.0;
    EXPECT_NEAR(mean, 255 * light, 0.2);
    EXPECT_NEAR(std::sqrt(variance), std::sqrt(expected), 0.03 * std::sqrt(expected));
  }
}

TEST(Imager, NoiseDiffersBetweenFrames) {
  const Imager imager(plainImager(), 3);
  std::vector<std::uint8_t> a, b, again;
  const std::vector<float> light(752 * 480, 0.5f);
  imager.expose(light, 1, 0.01, 0, &a);
  imager.expose(light, 1, 0.01, 1, &b);
  imager.expose(light, 1, 0.01, 0, &again);
  EXPECT_NE(a, b);
  EXPECT_EQ(a, again);
  EXPECT_THROW(imager.expose(std::vector<float>(10), 1, 0.01, 0, &a), std::invalid_argument);
}

TEST(ExposureControl, ReachesTheTargetAndFollowsTheLight) {
  ImagerConfig c = SimConfig::defaults().mav_camera;
  c.min_exposure = 1e-4;
  c.max_exposure = 0.05;
  const Imager imager(c, 1);
  ExposureControl control(c);
  double exposure_bright = 0;
  for (const float light : {0.3f, 0.1f}) {
    double mean = 0;
    std::vector<std::uint8_t> image;
    for (int i = 0; i < 40; ++i) {
      mean = imager.expose(std::vector<float>(752 * 480, light), 1, control.exposure(), i, &image);
      control.update(mean);
    }
    EXPECT_NEAR(mean, c.target_mean, 0.02);
    if (exposure_bright > 0) {
      EXPECT_NEAR(control.exposure() / exposure_bright, 3, 0.3);
    }
    exposure_bright = control.exposure();
  }
}

TEST(Positioning, SatellitesErrByMetresForLongAndJump) {
  GpsConfig c;
  c.rate = 2;
  double horizontal = 0, vertical = 0, step = 0;
  int n = 0, jumps = 0;
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    GpsReceiver gps(c, seed);
    Eigen::Vector3d last = Eigen::Vector3d::Zero();
    for (int i = 0; i < 400; ++i, ++n) {
      const Eigen::Vector3d e = gps.measure(Eigen::Vector3d::Zero());
      horizontal += e.head<2>().squaredNorm();
      vertical += e.z() * e.z();
      if (i) step += (e - last).head<2>().squaredNorm();
      jumps += i && (e - last).head<2>().norm() > 3;
      last = e;
    }
  }
  const double rms = std::sqrt(horizontal / n);
  EXPECT_GT(rms, 3);
  EXPECT_LT(rms, 6);
  EXPECT_NEAR(std::sqrt(vertical / n), 11, 1.5);
  EXPECT_LT(std::sqrt(step / n), 0.5 * rms) << "the error is slow";
  EXPECT_GT(jumps, n / 2 / 60) << "and jumps within a minute";
}

TEST(Positioning, PressureFallsByTwelvePascalAMetre) {
  EXPECT_NEAR(standardPressure(0), 101325, 1e-9);
  EXPECT_NEAR(standardPressure(410) - standardPressure(411), 11.55, 0.1);
  EXPECT_NEAR(standardPressure(1000), 89875, 10);  // ICAO table
  BarometerConfig c;
  c.rate = 20;
  Barometer b(c, 3);
  double mean = 0, first = 0;
  for (int i = 0; i < 200; ++i) (i < 100 ? first : mean) += b.measure(i < 100 ? 410 : 420) / 100;
  EXPECT_NEAR(first - mean, 115, 5);
}

TEST(Positioning, IronBendsTheFieldByItsAmplitude) {
  Rng rng(1);
  double sum = 0, change = 0;
  const int n = 20000;
  for (int i = 0; i < n; ++i) {
    const Eigen::Vector3d p(rng.uniform(-100, 100), rng.uniform(-100, 100), rng.uniform(0, 15));
    const Eigen::Vector3d f = magneticDisturbance(p, 8e-7, 5);
    sum += f.squaredNorm() / 3;
    change += (magneticDisturbance(p + Eigen::Vector3d(0.2, 0, 0), 8e-7, 5) - f).squaredNorm() / 3;
  }
  EXPECT_NEAR(std::sqrt(sum / n), 8e-7, 8e-8);
  EXPECT_LT(std::sqrt(change / n), 2e-7);
}

}  // namespace
}  // namespace air_ground_sim
