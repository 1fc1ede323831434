#include "streetview_localizer/localizer.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <utility>

#include "air_ground_common/rectification.h"
#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"
#include "candidates.h"
#include "mirror_check.h"
#include "step_times.h"
#include "streetview_localizer/recent_cache.h"
#include "view_search.h"

namespace streetview_localizer {

using air_ground_common::formatted;

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

namespace {

constexpr std::size_t kPyramidBytes = std::size_t{256} << 20;

// An image of much finer resolution than the database's views shows nothing more that could be matched, while
// tolerances in pixels become narrow in it and everything takes long: it is reduced to this multiple of the views'
// focal length.
constexpr double kSearchedFocal = 1.5, kWorthReducing = 1.25;

double medianFocal(const StreetviewDatabase& database) {
  std::vector<double> focals;
  for (const View& view : database.views) focals.push_back(view.camera.fx);
  return air_ground_common::median(std::move(focals));
}

}  // namespace

struct StreetviewLocalizer::Impl {
  std::shared_ptr<const StreetviewDatabase> database;
  StreetviewLocalizerSettings settings;
  BackProjector projector;
  ViewSearch search;
  CandidateFinder candidates;
  /// Gradients of the views' images, which k-VLD needs: too large to keep them all.
  mutable RecentCache<std::shared_ptr<const GradientPyramid>> pyramids;
  const double searched_focal;  // of a large image, once reduced [px]

  Impl(std::shared_ptr<const StreetviewDatabase> db, const StreetviewLocalizerSettings& s)
      : database(std::move(db)),
        settings(s),
        projector(database->model),
        search(*database, settings),
        candidates(*database, projector, settings),
        pyramids(kPyramidBytes, [](const auto& pyramid) { return pyramid->bytes(); }),
        searched_focal(kSearchedFocal * medianFocal(*database)) {}

  static void adopt(Candidate&& c, LocalizerResult* result) {
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
      if (const std::string apart = disagreement(candidates[0], candidates[i]); !apart.empty())
        contradiction = "poses from two panoramas lie " + apart;
    }
    adopt(std::move(candidates[0]), result);
    if (!contradiction.empty()) contradict(contradiction, result);
  }

  // How two poses, each with its panorama, disagree by more than their panoramas' own errors explain; empty if they do
  // not. Poses from one panorama share its error.
  template <typename Posed>
  std::string disagreement(const Posed& a, const Posed& b) const {
    constexpr double kDeviations = 3;
    const auto panorama = [&](const Posed& p) -> const Panorama& {
      return database->panoramas[static_cast<std::size_t>(p.panorama)];
    };
    const Pose &A = a.pose.T_world_camera, &B = b.pose.T_world_camera;
    const double apart = (A.translation() - B.translation()).norm(),
                 turn = air_ground_common::rotationAngle(A.linear(), B.linear());
    double allowed = settings.max_disagreement, allowed_turn = settings.max_turn;
    if (a.panorama != b.panorama) {
      const Panorama &p = panorama(a), &q = panorama(b);
      allowed = std::max(allowed, kDeviations * std::hypot(p.position_stddev, q.position_stddev));
      allowed_turn = std::max(allowed_turn, kDeviations * std::hypot(p.orientation_stddev, q.orientation_stddev));
    }
    if (apart <= allowed && turn <= allowed_turn) return "";
    return formatted("%.1f m and %.1f degrees apart, the second with %zu inliers", apart, turn * 180 / M_PI,
                     b.pose.inliers.size());
  }

  static void contradict(const std::string& why, LocalizerResult* result) {
    result->status = LocalizerStatus::kRefused;
    result->contradicted = true;
    result->acceptance.accepted = false;
    result->acceptance.score = 0;
    result->acceptance.reason = result->reason = why;
  }

  // Of two attempts at one image: the accepted one with more inliers, else the later. Both accepted, they must agree;
  // what the later, with more matches, finds to be ambiguous is so for both.
  LocalizerResult better(LocalizerResult before, LocalizerResult after) const {
    after.features = std::max(after.features, before.features);
    if (!before.accepted() || after.contradicted) return after;
    const bool second = after.accepted() && after.acceptance.evidence.inliers > before.acceptance.evidence.inliers;
    const std::string apart = after.accepted() ? disagreement(before, after) : "";
    LocalizerResult& chosen = second ? after : before;
    chosen.features = after.features;
    if (!apart.empty()) contradict("poses from the image and its virtual views lie " + apart, &chosen);
    return std::move(chosen);
  }

