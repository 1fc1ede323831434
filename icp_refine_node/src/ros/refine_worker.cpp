#include "refine_worker.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "icp_refine/ceilings.h"

namespace icp_refine {
namespace {

namespace ros_utils = air_ground_common::ros_utils;

Cloud positionsOf(const std::vector<CloudPoint>& points) {
  Cloud cloud;
  cloud.points.reserve(points.size());
  for (const auto& p : points) cloud.points.push_back(p.position);
  return cloud;
}

/// Of the ground robot's points those that a MAV can see as they are.
Cloud groundPositions(const std::vector<CloudPoint>& points) {
  Cloud cloud = positionsOf(points);
  std::vector<float> hidden_from;
  hidden_from.reserve(points.size());
  for (const auto& p : points) hidden_from.push_back(p.hidden_from);
  std::vector<char> kept = onUndersides(cloud.points, hidden_from);
  for (char& below : kept) below = !below;
  cloud.keep(kept);
  return cloud;
}

constexpr double kWeakScale = 0.05;    // relative; the coarse stage's figure knows nothing of drift in the map
constexpr double kOtherScale = 0.05;   // a coarse alignment that differs by more ...
constexpr double kOtherLevel = 0.035;  // ... or is tilted by more, begins afresh while nothing is tracked [rad]

/// The map of T's scale and vertical: T without heading and place.
Similarity levelMetric(const Similarity& T_ground_visual) {
  return {T_ground_visual.scale,
          air_ground_common::levelingRotation(T_ground_visual.R.transpose() * Eigen::Vector3d::UnitZ()),
          Eigen::Vector3d::Zero()};
}

std::chrono::steady_clock::duration secondsOf(double seconds) {
  return std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double>(seconds));
}

}  // namespace

RefineWorker::RefineWorker(const NodeSettings& settings, IcpChain chain, AlignmentOutput& output,
                           ros_utils::NodeHealth& health)
    : settings_(settings),
      output_(output),
      health_(health),
      refiner_(std::move(chain), settings.refiner),
      map_(settings.map, settings.ground_map_frame, settings.map_period, health) {
  thread_ = std::thread([this] { work(); });
}

