// The tables of the database and what reader and writer share.
#pragma once

#include <ogrsf_frmts.h>

#include <memory>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "streetview_localizer/database.h"

namespace streetview_localizer {

// panoramas: points in the database's system. views: one row an image, linked by panorama_fid. buildings: footprints,
// with the 3D mesh in blobs; the row without geometry and id is the terrain. street_view_database: keys and values.
constexpr char kPanoramaTable[] = "panoramas";
constexpr char kViewTable[] = "views";
constexpr char kBuildingTable[] = "buildings";
constexpr char kInfoTable[] = "street_view_database";

/// Silences GDAL's own messages while it lives; the last one is in CPLGetLastErrorMsg().
struct QuietGdal {
  QuietGdal() {
    CPLPushErrorHandler(CPLQuietErrorHandler);
    CPLErrorReset();
  }
  ~QuietGdal() { CPLPopErrorHandler(); }
  QuietGdal(const QuietGdal&) = delete;
};

/// GDAL's last error as one line: the servers' messages have several.
std::string lastGdalError();

using Dataset = std::unique_ptr<GDALDataset, decltype(&GDALClose)>;
/// Throws std::runtime_error with one line.
Dataset openDataset(const std::string& path, bool update);
/// For update, a file that a killed build may have left: SQLite takes half a commit back, so its length is not checked.
/// Throws std::runtime_error that says what to do.
Dataset openUnfinished(const std::string& path);

/// Value of a key of the information table; empty if absent.
std::string infoValue(GDALDataset* dataset, const std::string& key);

/// Pose from seven columns, <prefix>x ... <prefix>qw. Throws std::runtime_error with `path` unless it is a rigid
/// transform.
air_ground_common::Pose readPose(OGRFeature& row, const std::string& prefix, const std::string& path);

/// Throws std::runtime_error unless the dataset is a Street View database of this version.
void checkVersion(GDALDataset* dataset, const std::string& path);

/// Reads crs, origin, frame and the mesh.
CityModel readStoredModel(GDALDataset* dataset, const std::string& path);

Panorama readPanorama(OGRFeature& row, const std::string& path);
void writePanorama(const Panorama& panorama, const CityModel& model, OGRFeature* row);

/// Seven columns, <prefix>x ... <prefix>qw.
void writePose(const air_ground_common::Pose& T, const std::string& prefix, OGRFeature* row);

/// Blobs are little-endian arrays.
template <typename T>
void setBlob(OGRFeature* row, const char* field, const std::vector<T>& values) {
  row->SetField(row->GetFieldIndex(field), static_cast<int>(values.size() * sizeof(T)),
                static_cast<const void*>(values.data()));
}

template <typename T>
std::vector<T> blob(OGRFeature& row, const char* field) {
  int bytes = 0;
  const GByte* data = row.GetFieldAsBinary(row.GetFieldIndex(field), &bytes);
  std::vector<T> values(static_cast<std::size_t>(bytes) / sizeof(T));
  if (!values.empty()) std::copy(data, data + values.size() * sizeof(T), reinterpret_cast<GByte*>(values.data()));
  return values;
}

}  // namespace streetview_localizer
