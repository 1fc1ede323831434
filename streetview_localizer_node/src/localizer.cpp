#include "streetview_localizer/localizer.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <numeric>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <utility>

#include "air_ground_common/rectification.h"
#include "mirror_check.h"
#include "pyramid_cache.h"
#include "step_timer.h"
#include "view_search.h"

namespace streetview_localizer {
namespace {

constexpr double kDegree = M_PI / 180;
constexpr double kGravityGate = 4;  // standard deviations

std::string text(const char* format, double a, double b = 0, double c = 0) {
  char line[240];
  std::snprintf(line, sizeof line, format, a, b, c);
  return line;
}

// Matches of the query with one view.
struct ViewMatches {
  int view = 0;
  std::vector<Match> matches;   // that survived k-VLD
  std::vector<int> supporters;  // of each
  std::vector<Match> dropped;   // by k-VLD: evidence against a pose
};

// Matches with panoramas whose points may be used as one.
struct Group {
  std::vector<ViewMatches> parts;
  int size() const {
    return std::accumulate(parts.begin(), parts.end(), 0,
                           [](int n, const ViewMatches& p) { return n + static_cast<int>(p.matches.size()); });
  }
};

struct Candidate {
  PoseResult pose;
  Acceptance acceptance;
  std::vector<Correspondence> correspondences;
  std::vector<int> views;
  std::size_t kept = 0;  // the first correspondences; k-VLD dropped the others
  int panorama = -1, view = -1;
};

// Index of the most frequent value; the first of equals.
int mostFrequent(const std::map<int, int>& counts) {
  int best = -1, most = 0;
  for (const auto& [value, count] : counts)
    if (count > most) best = value, most = count;
  return best;
}

}  // namespace

const char* nameOf(LocalizerStatus status) {
  switch (status) {
    case LocalizerStatus::kAccepted:
      return "accepted";
    case LocalizerStatus::kRefused:
      return "refused";
    case LocalizerStatus::kNoPose:
      return "no_pose";
    case LocalizerStatus::kNoMatch:
      return "no_match";
  }
  return "";
}

const char* nameOf(Step step) {
  switch (step) {
    case Step::kFeatures:
      return "1 virtual views, features";
    case Step::kSearch:
      return "2 search in the database";
    case Step::kVoting:
      return "3 voting";
    case Step::kMatching:
      return "4 pairwise matching";
    case Step::kVerification:
      return "5 k-VLD";
    case Step::kPose:
      return "6 pose, acceptance";
  }
  return "";
}

struct Localizer::Impl {
  std::shared_ptr<const StreetviewDatabase> database;
  LocalizerSettings settings;
  BackProjector projector;

  ViewSearch search;
  mutable PyramidCache pyramids;

  Impl(std::shared_ptr<const StreetviewDatabase> db, const LocalizerSettings& s)
      : database(std::move(db)),
        settings(s),
        projector(database->model),
        search(*database, settings),
        pyramids(*database) {}

  const View& view(int index) const { return database->views[static_cast<std::size_t>(index)]; }
  const Panorama& panorama(int index) const { return database->panoramas[static_cast<std::size_t>(index)]; }

  ViewMatches match(const Features& query, const GradientPyramid& query_pyramid, int index,
                    LocalizerResult* result) const {
    ViewMatches out;
    out.view = index;
    const View& candidate = view(index);
    std::vector<Match> putative;
    {
      const StepTimer timer(result, Step::kMatching);
      putative = matchPairwise(query, candidate.features, settings.pairwise);
    }
    const StepTimer timer(result, Step::kVerification);
    if (static_cast<int>(putative.size()) < settings.min_view_matches) return out;
    const KvldResult kvld = filterKvld(query_pyramid, *pyramids.of(index), query.keypoints,
                                       candidate.features.keypoints, putative, settings.kvld);
    auto kept = kvld.kept.begin();  // ascending
    for (int i = 0; i < static_cast<int>(putative.size()); ++i) {
      const bool survived = kept != kvld.kept.end() && *kept == i;
      if (survived) ++kept;
      (survived ? out.matches : out.dropped).push_back(putative[static_cast<std::size_t>(i)]);
    }
    out.supporters = kvld.supporters;
    return out;
  }

