#include "air_ground_sim/street/city.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <sstream>
#include <stdexcept>

#include "air_ground_common/camera_file.h"
#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"
#include "air_ground_common/units.h"

namespace air_ground_sim {
namespace {

namespace fs = std::filesystem;
using air_ground_common::formatted;
using air_ground_common::kDegree;
using air_ground_common::LocalFrame;
using air_ground_common::Pose;

void writeText(const fs::path& path, const std::string& text) {
  const fs::path part = path.string() + ".part";
  std::ofstream out(part, std::ios::binary);
  out << text;
  out.close();
  if (!out) throw std::runtime_error("cannot write '" + path.string() + "'");
  fs::rename(part, path);
}

void writeImage(const fs::path& path, const cv::Mat& image, const std::vector<int>& settings = {}) {
  const fs::path part = path.parent_path() / ("part_" + path.filename().string());
  if (!cv::imwrite(part.string(), image, settings)) throw std::runtime_error("cannot write '" + path.string() + "'");
  fs::rename(part, path);
}

std::string poseText(const Pose& T) {
  const Eigen::Quaterniond q(T.linear());
  std::string text;
  for (int k = 0; k < 3; ++k) text += "," + formatted("%.6f", T.translation()[k]);
  for (const double v : {q.x(), q.y(), q.z(), q.w()}) text += "," + formatted("%.9f", v);
  return text;
}

// A camera's rendering of a panorama: exposure for the facades, response, noise. B G R.
cv::Mat develop(const std::vector<float>& rgb, int width, std::uint64_t seed) {
  std::vector<float> sample;
  for (std::size_t i = width * (width / 8) * 3ul; i < width * (width / 3) * 3ul; i += 3 * 97)
    sample.push_back(rgb[i + 1]);
  const float gain = 0.26f / std::max(1e-4f, air_ground_common::median(std::move(sample)));
  // Response in steps of 1/1024 of the square root of the light, up to 8 times white.
  constexpr int kSteps = 1024 * 3;
  std::vector<float> response(kSteps);
  for (int i = 0; i < kSteps; ++i) {
    const float l = static_cast<float>(i * i) / (1024 * 1024);
    const float shown = l * (1 + l / 6) / (1 + 0.8f * l);  // bright parts are held back, as cameras do
    response[i] = 255 * std::pow(std::min(1.0f, shown), 1 / 2.2f);
  }
  cv::Mat image(width / 2, width, CV_8UC3);
#pragma omp parallel for schedule(static)
  for (int y = 0; y < image.rows; ++y) {
    Rng rng(mix(seed, y));
    for (int x = 0; x < width; ++x)
      for (int c = 0; c < 3; ++c) {
        const float l = gain * rgb[(static_cast<std::size_t>(y) * width + x) * 3 + c];
        // Noise uniform over +-3 grey values: the sum of shot noise and compression.
        const double v =
            response[std::min(kSteps - 1, static_cast<int>(1024 * std::sqrt(l)))] + 6 * (rng.uniform() - 0.5);
        image.at<cv::Vec3b>(y, x)[2 - c] = static_cast<std::uint8_t>(std::clamp(v + 0.5, 0.0, 255.0));
      }
  }
  return image;
}

std::string cameraYaml(const air_ground_common::CameraModel& c) {
  return "# The MAV's camera (ROS calibration file).\n" + air_ground_common::cameraFileText(c, "mav_camera");
}

std::string cityYaml(const SimConfig& config, const Street& street, const LocalFrame& frame) {
  const StreetConfig& c = street.config;
  const Eigen::Vector3d field = earthMagneticField();
  std::ostringstream s;
  s.precision(12);
  s << "# Where the city lies and what belongs to it. Frame world: local east-north-up at `origin`, y to true north.\n"
    << "crs: " << c.crs << "\norigin: [" << c.origin.x() << ", " << c.origin.y() << ", " << c.origin.z()
    << "]  # easting, northing, height of world's origin\n"
    << "geoid_undulation: " << c.geoid_undulation
    << "  # ellipsoidal height minus the height used in origin [m]; gps/fix is ellipsoidal\n"
    << "magnetic_declination: " << formatted("%.4f", std::atan2(field.x(), field.y()) / kDegree)
    << "  # [deg], east positive\n"
    << "meridian_convergence: " << formatted("%.5f", frame.meridianConvergence() / kDegree)
    << "  # from true to grid north, clockwise [deg]\n"
    << "geotags: geotags.csv  # image, WGS 84, alt in the height system of origin [m]; heading of the image's centre, "
       "clockwise from true "
       "north, pitch up, roll right side down [deg]\n"
    << "heading_reference: true_north\npanoramas: panoramas\nmodel: model.gml\nmodel_obj: model.obj\ncamera: "
       "camera.yaml\n"
    << "panorama_truth: panorama_truth.csv  # T_world_panorama: x to the image's centre, y left, z up\n"
    << "street: " << config.name << "\nseed: " << street.seed << '\n';
  return s.str();
}

}  // namespace

Geotag geotagOf(const LocalFrame& frame, const Pose& T) {
  Geotag g;
  g.place = frame.toGeodetic(T.translation());
  const Eigen::Matrix3d& R = T.linear();
  g.heading = std::fmod(450 - std::atan2(R(1, 0), R(0, 0)) / kDegree, 360.0);
  g.pitch = std::asin(std::clamp(R(2, 0), -1.0, 1.0)) / kDegree;
  g.roll = std::atan2(R(2, 1), R(2, 2)) / kDegree;
  return g;
}

void writeCity(const SimConfig& config, const Street& street, const std::string& folder,
               const std::function<void(int, int)>& progress) {
  const fs::path root(folder);
  fs::create_directories(root / "panoramas");
  fs::remove(root / "city.yaml");  // written last: where it is, the folder is complete
  const LocalFrame frame(street.config.crs, street.config.origin);
  writeCityGml((root / "model.gml").string(), street, frame);
  writeObj((root / "model.obj").string(), street, frame);
  std::string tags = "image,lat,lon,alt,heading_deg,pitch_deg,roll_deg\n", truth = "id,x,y,z,qx,qy,qz,qw\n";
  for (const auto& p : street.panoramas) {
    const Geotag g = geotagOf(frame, p.T_world_geotag);
    tags += p.id + ".jpg," + formatted("%.9f", g.place.latitude) + "," + formatted("%.9f", g.place.longitude) + "," +
            formatted("%.3f", g.place.height) + "," + formatted("%.4f", g.heading) + "," + formatted("%.4f", g.pitch) +
            "," + formatted("%.4f", g.roll) + "\n";
    truth += p.id + poseText(p.T_world_panorama) + "\n";
  }
  const Scene scene(buildStreetWorld(street, Season::kPanoramas));
  std::vector<float> light;
  const StreetConfig& c = street.config;
  for (std::size_t i = 0; i < street.panoramas.size(); ++i) {
    const auto& p = street.panoramas[i];
    renderPanorama(scene, p.T_world_panorama, c.panorama_width, c.panorama_samples, mix(street.seed, 5000 + i), &light);
    writeImage(root / "panoramas" / (p.id + ".jpg"), develop(light, c.panorama_width, mix(street.seed, 6000 + i)),
               {cv::IMWRITE_JPEG_QUALITY, 92});
    if (progress) progress(static_cast<int>(i) + 1, static_cast<int>(street.panoramas.size()));
  }
  writeText(root / "camera.yaml", cameraYaml(config.mav_camera.camera));
  writeText(root / "panorama_truth.csv", truth);
  writeText(root / "geotags.csv", tags);
  writeText(root / "city.yaml", cityYaml(config, street, frame));
}

void writeQueries(Recording* recording, int count, const std::string& folder) {
  const SimConfig& c = recording->config();
  std::vector<std::uint8_t> pixels;
  const auto series = [&](const std::string& name, int n, const std::function<Pose(int, Eigen::Vector3d*)>& base) {
    const fs::path root = fs::path(folder) / name;
    fs::create_directories(root);
    std::string truth = "image,x,y,z,qx,qy,qz,qw\n";
    for (int i = 0; i < n; ++i) {
      Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
      const Pose T_world_camera = base(i, &velocity) * c.T_mav_base_camera;
      recording->photograph(T_world_camera, velocity, i, &pixels);
      const std::string id = formatted("query_%04d.png", i);
      writeImage(root / id, cv::Mat(c.mav_camera.camera.height, c.mav_camera.camera.width, CV_8U, pixels.data()));
      truth += id + poseText(T_world_camera) + "\n";
    }
    writeText(fs::path(folder) / (name + "_truth.csv"), truth);
  };
  const double begin = c.flight.stand_still + 6, end = std::max(begin, c.flight.duration - 0.5);
  series("queries", count, [&](int i, Eigen::Vector3d* velocity) {
    const BodyState s = recording->mav().state(begin + (end - begin) * (i + 0.5) / count);
    *velocity = s.velocity;
    return s.T_world_body;
  });
  std::vector<Pose> elsewhere;
  for (std::size_t i = 0; i < c.street.lines.size(); ++i)
    if (!c.street.lines[i].panoramas)
      for (const Pose& T : posesAlongLine(recording->street(), static_cast<int>(i), c.flight, 3.0))
        elsewhere.push_back(T);
  series("queries_elsewhere", static_cast<int>(elsewhere.size()),
         [&](int i, Eigen::Vector3d*) { return elsewhere[i]; });
}

}  // namespace air_ground_sim
