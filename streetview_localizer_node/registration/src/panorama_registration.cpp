#include "streetview_localizer/panorama_registration.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "air_ground_common/text.h"
#include "model_outline.h"
#include "pose_solver.h"

namespace streetview_localizer {
namespace {

using air_ground_common::CameraModel;
using air_ground_common::formatted;
using air_ground_common::Matrix6d;
using air_ground_common::Pose;
namespace reg = registration;

void requireRange(const char* name, double value, double low, double high) {
  if (!(value >= low && value <= high)) {
    throw std::invalid_argument("registration setting " + std::string(name) + " is " + std::to_string(value) +
                                ", must be from " + std::to_string(low) + " to " + std::to_string(high));
  }
}

void validate(const RegistrationSettings& s) {
  requireRange("search_radius", s.search_radius, 0.5, 50);
  requireRange("search_yaw", s.search_yaw, 0.01, M_PI);
  requireRange("geotag_stddev", s.geotag_stddev, 0.01, 100);
  requireRange("heading_stddev", s.heading_stddev, 1e-4, M_PI);
  requireRange("tilt_stddev", s.tilt_stddev, 1e-4, 0.5);
  requireRange("height_stddev", s.height_stddev, 0.01, 100);
  requireRange("camera_height", s.camera_height, 0, 20);
  requireRange("camera_height_stddev", s.camera_height_stddev, 0.01, 10);
  requireRange("model_radius", s.model_radius, 20, 1000);
  requireRange("model_lateral_stddev", s.model_lateral_stddev, 0.001, 5);
  requireRange("model_height_stddev", s.model_height_stddev, 0.001, 10);
  requireRange("roof_overhang", s.roof_overhang, 0, 3);
  requireRange("roof_overhang_stddev", s.roof_overhang_stddev, 0.001, 3);
  requireRange("max_position_stddev", s.max_position_stddev, 0.01, 10);
  requireRange("max_orientation_stddev", s.max_orientation_stddev, 1e-3, 1);
  requireRange("threads", s.threads, 1, 256);
}

/// The settings for an image of which the heading is known, or is not: then any is as likely as any other.
RegistrationSettings settingsFor(const RegistrationSettings& settings, bool heading_known) {
  RegistrationSettings s = settings;
  if (!heading_known) {
    s.search_yaw = M_PI;
    s.heading_stddev = M_PI / std::sqrt(3.0);
  }
  return s;
}

/// The geotag, and how far it is believed.
RegistrationResult rejected(const Pose& geotag, const RegistrationSettings& settings, const std::string& reason) {
  RegistrationResult result;
  result.T_world_panorama = geotag;
  result.reason = reason;
  result.cost = 1;
  result.covariance = geotagCovariance(settings);
  return result;
}

void setStddevs(RegistrationResult* result) {
  result->position_stddev = std::sqrt(result->covariance.topLeftCorner<3, 3>().trace() / 3);
  result->orientation_stddev = std::sqrt(result->covariance.bottomRightCorner<3, 3>().trace() / 3);
}

}  // namespace

Matrix6d geotagCovariance(const RegistrationSettings& settings, bool heading_known) {
  const RegistrationSettings s = settingsFor(settings, heading_known);
  air_ground_common::Vector6d stddev;
  stddev << s.geotag_stddev, s.geotag_stddev, s.height_stddev, s.tilt_stddev, s.tilt_stddev, s.heading_stddev;
  return stddev.cwiseAbs2().asDiagonal();
}

namespace registration {
namespace {

/// What a fit must show to be believed.
struct Demands {
  double sky_angle, sky_ratio;  // of the model's sky line [rad], and the share of it that is found
  int verticals;                // corners found
  double vertical_ratio;        // of the visible ones
  double cost, cost_margin;     // at most; less than that of another place
};
constexpr Demands kOfPanorama = {1.0, 0.62, 4, 0.5, 0.38, 0.025};
// A photograph sees less of the outline: that part must fit better.
constexpr Demands kOfPhotograph = {0.7, 0.8, 5, 0.7, 0.25, 0.05};

/// Why the best fit is not believed; empty when it is. `second_cost`: of the best fit at another place.
/// `out_of_search`: becomes true where the truth may lie where nobody has looked.
std::string doubt(const Fit& best, double second_cost, const Demands& demands, const Pose& T_world_geotag,
                  const RegistrationSettings& settings, bool* out_of_search) {
  const Matrix6d& c = best.covariance;
  const double a = c(0, 0), b = c(0, 1), d = c(1, 1);
  const double horizontal = std::sqrt(0.5 * (a + d) + std::sqrt(0.25 * (a - d) * (a - d) + b * b));
  const double turn = std::sqrt(c.diagonal().tail<3>().maxCoeff());
  const double off = (best.T_world_level.translation() - T_world_geotag.translation()).head<2>().norm();
  const double turned = std::abs(air_ground_common::wrapAngle(air_ground_common::yawOf(best.T_world_level.linear()) -
                                                              air_ground_common::yawOf(T_world_geotag.linear())));
  constexpr double kEdge = 0.9;  // of the search
  const bool at_edge = off > kEdge * settings.search_radius ||
                       (settings.search_yaw < kEdge * M_PI && turned > kEdge * settings.search_yaw);
  const bool misfit = best.sky_ratio < demands.sky_ratio || best.verticals < demands.verticals ||
                      best.verticals < demands.vertical_ratio * best.verticals_seen || best.cost > demands.cost;
  *out_of_search = at_edge || misfit;
  if (best.sky_angle < demands.sky_angle)
    return formatted("the model's sky line covers only %.0f degrees", best.sky_angle * 180 / M_PI);
  if (best.sky_ratio < demands.sky_ratio)
    return formatted("the image's sky line follows only %.0f %% of the model's", 100 * best.sky_ratio);
  if (best.verticals < demands.verticals || best.verticals < demands.vertical_ratio * best.verticals_seen)
    return formatted("only %d of the model's %d visible corners were found", best.verticals, best.verticals_seen);
  if (best.cost > demands.cost) return formatted("the model's outline does not fit (cost %.2f)", best.cost);
  if (second_cost < best.cost + demands.cost_margin)
    return formatted("another place fits nearly as well (cost %.2f against %.2f)", second_cost, best.cost);
  if (off > settings.search_radius + 0.5)
    return formatted("the best place lies %.1f m from the geotag, outside the search", off);
  if (horizontal > settings.max_position_stddev) return formatted("the position is uncertain by %.2f m", horizontal);
  if (turn > settings.max_orientation_stddev)
    return formatted("the orientation is uncertain by %.2f degrees", turn * 180 / M_PI);
  return "";
}

}  // namespace

Selection selectPose(const ModelOutline& model, const ImageCues& cues, const Pose& T_world_geotag,
                     const RegistrationSettings& settings) {
  Selection selection;
  if (!cues.sky.failure.empty()) {
    selection.reason = cues.sky.failure;
    return selection;
  }
  const auto edges = model.edgesNear(T_world_geotag.translation(), settings.model_radius);
  if (edges.empty()) {
    selection.reason = formatted("the model has no building within %.0f m of the geotag", settings.model_radius);
    return selection;
  }
  std::vector<Fit> fits;
  for (const Candidate& candidate : searchCandidates(model, edges, cues, T_world_geotag, settings)) {
    const Fit fit = refinePose(model, edges, cues, candidate, T_world_geotag, settings);
    if (fit.valid) fits.push_back(fit);
  }
  if (fits.empty()) {
    selection.reason = "no place near the geotag from which the model's sky line could be seen";
    return selection;
  }
  std::sort(fits.begin(), fits.end(), [](const Fit& a, const Fit& b) { return a.cost < b.cost; });
  // Once more from the best: what it had taken for a corner from afar may be another from near.
  Candidate again;
  again.position = fits[0].T_world_level.translation();
  again.yaw = air_ground_common::yawOf(fits[0].T_world_level.linear());
  const Fit refit = refinePose(model, edges, cues, again, T_world_geotag, settings);
  if (refit.valid && refit.cost < fits[0].cost) fits[0] = refit;
  const Fit& best = selection.fit = fits[0];
  for (const Fit& other : fits) {
    const double apart = (other.T_world_level.translation() - best.T_world_level.translation()).head<2>().norm();
    const double turn = air_ground_common::wrapAngle(air_ground_common::yawOf(other.T_world_level.linear()) -
                                                     air_ground_common::yawOf(best.T_world_level.linear()));
    if (apart > 0.6 || std::abs(turn) > kOtherHeading)
      selection.second_cost = std::min(selection.second_cost, other.cost);
  }

  bool out_of_search = false;
  selection.reason = doubt(best, selection.second_cost, cues.mask.empty() ? kOfPanorama : kOfPhotograph, T_world_geotag,
                           settings, &out_of_search);
  selection.accepted = selection.reason.empty();
  if (!selection.accepted && out_of_search) {
    selection.reason += formatted("; the geotag may be wrong by more than the search: --search-radius (now %.3g m)",
                                  settings.search_radius);
    if (settings.search_yaw < M_PI)
      selection.reason += formatted(", --search-yaw (now %.3g degrees)", settings.search_yaw * 180 / M_PI);
  }
  return selection;
}

}  // namespace registration

struct PanoramaRegistrar::Impl {
  Impl(const CityModel& city, const RegistrationSettings& s) : all_settings(s), model(city) {}

