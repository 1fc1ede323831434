#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "air_ground_common/text.h"
#include "streetview_localizer/city_model.h"
#include "test_files.h"

namespace streetview_localizer {
namespace {

using air_ground_common::formatted;

/// A wall from a corner of its foot, 10 units of the plan long (`step`: so many degrees) and 5 units high.
CityModel wallAt(const Eigen::Vector3d& corner, CityModelOptions options, double step = 10) {
  const TemporaryFolder folder;
  std::string obj = "o house\n";
  for (const auto& [along, up] : {std::make_pair(0.0, 0.0), {step, 0.0}, {step, 5.0}, {0.0, 5.0}})
    obj += formatted("v %.9f %.9f %.6f\n", corner.x() + along, corner.y(), corner.z() + up);
  return readCityModel(folder.write("wall.obj", obj + "f 1 2 3 4\n"), options);
}

CityModelOptions in(const std::string& crs) {
  CityModelOptions options;
  options.crs = crs;
  return options;
}

/// Of the box around the wall, which stands from west to east.
Eigen::Vector3f extentOf(const CityModel& m) {
  Eigen::Vector3f low = m.mesh.vertices[0], high = low;
  for (const auto& v : m.mesh.vertices) low = low.cwiseMin(v), high = high.cwiseMax(v);
  return high - low;
}
float heightOf(const CityModel& m) { return extentOf(m).z(); }

void expectPlace(const CityModel& m, double latitude, double longitude) {
  EXPECT_NEAR(m.frame->origin().latitude, latitude, 0.05) << m.crs;
  EXPECT_NEAR(m.frame->origin().longitude, longitude, 0.05) << m.crs;
}

// Surveys deliver a whole country in the grid of its middle. Places by PROJ's cs2cs.
TEST(CoordinateSystem, GridsAreUsedBeyondTheirArea) {
  const auto check = [](const std::string& crs, double x, double y, double latitude, double longitude, int remarks) {
    const CityModel m = wallAt({x, y, 100}, in(crs));
    expectPlace(m, latitude, longitude);
    ASSERT_EQ(m.remarks.size(), static_cast<std::size_t>(remarks)) << crs;
    if (remarks > 0) {
      EXPECT_NE(m.remarks.back().find("outside the area of " + crs), std::string::npos) << m.remarks.back();
    }
  };
  check("EPSG:25832", 826000, 5380000, 48.488, 13.413, 1);   // Passau, in the zone that ends at 12 E
  check("EPSG:25833", 262000, 6649000, 59.910, 10.743, 1);   // Oslo
  check("EPSG:25833", -32000, 6737000, 60.416, 5.317, 1);    // Bergen
  check("EPSG:25833", 1079000, 7800000, 69.662, 30.059, 1);  // Kirkenes: 12 degrees, but 470 km
  check("EPSG:25832", 5380000, 826000, 48.488, 13.413, 2);   // north first, against the declaration
  check("EPSG:25832", 691000, 5335000, 48.137, 11.568, 0);   // Munich
}

TEST(CoordinateSystem, AreasMayCrossTheAntimeridian) {
  const auto check = [](const std::string& code, double latitude, double longitude) {
    for (const bool urn : {false, true}) {  // which says north first
      const CityModel m = wallAt({urn ? latitude : longitude, urn ? longitude : latitude, 10},
                                 in((urn ? "urn:ogc:def:crs:EPSG::" : "EPSG:") + code), 1e-4);
      expectPlace(m, latitude, longitude);
      EXPECT_TRUE(m.remarks.empty()) << m.remarks[0];
    }
  };
  check("4269", 40.7, -74);     // New York
  check("6318", 61.2, -149.9);  // Anchorage
  check("6318", 52.9, 173);     // the Aleutian islands, west of the antimeridian
  check("4167", -41.3, 174.8);  // Wellington
  check("4167", -44, -176.5);   // the Chatham islands
}

TEST(CoordinateSystem, CoordinatesOfAnotherSystemAreRefused) {
  for (const auto& [x, y] : {std::make_pair(2683000, 1247000), {1247000, 2683000}}) {
    const std::string m = messageOf([&, x = x, y = y] { wallAt({double(x), double(y), 410}, in("EPSG:28992")); });
    EXPECT_NE(m.find("outside the area of EPSG:28992"), std::string::npos) << m;
    EXPECT_NE(m.find("--crs"), std::string::npos) << m;
  }
}

// A system made of two has no area of its own: that of its horizontal part tells the order of the axes.
TEST(CoordinateSystem, CompoundSystemsHaveTheAreaOfTheirPart) {
  const CityModel m = wallAt({5335000, 691000, 500}, in("EPSG:25832+5783"));
  expectPlace(m, 48.137, 11.568);
  EXPECT_EQ(m.remarks.size(), 1u);
}

constexpr double kSurveyFoot = 1200.0 / 3937;

TEST(CoordinateSystem, HeightsAreReadInTheUnitOfTheirSystem) {
  const CityModel m = wallAt({985000, 200000, 30}, in("EPSG:2263+6360"));  // New York, all in US survey feet
  EXPECT_EQ(m.crs, "EPSG:2263");
  EXPECT_DOUBLE_EQ(m.height_unit, kSurveyFoot);
  EXPECT_NEAR(extentOf(m).x(), 10 * kSurveyFoot, 1e-3);
  EXPECT_NEAR(heightOf(m), 5 * kSurveyFoot, 1e-5);
  EXPECT_NEAR(m.origin.z(), 9, 1e-9);  // 30 feet, down to whole metres
  EXPECT_TRUE(m.remarks.empty()) << m.remarks[0];
  EXPECT_NEAR(heightOf(wallAt({84700, 447500, 1}, in("EPSG:7415"))), 5, 1e-6);
  // Where only the plan has a system, its unit says nothing of the heights.
  const CityModel plan = wallAt({985000, 200000, 30}, in("EPSG:2263"));
  EXPECT_NEAR(heightOf(plan), 5, 1e-5);
  ASSERT_EQ(plan.remarks.size(), 1u);
  EXPECT_NE(plan.remarks[0].find("--height-unit 0.3048006"), std::string::npos) << plan.remarks[0];
  CityModelOptions feet = in("EPSG:2263");
  feet.height_unit = 0.3048;
  feet.height_offset = 2;
  feet.origin = Eigen::Vector3d(985000, 200000, 30);
  const CityModel told = wallAt({985000, 200000, 30}, feet);
  EXPECT_NEAR(heightOf(told), 5 * 0.3048, 1e-5);
  EXPECT_TRUE(told.remarks.empty());
  EXPECT_NEAR(told.origin.z(), 30 * 0.3048, 1e-9);  // the origin's height, too, is counted in feet
  float low = 1000;
  for (const auto& v : told.mesh.vertices) low = std::min(low, v.z());
  EXPECT_NEAR(low, 2, 1e-3);
}

TEST(CoordinateSystem, AnOriginFarFromTheModelIsRefused) {
  const auto refusal = [](const std::string& crs, const Eigen::Vector3d& origin) {
    CityModelOptions options = in(crs);
    options.origin = origin;
    const Eigen::Vector3d corner = crs.empty() ? Eigen::Vector3d(100, 200, 3) : Eigen::Vector3d(691000, 5335000, 500);
    return messageOf([&] { wallAt(corner, options); });
  };
  for (const std::string crs : {"EPSG:25832", ""}) {
    const Eigen::Vector3d near = crs.empty() ? Eigen::Vector3d(0, 0, 0) : Eigen::Vector3d(690000, 5330000, 0);
    EXPECT_EQ(refusal(crs, near), "");
    EXPECT_EQ(refusal(crs, near + Eigen::Vector3d(30000, -30000, 5000)), "");
    const std::string north = refusal(crs, near + Eigen::Vector3d(0, 70000, 0));
    EXPECT_NE(north.find(crs.empty() ? "lies 70 km from the model" : "lies 65 km from the model"), std::string::npos)
        << north;
    EXPECT_NE(refusal(crs, near + Eigen::Vector3d(0, 0, 12000)).find("km from the model"), std::string::npos);
  }
  EXPECT_NE(refusal("EPSG:25832", {0, 0, 0}).find("--origin (0, 0, 0) lies 5"), std::string::npos)
      << refusal("EPSG:25832", {0, 0, 0});
}

}  // namespace
}  // namespace streetview_localizer
