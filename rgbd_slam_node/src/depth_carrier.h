// Depth that was taken a little before or after its colour image, as the camera sees it at the image's time.
#pragma once

#include <opencv2/core/mat.hpp>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/geometry.h"
#include "depth_lookup.h"

namespace rgbd_slam {

/// Each pixel looks up where the depth image shows what it sees: unlike pixels that are thrown to where they belong,
/// that leaves no cracks, and a slanted plane does not become stairs. At the rim of something near, as far as parallax
/// moves it, the surface behind may be shown.
class DepthCarrier {
 public:
  explicit DepthCarrier(const air_ground_common::CameraModel& camera) : camera_(camera) {}

  /// `depth`: CV_32F of the camera's size [m], NaN or <= 0 unknown, by the camera at `T_image_depth`, its pose when
  /// depth was taken in its frame at the image's time. Returns what it would have shown then, NaN where that is not
  /// known; `depth` itself, not copied, where its middle distance moves by less than half a pixel.
  cv::Mat carry(const cv::Mat& depth, const air_ground_common::Pose& T_image_depth);

 private:
  /// Where a pixel's depth is found, smooth over the image: between nodes of a grid it is interpolated.
  struct Node {
    float far_x, far_y;    ///< from the pixel to where the depth image shows it, were it far away [px]
    float near_x, near_y;  ///< what is added to that at 1 m, in proportion to inverse depth [px m]
    float scale;           ///< of the depth found there
  };
  /// Of a row's pixels: nodes between which each lies, and where it is looked for.
  struct Sought {
    std::vector<float> far_x, far_y, near_x, near_y, scale, inverse, x, y;
    void resize(int pixels) {
      for (auto* of_pixel : {&far_x, &far_y, &near_x, &near_y, &scale, &inverse, &x, &y}) of_pixel->resize(pixels);
    }
  };
  void makeGrid();
  std::vector<Node> displacements(const air_ground_common::Pose& T_image_depth) const;
  /// `offset`: of a depth found, before it is scaled [m].
  void carryRow(const cv::Mat& depth, int v, const std::vector<Node>& row, float offset, float* out);
  /// Of pixel u, by the depth `found` where it was looked for first [m]; NaN where it is not known.
  float settled(const DepthImage& image, int u, float offset, float found) const;

  air_ground_common::CameraModel camera_;
  std::vector<int> columns_, rows_;    ///< pixels of the grid's nodes
  std::vector<Eigen::Vector2d> rays_;  ///< of the nodes, row by row, z = 1
  Sought sought_;
};

}  // namespace rgbd_slam
