#include "air_ground_common/geodesy.h"

#include <gtest/gtest.h>

#include <cmath>
#include <iostream>
#include <stdexcept>
#include <vector>

#include "air_ground_common/units.h"

namespace air_ground_common {
namespace {

const Eigen::Vector3d kZurichLv95(2683300, 1247900, 420);

// UTM by Krueger's series to n^4, from the textbook: an independent reference for PROJ and for the axes' order.
Eigen::Vector2d utm(double latitude, double longitude, double central) {
  const double f = 1 / 298.257223563, n = f / (2 - f), k0 = 0.9996;
  const double A = 6378137.0 / (1 + n) * (1 + n * n / 4 + std::pow(n, 4) / 64);
  const double alpha[4] = {n / 2 - 2 * n * n / 3 + 5 * std::pow(n, 3) / 16 + 41 * std::pow(n, 4) / 180,
                           13 * n * n / 48 - 3 * std::pow(n, 3) / 5 + 557 * std::pow(n, 4) / 1440,
                           61 * std::pow(n, 3) / 240 - 103 * std::pow(n, 4) / 140, 49561 * std::pow(n, 4) / 161280};
  const double s = std::sin(latitude * kDegree), e = 2 * std::sqrt(n) / (1 + n), dl = (longitude - central) * kDegree;
  const double t = std::sinh(std::atanh(s) - e * std::atanh(e * s));
  const double xi = std::atan2(t, std::cos(dl)), eta = std::atanh(std::sin(dl) / std::sqrt(1 + t * t));
  double east = eta, north = xi;
  for (int j = 1; j <= 4; ++j) {
    east += alpha[j - 1] * std::cos(2 * j * xi) * std::sinh(2 * j * eta);
    north += alpha[j - 1] * std::sin(2 * j * xi) * std::cosh(2 * j * eta);
  }
  return {500000 + k0 * A * east, k0 * A * north};
}

TEST(Geodesy, UtmAgreesWithKruegersSeries) {
  const LocalFrame frame("EPSG:32632", {465700, 5247900, 470});
  for (const auto& p :
       std::vector<Eigen::Vector3d>{{465666, 5247973, 469}, {466500, 5247000, 500}, {464000, 5249500, 400}}) {
    const Eigen::Vector3d local = frame.fromCrs(p);
    const Geodetic g = frame.toGeodetic(local);
    EXPECT_LT((utm(g.latitude, g.longitude, 9) - p.head<2>()).norm(), 1e-3);
    EXPECT_NEAR(g.height, p.z(), 1e-6);
    EXPECT_LT((frame.toCrs(local) - p).norm(), 1e-4);
    EXPECT_LT((frame.fromGeodetic(g) - local).norm(), 1e-6);
  }
}

TEST(Geodesy, Lv95HasItsOriginInBern) {
  // By definition: CH1903+ 46 57' 08.66" N, 7 26' 22.50" E is (2600000, 1200000); EPSG:4150 is that geographic system.
  const LocalFrame grid("EPSG:2056", {2600000, 1200000, 550});
  const LocalFrame geographic("EPSG:4150", {7 + 26 / 60. + 22.5 / 3600, 46 + 57 / 60. + 8.66 / 3600, 550});
  EXPECT_LT((grid.fromGeodetic(geographic.origin())).norm(), 1e-3);
  // At the centre of the oblique Mercator projection the grid's north is true north of the Bessel ellipsoid; the WGS 84
  // meridian differs by the datum shift's few arc seconds.
  EXPECT_NEAR(grid.meridianConvergence(), 0, 1e-4);
  EXPECT_NEAR(grid.gridScale(), 1, 2e-4);
  EXPECT_EQ(geographic.meridianConvergence(), 0);
}

TEST(Geodesy, UtmLv95AndLocalFrameAgreeToACentimetre) {
  const LocalFrame lv95("EPSG:2056", kZurichLv95);
  const Eigen::Vector3d origin_utm =
      LocalFrame("EPSG:32632", {465700, 5247900, 0})
          .toCrs(LocalFrame("EPSG:32632", {465700, 5247900, 0}).fromGeodetic(lv95.origin()));
  const LocalFrame utm32("EPSG:32632", origin_utm);
  for (double x = -1000; x <= 1000; x += 400) {
    for (double y = -1000; y <= 1000; y += 400) {
      const Eigen::Vector3d p(x, y, 30);
      // One local point, through either grid.
      EXPECT_LT((utm32.fromCrs(utm32.toCrs(p)) - p).norm(), 1e-3);
      const Geodetic g = lv95.toGeodetic(p);
      const Eigen::Vector3d through_lv95 = lv95.fromCrs(lv95.toCrs(p)),
                            through_utm = utm32.fromCrs(utm32.toCrs(utm32.fromGeodetic(g)));
      EXPECT_LT((through_lv95 - through_utm).norm(), 0.01) << p.transpose();
      EXPECT_LT((utm(g.latitude, g.longitude, 9) - utm32.toCrs(p).head<2>()).norm(), 0.01);
      // And against the flat grids: turned by the convergence, stretched by the scale, without the Earth's curvature.
      for (const LocalFrame* frame : {&lv95, &utm32}) {
        const Eigen::Vector3d zero = frame->toCrs(Eigen::Vector3d::Zero()), grid = frame->toCrs(p) - zero;
        const double c = std::cos(frame->meridianConvergence()), s = std::sin(frame->meridianConvergence());
        // A grid vector lies clockwise of its true direction by minus the convergence; height shrinks it to the
        // ellipsoid.
        const double shrink = (1 + (zero.z() + 30) / 6.38e6) / frame->gridScale();
        const Eigen::Vector2d flat(shrink * (c * grid.x() + s * grid.y()), shrink * (-s * grid.x() + c * grid.y()));
        EXPECT_LT((flat - p.head<2>()).norm(), 0.08) << p.transpose();  // the scale changes over a kilometre of grid
      }
    }
  }
  // Convergence of UTM: about (longitude - 9 deg) * sin(latitude), negative west of the central meridian.
  EXPECT_NEAR(utm32.meridianConvergence(),
              (lv95.origin().longitude - 9) * kDegree * std::sin(lv95.origin().latitude * kDegree), 1e-5);
  EXPECT_LT(utm32.meridianConvergence(), -0.005);
  // LV95: grid north turns clockwise of true north east of Bern.
  EXPECT_GT(lv95.meridianConvergence(), 0.01);
  EXPECT_NEAR(utm32.gridScale(), 0.9996 * (1 + std::pow((origin_utm.x() - 500000) / 6.38e6, 2) / 2), 1e-6);
}

TEST(Geodesy, AxesPointEastNorthUp) {
  const LocalFrame frame("EPSG:2056", kZurichLv95);
  Geodetic g = frame.origin();
  g.longitude += 0.001;
  EXPECT_NEAR(frame.fromGeodetic(g).x(), 75.5, 0.5);
  EXPECT_NEAR(frame.fromGeodetic(g).y(), 0, 0.01);
  g = frame.origin();
  g.latitude += 0.001;
  EXPECT_NEAR(frame.fromGeodetic(g).y(), 111.2, 0.1);
  EXPECT_NEAR(frame.fromGeodetic(g).z(), -111.2 * 111.2 / 12742e3, 1e-4);
  EXPECT_NEAR(frame.fromCrs(kZurichLv95 + Eigen::Vector3d(0, 0, 12)).z(), 12, 1e-9);
}

TEST(Geodesy, OldSwissGridUsesChenyx06WhereInstalled) {
  const LocalFrame lv03("EPSG:21781", {683300, 247900, 420});
  const LocalFrame lv95("EPSG:2056", kZurichLv95);
  const double shift = lv95.fromGeodetic(lv03.origin()).norm();
  // The old network is distorted by up to 1.6 m against the new one; the formulas alone know none of it.
  EXPECT_LT(shift, 2);
  if (!lv03.usesGrid()) GTEST_SKIP() << "PROJ has no CHENYX06 grid here: LV03 coordinates stay up to 1.6 m off";
  EXPECT_GT(shift, 0.02);
  std::cout << "LV03 differs from LV95 by " << shift << " m in Zurich, as CHENYX06 says\n";
}

TEST(Geodesy, BadInputIsRefusedWithAReason) {
  EXPECT_THROW(LocalFrame("EPSG:999999", {0, 0, 0}), std::invalid_argument);
  EXPECT_THROW(LocalFrame("EPSG:2056", {NAN, 0, 0}), std::invalid_argument);
  const LocalFrame frame("EPSG:2056", kZurichLv95);
  EXPECT_THROW(frame.fromGeodetic({NAN, 8, 0}), std::invalid_argument);
  EXPECT_THROW(frame.fromGeodetic({95, 8, 0}), std::invalid_argument);
}

}  // namespace
}  // namespace air_ground_common
