#include "build_items.h"

#include <omp.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <set>
#include <stdexcept>

#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"
#include "streetview_localizer/plane_index.h"

namespace streetview_localizer {

namespace fs = std::filesystem;
using air_ground_common::CameraModel;
using air_ground_common::Pose;

namespace {

const char kCountAsModel[] =
    "; --poses are taken as the model's file counts: --up, --model-offset and --model-height-offset move them, too";

/// Image files of a folder by their names without extension: lists of Mapillary's or Street View's ids have none.
class Stems {
 public:
  /// The path of the image of this path without extension; empty, and `several` true, where there are several; empty
  /// where there is none.
  std::string find(const fs::path& wanted, bool* several) {
    const std::string folder = wanted.parent_path();
    const auto [entry, is_new] = folders_.emplace(folder, std::multimap<std::string, std::string>());
    auto& files = entry->second;
    if (is_new && fs::is_directory(folder))
      for (const auto& file : fs::directory_iterator(folder))
        if (isImage(file.path())) files.emplace(file.path().stem(), file.path());
    const auto [first, last] = files.equal_range(wanted.filename());
    *several = first != last && std::next(first) != last;
    return first == last || *several ? "" : first->second;
  }

 private:
  static bool isImage(const fs::path& path) {
    std::string e = path.extension();
    std::transform(e.begin(), e.end(), e.begin(), ::tolower);
    const auto names = {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".webp", ".bmp"};
    return std::find(names.begin(), names.end(), e) != names.end();
  }
  std::map<std::string, std::multimap<std::string, std::string>> folders_;
};

/// The model's vertices: a city has too many to look at all of them for each image.
PlaneIndex cornersOf(const CityModel& model) {
  std::vector<std::pair<Eigen::Vector2d, int>> corners;
  for (std::size_t i = 0; i < model.mesh.vertices.size(); ++i)
    corners.emplace_back(model.mesh.vertices[i].head<2>().cast<double>(), static_cast<int>(i));
  return PlaneIndex(corners);
}

class ImageList {
 public:
  ImageList(const BuildSettings& settings, const CityModel& model, const std::string& axis_order, BuildReport* report)
      : s_(settings), model_(model), axis_order_(axis_order), report_(*report), corners_(cornersOf(model)) {}

  std::vector<BuildItem> take() {
    if (!s_.poses.empty()) {
      for (const SurveyedImage& surveyed : readSurveyedImages(s_.poses)) {
        BuildItem item;
        if (taken() && accept(surveyed.image, &item)) addSurveyed(surveyed, &item);
      }
      return std::move(items_);
    }
    if (s_.geotags.empty() && s_.images.empty())
      throw std::invalid_argument("no images given: --geotags FILE, --images FOLDER (EXIF), or --poses FILE");
    requireCoordinateSystem(model_);
    for (const Geotag& geotag : s_.geotags.empty() ? readExif(s_.images) : readGeotags(s_.geotags)) {
      BuildItem item;
      if (!taken()) continue;
      if (!geotag.problem.empty()) {
        refuse(geotag.image, geotag.problem);
        continue;
      }
      if (accept(geotag.image, &item)) addGeotagged(geotag, &item);
    }
    remarkOnHeights();
    if (unmarked_ > 0)
      report_.image_remarks.push_back(std::to_string(unmarked_) +
                                      " images twice as wide as high are taken for full spheres, though they do not "
                                      "say so (GPano): of photographs give --camera FILE");
    return std::move(items_);
  }

 private:
  void refuse(const std::string& image, const std::string& reason) { report_.refused.push_back({image, reason}); }

  /// Whether the next image of the list is one of those to take.
  bool taken() {
    const int i = index_++ - s_.take_first;
    return i >= 0 && i % s_.take_every == 0;
  }

  fs::path folder() const {
    if (!s_.images.empty()) return s_.images;
    const fs::path beside = fs::path(s_.poses.empty() ? s_.geotags : s_.poses).parent_path();
    return beside.empty() ? "." : beside;
  }

  bool accept(const std::string& image, BuildItem* item) {
    fs::path name = image;
    bool several = false;
    if (!fs::is_regular_file(folder() / name))
      if (const std::string found = stems_.find(folder() / name, &several); !found.empty())
        name.replace_filename(fs::path(found).filename());
    item->path = (folder() / name).string();
    item->panorama.id = name.lexically_normal().generic_string();
    if (!ids_.insert(item->panorama.id).second) {
      refuse(image, "is listed twice");
      return false;
    }
    if (!fs::is_regular_file(item->path)) {
      refuse(image, several ? "is the name of several images in " + folder().string() + ": list it with its extension"
                            : "is missing: there is no " + item->path);
      return false;
    }
    return true;
  }

