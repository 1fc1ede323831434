#include "model_files.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <stdexcept>

#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"

namespace streetview_localizer {

namespace fs = std::filesystem;
using air_ground_common::formatted;

namespace {

// Beyond it a coordinate is no place on earth, in no system; and the tessellation's products would overflow.
void checkCoordinates(const std::string& path, PolygonModel* model) {
  constexpr double kFarthest = 1e9;
  forEachPoint(model, [&](const Eigen::Vector3d& p) {
    if (!(p.cwiseAbs().maxCoeff() < kFarthest) || !p.allFinite())
      throw std::runtime_error(path + " has coordinates that are no place on earth: is its transform right?");
  });
}

/// Takes away what lies so far from all else that it is no part of the city: corners at 0 0 0, things of a test. The
/// frame would be put between it and the city.
void leaveOutStrays(const std::string& path, PolygonModel* model) {
  constexpr double kTimes = 20;                      // as far out as nine tenths of the model, ...
  constexpr double kLeast = 1e4, kLeastAngle = 0.1;  // ... and at least so far, in the plan's unit
  std::vector<double> x, y, distances;
  for (const Polygon& polygon : model->polygons)
    x.push_back(polygon.rings[0][0].x()), y.push_back(polygon.rings[0][0].y());
  const Eigen::Vector2d middle(air_ground_common::median(x), air_ground_common::median(y));
  for (std::size_t i = 0; i < x.size(); ++i) distances.push_back((Eigen::Vector2d(x[i], y[i]) - middle).norm());
  const bool degrees = middle.cwiseAbs().maxCoeff() <= 360;
  const double reach = air_ground_common::quantile(std::move(distances), 0.9);
  const double limit = std::max(degrees ? kLeastAngle : kLeast, kTimes * reach);
  const auto strays = [&](const Polygon& polygon) {
    return std::any_of(polygon.rings[0].begin(), polygon.rings[0].end(),
                       [&](const Eigen::Vector3d& p) { return (p.head<2>() - middle).norm() > limit; });
  };
  auto& all = model->polygons;
  const auto kept = std::remove_if(all.begin(), all.end(), strays);
  const auto count = std::distance(kept, all.end());
  all.erase(kept, all.end());
  if (count > 0)
    model->remarks.push_back(path + formatted(": %ld polygons lie more than %.6g units of its plan from the city: they "
                                              "were left out",
                                              static_cast<long>(count), limit));
}

/// True when y, not z, seems to be up: buildings stand on one level of y and all over z, or their roofs look along y.
bool liesOnItsSide(const PolygonModel& model) {
  Eigen::Vector3d net = Eigen::Vector3d::Zero();
  double total = 0;
  Box all, feet;
  std::map<int, Box> buildings;
  for (const Polygon& polygon : model.polygons) {
    const Eigen::Vector3d area = areaVector(polygon.rings[0]);
    net += area;
    total += area.norm();
    for (const Eigen::Vector3d& p : polygon.rings[0]) {
      all.add(p);
      if (polygon.building >= 0) buildings[polygon.building].add(p);
    }
  }
  for (const auto& [building, box] : buildings) feet.add(box.low);
  const Eigen::Vector3d size = all.high - all.low, levels = feet.high - feet.low;
  if (size.y() < 2) return false;  // a single wall
  const bool roofs = net.y() > 0.15 * total && std::abs(net.z()) < 0.2 * net.y();
  const bool level = buildings.size() > 2 && levels.z() > 20 && levels.z() > 3 * levels.y();
  const bool flat = buildings.size() <= 2 && size.z() > 60 && size.z() > 5 * size.y() && size.x() > 5 * size.y();
  return roofs || level || flat;
}

PolygonModel readObjFile(const std::string& path, const CityModelOptions& options) {
  PolygonModel model = readObj(path, options.y_up);
  model.turned = options.y_up;
  if (!model.turned && liesOnItsSide(model))
    model.remarks.push_back(path + " seems to lie on its side: if its y is up, give --up y");
  return model;
}

PolygonModel readFile(const std::string& path, const CityModelOptions& options) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error("cannot open " + path);
  std::string head(4096, '\0');
  file.read(head.data(), static_cast<std::streamsize>(head.size()));
  head.resize(static_cast<std::size_t>(file.gcount()));
  const std::size_t start = head.find_first_not_of(" \t\r\n\xEF\xBB\xBF");
  if (start == std::string::npos) throw NoModel(path + " is empty");
  if (head[start] == '<') return readCityGml(path, options.lod);
  if (head[start] == '{') return readCityJson(path, options.lod);
  if (head.rfind("\x1F\x8B", 0) == 0 || head.rfind("PK\x03\x04", 0) == 0)
    throw NoModel(path + " is packed: unpack it (gunzip, unzip)");
  std::string extension = fs::path(path).extension();
  std::transform(extension.begin(), extension.end(), extension.begin(), ::tolower);
  if (extension == ".obj") return readObjFile(path, options);
  throw NoModel(path + " is neither CityGML, nor CityJSON, nor OBJ");
}

/// The file; or those of a folder and the folders in it that by their names may be models, in order.
std::vector<std::string> filesOf(const std::string& path) {
  if (!fs::exists(path)) throw std::runtime_error("there is no " + path);
  if (!fs::is_directory(path)) return {path};
  std::vector<std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(path, fs::directory_options::skip_permission_denied)) {
    std::string e = entry.path().extension();
    std::transform(e.begin(), e.end(), e.begin(), ::tolower);
    const auto names = {".gml", ".xml", ".json", ".jsonl", ".obj", ".gz", ".zip"};
    if (entry.is_regular_file() && std::find(names.begin(), names.end(), e) != names.end())
      files.push_back(entry.path());
  }
  if (files.empty()) throw std::runtime_error("no .gml, .xml, .json, .jsonl or .obj file in " + path);
  std::sort(files.begin(), files.end());
  return files;
}

