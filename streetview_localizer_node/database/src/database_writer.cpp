#include <algorithm>
#include <filesystem>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>
#include <unordered_map>

#include "air_ground_common/text.h"
#include "footprint.h"
#include "geopackage.h"

namespace streetview_localizer {

namespace fs = std::filesystem;

namespace {

std::string partialName(const std::string& path) {
  fs::path p(path);
  return (p.parent_path() / (p.stem().string() + ".partial.gpkg")).string();
}

struct Column {
  const char* name;
  OGRFieldType type;
};

OGRLayer* createTable(GDALDataset* dataset, const char* name, OGRwkbGeometryType geometry, OGRSpatialReference* srs,
                      const std::vector<Column>& columns) {
  const char* options[] = {geometry == wkbNone ? nullptr : "SPATIAL_INDEX=YES", nullptr};
  OGRLayer* layer = dataset->CreateLayer(name, srs, geometry, const_cast<char**>(options));
  if (!layer) throw std::runtime_error(std::string("cannot create table ") + name + ": " + CPLGetLastErrorMsg());
  for (const Column& column : columns) {
    OGRFieldDefn field(column.name, column.type);
    if (layer->CreateField(&field) != OGRERR_NONE)
      throw std::runtime_error(std::string("cannot create column ") + column.name + ": " + CPLGetLastErrorMsg());
  }
  return layer;
}

/// The parts ("; " between) in which two lines of settings differ, empty where they say the same. Databases of before
/// say nothing from "model" on: any is right for them.
std::string differenceOf(const std::string& old, const std::string& now) {
  constexpr char kLater[] = "; model ";
  if (now.compare(0, old.size(), old) == 0 && now.compare(old.size(), sizeof(kLater) - 1, kLater) == 0) return "";
  const auto parts = [](const std::string& line) {
    std::vector<std::string> list(1);
    for (std::size_t i = 0; i < line.size(); ++i) {
      if (line.compare(i, 2, "; ") == 0) {
        list.emplace_back();
        ++i;
      } else {
        list.back() += line[i];
      }
    }
    return list;
  };
  const std::vector<std::string> before = parts(old), after = parts(now);
  std::string difference;
  for (std::size_t i = 0; i < std::max(before.size(), after.size()); ++i) {
    const std::string a = i < before.size() ? before[i] : "nothing", b = i < after.size() ? after[i] : "nothing";
    if (a != b) difference += (difference.empty() ? "" : "; ") + a + ", now " + b;
  }
  return difference;
}

std::vector<Column> withPose(std::vector<Column> columns, const std::vector<const char*>& names) {
  for (const char* name : names) columns.push_back({name, OFTReal});
  return columns;
}

}  // namespace

struct DatabaseWriter::Impl {
  std::string path, working;  // working: the file being written
  Dataset dataset{nullptr, &GDALClose};
  CityModel model;
  std::vector<Panorama> panoramas;
  std::unordered_map<std::string, GIntBig> row_of;
  std::unordered_map<std::string, int> views_of;          // -1: planned, not stored
  std::unordered_map<std::string, std::size_t> place_of;  // in panoramas
  bool in_transaction = false;

  [[noreturn]] void fail(const std::string& what) {
    const std::string reason = *CPLGetLastErrorMsg() ? CPLGetLastErrorMsg() : "the disk may be full";
    if (in_transaction) dataset->RollbackTransaction();
    in_transaction = false;
    throw std::runtime_error("cannot " + what + " in " + working + ": " + reason);
  }

  OGRLayer* table(const char* name) {
    OGRLayer* layer = dataset->GetLayerByName(name);
    if (!layer) throw std::runtime_error(working + " has no table " + name + ": delete it and start again");
    return layer;
  }

  // SQLite's own lock, kept from the first write until the file is closed: a second build of the same name is refused.
  void keepLocked() { trySql("PRAGMA locking_mode = EXCLUSIVE"); }

  // The same on a server, which lets go when the connection ends.
  void lockServer() {
    bool locked = false;
    if (OGRLayer* answer = dataset->ExecuteSQL(
            "SELECT pg_try_advisory_lock(hashtext('street_view_database'))::int AS locked", nullptr, nullptr)) {
      for (auto& row : *answer) locked = row->GetFieldAsInteger("locked") == 1;
      dataset->ReleaseResultSet(answer);
    }
    if (!locked) throw std::runtime_error("cannot write " + working + ": another program is writing it");
  }

  void begin() {
    if (dataset->StartTransaction() != OGRERR_NONE) fail("start a transaction");
    in_transaction = true;
  }

  void commit() {
    if (dataset->CommitTransaction() != OGRERR_NONE) fail("store a panorama");
    in_transaction = false;
  }

