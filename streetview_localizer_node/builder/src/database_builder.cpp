#include "streetview_localizer/database_builder.h"

#include <omp.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <mutex>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <set>
#include <sstream>
#include <stdexcept>

#include "air_ground_common/text.h"

namespace streetview_localizer {

namespace fs = std::filesystem;
using air_ground_common::CameraModel;
using air_ground_common::Pose;

std::string BuildSettings::fingerprint() const {
  std::ostringstream out;
  out << "views " << views.width << "x" << views.height << " fov " << views.horizontal_fov << " step " << views.yaw_step
      << " pitch";
  for (const double p : views.pitches) out << " " << p;
  out << "; sift " << features.max_features << " " << features.contrast_threshold << " " << features.edge_threshold
      << " " << features.double_image;
  out << "; rays " << back_projection.max_incidence << " " << back_projection.min_depth << " "
      << back_projection.max_depth << " " << back_projection.edge_distance << " " << back_projection.discontinuity
      << " " << back_projection.walls_only;
  out << "; consistency " << (check_consistency ? consistency.min_correlation : -1) << "; registered "
      << register_panoramas << keep_unregistered << "; north " << (north == North::kGrid ? "grid" : "true")
      << " height " << geotag_height_offset;
  if (register_panoramas) {
    const RegistrationSettings& r = registration;
    out << "; registration";
    for (const double value :
         {r.search_radius, r.search_yaw, r.geotag_stddev, r.heading_stddev, r.tilt_stddev, r.height_stddev,
          r.camera_height, r.camera_height_stddev, r.model_radius, r.model_lateral_stddev, r.model_height_stddev,
          r.roof_overhang, r.roof_overhang_stddev, r.max_position_stddev, r.max_orientation_stddev})
      out << " " << value;
  }
  if (camera) {
    out << "; camera " << camera->width << "x" << camera->height;
    for (const double value :
         {camera->fx, camera->fy, camera->cx, camera->cy, camera->k1, camera->k2, camera->p1, camera->p2, camera->k3})
      out << " " << value;
  }
  return out.str();
}

namespace {

struct Item {
  std::string path;
  Panorama panorama;
  CameraModel camera;    // of a photograph
  bool readable = true;  // as far as is known: pose correction reads it first
  bool known = false;    // to the database, from an earlier run
};

class Builder {
 public:
  Builder(const BuildSettings& settings, const std::function<void(const std::string&, int, int)>& progress)
      : s_(settings), progress_(progress) {}

  BuildReport build() {
    if (s_.output.empty()) throw std::invalid_argument("no output given");
    if (s_.take_every < 1 || s_.take_first < 0)
      throw std::invalid_argument("take_every must be at least 1, take_first at least 0");
    const CityModel model = readCityModel(s_.model, s_.model_options);
    report_.remarks = model.remarks;
    height_unit_ = model.height_unit;
    listImages(model);
    if (items_.empty()) throw std::runtime_error(nothingLeft());
    DatabaseWriter writer(s_.output, model, s_.fingerprint());
    // An existing database keeps its own model and frame.
    if (writer.model().crs != model.crs)
      throw std::runtime_error(s_.output + " is in " + writer.model().crs + ", the model in " + model.crs +
                               ": use the model it was made with");
    if ((writer.model().origin - model.origin).norm() > 1e-6) {
      items_.clear();
      report_.refused.clear();
      listImages(writer.model());
    }
    const BackProjector projector(writer.model(), s_.back_projection);
    place(&writer);
    storeViews(&writer, projector);
    if (writer.panoramas().empty()) throw std::runtime_error(nothingLeft());
    writer.finish();
    if (!s_.textured_model.empty()) {
      tell("texturing", 0, 1);
      DatabaseLoadOptions load;
      load.features = false;
      writeObj(makeTexturedModel(loadDatabase(s_.output, load), s_.texture), s_.textured_model);
      tell("texturing", 1, 1);
    }
    return report_;
  }

 private:
  std::string nothingLeft() const {
    std::string text = "no image can be used";
    if (!report_.refused.empty()) text += "; the first: " + report_.refused[0].image + " " + report_.refused[0].reason;
    return text;
  }

  void refuse(const std::string& image, const std::string& reason) { report_.refused.push_back({image, reason}); }

  // What is to be said of a stored image.
  void remark(const Panorama& panorama, bool used) {
    if (!panorama.remark.empty())
      (used ? report_.uncorrected : report_.refused).push_back({panorama.id, panorama.remark});
  }

  void tell(const std::string& stage, int done, int all) {
    if (progress_) progress_(stage, done, all);
  }

