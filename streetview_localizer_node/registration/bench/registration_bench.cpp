// One panorama of 2048 x 1024 pixels, one thread: what is read from the image, and the whole correction.
#include <benchmark/benchmark.h>

#include "panorama_image.h"
#include "sky.h"
#include "streetview_localizer/panorama_registration.h"
#include "synthetic_street.h"

namespace {

using namespace streetview_localizer;

struct Scene {
  Scene() : street(settings()), registrar(street.model()) {
    std::mt19937_64 random(3);
    const auto truth = street.panoramaPose(60, &random);
    geotag = drawGeotag(truth, &random);
    image = street.render(truth);
  }
  static SyntheticStreetSettings settings() {
    SyntheticStreetSettings s;
    s.seed = 301;
    s.image_width = 2048;
    return s;
  }
  SyntheticStreet street;
  PanoramaRegistrar registrar;
  air_ground_common::Pose geotag;
  cv::Mat image;
};

const Scene& scene() {
  static const Scene instance;
  return instance;
}

void BM_SkyLine(benchmark::State& state) {
  scene();  // not part of the time
  for (auto _ : state) benchmark::DoNotOptimize(registration::findSkyLine(scene().image, {}));
}

void BM_Segments(benchmark::State& state) {
  scene();  // not part of the time
  for (auto _ : state) benchmark::DoNotOptimize(registration::findSegments(scene().image, {}, 1.1));
}

void BM_RegisterPanorama(benchmark::State& state) {
  scene();  // not part of the time
  for (auto _ : state) benchmark::DoNotOptimize(scene().registrar.registerPanorama(scene().image, scene().geotag));
}

BENCHMARK(BM_SkyLine)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_Segments)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_RegisterPanorama)->Unit(benchmark::kMillisecond);

}  // namespace
