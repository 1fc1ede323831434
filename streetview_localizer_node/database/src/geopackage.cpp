#include "geopackage.h"

#include <array>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <stdexcept>

namespace streetview_localizer {

using air_ground_common::Pose;

namespace {

// SQLite's header tells how long the file ought to be (fields at 16 and 28, sqlite.org/fileformat2.html).
void checkFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file)
    throw std::runtime_error("cannot open " + path + (std::filesystem::exists(path) ? "" : ": there is no such file"));
  std::array<unsigned char, 100> h{};
  file.read(reinterpret_cast<char*>(h.data()), h.size());
  if (file.gcount() < static_cast<std::streamsize>(h.size()) ||
      std::string(h.begin(), h.begin() + 15) != "SQLite format 3")
    throw std::runtime_error(path +
                             " is no Street View database (not a GeoPackage): build one with build_streetview_db");
  const std::uint64_t page = h[16] == 0 && h[17] == 1 ? 65536 : (std::uint64_t{h[16]} << 8 | h[17]);
  const std::uint64_t pages =
      std::uint64_t{h[28]} << 24 | std::uint64_t{h[29]} << 16 | std::uint64_t{h[30]} << 8 | h[31];
  const std::uint64_t size = std::filesystem::file_size(path);
  if (size < page * pages)
    throw std::runtime_error(path + " is truncated (" + std::to_string(size) + " of " + std::to_string(page * pages) +
                             " bytes): copy or build it again");
}

Dataset openAny(const std::string& path, bool update) {
  // The list names both drivers, so that GDAL does not guess by the file's extension.
  const char* drivers[] = {"GPKG", "PostgreSQL", nullptr};
  return Dataset(GDALDataset::Open(path.c_str(), GDAL_OF_VECTOR | (update ? GDAL_OF_UPDATE : 0), drivers), &GDALClose);
}

}  // namespace

bool isServer(const std::string& path) { return path.rfind("PG:", 0) == 0; }

std::string lastGdalError() {
  std::string text = CPLGetLastErrorMsg();
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back()))) text.pop_back();
  for (char& c : text)
    if (c == '\n' || c == '\t') c = ' ';
  return text;
}

Pose readPose(OGRFeature& row, const std::string& prefix, const std::string& path) {
  const auto value = [&](const char* name) { return row.GetFieldAsDouble((prefix + name).c_str()); };
  const Eigen::Quaterniond q(value("qw"), value("qx"), value("qy"), value("qz"));
  Pose T = Pose::Identity();
  T.translation() << value("x"), value("y"), value("z");
  T.linear() = q.normalized().toRotationMatrix();
  if (!(std::abs(q.norm() - 1) < 1e-3) || !air_ground_common::isValid(T))
    throw std::runtime_error(path + " holds a broken pose: build it again");
  return T;
}

void writePose(const Pose& T, const std::string& prefix, OGRFeature* row) {
  const Eigen::Quaterniond q(T.linear());
  const std::array<std::pair<const char*, double>, 7> values = {{{"x", T.translation().x()},
                                                                 {"y", T.translation().y()},
                                                                 {"z", T.translation().z()},
                                                                 {"qx", q.x()},
                                                                 {"qy", q.y()},
                                                                 {"qz", q.z()},
                                                                 {"qw", q.w()}}};
  for (const auto& [name, value] : values) row->SetField((prefix + name).c_str(), value);
}

Dataset openDataset(const std::string& path, bool update) {
  GDALAllRegister();
  if (!isServer(path)) checkFile(path);
  const QuietGdal quiet;
  Dataset dataset = openAny(path, update);
  if (!dataset) throw std::runtime_error("cannot open " + path + " as a database: " + lastGdalError());
  return dataset;
}

Dataset openUnfinished(const std::string& path) {
  GDALAllRegister();
  const QuietGdal quiet;
  Dataset dataset = openAny(path, true);
  // GDAL opens some files that SQLite cannot read; a query tells.
  OGRLayer* tables = dataset ? dataset->ExecuteSQL("SELECT count(*) FROM sqlite_master", nullptr, nullptr) : nullptr;
  const bool readable = tables && CPLGetLastErrorType() < CE_Failure;
  const std::string reason = CPLGetLastErrorMsg();
  if (tables) dataset->ReleaseResultSet(tables);
  if (readable) return dataset;
  if (reason.find("locked") != std::string::npos)
    throw std::runtime_error("cannot resume " + path + ": another program is writing it (" + reason + ")");
  throw std::runtime_error("cannot resume " + path + ": " + reason + "; delete it to start over");
}

std::string infoValue(GDALDataset* dataset, const std::string& key) {
  const QuietGdal quiet;
  OGRLayer* layer = dataset->GetLayerByName(kInfoTable);
  if (!layer) return "";
  layer->SetAttributeFilter(nullptr);
  layer->ResetReading();
  for (auto& row : layer)
    if (key == row->GetFieldAsString("key")) return row->GetFieldAsString("value");
  return "";
}

