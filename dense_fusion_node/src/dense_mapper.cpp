#include "dense_fusion/dense_mapper.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "air_ground_common/geometry.h"
#include "air_ground_common/text.h"
#include "sparse_depth.h"

namespace dense_fusion {

using air_ground_common::CloudCorrections;
using air_ground_common::PosesByStamp;
using air_ground_common::Similarity;

namespace {

constexpr std::size_t kMostPoses = 40000;       // half an hour of images 0.02 m apart
constexpr std::int64_t kStanding = 4000000000;  // after so long without a motion what there is is fused [ns]
constexpr std::size_t kRecentFrames = 65;       // the newest and what joins its depth map when it starts one

double distance(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  return (a.translation() - b.translation()).norm();
}

double angle(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  return air_ground_common::rotationAngle(a.linear(), b.linear());
}

double validShare(const cv::Mat& depth) {
  std::size_t valid = 0;
  for (int v = 0; v < depth.rows; ++v)
    for (int u = 0; u < depth.cols; ++u) valid += !std::isnan(depth.at<float>(v, u));
  return static_cast<double>(valid) / static_cast<double>(depth.total());
}

bool known(double depth_min, double depth_max) {
  return std::isfinite(depth_min) && std::isfinite(depth_max) && depth_min > 0 && depth_max >= depth_min;
}

bool sameCalibration(const air_ground_common::CameraModel& a, const air_ground_common::CameraModel& b) {
  return a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy && a.cx == b.cx && a.cy == b.cy &&
         a.model == b.model && a.distortionCoefficients() == b.distortionCoefficients();
}

}  // namespace

DenseMapper::DenseMapper(const MapperSettings& settings) : settings_(settings), reach_{settings.sweep_radius, false} {
  settings_.validate();
}

void DenseMapper::reset() {
  unit_ = 1;
  followed_ = false;
  poses_.clear();
  corrected_.clear();
  made_.clear();
  forgetViews();
}

void DenseMapper::forgetViews() {
  sweeping_ = false;
  waiting_range_.reset();
  recent_.clear();
  spacing_.clear();
  reach_ = {settings_.sweep_radius, false};
  last_ = {};
  group_.clear();
  carried_over_ = 0;
}

std::optional<FusedMap> DenseMapper::add(const cv::Mat& image, const air_ground_common::CameraModel& camera,
                                         std::int64_t stamp, const Eigen::Isometry3d& T_map_camera_given,
                                         double depth_min, double depth_max, double readout_time) {
  if (!air_ground_common::isValid(T_map_camera_given))
    throw std::invalid_argument("dense mapper: the camera pose is not a rigid transform");
  const Eigen::Isometry3d T_now = air_ground_common::poseOfImage(corrected_, stamp).value_or(T_map_camera_given);
  Eigen::Isometry3d T_map_camera = T_now;
  T_map_camera.translation() *= unit_;
  depth_min *= unit_;
  depth_max *= unit_;
  if (!rectifier_ || !sameCalibration(rectifier_->recordedCamera(), camera)) {
    auto rectifier = std::make_unique<Rectifier>(camera, settings_.rectifier);
    forgetViews();
    rectifier_ = std::move(rectifier);
    sweep_ = std::make_unique<PlaneSweep>(rectifier_->camera(), settings_.sweep);
  }
  ++counters_.images;
  poses_[stamp] = T_now;
  if (poses_.size() > kMostPoses) poses_.erase(poses_.begin());
  const RowMotion rows = rowMotion(readout_time, stamp, T_map_camera, depth_min, depth_max);
  constexpr double kRedundantRotation = 0.05;
  if (!recent_.empty() && distance(recent_.back().T_map_camera, T_map_camera) < settings_.frame_spacing &&
      angle(recent_.back().T_map_camera, T_map_camera) < kRedundantRotation) {
    ++counters_.redundant;
    return stamp - recent_.back().stamp > kStanding ? flush() : std::nullopt;
  }
  startWaitingSweep();
  if (!recent_.empty()) spacing_.add(distance(recent_.back().T_map_camera, T_map_camera));
  reachOut(depth_min, depth_max);
  const Frame frame = rectifier_->rectify(image, stamp, T_map_camera, rows);
  std::optional<FusedMap> fused;
  if (sweeping_ && !sweep_->full() && joinsSweep(sweep_->reference().T_map_camera, T_map_camera)) {
    counters_.swept += sweep_->add(frame);
    // By which the map is told to be complete: to wait for the next image would be to send it so much later.
    const Eigen::Isometry3d T_map_next = expectedNext(T_map_camera);
    keep(frame);
    if (sweep_->full() || !joinsSweep(sweep_->reference().T_map_camera, T_map_next)) {
      finishSweep();
      if (endsGroup(T_map_next)) fused = fuseGroup();
    }
  } else {
    if (sweeping_) finishSweep();
    if (endsGroup(T_map_camera)) fused = fuseGroup();
    waiting_range_ = {depth_min, depth_max};
    keep(frame);
    if (!fused) startWaitingSweep();  // else it would only delay the map
  }
  return inPosesUnit(std::move(fused));
}

void DenseMapper::keep(const Frame& frame) {
  recent_.push_back(frame);
  if (recent_.size() > kRecentFrames) recent_.pop_front();
}

// After the same motion once more.
Eigen::Isometry3d DenseMapper::expectedNext(const Eigen::Isometry3d& T_map_camera) const {
  if (recent_.empty()) return T_map_camera;
  return T_map_camera * (recent_.back().T_map_camera.inverse(Eigen::Isometry) * T_map_camera);
}

void DenseMapper::reachOut(double depth_min, double depth_max) {
  scene_distance_ = known(depth_min, depth_max) ? std::sqrt(depth_min * depth_max)
                                                : std::sqrt(settings_.default_depth_min * settings_.default_depth_max);
  reach_ = sweepReach(settings_.sweep_radius, spacing_.typical(), settings_.max_baseline * scene_distance_);
}

bool DenseMapper::joinsSweep(const Eigen::Isometry3d& T_map_reference, const Eigen::Isometry3d& T_map_camera) const {
  return distance(T_map_reference, T_map_camera) <= reach_.radius &&
         angle(T_map_reference, T_map_camera) <= settings_.max_rotation;
}

std::string DenseMapper::whyPoor(const std::string& unit) const {
  const std::string scene =
      air_ground_common::formatted("of a scene %.3g%s away: ", scene_distance_ / unit_, unit.c_str());
  if (!reach_.few) return scene + "too little texture or parallax, or poses that are off";
  return air_ground_common::formatted("images are %.2g%s apart, ", spacing_.typical() / unit_, unit.c_str()) + scene +
         "too far to tell its depth; fly slower or raise the frame rate";
}

RowMotion DenseMapper::rowMotion(double readout_time, std::int64_t stamp, const Eigen::Isometry3d& T_map_camera,
                                 double depth_min, double depth_max) {
  constexpr double kLongest = 0.25;  // between two images that tell of a motion [s]
  RowMotion rows;
  const double dt = 1e-9 * static_cast<double>(stamp - last_.stamp);
  if (readout_time != 0 && dt > 0 && dt < kLongest) {
    const Eigen::Isometry3d T_camera_last = T_map_camera.inverse(Eigen::Isometry) * last_.T_map_camera;
    rows.readout_time = readout_time;
    rows.angular_rate = -air_ground_common::logSO3(T_camera_last.linear()) / dt;
    rows.velocity = -T_camera_last.translation() / dt;
    if (depth_min > 0 && depth_max >= depth_min) rows.depth = 2 / (1 / depth_min + 1 / depth_max);
  }
  last_.stamp = stamp;
  last_.T_map_camera = T_map_camera;
  return rows;
}

std::optional<FusedMap> DenseMapper::followDistance(double scene_distance) {
  if (!(scene_distance > 0) || !std::isfinite(scene_distance))
    throw std::invalid_argument("dense mapper: the scene's distance must be positive");
  constexpr double kHysteresis = 2;
  const double wanted = settings_.nominal_distance / scene_distance;
  if (unit_ < kHysteresis * wanted && wanted < kHysteresis * unit_ && followed_) return std::nullopt;
  auto fused = followed_ ? flush() : std::nullopt;
  forgetViews();
  unit_ = wanted;
  followed_ = true;
  return fused;
}

std::optional<FusedMap> DenseMapper::followMetricDistance(double scene_distance) {
  constexpr double kSlack = 1.5;  // with followDistance's factor of two: three times
  return followDistance(std::max(settings_.nominal_distance, scene_distance / kSlack));
}

CloudCorrections DenseMapper::correct(const PosesByStamp& now) {
  // Depth rests on baselines of the sweep's radius: where they have changed among each other, it was off.
  constexpr double kBent = 0.02;
  const double radius = settings_.fusion_radius, most = kBent * settings_.sweep_radius;  // as set
  constexpr std::size_t kNewerOnes = 3;  // until then a poor map is better than none
  const air_ground_common::MapCorrection correction(poses_, now);
  CloudCorrections since;
  std::size_t newer = made_.size();
  for (auto& [stamp, made] : made_) {
    const auto [S, residual] = correction.around(made.place, made.radii * radius);
    made.bent = made.bent || residual > made.radii * most;
    --newer;
    if (!made.T_now_returned || (made.bent && newer >= kNewerOnes)) {
      counters_.given_up += made.T_now_returned.has_value();
      since[stamp] = made.T_now_returned = std::nullopt;
      continue;
    }
    made.T_now_returned = air_ground_common::compose(S, *made.T_now_returned);
    made.place = S * made.place;
    since[stamp] = S;
  }
  const Eigen::Vector3d here = last_.T_map_camera.translation() / unit_;
  followHere(now, correction.around(here, growth() / unit_ * radius).T_now_then);
  for (auto& [stamp, T] : poses_)
    if (const auto known = air_ground_common::poseOfImage(now, stamp)) T = *known;
  corrected_ = now;
  ++counters_.corrections;
  return since;
}

// What waits to be fused, and what is to be swept with images to come.
void DenseMapper::followHere(const PosesByStamp& now, const Similarity& T_now_then) {
  const auto follow = [&](std::int64_t stamp, Eigen::Isometry3d* T_map_camera) {
    if (const auto known = air_ground_common::poseOfImage(now, stamp)) {
      *T_map_camera = *known;
    } else {
      T_map_camera->translation() = T_now_then * (T_map_camera->translation() / unit_);
      T_map_camera->linear() = T_now_then.R * T_map_camera->linear().eval();
    }
    T_map_camera->translation() *= unit_;
  };
  follow(last_.stamp, &last_.T_map_camera);
  for (Frame& frame : recent_) follow(frame.stamp, &frame.T_map_camera);
  for (DepthMap& map : group_) {
    follow(map.stamp, &map.T_map_camera);
    map.depth *= T_now_then.scale;
  }
  if (!sweeping_) return;
  Eigen::Isometry3d T_map_reference = sweep_->reference().T_map_camera;
  follow(sweep_->reference().stamp, &T_map_reference);
  sweep_->moveReference(T_map_reference);
}

CloudCorrections DenseMapper::corrections() const {
  CloudCorrections corrections;
  for (const auto& [stamp, made] : made_) corrections[stamp] = made.T_now_returned;
  return corrections;
}

std::vector<Eigen::Vector3f> DenseMapper::sparsePoints() const {
  std::vector<Eigen::Vector3f> points = sparse_points_;
  for (Eigen::Vector3f& p : points) p *= static_cast<float>(unit_);
  return points;
}

std::optional<FusedMap> DenseMapper::inPosesUnit(std::optional<FusedMap> fused) const {
  if (!fused || unit_ == 1) return fused;
  const double scale = 1 / unit_;
  if (!fused->depth_map.depth.empty()) fused->depth_map.depth.convertTo(fused->depth_map.depth, CV_32F, scale);
  fused->depth_map.T_map_camera.translation() *= scale;
  for (SurfacePoint& p : fused->points) p.position *= static_cast<float>(scale);
  fused->grid.origin *= scale;
  fused->grid.voxel_size *= scale;
  return fused;
}

void DenseMapper::startWaitingSweep() {
  if (!waiting_range_) return;
  const auto [depth_min, depth_max] = *waiting_range_;
  waiting_range_.reset();
  const bool told = known(depth_min, depth_max);
  const double near = told ? depth_min / settings_.near_margin : settings_.default_depth_min;
  const double far = told ? depth_max * settings_.far_margin : settings_.default_depth_max;
  const Frame& reference = recent_.back();
  sweep_->start(reference, near, std::max(far, near * 1.01));
  sweeping_ = true;
  const auto joins = [&](const Frame& frame) { return joinsSweep(reference.T_map_camera, frame.T_map_camera); };
  // Frames from before the reference count as much as those after it: the baseline doubles. Where the camera hovers
  // they would be all, and the depth map the last one once more.
  auto frame = recent_.end() - 1;
  for (int earlier = 0; frame != recent_.begin() && 2 * earlier < settings_.sweep.max_frames;)
    earlier += joins(*--frame);
  for (; frame != recent_.end() - 1; ++frame)
    if (joins(*frame)) counters_.swept += sweep_->add(*frame);
}

void DenseMapper::finishSweep() {
  DepthMap map = sweep_->depthMap(reach_.few);
  sweeping_ = false;
  if (validShare(map.depth) < settings_.min_valid) {
    ++counters_.poor_depth_maps;
    return;
  }
  ++counters_.depth_maps;
  // Errors of poses within so short a baseline show in the depth as a whole; landmarks have been seen from further
  // apart.
  if (const auto ratio = sparseDepthRatio(map, sparsePoints())) map.depth *= *ratio;
  if (on_depth_map_) on_depth_map_(map);
  group_.push_back(std::move(map));
}

// Told by where the next depth map begins: its end would come later.
bool DenseMapper::endsGroup(const Eigen::Isometry3d& T_map_reference) const {
  // A camera that hovers or turns around never leaves the radius; on the way through it there are about ten.
  constexpr std::size_t kMaxGroup = 30;
  return !group_.empty() &&
         (distance(group_.front().T_map_camera, T_map_reference) > growth() * settings_.fusion_radius ||
          group_.size() - carried_over_ >= kMaxGroup);
}

std::optional<FusedMap> DenseMapper::fuseGroup() {
  std::optional<FusedMap> fused;
  // Taken out first: a group that fails (no memory, say) is not tried again with the next depth map.
  std::vector<DepthMap> group = std::move(group_);
  const std::size_t carried_over = carried_over_;
  group_.clear();
  carried_over_ = 0;
  if (group.size() == carried_over) return fused;  // the camera has leapt: nothing new to fuse these with
  if (static_cast<int>(group.size()) >= settings_.min_depth_maps) {
    Eigen::Vector3d centre = Eigen::Vector3d::Zero();
    for (const DepthMap& map : group) centre += map.T_map_camera.translation() / static_cast<double>(group.size());
    // Among the new views: the stamps of fused maps must rise, which those of carried ones need not.
    std::size_t reference = carried_over;
    double nearest = std::numeric_limits<double>::max();
    for (std::size_t i = carried_over; i < group.size(); ++i) {
      const double d = (group[i].T_map_camera.translation() - centre).norm();
      if (d < nearest) {
        nearest = d;
        reference = i;
      }
    }
    fused = fuseDepthMaps(group, reference, settings_.fusion, sparsePoints(), views_);
    if (fused) {
      ++counters_.fused;
      fused->newest_image = recent_.back().stamp;
      made_[fused->depth_map.stamp] = {fused->depth_map.T_map_camera.translation() / unit_, Similarity(), false,
                                       growth() / unit_};
      if (made_.size() > air_ground_common::kFollowedClouds) made_.erase(made_.begin());
    }
  } else {
    ++counters_.small_groups;
  }
  const Eigen::Isometry3d last = group.back().T_map_camera;
  for (DepthMap& map : group)
    if (distance(map.T_map_camera, last) < growth() * settings_.overlap) group_.push_back(std::move(map));
  carried_over_ = group_.size();
  return fused;
}

std::optional<FusedMap> DenseMapper::flush() {
  std::optional<FusedMap> fused;
  startWaitingSweep();
  if (sweeping_) finishSweep();
  // What is carried over alone brings nothing new; what is too little waits for more.
  if (group_.size() > carried_over_ && static_cast<int>(group_.size()) >= settings_.min_depth_maps) fused = fuseGroup();
  return inPosesUnit(std::move(fused));
}

}  // namespace dense_fusion
