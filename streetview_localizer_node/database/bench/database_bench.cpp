// Rays against a city model one by one and in packets; reading a database.
#include <benchmark/benchmark.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdlib>
#include <filesystem>

#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/database.h"

namespace streetview_localizer {
namespace {

// 40 x 40 blocks of 12 facets each.
CityModel city() {
  CityModel m;
  m.building_ids = {"city"};
  for (int i = 0; i < 40; ++i)
    for (int j = 0; j < 40; ++j) {
      const float height = 8.f + static_cast<float>((i * 7 + j * 13) % 12);
      const int first = static_cast<int>(m.mesh.vertices.size());
      for (int k = 0; k < 8; ++k)
        m.mesh.vertices.emplace_back(25.f * i + (k & 1 ? 15.f : 0.f), 25.f * j + (k & 2 ? 15.f : 0.f),
                                     k & 4 ? height : 0.f);
      const int quads[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
      for (const auto& q : quads)
        for (int t = 1; t < 3; ++t) {
          m.mesh.triangles.emplace_back(first + q[0], first + q[t], first + q[t + 1]);
          m.surface.push_back(Surface::kWall);
          m.building.push_back(0);
        }
    }
  return m;
}

struct Camera {
  air_ground_common::CameraModel model;
  air_ground_common::Pose T = air_ground_common::Pose::Identity();
  Camera() {
    model.width = 640, model.height = 480, model.fx = model.fy = 400, model.cx = 319.5, model.cy = 239.5;
    T.translation() << 495, 495, 2.5;
    T.linear() = Eigen::AngleAxisd(0.6, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
                 air_ground_common::opticalFromForwardBody().transpose();
  }

  /// Rays through all pixels, in world.
  std::vector<Eigen::Vector3f> directions() const {
    std::vector<Eigen::Vector3f> result;
    for (int y = 0; y < model.height; ++y)
      for (int x = 0; x < model.width; ++x)
        result.push_back((T.linear() * model.ray({double(x), double(y)})).cast<float>());
    return result;
  }
};

void BM_SingleRays640x480(benchmark::State& state) {
  const CityModel model = city();
  const air_ground_common::MeshScene scene(model.mesh);
  const Camera c;
  const std::vector<Eigen::Vector3f> directions = c.directions();
  const Eigen::Vector3f origin = c.T.translation().cast<float>();
  for (auto _ : state)
    for (const auto& d : directions) benchmark::DoNotOptimize(scene.cast(origin, d));
}
BENCHMARK(BM_SingleRays640x480)->Unit(benchmark::kMillisecond);

void BM_PacketsOf8Rays640x480(benchmark::State& state) {
  const CityModel model = city();
  const air_ground_common::MeshScene scene(model.mesh);
  const Camera c;
  const std::vector<Eigen::Vector3f> directions = c.directions();
  const Eigen::Vector3f origin = c.T.translation().cast<float>();
  for (auto _ : state) benchmark::DoNotOptimize(scene.castMany(origin, directions));
}
BENCHMARK(BM_PacketsOf8Rays640x480)->Unit(benchmark::kMillisecond);

// 20 panoramas of 8 views with 2000 features: 320000 features, 52 MB.
const std::string& databaseFile() {
  static const std::string path = [] {
    const std::string file = (std::filesystem::temp_directory_path() / "streetview_database_bench.gpkg").string();
    std::filesystem::remove(file);
    DatabaseWriter writer(file, city(), "bench");
    View view;
    view.camera = Camera().model;
    view.image.create(view.camera.height, view.camera.width, CV_8UC3);
    cv::randu(view.image, 0, 255);
    view.features.descriptors = cv::Mat(2000, 128, CV_8U, cv::Scalar(7));
    view.features.keypoints.assign(2000, cv::KeyPoint(10.f, 20.f, 3.f));
    view.points.assign(2000, Eigen::Vector3f::Zero());
    view.normals.assign(2000, Eigen::Vector3f::UnitX());
    for (int i = 0; i < 20; ++i) {
      Panorama p;
      p.id = std::to_string(i);
      p.T_world_panorama.translation().x() = 12 * i;
      writer.add(p, std::vector<View>(8, view));
    }
    writer.finish();
    return file;
  }();
  return path;
}

void BM_LoadDatabase(benchmark::State& state) {
  DatabaseLoadOptions options;
  options.images = state.range(0) != 0;
  for (auto _ : state) benchmark::DoNotOptimize(loadDatabase(databaseFile(), options));
  state.counters["features/s"] =
      benchmark::Counter(320000.0 * static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}
BENCHMARK(BM_LoadDatabase)->Arg(0)->Arg(1)->ArgName("images")->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace streetview_localizer
