// Files and folders as they are delivered, and the frames that their coordinates are counted in.
#include <gtest/gtest.h>

#include <cstdio>
#include <sstream>
#include <tuple>

#include "box_model.h"
#include "test_files.h"

namespace streetview_localizer {
namespace {

/// Of the box around a model.
Eigen::Vector3f sizeOf(const CityModel& m) {
  Eigen::Vector3f low = m.mesh.vertices[0], high = low;
  for (const auto& v : m.mesh.vertices) low = low.cwiseMin(v), high = high.cwiseMax(v);
  return high - low;
}

// As downloads come: tiles in folders, names in capitals, terrain in a file of its own, and what is no model.
TEST(ModelFiles, FoldersMayHoldOtherFiles) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(2683000, 1247000, 410);
  std::filesystem::create_directories(folder / "city/tiles");
  folder.write("city/a.GML", cityGml("EPSG:2056", o));
  folder.write("city/tiles/b.gml", cityGml("EPSG:2056", o + Eigen::Vector3d(40, 0, 0)));
  folder.write(
      "city/dem.gml",
      "<CityModel><boundedBy><Envelope srsName=\"EPSG:2056\" srsDimension=\"3\"/></boundedBy><cityObjectMember>"
      "<ReliefFeature><tin><Triangle><exterior><LinearRing><posList>2683000 1246900 410 2683100 1246900 410 "
      "2683000 1247000 410 2683000 1246900 410</posList></LinearRing></exterior></Triangle></tin></ReliefFeature>"
      "</cityObjectMember></CityModel>");
  folder.write("city/metadata.xml", "<?xml version=\"1.0\"?><gmd:MD_Metadata/>");
  folder.write("city/style.json", "{\"colour\": \"red\"}");
  folder.write("city/empty.json", "");
  folder.write("city/tiles/c.gml.gz", "\x1F\x8B packed");
  const CityModel m = readCityModel(folder / "city", {"", o});
  EXPECT_EQ(m.building_ids.size(), 2u);
  EXPECT_NEAR(areaOf(m, Surface::kGround), 2 * 200 + 5000, 2);
  std::string remarks;
  for (const std::string& remark : m.remarks) remarks += remark + "\n";
  EXPECT_EQ(m.remarks.size(), 4u) << remarks;
  for (const char* said :
       {"metadata.xml is XML but not CityGML: passed over", "style.json is JSON but not CityJSON: passed",
        "empty.json is empty: passed over", "c.gml.gz is packed: unpack it (gunzip, unzip): passed"})
    EXPECT_NE(remarks.find(said), std::string::npos) << said << " in " << remarks;
  // What is broken is still an error, and so is a folder without any building.
  folder.write("city/broken.gml", "<CityModel><cityObjectMember>");
  EXPECT_NE(messageOf([&] { readCityModel(folder / "city"); }).find("broken.gml is not well-formed"),
            std::string::npos);
  std::filesystem::create_directory(folder / "other");
  folder.write("other/metadata.xml", "<gmd:MD_Metadata/>");
  EXPECT_NE(messageOf([&] { readCityModel(folder / "other"); }).find("has no buildings with walls"), std::string::npos);
  EXPECT_NE(messageOf([&] { readCityModel(folder / "city/tiles/c.gml.gz"); }).find("is packed"), std::string::npos);
}

/// The house at `o` with things around it that are no buildings: `theme` at a height above its feet, as `geometry`
/// (MultiSurface, MultiSolid).
std::string houseAnd(const Eigen::Vector3d& o,
                     const std::vector<std::tuple<std::string, double, std::string>>& things) {
  std::string out = cityGml("EPSG:2056", o);
  out.resize(out.rfind("</CityModel>"));
  for (const auto& [theme, height, geometry] : things) {
    const auto p = [&, z = height](double x, double y) { return Eigen::Vector3d(o + Eigen::Vector3d(x, y, z)); };
    const bool solid = geometry == "MultiSolid";
    out += "<cityObjectMember><" + theme + "><lod1" + geometry + "><" + geometry + "><member>" +
           (solid ? "<Solid><exterior><surfaceMember>" : "") +
           gmlPolygon({{p(20, 0), p(30, 0), p(30, 10), p(20, 10)}}, false) +
           (solid ? "</surfaceMember></exterior></Solid>" : "") + "</member></" + geometry + "></lod1" + geometry +
           "></" + theme + "></cityObjectMember>";
  }
  return out + "</CityModel>";
}

/// Area of what belongs to no building [m2].
double groundOf(const CityModel& m) { return areaOf(m, Surface::kGround) - 200; }

// Roads of PLATEAU's LOD1 lie at height 0 by its standard, its flood zones metres above the street.
TEST(ModelFiles, RoadsAndWatersFarFromTheBuildingsFeetAreNoGround) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(2683000, 1247000, 410);
  const auto read = [&](const std::vector<std::tuple<std::string, double, std::string>>& things) {
    return readCityModel(folder.write("a.gml", houseAnd(o, things)), {"", o});
  };
  const CityModel plateau = read({{"Road", -410, "MultiSurface"}, {"WaterBody", 5, "MultiSurface"}});
  EXPECT_NEAR(groundOf(plateau), 0, 0.1);
  ASSERT_EQ(plateau.remarks.size(), 2u);
  EXPECT_EQ(plateau.remarks[0],
            "Road surfaces lie 410 m below the ground at the buildings: they are no ground, and were left out");
  EXPECT_EQ(plateau.remarks[1].rfind("WaterBody surfaces lie 5 m above the ground", 0), 0u) << plateau.remarks[1];
  // A street above a cellar, a canal below a quay; a relief, whatever the walls do.
  const CityModel usual = read({{"Road", 2.5, "MultiSurface"}, {"WaterBody", -2, "MultiSurface"}});
  EXPECT_NEAR(groundOf(usual), 200, 0.1);
  EXPECT_TRUE(usual.remarks.empty());
  const CityModel relief = read({{"ReliefFeature", 8, "MultiSurface"}, {"Road", 8.1, "MultiSurface"}});
  EXPECT_NEAR(groundOf(relief), 200, 0.1);
  EXPECT_TRUE(relief.remarks.empty());
}

