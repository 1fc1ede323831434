#include "streetview_localizer/city_model.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <numeric>
#include <random>
#include <sstream>

#include "../src/coordinate_system.h"
#include "../src/polygons.h"
#include "box_model.h"
#include "test_files.h"

namespace streetview_localizer {
namespace {

double volumeOf(const CityModel& m) {
  double volume = 0;
  for (const auto& t : m.mesh.triangles)
    volume += m.mesh.vertices[t[0]].cast<double>().dot(
                  m.mesh.vertices[t[1]].cast<double>().cross(m.mesh.vertices[t[2]].cast<double>())) /
              6;
  return volume;
}

std::string cityJson(const std::string& version, const std::string& crs, const Eigen::Vector3d& origin,
                     bool transform) {
  std::string vertices, boundaries;
  int count = 0;
  for (const auto& rings : boxFaces(origin)) {
    boundaries += boundaries.empty() ? "[" : ",[";
    for (const Ring& ring : rings) {
      boundaries += &ring == &rings[0] ? "[" : ",[";
      for (std::size_t i = 0; i < ring.size(); ++i, ++count) {
        boundaries += (i ? "," : "") + std::to_string(count);
        const Eigen::Vector3d p = transform ? Eigen::Vector3d((ring[i] - origin) * 1000) : ring[i];
        vertices += (count ? ",[" : "[") + std::to_string(transform ? std::llround(p.x()) : p.x()) + "," +
                    std::to_string(p.y()) + "," + std::to_string(p.z()) + "]";
      }
      boundaries += "]";
    }
    boundaries += "]";
  }
  const std::string lod = version == "1.0" ? "2" : "\"2.2\"";
  std::string out =
      "{\"type\":\"CityJSON\",\"version\":\"" + version + "\",\"metadata\":{\"referenceSystem\":\"" + crs + "\"},";
  if (transform)
    out += "\"transform\":{\"scale\":[0.001,0.001,0.001],\"translate\":[" + std::to_string(origin.x()) + "," +
           std::to_string(origin.y()) + "," + std::to_string(origin.z()) + "]},";
  out +=
      "\"CityObjects\":{\"part\":{\"type\":\"BuildingPart\",\"parents\":[\"house\"],\"geometry\":[{\"type\":\"Solid\","
      "\"lod\":" +
      lod + ",\"boundaries\":[[" + boundaries +
      "]],\"semantics\":{\"surfaces\":[{\"type\":\"GroundSurface\"},{\"type\":\"RoofSurface\"},{\"type\":"
      "\"WallSurface\"}],\"values\":[[0,1,2,2,2,2]]}}]},"
      "\"house\":{\"type\":\"Building\",\"children\":[\"part\"]}},\"vertices\":[" +
      vertices + "]}";
  return out;
}

// The box in a frame at its lower corner: areas, classes, volume and which way is east.
void expectBox(const CityModel& m, double tolerance) {
  ASSERT_EQ(m.building_ids.size(), 1u);
  EXPECT_EQ(m.building_ids[0], "house");
  EXPECT_NEAR(areaOf(m, Surface::kGround), 200, tolerance);
  EXPECT_NEAR(areaOf(m, Surface::kRoof), 200, tolerance);
  EXPECT_NEAR(areaOf(m, Surface::kWall), 2 * 50 + 2 * 100 - 2, tolerance);
  EXPECT_NEAR(volumeOf(m), 1000, 10 * tolerance);
  Eigen::Vector3f low = m.mesh.vertices[0], high = low;
  for (const auto& v : m.mesh.vertices) low = low.cwiseMin(v), high = high.cwiseMax(v);
  EXPECT_NEAR(high.z() - low.z(), 5, 0.01);
  for (std::size_t i = 0; i < m.building.size(); ++i)
    EXPECT_EQ(m.isBuilding(static_cast<int>(i)), m.surface[i] != Surface::kGround);
}

TEST(CityModel, CityGmlOfAllVersionsGivesTheBox) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(2683000, 1247000, 410);
  for (const int version : {1, 2, 3}) {
    const CityModel m =
        readCityModel(folder.write("a.gml", cityGml("urn:ogc:def:crs:EPSG::2056", o, version)), {"", o});
    EXPECT_EQ(m.crs, "EPSG:2056");
    expectBox(m, 0.06);  // grid metres are not metres: 1 + 1e-4
    EXPECT_TRUE(m.remarks.empty()) << m.remarks[0];
    // The corner 20 m north of the origin on the grid: true north lies off by the convergence.
    const double c = m.frame->meridianConvergence();
    EXPECT_GT(std::abs(c), 1e-3);
    const Eigen::Vector3d p = m.worldFromCrs(o + Eigen::Vector3d(0, 20, 0));
    EXPECT_NEAR(p.x(), 20 * std::sin(c), 1e-3);
    EXPECT_NEAR(p.y(), 20 * std::cos(c), 3e-3);
    EXPECT_LT((m.crsFromWorld(p) - (o + Eigen::Vector3d(0, 20, 0))).norm(), 3e-3);  // PROJ's own round trip
  }
}

TEST(CityModel, CityJsonWithAndWithoutTransformGivesTheBox) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(84700, 447500, 1);
  for (const std::string version : {"1.0", "1.1", "2.0"})
    for (const bool transform : {false, true}) {
      if (!transform && version != "1.0") continue;
      const std::string text = cityJson(version, "https://www.opengis.net/def/crs/EPSG/0/7415", o, transform);
      const CityModel m = readCityModel(folder.write("a.json", text), {"", o});
      EXPECT_EQ(m.crs, "EPSG:28992");
      expectBox(m, 0.06);
    }
  // A sequence: the first line carries the transform, each feature its own vertices.
  // On one line or on many.
  const std::string whole = cityJson("2.0", "EPSG:7415", o, true);
  const std::size_t objects = whole.find("\"CityObjects\"");
  const std::string head = whole.substr(0, objects) + "\"CityObjects\":{},\"vertices\":[]}\n";
  const std::string feature = "{\"type\":\"CityJSONFeature\",\"id\":\"house\"," + whole.substr(objects) + "\n";
  expectBox(readCityModel(folder.write("a.city.jsonl", head + feature), {"", o}), 0.06);
  std::string lines = "\n \n";
  for (const char c : whole) lines += std::string(c == '{' ? "\n" : "") + c;
  expectBox(readCityModel(folder.write("lines.json", lines), {"", o}), 0.06);
}