  std::string folder() const {
    if (!s_.images.empty()) return s_.images;
    return fs::path(s_.poses.empty() ? s_.geotags : s_.poses).parent_path();
  }

  void listImages(const CityModel& model) {
    std::set<std::string> ids;
    const auto accept = [&](const std::string& image, Item* item) {
      item->path = (fs::path(folder()) / image).string();
      item->panorama.id = fs::path(image).lexically_normal().generic_string();
      if (!ids.insert(item->panorama.id).second) {
        refuse(image, "is listed twice");
        return false;
      }
      if (!fs::is_regular_file(item->path)) {
        refuse(image, "is missing: there is no " + item->path);
        return false;
      }
      return true;
    };
    int index = 0;
    const auto taken = [&] {
      const int i = index++ - s_.take_first;
      return i >= 0 && i % s_.take_every == 0;
    };
    if (!s_.poses.empty()) {
      for (const SurveyedImage& surveyed : readSurveyedImages(s_.poses)) {
        Item item;
        if (taken() && accept(surveyed.image, &item)) addSurveyed(surveyed, model, &item);
      }
      return;
    }
    if (s_.geotags.empty() && s_.images.empty())
      throw std::invalid_argument("no images given: --geotags FILE, --images FOLDER (EXIF), or --poses FILE");
    requireCoordinateSystem(model);
    for (const Geotag& geotag : s_.geotags.empty() ? readExif(s_.images) : readGeotags(s_.geotags)) {
      Item item;
      if (!taken()) continue;
      if (!geotag.problem.empty()) {
        refuse(geotag.image, geotag.problem);
        continue;
      }
      if (accept(geotag.image, &item)) addGeotagged(geotag, model, &item);
    }
  }

  /// From its header; empty, and refused, when the image cannot be read or would fill the memory.
  cv::Size usableSize(const Item& item, const std::string& name) {
    constexpr double kMostPixels = 4e8;
    const cv::Size size = imageSize(item.path);
    if (size.empty()) refuse(name, "cannot be read as an image");
    if (1.0 * size.width * size.height <= kMostPixels) return size;
    refuse(name, "has " + std::to_string(size.width) + "x" + std::to_string(size.height) + " pixels: make it smaller");
    return {};
  }

  void addSurveyed(const SurveyedImage& surveyed, const CityModel& model, Item* item) {
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
    p.position_stddev = 0.02;  // bundle adjustment of good photographs
    p.orientation_stddev = 0.001;
    Pose T_world_camera = surveyed.T_crs_camera;
    Eigen::Vector3d place = surveyed.T_crs_camera.translation();
    place.z() *= height_unit_;
    try {
      T_world_camera.translation() = model.worldFromCrs(place);
    } catch (const std::invalid_argument& e) {
      return refuse(surveyed.image, e.what());
    }
    // Grid north lies clockwise of the frame's true north by the convergence.
    if (model.frame)
      T_world_camera.linear() = Eigen::AngleAxisd(-model.frame->meridianConvergence(), Eigen::Vector3d::UnitZ()) *
                                surveyed.T_crs_camera.linear();
    p.T_world_panorama = T_world_camera;
    p.T_world_panorama.linear() = T_world_camera.linear() * air_ground_common::opticalFromForwardBody();
    p.T_world_geotag = p.T_world_panorama;
    items_.push_back(*item);
  }

  void addGeotagged(Geotag geotag, const CityModel& model, Item* item) {
    const cv::Size size = usableSize(*item, geotag.image);
    if (size.empty()) return;
    if (const auto full = fullSphereSize(item->path))
      return refuse(geotag.image, "covers only part of the sphere (GPano): pad it to " + std::to_string(full->width) +
                                      "x" + std::to_string(full->height));
    Panorama& p = item->panorama;
    p.equirectangular = std::abs(size.width - 2.0 * size.height) <= 0.02 * size.width;
    if (!p.equirectangular) {
      if (s_.camera) {
        item->camera = *s_.camera;
        if (s_.camera->width != size.width || s_.camera->height != size.height)
          return refuse(geotag.image, "has another size than the camera");
      } else if (const auto focal = exifFocalLength(item->path, size.width)) {
        item->camera.width = size.width, item->camera.height = size.height;
        item->camera.fx = item->camera.fy = *focal;
        item->camera.cx = 0.5 * (size.width - 1), item->camera.cy = 0.5 * (size.height - 1);
      } else {
        return refuse(geotag.image,
                      "is no panorama (twice as wide as high) and its focal length is not known: give --camera FILE");
      }
    }
    geotag.position.height += s_.geotag_height_offset;
    p.T_world_geotag = worldPose(geotag, model, s_.north);
    p.T_world_panorama = p.T_world_geotag;
    double nearest = std::numeric_limits<double>::infinity();
    for (const auto& v : model.mesh.vertices)
      nearest = std::min(nearest, (v.cast<double>() - p.T_world_geotag.translation()).head<2>().norm());
    if (nearest > 500)
      return refuse(geotag.image, "lies " + std::to_string(std::lround(nearest / 1000)) + " km from the city model");
    items_.push_back(*item);
  }

