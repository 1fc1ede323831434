// Dense reconstruction of a recording with given poses: rosbag (ground truth or posed images) or folder in 7-Scenes
// layout. Writes a PLY and pictures for each fused map; with the true mesh, prints errors.
#include <air_ground/PosedImage.h>
#include <geometry_msgs/PoseStamped.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/PointCloud2.h>
#include <tf2_msgs/TFMessage.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "air_ground_common/mesh.h"
#include "air_ground_common/ros/compressed_image.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"
#include "air_ground_common/trajectory.h"
#include "dense_fusion/dense_mapper.h"

namespace {

using air_ground_common::CameraModel;
using air_ground_common::Pose;
using air_ground_common::quantile;
namespace ros_utils = air_ground_common::ros_utils;
namespace fs = std::filesystem;

struct Options {
  std::string input, mesh, out = "dense_out", posed_topic, sparse_topic, trajectory,
                           image_topic = "/mav/camera/image_raw", info_topic = "/mav/camera/camera_info",
                           pose_topic = "/ground_truth/mav";
  std::string camera_frame = "mav_camera_optical_frame";
  double depth_min = 0, depth_max = 0, focal = 525, up_x = 0, up_y = 0, up_z = 1, offset_x = 0;
  double noise_position = 0, noise_rotation = 0, readout_time = 0;
  int first = 0, last = 1000000, threads = 2;
  bool depth_maps = false, corners = false;
};

using ImageSink = std::function<void(const cv::Mat&, const CameraModel&, std::int64_t stamp, const Pose& T_map_camera,
                                     double, double)>;
using SparseSink = std::function<void(std::vector<Eigen::Vector3f>)>;

// Posed images as recorded from mav/posed_image, and sparse clouds of the same map if asked for.
void readPosedImages(const Options& options, const ImageSink& sink, const SparseSink& sparse_sink) {
  rosbag::Bag bag(options.input);
  std::vector<std::string> topics{options.posed_topic};
  if (!options.sparse_topic.empty()) topics.push_back(options.sparse_topic);
  rosbag::View view(bag, rosbag::TopicQuery(topics));
  for (const rosbag::MessageInstance& m : view) {
    if (const auto cloud = m.instantiate<sensor_msgs::PointCloud2>()) {
      std::size_t dropped = 0;
      std::vector<Eigen::Vector3f> points;
      for (const auto& p : ros_utils::cloudFromMsg(*cloud, &dropped)) points.push_back(p.position);
      sparse_sink(std::move(points));
    }
    const auto msg = m.instantiate<air_ground::PosedImage>();
    if (!msg || !msg->metric) continue;
    sink(ros_utils::greyFromMsg(*msg), ros_utils::fromMsg(msg->camera_info),
         static_cast<std::int64_t>(msg->header.stamp.toNSec()), ros_utils::fromMsg(msg->pose.pose), msg->depth_min,
         msg->depth_max);
  }
}

// Raw images with the true poses of the body.
void readTruth(const Options& options, const ImageSink& sink) {
  rosbag::Bag bag(options.input);
  air_ground_common::Trajectory trajectory;
  Pose T_base_camera = Pose::Identity();
  bool found = false;
  CameraModel camera;
  {
    rosbag::View view(
        bag, rosbag::TopicQuery(std::vector<std::string>{options.pose_topic, "/tf_static", options.info_topic}));
    for (const rosbag::MessageInstance& m : view) {
      if (const auto pose = m.instantiate<geometry_msgs::PoseStamped>())
        trajectory.push_back({pose->header.stamp.toSec(), ros_utils::fromMsg(pose->pose)});
      if (const auto info = m.instantiate<sensor_msgs::CameraInfo>(); info && camera.width == 0)
        camera = ros_utils::fromMsg(*info);
      if (const auto tf = m.instantiate<tf2_msgs::TFMessage>())
        for (const auto& t : tf->transforms)
          if (t.child_frame_id == options.camera_frame) {
            T_base_camera = ros_utils::fromMsg(t.transform);
            found = true;
          }
    }
  }
  if (found && !options.trajectory.empty()) {
    // Estimated camera poses, moved rigidly to the truth: what is left of drift and scale error shows in the result.
    air_ground_common::Trajectory truth = trajectory;
    for (auto& pose : truth) pose.T_map_body = pose.T_map_body * T_base_camera;
    trajectory = air_ground_common::readTum(options.trajectory);
    const auto error =
        air_ground_common::absoluteTrajectoryError(truth, trajectory, air_ground_common::Alignment::kRigid);
    std::printf("trajectory: RMS error %.4f m over %.1f m after rigid alignment\n", error.rmse, error.path_length);
    Pose T_truth_estimate = Pose::Identity();
    T_truth_estimate.linear() = error.reference_from_estimate.R;
    T_truth_estimate.translation() = error.reference_from_estimate.t;
    for (auto& pose : trajectory) pose.T_map_body = T_truth_estimate * pose.T_map_body;
    T_base_camera = Pose::Identity();
  }
  if (!found) throw std::runtime_error("no /tf_static transform to " + options.camera_frame + " in the bag");
  if (camera.width == 0) throw std::runtime_error("no camera_info on " + options.info_topic);
  rosbag::View view(bag, rosbag::TopicQuery(options.image_topic));
  for (const rosbag::MessageInstance& m : view) {
    const auto msg = m.instantiate<sensor_msgs::Image>();
    if (!msg) continue;
    const auto pose = air_ground_common::poseAt(trajectory, msg->header.stamp.toSec());
    if (pose)
      sink(ros_utils::greyFromMsg(*msg), camera, static_cast<std::int64_t>(msg->header.stamp.toNSec()),
           *pose * T_base_camera, 0, 0);
  }
}

// frame-000000.color.jpg and frame-000000.pose.txt (camera to world); the world is levelled by the given up direction.
void readFolder(const Options& options, const ImageSink& sink) {
  Pose T_level = Pose::Identity();
  T_level.linear() = air_ground_common::levelingRotation({options.up_x, options.up_y, options.up_z});
  for (int i = options.first; i <= options.last; ++i) {
    const std::string name = air_ground_common::formatted("frame-%06d", i);
    const fs::path base = fs::path(options.input) / name;
    std::ifstream file(base.string() + ".pose.txt");
    const cv::Mat image = cv::imread(base.string() + ".color.jpg", cv::IMREAD_GRAYSCALE);
    if (!file || image.empty()) break;
    Eigen::Matrix4d T;
    for (int k = 0; k < 16; ++k) file >> T(k / 4, k % 4);
    Pose pose = Pose::Identity();
    pose.matrix() = T;
    CameraModel camera;
    camera.width = image.cols;
    camera.height = image.rows;
    camera.fx = camera.fy = options.focal;
    camera.cx = 0.5 * image.cols;
    camera.cy = 0.5 * image.rows;
    sink(image, camera, static_cast<std::int64_t>(i / 30.0 * 1e9),
         T_level * air_ground_common::normalized(pose) * Pose(Eigen::Translation3d(options.offset_x, 0, 0)), 0, 0);
  }
}

// True depths of some rays, to stand in for the sparse points of visual odometry.
void depthRange(const air_ground_common::MeshScene& mesh, const CameraModel& camera, const Pose& T, double* near,
                double* far) {
  std::vector<double> depths;
  for (int v = 20; v < camera.height; v += 40)
    for (int u = 20; u < camera.width; u += 40) {
      const Eigen::Vector3d ray = T.linear() * camera.ray({u, v});
      if (const auto hit = mesh.cast(T.translation().cast<float>(), ray.cast<float>()))
        depths.push_back(hit->distance * camera.ray({u, v}).z());
    }
  *near = depths.empty() ? 0 : quantile(depths, 0.05);
  *far = depths.empty() ? 0 : quantile(depths, 0.95);
}

// Where rays through an image's corners meet the mesh, their depth wrong by 2 %: stand-ins for the sparse points of
// visual odometry.
void appendCorners(const air_ground_common::MeshScene& mesh, const cv::Mat& image, const CameraModel& camera,
                   const Pose& T, std::mt19937* random, std::vector<Eigen::Vector3f>* points) {
  std::vector<cv::Point2f> corners;
  constexpr int kCorners = 150, kSpacing = 15;
  cv::goodFeaturesToTrack(image, corners, kCorners, 0.01, kSpacing);
  std::normal_distribution<double> scale(1, 0.02);
  for (const cv::Point2f& corner : corners) {
    const Eigen::Vector3d ray = T.linear() * camera.ray({corner.x, corner.y});
    if (const auto hit = mesh.cast(T.translation().cast<float>(), ray.cast<float>()))
      points->push_back((T.translation() + scale(*random) * hit->distance * ray).cast<float>());
  }
}

// Depth minus true depth [m], CV_32F; NaN where the map knows nothing, infinity where the mesh has nothing.
cv::Mat depthErrors(const air_ground_common::MeshScene& mesh, const dense_fusion::DepthMap& map) {
  cv::Mat errors(map.depth.size(), CV_32F, cv::Scalar(std::numeric_limits<float>::quiet_NaN()));
  for (int v = 0; v < map.depth.rows; ++v)
    for (int u = 0; u < map.depth.cols; ++u) {
      const Eigen::Vector3d ray((u - map.camera.cx) / map.camera.fx, (v - map.camera.cy) / map.camera.fy, 1);
      const auto hit = mesh.cast(map.T_map_camera.translation().cast<float>(),
                                 (map.T_map_camera.linear() * ray.normalized()).cast<float>());
      errors.at<float>(v, u) = hit ? map.depth.at<float>(v, u) - static_cast<float>(hit->distance / ray.norm())
                                   : std::numeric_limits<float>::infinity();
    }
  return errors;
}

// Appends absolute errors; returns the share of the true surface in view that is known to 3 cm.
double collectErrors(const cv::Mat& errors, std::vector<double>* absolute) {
  std::size_t good = 0, seen = 0;
  for (int i = 0; i < errors.rows * errors.cols; ++i) {
    const double e = std::abs(errors.ptr<float>()[i]);
    if (std::isfinite(e)) absolute->push_back(e);
    seen += !std::isinf(e);
    good += e < 0.03;
  }
  return static_cast<double>(good) / static_cast<double>(std::max<std::size_t>(1, seen));
}

// Depth from near (red) to far (blue), black where unknown, beside the reference image; and errors where they are
// known, from too near (blue) over right (white) to 5 cm too far (red).
void drawDepth(const std::string& path, const dense_fusion::DepthMap& map, const cv::Mat& errors) {
  std::vector<double> depths;
  for (int i = 0; i < map.depth.rows * map.depth.cols; ++i)
    if (const float z = map.depth.ptr<float>()[i]; !std::isnan(z)) depths.push_back(z);
  if (depths.empty()) return;
  const double near = quantile(depths, 0.01), far = std::max(near + 0.01, quantile(depths, 0.99));
  cv::Mat scaled(map.depth.size(), CV_8U), coloured, picture;
  for (int i = 0; i < map.depth.rows * map.depth.cols; ++i)
    scaled.data[i] = cv::saturate_cast<std::uint8_t>(255 * (far - map.depth.ptr<float>()[i]) / (far - near));
  cv::applyColorMap(scaled, coloured, cv::COLORMAP_JET);
  coloured.setTo(cv::Scalar(0, 0, 0), map.confidence <= 0);
  cv::cvtColor(map.intensity, picture, cv::COLOR_GRAY2BGR);
  cv::hconcat(picture, coloured, picture);
  if (!errors.empty()) {
    cv::Mat drawn(errors.size(), CV_8UC3, cv::Scalar(0, 0, 0));
    for (int v = 0; v < errors.rows; ++v)
      for (int u = 0; u < errors.cols; ++u) {
        const float e = errors.at<float>(v, u);
        if (!std::isfinite(e)) continue;
        const auto rest = cv::saturate_cast<std::uint8_t>(255 - 255 * std::abs(e) / 0.05f);
        drawn.at<cv::Vec3b>(v, u) = e > 0 ? cv::Vec3b(rest, rest, 255) : cv::Vec3b(255, rest, rest);
      }
    cv::hconcat(picture, drawn, picture);
  }
  cv::imwrite(path, picture);
}

// Highest point a cell seen from above: heights in colour beside grey levels, 50 cells a metre.
void drawFromAbove(const std::string& path, const std::vector<dense_fusion::SurfacePoint>& points) {
  if (points.empty()) return;
  Eigen::Vector3f lower = points[0].position, upper = lower;
  for (const auto& p : points) {
    lower = lower.cwiseMin(p.position);
    upper = upper.cwiseMax(p.position);
  }
  constexpr float kCells = 50;
  const int width = static_cast<int>((upper.x() - lower.x()) * kCells) + 1,
            height = static_cast<int>((upper.y() - lower.y()) * kCells) + 1;
  cv::Mat z(height, width, CV_32F, cv::Scalar(-1e9)), grey = cv::Mat::zeros(height, width, CV_8U), scaled, coloured,
                                                      grey3, both;
  for (const auto& p : points) {
    const int x = static_cast<int>((p.position.x() - lower.x()) * kCells),
              y = height - 1 - static_cast<int>((p.position.y() - lower.y()) * kCells);
    if (p.position.z() <= z.at<float>(y, x)) continue;
    z.at<float>(y, x) = p.position.z();
    grey.at<std::uint8_t>(y, x) = p.intensity;
  }
  const double range = std::max(0.05f, upper.z() - lower.z());
  z.convertTo(scaled, CV_8U, 255 / range, -255 * lower.z() / range);
  cv::applyColorMap(scaled, coloured, cv::COLORMAP_JET);
  coloured.setTo(cv::Scalar(0, 0, 0), z < -1e8);
  cv::cvtColor(grey, grey3, cv::COLOR_GRAY2BGR);
  cv::hconcat(grey3, coloured, both);
  cv::imwrite(path, both);
}

struct Report {
  std::vector<double> depth_map, fused, cloud, complete, complete_single;
  int maps = 0;
};

void reportFused(const Options& options, const dense_fusion::FusedMap& fused, const air_ground_common::MeshScene* mesh,
                 Report* report) {
  const std::string name = air_ground_common::formatted("fused_%03d", report->maps++);
  const std::string base = (fs::path(options.out) / name).string();
  std::vector<air_ground_common::LabeledPoint> cloud;
  for (const auto& p : fused.points) {
    air_ground_common::LabeledPoint point;
    point.position = p.position;
    point.rgb.setConstant(p.intensity);
    point.source = 1;
    cloud.push_back(point);
  }
  air_ground_common::writePly(base + ".ply", cloud);
  const cv::Mat errors = mesh ? depthErrors(*mesh, fused.depth_map) : cv::Mat();
  drawDepth(base + "_view.png", fused.depth_map, errors);
  drawFromAbove(base + "_above.png", fused.points);
  std::printf(
      "%s: %d depth maps, grid %dx%dx%d of %.4f m, %zu points, support %.1f, votes %.0f + TV-L1 %.0f + surface %.0f ms",
      name.c_str(), fused.depth_maps, fused.grid.nx, fused.grid.ny, fused.grid.nz, fused.grid.voxel_size,
      fused.points.size(), fused.mean_support, 1e3 * fused.timings.votes, 1e3 * fused.timings.minimisation,
      1e3 * fused.timings.surface);
  if (mesh) {
    std::vector<double> view, surface;
    report->complete.push_back(collectErrors(errors, &view));
    for (const auto& p : fused.points) surface.push_back(mesh->distance(p.position, 1.f));
    std::printf("; depth median %.4f 95%% %.4f m, cloud to mesh median %.4f 95%% %.4f m", quantile(view, 0.5),
                quantile(view, 0.95), quantile(surface, 0.5), quantile(surface, 0.95));
    report->fused.insert(report->fused.end(), view.begin(), view.end());
    report->cloud.insert(report->cloud.end(), surface.begin(), surface.end());
  }
  std::printf("\n");
  std::fflush(stdout);
}

/// `report`: against the true surface; null where it is not known.
void printFigures(const dense_fusion::MapperCounters& c, double seconds, const Report* report) {
  std::printf(
      "%zu images (%zu redundant), %zu sweeps, %zu depth maps (%zu poor), %zu fused (%zu groups too small), %.1f ms an "
      "image\n",
      c.images, c.redundant, c.swept, c.depth_maps, c.poor_depth_maps, c.fused, c.small_groups,
      1e3 * seconds / std::max<std::size_t>(1, c.images));
  if (report)
    std::printf(
        "single depth maps: median %.4f 95%% %.4f m, %.1f %% of a view known to 3 cm\nfused depth maps: median %.4f "
        "95%% %.4f m, %.1f %% of a view known to 3 cm\ncloud to mesh: median %.4f 95%% %.4f m, %zu points\n",
        quantile(report->depth_map, 0.5), quantile(report->depth_map, 0.95),
        100 * quantile(report->complete_single, 0.5), quantile(report->fused, 0.5), quantile(report->fused, 0.95),
        100 * quantile(report->complete, 0.5), quantile(report->cloud, 0.5), quantile(report->cloud, 0.95),
        report->cloud.size());
}

int run(const Options& options, const dense_fusion::MapperSettings& settings) {
  fs::create_directories(options.out);
  std::unique_ptr<air_ground_common::MeshScene> mesh;
  if (!options.mesh.empty())
    mesh = std::make_unique<air_ground_common::MeshScene>(air_ground_common::readPlyMesh(options.mesh));
  dense_fusion::DenseMapper mapper(settings);
  Report report;
  int depth_maps = 0;
  mapper.onDepthMap([&](const dense_fusion::DepthMap& map) {
    const cv::Mat errors = mesh ? depthErrors(*mesh, map) : cv::Mat();
    if (mesh) report.complete_single.push_back(collectErrors(errors, &report.depth_map));
    if (options.depth_maps)
      drawDepth((fs::path(options.out) / ("depth_" + std::to_string(depth_maps) + ".png")).string(), map, errors);
    ++depth_maps;
  });
  std::mt19937 random(1);
  std::normal_distribution<double> normal(0, 1);
  std::vector<Eigen::Vector3f> corners;
  int images = 0;
  double seconds = 0;
  const ImageSink sink = [&](const cv::Mat& image, const CameraModel& camera, std::int64_t stamp, const Pose& T,
                             double near, double far) {
    const int index = images++;
    const bool folder = fs::is_directory(options.input);
    if (!folder && (index < options.first || index > options.last)) return;
    if (options.depth_max > 0) {
      near = options.depth_min;
      far = options.depth_max;
    } else if (mesh && !(far > 0)) {
      depthRange(*mesh, camera, T, &near, &far);
    }
    constexpr int kCornersEvery = 20;
    if (options.corners && mesh && index % kCornersEvery == 0) {
      appendCorners(*mesh, image, camera, T, &random, &corners);
      mapper.setSparsePoints(corners);
    }
    Pose noisy = T;
    const auto draw = [&](double sigma) {
      return Eigen::Vector3d(sigma * normal(random), sigma * normal(random), sigma * normal(random));
    };
    noisy.translation() += draw(options.noise_position);
    noisy.linear() = T.linear() * air_ground_common::expSO3(draw(options.noise_rotation));
    const auto start = std::chrono::steady_clock::now();
    const auto fused = mapper.add(image, camera, stamp, noisy, near, far, options.readout_time);
    seconds += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    if (fused) reportFused(options, *fused, mesh.get(), &report);
  };
  if (fs::is_directory(options.input))
    readFolder(options, sink);
  else if (!options.posed_topic.empty())
    readPosedImages(options, sink,
                    [&](std::vector<Eigen::Vector3f> points) { mapper.setSparsePoints(std::move(points)); });
  else
    readTruth(options, sink);
  if (const auto fused = mapper.flush()) reportFused(options, *fused, mesh.get(), &report);
  printFigures(mapper.counters(), seconds, mesh ? &report : nullptr);
  return mapper.counters().fused > 0 ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  dense_fusion::MapperSettings settings;
  CLI::App app("Dense reconstruction of a recording whose camera poses are known");
  app.add_option("input", options.input, "rosbag, or folder with frame-*.color.jpg and frame-*.pose.txt")
      ->required()
      ->check(CLI::ExistingPath);
  app.add_option("--out", options.out, "folder for PLY and PNG files");
  app.add_option("--mesh", options.mesh, "true mesh in the poses' frame (PLY): prints errors")
      ->check(CLI::ExistingFile);
  app.add_option("--posed-image-topic", options.posed_topic,
                 "take images and poses from this topic instead of raw images and truth");
  app.add_option("--sparse-cloud-topic", options.sparse_topic,
                 "with posed images: sparse points that bound the voxel grid");
  app.add_flag("--sparse-corners", options.corners,
               "without posed images: points of --mesh at corners of the images bound the voxel grid");
  app.add_option("--image-topic", options.image_topic, "raw images");
  app.add_option("--camera-info-topic", options.info_topic, "calibration");
  app.add_option("--pose-topic", options.pose_topic, "true poses of the body");
  app.add_option("--trajectory", options.trajectory,
                 "estimated camera poses (TUM) to use instead of the truth, moved rigidly to it")
      ->check(CLI::ExistingFile);
  app.add_option("--camera-frame", options.camera_frame, "optical frame in /tf_static");
  app.add_option("--depth-min", options.depth_min, "expected depths in view [m]; else from the mesh");
  app.add_option("--depth-max", options.depth_max, "expected depths in view [m]; else from the mesh");
  app.add_option("--focal", options.focal, "focal length of a folder's images [px]");
  app.add_option("--offset-x", options.offset_x, "x of a folder's colour camera in the frame that its poses give [m]");
  app.add_option("--up-x", options.up_x, "up direction in a folder's world frame");
  app.add_option("--up-y", options.up_y, "up direction in a folder's world frame");
  app.add_option("--up-z", options.up_z, "up direction in a folder's world frame");
  app.add_option("--first", options.first, "first image");
  app.add_option("--last", options.last, "last image");
  app.add_option("--readout-time", options.readout_time, "of a rolling shutter [s]");
  app.add_option("--noise-position", options.noise_position, "white noise added to the poses [m]");
  app.add_option("--noise-rotation", options.noise_rotation, "white noise added to the poses [rad]");
  app.add_option("--threads", options.threads, "threads");
  app.add_option("--voxel-size", settings.fusion.voxel_size, "[m]");
  app.add_option("--voxel-pixels", settings.fusion.voxel_pixels, "least edge of a voxel [px of the swept images]");
  app.add_option("--truncation-voxels", settings.fusion.truncation_voxels, "half width of the band [voxels]");
  app.add_option("--behind-voxels", settings.fusion.behind_voxels, "reach of votes for matter beyond it [voxels]");
  app.add_option("--lambda", settings.fusion.tv_l1.lambda, "weight of the votes");
  app.add_option("--iterations", settings.fusion.tv_l1.iterations, "of TV-L1 at full resolution");
  app.add_option("--min-support", settings.fusion.min_support, "depth maps that must agree");
  app.add_option("--min-agreeing", settings.fusion.min_agreeing, "depth maps that must agree with a point");
  app.add_option("--agreement", settings.fusion.agreement, "how near [voxels]");
  app.add_option("--fill-radius", settings.fusion.fill_radius, "[voxels]");
  app.add_option("--sparse-margin", settings.fusion.sparse_margin, "room around the sparse points [m]");
  app.add_option("--refine", settings.fusion.refine, "sub-voxel correction");
  app.add_option("--sweep-radius", settings.sweep_radius, "[m]");
  app.add_option("--frame-spacing", settings.frame_spacing, "[m]");
  app.add_option("--fusion-radius", settings.fusion_radius, "[m]");
  app.add_option("--overlap", settings.overlap, "[m]");
  app.add_option("--hypotheses", settings.sweep.hypotheses, "planes of the sweep");
  app.add_option("--aggregation-radius", settings.sweep.aggregation_radius, "[px]");
  app.add_option("--min-confidence", settings.sweep.min_confidence, "0..1");
  app.add_option("--max-peak-ratio", settings.sweep.max_peak_ratio, "0..1");
  app.add_option("--contrast-floor", settings.rectifier.contrast_floor, "[grey levels]");
  app.add_option("--normalization-radius", settings.rectifier.normalization_radius, "[px]");
  app.add_option("--scale", settings.rectifier.scale, "size of the swept images");
  app.add_option("--max-field", settings.rectifier.max_field, "field of view used of wide-angle images [rad]");
  app.add_flag("--write-depth-maps", options.depth_maps, "also draw every single depth map");
  CLI11_PARSE(app, argc, argv);
  settings.fusion.threads = settings.sweep.threads = options.threads;
  try {
    return run(options, settings);
  } catch (const std::exception& e) {
    std::cerr << "dense_offline: " << e.what() << std::endl;
    return 1;
  }
}
