#include "polygons.h"

#include <GL/glu.h>

#include <Eigen/Geometry>
#include <deque>

namespace streetview_localizer {
namespace {

// GLU's sweep-line tessellator: holes, concave rings, crossing edges; it needs no graphics context.
struct Tessellation {
  std::vector<Eigen::Vector3d>* points;
  std::deque<std::array<double, 3>> planar;  // stable addresses: GLU keeps pointers
  std::deque<int> indices;
  std::vector<int> corners;
  bool failed = false;
};

void onVertex(void* vertex, void* user) {
  static_cast<Tessellation*>(user)->corners.push_back(*static_cast<int*>(vertex));
}
void onEdgeFlag(GLboolean, void*) {}  // its presence makes GLU emit plain triangles
void onError(GLenum, void* user) { static_cast<Tessellation*>(user)->failed = true; }
void onCombine(GLdouble[3], void* data[4], GLfloat weight[4], void** out, void* user) {
  auto& t = *static_cast<Tessellation*>(user);
  Eigen::Vector3d p = Eigen::Vector3d::Zero();
  for (int i = 0; i < 4; ++i)
    if (data[i]) p += double(weight[i]) * (*t.points)[*static_cast<int*>(data[i])];
  t.points->push_back(p);
  t.indices.push_back(static_cast<int>(t.points->size()) - 1);
  *out = &t.indices.back();
}

template <typename F>
void setCallback(GLUtesselator* tess, GLenum which, F* function) {
  gluTessCallback(tess, which, reinterpret_cast<_GLUfuncptr>(function));
}

}  // namespace

Eigen::Vector3d areaVector(const Ring& ring) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t i = 1; i + 1 < ring.size(); ++i) sum += (ring[i] - ring[0]).cross(ring[i + 1] - ring[0]);
  return sum;
}

std::vector<std::array<int, 3>> triangulate(const std::vector<Ring>& rings, std::vector<Eigen::Vector3d>* points) {
  points->clear();
  for (const Ring& ring : rings) points->insert(points->end(), ring.begin(), ring.end());
  std::vector<std::array<int, 3>> triangles;
  if (rings.empty() || rings[0].size() < 3) return triangles;
  const Eigen::Vector3d area = areaVector(rings[0]);
  if (area.norm() < 1e-6) return triangles;
  if (rings.size() == 1 && rings[0].size() == 3) return {{0, 1, 2}};
  const Eigen::Vector3d n = area.normalized(), u = n.unitOrthogonal(), v = n.cross(u), origin = rings[0][0];

  Tessellation t;
  t.points = points;
  GLUtesselator* tess = gluNewTess();
  setCallback(tess, GLU_TESS_VERTEX_DATA, onVertex);
  setCallback(tess, GLU_TESS_EDGE_FLAG_DATA, onEdgeFlag);
  setCallback(tess, GLU_TESS_COMBINE_DATA, onCombine);
  setCallback(tess, GLU_TESS_ERROR_DATA, onError);
  gluTessProperty(tess, GLU_TESS_WINDING_RULE, GLU_TESS_WINDING_ODD);  // holes count however they are wound
  gluTessNormal(tess, 0, 0, 1);
  gluTessBeginPolygon(tess, &t);
  int index = 0;
  for (const Ring& ring : rings) {
    gluTessBeginContour(tess);
    for (const Eigen::Vector3d& p : ring) {
      t.planar.push_back({(p - origin).dot(u), (p - origin).dot(v), 0.0});
      t.indices.push_back(index++);
      gluTessVertex(tess, t.planar.back().data(), &t.indices.back());
    }
    gluTessEndContour(tess);
  }
  gluTessEndPolygon(tess);
  gluDeleteTess(tess);
  if (t.failed) return triangles;
  for (std::size_t i = 0; i + 2 < t.corners.size(); i += 3) {
    const std::array<int, 3> c = {t.corners[i], t.corners[i + 1], t.corners[i + 2]};
    const Eigen::Vector3d cross = ((*points)[c[1]] - (*points)[c[0]]).cross((*points)[c[2]] - (*points)[c[0]]);
    if (cross.norm() > 1e-9) triangles.push_back(c);
  }
  return triangles;
}

int chooseLod(const std::array<double, 4>& area, int wanted) {
  if (wanted >= 1 && wanted <= 3 && area[wanted] > 0) return wanted;
  const double fullest = std::max({area[1], area[2], area[3]});
  if (fullest <= 0) return -1;
  for (int lod = 3; lod >= 1; --lod)
    if (area[lod] >= 0.5 * fullest) return lod;
  return -1;
}

}  // namespace streetview_localizer
