#include "city_display.h"

#include <sensor_msgs/PointCloud2.h>
#include <visualization_msgs/MarkerArray.h>

#include <algorithm>
#include <cmath>

#include "air_ground_common/ros/conversions.h"
#include "streetview_localizer/match_picture.h"

namespace streetview_localizer {
namespace {

namespace ru = air_ground_common::ros_utils;

constexpr double kFrustum = 1.2;   // depth of a drawn camera [m]
constexpr double kWidest = 4;      // distance of its corners from its axis, over that depth
constexpr std::size_t kLines = 8;  // of a drawn camera

geometry_msgs::Point toPoint(const Eigen::Vector3d& p) {
  geometry_msgs::Point out;
  out.x = p.x();
  out.y = p.y();
  out.z = p.z();
  return out;
}

visualization_msgs::Marker marker(const std::string& frame, const std::string& space, int type, double r, double g,
                                  double b) {
  visualization_msgs::Marker m;
  m.header.frame_id = frame;
  m.ns = space;
  m.type = type;
  m.pose.orientation.w = 1;
  m.color.r = static_cast<float>(r);
  m.color.g = static_cast<float>(g);
  m.color.b = static_cast<float>(b);
  m.color.a = 1;
  return m;
}

}  // namespace

void CityDisplay::advertise(ros::NodeHandle* handle) {
  model_ = handle->advertise<sensor_msgs::PointCloud2>("streetview/textured_model", 1, true);
  panoramas_ = handle->advertise<visualization_msgs::MarkerArray>("streetview/panoramas", 1, true);
  cameras_ = handle->advertise<visualization_msgs::Marker>("streetview/cameras", 1, true);
}

void CityDisplay::prepare(const StreetviewLocalizer& localizer, double spacing, std::size_t max_points,
                          int cameras_shown) {
  localizer_ = &localizer;
  spacing_ = spacing;
  max_points_ = max_points;
  cameras_shown_ = static_cast<std::size_t>(cameras_shown);
  synthesizer_ = std::make_unique<ViewSynthesizer>(localizer.database(), localizer.projector());
}

void CityDisplay::publishCity(const std::string& world_frame) {
  std_msgs::Header header;
  header.frame_id = world_frame;
  std::vector<ru::CloudPoint> cloud;
  for (const ColouredPoint& p : synthesizer_->sampleModel(spacing_, max_points_)) {
    ru::CloudPoint out;
    out.position = p.position;
    out.rgb = {p.bgr[2], p.bgr[1], p.bgr[0]};
    cloud.push_back(out);
  }
  model_.publish(ru::toMsg(cloud, ru::CloudFields::kXyzRgb, header));

  visualization_msgs::MarkerArray array;
  for (const Panorama& p : localizer_->database().panoramas) {
    visualization_msgs::Marker sphere =
        p.registered ? marker(world_frame, "panoramas", visualization_msgs::Marker::SPHERE, 0.1, 0.1, 0.1)
                     : marker(world_frame, "panoramas", visualization_msgs::Marker::SPHERE, 0.8, 0.1, 0.1);
    sphere.id = static_cast<int>(array.markers.size());
    sphere.pose = ru::toMsg(p.T_world_panorama);
    sphere.scale.x = sphere.scale.y = sphere.scale.z = 0.6;
    array.markers.push_back(sphere);
    visualization_msgs::Marker label =
        marker(world_frame, "names", visualization_msgs::Marker::TEXT_VIEW_FACING, 0.1, 0.1, 0.1);
    label.id = sphere.id;
    label.pose = sphere.pose;
    label.pose.position.z += 0.7;
    label.scale.z = 0.5;
    label.text = p.id;
    array.markers.push_back(label);
  }
  panoramas_.publish(array);
}

void CityDisplay::addCamera(const CameraModel& camera, const Pose& T_world_camera, const ros::Time& stamp,
                            const std::string& world_frame) {
  if (frusta_.points.empty()) {
    frusta_ = marker(world_frame, "cameras", visualization_msgs::Marker::LINE_LIST, 0.05, 0.2, 0.95);
    frusta_.scale.x = 0.06;
  }
  frusta_.header.stamp = stamp;
  const Eigen::Vector3d centre = T_world_camera.translation();
  Eigen::Vector3d corners[4];
  const double x[4] = {0, camera.width - 1.0, camera.width - 1.0, 0},
               y[4] = {0, 0, camera.height - 1.0, camera.height - 1.0};
  for (int i = 0; i < 4; ++i) {
    // A fisheye's corners may lie outside its image circle: go inwards to what it sees.
    Eigen::Vector2d pixel(x[i], y[i]), n = camera.unproject(pixel);
    while (!n.allFinite() || n.norm() > kWidest) {
      pixel = 0.95 * pixel + 0.05 * Eigen::Vector2d(camera.cx, camera.cy);
      n = camera.unproject(pixel);
    }
    corners[i] = T_world_camera * Eigen::Vector3d(kFrustum * n.x(), kFrustum * n.y(), kFrustum);
  }
  for (int i = 0; i < 4; ++i) {
    for (const Eigen::Vector3d& p : {centre, corners[i], corners[i], corners[(i + 1) % 4]})
      frusta_.points.push_back(toPoint(p));
  }
  if (frusta_.points.size() > 2 * kLines * cameras_shown_)
    frusta_.points.erase(frusta_.points.begin(), frusta_.points.begin() + 2 * kLines);
  cameras_.publish(frusta_);
}

cv::Mat CityDisplay::matchImage(const cv::Mat& image, const LocalizerResult& result, int width) const {
  return drawMatch(image, localizer_->database(), result, std::min(image.rows, image.rows * width / image.cols));
}

cv::Mat CityDisplay::besideModel(const cv::Mat& image, const CameraModel& camera, const LocalizerResult& result,
                                 int width) const {
  const CameraModel small = camera.scaled(std::min(1.0, static_cast<double>(width) / camera.width));
  return drawBeside(image, synthesizer_->render(small, result.pose.T_world_camera));
}

}  // namespace streetview_localizer