  // One group for all panoramas of well-known pose, one for each of the others: their errors, a decimetre, are common
  // to the points of one and would set those of two against each other.
  std::vector<Group> grouped(std::vector<ViewMatches> parts) const {
    std::vector<Group> groups;
    std::map<int, std::size_t> group_of;
    for (ViewMatches& part : parts) {
      if (static_cast<int>(part.matches.size()) < settings.min_view_matches) continue;
      const int p = view(part.view).panorama;
      const bool exact = panorama(p).position_stddev <= settings.merge_position_stddev &&
                         panorama(p).orientation_stddev <= settings.merge_orientation_stddev;
      const auto [it, is_new] = group_of.try_emplace(exact ? -1 : p, groups.size());
      if (is_new) groups.emplace_back();
      groups[it->second].parts.push_back(std::move(part));
    }
    std::stable_sort(groups.begin(), groups.end(), [](const Group& a, const Group& b) { return a.size() > b.size(); });
    return groups;
  }

  Candidate locate(const Group& group, const Features& query, const CameraModel& camera, const PosePrior& prior) const {
    Candidate c;
    std::vector<ViewRay> rays;
    std::map<int, int> matches_of_panorama;
    const auto add = [&](const ViewMatches& part, const Match& m, double quality) {
      const View& from = view(part.view);
      const auto q = static_cast<std::size_t>(m.query), v = static_cast<std::size_t>(m.view);
      Correspondence corr;
      corr.pixel = {query.keypoints[q].pt.x, query.keypoints[q].pt.y};
      corr.view_pixel = {from.features.keypoints[v].pt.x, from.features.keypoints[v].pt.y};
      corr.p_world = from.points[v].cast<double>();
      corr.normal = from.normals[v].cast<double>();
      corr.view_centre = from.T_world_camera.translation();
      corr.quality = quality;
      c.correspondences.push_back(corr);
      c.views.push_back(part.view);
      rays.push_back({from.T_world_camera.translation(), 1 / from.camera.fx, panorama(from.panorama).position_stddev});
    };
    for (const ViewMatches& part : group.parts) {
      matches_of_panorama[view(part.view).panorama] += static_cast<int>(part.matches.size());
      for (std::size_t i = 0; i < part.matches.size(); ++i)
        add(part, part.matches[i], part.supporters[i] * (1 - part.matches[i].ratio));
    }
    c.kept = c.correspondences.size();
    for (const ViewMatches& part : group.parts)
      for (const Match& m : part.dropped) add(part, m, 0);
    c.panorama = mostFrequent(matches_of_panorama);
    PointSource source = sourceOf(c.panorama);
    c.pose = estimatePose(c.correspondences, camera, source, prior, settings.pose, c.kept);
    if (c.pose.success) {
      // The panorama that the pose rests on.
      std::map<int, int> inliers_of_panorama, inliers_of_view;
      for (const int i : c.pose.inliers) {
        const int v = c.views[static_cast<std::size_t>(i)];
        ++inliers_of_view[v];
        ++inliers_of_panorama[view(v).panorama];
      }
      c.panorama = mostFrequent(inliers_of_panorama);
      c.view = mostFrequent(inliers_of_view);
      source = sourceOf(c.panorama);
      if (inliers_of_panorama.size() > 1) refine(camera, prior, rays, &c);
    }
    c.acceptance = judge(c.pose, c.correspondences, camera, source, settings.pose, settings.acceptance, c.kept);
    if (c.acceptance.accepted && prior.up_camera) checkGravity(prior, &c);
    if (c.acceptance.accepted) checkAgainstModel(&c);
    if (settings.covariance == CovarianceKind::kMonteCarlo) useMonteCarlo(&c);
    c.correspondences.resize(c.kept);
    c.views.resize(c.kept);
    return c;
  }

