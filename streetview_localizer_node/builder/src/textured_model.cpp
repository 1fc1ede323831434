#include "streetview_localizer/textured_model.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <numeric>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>
#include <system_error>

#include "air_ground_common/atomic_file.h"

namespace streetview_localizer {
namespace {

using air_ground_common::MeshScene;
using air_ground_common::writeAtomically;

constexpr int kPad = 2;  // texels beside a facet, so that filtering does not pull in its neighbour in the atlas
const cv::Vec3b kUnseen(170, 170, 170);
// How our files begin.
constexpr char kObjBegin[] = "# city model with facade textures, local east-north-up frame [m]\n";
constexpr char kMtlBegin[] = "newmtl plain\nKd 0.67 0.67 0.67\n";

// Triangles of a building in one plane, and their rectangle in it.
struct Facet {
  Eigen::Vector3d normal, right, up;
  double offset = 0;
  std::vector<int> triangles;
  Eigen::Vector2d low = Eigen::Vector2d::Constant(1e30), high = Eigen::Vector2d::Constant(-1e30);
  double texel = 0;           // [m]
  int width = 0, height = 0;  // [px]
  int page = -1, x = 0, y = 0;

  Eigen::Vector3d at(double u, double v) const {  // pixel of the facet's own image to world
    return normal * offset + right * (low.x() + (u - kPad) * texel) + up * (high.y() - (v - kPad) * texel);
  }
};

std::vector<Facet> findFacets(const CityModel& m, double resolution, int page_size) {
  std::map<int, std::vector<int>> of_building;
  for (std::size_t i = 0; i < m.mesh.triangles.size(); ++i)
    if (m.isBuilding(static_cast<int>(i))) of_building[m.building[i]].push_back(static_cast<int>(i));
  std::vector<Facet> facets;
  for (const auto& [building, triangles] : of_building) {
    const std::size_t first = facets.size();
    for (const int t : triangles) {
      const auto corner = [&](int k) {
        return Eigen::Vector3d(m.mesh.vertices[m.mesh.triangles[t][k]].cast<double>());
      };
      const Eigen::Vector3d cross = (corner(1) - corner(0)).cross(corner(2) - corner(0));
      if (cross.norm() < 1e-4) continue;
      const Eigen::Vector3d n = cross.normalized(), centre = (corner(0) + corner(1) + corner(2)) / 3;
      std::size_t f = first;
      while (f < facets.size() &&
             !(facets[f].normal.dot(n) > 0.9994 && std::abs(facets[f].normal.dot(centre) - facets[f].offset) < 0.05))
        ++f;
      if (f == facets.size()) {
        Facet facet;
        facet.normal = n;
        facet.offset = n.dot(centre);
        facet.right =
            std::abs(n.z()) < 0.99 ? Eigen::Vector3d::UnitZ().cross(n).normalized() : Eigen::Vector3d::UnitX();
        facet.right = (facet.right - facet.right.dot(n) * n).normalized();
        facet.up = n.cross(facet.right);
        facets.push_back(facet);
      }
      facets[f].triangles.push_back(t);
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector2d p(facets[f].right.dot(corner(k)), facets[f].up.dot(corner(k)));
        facets[f].low = facets[f].low.cwiseMin(p);
        facets[f].high = facets[f].high.cwiseMax(p);
      }
    }
  }
  for (Facet& f : facets) {
    const Eigen::Vector2d size = f.high - f.low;
    f.texel = std::max(resolution, size.maxCoeff() / (page_size - 2 * kPad - 2));
    f.width = static_cast<int>(std::ceil(size.x() / f.texel)) + 2 * kPad + 1;
    f.height = static_cast<int>(std::ceil(size.y() / f.texel)) + 2 * kPad + 1;
  }
  return facets;
}

// How many pixels of a view fall on a metre of the facade; 0 where it does not see the point.
double pixelsPerMetre(const View& view, const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
                      const MeshScene& scene, const TextureSettings& s) {
  const Eigen::Vector3d ray = view.T_world_camera.translation() - point;
  const double distance = ray.norm(), cosine = normal.dot(ray) / distance;
  if (distance > s.max_distance || distance < 0.5 || cosine < std::cos(s.max_incidence)) return 0;
  const auto pixel = view.camera.project(view.T_world_camera.inverse() * point);
  if (!pixel || !view.camera.contains(*pixel, 2)) return 0;
  const Eigen::Vector3d start = point + 0.05 * normal;
  if (scene.occluded(start.cast<float>(), (ray / distance).cast<float>(), static_cast<float>(distance))) return 0;
  return view.camera.fx * cosine / distance;
}

cv::Vec3b colourOf(const View& view, const Eigen::Vector3d& point) {
  const auto p = view.camera.project(view.T_world_camera.inverse() * point);
  if (!p) return kUnseen;
  const double x = std::clamp(p->x(), 0.0, view.image.cols - 1.001),
               y = std::clamp(p->y(), 0.0, view.image.rows - 1.001);
  const int u = static_cast<int>(x), v = static_cast<int>(y);
  const double a = x - u, b = y - v;
  const auto at = [&](int row, int column) {
    if (view.image.channels() == 3) return cv::Vec3d(view.image.at<cv::Vec3b>(row, column));
    return cv::Vec3d::all(view.image.at<uchar>(row, column));
  };
  return cv::Vec3b((1 - b) * ((1 - a) * at(v, u) + a * at(v, u + 1)) +
                   b * ((1 - a) * at(v + 1, u) + a * at(v + 1, u + 1)));
}

// Empty if no view sees the facet.
cv::Mat paint(const Facet& f, const StreetviewDatabase& d, const MeshScene& scene, const TextureSettings& s) {
  const Eigen::Vector3d centre = f.at(0.5 * f.width, 0.5 * f.height);
  const double radius = 0.5 * std::hypot(f.width, f.height) * f.texel;
  std::vector<const View*> views;
  for (const View& view : d.views) {
    const Eigen::Vector3d to = view.T_world_camera.translation();
    if (!view.image.empty() && (to - centre).norm() < s.max_distance + radius && f.normal.dot(to) > f.offset)
      views.push_back(&view);
  }
  if (views.empty()) return {};
  cv::Mat image(f.height, f.width, CV_8UC3, kUnseen);
  bool seen = false;
  const int block = std::max(1, static_cast<int>(std::lround(s.block / f.texel)));
  for (int y = 0; y < f.height; y += block)
    for (int x = 0; x < f.width; x += block) {
      const int w = std::min(block, f.width - x), h = std::min(block, f.height - y);
      const Eigen::Vector3d middle = f.at(x + 0.5 * (w - 1), y + 0.5 * (h - 1));
      const View* best = nullptr;
      double most = 0;
      for (const View* view : views) {
        const double pixels = pixelsPerMetre(*view, middle, f.normal, scene, s);
        if (pixels > most) most = pixels, best = view;
      }
      if (!best) continue;
      seen = true;
      for (int v = y; v < y + h; ++v)
        for (int u = x; u < x + w; ++u) image.at<cv::Vec3b>(v, u) = colourOf(*best, f.at(u, v));
    }
  return seen ? image : cv::Mat();
}

// Shelf packing: facets by falling height, in rows.
void pack(std::vector<std::pair<Facet*, cv::Mat>>* painted, int size, std::vector<cv::Mat>* pages) {
  std::sort(painted->begin(), painted->end(),
            [](const auto& a, const auto& b) { return a.first->height > b.first->height; });
  int x = 0, y = 0, shelf = 0;
  std::vector<int> used;
  for (auto& [facet, image] : *painted) {
    if (x + facet->width > size) x = 0, y += shelf, shelf = 0;
    if (used.empty() || y + facet->height > size) x = y = shelf = 0, used.push_back(0);
    facet->page = static_cast<int>(used.size()) - 1;
    facet->x = x, facet->y = y;
    x += facet->width;
    shelf = std::max(shelf, facet->height);
    used.back() = std::max(used.back(), y + shelf);
  }
  for (const int height : used) pages->emplace_back(height, size, CV_8UC3, kUnseen);
  for (auto& [facet, image] : *painted)
    image.copyTo((*pages)[facet->page](cv::Rect(facet->x, facet->y, facet->width, facet->height)));
}

// The names that a textured model's files have.
struct ObjFiles {
  explicit ObjFiles(const std::string& path) : obj(path), stem(obj.stem().string()) {}
  std::string mtl() const { return (obj.parent_path() / (stem + ".mtl")).string(); }
  std::string pageName(std::size_t i) const { return stem + "_" + std::to_string(i) + ".jpg"; }
  std::string page(std::size_t i) const { return (obj.parent_path() / pageName(i)).string(); }

