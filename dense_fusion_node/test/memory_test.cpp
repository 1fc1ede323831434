// Memory that runs out, at any allocation of a fusion: an exception for the caller, never the end of the process.
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <new>

#include "dense_fusion/depth_fusion.h"
#include "dense_fusion/plane_sweep.h"
#include "synthetic_scene.h"

namespace {
std::atomic<long> allocations_left{-1};  // the one that finds 0 fails; below 0 none does
}

// Not inlined: the compiler would take malloc and delete, or new and free, for a mismatch.
__attribute__((noinline)) void* operator new(std::size_t size) {
  if (allocations_left >= 0 && allocations_left-- == 0) throw std::bad_alloc();
  if (void* memory = std::malloc(size == 0 ? 1 : size)) return memory;
  throw std::bad_alloc();
}
__attribute__((noinline)) void operator delete(void* memory) noexcept { std::free(memory); }
__attribute__((noinline)) void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

namespace dense_fusion {
namespace {

// Runs `job` with the first allocation failing, then with a later one, and so on, until it needs no more than there is.
template <typename Job>
int failures(const Job& job) {
  int thrown = 0;
  for (long fails = 0;; fails += 1 + fails / 16) {
    allocations_left = fails;
    try {
      job();
      const bool had_enough = allocations_left.exchange(-1) >= 0;
      if (had_enough) return thrown;
      ADD_FAILURE() << "allocation " << fails << " failed, and nobody was told";
      return thrown;
    } catch (const std::bad_alloc&) {
      allocations_left = -1;
      ++thrown;
    }
  }
}

DepthMap exactDepth(double x) {
  DepthMap map;
  map.camera = testing::wideCamera().undistorted().scaled(0.125);
  map.T_map_camera = testing::lookDown({x, 0, 2});
  map.intensity = testing::boxScene().render(map.camera, map.T_map_camera, 1, 0, &map.depth);
  map.confidence = cv::Mat::ones(map.depth.size(), CV_32F);
  return map;
}

TEST(OutOfMemory, AFusionThrows) {
  const std::vector<DepthMap> maps = {exactDepth(0), exactDepth(0.1), exactDepth(0.2)};
  FusionSettings settings;
  settings.voxel_size = 0.08;
  settings.fill_radius = 1;
  settings.tv_l1.iterations = 1;
  settings.tv_l1.coarse_iterations = 1;
  EXPECT_GT(failures([&] { fuseDepthMaps(maps, 1, settings); }), 20);
  EXPECT_TRUE(fuseDepthMaps(maps, 1, settings));
}

TEST(OutOfMemory, ADepthMapThrows) {
  const DepthMap view = exactDepth(0);
  Frame frame;
  frame.normalized = frame.intensity = view.intensity;
  frame.T_map_camera = view.T_map_camera;
  PlaneSweep sweep(view.camera);
  sweep.start(frame, 1, 3);
  frame.T_map_camera = testing::lookDown({0.3, 0, 2});
  ASSERT_TRUE(sweep.add(frame));
  EXPECT_GT(failures([&] { sweep.depthMap(); }), 5);
}

}  // namespace
}  // namespace dense_fusion
