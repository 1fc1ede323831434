// The street of wall_scene.h as files: what a database is built from.
#pragma once

#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>
#include <string>

#include "air_ground_common/text.h"
#include "streetview_localizer/database_builder.h"
#include "test_files.h"
#include "wall_scene.h"

namespace streetview_localizer {

using air_ground_common::formatted;

inline const Eigen::Vector3d kOrigin(2683500, 1247800, 410);

// The wall as OBJ in Swiss coordinates, panoramas at x = -12, 0, 12 and their geotags.
class Street {
 public:
  Street() {
    writeWall(1);
    settings.model_options.crs = "EPSG:2056";
    std::string lines;
    for (int i = 0; i < 3; ++i) {
      const std::string name = "p" + std::to_string(i) + ".png";
      cv::imwrite(folder / name, wallPanorama(1024, panoramaPose(12.0 * (i - 1)), i == 1));
      lines += lineOf(name, 12.0 * (i - 1));
    }
    settings.geotags = listOf("geotags.csv", lines);
    settings.output = folder / "street.gpkg";
    settings.register_panoramas = false;
    settings.threads = 2;
    settings.views.width = settings.views.height = 256;
  }

  /// The model, and its origin, with heights in units of so many metres.
  void writeWall(double unit) {
    std::string obj = "o wall\n";
    for (const auto& v : wallModel().mesh.vertices) {
      const Eigen::Vector3d p = frame.toCrs(v.cast<double>());
      obj += formatted("v %.6f %.6f %.6f\n", p.x(), p.y(), p.z() / unit);
    }
    settings.model = folder.write("wall.obj", obj + "f 1 2 3 4\n");
    settings.model_options.height_unit = unit;
    settings.model_options.origin = Eigen::Vector3d(kOrigin.x(), kOrigin.y(), kOrigin.z() / unit);
  }
  /// The geotag of an image at (x, 0, 2.5).
  std::string lineOf(const std::string& name, double x) const {
    const auto g = frame.toGeodetic(panoramaPose(x).translation());
    return formatted("%s,%.10f,%.10f,%.4f,%.6f,0,0\n", name.c_str(), g.latitude, g.longitude, g.height,
                     90 - 0.9 * 180 / M_PI);
  }
  std::string listOf(const std::string& name, const std::string& lines) const {
    return folder.write(name, "image,lat,lon,alt,heading_deg,pitch_deg,roll_deg\n" + lines);
  }

  const air_ground_common::LocalFrame frame{"EPSG:2056", kOrigin};
  TemporaryFolder folder;
  BuildSettings settings;
};

inline bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

}  // namespace streetview_localizer