  std::filesystem::path obj;
  std::string stem;
};

bool holdsSomething(const std::string& path) {
  std::error_code error;
  const auto size = std::filesystem::file_size(path, error);
  return !error && size > 0;
}

}  // namespace

TexturedModel makeTexturedModel(const StreetviewDatabase& database, const TextureSettings& settings) {
  if (!(settings.resolution > 0) || !(settings.block > 0) || settings.page < 256)
    throw std::invalid_argument("makeTexturedModel: resolution, block and page must be positive");
  TexturedModel out;
  out.mesh = database.model.mesh;
  out.uv.resize(out.mesh.triangles.size());
  out.page.assign(out.mesh.triangles.size(), -1);
  if (out.mesh.triangles.empty()) return out;
  const MeshScene scene(out.mesh);
  std::vector<Facet> facets = findFacets(database.model, settings.resolution, settings.page);
  std::vector<cv::Mat> images(facets.size());
#pragma omp parallel for schedule(dynamic)
  for (std::size_t i = 0; i < facets.size(); ++i) images[i] = paint(facets[i], database, scene, settings);
  std::vector<std::pair<Facet*, cv::Mat>> painted;
  for (std::size_t i = 0; i < facets.size(); ++i)
    if (!images[i].empty()) painted.emplace_back(&facets[i], images[i]);
  pack(&painted, settings.page, &out.pages);
  for (const auto& entry : painted) {
    const Facet& f = *entry.first;
    for (const int t : f.triangles) {
      out.page[t] = f.page;
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector3d p = out.mesh.vertices[out.mesh.triangles[t][k]].cast<double>();
        out.uv[t][k] = Eigen::Vector2d(f.x + kPad + (f.right.dot(p) - f.low.x()) / f.texel,
                                       f.y + kPad + (f.high.y() - f.up.dot(p)) / f.texel)
                           .cast<float>();
      }
    }
  }
  return out;
}

