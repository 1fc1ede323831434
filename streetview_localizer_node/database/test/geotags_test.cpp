#include "streetview_localizer/geotags.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <opencv2/imgcodecs.hpp>

#include "air_ground_common/units.h"
#include "test_files.h"
#include "xmp_jpeg.h"

namespace streetview_localizer {
namespace {

using air_ground_common::kDegree;

CityModel modelAt(const std::string& crs, const Eigen::Vector3d& origin) {
  CityModel m;
  m.crs = crs;
  m.origin = origin;
  m.frame = std::make_shared<air_ground_common::LocalFrame>(crs, origin);
  return m;
}

TEST(Geotags, CsvColumnsByNameAndProblemsOfSingleImages) {
  const TemporaryFolder folder;
  const std::string path = folder.write("a.csv",
                                        "image,heading_deg,lon,lat,alt,roll_deg\n"
                                        "\"a,1.jpg\",90,8.54,47.37,410.5,2\n"
                                        "b.jpg,90,0,0,0,0\r\n"
                                        "c.jpg,,8.54,47.37,410,0\n"
                                        "d.jpg,10,8.54,147.37,410,0\n");
  const auto tags = readGeotags(path);
  ASSERT_EQ(tags.size(), 4u);
  EXPECT_EQ(tags[0].image, "a,1.jpg");
  EXPECT_TRUE(tags[0].problem.empty());
  EXPECT_DOUBLE_EQ(tags[0].position.latitude, 47.37);
  EXPECT_DOUBLE_EQ(tags[0].position.longitude, 8.54);
  EXPECT_NEAR(tags[0].heading, M_PI / 2, 1e-12);
  EXPECT_NEAR(tags[0].roll, 2 * kDegree, 1e-12);
  EXPECT_EQ(tags[0].pitch, 0);
  EXPECT_NE(tags[1].problem.find("0,0"), std::string::npos);
  EXPECT_EQ(tags[2].problem, "");
  EXPECT_TRUE(tags[0].heading_known);
  EXPECT_FALSE(tags[2].heading_known);
  EXPECT_TRUE(tags[2].height_known);
  EXPECT_NE(tags[3].problem.find("latitude"), std::string::npos);
}

// Street View's metadata, and what Mapillary's and KartaView's tools write: neither heights nor headings are a must.
TEST(Geotags, CsvByOtherNames) {
  const TemporaryFolder folder;
  const auto first = [&](const std::string& text) { return readGeotags(folder.write("a.csv", text)).at(0); };
  const Geotag street_view = first("pano_id,lat,lng\nCAoSLEFGMVFp,47.37,8.54\n");
  EXPECT_EQ(street_view.image, "CAoSLEFGMVFp");
  EXPECT_EQ(street_view.problem, "");
  EXPECT_DOUBLE_EQ(street_view.position.longitude, 8.54);
  EXPECT_FALSE(street_view.height_known);
  EXPECT_FALSE(street_view.heading_known);
  EXPECT_EQ(street_view.position.height + street_view.heading, 0);
  const Geotag mapillary =
      first("id,latitude,longitude,altitude,compass_angle,computed_compass_angle\n17,47.37,8.54,410,80,90\n");
  EXPECT_EQ(mapillary.image, "17");
  EXPECT_DOUBLE_EQ(mapillary.position.height, 410);
  EXPECT_NEAR(mapillary.heading, M_PI / 2, 1e-12);
  EXPECT_NEAR(first("id,lat,lon,compass_angle,computed_compass_angle\n17,47.37,8.54,90,\n").heading, M_PI / 2, 1e-12);
  const Geotag drone = first("filename,latitude,longitude,elevation,yaw,pitch,roll\na.jpg,47.37,8.54,3,90,1,2\n");
  EXPECT_DOUBLE_EQ(drone.position.height, 3);
  EXPECT_NEAR(drone.heading, M_PI / 2, 1e-12);
  EXPECT_NEAR(drone.pitch, kDegree, 1e-12);
  EXPECT_NEAR(drone.roll, 2 * kDegree, 1e-12);
}

// As spreadsheets save them: a byte order mark, semicolons, carriage returns, quoted cells, spaces.
TEST(Geotags, CsvOfSpreadsheets) {
  const TemporaryFolder folder;
  const auto tags = readGeotags(folder.write("a.CSV",
                                             "\xEF\xBB\xBF\"image\"; \"lat\" ;lon;alt;heading_deg\r\n"
                                             "\r\n"
                                             "\"a;1, north.jpg\" ; \"-33.86\";-151.21; 4.5 ;90\r\n"
                                             "b.jpg;;8;1;2;a cell too many\r\n"));
  ASSERT_EQ(tags.size(), 2u);
  EXPECT_EQ(tags[0].image, "a;1, north.jpg");
  EXPECT_EQ(tags[0].position.latitude, -33.86);
  EXPECT_EQ(tags[0].position.longitude, -151.21);
  EXPECT_EQ(tags[0].position.height, 4.5);
  EXPECT_NEAR(tags[0].heading, M_PI / 2, 1e-12);
  EXPECT_EQ(tags[0].problem, "");
  EXPECT_EQ(tags[1].problem, "has no latitude and longitude");
}

TEST(Geotags, GeoJson) {
  const TemporaryFolder folder;
  const auto tags = readGeotags(folder.write("a.geojson",
                                             R"({"type":"FeatureCollection","features":[
    {"type":"Feature","geometry":{"type":"Point","coordinates":[8.54,47.37,410.5]},"properties":{"image":"a.jpg","heading_deg":350,"pitch_deg":1}},
    {"type":"Feature","geometry":null,"properties":{"image":"b.jpg","heading_deg":350}}]})"));
  ASSERT_EQ(tags.size(), 2u);
  EXPECT_DOUBLE_EQ(tags[0].position.latitude, 47.37);
  EXPECT_DOUBLE_EQ(tags[0].position.height, 410.5);
  EXPECT_NEAR(tags[0].heading, 350 * kDegree, 1e-12);
  EXPECT_TRUE(tags[0].problem.empty());
  EXPECT_FALSE(tags[1].problem.empty());
}

// Mapillary's points: numbers for names, its own words for headings, no heights.
TEST(Geotags, GeoJsonOfMapillary) {
  const TemporaryFolder folder;
  const auto tags = readGeotags(folder.write("a.geojson",
                                             R"({"features":[
    {"geometry":{"type":"Point","coordinates":[8.54,47.37]},"properties":{"id":498763468214164,"compass_angle":80,"computed_compass_angle":90.0}},
    {"id":"abc","geometry":{"type":"Point","coordinates":[8.54,47.37]},"properties":{"compass_angle":90}}]})"));
  ASSERT_EQ(tags.size(), 2u);
  EXPECT_EQ(tags[0].image, "498763468214164");
  EXPECT_EQ(tags[1].image, "abc");
  for (const Geotag& g : tags) {
    EXPECT_EQ(g.problem, "");
    EXPECT_FALSE(g.height_known);
    EXPECT_NEAR(g.heading, M_PI / 2, 1e-12);
  }
}