  void setInfo(const std::string& key, const std::string& value) {
    OGRLayer* layer = table(kInfoTable);
    layer->ResetReading();
    for (auto& row : layer) {
      if (key != row->GetFieldAsString("key")) continue;
      row->SetField("value", value.c_str());
      if (layer->SetFeature(row.get()) != OGRERR_NONE) fail("write");
      return;
    }
    OGRFeature row(layer->GetLayerDefn());
    row.SetField("key", key.c_str());
    row.SetField("value", value.c_str());
    if (layer->CreateFeature(&row) != OGRERR_NONE) fail("write");
  }

  void createTables(const std::string& settings) {
    OGRSpatialReference srs;
    srs.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    if (model.crs.empty())
      srs.SetLocalCS("Undefined Cartesian SRS");
    else if (srs.SetFromUserInput(model.crs.c_str()) != OGRERR_NONE)
      throw std::runtime_error("GDAL knows no coordinate system " + model.crs);
    begin();
    createTable(dataset.get(), kInfoTable, wkbNone, nullptr, {{"key", OFTString}, {"value", OFTString}});
    createTable(dataset.get(), kPanoramaTable, wkbPoint25D, &srs,
                withPose({{"panorama_id", OFTString},
                          {"equirectangular", OFTInteger},
                          {"registered", OFTInteger},
                          {"position_stddev", OFTReal},
                          {"orientation_stddev", OFTReal},
                          {"remark", OFTString},
                          {"heading_deg", OFTReal},
                          {"views", OFTInteger},
                          {"features", OFTInteger}},
                         {"x", "y", "z", "qx", "qy", "qz", "qw", "geotag_x", "geotag_y", "geotag_z", "geotag_qx",
                          "geotag_qy", "geotag_qz", "geotag_qw"}));
    createTable(dataset.get(), kViewTable, wkbNone, nullptr, [] {
      auto columns = withPose(
          {{"panorama_fid", OFTInteger64}, {"panorama_id", OFTString}, {"width", OFTInteger}, {"height", OFTInteger}},
          {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "x", "y", "z", "qx", "qy", "qz", "qw"});
      columns.push_back({"features", OFTInteger});
      for (const char* name : {"image", "keypoints", "octaves", "descriptors", "points", "normals"})
        columns.push_back({name, OFTBinary});
      return columns;
    }());
    createTable(
        dataset.get(), kBuildingTable, wkbMultiPolygon, &srs,
        {{"building_id", OFTString}, {"vertices", OFTBinary}, {"triangles", OFTBinary}, {"surfaces", OFTBinary}});
    setInfo("version", std::to_string(kDatabaseVersion));
    setInfo("crs", model.crs);
    for (int i = 0; i < 3; ++i)
      setInfo(std::string("origin_") + "xyz"[i], air_ground_common::formatted("%.10f", model.origin[i]));
    setInfo("settings", settings);
    setInfo("complete", "0");
    writeModel();
    commit();
    const QuietGdal quiet;
    OGRLayer* unused = dataset->ExecuteSQL("CREATE INDEX views_of_panorama ON views (panorama_fid)", nullptr, nullptr);
    if (unused) dataset->ReleaseResultSet(unused);
  }

  void writeModel() {
    std::map<int, std::vector<int>> triangles_of;
    for (std::size_t i = 0; i < model.mesh.triangles.size(); ++i)
      triangles_of[model.building[i]].push_back(static_cast<int>(i));
    OGRLayer* layer = table(kBuildingTable);
    for (const auto& [building, list] : triangles_of) {
      OGRFeature row(layer->GetLayerDefn());
      std::unordered_map<int, std::int32_t> index;
      std::vector<float> vertices;
      std::vector<std::int32_t> triangles;
      std::vector<std::uint8_t> surfaces;
      for (const int t : list) {
        for (int k = 0; k < 3; ++k) {
          const int v = model.mesh.triangles[t][k];
          const auto inserted = index.emplace(v, static_cast<std::int32_t>(index.size()));
          if (inserted.second)
            vertices.insert(vertices.end(), model.mesh.vertices[v].data(), model.mesh.vertices[v].data() + 3);
          triangles.push_back(inserted.first->second);
        }
        surfaces.push_back(static_cast<std::uint8_t>(model.surface[t]));
      }
      if (building >= 0) {
        row.SetField("building_id", model.building_ids[building].c_str());
        row.SetGeometryDirectly(footprint(model, list).release());
      }
      setBlob(&row, "vertices", vertices);
      setBlob(&row, "triangles", triangles);
      setBlob(&row, "surfaces", surfaces);
      if (layer->CreateFeature(&row) != OGRERR_NONE) fail("store the city model");
    }
  }

  void note(const Panorama& panorama, GIntBig row, int views) {
    const auto [place, is_new] = place_of.emplace(panorama.id, panoramas.size());
    if (is_new)
      panoramas.push_back(panorama);
    else
      panoramas[place->second] = panorama;
    row_of[panorama.id] = row;
    views_of[panorama.id] = views;
  }

