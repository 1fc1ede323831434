#include "model_outline.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <stdexcept>

namespace streetview_localizer::registration {
namespace {

constexpr double kCreaseCosine = 0.97;   // 14 degrees
constexpr double kOutlineStep = 0.0105;  // between samples of the outline [rad]

using Key = std::array<long, 3>;

Key keyOf(const Eigen::Vector3f& p) {  // welds corners within a few millimetres
  return {std::lround(p.x() * 250), std::lround(p.y() * 250), std::lround(p.z() * 250)};
}

/// Distance in plan from a point to a segment.
double planDistance(const Eigen::Vector3d& p, const ModelEdge& e) {
  const Eigen::Vector2d a = e.a.head<2>(), d = e.b.head<2>() - a, q = p.head<2>() - a;
  const double s = d.squaredNorm() > 0 ? std::clamp(q.dot(d) / d.squaredNorm(), 0.0, 1.0) : 0.0;
  return (q - s * d).norm();
}

/// Edges of the buildings' triangles at which a face ends or bends.
std::vector<ModelEdge> findCreases(const CityModel& model, const std::vector<char>& solid) {
  const air_ground_common::TriangleMesh& mesh = model.mesh;
  std::map<std::pair<int, std::pair<Key, Key>>, std::vector<int>> faces;
  std::vector<Eigen::Vector3d> normals(mesh.triangles.size());
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (!solid[t]) continue;
    const Eigen::Vector3i& corner = mesh.triangles[t];
    const Eigen::Vector3d a = mesh.vertices[corner[0]].cast<double>(), b = mesh.vertices[corner[1]].cast<double>(),
                          c = mesh.vertices[corner[2]].cast<double>();
    const Eigen::Vector3d n = (b - a).cross(c - a);
    if (n.norm() < 1e-9) continue;
    normals[t] = n.normalized();
    for (int i = 0; i < 3; ++i) {
      Key p = keyOf(mesh.vertices[corner[i]]), q = keyOf(mesh.vertices[corner[(i + 1) % 3]]);
      if (p == q) continue;
      if (q < p) std::swap(p, q);
      faces[{model.building[t], {p, q}}].push_back(static_cast<int>(t) * 3 + i);
    }
  }
  std::vector<ModelEdge> edges;
  for (const auto& [key, users] : faces) {
    bool crease = users.size() == 1;
    for (std::size_t i = 1; i < users.size(); ++i) {
      crease = crease || std::abs(normals[users[0] / 3].dot(normals[users[i] / 3])) < kCreaseCosine;
    }
    if (!crease) continue;
    const Eigen::Vector3i& corner = mesh.triangles[users[0] / 3];
    ModelEdge edge;
    edge.a = mesh.vertices[corner[users[0] % 3]].cast<double>();
    edge.b = mesh.vertices[corner[(users[0] % 3 + 1) % 3]].cast<double>();
    if (edge.b.z() < edge.a.z()) std::swap(edge.a, edge.b);
    edge.building = key.first;
    edge.vertical = std::abs((edge.b - edge.a).normalized().z()) > 0.998;
    for (const int user : users) edge.eave = edge.eave || (!edge.vertical && model.surface[user / 3] == Surface::kWall);
    edges.push_back(edge);
  }
  return edges;
}

/// Of each building the middle of its edges, at the height of the lowest [m].
std::vector<Eigen::Vector3d> findFeet(const std::vector<ModelEdge>& edges) {
  std::map<int, std::pair<Eigen::Vector3d, int>> sums;  // sum of x and y, lowest z, count
  for (const ModelEdge& edge : edges) {
    auto& [foot, used] =
        sums.emplace(edge.building, std::make_pair(Eigen::Vector3d(0, 0, edge.a.z()), 0)).first->second;
    foot += Eigen::Vector3d(edge.a.x(), edge.a.y(), std::min(0.0, edge.a.z() - foot.z()));
    ++used;
  }
  std::vector<Eigen::Vector3d> feet;
  for (const auto& [building, foot] : sums)
    feet.emplace_back(foot.first.x() / foot.second, foot.first.y() / foot.second, foot.first.z());
  return feet;
}

/// Middles of the parts of an edge that a camera at `position` sees under equal angles: metres along, angle [rad]. By
/// shorter steps where the edge is near.
std::vector<std::pair<double, double>> samplesOf(const ModelEdge& edge, const Eigen::Vector3d& position) {
  const double length = (edge.b - edge.a).norm();
  const Eigen::Vector3d direction = (edge.b - edge.a) / length;
  std::vector<std::pair<double, double>> places;
  for (double s = 0; s < length;) {
    const Eigen::Vector3d p = edge.a + s * direction - position;
    const double speed = std::max(1e-4, p.normalized().cross(direction).norm() / std::max(0.5, p.norm()));
    const double step = std::min({kOutlineStep / speed, length - s, 5.0});
    places.emplace_back(s + 0.5 * step, step * speed);
    s += step;
  }
  return places;
}

}  // namespace