  LocalizerResult locate(const cv::Mat& image, const CameraModel& camera, const PosePrior& prior) const;
  LocalizerResult locateInPinhole(const cv::Mat& image, const CameraModel& camera, const PosePrior& prior) const;
};

namespace {

using air_ground_common::formatted;

cv::Mat greyOf(const cv::Mat& image) {
  cv::Mat grey = image;
  if (image.channels() == 3) cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  return grey;
}

}  // namespace

// One image, and all that is tried to locate it.
class StreetviewLocalizer::Query {
 public:
  Query(const Impl& engine, const cv::Mat& image, const CameraModel& camera, const PosePrior& prior)
      : engine_(engine),
        settings_(engine.settings),
        camera_(camera),
        prior_(prior),
        grey_(greyOf(image)),
        pyramid_(times_.timed(Step::kVerification, [&] { return GradientPyramid(grey_); })),
        features_(times_.timed(Step::kFeatures, [&] { return extractFeatures(grey_, settings_.features.original); })),
        mirror_(features_, engine.search, *engine.database, settings_) {}

  // Cheap first: the strongest features, then all, then the virtual views; each only where those before neither settled
  // it nor met a contradiction.
  LocalizerResult locate() {
    const int count = static_cast<int>(features_.size());
    const bool in_steps = settings_.quick_inliers > 0, has_virtual_views = !settings_.features.views.empty();
    const bool more = count > settings_.quick_features || settings_.max_views > settings_.quick_views;
    bool settled = count < settings_.acceptance.min_inliers;  // a blank image stays blank from every side
    if (settled) best_.reason = formatted("%d features in the image: nothing to match", count);
    if (!settled && in_steps)
      settled = settle(strongestFeatures(features_, settings_.quick_features),
                       std::min(settings_.quick_views, settings_.max_views), settings_.quick_inliers);
    if (!settled && (in_steps ? more : !has_virtual_views)) settled = settle(features_, settings_.max_views, 0);
    best_.quick = settled;
    if (!settled && has_virtual_views) {
      const Features all =
          times_.timed(Step::kFeatures, [&] { return addVirtualViews(features_, grey_, camera_, settings_.features); });
      settle(all, settings_.max_views, 0);
    }
    best_.times = times_.seconds();
    return std::move(best_);
  }

 private:
  // One more attempt; true when no other is needed.
  bool settle(const Features& query, int max_views, int enough) {
    LocalizerResult next = attempt(query, max_views);
    best_ = engine_.better(std::move(best_), std::move(next));
    return best_.accepted() ? best_.acceptance.evidence.inliers >= enough : best_.contradicted;
  }

  LocalizerResult attempt(const Features& query, int max_views) {
    LocalizerResult result;
    result.features = static_cast<int>(query.size());
    const double prior_stddev = prior_.T_world_camera
                                    ? std::sqrt(prior_.covariance.topLeftCorner<2, 2>().diagonal().maxCoeff())
                                    : std::numeric_limits<double>::infinity();
    result.used_prior = prior_stddev <= settings_.max_prior_stddev;
    const std::vector<int> views = viewsFor(query, max_views, result.used_prior);
    std::vector<ViewMatches> parts;
    for (const int v : views) {
      parts.push_back(match(query, v));
      result.matches += static_cast<int>(parts.back().matches.size());
      const int p = engine_.database->views[static_cast<std::size_t>(v)].panorama;
      if (std::find(result.searched.begin(), result.searched.end(), p) == result.searched.end())
        result.searched.push_back(p);
    }
    const auto timer = times_.measure(Step::kPose);
    std::vector<Candidate> candidates = engine_.candidates.find(std::move(parts), query, camera_, prior_);
    if (candidates.empty()) {
      result.reason =
          !views.empty()      ? formatted("fewer than %d matches with every view searched", settings_.min_view_matches)
          : result.used_prior ? "no view of the nearest panoramas shows what would be seen from the predicted pose"
                              : "no panorama resembles the image";
      return result;
    }
    engine_.decide(std::move(candidates), &result);
    if (!result.accepted() || prior_.not_mirrored) return result;
    if (const std::string why = mirror_.objection(result.view, result.used_prior); !why.empty())
      engine_.contradict(why, &result);
    return result;
  }

  std::vector<int> viewsFor(const Features& query, int max_views, bool near_prior) {
    const ViewSearch& search = engine_.search;
    if (near_prior) return times_.timed(Step::kVoting, [&] { return search.byPrior(camera_, prior_, max_views); });
    const FoundDescriptors found = times_.timed(Step::kSearch, [&] { return search.nearest(query); });
    return times_.timed(Step::kVoting, [&] { return search.votedBy(found, query, max_views); });
  }