TEST(ModelFiles, CrownsOfWoodsAreNoGround) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(2683000, 1247000, 410);
  const auto read = [&](const char* geometry) {
    return readCityModel(folder.write("a.gml", houseAnd(o, {{"PlantCover", 2, geometry}})), {"", o});
  };
  EXPECT_NEAR(groundOf(read("MultiSolid")), 0, 0.1);
  EXPECT_NEAR(groundOf(read("MultiSurface")), 100, 0.1);
  // CityJSON: a house of one wall, a wood as solid and as surface, a road that hovers.
  const auto json = [&](const std::string& wood, const std::string& road_height) {
    return readCityModel(folder.write(
        "a.json",
        R"({"type": "CityJSON", "version": "1.1", "vertices": [[0,0,0],[10,0,0],[10,0,5],[0,0,5],[0,10,1],[10,10,1],
            [10,20,1],[0,20,1],[0,10,)" +
            road_height + "],[10,10," + road_height + "],[10,20," + road_height + R"(]],
            "CityObjects": {
            "h": {"type": "Building", "geometry": [{"type": "MultiSurface", "lod": "2", "boundaries": [[[0,1,2,3]]]}]},
            "w": {"type": "PlantCover", "geometry": [{"type": )" +
            wood + R"(}]},
            "r": {"type": "Road", "geometry": [{"type": "MultiSurface", "lod": "1", "boundaries": [[[8,9,10]]]}]}}})"));
  };
  const CityModel surface = json(R"("MultiSurface", "lod": "1", "boundaries": [[[4,5,6,7]]])", "0.5");
  EXPECT_NEAR(areaOf(surface, Surface::kGround), 150, 0.1);
  const CityModel solid = json(R"("Solid", "lod": "1", "boundaries": [[[[4,5,6,7]]]])", "31");
  EXPECT_NEAR(areaOf(solid, Surface::kGround), 0, 0.1);
  ASSERT_EQ(solid.remarks.size(), 1u);
  EXPECT_EQ(solid.remarks[0].rfind("Road surfaces lie 31 m above", 0), 0u) << solid.remarks[0];
}

TEST(ModelFiles, IsToldFromOthersByItsIdentity) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(2683000, 1247000, 410);
  const std::string path = folder.write("a.gml", cityGml("EPSG:2056", o)),
                    copy = folder.write("b.gml", cityGml("EPSG:2056", o));
  const std::string identity = readCityModel(path).identity;
  EXPECT_NE(identity.find("1 buildings 6 polygons heights 410.00 to 415.00"), std::string::npos) << identity;
  EXPECT_EQ(readCityModel(copy, {"", Eigen::Vector3d(o + Eigen::Vector3d(100, 0, 0))}).identity, identity);
  CityModelOptions options;
  options.height_offset = -3;
  EXPECT_NE(readCityModel(path, options).identity, identity);
  options = {};
  options.height_unit = 0.3048;
  EXPECT_NE(readCityModel(path, options).identity, identity);
  EXPECT_NE(readCityModel(folder.write("a.gml", cityGml("EPSG:2056", o + Eigen::Vector3d(0.01, 0, 0)))).identity,
            identity);
}

