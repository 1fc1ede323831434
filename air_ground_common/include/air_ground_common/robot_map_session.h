// Which map of a robot its neighbours work on: by its id, its frame, and the time at which it began.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <utility>

#include "air_ground_common/text.h"

namespace air_ground_common {

/// Stamps in seconds. Not thread-safe.
class RobotMapSession {
 public:
  enum class Verdict {
    kCurrent,    ///< use it
    kNewMap,     ///< forget the map so far, then use it
    kStale,      ///< drop it: of a map that has ended
    kOtherFrame  ///< drop it: in no frame of the robot's map
  };

  /// `frame`: of the map; empty: the first that comes. `frame_without_scale`, unless empty: of a map whose unit is its
  /// own. A robot that gets its scale, or loses it, begins another map.
  explicit RobotMapSession(const std::string& frame, const std::string& frame_without_scale = "")
      : expected_(withoutSlash(frame)), without_scale_(withoutSlash(frame_without_scale)) {}

  /// Whether the robot's map may be in this frame.
  bool knows(const std::string& message_frame) const {
    const std::string frame = withoutSlash(message_frame);
    return !frame.empty() && (frame == without_scale_ || frame == expected_ || expected_.empty());
  }

  /// A part of the map.
  Verdict admit(const std::string& message_frame, double stamp) {
    if (!knows(message_frame)) return Verdict::kOtherFrame;
    if (stamp < begin_) return Verdict::kStale;
    const std::string frame = withoutSlash(message_frame);
    if (expected_.empty() && frame != without_scale_) expected_ = frame;
    const bool other = !frame_.empty() && frame != frame_;
    frame_ = frame;
    return other ? Verdict::kNewMap : Verdict::kCurrent;
  }

  /// The robot names its map. True: another than before; what is stamped earlier is of the old one. Once the robot has
  /// said it itself, `second_hand` knowledge does not count.
  bool observe(std::uint32_t id, double stamp, bool second_hand = false) {
    if (second_hand && id_ && !second_hand_) return false;
    second_hand_ = second_hand;
    const bool other = id_ && *id_ != id;
    if (other) {
      begin_ = stamp;
      revision_.reset();
    }
    id_ = id;
    return other;
  }

  /// The robot counts the corrections of its map. True: another count than before in this map; what is stamped earlier
  /// is of the map as it was.
  bool revise(std::uint32_t revision, double stamp) {
    const bool other = revision_ && *revision_ != revision;
    if (other) begin_ = stamp;
    revision_ = revision;
    return other;
  }

  /// Time ran back, or all is to be forgotten: what comes next is of the present map, whatever its id and stamp.
  void restart() {
    begin_ = -std::numeric_limits<double>::infinity();
    id_.reset();
    revision_.reset();
  }

  const std::optional<std::uint32_t>& id() const { return id_; }
  bool isStale(double stamp) const { return stamp < begin_; }
  /// Of what was admitted last; empty before.
  const std::string& frame() const { return frame_; }
  /// What other messages of the robot's map should be in; empty: not known yet.
  const std::string& expectedFrame() const { return ownUnit() ? without_scale_ : expected_; }
  bool ownUnit() const { return !frame_.empty() && frame_ == without_scale_; }

 private:
  std::string expected_, without_scale_, frame_;
  std::optional<std::uint32_t> id_, revision_;
  bool second_hand_ = false;
  double begin_ = -std::numeric_limits<double>::infinity();
};

}  // namespace air_ground_common