ModelOutline::ModelOutline(const CityModel& model) : mesh_(model.mesh), building_(model.building) {
  const std::size_t count = mesh_.triangles.size();
  if (model.surface.size() != count || model.building.size() != count) {
    throw std::invalid_argument("the city model has " + std::to_string(count) +
                                " triangles but lists of surfaces and buildings of other lengths");
  }
  solid_.resize(count);
  air_ground_common::TriangleMesh ground;
  for (std::size_t t = 0; t < count; ++t) {
    solid_[t] = model.isBuilding(static_cast<int>(t));
    building_count_ = std::max(building_count_, building_[t] + 1);
    if (building_[t] < 0 && model.surface[t] == Surface::kGround) ground.triangles.push_back(mesh_.triangles[t]);
  }
  edges_ = findCreases(model, solid_);
  if (edges_.empty())
    throw std::invalid_argument("the city model has no building: panoramas cannot be registered to it");
  feet_ = findFeet(edges_);
  scene_ = std::make_unique<air_ground_common::MeshScene>(mesh_);
  if (!ground.triangles.empty()) {
    ground.vertices = mesh_.vertices;
    ground_ = std::make_unique<air_ground_common::MeshScene>(ground);
    for (const Eigen::Vector3i& t : ground.triangles)
      for (int k = 0; k < 3; ++k) above_ = std::max(above_, ground.vertices[t[k]].z() + 1);
  }
}

std::vector<ModelEdge> ModelOutline::edgesNear(const Eigen::Vector3d& position, double radius) const {
  std::vector<ModelEdge> near;
  for (const ModelEdge& edge : edges_) {
    if (planDistance(position, edge) < radius) near.push_back(edge);
  }
  return near;
}

void ModelOutline::skyProfile(const std::vector<ModelEdge>& edges, const Eigen::Vector3d& position, int bins,
                              SkyProfile* profile) {
  profile->tangent.assign(bins, 0.0f);
  profile->distance.assign(bins, 0.0f);
  profile->building.assign(bins, -1);
  std::vector<Eigen::Vector2d> axes(bins);
  for (int i = 0; i < bins; ++i) {
    const double azimuth = (0.5 - (i + 0.5) / bins) * 2 * M_PI;
    axes[i] = {std::cos(azimuth), std::sin(azimuth)};
  }
  auto binOf = [bins](const Eigen::Vector3d& p) { return (0.5 - std::atan2(p.y(), p.x()) / (2 * M_PI)) * bins - 0.5; };
  for (const ModelEdge& edge : edges) {
    if (edge.vertical) continue;
    const Eigen::Vector3d a = edge.a - position, b = edge.b - position;
    if (a.z() < 0 && b.z() < 0) continue;
    double from = binOf(a), to = binOf(b);
    if (to - from > bins / 2.0) to -= bins;
    if (from - to > bins / 2.0) from -= bins;
    if (from > to) std::swap(from, to);
    const Eigen::Vector3d d = b - a;
    for (int i = static_cast<int>(std::ceil(from)); i <= to; ++i) {
      const int bin = ((i % bins) + bins) % bins;
      const Eigen::Vector2d& axis = axes[bin];
      const double denominator = axis.x() * d.y() - axis.y() * d.x();
      if (std::abs(denominator) < 1e-9) continue;
      const double s = -(axis.x() * a.y() - axis.y() * a.x()) / denominator;
      const Eigen::Vector3d p = a + std::clamp(s, 0.0, 1.0) * d;
      const double distance = axis.dot(p.head<2>());
      if (distance < 0.3) continue;
      const float tangent = static_cast<float>(p.z() / distance);
      if (tangent > profile->tangent[bin]) {
        profile->tangent[bin] = tangent;
        profile->distance[bin] = static_cast<float>(distance);
        profile->building[bin] = edge.building;
      }
    }
  }
}

