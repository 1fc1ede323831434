// rosrun air_ground simulate --world indoor_boxes_a --seed 1 --out scene.bag
// Renders both robots' sensors into a bag and writes the true mesh beside it.
#include <omp.h>
#include <unistd.h>

#include <filesystem>
#include <iostream>
#include <memory>

#include "air_ground_common/mesh.h"
#include "air_ground_sim/street/city.h"
#include "options.h"
#include "recorder.h"
#include "recording_files.h"

namespace {

namespace fs = std::filesystem;
using namespace air_ground_sim;

void renderCity(const SimConfig& config, const Options& o, const std::string& folder) {
  const Street street = planStreet(config.street, o.seed);
  if (!o.quiet)
    std::cerr << "city: " << street.buildings.size() << " buildings, " << street.panoramas.size() << " panoramas ..."
              << std::endl;
  std::unique_ptr<Progress> progress;
  writeCity(config, street, folder, [&](int, int all) {
    if (!progress) progress = std::make_unique<Progress>(all, o.quiet);
    progress->step();
  });
}

// Names of what is written.
struct Outputs {
  std::string bag, stem, city;

  Outputs(const Options& o, const SimConfig& config, const std::string& world_file) : bag(o.out) {
    if (!o.cache.empty()) {
      fs::create_directories(o.cache);
      bag = fs::path(o.cache) /
            (config.name + "_" + std::to_string(o.seed) + "_" + contentKey(world_file, config, o) + ".bag");
    }
    if (bag.empty()) throw std::invalid_argument("give --out FILE.bag or --cache DIR");
    if (fs::path(bag).extension() != ".bag") throw std::invalid_argument("--out must end in .bag");
    stem = bag.substr(0, bag.size() - 4);
    city = stem + ".city";
  }
};

std::unique_ptr<Recording> buildRecording(const SimConfig& config, const Options& o) {
  if (!o.quiet) std::cerr << "building world " << config.name << ", seed " << o.seed << " ..." << std::endl;
  auto recording = std::make_unique<Recording>(config, o.seed);
  if (!o.quiet)
    std::cerr << recording->scene().mesh().triangles.size() << " triangles, "
              << recording->scene().texelCount() / 1000000 << " million texels; flight "
              << recording->mav().pathLength(0, recording->duration()) << " m, drive "
              << (config.hasGroundRobot() ? recording->ground().pathLength(0, recording->duration()) : 0.0) << " m in "
              << recording->duration() << " s" << std::endl;
  return recording;
}

// Under a temporary name until complete: nobody reads half a bag.
void record(Recording* recording, const Options& o, const Outputs& out) {
  const std::string part = out.bag + "." + std::to_string(getpid()) + ".part";
  RecorderOptions recorder;
  recorder.mav = !o.no_mav;
  recorder.ground = !o.no_ground;
  recorder.lz4 = o.compression == "lz4";
  recorder.threads = o.threads;
  recorder.quiet = o.quiet;
  try {
    air_ground_common::writePly(out.stem + ".world.ply", recording->scene().mesh());
    if (recording->config().faults.any()) writeFaults(*recording, out.stem + ".faults.yaml");
    BagRecorder(recording, recorder, part).run();
    fs::rename(part, out.bag);
  } catch (...) {
    std::error_code ignored;
    fs::remove(part, ignored);
    throw;
  }
}

void simulate(Options o) {
  const std::string file = worldFile(o.world);
  SimConfig config = loadSimConfig(file);
  o.apply(&config);
  o.no_ground = o.no_ground || !config.hasGroundRobot();
  if (!config.hasCity() && (o.city_only || o.queries > 0))
    throw std::invalid_argument("--city-only and --queries need a street world");
  const Outputs out(o, config, file);
  if (o.threads > 0) omp_set_num_threads(o.threads);

  const auto isWanted = [&](bool asked, const std::string& path) {
    return asked && (o.cache.empty() || !fs::exists(path));
  };
  if (isWanted(config.hasCity() && !o.no_city, out.city + "/city.yaml")) renderCity(config, o, out.city);
  const bool queries = isWanted(o.queries > 0, out.city + "/queries_truth.csv"), bag = isWanted(!o.city_only, out.bag);
  if (queries || bag) {
    const auto recording = buildRecording(config, o);
    if (queries) writeQueries(recording.get(), o.queries, out.city);
    if (bag) record(recording.get(), o, out);
  }
  std::cout << (o.city_only ? out.city : out.bag) << std::endl;
}

}  // namespace

int main(int argc, char** argv) {
  Options o;
  CLI::App app{
      "Renders a simulated air-ground recording into a rosbag, with the true mesh beside it (x.world.ply).\n"
      "Same world, seed and options give the same messages."};
  addOptions(&app, &o);
  CLI11_PARSE(app, argc, argv);
  try {
    simulate(o);
    return 0;
  } catch (const std::exception& e) {
    std::cerr << "simulate: " << e.what() << std::endl;
    return 1;
  }
}