/// Two boxes of boxFaces() 60 m apart, without their floors, with y up or z up, at an offset.
std::string twoBoxes(bool y_up, const Eigen::Vector3d& offset) {
  std::string text;
  int n = 0;
  for (const double east : {0.0, 60.0}) {
    text += "o box" + std::to_string(east) + "\n";
    const Faces faces = boxFaces(offset + Eigen::Vector3d(east, 0, 0));
    for (std::size_t i = 1; i < faces.size(); ++i) {
      std::string face;
      for (const auto& p : faces[i][0]) {
        const Eigen::Vector3d q = y_up ? Eigen::Vector3d(p.x(), p.z(), -p.y()) : p;
        text += air_ground_common::formatted("v %.3f %.3f %.3f\n", q.x(), q.y(), q.z());
        face += " " + std::to_string(++n);
      }
      text += "f" + face + "\n";
    }
  }
  return text;
}

TEST(ModelFiles, ObjWithYUpAndOriginOfItsOwn) {
  const TemporaryFolder folder;
  const std::string lying = folder.write("a.obj", twoBoxes(true, {0, 0, 0}));
  const CityModel wrong = readCityModel(lying);
  ASSERT_EQ(wrong.remarks.size(), 1u);
  EXPECT_NE(wrong.remarks[0].find("a.obj seems to lie on its side: if its y is up, give --up y"), std::string::npos);
  CityModelOptions options;
  options.y_up = true;
  const CityModel right = readCityModel(lying, options);
  EXPECT_TRUE(right.remarks.empty());
  EXPECT_LT((sizeOf(right) - Eigen::Vector3f(70, 20, 5)).norm(), 1e-4f);
  EXPECT_NEAR(areaOf(right, Surface::kRoof), 400, 1e-2);
  EXPECT_NEAR(areaOf(right, Surface::kWall), 2 * 300, 1e-2);
  EXPECT_TRUE(readCityModel(folder.write("up.obj", twoBoxes(false, {0, 0, 0}))).remarks.empty());
  // In a grid, counted from a place of its own: told, and put there.
  options.crs = "EPSG:2056";
  const std::string m = messageOf([&] { readCityModel(lying, options); });
  EXPECT_NE(m.find("--model-offset EASTING NORTHING HEIGHT"), std::string::npos) << m;
  options.offset = Eigen::Vector3d(2683000, 1247000, 410);
  const CityModel placed = readCityModel(lying, options);
  EXPECT_LT((placed.crsFromWorld(Eigen::Vector3d::Zero()) - Eigen::Vector3d(2683035, 1247010, 410)).norm(), 1e-2);
  EXPECT_NEAR(sizeOf(placed).z(), 5, 0.01);
}

// Feet of a file whose plan nothing converts: only its heights would become metres.
TEST(ModelFiles, AHeightUnitNeedsACoordinateSystem) {
  const TemporaryFolder folder;
  const std::string path = folder.write("feet.obj", twoBoxes(false, {0, 0, 0}));
  CityModelOptions options;
  options.height_unit = 0.3048;
  const std::string m = messageOf([&] { readCityModel(path, options); });
  EXPECT_NE(m.find("feet.obj names no coordinate system"), std::string::npos) << m;
  EXPECT_NE(m.find("--crs"), std::string::npos) << m;
  EXPECT_EQ(m.find('\n'), std::string::npos) << m;
  options.height_unit = 1;
  EXPECT_LT((sizeOf(readCityModel(path, options)) - Eigen::Vector3f(70, 20, 5)).norm(), 1e-4f);
}

/// A box of boxFaces() at `o` with `names` (lines of OBJ) before its faces.
std::string namedBox(const Eigen::Vector3d& o, const std::string& names, int* vertices) {
  std::string text = names;
  for (const auto& rings : boxFaces(o)) {
    std::string face;
    for (const auto& p : rings[0]) {
      text += air_ground_common::formatted("v %.3f %.3f %.3f\n", p.x(), p.y(), p.z());
      face += " " + std::to_string(++*vertices);
    }
    text += "f" + face + "\n";
  }
  return text;
}