  PointSource sourceOf(int index) const {
    PointSource source;
    const Panorama& p = panorama(index);
    source.position = p.T_world_panorama.translation();
    source.position_stddev = p.position_stddev;
    source.orientation_stddev = p.orientation_stddev;
    source.model_lateral_stddev = settings.model_lateral_stddev;
    source.model_height_stddev = settings.model_height_stddev;
    return source;
  }

  // Several panoramas see the same points: their rays fix them better than the model. Only a pose that the matches
  // support as well, and near what was found without, takes the place of the first.
  void refine(const CameraModel& camera, const PosePrior& prior, const std::vector<ViewRay>& rays, Candidate* c) const {
    const auto fused = fusePoints(c->correspondences, rays, c->pose.inliers, settings.fusion);
    const FusedRefinement refined = refineOnFusedPoints(fused, camera, prior, c->pose.T_world_camera, settings.fusion);
    if (!refined.converged) return;
    const Pose& from = c->pose.T_world_camera;
    const Eigen::Vector3d moved = refined.T_world_camera.translation() - from.translation();
    const Eigen::Vector3d turned =
        air_ground_common::logSO3(refined.T_world_camera.linear() * from.linear().transpose());
    const auto deviations = [](const Eigen::Vector3d& e, const Eigen::Matrix3d& covariance) {
      return std::sqrt(e.dot(covariance.llt().solve(e)));
    };
    if (!(deviations(moved, c->pose.covariance.topLeftCorner<3, 3>()) <= settings.max_fusion_shift) ||
        !(deviations(turned, c->pose.covariance.bottomRightCorner<3, 3>()) <= settings.max_fusion_shift))
      return;
    const auto kept =
        onMovedWalls({c->correspondences.begin(), c->correspondences.begin() + static_cast<long>(c->kept)}, c->pose);
    PoseHypothesis scored = scorePose(refined.T_world_camera, kept, camera, settings.pose);
    if (static_cast<double>(scored.inliers.size()) <
        settings.min_fusion_inliers * static_cast<double>(c->pose.inliers.size()))
      return;
    static_cast<PoseHypothesis&>(c->pose) = std::move(scored);
    c->pose.covariance += refined.covariance - c->pose.image_covariance;
    c->pose.image_covariance = refined.covariance;
  }

  // The paper's covariance in place of the estimate's.
  static void useMonteCarlo(Candidate* c) {
    if (c->pose.monte_carlo_covariance)
      c->pose.covariance = *c->pose.monte_carlo_covariance;
    else if (c->acceptance.accepted)
      refuse(text("only %.0f samples of five matches give a plausible pose: no Monte Carlo covariance",
                  c->pose.monte_carlo_plausible),
             c);
  }

  static void refuse(const std::string& why, Candidate* c) {
    c->acceptance.accepted = false;
    c->acceptance.score = 0;
    c->acceptance.reason = why;
  }

  // Gravity is part of the estimate; matches that pull away from it all the same belong to another attitude.
  static void checkGravity(const PosePrior& prior, Candidate* c) {
    const Eigen::Vector3d up = c->pose.T_world_camera.linear() * prior.up_camera->normalized();
    const double angle = std::acos(std::clamp(up.z(), -1.0, 1.0)), bound = kGravityGate * prior.up_stddev;
    if (angle > bound)
      refuse(text("the attitude is %.1f degrees off the direction of gravity, at most %.1f", angle / kDegree,
                  bound / kDegree),
             c);
  }

