#include "heightmap_mcl/earlier_clouds.h"

#include <algorithm>
#include <utility>

#include "air_ground_common/followed_clouds.h"

namespace heightmap_mcl {
namespace {

constexpr double kGrowth = 1.1;

}  // namespace

EarlierClouds::EarlierClouds(const HeightMapLocalizerSettings& settings)
    : settings_(settings), in_group_(static_cast<std::size_t>(settings.verify)) {}
EarlierClouds::~EarlierClouds() = default;

void EarlierClouds::add(AerialCloud cloud, bool searched) {
  const std::int64_t stamp = cloud.stamp;
  if (const auto it = corrections_.find(stamp); it != corrections_.end()) {
    if (!it->second) return;
    moveBy(*it->second, &cloud);
  }
  clouds_.emplace_back(stamp, Kept{std::move(cloud), searched ? ground_cells_ : 0, !searched});
  if (clouds_.size() > air_ground_common::kFollowedClouds) clouds_.pop_front();
}

void EarlierClouds::correct(const air_ground_common::CloudCorrections& corrections) {
  const auto since = air_ground_common::correctionsSince(std::exchange(corrections_, corrections), corrections);
  air_ground_common::correctClouds(since, &clouds_,
                                   [](const air_ground_common::Similarity& S, Kept* kept) { moveBy(S, &kept->cloud); });
}

void EarlierClouds::setGround(std::vector<Eigen::Vector3f> points, std::size_t defined_cells, bool corrected) {
  ground_ = std::move(points);
  ground_cells_ = defined_cells;
  ground_is_new_ = true;
  if (corrected) searchAgain();
  // The newest ones are HeightMapLocalizer's, which searches them now.
  for (std::size_t i = clouds_.size() - std::min(in_group_, clouds_.size()); i < clouds_.size(); ++i)
    if (!clouds_[i].second.passed_by) clouds_[i].second.searched = ground_cells_;
}

void EarlierClouds::forgetAerial() {
  clouds_.clear();
  corrections_.clear();
  group_.clear();
}

void EarlierClouds::forgetGround() {
  ground_.clear();
  ground_cells_ = 0;
  searchAgain();
}

void EarlierClouds::setPrior(const Prior& prior) {
  prior_ = prior;
  searchAgain();
}

void EarlierClouds::setOwnUnit(bool own_unit) {
  if (own_unit == own_unit_) return;
  own_unit_ = own_unit;
  in_group_ = static_cast<std::size_t>(settings_.verifyFor(own_unit));
  forgetAerial();
}

void EarlierClouds::searchAgain() {
  group_.clear();
  for (auto& [stamp, kept] : clouds_) kept.searched = 0;
}

bool EarlierClouds::pending() const { return !group_.empty() || nextGroup() > 0; }

std::size_t EarlierClouds::nextGroup() const {
  if (ground_cells_ == 0 || settings_.mode == Mode::kPaper || clouds_.size() <= in_group_) return 0;
  const auto now = static_cast<double>(ground_cells_);
  for (std::size_t end = clouds_.size() - in_group_; end > 0; --end) {
    const auto then = static_cast<double>(clouds_[end - 1].second.searched);
    if (now > kGrowth * then || then > kGrowth * now) return end;
  }
  return 0;
}

void EarlierClouds::begin(std::size_t end) {
  const std::size_t first = end - std::min(in_group_, end);
  for (std::size_t i = end; i > first; --i) group_.push_back(clouds_[i - 1].first);
  // Half of a group is in the next one, too, if there is one.
  for (std::size_t i = first == 0 ? 0 : first + (end - first) / 2; i < end; ++i)
    clouds_[i].second.searched = ground_cells_;
  if (!localizer_) {
    localizer_ = std::make_unique<HeightMapLocalizer>(settings_);
    ground_is_new_ = true;
  }
  localizer_->setOwnUnit(own_unit_);
  localizer_->setPrior(prior_);
  localizer_->restart(true);
  localizer_->setVertical(vertical_);
  if (std::exchange(ground_is_new_, false)) localizer_->setGround(ground_);
}

std::optional<EarlierClouds::Found> EarlierClouds::step() {
  if (group_.empty()) {
    const std::size_t end = nextGroup();
    if (end == 0) return std::nullopt;
    begin(end);
  }
  const std::int64_t stamp = group_.back();
  group_.pop_back();
  const auto cloud =
      std::find_if(clouds_.begin(), clouds_.end(), [stamp](const auto& kept) { return kept.first == stamp; });
  if (cloud == clouds_.end() || !localizer_->addAerial(cloud->second.cloud)) return std::nullopt;
  if (localizer_->estimate().status != Status::kConverged) return std::nullopt;
  group_.clear();
  for (auto& [other, kept] : clouds_) kept.searched = ground_cells_;
  return Found{stamp, localizer_->estimate(), cloud->second.cloud.reference};
}

}  // namespace heightmap_mcl
