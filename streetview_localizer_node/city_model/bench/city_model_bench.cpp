// Reading a city: seconds must grow with the number of buildings, not with its square.
#include <benchmark/benchmark.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "streetview_localizer/city_model.h"

namespace {

/// CityJSON of so many boxes in rows, on one line.
std::string cityJson(int boxes) {
  std::string objects, vertices;
  const auto text = [](int i) { return std::to_string(i); };
  for (int k = 0; k < boxes; ++k) {
    const int east = 30000 * (k % 100), north = 25000 * (k / 100), b = 8 * k;
    for (const int z : {10000, 22000})
      for (const auto& [x, y] : {std::make_pair(0, 0), {20000, 0}, {20000, 15000}, {0, 15000}})
        vertices += std::string(vertices.empty() ? "" : ",") + "[" + text(east + x) + "," + text(north + y) + "," +
                    text(z) + "]";
    std::string faces;
    for (int i = 0; i < 4; ++i)
      faces += "[[" + text(b + i) + "," + text(b + (i + 1) % 4) + "," + text(b + 4 + (i + 1) % 4) + "," +
               text(b + 4 + i) + "]],";
    objects += std::string(k ? "," : "") + "\"b" + text(k) +
               R"(":{"type":"Building","geometry":[{"type":"Solid","lod":"2.2","boundaries":[[)" + faces + "[[" +
               text(b + 4) + "," + text(b + 5) + "," + text(b + 6) + "," + text(b + 7) + "]],[[" + text(b + 3) + "," +
               text(b + 2) + "," + text(b + 1) + "," + text(b) + "]]]]}]}";
  }
  return R"({"type":"CityJSON","version":"2.0","transform":{"scale":[0.001,0.001,0.001],"translate":[2680000,1245000,0]},)"
         R"("metadata":{"referenceSystem":"EPSG:2056"},"CityObjects":{)" +
         objects + "},\"vertices\":[" + vertices + "]}";
}

void BM_ReadCityJson(benchmark::State& state) {
  const std::string path =
      std::filesystem::temp_directory_path() / ("city_model_bench_" + std::to_string(getpid()) + ".json");
  std::ofstream(path) << cityJson(static_cast<int>(state.range(0)));
  for (auto _ : state) benchmark::DoNotOptimize(streetview_localizer::readCityModel(path));
  std::filesystem::remove(path);
  state.SetComplexityN(state.range(0));
}

}  // namespace

BENCHMARK(BM_ReadCityJson)->RangeMultiplier(4)->Range(400, 25600)->Unit(benchmark::kMillisecond)->Complexity();