// Brackets in names are no nesting.
TEST(CityModel, DeepCityJsonIsRefusedAndNamesMayHoldBrackets) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(84700, 447500, 1);
  std::string text = cityJson("2.0", "EPSG:7415", o, true);
  text.insert(1, "\"title\":\"" + std::string(100, '[') + "\\\"{\",");
  expectBox(readCityModel(folder.write("a.json", text), {"", o}), 0.06);
  for (const char* before : {"", "\n"}) {
    text = "{" + std::string(before) + "\"type\":\"CityJSON\",\"extra\":" + std::string(100, '[') +
           std::string(100, ']') + "}";
    const std::string m = messageOf([&] { readCityModel(folder.write("a.json", text)); });
    EXPECT_NE(m.find("a.json is nested too deeply"), std::string::npos) << m;
  }
}

TEST(CityModel, AxisOrderFollowsTheDeclarationAndTheAreaOfUse) {
  const TemporaryFolder folder;
  // EPSG:31468 (Gauss-Krueger 4) is defined northing first; Munich. The urn follows the definition, the short form
  // custom.
  const Eigen::Vector3d o(4468000, 5333000, 515);
  const auto check = [&](const std::string& srs, bool north_first, bool remark) {
    const CityModel m = readCityModel(folder.write("a.gml", cityGml(srs, o, 2, north_first)));
    EXPECT_EQ(m.crs, "EPSG:31468");
    EXPECT_NEAR(m.frame->origin().latitude, 48.13, 0.05) << srs;
    EXPECT_NEAR(m.frame->origin().longitude, 11.57, 0.05);
    // Normals point outwards only if the axes were put right.
    EXPECT_GT(volumeOf(m), 0) << srs;
    EXPECT_EQ(!m.remarks.empty(), remark) << srs;
  };
  check("urn:ogc:def:crs:EPSG::31468", true, false);
  check("urn:ogc:def:crs:EPSG::31468", false, true);  // a common fault of exporters: told, and read right
  check("EPSG:31468", false, false);
  check("urn:adv:crs:DE_DHDN_3GK4*DE_DHHN92_NH", false, false);
}

