#include "messages.h"

#include <cmath>
#include <stdexcept>

#include "air_ground_common/ros/conversions.h"

namespace view_match {

namespace ros_utils = air_ground_common::ros_utils;
using air_ground::AlignmentEstimate;

constexpr int kDescriptorBytes = 32;

// One order in both.
static_assert(static_cast<int>(MatchStatus::kSearching) == AlignmentEstimate::STATUS_SEARCHING &&
              static_cast<int>(MatchStatus::kAmbiguous) == AlignmentEstimate::STATUS_AMBIGUOUS &&
              static_cast<int>(MatchStatus::kDegenerate) == AlignmentEstimate::STATUS_DEGENERATE &&
              static_cast<int>(MatchStatus::kConverged) == AlignmentEstimate::STATUS_CONVERGED);

std::map<std::uint32_t, Pose> posesOf(const air_ground::MapKeyframes& msg) {
  if (msg.ids.size() != msg.poses.size()) throw std::invalid_argument("there are not as many poses as ids");
  std::map<std::uint32_t, Pose> poses;
  for (std::size_t i = 0; i < msg.ids.size(); ++i) poses[msg.ids[i]] = ros_utils::fromMsg(msg.poses[i]);
  return poses;
}

KeyframeView viewOf(const air_ground::KeyframeFeatures& msg, const Pose& T_ground_camera) {
  if (msg.descriptors.size() != kDescriptorBytes * msg.points.size())
    throw std::invalid_argument("descriptors do not fit the points");
  KeyframeView view;
  view.id = msg.id;
  view.T_ground_camera = T_ground_camera;
  for (const auto& p : msg.points) view.points.emplace_back(p.x, p.y, p.z);
  view.descriptors = cv::Mat(static_cast<int>(msg.points.size()), kDescriptorBytes, CV_8UC1,
                             const_cast<std::uint8_t*>(msg.descriptors.data()))
                         .clone();
  return view;
}

AlignmentEstimate toMsg(const MatchEstimate& e) {
  AlignmentEstimate msg;
  Pose T = Pose::Identity();
  T.linear() = e.T_ground_mav.R;
  T.translation() = e.T_ground_mav.t;
  msg.pose.pose = ros_utils::toMsg(T);
  ros_utils::setCovariance(e.covariance.topLeftCorner<6, 6>(), &msg.pose.covariance);
  msg.scale = e.T_ground_mav.scale;
  msg.scale_stddev = e.status == MatchStatus::kConverged ? msg.scale * std::sqrt(e.covariance(6, 6)) : 0;
  msg.reference_point.x = e.centre.x();
  msg.reference_point.y = e.centre.y();
  msg.reference_point.z = e.centre.z();
  msg.status = static_cast<std::uint8_t>(e.status);
  msg.stage = AlignmentEstimate::STAGE_COARSE;
  msg.reason = e.reason;
  msg.iterations = static_cast<std::uint32_t>(e.images);
  return msg;
}

}  // namespace view_match