// As its interface answers, and as scripts keep the images of several answers.
TEST(Geotags, AnswersOfMapillary) {
  const TemporaryFolder folder;
  const std::string images = R"([
    {"id":"498763468214164","geometry":{"type":"Point","coordinates":[8.5,47.3]},"computed_geometry":{"type":"Point","coordinates":[8.54,47.37]},
     "altitude":410.5,"compass_angle":80,"computed_compass_angle":90,"is_pano":true},
    {"id":"17","geometry":{"type":"Point","coordinates":[8.54,47.37]},"computed_geometry":null,"compass_angle":90}])";
  for (const std::string& text : {images, R"({"data":)" + images + "}"}) {
    const auto tags = readGeotags(folder.write("mapillary.json", text));
    ASSERT_EQ(tags.size(), 2u);
    EXPECT_EQ(tags[0].image, "498763468214164");
    EXPECT_DOUBLE_EQ(tags[0].position.height, 410.5);
    EXPECT_FALSE(tags[1].height_known);
    for (const Geotag& g : tags) {
      EXPECT_EQ(g.problem, "");
      EXPECT_DOUBLE_EQ(g.position.latitude, 47.37);
      EXPECT_DOUBLE_EQ(g.position.longitude, 8.54);
      EXPECT_NEAR(g.heading, M_PI / 2, 1e-12);
    }
  }
  EXPECT_THROW(readGeotags(folder.write("error.json", R"({"error":{"message":"Invalid token"}})")), std::runtime_error);
}