  // Takes over what is stored of the images, also under their bare names, as databases had them once. An image whose
  // name stands for one at another place is refused: its pose would be that one's.
  void recall(const std::vector<Panorama>& stored) {
    constexpr double kSamePlace = 0.1;  // geotags are written to centimetres [m]
    std::map<std::string, const Panorama*> known;
    for (const Panorama& p : stored) known[p.id] = &p;
    std::vector<Item> kept;
    for (Item& item : items_) {
      const auto distance = [&](const Panorama& p) {
        return (p.T_world_geotag.translation() - item.panorama.T_world_geotag.translation()).norm();
      };
      auto it = known.find(item.panorama.id);
      if (it != known.end() && distance(*it->second) > kSamePlace) {
        refuse(item.panorama.id, air_ground_common::formatted("another image of this name is in the database, %.1f m "
                                                              "from here: list it with its folder, or rename it",
                                                              distance(*it->second)));
        continue;
      }
      if (it == known.end()) it = known.find(fs::path(item.panorama.id).filename());
      if (it != known.end() && distance(*it->second) <= kSamePlace) {
        item.panorama = *it->second;
        item.known = true;
        known.erase(it);  // it stands for one image
      }
      kept.push_back(std::move(item));
    }
    items_ = std::move(kept);
  }

  // Corrects the images of the first stage and notes their poses, so that an interrupted build finds them.
  void place(DatabaseWriter* writer) {
    recall(writer->panoramas());
    std::vector<Item*> open;
    for (Item& item : items_)
      if (!item.known) open.push_back(&item);
    constexpr std::size_t kBatch = 100;  // corrected poses that an interruption may lose
    for (std::size_t first = 0; first < open.size(); first += kBatch) {
      const std::vector<Item*> batch(open.begin() + first, open.begin() + std::min(open.size(), first + kBatch));
      if (s_.register_panoramas)
        correct(writer->model(), batch, static_cast<int>(first), static_cast<int>(open.size()));
      std::vector<Panorama> panoramas;
      for (const Item* item : batch)
        if (item->readable) panoramas.push_back(item->panorama);  // else the next run tries again
      writer->plan(panoramas);
    }
  }

  void correct(const CityModel& model, const std::vector<Item*>& batch, int before, int all) {
    std::vector<Item*> wanted;
    for (Item* item : batch)
      if (!item->panorama.registered) wanted.push_back(item);  // surveyed ones are
    if (wanted.empty()) return;
    RegistrationSettings settings = s_.registration;
    settings.threads = s_.threads > 0 ? s_.threads : omp_get_num_procs();
    const PanoramaRegistrar registrar(model, settings);
    std::vector<RegistrationInput> inputs;
    for (Item* item : wanted) {
      RegistrationInput input;
      input.load = [item] {
        cv::Mat image = cv::imread(item->path, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);
        item->readable = !image.empty();
        return image;
      };
      if (!item->panorama.equirectangular) input.camera = item->camera;
      input.T_world_geotag = item->panorama.T_world_geotag;
      inputs.push_back(std::move(input));
    }
    const auto results = registrar.registerPanoramas(
        inputs, [&](std::size_t done) { tell("correcting poses", before + static_cast<int>(done), all); });
    for (std::size_t i = 0; i < results.size(); ++i) {
      Panorama& p = wanted[i]->panorama;
      p.registered = results[i].accepted;
      p.T_world_panorama = results[i].T_world_panorama;
      p.position_stddev = results[i].position_stddev;
      p.orientation_stddev = results[i].orientation_stddev;
      p.remark = results[i].accepted ? "" : "pose not corrected: " + results[i].reason;
    }
  }

  bool usable(const Item& item) const {
    return item.readable && (item.panorama.registered || !s_.register_panoramas || s_.keep_unregistered);
  }