TEST(CityModel, GeographicAndCompoundSystems) {
  EXPECT_EQ(parseCrs("urn:ogc:def:crs:EPSG::7415").horizontal, "EPSG:28992");
  EXPECT_EQ(parseCrs("urn:ogc:def:crs,crs:EPSG::25832,crs:EPSG::5783").horizontal, "EPSG:25832");
  EXPECT_EQ(parseCrs("EPSG:25832+5783").horizontal, "EPSG:25832");
  EXPECT_EQ(parseCrs("urn:adv:crs:ETRS89_UTM32*DE_DHHN2016_NH").horizontal, "EPSG:25832");
  EXPECT_EQ(parseCrs("http://www.opengis.net/gml/srs/epsg.xml#31467").horizontal, "EPSG:31467");
  EXPECT_TRUE(parseCrs("urn:ogc:def:crs:EPSG::4326").north_first);
  EXPECT_FALSE(parseCrs("EPSG:2056").north_first);
  for (const char* bad : {"EPSG:999999", "Zurich", "EPSG:5783"}) {
    const std::string m = messageOf([&] { parseCrs(bad); });
    EXPECT_NE(m.find(std::string("unknown coordinate system '") + bad), std::string::npos) << m;
  }
}

TEST(CityModel, TheFinestCompleteLevelIsTaken) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(2683000, 1247000, 410);
  std::string gml = cityGml("EPSG:2056", o);
  // A coarser shell, twice as high, and one detailed door: neither replaces the complete LoD2.
  const std::string extra =
      "<bldg:lod1Solid><gml:Solid>" +
      gmlPolygon({{o, o + Eigen::Vector3d(10, 0, 0), o + Eigen::Vector3d(10, 0, 40), o + Eigen::Vector3d(0, 0, 40)}},
                 false) +
      "</gml:Solid></bldg:lod1Solid><bldg:lod3MultiSurface>" +
      gmlPolygon({{o, o + Eigen::Vector3d(1, 0, 0), o + Eigen::Vector3d(1, 0, 2), o + Eigen::Vector3d(0, 0, 2)}},
                 false) +
      "</bldg:lod3MultiSurface>";
  gml.insert(gml.find("</bldg:Building>"), extra);
  const std::string path = folder.write("a.gml", gml);
  expectBox(readCityModel(path, {"", o}), 0.06);
  EXPECT_NEAR(areaOf(readCityModel(path, {"", o, 1}), Surface::kWall), 400, 0.1);
  EXPECT_NEAR(areaOf(readCityModel(path, {"", o, 3}), Surface::kWall), 2, 0.01);
}

// Converters write what a solid does not hold, overhangs of the roof say, as a second geometry of its level.
TEST(CityModel, OfTwoGeometriesOfOneLevelTheFullerIsTaken) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(84700, 447500, 1);
  for (const bool first : {false, true}) {
    std::string text = cityJson("2.0", "EPSG:7415", o, true);
    const std::string overhang = R"({"type":"MultiSurface","lod":"2.2","boundaries":[[[4,5,6]]]})";
    if (first)
      text.insert(text.find("\"geometry\":[") + 12, overhang + ",");
    else
      text.insert(text.find("}}]},\"house\"") + 2, "," + overhang);
    expectBox(readCityModel(folder.write("a.json", text), {"", o}), 0.06);
  }
}

