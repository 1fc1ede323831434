#include "synthetic_street.h"

#include <cmath>

namespace streetview_localizer {
namespace {

using air_ground_common::Pose;

double uniform(std::mt19937_64* random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(*random);
}

double normal(std::mt19937_64* random, double stddev) {
  return std::normal_distribution<double>(0, 1)(*random) * stddev;
}

/// Value noise in [0, 1] of a lattice of unit spacing.
float noise(float x, float y, std::uint32_t salt) {
  const int ix = static_cast<int>(std::floor(x)), iy = static_cast<int>(std::floor(y));
  auto lattice = [salt](int i, int j) {
    std::uint32_t h =
        static_cast<std::uint32_t>(i) * 374761393u + static_cast<std::uint32_t>(j) * 668265263u + salt * 2246822519u;
    h = (h ^ (h >> 13)) * 1274126177u;
    return static_cast<float>((h ^ (h >> 16)) & 0xffffu) / 65535.0f;
  };
  const float fx = x - ix, fy = y - iy;
  const float sx = fx * fx * (3 - 2 * fx), sy = fy * fy * (3 - 2 * fy);
  const float a = lattice(ix, iy) + sx * (lattice(ix + 1, iy) - lattice(ix, iy));
  const float b = lattice(ix, iy + 1) + sx * (lattice(ix + 1, iy + 1) - lattice(ix, iy + 1));
  return a + sy * (b - a);
}

}  // namespace

Eigen::Vector3d SyntheticStreet::place(double along, double across, double height) const {
  const double c = std::cos(settings_.heading), s = std::sin(settings_.heading);
  return {c * along - s * across, s * along + c * across, height + settings_.slope * along};
}

void SyntheticStreet::addPolygon(const std::vector<Eigen::Vector3d>& corners, Kind kind, int house,
                                 const Eigen::Vector3f& colour) {
  Patch patch;
  patch.kind = kind;
  patch.house = house;
  patch.origin = corners[0].cast<float>();
  patch.along = (corners[1] - corners[0]).cast<float>();
  patch.length = patch.along.norm();
  patch.along /= patch.length;
  patch.normal = patch.along.cross((corners[2] - corners[0]).cast<float>()).normalized();
  patch.up = patch.normal.cross(patch.along);
  patch.colour = colour;
  const int first = static_cast<int>(mesh_.vertices.size());
  for (const auto& corner : corners) mesh_.vertices.push_back(corner.cast<float>());
  for (int i = 2; i < static_cast<int>(corners.size()); ++i) {
    mesh_.triangles.push_back({first, first + i - 1, first + i});
    patch_of_triangle_.push_back(static_cast<int>(patches_.size()));
  }
  patches_.push_back(patch);
}

void SyntheticStreet::addBox(double s0, double s1, double q0, double q1, double height, const Eigen::Vector3f& colour) {
  const double s[4] = {s0, s1, s1, s0}, q[4] = {q0, q0, q1, q1};
  for (int i = 0; i < 4; ++i) {
    const int j = (i + 1) % 4;
    addPolygon({place(s[i], q[i], 0), place(s[j], q[j], 0), place(s[j], q[j], height), place(s[i], q[i], height)},
               Kind::kBox, -1, colour);
  }
  addPolygon({place(s0, q0, height), place(s1, q0, height), place(s1, q1, height), place(s0, q1, height)}, Kind::kBox,
             -1, colour);
}

void SyntheticStreet::addHouse(double s0, double s1, double q0, double q1, double height, double ridge,
                               std::mt19937_64* random) {
  const int id = static_cast<int>(houses_.size());
  House house;
  house.wall = Eigen::Vector3f(uniform(random, 0.3, 0.8), uniform(random, 0.3, 0.75), uniform(random, 0.25, 0.7));
  house.trim = house.wall * static_cast<float>(uniform(random, 0.6, 1.3));
  house.window = Eigen::Vector3f::Constant(static_cast<float>(uniform(random, 0.08, 0.3)));
  house.pitch_x = static_cast<float>(uniform(random, 1.8, 3.2));
  house.pitch_y = static_cast<float>(uniform(random, 2.8, 3.6));
  house.fill_x = static_cast<float>(uniform(random, 0.35, 0.6));
  house.fill_y = static_cast<float>(uniform(random, 0.4, 0.65));
  house.offset = static_cast<float>(uniform(random, 3.2, 4.2));
  house.phase = static_cast<float>(uniform(random, 0, 1));
  houses_.push_back(house);

  // The floors are level: the wall's lower edge lies below the sloping ground, as in a cadastral model.
  const double base = settings_.slope * std::min(s0, s1), top = settings_.slope * 0.5 * (s0 + s1) + height;
  auto corner = [this](double s, double q, double z) {
    Eigen::Vector3d p = place(s, q, 0);
    p.z() = z;
    return p;
  };
  const Eigen::Vector3f roof_colour(0.35f, 0.2f, 0.16f);
  // Counter-clockwise seen from above, whatever the order of q0 and q1.
  const double a = std::min(q0, q1), b = std::max(q0, q1), middle = 0.5 * (a + b);
  const double s[4] = {s0, s1, s1, s0}, q[4] = {a, a, b, b};
  auto build = [&](double base_z, double top_z, double ridge_z, const Eigen::Vector3d& shift, auto&& polygon) {
    for (int i = 0; i < 4; ++i) {
      const int j = (i + 1) % 4;
      std::vector<Eigen::Vector3d> wall = {corner(s[i], q[i], base_z), corner(s[j], q[j], base_z),
                                           corner(s[j], q[j], top_z)};
      if (ridge_z > top_z && i % 2 == 1) wall.push_back(corner(s[i], middle, ridge_z));
      wall.push_back(corner(s[i], q[i], top_z));
      for (auto& p : wall) p += shift;
      polygon(wall, Kind::kWall);
    }
    std::vector<std::vector<Eigen::Vector3d>> roofs;
    if (ridge_z > top_z) {
      roofs.push_back(
          {corner(s0, a, top_z), corner(s1, a, top_z), corner(s1, middle, ridge_z), corner(s0, middle, ridge_z)});
      roofs.push_back(
          {corner(s1, b, top_z), corner(s0, b, top_z), corner(s0, middle, ridge_z), corner(s1, middle, ridge_z)});
    } else {
      roofs.push_back({corner(s0, a, top_z), corner(s1, a, top_z), corner(s1, b, top_z), corner(s0, b, top_z)});
    }
    for (auto& roof : roofs) {
      for (auto& p : roof) p += shift;
      polygon(roof, Kind::kRoof);
    }
  };
  build(base, top, top + ridge, Eigen::Vector3d::Zero(),
        [&](const std::vector<Eigen::Vector3d>& corners, Kind kind) { addPolygon(corners, kind, id, roof_colour); });

  const double height_error = normal(random, settings_.model_height_stddev);
  const Eigen::Vector3d shift(normal(random, settings_.model_lateral_stddev),
                              normal(random, settings_.model_lateral_stddev), 0);
  build(base, top + height_error, top + ridge + height_error, shift,
        [&](const std::vector<Eigen::Vector3d>& corners, Kind kind) {
          const int first = static_cast<int>(model_.mesh.vertices.size());
          for (const auto& p : corners) model_.mesh.vertices.push_back(p.cast<float>());
          for (int i = 2; i < static_cast<int>(corners.size()); ++i) {
            model_.mesh.triangles.push_back({first, first + i - 1, first + i});
            model_.surface.push_back(kind == Kind::kRoof ? Surface::kRoof : Surface::kWall);
            model_.building.push_back(id);
          }
        });
  model_.building_ids.push_back("house_" + std::to_string(id));
}

SyntheticStreet::SyntheticStreet(const SyntheticStreetSettings& settings) : settings_(settings) {
  std::mt19937_64 random(settings.seed * 7919 + 17);
  sun_ = Eigen::Vector3f(uniform(&random, -1, 1), uniform(&random, -1, 1), uniform(&random, 0.4, 1.2)).normalized();
  light_ = Eigen::Vector3f(uniform(&random, 0.9, 1.1), 1.0f, uniform(&random, 0.85, 1.05)) * uniform(&random, 0.8, 1.2);

  const double ends = 60;
  const std::vector<Eigen::Vector3d> ground = {place(-ends, -80, 0), place(settings.length + ends, -80, 0),
                                               place(settings.length + ends, 80, 0), place(-ends, 80, 0)};
  addPolygon(ground, Kind::kGround, -1, Eigen::Vector3f(0.3f, 0.3f, 0.31f));
  for (const auto& p : ground) model_.mesh.vertices.push_back(p.cast<float>());
  for (const Eigen::Vector3i& t : {Eigen::Vector3i(0, 1, 2), Eigen::Vector3i(0, 2, 3)}) {
    model_.mesh.triangles.push_back(t);
    model_.surface.push_back(Surface::kGround);
    model_.building.push_back(-1);
  }
  for (const int side : {-1, 1}) {
    for (double s = -ends; s < settings.length + ends;) {
      const double width = uniform(&random, 7, 16), front = uniform(&random, 7.0, 8.2);
      const double height = uniform(&random, 7.5, 17);
      const bool gable = uniform(&random, 0, 1) < 0.4;
      addHouse(s, s + width, side * front, side * (front + 10), height, gable ? uniform(&random, 2, 4) : 0, &random);
      s += width;
      const double draw = uniform(&random, 0, 1);
      if (draw < 0.12) s += uniform(&random, 1.5, 4);
      if (draw > 0.92) s += uniform(&random, 9, 13);
    }
  }
  if (settings.occluders) {
    for (const int side : {-1, 1}) {
      for (double s = -ends; s < settings.length + ends; s += 6) {
        if (uniform(&random, 0, 1) < 0.45) {
          const Eigen::Vector3f colour(uniform(&random, 0.05, 0.8), uniform(&random, 0.05, 0.8),
                                       uniform(&random, 0.05, 0.8));
          addBox(s, s + 4.3, side * 3.6, side * 5.4, uniform(&random, 1.4, 2.0), colour);
        }
        if (uniform(&random, 0, 1) < 0.3) {
          const double along = s + uniform(&random, 0, 5);
          addBox(along, along + 0.5, side * 6.0, side * 6.4, 1.75, Eigen::Vector3f(0.15f, 0.15f, 0.3f));
        }
      }
    }
  }
  scene_ = std::make_unique<air_ground_common::MeshScene>(mesh_);
}

Pose SyntheticStreet::panoramaPose(double along, std::mt19937_64* random) const {
  const Eigen::Vector3d p = place(along, uniform(random, -2, 2), 2.5 + normal(random, 0.03));
  Pose pose = air_ground_common::yawPose(settings_.heading + normal(random, 0.03), p);
  pose.linear() *=
      air_ground_common::expSO3({normal(random, 0.01), -std::atan(settings_.slope) + normal(random, 0.01), 0});
  return pose;
}

Eigen::Vector3f SyntheticStreet::sky(const Eigen::Vector3f& d) const {
  const float up = std::max(0.0f, d.z());
  Eigen::Vector3f colour = Eigen::Vector3f(0.75f, 0.82f, 0.9f) * (1 - up) + Eigen::Vector3f(0.35f, 0.55f, 0.85f) * up;
  const float x = d.x() / (up + 0.25f), y = d.y() / (up + 0.25f);
  const auto salt = static_cast<std::uint32_t>(settings_.seed);
  const float cloud = 0.6f * noise(1.5f * x, 1.5f * y, salt) + 0.4f * noise(4 * x, 4 * y, salt + 1);
  const float white = std::min(1.0f, std::max(0.0f, (cloud - 0.5f) * 4));
  return colour * (1 - white) + Eigen::Vector3f(0.93f, 0.93f, 0.95f) * white;
}

Eigen::Vector3f SyntheticStreet::shade(const Patch& patch, const Eigen::Vector3f& point) const {
  const Eigen::Vector3f offset = point - patch.origin;
  const float x = offset.dot(patch.along), y = offset.dot(patch.up);
  Eigen::Vector3f albedo = patch.colour;
  if (patch.kind == Kind::kWall) {
    const House& house = houses_[patch.house];
    albedo = y < house.offset - 0.5f ? house.trim : house.wall;
    const float u = x / house.pitch_x + house.phase, v = (y - house.offset) / house.pitch_y;
    const float fu = u - std::floor(u), fv = v - std::floor(v);
    const bool in_wall = x > 0.6f && x < patch.length - 0.6f;
    if (in_wall && v > 0 && fu < house.fill_x && fv > 0.2f && fv < 0.2f + house.fill_y) {
      const bool frame = fu < 0.05f || fu > house.fill_x - 0.05f || fv < 0.23f || fv > 0.17f + house.fill_y;
      albedo =
          frame ? Eigen::Vector3f(0.85f, 0.85f, 0.82f)
                : Eigen::Vector3f(house.window * (0.6f + 0.8f * noise(std::floor(u) + 0.5f, std::floor(v) + 0.5f, 3u)));
    }
    if (in_wall && y < house.offset - 1.2f && y > 0.3f && fu < 0.6f) albedo = house.window * 0.8f;
    albedo *= 0.85f + 0.3f * noise(3 * x, 3 * y, patch.house) * (0.5f + noise(0.4f * x, 0.4f * y, patch.house + 9));
  } else if (patch.kind == Kind::kGround) {
    const float across = std::abs(-std::sin(settings_.heading) * point.x() + std::cos(settings_.heading) * point.y());
    if (across > 5.4f) albedo *= 1.5f;
    albedo *= 0.8f + 0.4f * noise(2 * x, 2 * y, 5u);
  }
  const float direct = std::max(0.0f, patch.normal.dot(sun_));
  return (albedo * (0.45f + 0.6f * direct)).cwiseProduct(light_);
}

cv::Vec3b SyntheticStreet::pixel(const Eigen::Vector3f& origin, const std::array<Eigen::Vector3f, 4>& rays,
                                 int number) const {
  Eigen::Vector3f sum = Eigen::Vector3f::Zero();
  for (const Eigen::Vector3f& ray : rays) {
    const auto hit = scene_->cast(origin, ray);
    sum += hit ? shade(patches_[patch_of_triangle_[hit->triangle]], origin + hit->distance * ray) : sky(ray);
  }
  // Gamma 2, and the sensor's noise from the pixel's own place.
  std::uint32_t h = static_cast<std::uint32_t>(number) * 2654435761u;
  cv::Vec3b colour;
  for (int c = 0; c < 3; ++c) {
    h = (h ^ (h >> 15)) * 2246822519u;
    const float grain = (static_cast<float>(h >> 16) / 65535.0f - 0.5f) * 8;
    const float value = 255 * std::sqrt(std::min(1.0f, 0.25f * sum[2 - c])) + grain;
    colour[c] = cv::saturate_cast<std::uint8_t>(value);
  }
  return colour;
}

cv::Mat SyntheticStreet::render(const Pose& T_world_panorama) const {
  const int width = settings_.image_width, height = width / 2;
  cv::Mat image(height, width, CV_8UC3);
  const Eigen::Matrix3f R = T_world_panorama.linear().cast<float>();
  const Eigen::Vector3f origin = T_world_panorama.translation().cast<float>();
#pragma omp parallel for schedule(dynamic, 8)
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      std::array<Eigen::Vector3f, 4> rays;
      for (int sample = 0; sample < 4; ++sample) {
        const double azimuth = (0.5 - (u + 0.25 + 0.5 * (sample & 1)) / width) * 2 * M_PI;
        const double elevation = (0.5 - (v + 0.25 + 0.5 * (sample >> 1)) / height) * M_PI;
        rays[sample] = R * Eigen::Vector3f(std::cos(elevation) * std::cos(azimuth),
                                           std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      }
      image.at<cv::Vec3b>(v, u) = pixel(origin, rays, v * width + u);
    }
  }
  return image;
}

