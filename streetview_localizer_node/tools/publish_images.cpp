// Plays a folder of photographs as a camera: images and calibration on the topics of a driver.
#include <ros/ros.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <tf2_ros/static_transform_broadcaster.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/camera_file.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/tf_edge.h"
#include "query_list.h"

namespace {

namespace ru = air_ground_common::ros_utils;

const ros::WallDuration kPause(0.05), kReminder(10);

struct Arguments {
  std::string folder, images, camera, cameras, frame = "mav_camera_optical_frame", base_frame;
  double period = 2;
  bool loop = false;
};

/// Images with the calibration of each, or one of all.
struct Album {
  std::vector<std::string> names;
  std::optional<air_ground_common::CameraModel> common;
  std::map<std::string, air_ground_common::CameraModel> single;
};

Album readAlbum(const Arguments& a) {
  if (a.camera.empty() == a.cameras.empty()) throw std::runtime_error("give either --camera or --cameras");
  Album album;
  if (!a.camera.empty()) {
    album.common = air_ground_common::readCameraFile(a.camera);
    album.names = streetview_localizer::listImages(a.images);
  } else {
    album.single = streetview_localizer::readCameraList(a.cameras);
    album.names = streetview_localizer::listCalibratedImages(a.images, album.single, a.cameras);
  }
  return album;
}

/// All of them once, unless ROS ends before; returns how many could be read.
int play(const Arguments& a, const Album& album, const ros::Publisher& images, const ros::Publisher& infos) {
  int published = 0;
  for (const std::string& name : album.names) {
    if (!ros::ok()) break;
    const cv::Mat image =
        cv::imread(a.images + "/" + name, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);  // as the database's
    if (image.empty()) {
      ROS_WARN("%s is left out: it cannot be read as an image", name.c_str());
      continue;
    }
    air_ground_common::CameraModel camera = album.common ? *album.common : album.single.at(name);
    if (!album.common) camera.width = image.cols, camera.height = image.rows;
    std_msgs::Header header;
    header.stamp = ros::Time::now();
    header.frame_id = a.frame;
    infos.publish(ru::toMsg(camera, header));
    kPause.sleep();  // the calibration first
    images.publish(ru::toMsg(image, "bgr8", header));
    ros::WallDuration(a.period).sleep();
    ++published;
  }
  return published;
}

/// Until both topics have a listener; says every ten seconds which one has none.
void waitForListeners(const ros::Publisher& images, const ros::Publisher& infos) {
  ros::WallTime said = ros::WallTime::now();
  for (; ros::ok(); kPause.sleep()) {
    std::string alone;
    for (const ros::Publisher* topic : {&images, &infos})
      if (topic->getNumSubscribers() == 0) alone += (alone.empty() ? "" : " and ") + topic->getTopic();
    if (alone.empty()) return;
    if (ros::WallTime::now() - said < kReminder) continue;
    said = ros::WallTime::now();
    ROS_WARN(
        "no photograph is played before a node listens to %s: does the one that takes them run, has it loaded its "
        "database, and does it listen to these names (rosnode info)?",
        alone.c_str());
  }
}

void run(const Arguments& a) {
  if (!a.folder.empty()) std::filesystem::current_path(a.folder);
  const Album album = readAlbum(a);
  ros::NodeHandle handle;
  ros::Publisher images = handle.advertise<sensor_msgs::Image>("mav/camera/image_raw", 5);
  ros::Publisher infos = handle.advertise<sensor_msgs::CameraInfo>("mav/camera/camera_info", 5);
  tf2_ros::StaticTransformBroadcaster mount;
  if (!a.base_frame.empty()) {  // photographs have no body: the camera looks along its x axis
    air_ground_common::Pose T_base_camera = air_ground_common::Pose::Identity();
    T_base_camera.linear() = air_ground_common::opticalFromForwardBody().transpose();
    mount.sendTransform(ru::tfEdge(ros::Time(), a.base_frame, a.frame, T_base_camera));
  }
  waitForListeners(images, infos);
  do {
    // A round without a picture would not pause.
    if (play(a, album, images, infos) == 0 && ros::ok())
      throw std::runtime_error("none of the images of " + a.images + " can be read");
  } while (a.loop && ros::ok());
}

}  // namespace

int main(int argc, char** argv) {
  ros::init(argc, argv, "publish_images");
  CLI::App app("Plays a folder of photographs as a camera, on mav/camera/image_raw and mav/camera/camera_info.");
  Arguments a;
  app.add_option("--folder", a.folder,
                 "where relative names begin; roslaunch starts nodes elsewhere than it was started itself");
  app.add_option("--images", a.images, "folder of photographs")->required();
  app.add_option("--camera", a.camera, "calibration of all of them (ROS camera_info YAML)");
  app.add_option("--cameras", a.cameras,
                 "instead: lines of `image fx fy cx cy [k1 k2 p1 p2 k3]`; images not listed are left out");
  app.add_option("--frame", a.frame, "of the camera")->capture_default_str();
  app.add_option("--base-frame", a.base_frame, "if given, a fixed transform from it to the camera is published");
  app.add_option("--period", a.period, "between two images [s]")->capture_default_str()->check(CLI::Range(0.0, 3600.0));
  app.add_flag("--loop", a.loop, "begin again after the last image");
  app.allow_extras();  // roslaunch adds __name:= and the like, which ros::init reads
  CLI11_PARSE(app, argc, argv);
  try {
    run(a);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "publish_images: %s\n", e.what());
    return 1;
  }
  return 0;
}