  // A camera stands above the ground, outside of buildings, and sees what it matched.
  void checkAgainstModel(Candidate* c) const {
    const Eigen::Vector3d centre = c->pose.T_world_camera.translation();
    const auto below = projector.cast(centre, -Eigen::Vector3d::UnitZ());
    const auto above = projector.cast(centre, Eigen::Vector3d::UnitZ());
    const CityModel& model = projector.model();
    const bool over_ground = below && !model.isBuilding(below->triangle);
    if (over_ground && below->distance < settings.min_height)
      return refuse(text("%.2f m above the ground of the model, at least %.2f", below->distance, settings.min_height),
                    c);
    if (above && !model.isBuilding(above->triangle))
      return refuse("the camera would be below the ground of the model", c);
    int visible = 0;
    for (const int i : c->pose.inliers) {
      const Correspondence& corr = c->correspondences[static_cast<std::size_t>(i)];
      const Eigen::Vector3d ray = corr.p_world - centre;
      const auto hit = projector.cast(centre, ray);
      // Half a metre of tolerance: the model's own error, seen obliquely.
      visible += !hit || hit->distance > ray.norm() - 0.5 - 0.03 * ray.norm();
    }
    const double share =
        static_cast<double>(visible) / static_cast<double>(std::max<std::size_t>(c->pose.inliers.size(), 1));
    if (share < settings.min_visible_share)
      refuse(text("only %.0f %% of the matched points are visible from the pose, at least %.0f %%", 100 * share,
                  100 * settings.min_visible_share),
             c);
  }

  void take(Candidate&& c, LocalizerResult* result) const {
    result->pose = std::move(c.pose);
    result->acceptance = std::move(c.acceptance);
    result->correspondences = std::move(c.correspondences);
    result->views = std::move(c.views);
    result->panorama = c.panorama;
    result->view = c.view;
    result->reason = result->acceptance.reason;
    result->status = !result->pose.success         ? LocalizerStatus::kNoPose
                     : result->acceptance.accepted ? LocalizerStatus::kAccepted
                                                   : LocalizerStatus::kRefused;
  }

  void decide(std::vector<Candidate> candidates, LocalizerResult* result) const {
    const auto better = [](const Candidate& a, const Candidate& b) {
      if (a.acceptance.accepted != b.acceptance.accepted) return a.acceptance.accepted;
      if (a.pose.success != b.pose.success) return a.pose.success;
      return a.acceptance.evidence.inliers > b.acceptance.evidence.inliers;
    };
    std::stable_sort(candidates.begin(), candidates.end(), better);
    std::string contradiction;
    for (std::size_t i = 1; i < candidates.size() && candidates[i].acceptance.accepted; ++i) {
      const double inliers = candidates[i].acceptance.evidence.inliers;
      if (inliers < settings.min_rival_share * candidates[0].acceptance.evidence.inliers) continue;
      if (const std::string apart = disagreement(candidates[0].pose, candidates[i].pose); !apart.empty())
        contradiction = "poses from two panoramas lie " + apart;
    }
    take(std::move(candidates[0]), result);
    if (!contradiction.empty()) contradict(contradiction, result);
  }

  // How two poses disagree; empty if they do not.
  std::string disagreement(const PoseResult& a, const PoseResult& b) const {
    const double apart = (a.T_world_camera.translation() - b.T_world_camera.translation()).norm();
    const double turn = air_ground_common::rotationAngle(a.T_world_camera.linear(), b.T_world_camera.linear());
    if (apart <= settings.max_disagreement && turn <= settings.max_turn) return "";
    return text("%.1f m and %.1f degrees apart, the second with %.0f inliers", apart, turn / kDegree,
                static_cast<double>(b.inliers.size()));
  }

  static void contradict(const std::string& why, LocalizerResult* result) {
    result->status = LocalizerStatus::kRefused;
    result->acceptance.accepted = false;
    result->acceptance.score = 0;
    result->acceptance.reason = result->reason = why;
  }