  void storeViews(DatabaseWriter* writer, const BackProjector& projector) {
    std::vector<ConsistencyImage> images;
    for (const Item& item : items_) {
      const bool panorama = item.panorama.equirectangular;
      images.push_back(
          {usable(item), panorama, item.camera, panorama ? item.panorama.T_world_panorama : cameraPose(item.panorama)});
    }
    const FacadeConsistency consistency(
        projector, images,
        [&](int i) { return cv::imread(items_[i].path, cv::IMREAD_GRAYSCALE | cv::IMREAD_IGNORE_ORIENTATION); },
        s_.consistency);
    int done = 0;
    std::string error;
    const int count = static_cast<int>(items_.size());
    const int threads = s_.threads > 0 ? s_.threads : omp_get_num_procs();
#pragma omp parallel for schedule(dynamic) num_threads(threads)
    for (int i = 0; i < count; ++i) {
      bool skip = false;
      {
        const std::lock_guard<std::mutex> lock(writer_mutex_);
        skip = !error.empty() || writer->has(items_[i].panorama.id);
        if (error.empty() && skip) {
          ++done;
          const Panorama& panorama = items_[i].panorama;
          const bool used = writer->viewsOf(panorama.id) > 0;
          if (used) ++report_.resumed;
          remark(panorama, used);
        }
      }
      if (skip) continue;
      try {
        storeOne(i, writer, projector, consistency);
      } catch (const std::exception& e) {
        const std::lock_guard<std::mutex> lock(writer_mutex_);
        if (error.empty()) error = e.what();
      }
      const std::lock_guard<std::mutex> lock(writer_mutex_);
      tell("cutting and extracting", ++done, count);
    }
    if (!error.empty()) throw std::runtime_error(error);
  }

  void storeOne(int index, DatabaseWriter* writer, const BackProjector& projector,
                const FacadeConsistency& consistency) {
    const Item& item = items_[index];
    Panorama panorama = item.panorama;
    std::vector<View> views;
    BackProjectionCounts counts;
    int inconsistent = 0;
    cv::Mat image;
    if (usable(item)) image = cv::imread(item.path, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);
    if (!item.readable || (usable(item) && image.empty())) {  // not stored, so that the next run tries again
      const std::lock_guard<std::mutex> lock(writer_mutex_);
      refuse(panorama.id, "cannot be read as an image");
      return;
    }
    if (usable(item)) {
      views = viewsOf(item, image);
      for (View& view : views) {
        cv::Mat grey;
        cv::cvtColor(view.image, grey, cv::COLOR_BGR2GRAY);
        view.features = extractFeatures(grey, s_.features);
        const BackProjectionCounts c = projector.apply(&view);
        counts.kept += c.kept, counts.sky += c.sky, counts.ground += c.ground, counts.range += c.range,
            counts.grazing += c.grazing, counts.edge += c.edge;
        if (s_.check_consistency) inconsistent += consistency.apply(index, &view);
      }
      views.erase(std::remove_if(views.begin(), views.end(), [](const View& v) { return v.features.size() == 0; }),
                  views.end());
      if (views.empty()) panorama.remark = "sees no facade of the model";
    }
    const std::lock_guard<std::mutex> lock(writer_mutex_);
    writer->add(panorama, views);
    remark(panorama, !views.empty());
    if (!views.empty()) ++report_.stored;
    report_.views += static_cast<int>(views.size());
    report_.inconsistent += inconsistent;
    BackProjectionCounts& r = report_.features;
    r.kept += counts.kept, r.sky += counts.sky, r.ground += counts.ground, r.range += counts.range,
        r.grazing += counts.grazing, r.edge += counts.edge;
  }

  static Pose cameraPose(const Panorama& photograph) {
    Pose T = photograph.T_world_panorama;
    T.linear() = photograph.T_world_panorama.linear() * air_ground_common::opticalFromForwardBody().transpose();
    return T;
  }

  std::vector<View> viewsOf(const Item& item, const cv::Mat& image) const {
    if (item.panorama.equirectangular) return cutPanorama(image, item.panorama.T_world_panorama, s_.views);
    View view;
    view.camera = item.camera;
    view.image = image;
    view.T_world_camera = cameraPose(item.panorama);
    return {view};
  }

  const BuildSettings& s_;
  std::function<void(const std::string&, int, int)> progress_;
  std::vector<Item> items_;
  double height_unit_ = 1;  ///< of the model's file, and so of surveyed poses [m]
  BuildReport report_;
  std::mutex writer_mutex_;  ///< of the writer, the report and the progress; a failed write throws out of it, which a
                             ///< critical section of OpenMP may not
};

}  // namespace

BuildReport buildDatabase(const BuildSettings& settings,
                          const std::function<void(const std::string&, int, int)>& progress) {
  return Builder(settings, progress).build();
}

}  // namespace streetview_localizer