  RegistrationResult registerImage(const cv::Mat& bgr, const cv::Mat& mask, const Pose& geotag,
                                   bool heading_known) const {
    const RegistrationSettings settings = settingsFor(all_settings, heading_known);
    if (!air_ground_common::isValid(geotag)) throw std::invalid_argument("the geotag's pose is not a rigid transform");
    const reg::ImageCues cues = reg::findCues(bgr, mask, geotag.linear(), settings);
    const reg::Selection selection = reg::selectPose(model, cues, geotag, settings);
    RegistrationResult result = rejected(geotag, settings, selection.reason);
    if (selection.fit.valid) {
      result.cost = selection.fit.cost;
      result.inlier_ratio = selection.fit.sky_ratio;
    }
    if (selection.accepted) {
      result.accepted = true;
      result.T_world_panorama = selection.fit.T_world_level;
      result.T_world_panorama.linear() = result.T_world_panorama.linear() * cues.R_body_level.transpose();
      result.covariance = selection.fit.covariance;
    }
    setStddevs(&result);
    return result;
  }

  RegistrationSettings all_settings;
  reg::ModelOutline model;
};

PanoramaRegistrar::PanoramaRegistrar(const CityModel& model, const RegistrationSettings& settings) {
  validate(settings);
  impl_ = std::make_unique<Impl>(model, settings);
}

PanoramaRegistrar::~PanoramaRegistrar() = default;

RegistrationResult PanoramaRegistrar::registerPanorama(const cv::Mat& equirect_bgr, const Pose& T_world_geotag,
                                                       bool heading_known) const {
  if (equirect_bgr.empty() || equirect_bgr.type() != CV_8UC3 || equirect_bgr.cols < 256 ||
      std::abs(equirect_bgr.cols - 2 * equirect_bgr.rows) > 0.02 * equirect_bgr.cols) {
    throw std::invalid_argument(
        "a panorama must be an 8-bit BGR image twice as wide as high, at least 256 pixels wide; this one is " +
        std::to_string(equirect_bgr.cols) + " x " + std::to_string(equirect_bgr.rows));
  }
  if (equirect_bgr.cols == 2 * equirect_bgr.rows)
    return impl_->registerImage(equirect_bgr, {}, T_world_geotag, heading_known);
  cv::Mat exact;
  cv::resize(equirect_bgr, exact, {equirect_bgr.cols / 2 * 2, equirect_bgr.cols / 2}, 0, 0, cv::INTER_AREA);
  return impl_->registerImage(exact, {}, T_world_geotag, heading_known);
}

RegistrationResult PanoramaRegistrar::registerPhotograph(const cv::Mat& full, const CameraModel& full_camera,
                                                         const Pose& T_world_geotag, bool heading_known) const {
  full_camera.validate();
  if (full.type() != CV_8UC3 || full.cols != full_camera.width || full.rows != full_camera.height) {
    throw std::invalid_argument("the photograph must be 8-bit BGR of the camera's size " +
                                std::to_string(full_camera.width) + " x " + std::to_string(full_camera.height));
  }
  // As part of a panorama, at the resolution of the photograph's middle or the finest that is of use.
  const double scale = std::min(1.0, reg::kLargestWidth / (2 * M_PI * full_camera.fx));
  const CameraModel camera = full_camera.scaled(scale);
  cv::Mat bgr = full;
  if (scale < 1) cv::resize(full, bgr, {camera.width, camera.height}, 0, 0, cv::INTER_AREA);
  const int width = std::max(256, static_cast<int>(std::lround(M_PI * camera.fx)) * 2), height = width / 2;
  cv::Mat map_x(height, width, CV_32F, cv::Scalar(-1)), map_y(height, width, CV_32F, cv::Scalar(-1));
  cv::Mat mask(height, width, CV_8U, cv::Scalar(0));
  const Eigen::Matrix3d R_optical_body = air_ground_common::opticalFromForwardBody();
  const Eigen::Vector3d corner = camera.ray({0.0, 0.0});
  const double limit = 0.95 * corner.z();  // distortion is not to be trusted beyond the image
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      const Eigen::Vector3d ray = R_optical_body * reg::rayOf(u, v, width, height);
      if (ray.z() < limit) continue;
      const auto pixel = camera.project(ray);
      if (!pixel || !camera.contains(*pixel, 1)) continue;
      map_x.at<float>(v, u) = static_cast<float>(pixel->x());
      map_y.at<float>(v, u) = static_cast<float>(pixel->y());
      mask.at<std::uint8_t>(v, u) = 255;
    }
  }
  cv::Mat panorama;
  cv::remap(bgr, panorama, map_x, map_y, cv::INTER_CUBIC, cv::BORDER_CONSTANT);
  return impl_->registerImage(panorama, mask, T_world_geotag, heading_known);
}