RefineWorker::~RefineWorker() {
  {
    std::lock_guard<std::mutex> lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

void Inbox::startMap(bool in_own_unit) {
  new_map = true;
  own_unit = in_own_unit;
  aerial.clear();
  corrections.reset();
  scale_deviation.reset();
  aerial_vertical.reset();
  coarse.reset();
  views.reset();
  manual.reset();
}

void Inbox::reviseMap() {
  aerial_revised = true;
  aerial.clear();
  corrections.reset();
  views.reset();
}

void Inbox::reviseGround(bool at_hand) {
  ground_moved = at_hand;
  coarse.reset();
  views.reset();
}

void Inbox::setGround(std::vector<CloudPoint> points) {
  ground = std::move(points);
  if (ground_moved) ground_moved = true;
}

void Inbox::withdrawViews() {
  views_withdrawn = true;
  views.reset();
}

void Inbox::withdrawCoarse() {
  coarse_withdrawn = true;
  coarse.reset();
}

void Inbox::startGround() {
  new_ground = true;
  ground.reset();
  ground_camera.reset();
  ground_vertical.reset();
  coarse.reset();
  views.reset();
  manual.reset();
}

void RefineWorker::post(const std::function<void(Inbox&)>& change) {
  std::lock_guard<std::mutex> lock(mutex_);
  change(inbox_);
  // Each cloud is some hundred kilobytes: a worker that cannot keep up loses the oldest.
  while (inbox_.aerial.size() > static_cast<std::size_t>(settings_.queue_size)) {
    inbox_.aerial.pop_front();
    health_.count("dense clouds dropped: refinement does not keep up");
  }
  wake_.notify_all();
}

void RefineWorker::forget(const std::string& why, const std::function<void(Inbox&)>& change) {
  post([&](Inbox& inbox) {
    change(inbox);
    output_.withdraw(why, maps_, inbox.own_unit);
  });
}

void RefineWorker::setMapId(std::uint32_t map_id) {
  std::lock_guard<std::mutex> lock(mutex_);
  maps_.mav = map_id;
}

void RefineWorker::setGroundMapId(std::uint32_t map_id) {
  std::lock_guard<std::mutex> lock(mutex_);
  maps_.ground = map_id;
}

void RefineWorker::work() {
  RefinePace pace(secondsOf(settings_.min_period));
  while (true) {
    Inbox inbox;
    {
      std::unique_lock<std::mutex> lock(mutex_);
      const auto ready = [this] { return stop_ || inbox_.any(); };
      if (pace.pending())
        wake_.wait_until(lock, pace.due(), ready);
      else
        wake_.wait(lock, ready);
      if (stop_) return;
      std::swap(inbox, inbox_);
      inbox_.own_unit = inbox.own_unit;
    }
    try {
      const bool news = use(inbox);
      pace.add(news, !inbox.aerial.empty());
      if (!pace.pending() || Clock::now() < pace.due()) {
        refiner_.prepareGround();
        continue;
      }
      refine();
      pace.refined(Clock::now());
    } catch (const std::exception& e) {
      health_.count(std::string("failed refinements: ") + e.what());
      pace.drop();
    }
  }
}

// True when there is something new to refine.
bool RefineWorker::use(Inbox& inbox) {
  if (inbox.reset || inbox.new_map) {
    refiner_.startMap();
    map_.post([](auto& shown) { shown.map.clearAerial(); }, false);
    own_clouds_.clear();
    corrections_.clear();
    T_metric_visual_.reset();
  }
  if (inbox.reset || inbox.new_ground) {
    refiner_.startGround();
    map_.post([](auto& shown) { shown.map.clearGround(); }, false);
  }
  if (inbox.forgets()) dropMapPose();
  if (inbox.aerial_revised) {
    refiner_.forgetAerial();
    map_.post([](auto& shown) { shown.map.clearAerial(); }, true);
    own_clouds_.clear();
    corrections_.clear();
  }
  if (inbox.ground_camera) refiner_.setGroundCamera(*inbox.ground_camera);
  if (inbox.ground) {
    refiner_.setGround(groundPositions(*inbox.ground));
    map_.post([points = std::move(*inbox.ground)](auto& shown) mutable { shown.map.setGround(std::move(points)); },
              true);
  }
  if (inbox.ground_moved && !inbox.new_ground) refiner_.groundMoved(*inbox.ground_moved);
  own_unit_ = inbox.own_unit;
  for (AerialCloud& aerial : inbox.aerial) {
    const auto stamp = static_cast<std::int64_t>(aerial.stamp.toNSec());
    if (const auto it = corrections_.find(stamp); it != corrections_.end()) {
      if (!it->second) continue;
      moveBy(*it->second, &aerial.points);
    }
    if (own_unit_) own_clouds_.add(stamp, aerial.points, [](const auto&) {});
    addAerial(stamp, std::move(aerial.points));
  }
  if (inbox.corrections) correct(*inbox.corrections);
  if (inbox.scale_deviation) refiner_.setScaleDeviation(*inbox.scale_deviation);
  if (inbox.aerial_vertical) refiner_.setAerialVertical(*inbox.aerial_vertical);
  if (inbox.ground_vertical) refiner_.setGroundVertical(*inbox.ground_vertical);
  const bool tracked = refiner_.tracking();
  if (inbox.coarse_withdrawn) refiner_.withdrawCoarse();
  if (inbox.coarse) useCoarse(*inbox.coarse);
  if (inbox.views_withdrawn) refiner_.withdrawViews();
  if (inbox.views) useViews(*inbox.views);
  if (inbox.manual) refiner_.setManual(*inbox.manual);
  // While tracking, the next aerial cloud is soon enough; but where the ground map was corrected, a MAV that hovers or
  // has landed sends none.
  const bool wanted = (inbox.coarse || inbox.views || inbox.ground) && (!refiner_.tracking() || refiner_.unproven());
  const bool moved = (inbox.ground || inbox.ground_moved) && refiner_.groundHasMoved();
  const bool lost = tracked && !refiner_.tracking();
  return lost || moved || inbox.refine || !inbox.aerial.empty() || inbox.corrections || inbox.manual || wanted;
}

void RefineWorker::addAerial(std::int64_t stamp, std::vector<CloudPoint> points) {
  if (own_unit_ && !T_metric_visual_) return;  // once there is a coarse alignment
  if (own_unit_) moveBy(*T_metric_visual_, &points);
  refiner_.addAerial(stamp, positionsOf(points));
  map_.post([stamp, points = std::move(points)](auto& shown) mutable { shown.map.addAerial(stamp, std::move(points)); },
            false);
}

void RefineWorker::correct(const CloudCorrections& corrections) {
  CloudCorrections since = correctionsSince(std::exchange(corrections_, corrections), corrections);
  own_clouds_.correct(since);
  if (own_unit_ && !T_metric_visual_) return;
  if (own_unit_)
    for (auto& [stamp, S] : since)
      if (S) S = compose(compose(*T_metric_visual_, *S), inverse(*T_metric_visual_));
  refiner_.correctAerial(since);
  if (const auto tracked = trackedInMavMap()) output_.correct(*tracked);
  map_.post(
      [since = std::move(since), refined = refiner_.refined()](auto& shown) {
        shown.map.correctAerial(since);
        if (shown.map.aligned() && refined) shown.map.align(refined);
      },
      true);
}

std::optional<Similarity> RefineWorker::trackedInMavMap() const {
  const std::optional<Similarity> tracked = refiner_.refined();
  return tracked && own_unit_ && T_metric_visual_ ? compose(*tracked, *T_metric_visual_) : tracked;
}

void RefineWorker::makeMetric(const Similarity& T_ground_visual) {
  const Similarity now = levelMetric(T_ground_visual);
  const bool other = !T_metric_visual_ || std::abs(std::log(now.scale / T_metric_visual_->scale)) > kOtherScale ||
                     air_ground_common::rotationAngle(now.R, T_metric_visual_->R) > kOtherLevel;
  if (!other || refiner_.tracking()) return;
  T_metric_visual_ = now;
  refiner_.startMap();
  map_.post([](auto& shown) { shown.map.clearAerial(); }, false);
  for (const auto& [stamp, points] : own_clouds_.clouds()) addAerial(stamp, points);
}

void RefineWorker::useCoarse(CoarseAlignment coarse) {
  if (own_unit_) {
    makeMetric(coarse.T_ground_map_mav_map);
    coarse.T_ground_map_mav_map = compose(coarse.T_ground_map_mav_map, inverse(*T_metric_visual_));
    coarse.scale_stddev = std::max(kWeakScale, coarse.scale_stddev);
    // A guess does not compete with the tracked pose, whose scale the clouds have told.
    if (coarse.sure || !refiner_.tracking())
      refiner_.setScalePrior(coarse.T_ground_map_mav_map.scale, coarse.scale_stddev);
  }
  if (coarse.sure && coarse.covariance.diagonal().minCoeff() > 0)
    refiner_.setCoarse(coarse);
  else
    refiner_.setCoarse(coarse.T_ground_map_mav_map, coarse.sure);
}

void RefineWorker::useViews(KnownAlignment views) {
  if (own_unit_) {
    makeMetric(views.T_ground_map_mav_map);
    refiner_.setScaleDeviation(kWeakScale);
    views.T_ground_map_mav_map = compose(views.T_ground_map_mav_map, inverse(*T_metric_visual_));
  }
  refiner_.setViews(views);
}

void RefineWorker::refine() {
  const auto start = Clock::now();
  const RefineOutcome out = refiner_.refine();
  health_.timing("refine", std::chrono::duration<double>(Clock::now() - start).count());
  if (out.status != RefineStatus::kSearching && !refiner_.knowsGroundCamera()) {
    health_.count(
        "the ground camera's height is not known: neither tf to the frame of ground/rgb/camera_info nor "
        "ground/map_keyframes tells it. What is higher than that camera, a ceiling above all, may contradict right "
        "poses");
  }
  {
    // Locked: nothing of the time before a reset goes out after it.
    std::lock_guard<std::mutex> lock(mutex_);
    if (inbox_.forgets()) return;  // it is about a map that has ended
    RefineOutcome said = out;
    if (own_unit_ && T_metric_visual_) {
      said.T_ground_map_mav_map = compose(out.T_ground_map_mav_map, *T_metric_visual_);
      said.scale_stddev *= T_metric_visual_->scale;
    }
    output_.publish(said, maps_, trackedInMavMap(), own_unit_);
  }
  if (out.status == RefineStatus::kConverged)
    map_.post(
        [T = out.T_ground_map_mav_map, stamp = out.stamp](auto& shown) {
          shown.map.align(T);
          shown.stamp = ros::Time().fromNSec(static_cast<std::uint64_t>(stamp));
        },
        true);
  else if (!refiner_.tracking())
    dropMapPose();
}

// The map that stays is the ground robot's alone.
void RefineWorker::dropMapPose() {
  map_.post([](auto& shown) { shown.map.align(std::nullopt); }, true);
}

}  // namespace icp_refine
