#include "streetview_localizer/view_synthesis.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace streetview_localizer {
namespace {

using air_ground_common::CameraModel;
using air_ground_common::Pose;

constexpr int kReduction = 4;          // of the depth images that tell what is occluded
constexpr double kOccluded = 0.5;      // the model in front of a point by more than this hides it [m]
constexpr double kMinIncidence = 0.1;  // cosine: beyond 84 degrees a pixel smears over the wall
constexpr int kViewsUsed = 32;         // for a place of the model
const cv::Vec3b kSky(235, 225, 215);

cv::Vec3b shade(const Eigen::Vector3d& normal) {
  const double light = 110 + 60 * std::abs(normal.dot(Eigen::Vector3d(0.5, 0.3, 0.81)));
  return {cv::saturate_cast<uchar>(light), cv::saturate_cast<uchar>(light), cv::saturate_cast<uchar>(light)};
}

Eigen::Vector3d normalOf(const air_ground_common::TriangleMesh& mesh, int triangle) {
  const Eigen::Vector3i& t = mesh.triangles[static_cast<std::size_t>(triangle)];
  const Eigen::Vector3f a = mesh.vertices[static_cast<std::size_t>(t[0])],
                        b = mesh.vertices[static_cast<std::size_t>(t[1])],
                        c = mesh.vertices[static_cast<std::size_t>(t[2])];
  return (b - a).cross(c - a).cast<double>().normalized();
}

cv::Vec3b sampleBilinear(const cv::Mat& image, const Eigen::Vector2d& pixel) {
  const double x = std::clamp(pixel.x(), 0.0, image.cols - 1.001), y = std::clamp(pixel.y(), 0.0, image.rows - 1.001);
  const int x0 = static_cast<int>(x), y0 = static_cast<int>(y);
  const double u = x - x0, v = y - y0;
  cv::Vec3d sum;
  const auto add = [&](int row, int col, double weight) {
    if (image.channels() == 1)
      sum += weight * cv::Vec3d::all(image.at<uchar>(row, col));
    else
      sum += weight * cv::Vec3d(image.at<cv::Vec3b>(row, col));
  };
  add(y0, x0, (1 - u) * (1 - v));
  add(y0, x0 + 1, u * (1 - v));
  add(y0 + 1, x0, (1 - u) * v);
  add(y0 + 1, x0 + 1, u * v);
  return {cv::saturate_cast<uchar>(sum[0]), cv::saturate_cast<uchar>(sum[1]), cv::saturate_cast<uchar>(sum[2])};
}

}  // namespace

ViewSynthesizer::ViewSynthesizer(const StreetviewDatabase& database, const BackProjector& projector)
    : database_(database), projector_(projector), depth_(database.views.size()), depth_camera_(database.views.size()) {
#pragma omp parallel for schedule(dynamic, 4)
  for (std::size_t i = 0; i < database.views.size(); ++i) {
    const View& view = database.views[i];
    depth_camera_[i] = view.camera.scaled(1.0 / kReduction);
    depth_[i] = projector.render(depth_camera_[i], view.T_world_camera).depth;
  }
}

std::vector<int> ViewSynthesizer::viewsNear(const Eigen::Vector3d& position, int count) const {
  std::vector<int> views;
  for (const int p : database_.nearest(position, count)) {
    for (const int v : database_.viewsOf(p))
      if (!database_.views[static_cast<std::size_t>(v)].image.empty()) views.push_back(v);
    if (static_cast<int>(views.size()) >= count) break;
  }
  return views;
}

bool ViewSynthesizer::colour(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, const std::vector<int>& views,
                             cv::Vec3b* bgr) const {
  double best = 0;
  int best_view = -1;
  Eigen::Vector2d best_pixel;
  for (const int v : views) {
    const auto index = static_cast<std::size_t>(v);
    const View& view = database_.views[index];
    const Eigen::Vector3d from_view = point - view.T_world_camera.translation();
    const double distance = from_view.norm();
    const double incidence = std::abs(normal.dot(from_view)) / distance;
    const double score = incidence / distance;
    if (score <= best || incidence < kMinIncidence) continue;
    const Eigen::Vector3d in_view = view.T_world_camera.linear().transpose() * from_view;
    const auto pixel = view.camera.project(in_view);
    if (!pixel || !view.camera.contains(*pixel, 2)) continue;
    const auto reduced = depth_camera_[index].project(in_view);
    if (!reduced || !depth_camera_[index].contains(*reduced)) continue;
    const float depth =
        depth_[index].at<float>(static_cast<int>(reduced->y() + 0.5), static_cast<int>(reduced->x() + 0.5));
    if (depth > 0 && in_view.z() - depth > kOccluded + 0.02 * distance) continue;
    best = score;
    best_view = v;
    best_pixel = *pixel;
  }
  if (best_view < 0) return false;
  *bgr = sampleBilinear(database_.views[static_cast<std::size_t>(best_view)].image, best_pixel);
  return true;
}

