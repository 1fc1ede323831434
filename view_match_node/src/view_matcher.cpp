#include "view_match/view_matcher.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "air_ground_common/covariance.h"
#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"
#include "air_ground_common/units.h"

namespace view_match {
namespace {

using air_ground_common::formatted;
using air_ground_common::kDegree;
using visual_frontend::Keyframe;
using visual_frontend::KeyframeId;

constexpr double kDepthRadius = 10;       // of a point and a landmark whose depths are compared [px]
constexpr std::size_t kLeastDepths = 15;  // that tell the scale

/// Of the optical axis over the horizon [rad].
double elevationOf(const Pose& T_map_camera) { return std::asin(std::clamp(T_map_camera.linear()(2, 2), -1.0, 1.0)); }

}  // namespace

const char* toString(MatchStatus status) {
  switch (status) {
    case MatchStatus::kSearching:
      return "SEARCHING";
    case MatchStatus::kAmbiguous:
      return "AMBIGUOUS";
    case MatchStatus::kDegenerate:
      return "DEGENERATE";
    case MatchStatus::kConverged:
      return "CONVERGED";
  }
  return "";
}

MatcherSettings::MatcherSettings() { place.orb_features = 1000; }

ViewMatcher::ViewMatcher(const MatcherSettings& settings) : settings_(settings) {}

void ViewMatcher::addKeyframe(const KeyframeView& view) {
  if (view.points.empty() || view.descriptors.rows != static_cast<int>(view.points.size()) ||
      view.descriptors.cols != 32 || view.descriptors.type() != CV_8UC1)
    throw std::invalid_argument("a keyframe needs points, and a descriptor of 32 bytes for each");
  Keyframe keyframe;
  keyframe.T_map_camera = view.T_ground_camera;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p : view.points) {
    if (!p.allFinite() || !(p.z() > 0))
      throw std::invalid_argument("a keyframe's point does not lie before its camera");
    keyframe.orb_normalized.push_back(p.hnormalized());
    keyframe.orb_pixels.push_back(keyframe.orb_normalized.back());  // no landmarks are looked up by them
    keyframe.orb_depth.push_back(p.z());
    sum += p;
  }
  keyframe.orb_descriptors = view.descriptors.clone();
  const auto known = ids_.find(view.id);
  const KeyframeId id = known == ids_.end() ? map_.addKeyframe({}) : known->second;
  keyframe.id = ids_[view.id] = id;
  map_.keyframe(id) = std::move(keyframe);
  scenes_[id] = sum / static_cast<double>(view.points.size());
}

void ViewMatcher::setPoses(const std::map<std::uint32_t, Pose>& T_ground_camera) {
  Poses now;
  std::vector<KeyframeId> gone;
  for (const auto& [name, id] : ids_) {
    const auto pose = T_ground_camera.find(name);
    if (pose == T_ground_camera.end())
      gone.push_back(id);
    else
      now[id] = pose->second;
  }
  for (const KeyframeId id : gone) moveImages(id, now);
  if (bends(now))
    for (Image& image : waiting_)
      if (std::exchange(image.ambiguous, false)) image.next_keyframe = 0;
  for (const auto& [id, T] : now) map_.keyframe(id).T_map_camera = T;
  for (const KeyframeId id : gone) {
    map_.removeKeyframe(id);
    scenes_.erase(id);
  }
  for (auto it = ids_.begin(); it != ids_.end();) it = now.count(it->second) ? std::next(it) : ids_.erase(it);
  placed_ = std::move(now);
}

bool ViewMatcher::bends(const Poses& now) const {
  constexpr double kShift = 0.1, kTurn = 0.05;  // [m], [rad]
  std::optional<Pose> T_now_then;
  for (const auto& [id, T] : now) {
    const auto then = placed_.find(id);
    if (then == placed_.end()) continue;
    if (!T_now_then) T_now_then = T * then->second.inverse();
    const Pose moved = *T_now_then * then->second;
    if ((moved.translation() - T.translation()).norm() > kShift ||
        air_ground_common::rotationAngle(moved.linear(), T.linear()) > kTurn)
      return true;
  }
  return false;
}