// As ogr2ogr makes it of a CSV file: all properties are text.
TEST(Geotags, GeoJsonNumbersAsText) {
  const TemporaryFolder folder;
  const auto tagOf = [&](const std::string& properties) {
    return readGeotags(folder.write(
        "a.geojson",
        R"({"features":[{"geometry":{"type":"Point","coordinates":[8.54,47.37]},"properties":{"image":"a.jpg",)" +
            properties + "}}]}"))[0];
  };
  const Geotag g = tagOf(R"("alt":"410.5","heading_deg":"350","pitch_deg":" 1.5 ","roll_deg":"-2")");
  EXPECT_EQ(g.problem, "");
  EXPECT_DOUBLE_EQ(g.position.height, 410.5);
  EXPECT_NEAR(g.heading, 350 * kDegree, 1e-12);
  EXPECT_NEAR(g.pitch, 1.5 * kDegree, 1e-12);
  EXPECT_NEAR(g.roll, -2 * kDegree, 1e-12);
  // A cell that is empty, as in a CSV file, is no number; one that is absent or null is none given.
  EXPECT_FALSE(tagOf(R"("alt":"410","heading_deg":"","pitch_deg":"1")").heading_known);
  EXPECT_EQ(tagOf(R"("alt":"410","heading_deg":"1","pitch_deg":"")").problem, "has a pitch or roll that is no number");
  EXPECT_EQ(tagOf(R"("alt":410,"heading_deg":1,"pitch_deg":null)").problem, "");
  const std::string m = messageOf([&] { tagOf(R"("alt":"410","heading_deg":"north")"); });
  EXPECT_NE(m.find("a.geojson, image a.jpg: 'north' is not a number"), std::string::npos) << m;
}

TEST(Geotags, BrokenListsGiveOneClearLine) {
  const TemporaryFolder folder;
  const auto error = [&](const std::string& name, const std::string& text) {
    const std::string m = messageOf([&, path = folder.write(name, text)] { readGeotags(path); });
    EXPECT_EQ(m.find('\n'), std::string::npos);
    return m;
  };
  EXPECT_NE(error("a.csv", "image,lat,alt\n").find("no column lon"), std::string::npos);
  EXPECT_NE(error("a.csv", "image,lat,lon,alt,heading_deg\n").find("lists no images"), std::string::npos);
  EXPECT_NE(error("a.csv", "image,lat,lon,alt,heading_deg\na.jpg,1,2\n").find("line 2"), std::string::npos);
  EXPECT_NE(error("a.csv", "image,lat,lon,alt,heading_deg\na.jpg,1,2,3,north\n").find("'north' is not a number"),
            std::string::npos);
  EXPECT_NE(
      error("a.csv", "# first\n\nimage,lat,lon,alt,heading_deg\na.jpg,1,2,3,4\n#\nb.jpg,1,2,3,4deg\n").find("line 6: "),
      std::string::npos);
  EXPECT_NE(error("a.csv", "image;lat;lon;alt;heading_deg\na.jpg;47,37;8;3;4\n").find("'47,37' is not a number"),
            std::string::npos);
  EXPECT_NE(error("a.csv", "").find("no column image"), std::string::npos);
  EXPECT_NE(error("a.csv", "# nothing\r\n\r\n").find("no column image"), std::string::npos);
  EXPECT_NE(error("a.geojson", "{").find("no GeoJSON"), std::string::npos);
  EXPECT_NE(messageOf([&] { readGeotags(folder / "none.csv"); }).find("cannot open"), std::string::npos);
}