  void readExisting() {
    OGRLayer* layer = table(kPanoramaTable);
    layer->ResetReading();
    for (auto& row : layer) note(readPanorama(*row, working), row->GetFID(), row->GetFieldAsInteger("views"));
  }

  void resume(const std::string& settings) {
    checkVersion(dataset.get(), working);
    const std::string old = infoValue(dataset.get(), "settings");
    if (const std::string other = differenceOf(old, settings); !other.empty())
      throw std::runtime_error(working + " was made with other settings (" + other +
                               "): use those, or another output, or delete it");
    model = readStoredModel(dataset.get(), working);
    readExisting();
    setInfo("complete", "0");
  }

  // Writes or overwrites the row of a panorama; returns its id.
  GIntBig putPanorama(const Panorama& panorama, int views, int features) {
    OGRLayer* layer = table(kPanoramaTable);
    OGRFeature row(layer->GetLayerDefn());
    writePanorama(panorama, model, &row);
    row.SetField("views", views);
    row.SetField("features", features);
    const auto known = row_of.find(panorama.id);
    if (known != row_of.end()) {
      row.SetFID(known->second);
      if (layer->SetFeature(&row) != OGRERR_NONE) fail("store " + panorama.id);
    } else if (layer->CreateFeature(&row) != OGRERR_NONE) {
      fail("store " + panorama.id);
    }
    return row.GetFID();
  }

  void putView(const Panorama& panorama, GIntBig panorama_fid, const View& view) {
    OGRLayer* layer = table(kViewTable);
    OGRFeature row(layer->GetLayerDefn());
    row.SetField("panorama_fid", panorama_fid);
    row.SetField("panorama_id", panorama.id.c_str());
    row.SetField("width", view.camera.width);
    row.SetField("height", view.camera.height);
    const std::array<std::pair<const char*, double>, 9> camera = {{{"fx", view.camera.fx},
                                                                   {"fy", view.camera.fy},
                                                                   {"cx", view.camera.cx},
                                                                   {"cy", view.camera.cy},
                                                                   {"k1", view.camera.k1},
                                                                   {"k2", view.camera.k2},
                                                                   {"p1", view.camera.p1},
                                                                   {"p2", view.camera.p2},
                                                                   {"k3", view.camera.k3}}};
    for (const auto& [name, value] : camera) row.SetField(name, value);
    writePose(view.T_world_camera, "", &row);
    std::vector<std::uint8_t> encoded;
    if (!view.image.empty()) cv::imencode(".jpg", view.image, encoded, {cv::IMWRITE_JPEG_QUALITY, 92});
    setBlob(&row, "image", encoded);
    const std::size_t n = view.features.size();
    const cv::Mat& d = view.features.descriptors;
    if (view.points.size() != n || view.normals.size() != n ||
        (n > 0 && (d.rows != static_cast<int>(n) || d.cols != 128 || d.type() != CV_8U)))
      throw std::invalid_argument(
          "DatabaseWriter: lists of a view differ in length, or its descriptors are not 128 bytes");
    std::vector<float> keypoints, points, normals;
    std::vector<std::int32_t> octaves;
    for (std::size_t i = 0; i < n; ++i) {
      const cv::KeyPoint& k = view.features.keypoints[i];
      keypoints.insert(keypoints.end(), {k.pt.x, k.pt.y, k.size, k.angle, k.response});
      octaves.push_back(k.octave);
      points.insert(points.end(), view.points[i].data(), view.points[i].data() + 3);
      normals.insert(normals.end(), view.normals[i].data(), view.normals[i].data() + 3);
    }
    std::vector<std::uint8_t> descriptors;
    for (int i = 0; i < static_cast<int>(n); ++i) descriptors.insert(descriptors.end(), d.ptr(i), d.ptr(i) + 128);
    row.SetField("features", static_cast<int>(n));
    setBlob(&row, "keypoints", keypoints);
    setBlob(&row, "octaves", octaves);
    setBlob(&row, "descriptors", descriptors);
    setBlob(&row, "points", points);
    setBlob(&row, "normals", normals);
    if (layer->CreateFeature(&row) != OGRERR_NONE) fail("store " + panorama.id);
  }