cv::Mat SyntheticStreet::photograph(const air_ground_common::CameraModel& camera, const Pose& T_world_body) const {
  cv::Mat image(camera.height, camera.width, CV_8UC3);
  const Eigen::Matrix3d R = T_world_body.linear() * air_ground_common::opticalFromForwardBody().transpose();
  const Eigen::Vector3f origin = T_world_body.translation().cast<float>();
#pragma omp parallel for schedule(dynamic, 8)
  for (int v = 0; v < camera.height; ++v) {
    for (int u = 0; u < camera.width; ++u) {
      std::array<Eigen::Vector3f, 4> rays;
      for (int sample = 0; sample < 4; ++sample)
        rays[sample] = (R * camera.ray({u - 0.25 + 0.5 * (sample & 1), v - 0.25 + 0.5 * (sample >> 1)})).cast<float>();
      image.at<cv::Vec3b>(v, u) = pixel(origin, rays, v * camera.width + u);
    }
  }
  return image;
}

Pose drawGeotag(const Pose& T_world_panorama, std::mt19937_64* random) {
  // Rayleigh's mean is 1.25 sigma, that of three axes 1.6 sigma.
  Pose geotag = T_world_panorama;
  geotag.translation() += Eigen::Vector3d(normal(random, 2.8), normal(random, 2.8), normal(random, 1.0));
  geotag.linear() = geotag.linear() *
                    air_ground_common::expSO3({normal(random, 0.0207), normal(random, 0.0207), normal(random, 0.0207)});
  return geotag;
}

}  // namespace streetview_localizer