// A virtual raster can name any file of the machine, or of the network: it is no photograph, whatever it is called.
TEST(Geotags, OnlyPhotographsAreOpened) {
  const TemporaryFolder folder;
  cv::imwrite(folder / "real.png", cv::Mat(4, 6, CV_8UC1, cv::Scalar(90)));
  EXPECT_EQ(imageSize(folder / "real.png"), cv::Size(6, 4));
  folder.write("virtual.jpg",
               "<VRTDataset rasterXSize=\"6\" rasterYSize=\"4\"><VRTRasterBand dataType=\"Byte\" band=\"1\">"
               "<SimpleSource><SourceFilename relativeToVRT=\"1\">real.png</SourceFilename></SimpleSource>"
               "</VRTRasterBand></VRTDataset>");
  EXPECT_TRUE(imageSize(folder / "virtual.jpg").empty());
}

// x towards the image's centre, y left, z up; heading clockwise from north, pitch up, roll clockwise.
TEST(Geotags, AnglesTurnTheBodyAsTheirNamesSay) {
  const CityModel m = modelAt("EPSG:2056", {2683000, 1247000, 410});
  Geotag g;
  g.position = m.frame->origin();
  const auto x = [&](double heading, double pitch) {
    g.heading = heading * kDegree, g.pitch = pitch * kDegree, g.roll = 0;
    return Eigen::Vector3d(worldPose(g, m).linear().col(0));
  };
  EXPECT_LT((x(0, 0) - Eigen::Vector3d(0, 1, 0)).norm(), 1e-12);   // north
  EXPECT_LT((x(90, 0) - Eigen::Vector3d(1, 0, 0)).norm(), 1e-12);  // east
  EXPECT_LT((x(225, 0) - Eigen::Vector3d(-1, -1, 0).normalized()).norm(), 1e-12);
  EXPECT_NEAR(x(40, 10).z(), std::sin(10 * kDegree), 1e-12);
  g.heading = 0, g.pitch = 0, g.roll = 5 * kDegree;
  EXPECT_NEAR(worldPose(g, m).linear().col(1).z(), std::sin(5 * kDegree), 1e-12);  // the left side rises
  EXPECT_LT(worldPose(g, m).translation().norm(), 1e-6);
}

// Against PROJ through the frame: a point 100 m ahead on the grid's north has the origin's easting.
TEST(Geotags, GridNorthDiffersFromTrueNorthByTheConvergence) {
  // East and west of the central meridian of UTM 32 (9 E), and Swiss LV95 east of Berne.
  const std::pair<const char*, Eigen::Vector3d> places[] = {{"EPSG:32632", {677000, 5403000, 370}},
                                                            {"EPSG:32632", {320000, 5403000, 370}},
                                                            {"EPSG:2056", {2683000, 1247000, 410}}};
  for (const auto& [crs, origin] : places) {
    const CityModel m = modelAt(crs, origin);
    Geotag g;
    g.position = m.frame->origin();
    const Eigen::Vector3d ahead_grid = m.crsFromWorld(worldPose(g, m, North::kGrid) * Eigen::Vector3d(100, 0, 0));
    EXPECT_NEAR(ahead_grid.x(), origin.x(), 5e-3);
    EXPECT_NEAR(ahead_grid.y(), origin.y() + 100, 0.1);
    const auto ahead_true = m.frame->toGeodetic(worldPose(g, m, North::kTrue) * Eigen::Vector3d(100, 0, 0));
    EXPECT_NEAR(ahead_true.longitude, g.position.longitude, 1e-9);
    EXPECT_GT(ahead_true.latitude, g.position.latitude);
    // The two differ by more than this test's tolerance: 100 m times the convergence (0.8 to 1.9 degrees).
    EXPECT_GT(std::abs(m.crsFromWorld(worldPose(g, m, North::kTrue) * Eigen::Vector3d(100, 0, 0)).x() - origin.x()),
              1.0);
  }
}

