// Where both robots saw the same things from about the same side, their images tell how the maps lie to each other:
// the MAV's image is recognised among the ground robot's keyframes, whose features have depth.
#pragma once

#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>
#include <vector>

#include "air_ground_common/camera_model.h"
#include "air_ground_common/map_correction.h"
#include "view_match/pose_consensus.h"
#include "visual_frontend/place_recognition.h"

namespace air_ground_common {
class ParameterVisitor;
}

namespace view_match {

struct MatcherSettings {
  MatcherSettings();

  visual_frontend::PlaceSettings place;
  double min_lead = 1.4;     ///< features that agree at a place, over those at the best place elsewhere
  double systematic = 0.02;  ///< error that all features of an image share (calibration, depth), over their distance
  double systematic_angle = 0.02;  ///< and of the camera's attitude [rad]
  double systematic_scale = 0.03;  ///< and of the scale that depths tell, relative
  double new_view = 0.05;          ///< an image is another view when the camera moved by this share of the distance ...
  double new_view_angle = 0.08;    ///< ... or turned by this [rad]
  int max_images = 40;             ///< recognised images kept, the newest
  int max_waiting = 100;           ///< images kept for keyframes to come, those of views that differ most
  double scale_stddev = 0.03;      ///< relative, of the scale of a metric map
  double max_elevation = 1.0;      ///< difference of the elevations at which two cameras look in level maps [rad]

  // Acceptance
  int min_images = 4;             ///< that agree
  double min_share = 0.6;         ///< of the recognised images agree
  double min_baseline = 0.15;     ///< greatest distance between their cameras, over the distance of what they see
  double max_sigma = 0.15;        ///< position, any direction [m]
  double max_sigma_angle = 0.05;  ///< any axis [rad]
  double max_sigma_scale = 0.06;  ///< relative

  /// Throws std::invalid_argument, naming the fields.
  void validate() const;
};

/// What a user may set.
void describe(air_ground_common::ParameterVisitor& visitor, MatcherSettings& settings);

/// A keyframe of the ground robot's map.
struct KeyframeView {
  std::uint32_t id = 0;
  Pose T_ground_camera = Pose::Identity();
  std::vector<Eigen::Vector3d> points;  ///< in the camera's frame [m]; z > 0
  cv::Mat descriptors;                  ///< a row of 32 bytes a point, CV_8UC1: ORB
};

enum class MatchStatus { kSearching, kAmbiguous, kDegenerate, kConverged };
const char* toString(MatchStatus status);

struct MatchEstimate {
  MatchStatus status = MatchStatus::kSearching;
  std::string reason;  ///< one line for a person
  Similarity T_ground_mav;
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< in the ground map: covariance is about this point
  Matrix7d covariance =
      1e6 * Matrix7d::Identity();  ///< translation [m], rotation [rad], relative scale; 1e6 I: not known
  int images = 0;                  ///< that agree
  /// Of the newest image that was recognised; where too few were, of the newest one [ns]; 0: none.
  std::int64_t stamp = 0;
};

/// Not thread-safe.
class ViewMatcher {
 public:
  explicit ViewMatcher(const MatcherSettings& settings);

  /// Throws std::invalid_argument when descriptors and points do not fit. A known one is
  /// replaced: its camera may be known better.
  void addKeyframe(const KeyframeView& keyframe);
  /// Looks for the images that were not recognised so far in the keyframes that have come since. True: some were. Those
  /// that were are taken back where such keyframes show another place that looks alike.
  bool matchWaiting();
  /// The map as it stands now: keyframes that it does not name are forgotten; the images recognised there go to another
  /// one of the same view, or wait again. Names without keyframe are ignored.
  void setPoses(const std::map<std::uint32_t, Pose>& T_ground_camera);
  std::size_t keyframes() const { return ids_.size(); }

