// A textured corner of a room, rendered; both robots' views of it.
#pragma once

#include <cmath>
#include <opencv2/imgproc.hpp>
#include <utility>
#include <vector>

#include "view_match/view_matcher.h"

namespace view_match {

using air_ground_common::CameraModel;
using air_ground_common::expSO3;

/// Noise of several scales on the planes y = 4 (a wall), x = 2 (another) and z = 0 (the floor), [m].
class Corner {
 public:
  explicit Corner(int seed) {
    cv::RNG random(seed);
    for (cv::Mat& texture : textures_) {
      texture = cv::Mat::zeros(kSize, kSize, CV_32F);
      for (const int cells : {32, 128, 400}) {
        cv::Mat noise(cells, cells, CV_32F), large;
        random.fill(noise, cv::RNG::UNIFORM, 0, 255);
        cv::resize(noise, large, {kSize, kSize}, 0, 0, cv::INTER_CUBIC);
        texture += large / 3;
      }
    }
  }

  /// Grey value and range along a ray of the world.
  std::pair<float, double> look(const Eigen::Vector3d& from, const Eigen::Vector3d& ray) const {
    const double t[3] = {(4 - from.y()) / ray.y(), (2 - from.x()) / ray.x(), -from.z() / ray.z()};
    int plane = -1;
    for (int k = 0; k < 3; ++k)
      if (t[k] > 0 && (plane < 0 || t[k] < t[plane])) plane = k;
    if (plane < 0) return {0, 0};
    const Eigen::Vector3d p = from + t[plane] * ray;
    const Eigen::Vector2d at = plane == 0   ? Eigen::Vector2d(p.x(), p.z())
                               : plane == 1 ? Eigen::Vector2d(p.y(), p.z())
                                            : p.head<2>();
    const Eigen::Vector2d pixel = (at.array() + 5) * kSize / 12.0;
    if (pixel.minCoeff() < 0 || pixel.maxCoeff() >= kSize - 1) return {0, 0};
    return {textures_[plane].at<float>(static_cast<int>(pixel.y()), static_cast<int>(pixel.x())), t[plane]};
  }

 private:
  static constexpr int kSize = 1600;
  cv::Mat textures_[3];
};

inline Pose lookingAt(const Eigen::Vector3d& from, const Eigen::Vector3d& at) {
  Pose T = Pose::Identity();
  const Eigen::Vector3d z = (at - from).normalized(), x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
  T.linear() << x, z.cross(x), z;
  T.translation() = from;
  return T;
}

/// What both robots see of a corner, and where they are.
struct CornerScene {
  CornerScene() {
    camera.width = 480;
    camera.height = 360;
    camera.fx = camera.fy = 330;
    camera.cx = 239.5;
    camera.cy = 179.5;
  }

  cv::Mat render(const Corner& corner, const Pose& T_world_camera, cv::Mat* depth = nullptr) const {
    cv::Mat image(360, 480, CV_8UC1);
    if (depth) depth->create(360, 480, CV_32F);
    for (int v = 0; v < image.rows; ++v) {
      for (int u = 0; u < image.cols; ++u) {
        const Eigen::Vector3d ray = camera.unproject({u, v}).homogeneous();
        const auto [grey, range] = corner.look(T_world_camera.translation(), T_world_camera.linear() * ray);
        image.at<std::uint8_t>(v, u) = cv::saturate_cast<std::uint8_t>(grey);
        if (depth) depth->at<float>(v, u) = static_cast<float>(range);
      }
    }
    return image;
  }

  /// Of the ground robot; ids 0, 10, 20, ...
  std::vector<KeyframeView> groundViews(const Corner& corner) const {
    std::vector<KeyframeView> out;
    for (std::uint32_t i = 0; i < 5; ++i) {
      KeyframeView view;
      view.id = 10 * i;
      view.T_ground_camera = lookingAt({-1.0 + 0.4 * i, 0.2 * i, 0.6}, {0.3 + 0.2 * i, 4, 0.8});
      cv::Mat depth;
      const cv::Mat image = render(corner, view.T_ground_camera, &depth);
      visual_frontend::Keyframe seen;
      visual_frontend::describeKeyframe(image, camera, {}, seen);
      view.descriptors = seen.orb_descriptors;
      for (std::size_t k = 0; k < seen.orb_pixels.size(); ++k) {
        const double z =
            depth.at<float>(static_cast<int>(seen.orb_pixels[k].y()), static_cast<int>(seen.orb_pixels[k].x()));
        view.points.push_back((z > 0 ? z : 1) * seen.orb_normalized[k].homogeneous());
      }
      out.push_back(view);
    }
    return out;
  }

  /// Cameras of the MAV, a little higher and beside, in the ground map.
  static Pose flown(int i) { return lookingAt({-0.8 + 0.25 * i, 0.3 + 0.05 * i, 1.0 + 0.06 * i}, {0.5, 4, 0.7}); }

  /// As the MAV's odometry has it.
  Pose inMavMap(const Pose& T_ground_camera) const {
    Pose T = Pose::Identity();
    T.linear() = truth.R.transpose() * T_ground_camera.linear();
    T.translation() = truth.R.transpose() * (T_ground_camera.translation() - truth.t) / truth.scale;
    return T;
  }

  /// Of the MAV's map, as far as the image shows them.
  std::vector<Eigen::Vector3f> landmarks(const cv::Mat& depth, const Pose& T_ground_camera) const {
    std::vector<Eigen::Vector3f> out;
    for (int v = 10; v < depth.rows; v += 20) {
      for (int u = 10; u < depth.cols; u += 20) {
        const Eigen::Vector3d p = depth.at<float>(v, u) * camera.unproject({u, v}).homogeneous();
        out.push_back((inMavMap(T_ground_camera) * (p / truth.scale)).cast<float>());
      }
    }
    return out;
  }

  CameraModel camera;
  Similarity truth{2.5, expSO3({0.4, 0.3, 1.5}), {1, -2, 0.7}};  // T_ground_mav
};

}  // namespace view_match
