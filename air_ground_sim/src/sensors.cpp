#include "air_ground_sim/sensors.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace air_ground_sim {
namespace {

constexpr int kQuantiles = 4096;
constexpr int kSignalSteps = 4096;

// Inverse of the normal distribution by bisection of erfc; used to fill a table once.
double normalQuantile(double p) {
  double low = -6, high = 6;
  for (int i = 0; i < 60; ++i) {
    const double mid = 0.5 * (low + high);
    (0.5 * std::erfc(-mid / std::sqrt(2.0)) < p ? low : high) = mid;
  }
  return 0.5 * (low + high);
}

const std::vector<float>& normalTable() {
  static const std::vector<float> table = [] {
    std::vector<float> t(kQuantiles);
    for (int i = 0; i < kQuantiles; ++i) t[i] = static_cast<float>(normalQuantile((i + 0.5) / kQuantiles));
    return t;
  }();
  return table;
}

}  // namespace

ExposureControl::ExposureControl(const ImagerConfig& config)
    : config_(config), exposure_(std::sqrt(config.min_exposure * config.max_exposure)) {}

void ExposureControl::update(double mean_grey) {
  // The response is a power law: the signal's ratio is the grey values' ratio to 1 / response.
  const double ratio = std::pow(config_.target_mean / std::max(0.02, mean_grey), 1 / config_.response);
  exposure_ =
      std::clamp(exposure_ * std::pow(std::clamp(ratio, 0.25, 4.0), 0.15), config_.min_exposure, config_.max_exposure);
}

Imager::Imager(const ImagerConfig& config, std::uint64_t seed)
    : config_(config), seed_(seed), gaussian_(normalTable()) {
  const auto& c = config.camera;
  c.validate();
  vignette_.resize(static_cast<std::size_t>(c.width) * c.height);
  const double corner = std::max(std::hypot(c.cx, c.cy), std::hypot(c.width - 1 - c.cx, c.height - 1 - c.cy));
  for (int y = 0; y < c.height; ++y)
    for (int x = 0; x < c.width; ++x) {
      const double r = std::hypot(x - c.cx, y - c.cy) / corner;
      const bool seen = c.unproject({x, y}).allFinite();
      vignette_[static_cast<std::size_t>(y) * c.width + x] =
          seen ? static_cast<float>(1 - config.vignetting * r * r) : 0.0f;
    }
  response_.resize(kSignalSteps);
  for (int i = 0; i < kSignalSteps; ++i)
    response_[i] = static_cast<std::uint8_t>(
        std::lround(255 * std::pow(static_cast<double>(i) / (kSignalSteps - 1), config.response)));
}

double Imager::expose(const std::vector<float>& light, int channels, double exposure, int frame,
                      std::vector<std::uint8_t>* image) const {
  const int w = config_.camera.width, h = config_.camera.height;
  if (light.size() != static_cast<std::size_t>(w) * h * channels)
    throw std::invalid_argument("light does not fit the camera's size");
  image->resize(light.size());
  const float gain = static_cast<float>(config_.sensitivity * exposure);
  const float shot = static_cast<float>(1 / config_.full_well);
  const float read2 = static_cast<float>(config_.read_noise * config_.read_noise) * shot * shot;
  std::vector<double> row_sum(h);
#pragma omp parallel for schedule(static)
  for (int y = 0; y < h; ++y) {
    std::uint64_t state = mix(mix(seed_, static_cast<std::uint64_t>(frame)), static_cast<std::uint64_t>(y)) | 1;
    const float* in = &light[static_cast<std::size_t>(y) * w * channels];
    std::uint8_t* out = &(*image)[static_cast<std::size_t>(y) * w * channels];
    const float* vignette = &vignette_[static_cast<std::size_t>(y) * w];
    std::uint64_t sum = 0;
    for (int i = 0; i < w * channels; ++i) {
      state ^= state << 13;  // xorshift64: one number a value
      state ^= state >> 7;
      state ^= state << 17;
      const float signal = in[i] * gain * vignette[channels == 1 ? i : i / 3];
      const float noisy = signal + gaussian_[state >> 52] * std::sqrt(std::max(0.0f, signal) * shot + read2);
      out[i] = response_[static_cast<int>(std::clamp(noisy, 0.0f, 1.0f) * (kSignalSteps - 1) + 0.5f)];
      sum += out[i];
    }
    row_sum[y] = static_cast<double>(sum);
  }
  double sum = 0;
  for (double s : row_sum) sum += s;
  return sum / 255 / static_cast<double>(light.size());
}

double kinectAxialSigma(double z, double angle) {
  const double sigma = 0.0012 + 0.0019 * (z - 0.4) * (z - 0.4);
  const double limit = M_PI / 2 - angle;
  return sigma + 0.0001 / std::sqrt(z) * angle * angle / std::max(1e-3, limit * limit);
}