  /// Looks for the image (CV_8UC1) of time `stamp` [ns] in the keyframes; a view that is known already is left out.
  /// True: it was recognised. `landmarks`: points of the MAV's map, in it: what of them the image shows tells the
  /// scale. Throws std::invalid_argument for another image type.
  bool addImage(std::int64_t stamp, const cv::Mat& image, const air_ground_common::CameraModel& camera,
                const Pose& T_mav_camera, const std::vector<Eigen::Vector3f>& landmarks);
  /// The MAV's map was corrected: where it has its images now.
  void correctAerial(const air_ground_common::PosesByStamp& T_mav_camera);

  /// The MAV's map has no scale: it is to be estimated.
  void setOwnUnit(bool own_unit) { own_unit_ = own_unit; }
  /// The MAV's images wait for another map.
  void forgetGround();
  void forgetAerial();

  MatchEstimate estimate() const;
  /// The recognised images in both maps.
  std::vector<CameraInBoth> cameras() const;

 private:
  struct Image {
    std::int64_t stamp;  // [ns]
    visual_frontend::Keyframe features;
    air_ground_common::CameraModel camera;
    Pose T_mav_camera;
    std::vector<Eigen::Vector3d> seen;          // landmarks before the camera: pixel and depth
    double distance;                            // median of their depths; 0: none
    visual_frontend::KeyframeId next_keyframe;  // the first that it was not looked for in
    bool ambiguous = false;                     // it was found, at two places
  };
  struct RecognisedImage {
    Image image;
    Pose T_keyframe_camera;
    visual_frontend::KeyframeId keyframe;
    Matrix6d covariance;  // of T_keyframe_camera, in the keyframe's camera frame
    int inliers;          // features that agree on it
    double distance = 0;  // of what it sees [m]
    double scale = 1;     // metres per unit of the MAV's map, by depths
    double scale_stddev = std::numeric_limits<double>::infinity();  // relative
  };
  struct Places {
    std::vector<visual_frontend::KeyframeId> known, fresh;  // of the image's elevation; those it was not looked for in
    double least_elevation = std::numeric_limits<double>::infinity();  // between it and those, whatever it is [rad]
  };
  /// Where to look for the image, which then has been looked for in all keyframes.
  Places placesFor(Image& image) const;
  /// In the keyframes from `image.next_keyframe` on.
  bool recognise(Image& image);
  /// Those keyframes show another place where the image may have been taken as well.
  bool isContested(RecognisedImage& seen) const;
  void questionRecognised();
  /// For keyframes to come; where too many wait, one of the two views goes that differ least.
  void wait(Image image);
  /// For all keyframes: it has lost the one where it was recognised.
  void waitAgain(Image image);
  using Poses = std::map<visual_frontend::KeyframeId, Pose>;
  /// To the keyframe `now` which has the same view as the one that goes, if there is one.
  void moveImages(visual_frontend::KeyframeId gone, const Poses& now);
  /// Where a keyframe that goes would stand now: it was corrected as one that stays close by. Empty: none does.
  std::optional<Pose> carriedAlong(const Pose& T_ground_gone, const Poses& now) const;
  /// The keyframes that stay have moved against each other: a place that was mapped twice may be one now.
  bool bends(const Poses& now) const;
  void compareDepths(const Image& image, RecognisedImage& seen) const;
  /// From 1 on they are two views of what lies at that distance; infinity where it is 0 and the camera has moved.
  double difference(const Pose& T_mav_camera, const Pose& T_mav_other, double distance) const;
  CameraInBoth inBoth(const RecognisedImage& seen) const;
  void judge(const std::vector<CameraInBoth>& cameras, const Consensus& consensus, MatchEstimate* out) const;
  std::string notRecognised() const;
  std::int64_t newestStamp() const;

  MatcherSettings settings_;
  visual_frontend::Map map_;
  std::map<std::uint32_t, visual_frontend::KeyframeId> ids_;
  Poses placed_;  // by the last setPoses; those that have come since are as of the map to come
  std::map<visual_frontend::KeyframeId, Eigen::Vector3d> scenes_;  // middle of a keyframe's points, in its camera
  std::vector<RecognisedImage> images_;
  std::deque<Image> waiting_;
  std::string last_reason_;
  bool own_unit_ = false;
  bool contested_ = false;  // images were taken back, and not enough recognised since
  int tried_ = 0;           // images, since a map began
};

}  // namespace view_match