  void run(const cv::Mat& image, const CameraModel& camera, const PosePrior& prior, LocalizerResult* result) const {
    cv::Mat grey = image;
    if (image.channels() == 3) cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
    std::unique_ptr<GradientPyramid> pyramid;
    {
      const StepTimer timer(result, Step::kVerification);
      pyramid = std::make_unique<GradientPyramid>(grey);
    }
    Features features;
    {
      const StepTimer timer(result, Step::kFeatures);
      features = extractFeatures(grey, settings.features.original);
    }
    MirrorCheck mirror(features, search, *database, settings);
    LocalizerResult best;
    const auto settled = [&](const Features& query, int max_views, int enough) {
      LocalizerResult next;
      next.times = best.times;
      attempt(query, *pyramid, camera, prior, max_views, &mirror, &next);
      const bool both = best.accepted() && next.accepted();
      best = better(std::move(best), std::move(next));
      return best.accepted() ? best.acceptance.evidence.inliers >= enough : both;
    };
    best.times = result->times;
    const bool in_steps = settings.quick_inliers > 0;
    bool done = static_cast<int>(features.size()) <
                settings.acceptance.min_inliers;  // a blank image stays blank from every side
    if (done) best.reason = text("%.0f features in the image: nothing to match", static_cast<double>(features.size()));
    if (!done && in_steps)
      done = settled(strongestFeatures(features, settings.quick_features),
                     std::min(settings.quick_views, settings.max_views), settings.quick_inliers);
    const bool more =
        static_cast<int>(features.size()) > settings.quick_features || settings.max_views > settings.quick_views;
    if (!done && (in_steps ? more : settings.features.views.empty())) done = settled(features, settings.max_views, 0);
    best.quick = done;
    if (!done && !settings.features.views.empty()) {
      {
        StepTimer timer(&best, Step::kFeatures);
        features = addVirtualViews(features, grey, camera, settings.features);
      }
      settled(features, settings.max_views, 0);
    }
    *result = std::move(best);
  }

  // The panoramas' views are pinholes: features of a fisheye's image look like theirs only after rectification.
  void runOnPinhole(const cv::Mat& image, const CameraModel& camera, const PosePrior& prior,
                    LocalizerResult* result) const {
    constexpr double kMaxField = 100 * M_PI / 180;  // beyond, a pinhole's pixels are mostly of the rim
    const CameraModel view = air_ground_common::centralPinhole(camera, kMaxField);
    cv::Mat rectified;
    cv::remap(image, rectified, air_ground_common::rectificationMap(camera, view), cv::noArray(), cv::INTER_LINEAR,
              cv::BORDER_REPLICATE);
    run(rectified, view, prior, result);
    for (Correspondence& c : result->correspondences) {
      const auto pixel = camera.project(view.unproject(c.pixel).homogeneous());
      c.pixel = pixel ? *pixel : Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
    }
  }

  // Of two attempts at one image: the accepted one with more inliers, else the later. Both accepted, they must agree.
  LocalizerResult better(LocalizerResult before, LocalizerResult after) const {
    after.features = std::max(after.features, before.features);
    if (!before.accepted()) return after;
    const bool second = after.accepted() && after.acceptance.evidence.inliers > before.acceptance.evidence.inliers;
    const std::string apart = after.accepted() ? disagreement(before.pose, after.pose) : "";
    LocalizerResult& chosen = second ? after : before;
    chosen.times = after.times;
    chosen.features = after.features;
    if (!apart.empty()) contradict("poses from the image and its virtual views lie " + apart, &chosen);
    return std::move(chosen);
  }