cv::Mat ViewSynthesizer::render(const CameraModel& camera, const Pose& T_world_camera, int views_used) const {
  const ModelImage model = projector_.render(camera, T_world_camera);
  const std::vector<int> views = viewsNear(T_world_camera.translation(), views_used);
  cv::Mat image(camera.height, camera.width, CV_8UC3, cv::Scalar(kSky[0], kSky[1], kSky[2]));
  const auto& mesh = projector_.model().mesh;
#pragma omp parallel for schedule(dynamic, 16)
  for (int row = 0; row < image.rows; ++row) {
    for (int col = 0; col < image.cols; ++col) {
      const int triangle = model.triangle.at<int>(row, col);
      if (triangle < 0) continue;
      const Eigen::Vector2d n = camera.unproject({col, row});
      const Eigen::Vector3d point =
          T_world_camera * (model.depth.at<float>(row, col) * Eigen::Vector3d(n.x(), n.y(), 1));
      const Eigen::Vector3d normal = normalOf(mesh, triangle);
      if (!colour(point, normal, views, &image.at<cv::Vec3b>(row, col))) image.at<cv::Vec3b>(row, col) = shade(normal);
    }
  }
  return image;
}

std::vector<ColouredPoint> ViewSynthesizer::sampleModel(double spacing, std::size_t max_points) const {
  const CityModel& model = projector_.model();
  std::vector<int> triangles;
  double area = 0;
  const auto corner = [&](int triangle, int k) -> Eigen::Vector3d {
    return model.mesh.vertices[static_cast<std::size_t>(model.mesh.triangles[static_cast<std::size_t>(triangle)][k])]
        .cast<double>();
  };
  for (int t = 0; t < static_cast<int>(model.mesh.triangles.size()); ++t) {
    if (!model.isBuilding(t)) continue;
    triangles.push_back(t);
    area += 0.5 * (corner(t, 1) - corner(t, 0)).cross(corner(t, 2) - corner(t, 0)).norm();
  }
  spacing = std::max(spacing, std::sqrt(area / static_cast<double>(std::max<std::size_t>(max_points, 1))));
  std::vector<std::vector<ColouredPoint>> parts(triangles.size());
#pragma omp parallel for schedule(dynamic, 16)
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    // From the longest edge on, so that a needle has few rows: at most as many as its area has.
    int first = 0;
    const auto edge = [&](int k) { return (corner(triangles[i], (k + 1) % 3) - corner(triangles[i], k)).norm(); };
    for (int k = 1; k < 3; ++k)
      if (edge(k) > edge(first)) first = k;
    const Eigen::Vector3d a = corner(triangles[i], first), e1 = corner(triangles[i], (first + 1) % 3) - a,
                          e2 = corner(triangles[i], (first + 2) % 3) - a;
    const Eigen::Vector3d normal = e1.cross(e2).normalized();
    const double length = e1.norm();
    if (!normal.allFinite() || length < 1e-6) continue;
    // A square lattice in the triangle's plane.
    const Eigen::Vector3d x = e1 / length, y = normal.cross(x);
    const double bx = e2.dot(x), by = e2.dot(y);
    std::vector<int> views;
    Eigen::Vector3d views_at = Eigen::Vector3d::Constant(1e9);
    for (double v = 0.5 * spacing; v < by; v += spacing) {
      const double left = v / by * bx, right = length + v / by * (bx - length);
      for (double u = left + 0.5 * spacing; u < right; u += spacing) {
        ColouredPoint p;
        const Eigen::Vector3d point = a + u * x + v * y;
        if ((point - views_at).norm() > 5) views = viewsNear(views_at = point, kViewsUsed);
        p.position = point.cast<float>();
        if (!colour(point, normal, views, &p.bgr)) p.bgr = shade(normal);
        parts[i].push_back(p);
      }
    }
  }
  std::vector<ColouredPoint> points;
  for (const auto& part : parts) points.insert(points.end(), part.begin(), part.end());
  return points;
}

}  // namespace streetview_localizer
