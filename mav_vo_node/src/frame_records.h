// The images that were localised: each by a keyframe, so that it moves with the map when that is adjusted, and how the
// vehicle moved since the one before.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "air_ground_common/trajectory.h"
#include "mav_vo/imu_preintegration.h"
#include "visual_frontend/map.h"

namespace mav_vo {

struct FrameRecord {
  double stamp = 0;  ///< [s]
  visual_frontend::KeyframeId reference = visual_frontend::kNoKeyframe;
  air_ground_common::Pose T_reference_camera = air_ground_common::Pose::Identity();
  double scene_distance = 1;
  Eigen::Matrix3d position_covariance = Eigen::Matrix3d::Zero();  ///< of the image noise
  std::unique_ptr<const Preintegration> motion;                   ///< since the record before; kept for the recent ones
};

class FrameRecords {
 public:
  /// Of a long flight half of the older records go.
  void add(FrameRecord record);
  void clear() { records_.clear(); }

  bool empty() const { return records_.empty(); }
  std::size_t size() const { return records_.size(); }
  const FrameRecord& operator[](std::size_t i) const { return records_[i]; }
  const FrameRecord& back() const { return records_.back(); }

  air_ground_common::Pose pose(std::size_t i, const visual_frontend::Map& map) const;  ///< T_map_camera
  air_ground_common::Pose lastPose(const visual_frontend::Map& map) const { return pose(records_.size() - 1, map); }
  air_ground_common::Trajectory poses(const visual_frontend::Map& map) const;

  /// The last image became a keyframe.
  void lastIsKeyframe(visual_frontend::KeyframeId id);
  /// Before keyframe `from` leaves the map: its records go by `to`.
  void rebase(visual_frontend::KeyframeId from, visual_frontend::KeyframeId to,
              const air_ground_common::Pose& T_to_from);
  void transform(const air_ground_common::Similarity& S_new_old);
  /// Inertial motion integrated anew by `between` (two stamps, and the motion's bias), where it gives one.
  template <class Between>
  void integrateAnew(const Between& between) {
    for (std::size_t i = 1; i < records_.size(); ++i) {
      if (!records_[i].motion) continue;
      if (const auto motion = between(records_[i - 1].stamp, records_[i].stamp, records_[i].motion->bias()))
        records_[i].motion = std::make_unique<const Preintegration>(*motion);
    }
  }

 private:
  std::vector<FrameRecord> records_;
};

}  // namespace mav_vo
