#include "streetview_localizer/database_builder.h"

#include <omp.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <mutex>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <stdexcept>
#include <system_error>

#include "air_ground_common/text.h"
#include "build_items.h"
#include "neighbour_stage.h"

namespace streetview_localizer {

namespace fs = std::filesystem;
using air_ground_common::Pose;

namespace {

constexpr double kWorthReducing = 0.8;  // a photograph that is hardly finer stays as it is

class Builder {
 public:
  Builder(const BuildSettings& settings, const std::function<void(const std::string&, int, int)>& progress,
          BuildReport* report)
      : s_(settings), progress_(progress), report_(*report) {}

  void build() {
    if (s_.output.empty()) throw std::invalid_argument("no output given");
    if (s_.take_every < 1 || s_.take_first < 0)
      throw std::invalid_argument("take_every must be at least 1, take_first at least 0");
    checkTexturedModel();
    const CityModel model = readCityModel(s_.model, s_.model_options);
    report_.remarks = model.remarks;
    listImages(model, model.axis_order);
    if (items_.empty()) throw std::runtime_error(nothingLeft());
    DatabaseWriter writer(s_.output, model, s_.fingerprint(model.identity));
    // An existing database keeps its own model and frame.
    if (writer.model().crs != model.crs)
      throw std::runtime_error(s_.output + " is in " + writer.model().crs + ", the model in " + model.crs +
                               ": use the model it was made with");
    if ((writer.model().origin - model.origin).norm() > 1e-6) {
      report_.refused.clear();
      CityModel stored = writer.model();
      stored.height_unit = model.height_unit, stored.turned = model.turned;
      listImages(stored, model.axis_order);
    }
    const BackProjector projector(writer.model(), s_.back_projection);
    place(&writer);
    compareNeighbours(
        s_, projector, [&](const BuildItem& item) { return writer.has(item.panorama.id); },
        [&](const std::string& stage, int done, int all) { tell(stage, done, all); }, &items_, &report_);
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
  }

 private:
  // Before hours of work: what stands there may be the survey's own.
  void checkTexturedModel() const {
    if (s_.textured_model.empty()) return;
    std::error_code absent;
    if (s_.textured_model == s_.model || fs::equivalent(s_.textured_model, s_.model, absent))
      throw std::invalid_argument("--textured-model " + s_.textured_model +
                                  " is the city model itself: give another path");
    refuseOtherFiles(s_.textured_model);
  }

  std::string nothingLeft() const {
    std::string text = "no image can be used";
    if (!report_.refused.empty()) text += "; the first: " + report_.refused[0].image + " " + report_.refused[0].reason;
    return text;
  }

  void refuse(const std::string& image, const std::string& reason) { report_.refused.push_back({image, reason}); }

  // What is to be said of a stored image.
  void remark(const Panorama& panorama, bool used) {
    if (panorama.remark.empty()) return;
    auto& list = !used ? report_.refused : panorama.registered ? report_.doubtful : report_.uncorrected;
    list.push_back({panorama.id, panorama.remark});
  }

  void listImages(const CityModel& model, const std::string& axis_order) {
    items_ = listBuildItems(s_, model, axis_order, &report_);
  }

  void tell(const std::string& stage, int done, int all) {
    if (progress_) progress_(stage, done, all);
  }