void refuseOtherFiles(const std::string& path, std::size_t pages) {
  const ObjFiles files(path);
  air_ground_common::refuseOtherKind(path, kObjBegin);
  air_ground_common::refuseOtherKind(files.mtl(), kMtlBegin);
  if (holdsSomething(path) || holdsSomething(files.mtl())) return;  // ours, and the pages with them
  for (std::size_t i = 0; i < pages; ++i)
    if (std::filesystem::exists(files.page(i)))
      throw std::runtime_error(files.page(i) + " is there already, and of no textured model: give another path than " +
                               path + ", or delete it");
}

void writeObj(const TexturedModel& model, const std::string& path) {
  const ObjFiles files(path);
  refuseOtherFiles(path, model.pages.size());
  // First, so that the pages of a run that is interrupted are known for ours.
  const auto materials = [&](std::ostream& mtl) {
    mtl << kMtlBegin;
    for (std::size_t i = 0; i < model.pages.size(); ++i)
      mtl << "newmtl page" << i << "\nKa 1 1 1\nKd 1 1 1\nmap_Kd " << files.pageName(i) << "\n";
  };
  writeAtomically(files.mtl(), materials, kMtlBegin);
  for (std::size_t i = 0; i < model.pages.size(); ++i) {
    const std::string page = files.page(i), partial_page = page + ".partial.jpg";
    bool written = false;
    try {
      written = cv::imwrite(partial_page, model.pages[i], {cv::IMWRITE_JPEG_QUALITY, 92});
    } catch (const cv::Exception&) {
    }
    if (!written || std::rename(partial_page.c_str(), page.c_str()) != 0)
      throw std::runtime_error("cannot write " + page);
  }
  const auto faces = [&](std::ostream& obj) {
    obj.precision(9);
    obj << kObjBegin << "mtllib " << files.stem << ".mtl\n";
    for (const auto& v : model.mesh.vertices) obj << "v " << v.x() << " " << v.y() << " " << v.z() << "\n";
    std::vector<int> order(model.mesh.triangles.size());
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return model.page[a] < model.page[b]; });
    int page = -2, texture = 0;
    for (const int t : order) {
      if (model.page[t] != page) {
        page = model.page[t];
        obj << "usemtl " << (page < 0 ? "plain" : "page" + std::to_string(page)) << "\n";
      }
      const Eigen::Vector3i c = model.mesh.triangles[t] + Eigen::Vector3i::Ones();
      if (page < 0) {
        obj << "f " << c[0] << " " << c[1] << " " << c[2] << "\n";
        continue;
      }
      // OBJ counts from the lower left corner of the image, in units of its size; our pixel (0, 0) is a pixel's centre.
      const cv::Mat& image = model.pages[page];
      for (const auto& uv : model.uv[t])
        obj << "vt " << (uv.x() + 0.5) / image.cols << " " << 1 - (uv.y() + 0.5) / image.rows << "\n";
      obj << "f";
      for (int k = 0; k < 3; ++k) obj << " " << c[k] << "/" << ++texture;
      obj << "\n";
    }
  };
  writeAtomically(path, faces, kObjBegin);
}

}  // namespace streetview_localizer