  /// From its header; empty, and refused, when the image cannot be read or would fill the memory.
  cv::Size usableSize(const BuildItem& item, const std::string& name) {
    constexpr double kMostPixels = 4e8;
    const cv::Size size = imageSize(item.path);
    if (size.empty()) refuse(name, "cannot be read as an image");
    if (1.0 * size.width * size.height <= kMostPixels) return size;
    refuse(name, "has " + std::to_string(size.width) + "x" + std::to_string(size.height) + " pixels: make it smaller");
    return {};
  }

  /// A pose that counts as the model's file does, after what the options do to the file (CityModelOptions); in its
  /// system, heights in metres.
  Pose movedAsModel(const Pose& T_file_camera) const {
    Pose T = T_file_camera;
    if (model_.turned) T = Eigen::AngleAxisd(M_PI / 2, Eigen::Vector3d::UnitX()) * T;
    const CityModelOptions& options = s_.model_options;
    T.translation() += options.offset;
    T.translation().z() = T.translation().z() * model_.height_unit + options.height_offset;
    return T;
  }

  void addSurveyed(const SurveyedImage& surveyed, BuildItem* item) {
    const cv::Size size = usableSize(*item, surveyed.image);
    if (size.empty()) return;
    CameraModel& c = item->camera;
    c.width = size.width, c.height = size.height;
    c.fx = surveyed.fx, c.fy = surveyed.fy, c.cx = surveyed.cx, c.cy = surveyed.cy;
    if (!c.contains({c.cx, c.cy}))
      return refuse(surveyed.image, "has a principal point outside its " + std::to_string(size.width) + "x" +
                                        std::to_string(size.height) + " pixels");
    Panorama& p = item->panorama;
    p.equirectangular = false;
    p.registered = true;
    p.position_stddev = s_.pose_stddev;
    p.orientation_stddev = s_.pose_angle_stddev;
    const Pose T_crs_camera = movedAsModel(surveyed.T_crs_camera);
    Pose T_world_camera = T_crs_camera;
    try {
      T_world_camera.translation() = model_.worldFromCrs(T_crs_camera.translation());
    } catch (const std::invalid_argument& e) {
      return refuse(surveyed.image, std::string(e.what()) + kCountAsModel);
    }
    if (const std::string reason = farAway(T_world_camera.translation()); !reason.empty())
      return refuse(surveyed.image, reason + kCountAsModel);
    // Grid north lies clockwise of the frame's true north by the convergence.
    if (model_.frame)
      T_world_camera.linear() =
          Eigen::AngleAxisd(-model_.frame->meridianConvergence(), Eigen::Vector3d::UnitZ()) * T_crs_camera.linear();
    p.T_world_panorama = T_world_camera;
    p.T_world_panorama.linear() = T_world_camera.linear() * air_ground_common::opticalFromForwardBody();
    p.T_world_geotag = p.T_world_panorama;
    items_.push_back(*item);
  }

  /// Whether a geotagged image is a sphere, or through which lens it was taken. False, and refused, where that is not
  /// known.
  bool findCamera(const std::string& image, const cv::Size& size, BuildItem* item) {
    const bool marked = marksSphere(item->path),
               fits = s_.camera && size == cv::Size(s_.camera->width, s_.camera->height);
    const std::optional<double> focal = exifFocalLength(item->path, size.width);
    bool& sphere = item->panorama.equirectangular;
    sphere = std::abs(size.width - 2.0 * size.height) <= 0.02 * size.width && (marked || (!fits && !focal));
    if (sphere) {
      unmarked_ += !marked;
      return true;
    }
    if (s_.camera && !fits) {
      refuse(image, "has another size than the camera");
      return false;
    }
    if (fits) {
      item->camera = *s_.camera;
    } else if (focal) {
      item->camera.width = size.width, item->camera.height = size.height;
      item->camera.fx = item->camera.fy = *focal;
      item->camera.cx = 0.5 * (size.width - 1), item->camera.cy = 0.5 * (size.height - 1);
    } else {
      refuse(image, "is no panorama (twice as wide as high) and its focal length is not known: give --camera FILE");
      return false;
    }
    return true;
  }

  std::optional<double> groundAt(const Eigen::Vector3d& place) {
    if (!ground_) ground_ = std::make_unique<PanoramaRegistrar>(model_, registrationOf(s_));
    return ground_->groundHeight(place);
  }

  /// Ellipsoidal heights, or those of another vertical datum, put all cameras equally far above or below the street.
  void remarkOnHeights() {
    constexpr std::size_t kAsked = 200;  // of the images, spread over the list
    constexpr double kFarOff = 5;        // no camera and no error of a good receiver [m]
    std::vector<double> above;
    for (std::size_t i = 0; i < with_height_.size(); i += 1 + with_height_.size() / kAsked)
      if (const auto ground = groundAt(with_height_[i]))
        above.push_back(with_height_[i].z() - *ground - s_.registration.camera_height);
    if (above.empty()) return;
    const double median = air_ground_common::median(std::move(above));
    if (std::abs(median) <= kFarOff) return;
    std::string remark = air_ground_common::formatted(
        "geotags lie %.0f m %s where the model's ground and --camera-height put them: if their heights are not in the "
        "model's vertical datum, give --geotag-height-offset %.0f",
        std::abs(median), median > 0 ? "above" : "below", s_.geotag_height_offset - median);
    // The correction would take them to the street.
    if (median > 0 && s_.registration.camera_height > 0)
      remark += "; if the cameras do stand so high (a drone, a mast), give --camera-height 0";
    report_.image_remarks.push_back(remark);
  }