  void attempt(const Features& query, const GradientPyramid& pyramid, const CameraModel& camera, const PosePrior& prior,
               int max_views, MirrorCheck* mirror, LocalizerResult* result) const {
    result->features = static_cast<int>(query.size());
    const double prior_stddev = prior.T_world_camera
                                    ? std::sqrt(prior.covariance.topLeftCorner<2, 2>().diagonal().maxCoeff())
                                    : std::numeric_limits<double>::infinity();
    result->used_prior = prior_stddev <= settings.max_prior_stddev;
    std::vector<int> views;
    if (result->used_prior) {
      const StepTimer timer(result, Step::kVoting);
      views = search.byPrior(camera, prior, max_views);
    } else {
      views = search.byDescriptors(query, max_views, result);
    }
    std::vector<ViewMatches> parts;
    for (const int v : views) {
      parts.push_back(match(query, pyramid, v, result));
      result->matches += static_cast<int>(parts.back().matches.size());
      const int p = view(v).panorama;
      if (std::find(result->searched.begin(), result->searched.end(), p) == result->searched.end())
        result->searched.push_back(p);
    }
    const StepTimer timer(result, Step::kPose);
    std::vector<Candidate> candidates;
    for (const Group& group : grouped(std::move(parts))) candidates.push_back(locate(group, query, camera, prior));
    if (candidates.empty()) {
      result->reason =
          !views.empty()       ? text("fewer than %.0f matches with every view searched", settings.min_view_matches)
          : result->used_prior ? "no view of the nearest panoramas shows what would be seen from the predicted pose"
                               : "no panorama resembles the image";
      return;
    }
    decide(std::move(candidates), result);
    if (!result->accepted()) return;
    if (const std::string why = mirror->objection(result->view, result->used_prior); !why.empty())
      contradict(why, result);
  }
};

Localizer::Localizer(std::shared_ptr<const StreetviewDatabase> database, const LocalizerSettings& settings) {
  settings.validate();
  if (!database) throw std::invalid_argument("localizer: no database");
  std::size_t features = 0;
  for (const View& view : database->views) {
    features += view.features.size();
    if (view.image.empty())
      throw std::invalid_argument("localizer: the database was loaded without its images, which k-VLD needs");
  }
  if (features == 0) throw std::invalid_argument("localizer: the database holds no features on buildings");
  impl_ = std::make_unique<Impl>(std::move(database), settings);
}

Localizer::~Localizer() = default;

LocalizerResult Localizer::localize(const cv::Mat& image, const CameraModel& camera, const PosePrior& prior) const {
  const auto start = StepTimer::Clock::now();
  camera.validate();
  if (image.depth() != CV_8U || (image.channels() != 1 && image.channels() != 3))
    throw std::invalid_argument("localizer: the image must be grey or BGR of 8 bits");
  if (image.cols != camera.width || image.rows != camera.height)
    throw std::invalid_argument("localizer: the image has " + std::to_string(image.cols) + " x " +
                                std::to_string(image.rows) + " pixels, its calibration " +
                                std::to_string(camera.width) + " x " + std::to_string(camera.height));
  if (prior.T_world_camera && (!air_ground_common::isValid(*prior.T_world_camera) || !prior.covariance.allFinite()))
    throw std::invalid_argument("localizer: the predicted pose is not finite");
  if (prior.T_world_camera && Eigen::LLT<Matrix6d>(prior.covariance).info() != Eigen::Success)
    throw std::invalid_argument("localizer: the covariance of the predicted pose is not positive definite");
  if (prior.up_camera && (!prior.up_camera->allFinite() || prior.up_camera->norm() < 1e-9))
    throw std::invalid_argument("localizer: the direction of gravity is not finite");
  LocalizerResult result;
  if (camera.model == air_ground_common::DistortionModel::kPlumbBob)
    impl_->run(image, camera, prior, &result);
  else
    impl_->runOnPinhole(image, camera, prior, &result);
  result.total_time = StepTimer::secondsSince(start);
  return result;
}

const StreetviewDatabase& Localizer::database() const { return *impl_->database; }
const BackProjector& Localizer::projector() const { return impl_->projector; }
const LocalizerSettings& Localizer::settings() const { return impl_->settings; }
const std::string& Localizer::indexRemark() const { return impl_->search.indexRemark(); }

}  // namespace streetview_localizer
