#include "streetview_localizer/database.h"

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <limits>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>

#include "air_ground_common/encoded_image.h"
#include "air_ground_common/text.h"
#include "geopackage.h"

namespace streetview_localizer {

void StreetviewDatabase::buildIndex() {
  std::vector<std::pair<Eigen::Vector2d, int>> entries;
  for (std::size_t i = 0; i < panoramas.size(); ++i)
    entries.emplace_back(panoramas[i].T_world_panorama.translation().head<2>(), static_cast<int>(i));
  index_.emplace(entries);
  views_of_.assign(panoramas.size(), {});
  for (std::size_t i = 0; i < views.size(); ++i)
    views_of_.at(static_cast<std::size_t>(views[i].panorama)).push_back(static_cast<int>(i));
}

const std::vector<int>& StreetviewDatabase::viewsOf(int panorama) const {
  return views_of_.at(static_cast<std::size_t>(panorama));
}

std::vector<int> StreetviewDatabase::nearest(const Eigen::Vector3d& position, int count) const {
  if (!index_ || count <= 0) return {};
  std::vector<int> found = index_->nearest(position.head<2>(), static_cast<unsigned>(count));
  const auto distance = [&](int i) {
    return (panoramas[i].T_world_panorama.translation() - position).head<2>().norm();
  };
  std::sort(found.begin(), found.end(), [&](int a, int b) { return distance(a) < distance(b); });
  return found;
}

std::vector<int> StreetviewDatabase::near(const Eigen::Vector3d& position, double radius) const {
  std::vector<int> found;
  if (!index_) return found;
  const auto distance = [&](int i) {
    return (panoramas[i].T_world_panorama.translation() - position).head<2>().norm();
  };
  for (const int i : index_->inSquare(position.head<2>(), radius))
    if (distance(i) <= radius) found.push_back(i);
  std::sort(found.begin(), found.end(), [&](int a, int b) { return distance(a) < distance(b); });
  return found;
}

namespace {

using air_ground_common::formatted;

// One keypoint: x, y, size, angle, response.
constexpr std::size_t kKeypointFloats = 5;

View readView(OGRFeature& row, const std::string& path, const DatabaseLoadOptions& options) {
  View view;
  const auto real = [&](const char* name) { return row.GetFieldAsDouble(name); };
  view.camera.width = row.GetFieldAsInteger("width");
  view.camera.height = row.GetFieldAsInteger("height");
  view.camera.fx = real("fx"), view.camera.fy = real("fy"), view.camera.cx = real("cx"), view.camera.cy = real("cy");
  try {
    view.camera.setDistortion("plumb_bob", {real("k1"), real("k2"), real("p1"), real("p2"), real("k3")});
    view.camera.validate();
  } catch (const std::invalid_argument& e) {
    throw std::runtime_error(path + " holds a broken view (" + e.what() + "): build it again");
  }
  view.T_world_camera = readPose(row, "", path);
  if (options.images) {
    const auto encoded = blob<std::uint8_t>(row, "image");
    if (!encoded.empty()) {
      const cv::Size size(view.camera.width, view.camera.height);
      // Before it is decoded: a broken one may state any size.
      if (air_ground_common::encodedSize(encoded.data(), encoded.size()) == size)
        view.image = cv::imdecode(encoded, cv::IMREAD_COLOR);
      if (view.image.size() != size) throw std::runtime_error(path + " holds a broken view (image): build it again");
    }
  }
  if (!options.features) return view;
  const std::size_t n = static_cast<std::size_t>(row.GetFieldAsInteger("features"));
  const auto keypoints = blob<float>(row, "keypoints");
  const auto octaves = blob<std::int32_t>(row, "octaves");
  const auto descriptors = blob<std::uint8_t>(row, "descriptors");
  const auto points = blob<float>(row, "points");
  const auto normals = blob<float>(row, "normals");
  if (keypoints.size() != kKeypointFloats * n || octaves.size() != n || descriptors.size() != 128 * n ||
      points.size() != 3 * n || normals.size() != 3 * n)
    throw std::runtime_error(path + " holds a view whose lists do not fit together: build it again");
  view.features.descriptors.create(static_cast<int>(n), 128, CV_8U);
  if (n > 0) std::copy(descriptors.begin(), descriptors.end(), view.features.descriptors.data);
  view.features.keypoints.reserve(n);
  view.points.reserve(n);
  view.normals.reserve(n);
  for (std::size_t i = 0; i < n; ++i) {
    const float* k = &keypoints[kKeypointFloats * i];
    view.features.keypoints.emplace_back(k[0], k[1], k[2], k[3], k[4], octaves[i]);
    view.points.emplace_back(points[3 * i], points[3 * i + 1], points[3 * i + 2]);
    view.normals.emplace_back(normals[3 * i], normals[3 * i + 1], normals[3 * i + 2]);
  }
  return view;
}

}  // namespace

std::string indexFileOf(const std::string& path, const DatabaseLoadOptions& options) {
  if (isServer(path)) return "";
  if (!options.centre) return path + ".index";
  return path + formatted(".%.10g_%.10g_%.10g.index", options.centre->x(), options.centre->y(), options.radius);
}

namespace {

/// Reads the panoramas that the options choose: of each row's id its index, and how many views it must have.
std::map<GIntBig, int> readPanoramas(OGRLayer* layer, const std::string& path, const DatabaseLoadOptions& options,
                                     StreetviewDatabase* database, std::vector<int>* expected) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  if (options.centre) {
    const Eigen::Vector2d& c = *options.centre;
    double reach = options.radius * 1.02;  // the scale may differ so much within it
    if (database->model.frame && layer->GetSpatialRef() && layer->GetSpatialRef()->IsGeographic())
      reach /= 111000 * std::max(0.01, std::cos(c.y() * M_PI / 180));
    else if (database->model.frame)  // grids may count in feet
      reach *= air_ground_common::LocalFrame(database->crs, {c.x(), c.y(), 0}).gridScale();
    layer->SetSpatialFilterRect(c.x() - reach, c.y() - reach, c.x() + reach, c.y() + reach);
    centre = database->model.worldFromCrs({c.x(), c.y(), database->origin.z()});
  }
  std::map<GIntBig, int> index_of;
  layer->ResetReading();
  for (auto& row : layer) {
    Panorama panorama = readPanorama(*row, path);
    if (options.centre && (panorama.T_world_panorama.translation() - centre).head<2>().norm() > options.radius)
      continue;
    index_of[row->GetFID()] = static_cast<int>(database->panoramas.size());
    expected->push_back(row->GetFieldAsInteger("views"));
    database->panoramas.push_back(std::move(panorama));
  }
  if (options.centre && database->panoramas.empty())
    throw std::runtime_error(path + " has no panorama within " +
                             air_ground_common::formatted("%.10g m of %.10g, %.10g%s%s", options.radius,
                                                          options.centre->x(), options.centre->y(),
                                                          database->crs.empty() ? "" : " in ", database->crs.c_str()));
  return index_of;
}

/// Filters that bring the views of those panoramas alone, some at a time; one that brings all where all are wanted.
std::vector<std::string> viewFilters(const std::map<GIntBig, int>& index_of, bool all) {
  constexpr int kChunk = 200;  // ids in one query
  if (all) return {""};
  std::vector<std::string> filters;
  int count = 0;
  for (const auto& entry : index_of) {
    if (count++ % kChunk == 0)
      filters.push_back("panorama_fid IN (" + std::to_string(entry.first));
    else
      filters.back() += "," + std::to_string(entry.first);
  }
  for (std::string& filter : filters) filter += ")";
  return filters;
}

/// [bytes]; without end where the system does not say.
double freeMemory() {
  std::ifstream file("/proc/meminfo");
  std::string line;
  double kilobytes = 0;
  while (std::getline(file, line))
    if (std::sscanf(line.c_str(), "MemAvailable: %lf kB", &kilobytes) == 1) return 1024 * kilobytes;
  return std::numeric_limits<double>::infinity();
}

/// A process that outgrows the memory ends without a word. Features are read to be searched: what is built over them
/// counts, too.
void checkMemory(GDALDataset* dataset, const std::string& path, const std::vector<std::string>& filters,
                 const DatabaseLoadOptions& options) {
  // Over a feature: its descriptor twice more (in one matrix, in the graph), links, locks and tables of the graph.
  constexpr double kIndex = 520;                                                                 // [bytes]
  constexpr double kPixel = 3, kFeature = 128 + 7 * sizeof(float) + 6 * sizeof(float) + kIndex;  // [bytes]
  double needed = 0;
  for (const std::string& filter : filters) {
    const std::string sql = std::string("SELECT SUM(1.0 * width * height), SUM(1.0 * features) FROM ") + kViewTable +
                            (filter.empty() ? "" : " WHERE " + filter);
    OGRLayer* sums = dataset->ExecuteSQL(sql.c_str(), nullptr, nullptr);
    if (!sums) continue;
    for (auto& row : *sums)
      needed += (options.images ? kPixel * row->GetFieldAsDouble(0) : 0) +
                (options.features ? kFeature * row->GetFieldAsDouble(1) : 0);
    dataset->ReleaseResultSet(sums);
  }
  const double available = options.memory > 0 ? static_cast<double>(options.memory) : freeMemory();
  if (needed > available)
    throw std::runtime_error(path +
                             formatted(" needs %.3g GB of memory, and %.3g GB are free: load a part of it, by the "
                                       "parameters region/... of the node or --region of localize_images",
                                       needed / 1e9, available / 1e9));
}

}  // namespace