ModelOutline::EdgeView ModelOutline::lookAside(const ModelEdge& edge, const Eigen::Vector3d& p,
                                               const Eigen::Vector3d& direction,
                                               const Eigen::Vector3d& position) const {
  constexpr double kAside = 0.0045;  // [rad]
  EdgeView view;
  const Eigen::Vector3d ray = p - position;
  const double distance = ray.norm();
  view.across = ray.cross(direction);
  if (distance < 0.5 || view.across.norm() < 0.05 * distance) return view;
  view.across.normalize();
  for (const int side : {-1, 1}) {
    const Eigen::Vector3d d = (ray / distance + side * kAside * view.across).normalized();
    const auto hit = scene_->cast(position.cast<float>(), d.cast<float>());
    if (hit && std::abs(hit->distance - distance) < 0.3 + 0.03 * distance &&
        building_[hit->triangle] == edge.building && solid_[hit->triangle]) {
      ++view.own_sides;
      continue;
    }
    if (hit && hit->distance < distance - 0.3) {  // hidden
      view.own_sides = 0;
      return view;
    }
    view.outside = side;
    view.sky = !hit;
    view.boundary = !hit || !solid_[hit->triangle] || building_[hit->triangle] != edge.building;
  }
  return view;
}

void ModelOutline::addEdge(const ModelEdge& edge, const Eigen::Vector3d& position, Outline* outline) const {
  const double length = (edge.b - edge.a).norm();
  if (length < 0.3) return;
  const Eigen::Vector3d direction = (edge.b - edge.a) / length;
  double seen_low = std::numeric_limits<double>::infinity(), seen_high = -seen_low;
  int seen = 0, boundary = 0;
  for (const auto& [s, angle] : samplesOf(edge, position)) {
    const Eigen::Vector3d p = edge.a + s * direction;
    const EdgeView view = lookAside(edge, p, direction, position);
    if (view.own_sides < 1) continue;
    ++seen;
    seen_low = std::min(seen_low, s);
    seen_high = std::max(seen_high, s);
    if (view.own_sides != 1) continue;
    if (view.boundary) ++boundary;
    if (!view.sky || p.z() < position.z()) continue;  // below the camera nothing is seen against the sky
    OutlineSample sample;
    sample.point = p;
    sample.direction = direction;
    sample.outside = view.outside * view.across;
    sample.building = edge.building;
    sample.eave = edge.eave;
    sample.weight = angle;
    outline->samples.push_back(sample);
  }
  if (edge.vertical && seen >= 3) {
    OutlineVertical vertical;
    vertical.foot = edge.a + seen_low * direction;
    vertical.top = edge.a + seen_high * direction;
    vertical.building = edge.building;
    vertical.boundary = 2 * boundary > seen;
    outline->verticals.push_back(vertical);
  }
}