std::optional<Pose> ViewMatcher::carriedAlong(const Pose& T_ground_gone, const Poses& now) const {
  double least = 2.0;  // further away a correction may be another one [m]
  std::optional<Pose> carried;
  for (const auto& [id, T] : now) {
    const auto then = placed_.find(id);
    if (then == placed_.end()) continue;
    const double distance = (then->second.translation() - T_ground_gone.translation()).norm();
    if (distance >= least) continue;
    least = distance;
    carried = T * then->second.inverse() * T_ground_gone;
  }
  return carried;
}

// The ground robot replaces keyframes by newer ones of the same view, which are of the map as it is now.
void ViewMatcher::moveImages(KeyframeId gone, const Poses& now) {
  constexpr double kShift = 0.5, kTurn = 0.5;  // [m], [rad]; else it is not the same view
  const auto T_ground_gone = carriedAlong(map_.keyframe(gone).T_map_camera, now);
  std::optional<KeyframeId> nearest;
  double least = kShift;
  for (const auto& [id, T] : now) {
    if (!T_ground_gone) break;
    const double shift = (T.translation() - T_ground_gone->translation()).norm();
    if (shift >= least || air_ground_common::rotationAngle(T.linear(), T_ground_gone->linear()) > kTurn) continue;
    least = shift;
    nearest = id;
  }
  if (!nearest) {
    const auto lost = std::stable_partition(images_.begin(), images_.end(),
                                            [gone](const RecognisedImage& seen) { return seen.keyframe != gone; });
    std::for_each(lost, images_.end(), [this](RecognisedImage& seen) { waitAgain(std::move(seen.image)); });
    images_.erase(lost, images_.end());
    return;
  }
  const Pose T_new_gone = now.at(*nearest).inverse() * *T_ground_gone;
  for (RecognisedImage& seen : images_) {
    if (seen.keyframe != gone) continue;
    seen.keyframe = *nearest;
    seen.T_keyframe_camera = T_new_gone * seen.T_keyframe_camera;
    seen.covariance = air_ground_common::aboutAxes(T_new_gone.linear(), seen.covariance);
  }
}

double ViewMatcher::difference(const Pose& T_mav_camera, const Pose& T_mav_other, double distance) const {
  const double shift = (T_mav_camera.translation() - T_mav_other.translation()).norm();
  const double turn = air_ground_common::rotationAngle(T_mav_camera.linear(), T_mav_other.linear());
  return std::max(shift > 0 ? shift / (settings_.new_view * distance) : 0, turn / settings_.new_view_angle);
}

// The images stay in order of time. A MAV that hovers must not displace what it saw before.
void ViewMatcher::wait(Image image) {
  const auto later =
      std::find_if(waiting_.begin(), waiting_.end(), [&](const Image& other) { return other.stamp > image.stamp; });
  waiting_.insert(later, std::move(image));
  if (waiting_.size() <= static_cast<std::size_t>(settings_.max_waiting)) return;
  auto most_alike = waiting_.begin();
  double least = std::numeric_limits<double>::infinity();
  for (auto it = waiting_.begin(); std::next(it) != waiting_.end(); ++it) {
    const double d = difference(it->T_mav_camera, std::next(it)->T_mav_camera, it->distance);
    if (d >= least) continue;
    least = d;
    most_alike = it;
  }
  waiting_.erase(most_alike);
}

void ViewMatcher::waitAgain(Image image) {
  image.next_keyframe = 0;
  wait(std::move(image));
}

ViewMatcher::Places ViewMatcher::placesFor(Image& image) const {
  // A metric map is level, as the ground robot's is. Features bear half of the difference that is let through.
  const double elevation = elevationOf(image.T_mav_camera);
  Places places;
  for (const auto& [id, keyframe] : map_.keyframes()) {
    const double difference = std::abs(elevationOf(keyframe.T_map_camera) - elevation);
    const bool fits = own_unit_ || difference <= settings_.max_elevation;
    if (fits) places.known.push_back(id);
    if (id < image.next_keyframe) continue;
    if (fits) places.fresh.push_back(id);
    places.least_elevation = std::min(places.least_elevation, difference);
  }
  if (!map_.keyframes().empty()) image.next_keyframe = map_.keyframes().rbegin()->first + 1;
  return places;
}