// As cadastres write rings: of curves, and of points that are elements.
TEST(CityModel, RingsOfCurvesAndOfPointsAreRead) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(2683000, 1247000, 410);
  const auto replaced = [](std::string text, const std::string& from, const std::string& to) {
    for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
      text.replace(at, from.size(), to);
    return text;
  };
  const std::string usual = cityGml("EPSG:2056", o);
  std::string curves = replaced(usual, "<gml:LinearRing>", "<gml:Ring><gml:curveMember><gml:LineString>");
  curves = replaced(curves, "</gml:LinearRing>", "</gml:LineString></gml:curveMember></gml:Ring>");
  expectBox(readCityModel(folder.write("a.gml", curves), {"", o}), 0.06);
  std::string points;
  for (std::size_t at = 0, end = 0; at < usual.size(); at = end) {  // each corner in an element of its own
    const std::size_t begin = usual.find("<gml:posList>", at);
    if (begin == std::string::npos) {
      points += usual.substr(at);
      break;
    }
    end = usual.find("</gml:posList>", begin);
    points += usual.substr(at, begin - at);
    std::istringstream numbers(usual.substr(begin + 13, end - begin - 13));
    for (std::string x, y, z; numbers >> x >> y >> z;)
      points += "<gml:pointProperty><gml:Point><gml:pos>" + x + " " + y + " " + z +
                "</gml:pos></gml:Point></gml:pointProperty>";
    end += 14;
  }
  expectBox(readCityModel(folder.write("a.gml", points), {"", o}), 0.06);
  // What is not read is told: walls in plan alone.
  std::string flat = usual;
  flat.insert(flat.find("<gml:posList>") + 12, " srsDimension=\"2\"");
  const CityModel m = readCityModel(folder.write("a.gml", flat), {"", o});
  ASSERT_EQ(m.remarks.size(), 1u);
  EXPECT_NE(m.remarks[0].find("a.gml: 1 polygons without three coordinates a corner"), std::string::npos)
      << m.remarks[0];
}

TEST(CityModel, ObjKeepsItsFrameAndTellsWallsFromGround) {
  const TemporaryFolder folder;
  std::string text = "o house\n";
  int n = 0;
  for (const auto& rings : boxFaces({100, 200, 3})) {
    std::string face = "f";
    for (const auto& p : rings[0]) {
      text += "v " + std::to_string(p.x()) + " " + std::to_string(p.y()) + " " + std::to_string(p.z()) + "\n";
      face += " " + std::to_string(++n) + "/1/2";
    }
    text += face + "\n";
  }
  text += "g terrain\no terrain\nv 0 0 3\nv 300 0 3\nv 0 300 3\nf -3 -2 -1\n";
  const CityModel m = readCityModel(folder.write("a.obj", text));
  EXPECT_TRUE(m.crs.empty());
  ASSERT_EQ(m.building_ids.size(), 1u);
  EXPECT_NEAR(areaOf(m, Surface::kWall), 300, 1e-3);
  EXPECT_NEAR(areaOf(m, Surface::kRoof), 200, 1e-3);
  EXPECT_NEAR(areaOf(m, Surface::kGround), 200 + 45000, 0.1);
  EXPECT_EQ(m.building.back(), -1);
  Eigen::Vector3f low = Eigen::Vector3f::Constant(1e6f);
  for (const auto& v : m.mesh.vertices)
    if (v.z() > 3.1f) low = low.cwiseMin(v);
  EXPECT_LT((low - Eigen::Vector3f(100, 200, 8)).norm(), 1e-4f);  // of the roof
  EXPECT_LT((m.worldFromCrs({1, 2, 3}) - Eigen::Vector3d(1, 2, 3)).norm(), 1e-12);
}

