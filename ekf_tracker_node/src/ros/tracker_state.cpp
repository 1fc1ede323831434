#include "tracker_state.h"

#include "air_ground_common/text.h"

namespace ekf_tracker {
namespace {

constexpr double kSilence = 1.0;    // without odometry that could be used: it is lost [s]
constexpr double kUnlocated = 10;   // odometry without any fix: said on the console [s]
constexpr int kContradictions = 3;  // GPS positions refused in a row: one in 50 million by chance
constexpr char kGpsAdvice[] =
    "where the pose is wrong call ~reset; where GPS is, for longer than street canyons make it, check origin_crs, "
    "origin and geoid_undulation";

// By the clock that the messages follow, so that a paused replay is no silence; else by one that nobody sets [s].
double seconds() { return ros::Time::isSimTime() ? ros::Time::now().toSec() : ros::SteadyTime::now().toSec(); }

}  // namespace

void TrackerState::odometryUsed() {
  used_ = seconds();
  lost_ = false;
}

void TrackerState::odometryAhead(double seconds) {
  health_.count("increments ignored: stamped ahead of the clock");
  if (used_ && !lost_) return;  // one among good ones
  health_.state(health_.kError,
                air_ground_common::formatted(
                    "visual odometry is stamped %.3g s ahead of this machine's clock: no pose is published. Keep the "
                    "clocks of both machines together (chrony), or raise the parameter clock_tolerance",
                    seconds));
}

void TrackerState::unlocated(double stamp, bool metric, const ros::Subscriber& fixes) {
  std::string line = metric ? "waiting for two fixes that agree"
                            : "waiting for fixes that agree, two of them far enough apart to give the odometry's scale";
  line += "; " + std::to_string(fixes_heard_) + " came on " + fixes.getTopic() + ", which has " +
          std::to_string(fixes.getNumPublishers()) + " publishers";
  health_.state(health_.kWarn, line);
  if (fixes_heard_ > 0) return;
  if (!unlocated_since_ || stamp < *unlocated_since_) unlocated_since_ = stamp;
  if (stamp > *unlocated_since_ + kUnlocated) ROS_WARN_STREAM_ONCE("odometry has come for 10 s, but no fix: " << line);
}

void TrackerState::tracking(const PoseEstimate& estimate, double stamp, bool doubtful) {
  const Vector4d stddev = estimate.covariance.diagonal().cwiseSqrt();
  const std::string line = air_ground_common::formatted(
      "tracking: %.1f %.1f %.1f m, %.1f deg (1 sigma); odometry scale %.3f +- %.3f; %d fixes; last fused %.1f s ago",
      stddev[0], stddev[1], stddev[2], stddev[3] * 180 / M_PI, estimate.scale, estimate.scale_stddev, estimate.support,
      stamp - last_fix_);
  std::string doubts;
  if (!estimate.scale_known)
    doubts = "the odometry's scale is not known: position is held by fixes alone; ";
  else if (doubtful)
    doubts = "doubtful, fixes that it does not rest on agree; ";
  if (gps_refused_ >= kContradictions)
    doubts += air_ground_common::formatted("GPS contradicts the pose by %.0f m, %d positions in a row: %s; ", gps_off_,
                                           gps_refused_, kGpsAdvice);
  health_.state(doubts.empty() ? health_.kOk : health_.kWarn, doubts + line);
}

void TrackerState::gpsRefused(double metres) {
  gps_off_ = metres;
  if (++gps_refused_ == kContradictions)
    health_.count(std::string("GPS positions contradict the pose, several in a row: ") + kGpsAdvice);
}

void TrackerState::watch(const std::string& topic) {
  if (!used_ || lost_) return;
  const double silent = seconds() - *used_;
  if (silent < 0) used_ = seconds();  // the clock ran back
  if (silent < kSilence) return;
  lost_ = true;
  health_.count("visual odometry was lost");
  health_.state(health_.kError,
                "no usable visual odometry on " + topic + " for more than a second: no pose is published");
}

void TrackerState::forget() {
  used_.reset();
  lost_ = false;
  last_fix_ = 0;
  gps_refused_ = 0;
  health_.state(health_.kWarn, "forgot the pose; waiting for visual odometry");
}

}  // namespace ekf_tracker