bool ViewMatcher::recognise(Image& image) {
  Places places = placesFor(image);
  if (places.fresh.empty()) {
    if (std::isfinite(places.least_elevation))
      last_reason_ = formatted("the ground robot's images look %.0f degrees higher or lower, or more",
                               places.least_elevation / kDegree);
    return false;
  }
  visual_frontend::RelocalizationGate among;
  among.min_lead = settings_.min_lead;
  among.places = std::move(places.fresh);
  auto match = visual_frontend::relocalize(map_, image.camera, image.features, among, settings_.place);
  if (match.success && places.known.size() > among.places.size()) {
    // Of two places that look alike the image may have seen the other one before.
    among.places = std::move(places.known);
    match = visual_frontend::relocalize(map_, image.camera, image.features, among, settings_.place);
  }
  image.ambiguous = image.ambiguous || match.ambiguous;
  last_reason_ = match.success ? "" : match.reason;
  if (!match.success) return false;
  RecognisedImage seen{{}, match.T_place_query, match.keyframe, match.covariance, match.inliers};
  seen.distance = (match.T_place_query.inverse() * scenes_.at(match.keyframe)).norm();
  compareDepths(image, seen);
  seen.image = std::move(image);
  images_.push_back(std::move(seen));
  if (images_.size() > static_cast<std::size_t>(settings_.max_images)) images_.erase(images_.begin());
  if (images_.size() >= static_cast<std::size_t>(settings_.min_images)) contested_ = false;
  return true;
}

bool ViewMatcher::isContested(RecognisedImage& seen) const {
  const std::vector<KeyframeId> fresh = placesFor(seen.image).fresh;
  if (fresh.empty()) return false;
  visual_frontend::PlaceMatch place;
  place.keyframe = seen.keyframe;
  place.T_place_query = seen.T_keyframe_camera;
  place.inliers = seen.inliers;
  return !visual_frontend::rivalsOf(place, map_, seen.image.camera, seen.image.features, fresh, settings_.min_lead,
                                    settings_.place)
              .empty();
}

// The ground robot has come to a twin of a place that it had seen alone when the image was recognised there.
void ViewMatcher::questionRecognised() {
  std::vector<RecognisedImage> kept, contested;
  for (RecognisedImage& seen : images_) (isContested(seen) ? contested : kept).push_back(std::move(seen));
  images_ = std::move(kept);
  for (RecognisedImage& seen : contested) {
    seen.image.next_keyframe = 0;
    if (recognise(seen.image)) continue;
    contested_ = true;
    wait(std::move(seen.image));
  }
}

// Points of the keyframe beside landmarks in the image: their depths differ by the scale, but where one is behind the
// other's edge.
void ViewMatcher::compareDepths(const Image& image, RecognisedImage& seen) const {
  const Keyframe& keyframe = map_.keyframe(seen.keyframe);
  const Pose T_camera_keyframe = seen.T_keyframe_camera.inverse();
  std::vector<double> logs;
  for (std::size_t i = 0; i < keyframe.orb_depth.size(); ++i) {
    const Eigen::Vector3d p = T_camera_keyframe * (keyframe.orb_depth[i] * keyframe.orb_normalized[i].homogeneous());
    const auto pixel = image.camera.project(p);
    if (!pixel || !image.camera.contains(*pixel)) continue;
    double nearest = kDepthRadius * kDepthRadius, depth = 0;
    for (const Eigen::Vector3d& landmark : image.seen) {
      const double d2 = (landmark.head<2>() - *pixel).squaredNorm();
      if (d2 >= nearest) continue;
      nearest = d2;
      depth = landmark.z();
    }
    if (depth > 0) logs.push_back(std::log(p.z() / depth));
  }
  if (logs.size() < kLeastDepths) return;
  const double middle = air_ground_common::median(logs);
  std::vector<double> away;
  for (const double l : logs) away.push_back(std::abs(l - middle));
  // Standard error of a median of normal errors, these being 1.48 times their median away.
  const double error = 1.25 * 1.48 * air_ground_common::median(away) / std::sqrt(static_cast<double>(logs.size()));
  seen.scale = std::exp(middle);
  seen.scale_stddev = std::hypot(error, settings_.systematic_scale);
}

