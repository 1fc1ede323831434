// The Street View database: panoramas, their views with features on facades, and the city model, in one GeoPackage.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "streetview_localizer/city_model.h"
#include "streetview_localizer/plane_index.h"
#include "streetview_localizer/types.h"

namespace streetview_localizer {

constexpr int kDatabaseVersion = 1;

/// The database in memory.
struct StreetviewDatabase {
  std::string crs;                                   ///< as CityModel::crs; empty for a local frame
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  ///< of world, in crs
  std::vector<Panorama> panoramas;
  std::vector<View> views;  ///< grouped by panorama; View::panorama and View::id are indices
  CityModel model;
  int version = kDatabaseVersion;

  /// Indices of the views of a panorama. Throws std::out_of_range.
  const std::vector<int>& viewsOf(int panorama) const;

  /// Indices of the panoramas within `radius` [m] in plan of a place in world, nearest first.
  std::vector<int> near(const Eigen::Vector3d& position, double radius) const;
  /// The `count` nearest panoramas in plan, nearest first.
  std::vector<int> nearest(const Eigen::Vector3d& position, int count) const;

  /// Builds what viewsOf(), near() and nearest() use; loadDatabase() calls it. Call again after a change.
  void buildIndex();

 private:
  std::optional<PlaneIndex> index_;
  std::vector<std::vector<int>> views_of_;
};

struct DatabaseLoadOptions {
  bool images = true;    ///< decode the views' images (colour); false: View::image stays empty, much less memory
  bool features = true;  ///< read features, points and normals
  /// Only panoramas within `radius` of this place, given in the database's crs: answered by the file's spatial index.
  std::optional<Eigen::Vector2d> centre;
  double radius = 200;  ///< [m]
  /// What images, features and the search index over these may take [bytes]; 0 = the memory that the machine has free.
  std::uint64_t memory = 0;
};

/// True for "PG:...", a PostGIS database, false for a file.
bool isServer(const std::string& path);

/// Where the search index of (this part of) a database is kept: beside the file; empty for a server.
std::string indexFileOf(const std::string& path, const DatabaseLoadOptions& options = {});

/// Reads a GeoPackage file or, given "PG:..." , a PostGIS database. The city model is read whole. Throws
/// std::runtime_error with one line for a missing or truncated file, another version, a file that is no Street View
/// database, or a place without panoramas.
StreetviewDatabase loadDatabase(const std::string& path, const DatabaseLoadOptions& options = {});

/// Writes a database panorama by panorama. A file appears under its own name only with finish(); until then it grows as
/// `<name>.partial.gpkg`, one transaction a panorama, so that a killed build loses at most one panorama and a new
/// writer goes on from there. A finished file is added to through a copy. On a server the tables grow in place, under
/// an advisory lock, and cannot be loaded before finish().
class DatabaseWriter {
 public:
  /// Starts, resumes or extends `path`. `settings`: one line that names all that shapes the contents; a resumed or
  /// extended database must have been made with the same. `model`: stored at the start; of an existing database, that
  /// file's model is kept. Throws std::runtime_error with one line.
  DatabaseWriter(const std::string& path, const CityModel& model, const std::string& settings);
  ~DatabaseWriter();

  /// Notes the poses of panoramas whose views are still to come, in one transaction; known ones are left as they are.
  void plan(const std::vector<Panorama>& panoramas);
  /// All panoramas noted or stored so far.
  const std::vector<Panorama>& panoramas() const;
  /// True when the panorama is stored with its views.
  bool has(const std::string& panorama_id) const;
  /// How many views were stored with it; -1 when it is not stored.
  int viewsOf(const std::string& panorama_id) const;
  /// Stores a panorama and its views (none, if it could not be placed) in one transaction. View::panorama and View::id
  /// are ignored. Throws std::runtime_error when the disk refuses; what was stored before stays.
  void add(const Panorama& panorama, const std::vector<View>& views);
  /// The model that the database holds; what to cast onto when adding to an existing one.
  const CityModel& model() const;
  /// Closes the file and gives it its name.
  void finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace streetview_localizer
