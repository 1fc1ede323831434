// What is on a facade looks alike from two places; a car or a person in front of it does not.
#pragma once

#include <functional>
#include <memory>
#include <opencv2/core.hpp>
#include <vector>

#include "streetview_localizer/back_projection.h"
#include "streetview_localizer/types.h"

namespace streetview_localizer {

struct ConsistencySettings {
  int neighbours = 2;            ///< images that a feature is looked for in, the nearest that see its place
  double min_distance = 1.0;     ///< of that image: from nearer, a car hides the same piece of wall [m]
  double max_distance = 25.0;    ///< from the feature's image [m]
  double patch = 1.0;            ///< side of the compared square on the facade [m]
  double search = 0.4;           ///< the square is sought so far to each side: errors of pose and model, balconies [m]
  double min_correlation = 0.6;  ///< features below in every comparison are dropped
  int image_width = 2048;        ///< wider images are reduced to this for the comparison [px]
};

/// An image to compare with: a panorama, or a photograph.
struct ConsistencyImage {
  bool usable = true;  ///< false: its pose is not known to decimetres
  bool equirectangular = true;
  air_ground_common::CameraModel camera;  ///< of a photograph
  air_ground_common::Pose T_world_image =
      air_ground_common::Pose::Identity();  ///< panorama: body frame; photograph: optical frame
};

/// Compares squares on the facades between images. Methods are thread-safe.
class FacadeConsistency {
 public:
  /// `load`: grey or colour image by its index; called when needed, an empty one is passed over. Up to 512 MB of them
  /// are kept.
  FacadeConsistency(const BackProjector& model, std::vector<ConsistencyImage> images, std::function<cv::Mat(int)> load,
                    const ConsistencySettings& settings = {});
  ~FacadeConsistency();

  /// The usable images between min_distance and max_distance from image `own`, the nearest first.
  std::vector<int> neighbours(int own) const;

  /// Best correlation, in [-1, 1], of the square around a facade point as image `own` sees it with what its neighbours
  /// see; NaN where no neighbour sees the place, or the square has no texture.
  double correlation(int own, const Eigen::Vector3d& point, const Eigen::Vector3d& normal) const;

  /// Drops features that no neighbour confirms though one sees their place; returns how many.
  int apply(int own, View* view) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace streetview_localizer