/// FNV-1a over millimetres (in degrees, over some centimetres), so that it does not depend on the last digit.
class Checksum {
 public:
  void add(double value) {
    const std::int64_t whole = std::llround(value * (std::abs(value) <= 360 ? 1e7 : 1e3));
    for (int i = 0; i < 8; ++i) sum_ = (sum_ ^ (static_cast<std::uint64_t>(whole) >> 8 * i & 255u)) * 1099511628211u;
  }
  std::uint64_t value() const { return sum_; }

 private:
  std::uint64_t sum_ = 14695981039346656037u;
};

std::string identityOf(const PolygonModel& model) {
  Checksum checksum;
  for (const Polygon& polygon : model.polygons)
    for (const Ring& ring : polygon.rings)
      for (const Eigen::Vector3d& p : ring)
        for (int i = 0; i < 3; ++i) checksum.add(p[i]);
  const Box box = bounds(model);
  return formatted("%zu buildings %zu polygons heights %.2f to %.2f checksum %016llx", model.building_ids.size(),
                   model.polygons.size(), box.low.z(), box.high.z(), static_cast<unsigned long long>(checksum.value()));
}

/// Files of one model, put together.
class Merger {
 public:
  Merger(const CityModelOptions& options, CityModel* result) : options_(options), result_(result) {}

  void add(const std::string& file, PolygonModel model) {
    all_.remarks.insert(all_.remarks.end(), model.remarks.begin(), model.remarks.end());
    model.remarks.clear();
    if (model.polygons.empty()) return;
    checkCoordinates(file, &model);
    forEachPoint(&model, [&](Eigen::Vector3d& p) { p += options_.offset; });
    const std::string& srs = options_.crs.empty() ? model.srs : options_.crs;
    CrsName name;
    if (!srs.empty()) {
      try {
        name = parseCrs(srs);
      } catch (const std::runtime_error& e) {
        throw std::runtime_error(file + ": " + e.what());
      }
      leaveOutStrays(file, &model);
      outside_ = std::max(outside_, normaliseAxes(file, name, &model, &result_->axis_order));
    }
    if (name.horizontal.empty() && options_.height_unit > 0 && options_.height_unit != 1)
      throw std::runtime_error(file +
                               " names no coordinate system: --height-unit would leave its plan in the file's unit; "
                               "convert it to metres, or give its system, like --crs EPSG:2263");
    const double unit = heightUnitOf(name, options_.height_unit, &height_remark_);
    checkUnity(file, srs, name, unit);
    result_->crs = name.horizontal;
    result_->height_unit = unit;
    result_->turned = result_->turned || model.turned;
    forEachPoint(&model, [&](Eigen::Vector3d& p) { p.z() = p.z() * unit + options_.height_offset; });
    const int first = static_cast<int>(all_.building_ids.size());
    for (Polygon& polygon : model.polygons) {
      if (polygon.building >= 0) polygon.building += first;
      all_.polygons.push_back(std::move(polygon));
    }
    all_.building_ids.insert(all_.building_ids.end(), model.building_ids.begin(), model.building_ids.end());
    all_.remarks.insert(all_.remarks.end(), model.remarks.begin(), model.remarks.end());
  }

  void pass(const std::string& remark) { all_.remarks.push_back(remark); }

  PolygonModel take() {
    if (outside_ > 0) all_.remarks.push_back(remarkOnArea(result_->crs, outside_));
    if (!height_remark_.empty()) all_.remarks.push_back(height_remark_);
    result_->identity = identityOf(all_);
    return std::move(all_);
  }

 private:
  /// That a file counts as those before it do.
  void checkUnity(const std::string& file, const std::string& srs, const CrsName& name, double unit) const {
    if (all_.polygons.empty()) return;
    if (name.horizontal != result_->crs)
      throw std::runtime_error(file + " is in " + (srs.empty() ? "no coordinate system" : name.horizontal) +
                               ", the files before it in " + (result_->crs.empty() ? "none" : result_->crs) +
                               ": convert them to one");
    if (unit != result_->height_unit)
      throw std::runtime_error(
          file +
          formatted(" counts heights in units of %.7f m, the files before it of %.7f m", unit, result_->height_unit) +
          ": give the one that holds, as --height-unit METRES");
  }

  const CityModelOptions& options_;
  CityModel* result_;
  PolygonModel all_;
  std::string height_remark_;
  double outside_ = 0;  ///< of the area of use, the file farthest off [km]
};

}  // namespace

PolygonModel readModelFiles(const std::string& path, const CityModelOptions& options, CityModel* result) {
  Merger merger(options, result);
  const bool folder = fs::is_directory(path);
  for (const std::string& file : filesOf(path)) {
    try {
      merger.add(file, readFile(file, options));
    } catch (const NoModel& e) {
      if (!folder) throw;
      merger.pass(std::string(e.what()) + ": passed over");
    }
  }
  PolygonModel all = merger.take();
  if (std::none_of(all.polygons.begin(), all.polygons.end(), [](const Polygon& p) { return p.building >= 0; })) {
    std::string passed;
    if (!all.remarks.empty()) passed = "; " + all.remarks.front();
    throw std::runtime_error(path + " has no buildings with walls (LoD1 to LoD3): a model of the facades is needed" +
                             passed);
  }
  return all;
}

}  // namespace streetview_localizer
