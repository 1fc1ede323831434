// City models, geotags, the Street View database and its index.
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include "fuzzing.h"
#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/database.h"
#include "streetview_localizer/descriptor_index.h"
#include "streetview_localizer/geotags.h"

namespace air_ground_fuzz {
namespace {

namespace sl = streetview_localizer;

void requireWhole(const sl::CityModel& model) {
  const int vertices = static_cast<int>(model.mesh.vertices.size()),
            buildings = static_cast<int>(model.building_ids.size());
  require(model.surface.size() == model.mesh.triangles.size(), "surfaces");
  require(model.building.size() == model.mesh.triangles.size(), "buildings");
  for (const auto& t : model.mesh.triangles) require(t.minCoeff() >= 0 && t.maxCoeff() < vertices, "triangle");
  for (const int b : model.building) require(b >= -1 && b < buildings, "building");
  for (const auto& v : model.mesh.vertices) require(v.allFinite(), "vertex");
}

Target cityModel(const std::string& name) {
  return [name](const Bytes& bytes) {
    const std::string path = fileOf(name, bytes);
    answers([&] {
      const sl::CityModel model = sl::readCityModel(path);
      requireWhole(model);
      if (!model.mesh.triangles.empty()) const sl::BackProjector projector(model);
    });
  };
}

void geotags(const Bytes& bytes) {
  // The kind is told by the name.
  const std::string path = fileOf(!bytes.empty() && bytes[0] == '{' ? "input.geojson" : "input.csv", bytes);
  answers([&] {
    for (const sl::Geotag& tag : sl::readGeotags(path))
      require(!tag.problem.empty() || std::isfinite(tag.position.latitude + tag.heading), "geotag");
  });
  answers([&] {
    for (const auto& image : sl::readSurveyedImages(path))
      require(air_ground_common::isValid(image.T_crs_camera), "pose");
  });
}

void photograph(const Bytes& bytes) {
  const std::string folder = emptyFolder(), path = fileOf("input.jpg", bytes);
  answers([&] {
    for (const sl::Geotag& tag : sl::readExif(folder))
      require(!tag.problem.empty() || std::isfinite(tag.position.latitude + tag.heading), "geotag");
  });
  answers([&] {
    const cv::Size size = sl::imageSize(path);
    sl::exifFocalLength(path, size.width);
  });
}

Bytes contentOf(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return Bytes(std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>());
}

/// The input as a list of places and the bytes that are written there: small inputs reach all of a large file.
Bytes damaged(Bytes content, const Bytes& patches) {
  for (Source source(patches); !source.empty() && !content.empty();) {
    std::size_t at = source.take<std::uint32_t>() % content.size();
    for (const char c : source.text(64))
      content[std::exchange(at, (at + 1) % content.size())] = static_cast<std::uint8_t>(c);
  }
  return content;
}

cv::Mat someDescriptors() {
  std::mt19937 random(1);
  cv::Mat out(40, 128, CV_8U);
  for (int i = 0; i < out.rows * out.cols; ++i) out.data[i] = static_cast<std::uint8_t>(random());
  return out;
}

Bytes wholeDatabase() {
  const std::string path = emptyFolder() + "/whole.gpkg";
  sl::CityModel model;
  model.mesh.vertices = {{-30, 10, 0}, {30, 10, 0}, {30, 10, 12}, {-30, 10, 12}};
  model.mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  model.surface = {sl::Surface::kWall, sl::Surface::kWall};
  model.building = {0, 0};
  model.building_ids = {"wall"};
  sl::View view;
  view.camera.width = 64, view.camera.height = 48;
  view.camera.fx = view.camera.fy = 50, view.camera.cx = 31.5, view.camera.cy = 23.5;
  view.image = cv::Mat(48, 64, CV_8UC3, cv::Scalar(10, 100, 200));
  view.features.descriptors = someDescriptors();
  for (int i = 0; i < view.features.descriptors.rows; ++i) {
    view.features.keypoints.emplace_back(1.f * i, 1.f * i, 5.f);
    view.points.emplace_back(1.f * i, 10.f, 1.f);
    view.normals.emplace_back(0.f, -1.f, 0.f);
  }
  sl::Panorama panorama;
  panorama.id = "panorama.jpg";
  {
    sl::DatabaseWriter writer(path, model, "fuzzing");
    writer.add(panorama, {view, view});
    writer.finish();
  }
  return contentOf(path);
}

void database(const Bytes& bytes) {
  static const Bytes whole = wholeDatabase();
  const std::string folder = emptyFolder(), path = fileOf("input.gpkg", damaged(whole, bytes));
  answers([&] {
    const sl::StreetviewDatabase read = sl::loadDatabase(path);
    requireWhole(read.model);
    read.near({0, 0, 0}, 50);
    for (const sl::View& view : read.views) {
      require(view.points.size() == view.features.keypoints.size(), "points");
      require(view.features.descriptors.rows == static_cast<int>(view.points.size()), "descriptors");
    }
  });
}

// The first byte chooses method and file.
void index(const Bytes& bytes) {
  if (bytes.empty()) return;
  static const cv::Mat descriptors = someDescriptors();
  sl::IndexSettings settings;
  settings.method =
      bytes[0] % 2 && sl::isAvailable(sl::IndexMethod::kHnsw) ? sl::IndexMethod::kHnsw : sl::IndexMethod::kFlann;
  static std::map<sl::IndexMethod, std::pair<Bytes, Bytes>> kept;
  auto& [header, data] = kept[settings.method];
  const std::string path = emptyFolder() + "/input.index";
  if (header.empty()) {
    sl::buildIndex(descriptors, settings)->save(path);
    header = contentOf(path), data = contentOf(path + ".data");
  }
  const Bytes patches(bytes.begin() + 1, bytes.end());
  fileOf("input.index", bytes[0] & 2 ? damaged(header, patches) : header);
  fileOf("input.index.data", bytes[0] & 2 ? data : damaged(data, patches));
  answers([&] {
    const auto read = sl::loadIndex(path, descriptors, settings);
    for (const auto& found : read->search(descriptors.row(0), 3)) require(!found.empty(), "neighbours");
  });
}

}  // namespace

void addCityTargets(Targets* targets) {
  targets->insert({{"citygml", cityModel("input.gml")},
                   {"cityjson", cityModel("input.json")},
                   {"obj", cityModel("input.obj")},
                   {"geotags", geotags},
                   {"photograph", photograph},
                   {"database", database},
                   {"index", index}});
}

}  // namespace air_ground_fuzz