void measureDepth(const DepthImage& truth, const DepthConfig& c, std::uint64_t seed, int frame,
                  std::vector<std::uint16_t>* depth_mm) {
  const int w = truth.width, h = truth.height;
  depth_mm->assign(static_cast<std::size_t>(w) * h, 0);
  const std::vector<float>& normal = normalTable();
  const double steps = c.focal * c.baseline * c.subpixel;  // disparity in steps of 1 / subpixel px, times metres
#pragma omp parallel for schedule(static)
  for (int y = 0; y < h; ++y) {
    std::uint64_t state = mix(mix(seed, static_cast<std::uint64_t>(frame)), static_cast<std::uint64_t>(y)) | 1;
    const auto random = [&state] {
      state ^= state << 13;
      state ^= state >> 7;
      state ^= state << 17;
      return state;
    };
    for (int x = 0; x < w; ++x) {
      const std::size_t pixel = static_cast<std::size_t>(y) * w + x;
      if (!c.noise) {
        const float z = truth.depth[pixel];
        if (z >= c.min_range && z <= c.max_range)
          (*depth_mm)[pixel] = static_cast<std::uint16_t>(std::lround(1000 * z));
        continue;
      }
      const std::uint64_t bits = random();
      // The matched window is not centred exactly on the pixel: lateral noise.
      const int sx = std::clamp(x + static_cast<int>(std::lround(c.lateral * normal[bits & 4095])), 0, w - 1);
      const int sy = std::clamp(y + static_cast<int>(std::lround(c.lateral * normal[(bits >> 12) & 4095])), 0, h - 1);
      const std::size_t source = static_cast<std::size_t>(sy) * w + sx;
      const double z = truth.depth[source];
      if (z <= 0 || !truth.lit[source]) continue;
      const double share = static_cast<double>((bits >> 24) & 0xffff) / 65536;
      const double cosine = truth.cosine[source];
      // Correlation fails more and more beyond 80 degrees, always beyond 87.
      const double grazing = std::clamp((0.174 - cosine) / (0.174 - 0.052), 0.0, 1.0);
      // A window across a jump in depth matches neither side well.
      double jump = 0;
      for (const int offset : {-2, 2}) {
        const float a = truth.depth[static_cast<std::size_t>(y) * w + std::clamp(x + offset, 0, w - 1)];
        const float b = truth.depth[static_cast<std::size_t>(std::clamp(y + offset, 0, h - 1)) * w + x];
        jump = std::max({jump, std::abs(a - z), std::abs(b - z)});
      }
      const double edge = jump > 0.03 + 0.03 * z ? 0.5 : 0.0;
      if (share < c.dropout + (1 - c.dropout) * std::max(grazing, edge)) continue;
      const double noisy = z + normal[(bits >> 40) & 4095] * kinectAxialSigma(z, std::acos(std::min(1.0, cosine)));
      if (!(noisy > 0.1)) continue;
      const double disparity = std::round(steps / noisy);
      if (disparity < 1) continue;
      const double measured = steps / disparity;
      if (measured < c.min_range || measured > c.max_range) continue;
      (*depth_mm)[pixel] = static_cast<std::uint16_t>(std::lround(1000 * measured));
    }
  }
}

Imu::Imu(const ImuConfig& config, const air_ground_common::Pose& T_base_imu, std::uint64_t seed,
         const FaultsConfig& faults)
    : config_(config), T_base_imu_(T_base_imu), rng_(seed), vibration_(faults.vibration, mix(seed, 51)) {
  gyro_bias_ = initialBias(config.gyro_bias, noise(), faults.gyro_bias);
  accel_bias_ = initialBias(config.accel_bias, noise(), faults.accel_bias);
}

Eigen::Vector3d Imu::noise() {
  Eigen::Vector3d n;
  for (int i = 0; i < 3; ++i) n[i] = rng_.gaussian();
  return n;
}

ImuReading Imu::truth(const BodyState& s) const {
  const Eigen::Matrix3d R_world_base = s.T_world_body.linear();
  const Eigen::Vector3d lever = T_base_imu_.translation(), w = s.angular_velocity;
  const Eigen::Vector3d acceleration_base =
      R_world_base.transpose() * (s.acceleration + Eigen::Vector3d(0, 0, kGravity)) +
      s.angular_acceleration.cross(lever) + w.cross(w.cross(lever));
  ImuReading r;
  r.angular_velocity = T_base_imu_.linear().transpose() * w;
  r.specific_force = T_base_imu_.linear().transpose() * acceleration_base;
  return r;
}

ImuReading Imu::measure(const BodyState& s) {
  ImuReading r = truth(s);
  const double root_rate = std::sqrt(config_.rate), root_period = 1 / root_rate;
  const double time = count_++ / config_.rate;
  r.angular_velocity += vibration_.angularVelocity(time);
  r.specific_force += vibration_.acceleration(time);
  r.angular_velocity += gyro_bias_ + config_.gyro_noise * root_rate * noise();
  r.specific_force += accel_bias_ + config_.accel_noise * root_rate * noise();
  gyro_bias_ += config_.gyro_bias_walk * root_period * noise();
  accel_bias_ += config_.accel_bias_walk * root_period * noise();
  return r;
}

Eigen::Vector3d earthMagneticField() { return {1.1e-6, 21.4e-6, -43.2e-6}; }

}  // namespace air_ground_sim