  /// Of a geotag that has none, from the ground below it [m]; empty, and refused, where that is not known.
  std::optional<double> heightAt(const Geotag& geotag) {
    if (!(s_.registration.camera_height > 0)) {
      refuse(geotag.image, "has no height: give the camera's above the ground, as --camera-height");
      return std::nullopt;
    }
    const std::optional<double> ground = groundAt(worldPose(geotag, model_, s_.north).translation());
    if (!ground) {
      refuse(geotag.image, "has no height, and the model no ground there: give heights (alt)");
      return std::nullopt;
    }
    return *ground + s_.registration.camera_height;
  }

  /// Far from all buildings: empty, or a reason to refuse the image.
  std::string farAway(const Eigen::Vector3d& place) const {
    double nearest = std::numeric_limits<double>::infinity();
    for (const int i : corners_.nearest(place.head<2>(), 1))
      nearest = (model_.mesh.vertices[static_cast<std::size_t>(i)].cast<double>() - place).head<2>().norm();
    if (nearest <= 500) return "";
    return "lies " + std::to_string(std::lround(nearest / 1000)) + " km from the city model" +
           (axis_order_.empty() ? "" : ", whose coordinates were taken as " + axis_order_);
  }

  void addGeotagged(Geotag geotag, BuildItem* item) {
    const cv::Size size = usableSize(*item, geotag.image);
    if (size.empty()) return;
    if (const auto full = fullSphereSize(item->path))
      return refuse(geotag.image, "covers only part of the sphere (GPano): pad it to " + std::to_string(full->width) +
                                      "x" + std::to_string(full->height));
    const ExifOrientation orientation = exifOrientation(item->path);
    if (orientation.mirrored) return refuse(geotag.image, "is mirrored by its EXIF orientation: save it as it is seen");
    if (!findCamera(geotag.image, size, item)) return;
    if (!geotag.heading_known && !s_.register_panoramas)
      return refuse(geotag.image, "has no heading, which only the correction finds: do without --no-registration");
    item->heading_known = geotag.heading_known;
    geotag.roll += orientation.roll;
    if (geotag.height_known) geotag.position.height += s_.geotag_height_offset;
    Panorama& p = item->panorama;
    p.T_world_geotag = worldPose(geotag, model_, s_.north);
    if (const std::string reason = farAway(p.T_world_geotag.translation()); !reason.empty())
      return refuse(geotag.image, reason);
    if (geotag.height_known) {
      with_height_.push_back(p.T_world_geotag.translation());
    } else {
      const std::optional<double> height = heightAt(geotag);
      if (!height) return;
      p.T_world_geotag.translation().z() = *height;
    }
    placeAtGeotag(s_, item);
    items_.push_back(*item);
  }

  const BuildSettings& s_;
  const CityModel& model_;
  const std::string& axis_order_;
  BuildReport& report_;
  const PlaneIndex corners_;
  std::vector<BuildItem> items_;
  std::set<std::string> ids_;
  Stems stems_;
  std::unique_ptr<PanoramaRegistrar> ground_;  ///< made where a height is asked for
  std::vector<Eigen::Vector3d> with_height_;   ///< places of geotags that have one, in world
  int index_ = 0;                              ///< in the list
  int unmarked_ = 0;                           ///< spheres by their shape alone
};

}  // namespace

std::vector<BuildItem> listBuildItems(const BuildSettings& settings, const CityModel& model,
                                      const std::string& axis_order, BuildReport* report) {
  report->image_remarks.clear();
  return ImageList(settings, model, axis_order, report).take();
}

void placeAtGeotag(const BuildSettings& settings, BuildItem* item) {
  Panorama& p = item->panorama;
  p.T_world_panorama = p.T_world_geotag;
  const auto covariance = geotagCovariance(settings.registration, item->heading_known);
  p.position_stddev = std::sqrt(covariance.topLeftCorner<3, 3>().trace() / 3);
  p.orientation_stddev = std::sqrt(covariance.bottomRightCorner<3, 3>().trace() / 3);
}

cv::Mat readStored(const std::string& path, bool grey) {
  return cv::imread(path, (grey ? cv::IMREAD_GRAYSCALE : cv::IMREAD_COLOR) | cv::IMREAD_IGNORE_ORIENTATION);
}

RegistrationSettings registrationOf(const BuildSettings& settings) {
  RegistrationSettings registration = settings.registration;
  registration.threads = settings.threads > 0 ? settings.threads : omp_get_num_procs();
  return registration;
}

}  // namespace streetview_localizer