TEST(CityModel, InsideOutBuildingIsTurned) {
  const TemporaryFolder folder;
  std::string text = "o house\n";
  int n = 0;
  for (const auto& rings : boxFaces({0, 0, 0})) {
    std::string face;
    for (const auto& p : rings[0]) {
      text += "v " + std::to_string(p.x()) + " " + std::to_string(p.y()) + " " + std::to_string(p.z()) + "\n";
      face = " " + std::to_string(++n) + face;
    }
    text += "f" + face + "\n";
  }
  const CityModel m = readCityModel(folder.write("a.obj", text));
  EXPECT_NEAR(volumeOf(m), 1000, 1e-2);
  EXPECT_EQ(m.remarks.size(), 1u);
}

// Random star-shaped polygons with a hole, on a tilted plane: the area of the triangles is the area of the rings.
TEST(Polygons, TriangulationKeepsAreaAndOrientation) {
  std::mt19937 rng(3);
  std::uniform_real_distribution<double> u(0, 1);
  std::vector<Eigen::Vector3d> points;
  for (int trial = 0; trial < 300; ++trial) {
    const Eigen::Quaterniond q =
        Eigen::Quaterniond(u(rng) - 0.5, u(rng) - 0.5, u(rng) - 0.5, u(rng) - 0.5).normalized();
    const Eigen::Vector3d offset(1000 * u(rng), 1000 * u(rng), 100 * u(rng));
    const auto star = [&](double low, double high, bool reverse) {
      Ring ring;
      const int n = 3 + static_cast<int>(12 * u(rng));
      for (int i = 0; i < n; ++i) {
        const double a = (reverse ? -1 : 1) * 2 * M_PI * i / n, r = low + (high - low) * u(rng);
        ring.push_back(q * Eigen::Vector3d(r * std::cos(a), r * std::sin(a), 0) + offset);
      }
      return ring;
    };
    const std::vector<Ring> rings = {star(8, 20, false), star(0.5, 3, trial % 2 == 0)};
    const double expected = 0.5 * (areaVector(rings[0]).norm() - areaVector(rings[1]).norm());
    double area = 0;
    for (const auto& t : triangulate(rings, &points)) {
      const Eigen::Vector3d cross = (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]);
      area += 0.5 * cross.norm();
      EXPECT_GT(cross.dot(q * Eigen::Vector3d::UnitZ()), 0);
    }
    // A triangle as outer ring may cut the hole.
    if (rings[0].size() > 5) {
      EXPECT_NEAR(area, expected, 1e-6 * expected);
    }
  }
  EXPECT_TRUE(triangulate({{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}}}, &points).empty());
  // A bow tie: two triangles of area 1 each would be 2; wound oddly everywhere.
  double area = 0;
  for (const auto& t : triangulate({{{0, 0, 0}, {2, 2, 0}, {2, 0, 0}, {0, 2.5, 0}}}, &points))
    area += 0.5 * (points[t[1]] - points[t[0]]).cross(points[t[2]] - points[t[0]]).norm();
  EXPECT_GT(area, 1.5);
}