TEST(Geotags, ModelWithoutSystemHasNoPlaceForThem) {
  EXPECT_NE(messageOf([] { worldPose(Geotag(), CityModel()); }).find("--crs"), std::string::npos);
}

TEST(Geotags, SurveyedImages) {
  const TemporaryFolder folder;
  const auto images = readSurveyedImages(folder.write("p.txt", "# comment\na.jpg 800 801 320 240 1 2 3 0 0 0.6 0.8\n"));
  ASSERT_EQ(images.size(), 1u);
  EXPECT_EQ(images[0].fy, 801);
  EXPECT_LT((images[0].T_crs_camera.translation() - Eigen::Vector3d(1, 2, 3)).norm(), 1e-12);
  EXPECT_NEAR(images[0].T_crs_camera.linear()(1, 0), 2 * 0.6 * 0.8, 1e-12);
  EXPECT_NE(messageOf([&] {
              readSurveyedImages(folder.write("q.txt", "a.jpg 800 801 320 240 1 2 3 0 0 0.6\n"));
            }).find("line 1"),
            std::string::npos);
  EXPECT_NE(messageOf([&] {
              readSurveyedImages(folder.write("q.txt", "a.jpg 800 801 320 240 1 2 3 0 0 0.6 0.9\n"));
            }).find("norm"),
            std::string::npos);
}

// As attributes and as elements; angles that are none.
TEST(Geotags, AnglesOfPanoramasComeFromXmp) {
  const std::string begin = kXmpBegin, end = kXmpEnd;
  const std::string packets[] = {
      begin + " GPano:PoseHeadingDegrees=\"350.5\" GPano:PosePitchDegrees = '-2' GPano:PoseRollDegrees=\"\"/>" + end,
      begin +
          "><GPano:PoseHeadingDegrees>350.5</GPano:PoseHeadingDegrees><GPano:PosePitchDegrees> -2 "
          "</GPano:PosePitchDegrees></rdf:Description>" +
          end,
      begin + " GPano:PoseHeadingDegrees=\"350.5\"><broken"};
  const TemporaryFolder folder;
  for (std::size_t k = 0; k < std::size(packets); ++k)
    folder.write(std::to_string(k) + ".jpg", jpegWithXmp({6, 4}, packets[k]));
  const auto tags = readExif(folder / "");
  ASSERT_EQ(tags.size(), 3u);
  for (int k = 0; k < 2; ++k) {
    EXPECT_NEAR(tags[k].heading, 350.5 * kDegree, 1e-12) << k;
    EXPECT_NEAR(tags[k].pitch, -2 * kDegree, 1e-12) << k;
    EXPECT_EQ(tags[k].roll, 0) << k;
  }
  EXPECT_FALSE(tags[2].heading_known);
}

// The size that the whole sphere would have, of an image that shows a part of it.
TEST(Geotags, PartsOfASphereSaySo) {
  const TemporaryFolder folder;
  const auto full = [&](const cv::Size& size, const cv::Size& cropped, const cv::Size& whole) {
    return fullSphereSize(folder.write("a.jpg", panoramaJpeg(size, cropped, whole))).value_or(cv::Size());
  };
  EXPECT_EQ(full({40, 20}, {4000, 2000}, {8000, 4000}), cv::Size(8000, 4000));  // also when made smaller since
  EXPECT_EQ(full({40, 10}, {40, 10}, {40, 20}), cv::Size(40, 20));              // all around, without sky and ground
  EXPECT_EQ(full({40, 20}, {8000, 4000}, {8000, 4000}), cv::Size());
  EXPECT_EQ(full({40, 20}, {40, 10}, {40, 20}), cv::Size());  // padded since
  EXPECT_EQ(full({40, 20}, {4000, 1990}, {4000, 2000}), cv::Size());
  EXPECT_EQ(full({40, 20}, {0, 0}, {-1, 0}), cv::Size());
  EXPECT_FALSE(fullSphereSize(folder.write("a.jpg", jpegWithXmp({6, 4}, ""))));
  EXPECT_FALSE(fullSphereSize(folder.write("a.jpg", "no image")));
}