// Walls often reach below the terrain: their foot is where they meet it.
void ModelOutline::addFeet(const Eigen::Vector3d& position, Outline* outline) const {
  const Eigen::Vector3f origin = position.cast<float>();
  for (double azimuth = -M_PI; azimuth < M_PI; azimuth += kOutlineStep) {
    const Eigen::Vector3f level(std::cos(azimuth), std::sin(azimuth), 0);
    const auto hit = scene_->cast(origin, level, 40);
    if (!hit || !solid_[hit->triangle] || std::abs(hit->normal.z()) > 0.2f) continue;
    const Eigen::Vector3d wall = position + hit->distance * level.cast<double>();
    const Eigen::Vector3d along = Eigen::Vector3d::UnitZ().cross(hit->normal.cast<double>()).normalized();
    const auto below = groundHeight(wall.x() - 0.05 * level.x(), wall.y() - 0.05 * level.y());
    const auto beside = groundHeight(wall.x() + along.x() - 0.05 * level.x(), wall.y() + along.y() - 0.05 * level.y());
    if (!below || !beside || *below > position.z() - 0.5) continue;
    OutlineSample sample;
    sample.kind = OutlineSample::Kind::kFoot;
    sample.point = {wall.x(), wall.y(), *below};
    sample.direction = Eigen::Vector3d(along.x(), along.y(), *beside - *below).normalized();
    const Eigen::Vector3d ray = sample.point - position;
    sample.outside = ray.cross(sample.direction).normalized();
    if (sample.outside.z() > 0) sample.outside = -sample.outside;
    sample.building = building_[hit->triangle];
    sample.weight = kOutlineStep;
    const auto check = scene_->cast(origin, ray.normalized().cast<float>());
    if (check && check->distance < ray.norm() - 0.3) continue;
    outline->samples.push_back(sample);
  }
}

Outline ModelOutline::visible(const std::vector<ModelEdge>& edges, const Eigen::Vector3d& position) const {
  Outline outline;
  for (const ModelEdge& edge : edges) addEdge(edge, position, &outline);
  if (ground_) addFeet(position, &outline);
  return outline;
}

std::optional<double> ModelOutline::groundHeight(double x, double y) const {
  if (!ground_) return std::nullopt;
  const auto hit = ground_->cast({static_cast<float>(x), static_cast<float>(y), above_}, {0, 0, -1});
  if (!hit) return std::nullopt;
  return static_cast<double>(above_) - hit->distance;
}

GroundGuess ModelOutline::groundGuess(const Eigen::Vector3d& position) const {
  GroundGuess guess;
  if (const auto terrain = groundHeight(position.x(), position.y())) {
    guess.known = true;
    guess.height = *terrain;
    return guess;
  }
  // A plane through the feet of the walls around.
  Eigen::Matrix3d normal = Eigen::Vector3d(1e-9, 2.0, 2.0).asDiagonal();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  double weights = 0;
  for (const Eigen::Vector3d& foot : feet_) {
    const Eigen::Vector2d off = foot.head<2>() - position.head<2>();
    const double distance = off.norm();
    if (distance > 80) continue;
    const double w = 1 / (1 + distance * distance / 400);
    const Eigen::Vector3d j(1, off.x() / 20, off.y() / 20);
    normal += w * j * j.transpose();
    right += w * foot.z() * j;
    weights += w;
  }
  if (weights <= 0) return guess;
  // Footings lie lower than the pavement in front of them.
  constexpr double kFooting = 0.3;
  guess.height = normal.ldlt().solve(right).x() + kFooting;
  guess.guessed = true;
  return guess;
}

bool ModelOutline::insideBuilding(const Eigen::Vector3d& position) const {
  // The first solid above decides: seen from below means seen from inside only where the roof closes it; count instead.
  Eigen::Vector3f origin = position.cast<float>();
  int crossings = 0;
  for (int i = 0; i < 16; ++i) {
    const auto hit = scene_->cast(origin, {0.001f, 0.0013f, 1.0f});
    if (!hit) break;
    if (building_[hit->triangle] >= 0) ++crossings;  // an underside closes the solid above it
    origin += (hit->distance + 0.01f) * Eigen::Vector3f(0.001f, 0.0013f, 1.0f);
  }
  return crossings % 2 == 1;
}

}  // namespace streetview_localizer::registration