StreetviewDatabase loadDatabase(const std::string& path, const DatabaseLoadOptions& options) {
  const Dataset dataset = openDataset(path, false);
  checkVersion(dataset.get(), path);
  if (infoValue(dataset.get(), "complete") != "1")
    throw std::runtime_error(path + " was not finished: run the same build_streetview_db command again, it goes on");
  StreetviewDatabase database;
  database.model = readStoredModel(dataset.get(), path);
  database.crs = database.model.crs;
  database.origin = database.model.origin;

  const QuietGdal quiet;
  OGRLayer* layer = dataset->GetLayerByName(kPanoramaTable);
  OGRLayer* view_layer = dataset->GetLayerByName(kViewTable);
  if (!layer || !view_layer) throw std::runtime_error(path + " lacks a table: build it again");
  std::vector<int> expected;  // views that are still to come, by panorama
  const auto index_of = readPanoramas(layer, path, options, &database, &expected);
  const std::vector<std::string> filters = viewFilters(index_of, !options.centre);
  checkMemory(dataset.get(), path, filters, options);
  for (const std::string& filter : filters) {
    view_layer->SetAttributeFilter(filter.empty() ? nullptr : filter.c_str());
    view_layer->ResetReading();
    for (auto& row : view_layer) {
      const auto it = index_of.find(row->GetFieldAsInteger64("panorama_fid"));
      if (it == index_of.end()) continue;
      View view = readView(*row, path, options);
      view.panorama = it->second;
      --expected[static_cast<std::size_t>(view.panorama)];
      database.views.push_back(std::move(view));
    }
  }
  const bool lost = std::any_of(expected.begin(), expected.end(), [](int views) { return views > 0; });
  if (lost || CPLGetLastErrorType() >= CE_Failure)
    throw std::runtime_error(path + " is damaged (" + (lost ? "views are missing" : CPLGetLastErrorMsg()) +
                             "): build it again");
  std::stable_sort(database.views.begin(), database.views.end(),
                   [](const View& a, const View& b) { return a.panorama < b.panorama; });
  for (std::size_t i = 0; i < database.views.size(); ++i) database.views[i].id = static_cast<int>(i);
  database.buildIndex();
  return database;
}

}  // namespace streetview_localizer
