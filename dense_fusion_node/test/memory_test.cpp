// Memory that runs out, at any allocation of a fusion: an exception for the caller, never the end of the process.
#include "air_ground_common/testing/failing_memory.h"
#include "dense_fusion/depth_fusion.h"
#include "dense_fusion/plane_sweep.h"
#include "synthetic_scene.h"

namespace dense_fusion {
namespace {

using air_ground_common::testing::failuresWithoutMemory;

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
  EXPECT_GT(failuresWithoutMemory([&] { fuseDepthMaps(maps, 1, settings); }), 20);
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
  EXPECT_GT(failuresWithoutMemory([&] { sweep.depthMap(); }), 5);
}

}  // namespace
}  // namespace dense_fusion