  // A run of SQL whose failure does not matter (an index that is there already).
  void trySql(const std::string& sql) {
    if (OGRLayer* result = dataset->ExecuteSQL(sql.c_str(), nullptr, nullptr)) dataset->ReleaseResultSet(result);
  }
};

DatabaseWriter::DatabaseWriter(const std::string& path, const CityModel& model, const std::string& settings)
    : impl_(std::make_unique<Impl>()) {
  Impl& d = *impl_;
  d.path = path;
  GDALAllRegister();
  if (isServer(path)) {
    d.working = path;
    d.dataset = openDataset(path, true);
    d.lockServer();
    if (!infoValue(d.dataset.get(), "version").empty()) {
      d.resume(settings);
      return;
    }
  } else {
    d.working = partialName(path);
    const fs::path folder = fs::path(path).parent_path();
    if (!folder.empty() && !fs::is_directory(folder))
      throw std::runtime_error("there is no folder " + folder.string() + " for " + path);
    if (!fs::exists(d.working) && fs::exists(path)) {
      checkVersion(openDataset(path, false).get(), path);
      // Copied under a third name first, so that a half-written copy is never taken for a build to resume.
      const std::string copy = d.working + ".copy";
      std::error_code error;
      fs::copy_file(path, copy, fs::copy_options::overwrite_existing, error);
      if (!error) fs::rename(copy, d.working, error);
      if (error) throw std::runtime_error("cannot copy " + path + ": " + error.message());
    }
    if (fs::exists(d.working) && fs::file_size(d.working) > 0) {
      d.dataset = openUnfinished(d.working);
      const QuietGdal quiet;
      d.keepLocked();
      if (d.dataset->GetLayerByName(kInfoTable)) {
        d.resume(settings);
        return;
      }
      d.dataset.reset();
    }
    // A build killed before its first commit leaves no tables: nothing is lost by starting over.
    fs::remove(d.working);
    fs::remove(d.working + "-journal");
    const QuietGdal quiet;
    GDALDriver* driver = GetGDALDriverManager()->GetDriverByName("GPKG");
    if (!driver) throw std::runtime_error("this GDAL has no GeoPackage driver");
    d.dataset.reset(driver->Create(d.working.c_str(), 0, 0, 0, GDT_Unknown, nullptr));
    if (!d.dataset) throw std::runtime_error("cannot create " + d.working + ": " + CPLGetLastErrorMsg());
    d.keepLocked();
  }
  const QuietGdal quiet;
  d.model = model;
  d.createTables(settings);
}

DatabaseWriter::~DatabaseWriter() = default;

const CityModel& DatabaseWriter::model() const { return impl_->model; }
const std::vector<Panorama>& DatabaseWriter::panoramas() const { return impl_->panoramas; }

bool DatabaseWriter::has(const std::string& id) const { return viewsOf(id) >= 0; }

int DatabaseWriter::viewsOf(const std::string& id) const {
  const auto it = impl_->views_of.find(id);
  return it == impl_->views_of.end() ? -1 : it->second;
}

void DatabaseWriter::plan(const std::vector<Panorama>& panoramas) {
  Impl& d = *impl_;
  const QuietGdal quiet;
  d.begin();
  std::vector<std::pair<const Panorama*, GIntBig>> added;
  for (const Panorama& panorama : panoramas)
    if (!d.row_of.count(panorama.id)) added.emplace_back(&panorama, d.putPanorama(panorama, -1, 0));
  d.commit();
  for (const auto& [panorama, row] : added) d.note(*panorama, row, -1);
}

void DatabaseWriter::add(const Panorama& panorama, const std::vector<View>& views) {
  Impl& d = *impl_;
  if (has(panorama.id)) throw std::invalid_argument("DatabaseWriter: " + panorama.id + " is stored already");
  const QuietGdal quiet;
  int features = 0;
  for (const View& view : views) features += static_cast<int>(view.features.size());
  d.begin();
  GIntBig fid = 0;
  try {
    fid = d.putPanorama(panorama, static_cast<int>(views.size()), features);
    for (const View& view : views) d.putView(panorama, fid, view);
  } catch (...) {
    if (d.in_transaction) d.dataset->RollbackTransaction();
    d.in_transaction = false;
    throw;
  }
  d.commit();
  d.note(panorama, fid, static_cast<int>(views.size()));
}

void DatabaseWriter::finish() {
  Impl& d = *impl_;
  const QuietGdal quiet;
  if (!isServer(d.path)) {
    // An interrupted build may have left these for later.
    for (const char* table : {kPanoramaTable, kBuildingTable}) {
      d.trySql(std::string("SELECT CreateSpatialIndex('") + table + "','geom')");
      d.trySql(std::string("RECOMPUTE EXTENT ON ") + table);
    }
  }
  CPLErrorReset();
  d.setInfo("complete", "1");
  d.dataset->FlushCache();
  d.dataset.reset();
  if (CPLGetLastErrorType() >= CE_Failure)
    throw std::runtime_error("cannot finish " + d.working + ": " + CPLGetLastErrorMsg());
  if (!isServer(d.path) && std::rename(d.working.c_str(), d.path.c_str()) != 0)
    throw std::runtime_error("cannot rename " + d.working + " to " + d.path);
}

}  // namespace streetview_localizer