void checkVersion(GDALDataset* dataset, const std::string& path) {
  const std::string version = infoValue(dataset, "version");
  if (version.empty())
    throw std::runtime_error(path + " is no Street View database (it has no table " + kInfoTable +
                             "): build one with build_streetview_db");
  if (version != std::to_string(kDatabaseVersion))
    throw std::runtime_error(path + " has database version " + version + ", this program reads version " +
                             std::to_string(kDatabaseVersion) + ": build it again");
}

CityModel readStoredModel(GDALDataset* dataset, const std::string& path) {
  CityModel model;
  model.crs = infoValue(dataset, "crs");
  for (int i = 0; i < 3; ++i)
    model.origin[i] = std::atof(infoValue(dataset, std::string("origin_") + "xyz"[i]).c_str());
  if (!model.crs.empty()) {
    try {
      model.frame = std::make_shared<air_ground_common::LocalFrame>(model.crs, model.origin);
    } catch (const std::invalid_argument& e) {
      throw std::runtime_error(path + ": " + e.what());
    }
  }
  const QuietGdal quiet;
  OGRLayer* layer = dataset->GetLayerByName(kBuildingTable);
  if (!layer) throw std::runtime_error(path + " has no table " + kBuildingTable + ": build it again");
  layer->ResetReading();
  for (auto& row : layer) {
    const auto vertices = blob<float>(*row, "vertices");
    const auto triangles = blob<std::int32_t>(*row, "triangles");
    const auto surfaces = blob<std::uint8_t>(*row, "surfaces");
    const int count = static_cast<int>(vertices.size() / 3);
    if (vertices.size() % 3 != 0 || triangles.size() != 3 * surfaces.size())
      throw std::runtime_error(path + " holds a broken building: build it again");
    const int first = static_cast<int>(model.mesh.vertices.size());
    for (std::size_t i = 0; i + 2 < vertices.size(); i += 3)
      model.mesh.vertices.emplace_back(vertices[i], vertices[i + 1], vertices[i + 2]);
    const std::string id = row->GetFieldAsString("building_id");
    int building = -1;
    if (row->GetGeometryRef()) {
      building = static_cast<int>(model.building_ids.size());
      model.building_ids.push_back(id);
    }
    for (std::size_t i = 0; i < surfaces.size(); ++i) {
      Eigen::Vector3i t(triangles[3 * i], triangles[3 * i + 1], triangles[3 * i + 2]);
      if (t.minCoeff() < 0 || t.maxCoeff() >= count || surfaces[i] > 3)
        throw std::runtime_error(path + " holds a broken building: build it again");
      model.mesh.triangles.push_back(t + Eigen::Vector3i::Constant(first));
      model.surface.push_back(static_cast<Surface>(surfaces[i]));
      model.building.push_back(building);
    }
  }
  if (CPLGetLastErrorType() >= CE_Failure) throw std::runtime_error(path + " cannot be read: " + CPLGetLastErrorMsg());
  return model;
}

Panorama readPanorama(OGRFeature& row, const std::string& path) {
  Panorama p;
  p.id = row.GetFieldAsString("panorama_id");
  p.equirectangular = row.GetFieldAsInteger("equirectangular") != 0;
  p.registered = row.GetFieldAsInteger("registered") != 0;
  p.position_stddev = row.GetFieldAsDouble("position_stddev");
  p.orientation_stddev = row.GetFieldAsDouble("orientation_stddev");
  p.remark = row.GetFieldAsString("remark");
  p.T_world_panorama = readPose(row, "", path);
  p.T_world_geotag = readPose(row, "geotag_", path);
  return p;
}

void writePanorama(const Panorama& p, const CityModel& model, OGRFeature* row) {
  row->SetField("panorama_id", p.id.c_str());
  row->SetField("equirectangular", p.equirectangular ? 1 : 0);
  row->SetField("registered", p.registered ? 1 : 0);
  row->SetField("position_stddev", p.position_stddev);
  row->SetField("orientation_stddev", p.orientation_stddev);
  row->SetField("remark", p.remark.c_str());
  const double heading = 90 - air_ground_common::yawOf(p.T_world_panorama.linear()) * 180 / M_PI;
  row->SetField("heading_deg", heading < 0 ? heading + 360 : heading);
  writePose(p.T_world_panorama, "", row);
  writePose(p.T_world_geotag, "geotag_", row);
  const Eigen::Vector3d c = model.crsFromWorld(p.T_world_panorama.translation());
  OGRPoint point(c.x(), c.y(), c.z());
  row->SetGeometry(&point);
}

}  // namespace streetview_localizer
