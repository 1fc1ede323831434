#include "dense_fusion/plane_sweep.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <opencv2/core.hpp>
#include <random>

#include "dense_fusion/cost_kernels.h"
#include "synthetic_scene.h"

namespace dense_fusion {
namespace {

using testing::boxScene;
using testing::lookDown;
using testing::renderRows;
using testing::Scene;
using testing::wideCamera;

TEST(CostKernels, AddRowMatchesTheReferenceOnRandomInput) {
  std::mt19937 random(7);
  const int width = 301, height = 64, D = 37;
  std::vector<std::uint8_t> image(width * height), reference(width);
  // Smooth enough that 1/64 px of rounding changes a sample by little.
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      image[y * width + x] = static_cast<std::uint8_t>(128 + 60 * std::sin(0.31 * x + 0.1 * y) + random() % 9);
  for (auto& v : reference) v = static_cast<std::uint8_t>(100 + random() % 56);
  std::vector<std::uint32_t> packed(image.size());
  kernels::packNeighborhoods(image.data(), width, height, packed.data());
  // Hypotheses 0.3 px apart are all sampled; of those 0.03 and 0.01 px apart some, with differences between them.
  for (const float spacing : {0.02f, 0.002f, 0.0007f}) {
    std::vector<float> rho(D);
    for (int d = 0; d < D; ++d) rho[d] = 0.2f + spacing * d;
    const kernels::RowOfFrame frame{{3.2f, 20.4f, 1.f}, {0.97f, 0.01f, 1e-5f}, {9.f, 12.f, 0.02f}};
    const int between = kernels::hypothesesBetween(11, 280, frame, rho.data(), D);
    const int stride = 1 + kernels::costStride(280 - 11);
    std::vector<std::uint16_t> fast(stride * D, 5), plain(stride * D, 5);
    kernels::addRow(reference.data(), 11, 280, frame, rho.data(), D, between, packed.data(), width, &fast[1], stride);
    kernels::addRowReference(reference.data(), 11, 280, frame, rho.data(), D, image.data(), width, &plain[1], stride);
    double error = 0, largest = 0, sum = 0;
    for (std::size_t i = 0; i < fast.size(); ++i) {
      const double e = std::abs(double(fast[i]) - plain[i]);
      error += e;
      sum += plain[i];
      largest = std::max(largest, e);
    }
    EXPECT_LT(error, 0.01 * sum) << spacing;
    EXPECT_LE(largest, 64) << spacing;  // two grey levels at the limit of 63: (63^2 - 61^2) / 4
    EXPECT_GT(sum, 1e5);
    for (int d = 0; d < D; ++d) {
      EXPECT_EQ(fast[d * stride], 5);
      EXPECT_EQ(fast[d * stride + 1 + 280 - 11], 5);
    }
  }
}

/// A row of noise that a frame of noise sees.
struct NoiseRow {
  explicit NoiseRow(unsigned seed) : random(seed) {
    for (auto* of_image : {&image, &reference})
      for (auto& v : *of_image) v = static_cast<std::uint8_t>(random());
    kernels::packNeighborhoods(image.data(), width, height, packed.data());
  }
  static constexpr int width = 120, height = 40;
  std::mt19937 random;
  std::vector<std::uint8_t> image = std::vector<std::uint8_t>(width * height),
                            reference = std::vector<std::uint8_t>(width);
  std::vector<std::uint32_t> packed = std::vector<std::uint32_t>(width * height);
  kernels::RowOfFrame frame{{3.2f, 20.4f, 1.f}, {0.97f, 0.01f, 1e-5f}, {9.f, 12.f, 0.02f}};
};

TEST(CostKernels, ASinglePixelIsThatOfItsRow) {
  const NoiseRow row(8);
  for (const float rho : {0.2f, 0.4f, 0.9f})
    for (int x = 5; x < 100; ++x) {
      std::uint16_t cost = 0;
      kernels::addRowReference(row.reference.data(), x, x + 1, row.frame, &rho, 1, row.image.data(), row.width, &cost,
                               1);
      // That one rounds the sample to a grey level, and a quarter of the square down.
      EXPECT_NEAR(
          std::sqrt(kernels::squaredDifference(row.reference[x], x, rho, row.frame, row.packed.data(), row.width)),
          std::sqrt(4.0 * cost), 1.3);
    }
}

TEST(CostKernels, ManyPixelsAreAsOneByOne) {
  const int n = 600, x0 = 8, x1 = 95;
  NoiseRow row(9);
  std::vector<std::int32_t> x(n);
  std::vector<float> rho(n), sums(n, 7.f);
  for (int i = 0; i < n; ++i) {
    x[i] = static_cast<std::int32_t>(row.random() % row.width);
    rho[i] = 0.2f + 0.001f * static_cast<float>(row.random() % 700);
  }
  for (const int dx : {-1, 2})
    kernels::addSquaredDifferences(row.reference.data(), x.data(), rho.data(), n, dx, x0, x1, row.frame,
                                   row.packed.data(), row.width, sums.data());
  for (int i = 0; i < n; ++i) {
    double expected = 7;
    for (const int u : {x[i] - 1, x[i] + 2})
      if (u >= x0 && u < x1)
        expected += kernels::squaredDifference(row.reference[u], u, rho[i], row.frame, row.packed.data(), row.width);
    EXPECT_NEAR(sums[i], expected, 0.5) << x[i];
  }
}

TEST(CostKernels, BoxRowsMatchesDirectSums) {
  std::mt19937 random(3);
  for (const int radius : {0, 1, 2, 4})
    for (const int n : {1, 5, 100}) {
      const int stride = n + 2 * radius + 3;
      std::vector<std::uint32_t> in(3 * stride), out(in.size());
      for (auto& v : in) v = random() % 1000;
      kernels::boxRows(in.data(), 3, stride, n, radius, out.data());
      for (int r = 0; r < 3; ++r)
        for (int x = 0; x < n; ++x) {
          std::uint32_t s = 0;
          for (int k = 0; k <= 2 * radius; ++k) s += in[r * stride + x + k];
          ASSERT_EQ(out[r * stride + x], s) << "radius " << radius << " of " << n << ", x " << x;
        }
    }
}

TEST(CostKernels, WinnerAndItsRivalAreThoseOfAPlainSearch) {
  std::mt19937 random(4);
  const int D = 40, n = 70, stride = 77, exclusion = 6;
  std::vector<std::uint32_t> cost(D * stride), best(n), second(n);
  std::vector<std::int32_t> index(n);
  for (auto& v : cost) v = random() % 500;
  kernels::winnerTakesAll(cost.data(), D, stride, n, exclusion, best.data(), index.data(), second.data());
  for (int x = 0; x < n; ++x) {
    int winner = 0;
    for (int d = 1; d < D; ++d)
      if (cost[d * stride + x] < cost[winner * stride + x]) winner = d;
    std::uint32_t rival = 0x7fffffff;
    for (int d = 0; d < D; ++d)
      if (std::abs(d - winner) > exclusion) rival = std::min(rival, cost[d * stride + x]);
    ASSERT_EQ(index[x], winner);
    ASSERT_EQ(best[x], cost[winner * stride + x]);
    ASSERT_EQ(second[x], rival);
  }
}

struct Errors {
  double valid = 0, median = 0, p95 = 0, bias = 0;
};

Errors compare(const DepthMap& map, const cv::Mat& truth) {
  std::vector<double> errors;
  std::vector<double> signed_errors;
  for (int v = 0; v < truth.rows; ++v)
    for (int u = 0; u < truth.cols; ++u) {
      const float z = map.depth.at<float>(v, u);
      if (std::isnan(z)) continue;
      errors.push_back(std::abs(z - truth.at<float>(v, u)));
      signed_errors.push_back(z - truth.at<float>(v, u));
    }
  Errors e;
  e.valid = double(errors.size()) / truth.total();
  if (errors.empty()) return e;
  std::sort(errors.begin(), errors.end());
  std::sort(signed_errors.begin(), signed_errors.end());
  e.median = errors[errors.size() / 2];
  e.p95 = errors[errors.size() * 95 / 100];
  e.bias = signed_errors[signed_errors.size() / 2];
  return e;
}

// Sweeps a straight flight at 2 m over the scene with changing exposure; gains and offsets as of automatic exposure.
Errors sweep(const Scene& scene, const PlaneSweepSettings& settings, DepthMap* out = nullptr,
             const air_ground_common::CameraModel& recorded = wideCamera()) {
  const Rectifier rectifier(recorded);
  PlaneSweep plane_sweep(rectifier.camera(), settings);
  cv::Mat truth;
  const Eigen::Isometry3d T_reference = lookDown({0, 0, 2}, 0.02, -0.03, 0.4);
  scene.render(rectifier.camera(), T_reference, 1, 0, &truth);
  plane_sweep.start(rectifier.rectify(scene.render(recorded, T_reference, 1, 0), 0, T_reference), 0.9, 2.6);
  for (int i = -5; i <= 5; ++i) {
    if (i == 0) continue;
    const Eigen::Isometry3d T = lookDown({0.02 * i, 0.01 * i, 2 + 0.004 * i}, 0.01 * i, 0.005 * i, 0.4 + 0.01 * i);
    EXPECT_TRUE(plane_sweep.add(rectifier.rectify(scene.render(recorded, T, 1 + 0.03 * i, -2.0 * i), i, T)));
  }
  const DepthMap map = plane_sweep.depthMap();
  if (out) *out = map;
  return compare(map, truth);
}

TEST(PlaneSweep, FloorDepthIsUnbiased) {
  Scene floor;
  const Errors e = sweep(floor, {});
  std::printf("floor: valid %.2f median %.4f p95 %.4f bias %.4f m\n", e.valid, e.median, e.p95, e.bias);
  EXPECT_GT(e.valid, 0.8);
  EXPECT_LT(e.median, 0.012);
  EXPECT_LT(e.p95, 0.045);
  // Half a pixel of shift between the reduced and the recorded image would show as slanted depth; a scale error as
  // bias.
  EXPECT_LT(std::abs(e.bias), 0.003);
}

TEST(PlaneSweep, BoxesAreMeasured) {
  DepthMap map;
  const Errors e = sweep(boxScene(), {}, &map);
  std::printf("boxes: valid %.2f median %.4f p95 %.4f bias %.4f m\n", e.valid, e.median, e.p95, e.bias);
  EXPECT_GT(e.valid, 0.75);
  EXPECT_LT(e.median, 0.012);
  EXPECT_LT(e.p95, 0.07);
}

// Of the pixels within 3 px of a depth edge, few have the other side's depth.
TEST(PlaneSweep, EdgesOfBoxesStandWhereTheyAre) {
  DepthMap map;
  sweep(boxScene(), {}, &map);
  cv::Mat truth;
  boxScene().render(map.camera, map.T_map_camera, 1, 0, &truth);
  int known = 0, wrong = 0;
  for (int v = 3; v < truth.rows - 3; ++v)
    for (int u = 3; u < truth.cols - 3; ++u) {
      double nearest, farthest;
      cv::minMaxLoc(truth(cv::Rect(u - 3, v - 3, 7, 7)), &nearest, &farthest);
      const float z = map.depth.at<float>(v, u), z_true = truth.at<float>(v, u);
      if (farthest < 1.1 * nearest || std::isnan(z)) continue;
      ++known;
      wrong += std::abs(z - z_true) > 0.05 * z_true;
    }
  std::printf("beside edges: %d of %d pixels are wrong\n", wrong, known);
  ASSERT_GT(known, 3000);
  EXPECT_LT(wrong, 0.077 * known) << "0.083 where each window keeps its own";
}

// 150 degrees from left to right.
air_ground_common::CameraModel fisheye() {
  air_ground_common::CameraModel c = wideCamera();
  c.fx = c.fy = 289;
  c.setDistortion("equidistant", {-0.0121, 0.0234, -0.0194, 0.0051});
  return c;
}

TEST(Rectifier, FisheyeBecomesThePinholeThatWouldHaveSeenIt) {
  RectifierSettings settings;
  settings.scale = 1;
  const Rectifier rectifier(fisheye(), settings);
  const auto& view = rectifier.camera();
  EXPECT_FALSE(view.hasDistortion());
  EXPECT_DOUBLE_EQ(view.fx, 289);  // the resolution of the fisheye's middle
  const double across = std::atan(view.unproject({view.width - 0.5, 0}).x()) - std::atan(view.unproject({-0.5, 0}).x());
  EXPECT_NEAR(across, 100 * M_PI / 180, 0.02);
  const Eigen::Isometry3d T = lookDown({0, 0, 2}, 0.02, -0.03, 0.4);
  const Scene scene = boxScene();
  const cv::Mat truth = scene.render(view, T, 1, 0);
  const cv::Mat rectified = rectifier.rectify(scene.render(fisheye(), T, 1, 0), 0, T).intensity;
  ASSERT_EQ(rectified.size(), truth.size());
  cv::Mat difference;
  cv::absdiff(rectified, truth, difference);
  EXPECT_LT(cv::mean(difference)[0], 3);  // interpolation; the texture's contrast is 35 grey levels
  // The neighbouring pixel's image differs by far more: the geometry is right to a fraction of a pixel.
  cv::absdiff(rectified.colRange(1, truth.cols), truth.colRange(0, truth.cols - 1), difference);
  EXPECT_GT(cv::mean(difference)[0], 6);

  settings.max_field = 1.2;
  const auto narrow = Rectifier(fisheye(), settings).camera();
  EXPECT_NEAR(narrow.width, 2 * 289 * std::tan(0.6), 8);
  settings.max_field = 3.2;
  EXPECT_THROW(Rectifier(fisheye(), settings), std::invalid_argument);
}

TEST(Rectifier, RowsOfARollingShutterGoWhereTheMiddleOneSeesThem) {
  const auto camera = wideCamera();
  RectifierSettings settings;
  settings.scale = 1;
  const Rectifier rectifier(camera, settings);
  const Eigen::Isometry3d T = lookDown({0, 0, 2}, 0.02, -0.03, 0.4);
  const Scene floor;
  const cv::Mat truth = floor.render(rectifier.camera(), T, 1, 0);
  const auto difference = [&](const cv::Mat& recorded, const RowMotion& motion) {
    cv::Mat result;
    cv::absdiff(rectifier.rectify(recorded, 0, T, motion).intensity, truth, result);
    return cv::mean(result)[0];
  };
  RowMotion still;
  still.readout_time = 0.03;
  const double least = difference(floor.render(camera, T, 1, 0), still);
  RowMotion turning = still, shifting = still;
  turning.angular_rate = {0.5, -0.4, 0.7};
  shifting.velocity = {0.8, -1.2, 0.3};
  shifting.depth = 2;
  for (const RowMotion& motion : {turning, shifting}) {
    const cv::Mat recorded = renderRows(floor, camera, T, motion);
    const double untold = difference(recorded, {}), told = difference(recorded, motion);
    std::printf("rows: %.2f grey levels untold, %.2f told, %.2f of a camera at rest\n", untold, told, least);
    EXPECT_LT(told, least + 1.0);
    EXPECT_GT(untold, 3 * told);
    RowMotion wrong = motion;
    wrong.readout_time = -motion.readout_time;
    EXPECT_GT(difference(recorded, wrong), untold);
  }
}

TEST(PlaneSweep, FisheyeFloorDepthIsUnbiased) {
  const Errors e = sweep(Scene(), {}, nullptr, fisheye());
  std::printf("fisheye, floor: valid %.2f median %.4f p95 %.4f bias %.4f m\n", e.valid, e.median, e.p95, e.bias);
  EXPECT_GT(e.valid, 0.7);
  EXPECT_LT(e.median, 0.02);  // 289 px of focal length, not 420
  EXPECT_LT(e.p95, 0.07);
  EXPECT_LT(std::abs(e.bias), 0.004);
}

TEST(PlaneSweep, TexturelessSceneIsRejected) {
  Scene blank;
  blank.contrast = 0;
  const Errors e = sweep(blank, {});
  EXPECT_LT(e.valid, 0.01);
}

TEST(PlaneSweep, ThreadsDoNotChangeTheResult) {
  PlaneSweepSettings one;
  one.threads = 1;
  PlaneSweepSettings three;
  three.threads = 3;
  DepthMap a, b;
  sweep(boxScene(), one, &a);
  sweep(boxScene(), three, &b);
  for (int v = 0; v < a.depth.rows; ++v)
    for (int u = 0; u < a.depth.cols; ++u) {
      const float x = a.depth.at<float>(v, u), y = b.depth.at<float>(v, u);
      ASSERT_TRUE(x == y || (std::isnan(x) && std::isnan(y))) << u << ", " << v;
    }
}

TEST(PlaneSweep, RefusesBadInput) {
  const auto camera = wideCamera();
  EXPECT_THROW(PlaneSweep{camera}, std::invalid_argument);
  const Rectifier rectifier(camera);
  PlaneSweepSettings settings;
  settings.hypotheses = 3;
  EXPECT_THROW(PlaneSweep(rectifier.camera(), settings), std::invalid_argument);
  PlaneSweep plane_sweep(rectifier.camera());
  const Frame frame = rectifier.rectify(cv::Mat::zeros(480, 752, CV_8U), 0, Eigen::Isometry3d::Identity());
  EXPECT_THROW(plane_sweep.start(frame, 2, 1), std::invalid_argument);
  EXPECT_THROW(plane_sweep.add(frame), std::logic_error);
  EXPECT_THROW(rectifier.rectify(cv::Mat::zeros(10, 10, CV_8U), 0, Eigen::Isometry3d::Identity()),
               std::invalid_argument);
}

}  // namespace
}  // namespace dense_fusion
