#include "options.h"

#include <map>
#include <stdexcept>

#include "air_ground_common/camera_file.h"

namespace air_ground_sim {

void FaultOptions::apply(FaultsConfig* f) const {
  if (all) *f = FaultsConfig::all();
  f->time_offset = time_offset.value_or(f->time_offset);
  f->readout_time = readout_time.value_or(f->readout_time);
  f->vibration = vibration.value_or(f->vibration);
  f->radial_error = radial_error.value_or(f->radial_error);
  f->focal_error = focal_error.value_or(f->focal_error);
  f->lost_images = lost_images.value_or(f->lost_images);
  f->clock_offset = clock_offset.value_or(f->clock_offset);
  f->depth_delay = depth_delay.value_or(f->depth_delay);
  if (!gyro_bias.empty()) f->gyro_bias = gyro_bias;
  if (!accel_bias.empty()) f->accel_bias = accel_bias;
  f->start_in_motion = f->start_in_motion || start_in_motion;
  f->jpeg_quality = jpeg_quality.value_or(f->jpeg_quality);
  f->tf_static = tf_static.value_or(f->tf_static);
  f->validate();
}

void Options::apply(SimConfig* config) const {
  if (duration > 0) config->flight.duration = duration;
  if (config->flight.duration < 6)
    throw std::invalid_argument("--duration must be at least 6 s: standing still and take-off need them");
  faults.apply(&config->faults);
  config->imu.ground_magnetometer = config->imu.ground_magnetometer || ground_mag;
  if (samples > 0) config->mav_camera.samples = config->ground_camera.samples = samples;
  if (!mav_camera.empty()) config->mav_camera.camera = air_ground_common::readCameraFile(mav_camera);
}

namespace {

void addFaultOptions(CLI::App* app, FaultOptions* f) {
  const std::map<std::string, StaticTransforms> modes = {{"latched", StaticTransforms::kLatched},
                                                         {"split", StaticTransforms::kSplit},
                                                         {"publishers", StaticTransforms::kPublishers}};
  const std::string group = "Faults (section `faults` of a world file; what is used is written to x.faults.yaml)";
  app->add_option_function<std::string>(
         "--faults", [f](const std::string&) { f->all = true; },
         "all: time offset 0.02 s, readout 0.02 s, vibration 1 m/s^2, biases of 0.08 rad/s and 0.3 m/s^2, start in\n"
         "motion, JPEG 80 at once; an option beside it replaces its value")
      ->check(CLI::IsMember({"all"}))
      ->group(group);
  app->add_option(
         "--time-offset", f->time_offset,
         "stamps of the IMUs (and magnetometers) are late by this against the images': stamp = true time + S [s]")
      ->group(group);
  app->add_option("--readout-time", f->readout_time,
                  "rolling shutters of all cameras: row r is seen at stamp + (r / height - 1/2) S [s]")
      ->group(group);
  app->add_option("--vibration", f->vibration,
                  "of the IMUs, 30 to 120 Hz: root mean square of each accelerometer's axis [m/s^2]")
      ->group(group);
  app->add_option("--gyro-bias", f->gyro_bias,
                  "at time 0: its norm, in a direction drawn by the seed, or three numbers [rad/s]")
      ->expected(1, 3)
      ->group(group);
  app->add_option("--accel-bias", f->accel_bias, "likewise [m/s^2]")->expected(1, 3)->group(group);
  app->add_flag("--start-in-motion", f->start_in_motion, "begins after take-off and the ground robot's setting off")
      ->group(group);
  app->add_option(
         "--jpeg", f->jpeg_quality,
         "quality 1 to 100: sensor_msgs/CompressedImage on <topic>/compressed in place of raw images (depth stays)")
      ->group(group);
  app->add_option("--radial-error", f->radial_error, "of both calibrations as published: their k1 minus the true one")
      ->group(group);
  app->add_option("--focal-error", f->focal_error, "likewise: focal lengths that are too large by this share")
      ->group(group);
  app->add_option("--lost-images", f->lost_images,
                  "share of each robot's images that was not recorded, 1 to 5 in a row, drawn by the seed")
      ->group(group);
  app->add_option("--tf-static", f->tf_static,
                  "latched: one message; split: a message a transform, not latched; publishers: each by a latching\n"
                  "publisher of its own")
      ->transform(CLI::CheckedTransformer(modes))
      ->group(group);
  app->add_option("--clock-offset", f->clock_offset, "the ground robot's clock is ahead of the MAV's by this [s]")
      ->group(group);
  app->add_option("--depth-delay", f->depth_delay,
                  "the ground robot's depth images are taken, and stamped, so long after its colour images [s]")
      ->group(group);
}

}  // namespace

void addOptions(CLI::App* app, Options* o) {
  app->add_option("--world", o->world, "name of a file in config/worlds, or a path to a .yaml file")
      ->capture_default_str();
  app->add_option("--seed", o->seed, "varies layout, textures, light, ways and noise")->capture_default_str();
  app->add_option("--out", o->out, "bag to write");
  app->add_option("--cache", o->cache,
                  "instead of --out: folder of bags named by a hash of their parameters; renders only what is missing, "
                  "prints the path");
  app->add_option("--duration", o->duration, "length of the recording [s]; default: the world file's");
  app->add_option("--spp", o->samples, "rays a pixel; default: the world file's")->check(CLI::Range(1, 64));
  app->add_option("--mav-camera", o->mav_camera,
                  "calibration of the MAV's camera (camera_info YAML), for example config/cameras/fisheye_150.yaml");
  app->add_option("--threads", o->threads, "default: all cores")->check(CLI::Range(1, 1024));
  app->add_option("--compression", o->compression, "lz4 or none")
      ->check(CLI::IsMember({"lz4", "none"}))
      ->capture_default_str();
  app->add_flag("--no-mav", o->no_mav, "leave out the MAV");
  app->add_flag("--no-ground", o->no_ground, "leave out the ground robot");
  app->add_flag("--city-only", o->city_only,
                "street worlds: only the folder x.city of panoramas, geotags, model and truth, no bag");
  app->add_flag("--no-city", o->no_city, "street worlds: no such folder");
  app->add_option("--queries", o->queries,
                  "street worlds: so many pictures of the flight in x.city/queries, with their truth")
      ->check(CLI::Range(0, 100000));
  app->add_flag("--ground-mag", o->ground_mag, "a magnetometer on the ground robot, too: /ground/imu/mag");
  addFaultOptions(app, &o->faults);
  app->add_flag("--quiet", o->quiet, "no progress bar");
}

}  // namespace air_ground_sim