std::vector<RegistrationResult> PanoramaRegistrar::registerPanoramas(
    const std::vector<RegistrationInput>& panoramas, const std::function<void(std::size_t)>& progress) const {
  std::vector<RegistrationResult> results(panoramas.size());
  std::size_t done = 0;
#pragma omp parallel for schedule(dynamic, 1) num_threads(impl_->all_settings.threads)
  for (std::size_t i = 0; i < panoramas.size(); ++i) {
    try {
      const RegistrationInput& input = panoramas[i];
      results[i] = input.camera
                       ? registerPhotograph(input.load(), *input.camera, input.T_world_geotag, input.heading_known)
                       : registerPanorama(input.load(), input.T_world_geotag, input.heading_known);
    } catch (const std::exception& error) {
      results[i] = rejected(panoramas[i].T_world_geotag, settingsFor(impl_->all_settings, panoramas[i].heading_known),
                            error.what());
      setStddevs(&results[i]);
    }
#pragma omp critical
    if (progress) progress(++done);
  }
  return results;
}

std::optional<double> PanoramaRegistrar::groundHeight(const Eigen::Vector3d& position) const {
  const reg::GroundGuess guess = impl_->model.groundGuess(position);
  return guess.known || guess.guessed ? std::optional<double>(guess.height) : std::nullopt;
}

