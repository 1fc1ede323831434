// The city model with the facades' pictures on it, as in figure 5 (c) of Majdik 2014.
#pragma once

#include <array>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "streetview_localizer/database.h"

namespace streetview_localizer {

struct TextureSettings {
  double resolution = 0.05;     ///< size of a texel on the facade [m]
  double block = 0.5;           ///< side of the squares that take their colour from one view [m]
  double max_distance = 50.0;   ///< of a view from what it colours [m]
  double max_incidence = 1.31;  ///< between ray and normal [rad]
  int page = 4096;              ///< largest side of a texture image [px]
};

struct TexturedModel {
  air_ground_common::TriangleMesh mesh;            ///< in world [m]
  std::vector<std::array<Eigen::Vector2f, 3>> uv;  ///< of each triangle's corners, in pixels of its page
  std::vector<int> page;                           ///< of each triangle; -1: no view saw it
  std::vector<cv::Mat> pages;                      ///< CV_8UC3, BGR
};

/// Colours the buildings from the database's views: each square of a facade from the view that sees it best (pixels a
/// metre, not occluded by the model). Squares that none sees stay grey. Needs a database loaded with images.
TexturedModel makeTexturedModel(const StreetviewDatabase& database, const TextureSettings& settings = {});

/// Throws std::runtime_error where writeObj would overwrite what is no textured model: at `path`, or of the files
/// beside it with so many pages. A model of ours may be overwritten.
void refuseOtherFiles(const std::string& path, std::size_t pages = 1);

/// Wavefront OBJ with its MTL and one JPEG a page beside it, in world. Throws std::runtime_error, and for what
/// refuseOtherFiles does before anything is written.
void writeObj(const TexturedModel& model, const std::string& path);

}  // namespace streetview_localizer