bool ViewMatcher::matchWaiting() {
  questionRecognised();
  const std::size_t before = waiting_.size();
  waiting_.erase(std::remove_if(waiting_.begin(), waiting_.end(), [this](Image& image) { return recognise(image); }),
                 waiting_.end());
  return waiting_.size() < before;
}

bool ViewMatcher::addImage(std::int64_t stamp, const cv::Mat& image, const air_ground_common::CameraModel& camera,
                           const Pose& T_mav_camera, const std::vector<Eigen::Vector3f>& landmarks) {
  Image query{stamp, {}, camera, T_mav_camera, {}, 0, 0};
  const Pose T_camera_mav = T_mav_camera.inverse();
  std::vector<double> depths;
  for (const Eigen::Vector3f& p_mav : landmarks) {
    const Eigen::Vector3d p = T_camera_mav * p_mav.cast<double>();
    const auto pixel = camera.project(p);
    if (!pixel || !camera.contains(*pixel)) continue;
    query.seen.emplace_back(pixel->x(), pixel->y(), p.z());
    depths.push_back(p.z());
  }
  if (!depths.empty()) query.distance = air_ground_common::median(depths);
  const auto is_same_view = [&](const Image& other) {
    return difference(other.T_mav_camera, T_mav_camera, query.distance) < 1;
  };
  if (std::any_of(images_.begin(), images_.end(),
                  [&](const RecognisedImage& seen) { return is_same_view(seen.image); }))
    return false;
  visual_frontend::describeKeyframe(image, camera, settings_.place, query.features);
  ++tried_;
  if (recognise(query)) return true;
  waiting_.erase(std::remove_if(waiting_.begin(), waiting_.end(), is_same_view), waiting_.end());
  wait(std::move(query));
  return false;
}

void ViewMatcher::correctAerial(const air_ground_common::PosesByStamp& T_mav_camera) {
  air_ground_common::PosesByStamp then;
  for (const RecognisedImage& seen : images_) then[seen.image.stamp] = seen.image.T_mav_camera;
  for (const Image& image : waiting_) then[image.stamp] = image.T_mav_camera;
  const air_ground_common::MapCorrection correction(then, T_mav_camera);
  // The factor by which the map has grown around it: depths in it are of its unit.
  const auto follow = [&](Image& image) {
    const auto T = air_ground_common::poseOfImage(T_mav_camera, image.stamp);
    if (!T) return 1.0;
    const double grown = correction.around(image.T_mav_camera.translation(), image.distance).T_now_then.scale;
    image.T_mav_camera = *T;
    image.distance *= grown;
    for (Eigen::Vector3d& landmark : image.seen) landmark.z() *= grown;
    return grown;
  };
  for (RecognisedImage& seen : images_) seen.scale /= follow(seen.image);
  for (Image& image : waiting_) follow(image);
}

void ViewMatcher::forgetGround() {
  map_.clear();
  ids_.clear();
  placed_.clear();
  scenes_.clear();
  for (RecognisedImage& seen : images_) waitAgain(std::move(seen.image));
  images_.clear();
  contested_ = false;
}

void ViewMatcher::forgetAerial() {
  images_.clear();
  waiting_.clear();
  last_reason_.clear();
  contested_ = false;
  tried_ = 0;
}

CameraInBoth ViewMatcher::inBoth(const RecognisedImage& seen) const {
  const Pose& T_ground_keyframe = map_.keyframe(seen.keyframe).T_map_camera;
  CameraInBoth out;
  out.T_a_camera = T_ground_keyframe * seen.T_keyframe_camera;
  out.T_b_camera = seen.image.T_mav_camera;
  out.scene = T_ground_keyframe * scenes_.at(seen.keyframe);
  out.scale = seen.scale;
  out.scale_stddev = seen.scale_stddev;
  out.covariance = air_ground_common::aboutAxes(T_ground_keyframe.linear(), seen.covariance);
  out.covariance.diagonal().head<3>().array() += std::pow(settings_.systematic * seen.distance, 2);
  out.covariance.diagonal().tail<3>().array() += std::pow(settings_.systematic_angle, 2);
  return out;
}

std::vector<CameraInBoth> ViewMatcher::cameras() const {
  std::vector<CameraInBoth> out;
  for (const RecognisedImage& seen : images_) out.push_back(inBoth(seen));
  return out;
}

