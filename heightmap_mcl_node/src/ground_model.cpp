#include "ground_model.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "heightmap_mcl/agreement.h"

namespace heightmap_mcl {
namespace {

constexpr int kMostCells = 64;  // across the map in the search over all placements and scales

/// Twice the distance at which the heights' correlation has fallen to a half, squared [m^2].
double pieceArea(const HeightMap& map) {
  double sum = 0, squares = 0, count = 0;
  for (const float h : map.heights) {
    if (std::isnan(h)) continue;
    sum += h;
    squares += static_cast<double>(h) * h;
    ++count;
  }
  const double variance = count > 0 ? squares / count - sum / count * (sum / count) : 0;
  const int most = std::max(map.width, map.height) / 2;
  double apart = most, before = 0;  // cells; by linear interpolation, since a whole lag is a step of half an area
  for (int lag = 1; lag < most; ++lag) {
    double difference = 0, pairs = 0;
    const auto add = [&](float a, float b) {
      if (std::isnan(a) || std::isnan(b)) return;
      difference += (static_cast<double>(a) - b) * (static_cast<double>(a) - b);
      ++pairs;
    };
    for (int r = 0; r < map.height; ++r)
      for (int c = 0; c < map.width; ++c) {
        if (c + lag < map.width) add(map.at(r, c), map.at(r, c + lag));
        if (r + lag < map.height) add(map.at(r, c), map.at(r + lag, c));
      }
    if (pairs < 1) continue;
    const double mean = difference / pairs;
    if (mean > variance) {
      apart = std::max(1.0, lag - (mean - variance) / (mean - before));
      break;
    }
    before = mean;
  }
  return std::pow(2 * std::max(1.0, apart) * map.resolution, 2);
}

}  // namespace

GroundModel::Level::Level(HeightMap larger_cells) : map(std::move(larger_cells)), direct(map) {}

const FftCost& GroundModel::Level::fft() {
  if (!fft_) fft_ = std::make_unique<FftCost>(map);
  return *fft_;
}

GroundModel::GroundModel(HeightMap map, const HeightMapLocalizerSettings& settings)
    : map_(std::move(map)),
      direct_(map_),
      coarse_factor_(settings.coarse_factor),
      variance_(std::pow(heightDeviation(map_), 2)),
      raised_(raisedShare(map_, kRaised * settings.cutoff)) {}

const FftCost& GroundModel::fullFft() {
  if (!full_fft_) full_fft_ = std::make_unique<FftCost>(map_);
  return *full_fft_;
}

GroundModel::Level& GroundModel::level(int factor) {
  auto& level = levels_[factor];
  if (!level) level = std::make_unique<Level>(downsample(map_, factor));
  return *level;
}

int GroundModel::factorFor(int edge, int most) const { return std::max(coarse_factor_, (edge + most - 1) / most); }

int GroundModel::largeFactor() const { return factorFor(edge(), kMostCells); }

double GroundModel::piece() {
  if (piece_ <= 0) piece_ = pieceArea(level(largeFactor()).map);
  return piece_;
}

}  // namespace heightmap_mcl