cv::Mat PanoramaRegistrar::drawOutline(const cv::Mat& equirect_bgr, const Pose& T_world_panorama) const {
  cv::Mat drawing = equirect_bgr.clone();
  const auto edges = impl_->model.edgesNear(T_world_panorama.translation(), impl_->all_settings.model_radius);
  const reg::Outline outline = impl_->model.visible(edges, T_world_panorama.translation());
  const Pose T_panorama_world = T_world_panorama.inverse();
  const int thickness = std::max(1, drawing.cols / 1024);
  auto line = [&](const Eigen::Vector3d& a, const Eigen::Vector3d& b, const cv::Scalar& colour) {
    Eigen::Vector2d p = reg::pixelOf(T_panorama_world * a, drawing.cols, drawing.rows);
    const int pieces = 24;
    for (int i = 1; i <= pieces; ++i) {
      const Eigen::Vector2d q = reg::pixelOf(T_panorama_world * (a + (b - a) * i / pieces), drawing.cols, drawing.rows);
      if (std::abs(q.x() - p.x()) < drawing.cols / 2.0) {
        cv::line(drawing, cv::Point2d(p.x(), p.y()), cv::Point2d(q.x(), q.y()), colour, thickness, cv::LINE_AA);
      }
      p = q;
    }
  };
  for (const reg::OutlineVertical& vertical : outline.verticals) line(vertical.foot, vertical.top, {0, 220, 255});
  for (const reg::OutlineSample& sample : outline.samples) {
    const double half = 0.5 * sample.weight * (sample.point - T_world_panorama.translation()).norm();
    const bool sky = sample.kind == reg::OutlineSample::Kind::kSky;
    line(sample.point - half * sample.direction, sample.point + half * sample.direction,
         sky ? cv::Scalar(0, 0, 255) : cv::Scalar(0, 200, 0));
  }
  return drawing;
}

}  // namespace streetview_localizer
