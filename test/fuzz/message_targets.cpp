// What the nodes' callbacks make of hostile messages before their libraries see them, and the libraries behind.
#include <sensor_msgs/Imu.h>

#include <cmath>

#include "../../ekf_tracker_node/src/ros/sensor_bridge.h"
#include "../../icp_refine_node/src/ros/alignment_input.h"
#include "../../view_match_node/src/ros/messages.h"
#include "air_ground_common/encoded_image.h"
#include "air_ground_common/rectification.h"
#include "air_ground_common/ros/compressed_image.h"
#include "air_ground_common/ros/conversions.h"
#include "air_ground_common/ros/map_correction.h"
#include "ekf_tracker/tilt_source.h"
#include "fuzzing.h"
#include "heightmap_mcl/height_map.h"
#include "icp_refine/alignment_refiner.h"
#include "icp_refine/augmented_map.h"
#include "icp_refine/icp.h"

namespace air_ground_fuzz {
namespace {

namespace ru = air_ground_common::ros_utils;

std_msgs::Header headerFrom(Source& source) {
  std_msgs::Header header;
  // Near each other, or anything that a stamp can hold.
  const auto kind = source.take<std::uint8_t>();
  header.stamp = kind < 250 ? ros::Time(1000, kind * 4000000u) : ros::Time(source.take<std::uint32_t>(), 5u);
  return header;
}

template <typename Array>
void fill(Source& source, Array* values) {
  for (auto& v : *values) v = source.number();
}

geometry_msgs::Pose poseFrom(Source& source) {
  geometry_msgs::Pose pose;
  pose.orientation.w = 1;
  const auto kind = source.take<std::uint8_t>();
  if (kind & 1)
    for (double* v : {&pose.position.x, &pose.position.y, &pose.position.z}) *v = source.number();
  if (kind & 2)
    for (double* v : {&pose.orientation.x, &pose.orientation.y, &pose.orientation.z, &pose.orientation.w})
      *v = source.number();
  return pose;
}

const char* const kEncodings[] = {"mono8", "mono16", "bgr8", "rgb8", "bgra8", "rgba8",  "bayer_rggb8", "bayer_gbrg16",
                                  "16UC1", "32FC1",  "8UC1", "8UC3", "64FC4", "yuv422", "16SC2",       "rgb16"};

void readImage(const sensor_msgs::Image& image) {
  answers([&] { require(ru::greyFromMsg(image).type() == CV_8UC1, "grey image"); });
  answers([&] { require(ru::bgrFromMsg(image).type() == CV_8UC3, "colour image"); });
  answers([&] { require(ru::depthFromMsg(image).type() == CV_32FC1, "depth image"); });
}

void image(const Bytes& bytes) {
  Source source(bytes);
  sensor_msgs::Image msg;
  const auto kind = source.take<std::uint8_t>();
  msg.encoding = kind < std::size(kEncodings) ? kEncodings[kind] : source.text(255);
  const bool large = source.take<std::uint8_t>() == 0;
  msg.height = large ? source.take<std::uint32_t>() : source.take<std::uint8_t>();
  msg.width = large ? source.take<std::uint32_t>() : source.take<std::uint8_t>();
  msg.step = large ? source.take<std::uint32_t>() : source.take<std::uint16_t>();
  msg.is_bigendian = source.take<std::uint8_t>();
  msg.data = source.rest();
  // Half of the inputs have the length that they state.
  if (!large && source.empty() && kind % 2) msg.data.resize(static_cast<std::size_t>(msg.step) * msg.height);
  readImage(msg);
}

void compressedImage(const Bytes& bytes) {
  Source source(bytes);
  const char* const formats[] = {"jpeg",
                                 "png",
                                 "32FC1; compressedDepth png",
                                 "16UC1; compressedDepth png",
                                 "mono16; png compressed",
                                 "16UC1; compressedDepth rvl"};
  sensor_msgs::CompressedImage msg;
  msg.format = formats[source.take<std::uint8_t>() % std::size(formats)];
  msg.data = source.rest();
  answers([&] { readImage(*ru::decompressed(msg)); });
}

void cameraInfo(const Bytes& bytes) {
  Source source(bytes);
  const char* const models[] = {"plumb_bob", "rational_polynomial", "equidistant", "", "fisheye"};
  sensor_msgs::CameraInfo msg;
  const auto kind = source.take<std::uint8_t>();
  msg.distortion_model = kind < std::size(models) ? models[kind] : source.text(40);
  msg.width = source.take<std::uint32_t>() >> source.take<std::uint8_t>() % 32;
  msg.height = source.take<std::uint32_t>() >> source.take<std::uint8_t>() % 32;
  for (const int i : {0, 2, 4, 5}) msg.K[static_cast<std::size_t>(i)] = 100 * source.number();
  msg.D.resize(source.take<std::uint8_t>() % 16);
  fill(source, &msg.D);
  if (source.take<std::uint8_t>() % 2) {
    for (std::uint32_t* v :
         {&msg.roi.x_offset, &msg.roi.y_offset, &msg.roi.width, &msg.roi.height, &msg.binning_x, &msg.binning_y})
      *v = source.take<std::uint32_t>() >> source.take<std::uint8_t>() % 32;
  }
  answers([&] {
    const auto camera = ru::fromMsg(msg);
    require(camera.width > 0 && camera.height > 0, "size of the image");
    require(std::int64_t{camera.width} * camera.height <= air_ground_common::kMaxImagePixels, "pixels of the image");
    camera.unproject({0, 0});
    camera.unproject({0.7 * camera.width, 0.4 * camera.height});
    camera.project({0.3, -0.2, 1});
    if (camera.width > 2000 || camera.height > 2000) return;
    const auto view = air_ground_common::centralPinhole(camera, 1.7);
    require(view.width <= 4 * camera.width && view.height <= 4 * camera.height, "pinhole");
    air_ground_common::rectificationMap(camera, view);
  });
}

sensor_msgs::PointCloud2 cloudFrom(Source& source) {
  sensor_msgs::PointCloud2 msg;
  const char* const names[] = {"x", "y", "z", "rgb", "intensity", "source"};
  const bool large = source.take<std::uint8_t>() == 0;
  const int fields = source.take<std::uint8_t>() % 8;
  for (int i = 0; i < fields; ++i) {
    sensor_msgs::PointField field;
    field.name = names[source.take<std::uint8_t>() % std::size(names)];
    field.datatype = source.take<std::uint8_t>() % 9;
    field.offset = large ? source.take<std::uint32_t>() : source.take<std::uint8_t>();
    field.count = source.take<std::uint8_t>();
    msg.fields.push_back(field);
  }
  if (fields == 0)  // as ours are
    return ru::toMsg(std::vector<ru::CloudPoint>(), ru::CloudFields::kXyzRgb, std_msgs::Header());
  msg.height = large ? source.take<std::uint32_t>() : source.take<std::uint8_t>();
  msg.width = large ? source.take<std::uint32_t>() : source.take<std::uint8_t>();
  msg.point_step = large ? source.take<std::uint32_t>() : source.take<std::uint8_t>();
  msg.row_step = large ? source.take<std::uint32_t>() : msg.point_step * msg.width;
  msg.data = source.rest();
  if (!large) msg.data.resize(static_cast<std::size_t>(msg.row_step) * msg.height);
  return msg;
}

void pointCloud(const Bytes& bytes) {
  Source source(bytes);
  const sensor_msgs::PointCloud2 msg = cloudFrom(source);
  answers([&] {
    std::size_t dropped = 0;
    const auto points = ru::cloudFromMsg(msg, &dropped);
    require(points.size() + dropped == static_cast<std::size_t>(msg.width) * msg.height, "count of the points");
    for (const auto& p : points) require(p.position.cwiseAbs().maxCoeff() <= 1e6f, "point");
  });
}

// Finite points are anywhere that a float can be.
std::vector<Eigen::Vector3f> pointsFrom(Source& source, int count) {
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < count; ++i) {
    Eigen::Vector3f p;
    for (int k = 0; k < 3; ++k) p[k] = static_cast<float>(std::max(-3e38, std::min(3e38, source.number())));
    if (p.allFinite()) points.push_back(p);
  }
  return points;
}

void heightMaps(const Bytes& bytes) {
  Source source(bytes);
  heightmap_mcl::HeightMapSettings settings;
  settings.resolution = 0.1;
  const auto kind = source.take<std::uint8_t>();
  settings.tops = static_cast<heightmap_mcl::Tops>(kind % 3);
  settings.drop_hanging = kind & 4;
  settings.max_spike = kind & 8 ? 0.5 : 0;
  settings.height_quantile = kind & 16 ? 0.9 : 1;
  const auto first = heightmap_mcl::buildHeightMap(pointsFrom(source, 40), settings);
  const auto second = heightmap_mcl::buildHeightMap(pointsFrom(source, 40), settings, nullptr, &first.levels);
  for (const auto* map : {&first, &second})
    require(map->heights.size() == static_cast<std::size_t>(map->width) * static_cast<std::size_t>(map->height),
            "height map");
  if (heightmap_mcl::unionExtent({&first, &second}) < 100)
    heightmap_mcl::merge({&first, &second}, heightmap_mcl::Merge::kMean);
}

icp_refine::IcpChain smallChain() {
  return icp_refine::IcpChain::fromString(
      "{reading_filters: [{VoxelGrid: {leaf: 0.1}}, {StatisticalOutlier: {neighbors: 4}}, SurfaceNormals, "
      "OrientNormals], "
      "reference_filters: [{VoxelGrid: {leaf: 0.1}}, SurfaceNormals, OrientNormals], levels: [{matcher: KdTree, "
      "outlier_filters: "
      "[NormalAngle, Cauchy], error_minimizer: {PointToPlane: {dof: 7}}, checkers: [{Iterations: {max: 5}}]}]}");
}

void alignment(const Bytes& bytes) {
  static const auto chain = smallChain();
  Source source(bytes);
  icp_refine::Cloud reading, reference;
  reading.points = pointsFrom(source, 60);
  reference.points = pointsFrom(source, 60);
  const auto prepared = chain.prepareReference(reference);
  const auto result = chain.align(chain.prepareReading(reading), prepared, icp_refine::Similarity());
  if (result.outcome == icp_refine::IcpResult::Outcome::kConverged)
    require(result.T_reference_reading.t.allFinite() && result.T_reference_reading.scale > 0, "alignment");
}

// A cloud as cloudFromMsg may give it: any points, or a floor with a box on it, whose points are moved a little.
icp_refine::Cloud mapFrom(Source& source) {
  constexpr float kFarthest = 1e6f;
  icp_refine::Cloud cloud;
  const auto kind = source.take<std::uint8_t>();
  if (kind % 2) cloud.points = pointsFrom(source, kind / 4);
  for (Eigen::Vector3f& p : cloud.points) p = p.cwiseMax(-kFarthest).cwiseMin(kFarthest);
  for (int i = 0; kind & 2 && i < 324; ++i) {
    const float u = 0.1f * static_cast<float>(i % 18), v = 0.1f * static_cast<float>(i / 18);
    cloud.points.emplace_back(u, v, u > 0.5f && v > 0.3f && u + v < 2 ? 0.4f : 0.f);
    if (!source.empty()) cloud.points.back().z() += 0.001f * static_cast<float>(source.take<std::int8_t>());
  }
  return cloud;
}

// All that icp_refine's callbacks hand on, in any order.
void refinement(const Bytes& bytes) {
  namespace ir = icp_refine;
  Source source(bytes);
  ir::RefinerSettings settings;
  settings.min_points = 10;
  settings.retries = 1;
  ir::AlignmentRefiner refiner(smallChain(), settings);
  ir::AugmentedMapSettings map_settings;
  map_settings.max_voxels = 500;
  ir::AugmentedMap map(map_settings);
  for (int messages = 0; messages < 20 && !source.empty(); ++messages) {
    const auto kind = source.take<std::uint8_t>() % 10;  // 9: nothing
    answers([&] {
      air_ground::AlignmentEstimate estimate;
      estimate.scale = 1;
      estimate.pose.pose = poseFrom(source);
      for (std::size_t i = 0; i < 36; i += 7) estimate.pose.covariance[i] = 1e-4;
      if (kind == 0) refiner.setCoarse(ir::poseOf(ir::coarseAlignmentFrom(estimate, false).T_ground_map_mav_map));
      if (kind == 1)
        refiner.setManual(ir::alignmentFrom(ru::fromMsg(estimate.pose.pose), ru::fromMsg(poseFrom(source))));
      if (kind == 2) {
        estimate.scale_stddev = source.number();
        estimate.reference_point.x = source.number();
        refiner.setViews(ir::viewAlignmentFrom(estimate, true));
      }
      if (kind == 3) refiner.setScaleDeviation(source.number());
      if (kind == 4) refiner.groundMoved();
      if (kind == 5) refiner.setGroundCamera(source.number());
      if (kind == 6) refiner.setGround(mapFrom(source));
      if (kind == 7) {
        const ir::Cloud cloud = mapFrom(source);
        std::vector<ir::LabeledPoint> points(cloud.size());
        for (std::size_t i = 0; i < points.size(); ++i) points[i].position = cloud.points[i];
        map.addAerial(messages, std::move(points));
        refiner.addAerial(messages, cloud);
      }
      if (kind == 8) {
        air_ground::CloudCorrections msg;
        for (int i = 0; i < messages; ++i) {
          msg.stamps.emplace_back(0, static_cast<std::uint32_t>(i));
          msg.poses.push_back(poseFrom(source));
          msg.scales.push_back(source.take<std::uint8_t>() % 2 ? 1.01 : source.number());
        }
        const auto corrections = ru::fromMsg(msg);
        map.correctAerial(corrections);
        refiner.correctAerial(corrections);
      }
    });
    if (kind < 9 && !source.empty()) continue;
    const ir::RefineOutcome out = refiner.refine();
    if (out.status != ir::RefineStatus::kConverged) continue;
    require(out.T_ground_map_mav_map.t.allFinite() && out.T_ground_map_mav_map.scale > 0, "refined pose");
    require(out.covariance.allFinite(), "covariance of the refined pose");
    map.align(out.T_ground_map_mav_map);
    for (const auto& p : map.points()) require(p.position.allFinite(), "point of the augmented map");
  }
}

// Keyframes and recognised cameras, and what icp_refine makes of an alignment by views.
void views(const Bytes& bytes) {
  Source source(bytes);
  air_ground::MapKeyframes msg;
  const auto keyframes = source.take<std::uint8_t>() % 5;
  for (int i = 0; i < keyframes; ++i) {
    msg.ids.push_back(source.take<std::uint8_t>());
    msg.poses.push_back(poseFrom(source));
    air_ground::KeyframeFeatures features;
    features.id = source.take<std::uint8_t>() % 4 ? msg.ids.back() : source.take<std::uint8_t>();
    for (const Eigen::Vector3f& p : pointsFrom(source, source.take<std::uint8_t>() % 40)) {
      geometry_msgs::Point32 point;
      point.x = p.x(), point.y = p.y(), point.z = p.z();
      features.points.push_back(point);
    }
    features.descriptors.resize(features.points.size() * 32 + source.take<std::uint8_t>() / 250);
    for (auto& byte : features.descriptors) byte = source.take<std::uint8_t>();
    msg.features.push_back(features);
  }
  view_match::ViewMatcher matcher({});
  answers([&] {
    const auto poses = view_match::posesOf(msg);
    for (const auto& features : msg.features)
      if (poses.count(features.id)) matcher.addKeyframe(view_match::viewOf(features, poses.at(features.id)));
    matcher.setPoses(poses);
  });
  matcher.matchWaiting();

  std::vector<view_match::CameraInBoth> cameras;
  while (!source.empty() && cameras.size() < 8) {
    view_match::CameraInBoth camera;
    const bool good = answers([&] {
      camera.T_a_camera = ru::fromMsg(poseFrom(source));
      camera.T_b_camera = ru::fromMsg(poseFrom(source));
    });
    if (source.take<std::uint8_t>() % 2) camera.scale = std::abs(source.number()), camera.scale_stddev = 0.03;
    if (good) cameras.push_back(camera);
  }
  const auto found = view_match::consensusOf(cameras, {});
  if (!found.found) return;
  require(found.T_a_b.t.allFinite() && found.T_a_b.scale > 0 && found.covariance.allFinite(), "alignment by views");
  view_match::MatchEstimate estimate;
  estimate.T_ground_mav = found.T_a_b;
  estimate.covariance = found.covariance;
  answers([&] {
    const auto read = icp_refine::viewAlignmentFrom(view_match::toMsg(estimate), true);
    icp_refine::IcpResult icp;
    icp.centre = read.centre;
    require(icp_refine::heldBy(read, icp).allFinite(), "covariance by views");
  });
}

// From `last` on, which it moves, or at any time.
air_ground::VoIncrement incrementFrom(Source& source, const std_msgs::Header& header, ros::Time* last) {
  air_ground::VoIncrement msg;
  msg.header = header;
  msg.previous_stamp = last ? *last : headerFrom(source).stamp;
  if (last) *last = msg.header.stamp = *last + ros::Duration(0.05);
  msg.relative_pose = poseFrom(source);
  if (source.take<std::uint8_t>() % 2)
    for (std::size_t i = 0; i < 16; i += 5) msg.covariance[i] = 1e-4;
  else
    fill(source, &msg.covariance);
  msg.metric = source.take<std::uint8_t>() % 4 != 0;
  msg.scale_variance = source.number();
  msg.map_id = source.take<std::uint8_t>() % 3;
  return msg;
}

geometry_msgs::PoseWithCovarianceStamped fixFrom(Source& source, const std_msgs::Header& header) {
  geometry_msgs::PoseWithCovarianceStamped msg;
  msg.header = header;
  msg.pose.pose = poseFrom(source);
  if (source.take<std::uint8_t>() % 2)
    for (std::size_t i = 0; i < 36; i += 7) msg.pose.covariance[i] = i < 21 ? 0.1 : 0.001;
  else
    fill(source, &msg.pose.covariance);
  return msg;
}

// All sensors of the tracker in any order, at any time, with anything in them.
void tracking(const Bytes& bytes) {
  namespace ek = ekf_tracker;
  Source source(bytes);
  static const air_ground_common::LocalFrame frame("EPSG:2056", {2683500, 1247800, 410});
  ek::NodeSettings settings;
  settings.level_increments = source.take<std::uint8_t>() % 2;
  settings.declination = 0.05;
  ek::SensorBridge bridge(settings, &frame);
  ek::TiltSource tilts;
  ek::TiltFilter filter;
  ek::Tracker tracker;
  ros::Time last(1000, 0);
  for (int messages = 0; messages < 200 && !source.empty(); ++messages) {
    const auto kind = source.take<std::uint8_t>() % 8;
    const std_msgs::Header header = headerFrom(source);
    answers([&] {
      if (kind <= 2) {
        const air_ground::VoIncrement msg = incrementFrom(source, header, kind == 0 ? &last : nullptr);
        filter.turn(msg.previous_stamp.toSec(), msg.header.stamp.toSec(), ru::fromMsg(msg.relative_pose).linear());
        auto tilt = filter.at(msg.header.stamp.toSec());
        if (const auto R = tilts.accelerometerTiltAt(msg.header.stamp.toSec()); R && !tilt)
          tilt = ek::Tilt{*R, ek::TiltFilter::kForceStddev};
        tracker.addIncrement(bridge.increment(msg, tilt));
      } else if (kind == 3) {
        const geometry_msgs::PoseWithCovarianceStamped msg = fixFrom(source, header);
        tracker.addMeasurement(bridge.fix(msg));
        if (const auto vertical = ek::SensorBridge::vertical(msg)) filter.addVertical(*vertical);
      } else if (kind == 4) {
        sensor_msgs::NavSatFix msg;
        msg.header = header;
        msg.latitude = 47.37 + source.number(), msg.longitude = 8.54 + source.number(), msg.altitude = source.number();
        msg.position_covariance_type = source.take<std::uint8_t>();
        fill(source, &msg.position_covariance);
        if (const auto m = bridge.gps(msg)) tracker.addMeasurement(*m);
      } else if (kind == 5) {
        sensor_msgs::FluidPressure msg;
        msg.header = header;
        msg.fluid_pressure = 95000 + source.number();
        if (const auto m = bridge.pressure(msg)) tracker.addMeasurement(*m);
      } else if (kind == 6) {
        sensor_msgs::MagneticField msg;
        msg.header = header;
        for (double* v : {&msg.magnetic_field.x, &msg.magnetic_field.y, &msg.magnetic_field.z}) *v = source.number();
        if (bridge.isFieldDue(msg))
          tracker.addMeasurement(bridge.heading(msg, Eigen::Matrix3d::Identity(), Eigen::Matrix3d::Identity()));
      } else {
        tilts.addPose(header.stamp.toSec(), ru::fromMsg(poseFrom(source)));
        const Eigen::Vector3d force(source.number(), source.number(), source.number());
        if (force.allFinite()) tilts.addSpecificForce(header.stamp.toSec(), force);
        filter.addSpecificForce(header.stamp.toSec(), force);
      }
    });
    tracker.popOutcomes();
    if (const auto estimate = tracker.latest()) {
      require(estimate->pose.allFinite() && estimate->covariance.allFinite(), "tracked pose");
      require((estimate->covariance.diagonal().array() > 0).all(), "tracked covariance");
    }
  }
}

}  // namespace

void addMessageTargets(Targets* targets) {
  targets->insert({{"image", image},
                   {"compressed_image", compressedImage},
                   {"camera_info", cameraInfo},
                   {"point_cloud", pointCloud},
                   {"height_maps", heightMaps},
                   {"alignment", alignment},
                   {"refinement", refinement},
                   {"tracking", tracking},
                   {"views", views}});
}

}  // namespace air_ground_fuzz