  ViewMatches match(const Features& query, int index) {
    ViewMatches out;
    out.view = index;
    const Features& seen = engine_.database->views[static_cast<std::size_t>(index)].features;
    const std::vector<Match> putative =
        times_.timed(Step::kMatching, [&] { return matchPairwise(query, seen, settings_.pairwise); });
    if (static_cast<int>(putative.size()) < settings_.min_view_matches) return out;
    const auto timer = times_.measure(Step::kVerification);
    const auto pyramid = engine_.pyramids.get(index, [&] {
      return std::make_shared<const GradientPyramid>(engine_.database->views[static_cast<std::size_t>(index)].image);
    });
    const KvldResult kvld = filterKvld(pyramid_, *pyramid, query.keypoints, seen.keypoints, putative, settings_.kvld);
    auto kept = kvld.kept.begin();  // ascending
    for (int i = 0; i < static_cast<int>(putative.size()); ++i) {
      const bool survived = kept != kvld.kept.end() && *kept == i;
      if (survived) ++kept;
      (survived ? out.matches : out.dropped).push_back(putative[static_cast<std::size_t>(i)]);
    }
    out.supporters = kvld.supporters;
    return out;
  }

  const Impl& engine_;
  const StreetviewLocalizerSettings& settings_;
  const CameraModel& camera_;
  const PosePrior& prior_;
  StepTimes times_;
  const cv::Mat grey_;
  const GradientPyramid pyramid_;
  const Features features_;
  MirrorCheck mirror_;
  LocalizerResult best_;
};

LocalizerResult StreetviewLocalizer::Impl::locate(const cv::Mat& image, const CameraModel& camera,
                                                  const PosePrior& prior) const {
  // NaN in a database without views, in which nothing is found.
  if (!(camera.fx > kWorthReducing * searched_focal)) return Query(*this, image, camera, prior).locate();
  const double factor = searched_focal / camera.fx;
  cv::Mat reduced;
  cv::resize(greyOf(image), reduced, {}, factor, factor, cv::INTER_AREA);
  CameraModel reduced_camera = camera.scaled(factor);
  reduced_camera.width = reduced.cols;
  reduced_camera.height = reduced.rows;
  LocalizerResult result = Query(*this, reduced, reduced_camera, prior).locate();
  for (Correspondence& c : result.correspondences)
    c.pixel = (c.pixel.array() + 0.5) / factor - 0.5;  // (0, 0) is a pixel's centre
  return result;
}

// The panoramas' views are pinholes: features of a fisheye's image look like theirs only after rectification.
LocalizerResult StreetviewLocalizer::Impl::locateInPinhole(const cv::Mat& image, const CameraModel& camera,
                                                           const PosePrior& prior) const {
  constexpr double kMaxField = 100 * M_PI / 180;  // beyond, a pinhole's pixels are mostly of the rim
  const CameraModel view = air_ground_common::centralPinhole(camera, kMaxField);
  cv::Mat rectified;
  cv::remap(image, rectified, air_ground_common::rectificationMap(camera, view), cv::noArray(), cv::INTER_LINEAR,
            cv::BORDER_REPLICATE);
  LocalizerResult result = locate(rectified, view, prior);
  for (Correspondence& c : result.correspondences) {
    const auto pixel = camera.project(view.unproject(c.pixel).homogeneous());
    c.pixel = pixel ? *pixel : Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  return result;
}

StreetviewLocalizer::StreetviewLocalizer(std::shared_ptr<const StreetviewDatabase> database,
                                         const StreetviewLocalizerSettings& settings) {
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

StreetviewLocalizer::~StreetviewLocalizer() = default;

LocalizerResult StreetviewLocalizer::localize(const cv::Mat& image, const CameraModel& camera,
                                              const PosePrior& prior) const {
  const auto start = StepTimes::Clock::now();
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
  const bool pinhole = camera.model == air_ground_common::DistortionModel::kPlumbBob;
  LocalizerResult result = pinhole ? impl_->locate(image, camera, prior) : impl_->locateInPinhole(image, camera, prior);
  result.total_time = StepTimes::secondsSince(start);
  return result;
}

const StreetviewDatabase& StreetviewLocalizer::database() const { return *impl_->database; }
const BackProjector& StreetviewLocalizer::projector() const { return impl_->projector; }
const StreetviewLocalizerSettings& StreetviewLocalizer::settings() const { return impl_->settings; }
const std::string& StreetviewLocalizer::indexRemark() const { return impl_->search.indexRemark(); }

}  // namespace streetview_localizer