TEST(Geotags, OrientationsTurnTheImageOrMirrorIt) {
  const TemporaryFolder folder;
  std::vector<uchar> jpeg;
  cv::imencode(".jpg", cv::Mat(4, 6, CV_8UC1, cv::Scalar(90)), jpeg);
  const double rolls[] = {0, 0, 0, 180, 0, 0, 90, 0, -90};
  for (int k = 1; k <= 8; ++k) {
    const ExifOrientation o = exifOrientation(folder.write("a.jpg", withOrientation(jpeg, k)));
    EXPECT_EQ(o.mirrored, k == 2 || k == 4 || k == 5 || k == 7) << k;
    EXPECT_NEAR(o.roll, rolls[k] * kDegree, 1e-12) << k;
  }
  EXPECT_EQ(exifOrientation(folder.write("a.jpg", std::string(jpeg.begin(), jpeg.end()))).roll, 0);
  EXPECT_FALSE(exifOrientation(folder / "none.jpg").mirrored);
}

// A lens of 26 mm sees 26 / 21.63 half diagonals far, whatever the proportions: by the width, 4:3 would be 4 % short.
TEST(Geotags, EquivalentFocalLengthIsOfTheDiagonal) {
  const TemporaryFolder folder;
  for (const auto& [size, focal] :
       {std::make_pair(cv::Size(360, 240), 260.0), {{400, 300}, 300.46}, {{300, 400}, 300.46}, {{480, 270}, 330.95}}) {
    std::vector<uchar> jpeg;
    cv::imencode(".jpg", cv::Mat(size, CV_8UC1, cv::Scalar(90)), jpeg);
    const auto found = exifFocalLength(folder.write("a.jpg", withExifTag(jpeg, 0xA405, 26)), size.width);
    ASSERT_TRUE(found) << size;
    EXPECT_NEAR(*found, focal, 0.02) << size;
  }
}

/// A JPEG whose EXIF has these GPS entries: letters or a byte, and rationals as pairs.
class ExifImage {
 public:
  void text(std::uint16_t tag, char letter) { entry(tag, 2, 2, std::string(1, letter) + std::string(3, '\0')); }
  void byte(std::uint16_t tag, char value) { entry(tag, 1, 1, std::string(1, value) + std::string(3, '\0')); }
  void rationals(std::uint16_t tag, const std::vector<std::pair<std::uint32_t, std::uint32_t>>& values) {
    entry(tag, 5, static_cast<std::uint32_t>(values.size()), "");
    for (const auto& [numerator, denominator] : values) data_.back() += number(numerator, 4) + number(denominator, 4);
  }
  std::string jpeg() const {
    std::vector<uchar> image;
    cv::imencode(".jpg", cv::Mat(4, 6, CV_8UC1, cv::Scalar(90)), image);
    // The header and a directory of one entry, which points to that of GPS; behind it lie the rationals.
    constexpr std::uint32_t kGps = 8 + 2 + 12 + 4;
    std::string tiff = "II*" + std::string(1, '\0') + number(8, 4) + number(1, 2) + number(0x8825, 2) + number(4, 2) +
                       number(1, 4) + number(kGps, 4) + number(0, 4) + number(entries_.size(), 2);
    std::string data;
    for (std::size_t i = 0; i < entries_.size(); ++i) {
      const std::size_t at = kGps + 2 + 12 * entries_.size() + 4 + data.size();
      tiff += entries_[i] + (data_[i].empty() ? "" : number(at, 4));
      data += data_[i];
    }
    const std::string exif = std::string("Exif\0\0", 6) + tiff + number(0, 4) + data;
    return std::string("\xFF\xD8\xFF\xE1") + static_cast<char>((exif.size() + 2) >> 8) +
           static_cast<char>((exif.size() + 2) & 255) + exif + std::string(image.begin() + 2, image.end());
  }

