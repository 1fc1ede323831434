// A small database of known contents for the tests of its storage.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "streetview_localizer/database.h"
#include "wall_scene.h"

namespace streetview_localizer {

inline CityModel swissModel() {
  CityModel m = wallModel();
  m.crs = "EPSG:2056";
  m.origin = {2683500, 1247800, 410};
  m.frame = std::make_shared<air_ground_common::LocalFrame>(m.crs, m.origin);
  // Terrain beside the building.
  for (const Eigen::Vector3f& v :
       {Eigen::Vector3f(-50, -50, 0), Eigen::Vector3f(50, -50, 0), Eigen::Vector3f(0, 50, 0)})
    m.mesh.vertices.push_back(v);
  m.mesh.triangles.emplace_back(4, 5, 6);
  m.surface.push_back(Surface::kGround);
  m.building.push_back(-1);
  return m;
}

inline Panorama panoramaAt(int i) {
  Panorama p;
  p.id = "pano_" + std::to_string(i) + ".jpg";
  p.T_world_panorama = panoramaPose(12.0 * i);
  p.T_world_geotag = panoramaPose(12.0 * i + 3);
  p.registered = i % 2 == 0;
  p.position_stddev = 0.1 + i;
  p.remark = i % 2 ? "it's \"odd\"" : "";
  return p;
}

inline std::vector<View> viewsAt(int i, int count = 2) {
  std::mt19937 rng(static_cast<unsigned>(i));
  std::uniform_real_distribution<float> u(0, 1);
  std::vector<View> views(static_cast<std::size_t>(count));
  for (View& v : views) {
    v.camera.width = 64, v.camera.height = 48;
    v.camera.fx = 50.25, v.camera.fy = 51.5, v.camera.cx = 31.5, v.camera.cy = 23.75, v.camera.k1 = -0.1,
    v.camera.p2 = 0.01;
    v.T_world_camera = panoramaPose(12.0 * i);
    v.image = cv::Mat(48, 64, CV_8UC3, cv::Scalar(10 * (i % 20), 100, 200));
    for (int k = 0; k < 20; ++k) {
      v.features.keypoints.emplace_back(64 * u(rng), 48 * u(rng), 5 * u(rng), 360 * u(rng), u(rng), 0x1ff02);
      cv::Mat row(1, 128, CV_8U);
      for (int c = 0; c < 128; ++c) row.at<uchar>(c) = static_cast<uchar>(255 * u(rng));
      v.features.descriptors.push_back(row);
      v.points.emplace_back(u(rng), u(rng), u(rng));
      v.normals.emplace_back(0.f, -1.f, 0.f);
    }
  }
  return views;
}

inline void writeDatabase(const std::string& path, int count) {
  DatabaseWriter writer(path, swissModel(), "settings");
  for (int i = 0; i < count; ++i) writer.add(panoramaAt(i), viewsAt(i));
  writer.finish();
}

inline void expectPanorama(const StreetviewDatabase& d, int index, int i) {
  const Panorama &p = d.panoramas[index], e = panoramaAt(i);
  EXPECT_EQ(p.id, e.id);
  EXPECT_EQ(p.registered, e.registered);
  EXPECT_EQ(p.remark, e.remark);
  EXPECT_DOUBLE_EQ(p.position_stddev, e.position_stddev);
  EXPECT_TRUE(p.T_world_panorama.isApprox(e.T_world_panorama, 1e-12));
  EXPECT_TRUE(p.T_world_geotag.isApprox(e.T_world_geotag, 1e-12));
  const std::vector<View> expected = viewsAt(i);
  const std::vector<int>& views = d.viewsOf(index);
  ASSERT_EQ(views.size(), expected.size());
  for (std::size_t k = 0; k < views.size(); ++k) {
    const View &v = d.views[views[k]], &w = expected[k];
    EXPECT_EQ(v.id, views[k]);
    EXPECT_EQ(v.panorama, index);
    EXPECT_EQ(v.camera.fy, w.camera.fy);
    EXPECT_EQ(v.camera.cy, w.camera.cy);
    EXPECT_EQ(v.camera.k1, w.camera.k1);
    EXPECT_EQ(v.camera.p2, w.camera.p2);
    EXPECT_TRUE(v.T_world_camera.isApprox(w.T_world_camera, 1e-12));
    ASSERT_EQ(v.features.size(), w.features.size());
    EXPECT_EQ(cv::norm(v.features.descriptors, w.features.descriptors, cv::NORM_L1), 0);
    for (std::size_t f = 0; f < v.features.size(); ++f) {
      EXPECT_EQ(v.features.keypoints[f].pt, w.features.keypoints[f].pt);
      EXPECT_EQ(v.features.keypoints[f].angle, w.features.keypoints[f].angle);
      EXPECT_EQ(v.features.keypoints[f].octave, w.features.keypoints[f].octave);
      EXPECT_EQ(v.points[f], w.points[f]);
      EXPECT_EQ(v.normals[f], w.normals[f]);
    }
    EXPECT_LT(cv::norm(v.image, w.image, cv::NORM_INF), 6);  // JPEG
  }
}

}  // namespace streetview_localizer