std::string ViewMatcher::notRecognised() const {
  if (ids_.empty()) return "no keyframes of the ground robot yet";
  if (tried_ == 0) return "no images of the MAV yet";
  return formatted("%zu of %d images show what the ground robot saw, %d are needed%s", images_.size(), tried_,
                   settings_.min_images, last_reason_.empty() ? "" : (" (the last: " + last_reason_ + ")").c_str());
}

std::int64_t ViewMatcher::newestStamp() const {
  std::int64_t newest = 0;
  for (const RecognisedImage& seen : images_) newest = std::max(newest, seen.image.stamp);
  if (images_.size() >= static_cast<std::size_t>(settings_.min_images)) return newest;
  return waiting_.empty() ? newest : std::max(newest, waiting_.back().stamp);
}

MatchEstimate ViewMatcher::estimate() const {
  MatchEstimate out;
  out.stamp = newestStamp();
  if (static_cast<int>(images_.size()) < settings_.min_images) {
    out.status = contested_ ? MatchStatus::kAmbiguous : MatchStatus::kSearching;
    out.reason = (contested_ ? "what was recognised is taken back: " : "") + notRecognised();
    return out;
  }
  const std::vector<CameraInBoth> cameras = this->cameras();
  ScaleKnowledge scale;
  scale.stddev = own_unit_ ? std::numeric_limits<double>::infinity() : settings_.scale_stddev;
  const Consensus consensus = consensusOf(cameras, scale);
  judge(cameras, consensus, &out);
  return out;
}

void ViewMatcher::judge(const std::vector<CameraInBoth>& cameras, const Consensus& consensus,
                        MatchEstimate* out) const {
  const auto verdict = [out](MatchStatus status, const std::string& reason) {
    out->status = status;
    out->reason = reason;
  };
  if (!consensus.found) return verdict(MatchStatus::kDegenerate, consensus.reason);
  const auto& agreeing = consensus.agreeing;
  out->images = static_cast<int>(agreeing.size());
  out->T_ground_mav = consensus.T_a_b;
  out->centre = consensus.centre;
  if (out->images < settings_.min_images || out->images < settings_.min_share * static_cast<double>(cameras.size()))
    return verdict(MatchStatus::kAmbiguous, formatted("%d of %zu recognised images agree on where the MAV's map lies",
                                                      out->images, cameras.size()));
  double baseline = 0, distance = 0;
  for (const int i : agreeing) {
    distance += images_[i].distance / out->images;
    for (const int j : agreeing)
      baseline = std::max(baseline, (cameras[i].T_a_camera.translation() - cameras[j].T_a_camera.translation()).norm());
  }
  if (baseline < settings_.min_baseline * distance)
    return verdict(
        MatchStatus::kDegenerate,
        formatted("the %d images that agree are of one place: their cameras lie within %.2f m, %.2f m are needed",
                  out->images, baseline, settings_.min_baseline * distance));
  // What all images share does not average out.
  Matrix7d covariance = consensus.covariance;
  covariance.diagonal().head<3>().array() += std::pow(settings_.systematic * distance, 2);
  covariance.diagonal().segment<3>(3).array() += std::pow(settings_.systematic_angle, 2);
  const double sigma = air_ground_common::largestStddev(covariance.topLeftCorner<3, 3>());
  const double sigma_angle = air_ground_common::largestStddev(covariance.block<3, 3>(3, 3));
  const double sigma_scale = std::sqrt(covariance(6, 6));
  const std::string figures = formatted(
      "%d of %zu recognised images agree, 1 sigma %.3f m %.2f deg, scale %.4f +- %.4f", out->images, cameras.size(),
      sigma, sigma_angle / kDegree, consensus.T_a_b.scale, consensus.T_a_b.scale * sigma_scale);
  out->covariance = covariance;
  const bool sure = sigma <= settings_.max_sigma && sigma_angle <= settings_.max_sigma_angle &&
                    sigma_scale <= settings_.max_sigma_scale;
  verdict(sure ? MatchStatus::kConverged : MatchStatus::kDegenerate, sure ? figures : "not sure enough: " + figures);
}

}  // namespace view_match