 private:
  static std::string number(std::size_t value, int bytes) {
    std::string text;
    for (; bytes > 0; --bytes, value >>= 8) text += static_cast<char>(value & 255);
    return text;
  }
  void entry(std::uint16_t tag, std::uint16_t type, std::uint32_t count, const std::string& value) {
    entries_.push_back(number(tag, 2) + number(type, 2) + number(count, 4) + value);
    data_.emplace_back();
  }
  std::vector<std::string> entries_, data_;
};

/// The geotag of a photograph south of the equator and west of Greenwich, below the sea.
Geotag exifOf(const std::vector<std::pair<std::uint32_t, std::uint32_t>>& latitude,
              const std::vector<std::pair<std::uint32_t, std::uint32_t>>& longitude, char north = 'T',
              const std::pair<std::uint32_t, std::uint32_t>& depth = {45, 10},
              const std::pair<std::uint32_t, std::uint32_t>& direction = {2705, 10}) {
  ExifImage image;
  image.text(1, 'S');
  image.rationals(2, latitude);
  image.text(3, 'W');
  image.rationals(4, longitude);
  image.byte(5, 1);
  image.rationals(6, {depth});
  image.text(16, north);
  image.rationals(17, {direction});
  const TemporaryFolder folder;
  folder.write("a.JPG", image.jpeg());
  return readExif(folder / "").at(0);
}

TEST(Geotags, ExifOfAnotherHemisphere) {
  const Geotag g = exifOf({{33, 1}, {51, 1}, {4500, 100}}, {{151, 1}, {12, 1}, {0, 1}});
  EXPECT_EQ(g.problem, "");
  EXPECT_NEAR(g.position.latitude, -(33 + 51 / 60.0 + 45 / 3600.0), 1e-9);
  EXPECT_NEAR(g.position.longitude, -(151 + 12 / 60.0), 1e-9);
  EXPECT_NEAR(g.position.height, -4.5, 1e-9);
  EXPECT_NEAR(g.heading, 270.5 * kDegree, 1e-9);
  EXPECT_NE(exifOf({{33, 1}}, {{151, 1}}, 'M').problem.find("declination"), std::string::npos);
}

// What telephones write that never found their place.
TEST(Geotags, ExifRationalsOverZeroAreNoPlace) {
  const std::vector<std::pair<std::uint32_t, std::uint32_t>> none(3, {0, 0});
  EXPECT_NE(exifOf(none, none).problem.find("never located"), std::string::npos);
  for (const std::size_t part : {0, 1, 2}) {
    std::vector<std::pair<std::uint32_t, std::uint32_t>> known = {{33, 1}, {51, 1}, {45, 1}}, broken = known;
    broken[part].second = 0;
    for (const Geotag& g : {exifOf(broken, known), exifOf(known, broken)})
      EXPECT_NE(g.problem.find("over zero in its EXIF"), std::string::npos) << part << ": " << g.problem;
  }
  EXPECT_FALSE(exifOf({{33, 1}}, {{151, 1}}, 'T', {45, 0}).height_known);
  EXPECT_FALSE(exifOf({{33, 1}}, {{151, 1}}, 'T', {45, 10}, {2705, 0}).heading_known);
}

TEST(Geotags, ExifOfRealPhotographs) {
  const std::string folder = sharedData("opensfm_lund/images");
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << folder << " is not there";
  const auto tags = readExif(folder);
  EXPECT_EQ(tags.size(), 29u);
  for (const Geotag& g : tags) {
    EXPECT_NEAR(g.position.latitude, 55.71, 0.03) << g.image;
    EXPECT_NEAR(g.position.longitude, 13.19, 0.05);
    EXPECT_FALSE(g.heading_known);  // the telephone had no compass
  }
}

}  // namespace
}  // namespace streetview_localizer
