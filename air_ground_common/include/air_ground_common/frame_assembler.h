// Puts together what an estimator of a robot's motion works on: images, each with the IMU samples up to its stamp.
#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>
#include <utility>

#include "air_ground_common/bounded_queue.h"

namespace air_ground_common {

struct FrameAssemblerSettings {
  bool use_imu = true;
  double imu_wait = 0.5;   ///< an image waits for the IMU until images this much newer ... [s of data]
  double settle = 0.3;     ///< ... have been here for so long [s]
  QueueLimits images;      ///< that wait
  double max_latency = 0;  ///< images so far behind the newest are given up; 0 = none: a replay [s of data]
};

/// Image: anything movable, e.g. a message pointer or a pair of them; Imu: with a `stamp` [s]. Stamps in order of time.
/// `now`: time of a clock that runs on while the stamps may not [s]. Not thread-safe.
template <typename Image, typename Imu>
class FrameAssembler {
 public:
  explicit FrameAssembler(const FrameAssemblerSettings& settings)
      : settings_(settings), images_(settings.images), allowed_lag_(settings.max_latency) {}

  struct Frame {
    double stamp = 0, arrival = 0;  ///< by the data's clock and by that of `now` [s]
    Image image;
    std::deque<Imu> imu;  ///< since the last frame; one sample beyond the lead, to interpolate the motion up to it
  };

  /// `bytes`: that the image takes.
  void addImage(double stamp, Image image, double now, std::size_t bytes = 0) {
    images_.push({stamp, now, std::move(image)}, bytes);
    newest_image_ = std::max(newest_image_, stamp);
  }

  void addImu(const Imu& sample) {
    waited_in_vain_ = 0;
    constexpr std::size_t kMost = 40000;
    if (imu_.size() >= kMost) imu_.pop_front();
    imu_.push_back(sample);
    newest_imu_ = std::max(newest_imu_, sample.stamp);
  }

  /// An image needs the IMU up to its stamp plus this [s]: the IMU's clock may run ahead of the images'.
  void setImuLead(double lead) { imu_lead_ = lead; }

  /// Gives up the images that are too far behind, oldest first, and then some with each that is taken until the lag is
  /// half: what is slower than the images would lag by all that is allowed for ever. Returns how many.
  std::size_t dropLate() {
    std::size_t dropped = 0;
    for (; tooLate(); ++dropped) take();
    if (dropped > 0 && allowed_lag_ == settings_.max_latency) catching_up_ = true;
    return dropped;
  }

  /// The oldest image has its IMU samples, or has waited long enough for them.
  bool ready(double now) const {
    if (waiting() == 0) return false;
    const double stamp = oldest().stamp;
    if (!awaitsImu(stamp)) return true;
    for (const Waiting& image : images_.entries())
      if (image.stamp - stamp > settings_.imu_wait) return now - image.arrival >= settings_.settle;
    return false;
  }

  /// The oldest image; call when there is one.
  Frame pop() {
    constexpr double kStep = 0.05;  // of max_latency, an image: in a hole of half of it features would be lost
    allowed_lag_ = catching_up_ ? allowed_lag_ - kStep * settings_.max_latency : settings_.max_latency;
    catching_up_ = catching_up_ && allowed_lag_ > 0.5 * settings_.max_latency;
    Waiting oldest = take();
    Frame frame{oldest.stamp, oldest.arrival, std::move(oldest.image), {}};
    while (!imu_.empty() && (frame.imu.empty() || frame.imu.back().stamp < frame.stamp + imu_lead_)) {
      frame.imu.push_back(imu_.front());
      imu_.pop_front();
    }
    return frame;
  }

  void clear() {
    images_.clear();
    imu_.clear();
    newest_image_ = newest_imu_ = 0;
    waited_in_vain_ = 0;
    allowed_lag_ = settings_.max_latency;
    catching_up_ = false;
  }

  bool hasImu() const { return newest_imu_ > 0; }  ///< images wait for their samples, not for the first ever
  std::size_t waiting() const { return images_.entries().size(); }
  std::size_t waitingBytes() const { return images_.bytes(); }
  /// How far the oldest image is behind the newest [s of data].
  double lag() const { return waiting() == 0 ? 0 : newest_image_ - oldest().stamp; }
  /// Images given up because too many waited, or too large ones.
  const QueueOverflow& overflow() const { return images_.overflow(); }

 private:
  struct Waiting {
    double stamp, arrival;
    Image image;
  };

  const Waiting& oldest() const { return images_.entries().front(); }

  /// False once some in a row have waited in vain: later ones would be late for as long as the IMU is silent. In a
  /// replay, where nothing need be in time, all wait: topics out of step are no silence.
  bool awaitsImu(double stamp) const {
    constexpr int kInVain = 5;
    const bool silent = settings_.max_latency > 0 && waited_in_vain_ >= kInVain;
    return settings_.use_imu && !silent && newest_imu_ < stamp + imu_lead_;
  }
  /// One that waits for the IMU is not late because somebody is slow.
  bool tooLate() const {
    return settings_.max_latency > 0 && waiting() > 1 &&
           lag() > (awaitsImu(oldest().stamp) ? settings_.max_latency : allowed_lag_);
  }
  Waiting take() {
    if (awaitsImu(oldest().stamp)) ++waited_in_vain_;
    return images_.pop();
  }

  FrameAssemblerSettings settings_;
  BoundedQueue<Waiting> images_;
  std::deque<Imu> imu_;
  double newest_image_ = 0, newest_imu_ = 0, imu_lead_ = 0;
  int waited_in_vain_ = 0;  ///< images, since the last IMU sample
  double allowed_lag_;      ///< falls while catching up [s of data]
  bool catching_up_ = false;
};

}  // namespace air_ground_common