// Exporters of street maps call houses by their addresses, architects call storeys ground floor.
TEST(ModelFiles, HousesCalledAfterRoadsAreNoGround) {
  const TemporaryFolder folder;
  int n = 0;
  std::string text = namedBox({0, 0, 0}, "o 12_Church_Road\n", &n);
  text += namedBox({40, 0, 0}, "o house\ng ground_floor\nusemtl brick\n", &n);
  text += namedBox({80, 0, 0}, "o Pavement Lane 3\nusemtl ground\n", &n);
  // A road with kerbs of 15 cm, and a terrain that ends in a skirt of 8 m.
  const auto strip = [&](const std::string& name, double width, double depth) {
    text += "o " + name + "\n";
    for (const auto& [y, z] :
         {std::make_pair(-30.0, -depth), {-30.0, 0.0}, {-30.0 + width, 0.0}, {-30.0 + width, -depth}})
      text += air_ground_common::formatted("v -50 %.2f %.2f\nv 150 %.2f %.2f\n", y, z, y, z);
    for (int i = 0; i < 3; ++i, n += 2)
      text += air_ground_common::formatted("f %d %d %d %d\n", n + 1, n + 2, n + 4, n + 3);
    n += 2;
  };
  strip("Church_Road", 6, 0.15);
  strip("terrain", 20, 8);
  for (const bool y_up : {false, true}) {
    std::string turned;
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) {
      Eigen::Vector3d p;
      if (y_up && std::sscanf(line.c_str(), "v %lf %lf %lf", &p.x(), &p.y(), &p.z()) == 3)
        line = air_ground_common::formatted("v %.3f %.3f %.3f", p.x(), p.z(), -p.y());
      turned += line + "\n";
    }
    CityModelOptions options;
    options.y_up = y_up;
    const CityModel m = readCityModel(folder.write("a.obj", turned), options);
    EXPECT_EQ(m.building_ids, (std::vector<std::string>{"12_Church_Road", "house", "Pavement Lane 3"}));
    EXPECT_NEAR(areaOf(m, Surface::kWall), 3 * 300, 0.1);
    EXPECT_NEAR(areaOf(m, Surface::kRoof), 3 * 200, 0.1);
    EXPECT_NEAR(groundOf(m), 2 * 200 + 200 * (6 + 2 * 0.15) + 200 * (20 + 2 * 8), 0.1);
  }
}

// Corners at 0 0 0, things of a test: the frame would lie between them and the city.
TEST(ModelFiles, WhatLiesFarFromTheCityIsNoPartOfIt) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(691000, 5335000, 500);
  const auto withStray = [&](const Eigen::Vector3d& at, int houses) {
    std::string gml = cityGml("EPSG:25832", at);
    gml.resize(gml.rfind("</CityModel>"));
    for (int i = 0; i < houses; ++i) {
      const std::string other = cityGml("EPSG:25832", o + Eigen::Vector3d(30.0 * i, 0, 0));
      gml += other.substr(other.find("<cityObjectMember>"),
                          other.rfind("</CityModel>") - other.find("<cityObjectMember>"));
    }
    return readCityModel(folder.write("a.gml", gml + "</CityModel>"));
  };
  for (const Eigen::Vector3d& at : {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(491000, 5335000, 500)}) {
    const CityModel m = withStray(at, 20);
    EXPECT_EQ(m.building_ids.size(), 20u);
    EXPECT_LT((m.origin - Eigen::Vector3d(o.x() + 290, o.y() + 10, 500)).norm(), 2) << m.origin.transpose();
    ASSERT_EQ(m.remarks.size(), 1u);
    EXPECT_NE(m.remarks[0].find("a.gml: 6 polygons lie "), std::string::npos) << m.remarks[0];
  }
  // A village and a hamlet.
  EXPECT_EQ(withStray(o + Eigen::Vector3d(0, 9000, 0), 20).building_ids.size(), 21u);
}

// Soldner Berlin counts both ways from the middle of the town, and is defined north first.
TEST(ModelFiles, WhereBothAxisOrdersLieInTheAreaBuildingsTell) {
  const TemporaryFolder folder;
  const Eigen::Vector3d o(20100, 20000, 30);
  const auto check = [&](const std::string& srs, bool north_first, const char* order, std::size_t remarks) {
    const CityModel m = readCityModel(folder.write("a.gml", cityGml(srs, o, 2, north_first)), {"", o});
    EXPECT_EQ(m.axis_order, order);
    EXPECT_LT((sizeOf(m) - Eigen::Vector3f(10, 20, 5)).norm(), 0.2f) << srs << ": " << sizeOf(m).transpose();
    ASSERT_EQ(m.remarks.size(), remarks) << srs << ": " << m.remarks[0];
    if (remarks > 0) {
      EXPECT_NE(m.remarks[0].find("1 of 1 closed buildings are inside out"), std::string::npos) << m.remarks[0];
    }
  };
  check("urn:ogc:def:crs:EPSG::3068", true, "north, east", 0);
  check("urn:ogc:def:crs:EPSG::3068", false, "east, north", 1);
  check("EPSG:3068", false, "east, north", 0);
  check("EPSG:3068", true, "north, east", 1);
}

}  // namespace
}  // namespace streetview_localizer