TEST(CityModel, BrokenFilesGiveOneClearLine) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(2683000, 1247000, 410);
  const auto error = [&](const std::string& name, const std::string& text, const CityModelOptions& options = {}) {
    const std::string path = folder.write(name, text);
    const std::string m = messageOf([&] { readCityModel(path, options); });
    EXPECT_EQ(m.find('\n'), std::string::npos) << m;
    EXPECT_NE(m.find(path), std::string::npos) << m;
    return m;
  };
  EXPECT_NE(
      error("a.gml", "<CityModel><cityObjectMember><Road/></cityObjectMember></CityModel>").find("has no buildings"),
      std::string::npos);
  EXPECT_NE(error("a.gml", cityGml("EPSG:999999", o)).find("unknown coordinate system 'EPSG:999999'"),
            std::string::npos);
  EXPECT_NE(error("a.gml", cityGml("EPSG:28992", o)).find("outside the area"), std::string::npos);
  EXPECT_NE(error("a.gml", cityGml("EPSG:2056", o).substr(0, 900)).find("not well-formed"), std::string::npos);
  EXPECT_NE(error("a.json", "{\"type\":\"FeatureCollection\"}").find("not CityJSON"), std::string::npos);
  EXPECT_NE(error("a.json", "{\"type\":\"CityJSON\",\"version\":\"1.1\",\"CityObjects\":{},\"vertices\":[]}")
                .find("has no buildings"),
            std::string::npos);
  EXPECT_NE(error("a.json", "{\"type\":\"CityJSON\", ").find("no valid CityJSON"), std::string::npos);
  EXPECT_NE(error("a.json",
                  "{\"type\":\"CityJSON\",\"version\":\"1.1\",\"transform\":{\"translate\":[0,0,0]},"
                  "\"CityObjects\":{},\"vertices\":[]}")
                .find("scale"),
            std::string::npos);
  EXPECT_NE(error("a.obj", "v 0 0 0\nf 1 2 3\n").find("line 2"), std::string::npos);
  EXPECT_NE(error("a.obj", "v 2683000 1247000 0\nv 2683001 1247000 0\nv 2683000 1247000 9\nf 1 2 3\n").find("--crs"),
            std::string::npos);
  EXPECT_NE(error("a.txt", "hello").find("neither CityGML"), std::string::npos);
  EXPECT_NE(error("a.txt", "").find("empty"), std::string::npos);
  EXPECT_NE(messageOf([&] { readCityModel(folder / "missing.gml"); }).find("there is no"), std::string::npos);
}

// Share of the roof triangles that face up.
double outwardShare(const CityModel& m) {
  int out = 0, all = 0;
  for (std::size_t i = 0; i < m.mesh.triangles.size(); ++i) {
    if (m.surface[i] != Surface::kRoof) continue;
    const auto& t = m.mesh.triangles[i];
    const Eigen::Vector3f n =
        (m.mesh.vertices[t[1]] - m.mesh.vertices[t[0]]).cross(m.mesh.vertices[t[2]] - m.mesh.vertices[t[0]]);
    if (n.norm() < 0.2f) continue;
    ++all;
    out += n.z() > 0;
  }
  return all ? double(out) / all : 1;
}

TEST(CityModel, RealCities) {
  const std::string delft = sharedData("city/delft_epsg7415.city.json");
  if (!std::filesystem::exists(delft)) GTEST_SKIP() << "no real city models: " << delft << " is not there";
  const CityModel d = readCityModel(delft);
  EXPECT_EQ(d.crs, "EPSG:28992");
  EXPECT_EQ(d.building_ids.size(), 163u);  // 160 buildings, 3 bridges
  EXPECT_NEAR(d.frame->origin().latitude, 52.01, 0.01);
  EXPECT_NEAR(d.frame->origin().longitude, 4.36, 0.01);
  EXPECT_GT(outwardShare(d), 0.99);
  const CityModel z = readCityModel(sharedData("city/zurich_lod2_epsg2056.city.json"));
  EXPECT_EQ(z.crs, "EPSG:2056");
  EXPECT_GT(outwardShare(z), 0.99);
  const CityModel i = readCityModel(sharedData("city/ingolstadt_lod3_epsg32632"));
  EXPECT_EQ(i.crs, "EPSG:32632");
  EXPECT_EQ(i.building_ids.size(), 10u);
  EXPECT_GT(outwardShare(i), 0.97);
  const CityModel c = readCityModel(sharedData("strecha_960/castle_walls.obj"));
  EXPECT_EQ(c.building_ids.size(), 10u);
  EXPECT_EQ(c.mesh.triangles.size(), 22u);
  // Measured once, and looked at; LoD3 of one building of Ingolstadt alone has windows and doors.
  EXPECT_NEAR(areaOf(z, Surface::kWall), 40880, 50);
  EXPECT_NEAR(areaOf(d, Surface::kWall), 17698, 50);
  EXPECT_GT(areaOf(i, Surface::kOther), 1000);
  EXPECT_NEAR(areaOf(c, Surface::kGround), 56 * 40, 1);
}

}  // namespace
}  // namespace streetview_localizer