  // Takes over what is stored of the images, also under their bare names, as databases had them once. An image whose
  // name stands for one at another place is refused: its pose would be that one's.
  void recall(const std::vector<Panorama>& stored) {
    constexpr double kSamePlace = 0.1;  // geotags are written to centimetres [m]
    std::map<std::string, const Panorama*> known;
    for (const Panorama& p : stored) known[p.id] = &p;
    std::vector<BuildItem> kept;
    for (BuildItem& item : items_) {
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
    std::vector<BuildItem*> open;
    for (BuildItem& item : items_)
      if (!item.known) open.push_back(&item);
    const bool wanted = std::any_of(open.begin(), open.end(), [](const auto* i) { return !i->panorama.registered; });
    std::optional<PanoramaRegistrar> registrar;  // of a large model it takes a while to make
    if (s_.register_panoramas && wanted) registrar.emplace(writer->model(), registrationOf(s_));
    constexpr std::size_t kBatch = 100;  // corrected poses that an interruption may lose
    for (std::size_t first = 0; first < open.size(); first += kBatch) {
      const std::vector<BuildItem*> batch(open.begin() + first, open.begin() + std::min(open.size(), first + kBatch));
      if (registrar) correct(*registrar, batch, static_cast<int>(first), static_cast<int>(open.size()));
      std::vector<Panorama> panoramas;
      for (const BuildItem* item : batch)
        if (item->readable) panoramas.push_back(item->panorama);  // else the next run tries again
      writer->plan(panoramas);
    }
  }

  void correct(const PanoramaRegistrar& registrar, const std::vector<BuildItem*>& batch, int before, int all) {
    std::vector<BuildItem*> wanted;
    for (BuildItem* item : batch)
      if (!item->panorama.registered) wanted.push_back(item);  // surveyed ones are
    std::vector<RegistrationInput> inputs;
    for (BuildItem* item : wanted) {
      RegistrationInput input;
      input.load = [item] {
        cv::Mat image = readStored(item->path);
        item->readable = !image.empty();
        return image;
      };
      if (!item->panorama.equirectangular) input.camera = item->camera;
      input.T_world_geotag = item->panorama.T_world_geotag;
      input.heading_known = item->heading_known;
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

  /// A geotag without heading is of no use where it is not corrected.
  bool usable(const BuildItem& item) const {
    const bool trusted = item.heading_known && (!s_.register_panoramas || s_.keep_unregistered);
    return item.readable && (item.panorama.registered || trusted);
  }

  /// Whether the same piece of facade is found in it: the comparison seeks within decimetres. Corrected poses are that
  /// good unless a neighbour doubts it; others where they say so.
  bool comparable(const BuildItem& item) const {
    constexpr double kSurePosition = 0.5, kSureAngle = 0.02;  // [m], [rad]: as much again at 25 m
    const Panorama& p = item.panorama;
    const bool corrected = p.registered && p.remark.empty() && s_.poses.empty();
    return usable(item) && (corrected || (p.position_stddev <= kSurePosition && p.orientation_stddev <= kSureAngle));
  }

  void storeViews(DatabaseWriter* writer, const BackProjector& projector) {
    std::vector<ConsistencyImage> images;
    for (const BuildItem& item : items_) {
      const bool panorama = item.panorama.equirectangular;
      images.push_back({comparable(item), panorama, item.camera,
                        panorama ? item.panorama.T_world_panorama : cameraPose(item.panorama)});
    }
    const FacadeConsistency consistency(
        projector, images, [&](int i) { return readStored(items_[i].path, true); }, s_.consistency);
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
    const BuildItem& item = items_[index];
    Panorama panorama = item.panorama;
    std::vector<View> views;
    BackProjectionCounts counts;
    int inconsistent = 0;
    cv::Mat image;
    if (usable(item)) image = readStored(item.path);
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
        if (s_.check_consistency && comparable(item)) inconsistent += consistency.apply(index, &view);
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

  std::vector<View> viewsOf(const BuildItem& item, const cv::Mat& image) const {
    if (item.panorama.equirectangular) return cutPanorama(image, item.panorama.T_world_panorama, s_.views);
    View view;
    view.camera = item.camera;
    view.image = image;
    view.T_world_camera = cameraPose(item.panorama);
    // Finer detail matches nothing that an image from the air shows, and fills the memory.
    if (const double factor = s_.photograph_focal / view.camera.fx; factor < kWorthReducing) {
      cv::resize(image, view.image, {}, factor, factor, cv::INTER_AREA);
      view.camera = view.camera.scaled(factor);
      view.camera.width = view.image.cols, view.camera.height = view.image.rows;
    }
    return {view};
  }

  const BuildSettings& s_;
  std::function<void(const std::string&, int, int)> progress_;
  std::vector<BuildItem> items_;
  BuildReport& report_;
  std::mutex writer_mutex_;  ///< of the writer, the report and the progress; a failed write throws out of it, which a
                             ///< critical section of OpenMP may not
};

}  // namespace

BuildReport buildDatabase(const BuildSettings& settings,
                          const std::function<void(const std::string&, int, int)>& progress) {
  BuildReport report;
  buildDatabase(settings, progress, &report);
  return report;
}

void buildDatabase(const BuildSettings& settings, const std::function<void(const std::string&, int, int)>& progress,
                   BuildReport* report) {
  *report = BuildReport();
  Builder(settings, progress, report).build();
}

}  // namespace streetview_localizer
