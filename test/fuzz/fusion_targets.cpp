// Posed images, as dense_fusion's worker takes them.
#include <air_ground/PosedImage.h>

#include <cmath>
#include <optional>
#include <random>

#include "air_ground_common/ros/compressed_image.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/map_correction.h"
#include "dense_fusion/dense_mapper.h"
#include "dense_fusion/point_map.h"
#include "fuzzing.h"

namespace air_ground_fuzz {
namespace {

namespace df = dense_fusion;
namespace ru = air_ground_common::ros_utils;

constexpr int kWidth = 64, kHeight = 48;
constexpr double kFocalLength = 50, kStep = 0.05, kDistance = 2;  // [px], [m], [m]

// Random grey values, a few pixels wide.
const cv::Mat& texture() {
  static const cv::Mat texture = [] {
    std::mt19937 random(1);
    cv::Mat out(kHeight, 4 * kWidth, CV_8UC1);
    for (int v = 0; v < out.rows; ++v)
      for (int u = 0; u < out.cols; ++u)
        out.at<std::uint8_t>(v, u) = v % 3 > 0   ? out.at<std::uint8_t>(v - 1, u)
                                     : u % 3 > 0 ? out.at<std::uint8_t>(v, u - 1)
                                                 : static_cast<std::uint8_t>(random());
    return out;
  }();
  return texture;
}

// A flight along a wall, whose i-th image is spoilt here or there.
air_ground::PosedImage posedImage(Source& source, int i) {
  const auto spoilt = source.take<std::uint16_t>();
  air_ground::PosedImage msg;
  msg.header.stamp = ros::Time(100 + 0.1 * i);
  const int shift = static_cast<int>(std::lround(kStep * i * kFocalLength / kDistance));
  const int width = spoilt & 1 ? 1 + source.take<std::uint8_t>() % kWidth : kWidth;
  cv::Mat seen = texture()(cv::Rect(std::min(shift, 3 * kWidth), 0, width, kHeight)).clone();
  if (spoilt & 2) seen.setTo(source.take<std::uint8_t>());
  msg.image = ru::toMsg(seen, "mono8", msg.header);
  air_ground_common::CameraModel camera;
  camera.width = kWidth, camera.height = kHeight;
  camera.fx = camera.fy = kFocalLength, camera.cx = 0.5 * (kWidth - 1), camera.cy = 0.5 * (kHeight - 1);
  msg.camera_info = ru::toMsg(camera, msg.header);
  if (spoilt & 4) msg.camera_info.K[source.take<std::uint8_t>() % 9u] = source.number();
  if (spoilt & 8) msg.camera_info.D = {source.number(), source.number(), 0, 0, source.number()};
  if (spoilt & 16) msg.camera_info.distortion_model = "equidistant";
  msg.pose.pose = ru::toMsg(air_ground_common::Pose(Eigen::Translation3d(kStep * i, 0, 0)));
  if (spoilt & 32) msg.pose.pose.position.z = source.number();
  if (spoilt & 64) msg.pose.pose.orientation.z = source.number(), msg.pose.pose.orientation.w = source.number();
  if (spoilt & 128) {
    msg.header.stamp.sec = source.take<std::uint32_t>();
    msg.header.stamp.nsec = source.take<std::uint32_t>();
  }
  msg.depth_min = 1, msg.depth_max = 4;
  if (spoilt & 256) msg.depth_min = static_cast<float>(source.number());
  if (spoilt & 512) msg.depth_max = static_cast<float>(source.number());
  if (spoilt & 1024) msg.readout_time = static_cast<float>(source.number());
  return msg;
}

df::MapperSettings smallSettings() {
  df::MapperSettings settings;
  settings.rectifier.scale = 1;
  settings.rectifier.normalization_radius = 4;
  settings.sweep.hypotheses = 32;
  settings.sweep.threads = settings.fusion.threads = 1;
  settings.fusion.voxel_size = 0.1;
  settings.fusion.max_voxels = 20000;
  settings.fusion.tv_l1.iterations = 5;
  settings.fusion_radius = 0.2;
  settings.min_depth_maps = 2;
  return settings;
}

void posedImages(const Bytes& bytes) {
  Source source(bytes);
  df::DenseMapper mapper(smallSettings());
  const bool own_unit = source.take<std::uint8_t>() % 2;
  std::optional<df::PointMap> map(0.01);
  const auto keep = [&](const std::optional<df::FusedMap>& fused) {
    if (!fused) return;
    require(fused->depth_map.T_map_camera.matrix().allFinite(), "pose of the fused map");
    map->add(fused->points);
  };
  for (int i = 0; i < 12 && !source.empty(); ++i) {
    const air_ground::PosedImage msg = posedImage(source, i);
    answers([&] {
      const double distance = std::sqrt(static_cast<double>(msg.depth_min) * msg.depth_max), before = mapper.unit();
      if (own_unit && distance > 0 && std::isfinite(distance)) keep(mapper.followDistance(distance));
      if (before != mapper.unit()) map.emplace(0.01 / mapper.unit());
    });
    if (source.take<std::uint8_t>() % 4 == 3) {
      nav_msgs::Path path;
      for (int k = 0; k < i; ++k) {
        path.poses.emplace_back().header.stamp = ros::Time(100 + 0.1 * k);
        path.poses.back().pose = ru::toMsg(air_ground_common::Pose(Eigen::Translation3d(1.01 * kStep * k, 0, 0)));
        if (source.take<std::uint8_t>() % 8 == 7) path.poses.back().pose.position.y = source.number();
      }
      answers([&] { mapper.correct(ru::fromMsg(path)); });
      for (const auto& [stamp, S] : mapper.corrections())
        require(!S || (S->t.allFinite() && S->scale > 0), "correction of a fused map");
    }
    answers([&] {
      keep(mapper.add(ru::greyFromMsg(msg), ru::fromMsg(msg.camera_info),
                      static_cast<std::int64_t>(msg.header.stamp.toNSec()), ru::fromMsg(msg.pose.pose), msg.depth_min,
                      msg.depth_max, msg.readout_time));
    });
  }
  answers([&] { keep(mapper.flush()); });
  for (const auto& point : map->points()) require(point.position.allFinite(), "point of the dense map");
}

}  // namespace

void addFusionTargets(Targets* targets) { targets->insert({{"posed_images", posedImages}}); }

}  // namespace air_ground_fuzz
