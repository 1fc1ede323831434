#include "air_ground_common/mesh.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <sstream>
#include <stdexcept>

#include "air_ground_common/atomic_file.h"

namespace air_ground_common {
namespace {

template <typename T>
void put(std::ostream& out, const T& value) {
  out.write(reinterpret_cast<const char*>(&value), sizeof(T));
}

struct PlyProperty {
  std::string name, type, list_count_type;  // list_count_type is empty for a scalar
};

struct PlyElement {
  std::string name;
  std::size_t count = 0;
  std::vector<PlyProperty> properties;
};

// Header and values of a PLY file, read sequentially.
class PlyReader {
 public:
  explicit PlyReader(const std::string& path) : path_(path), file_(path, std::ios::binary) {
    if (!file_) throw std::runtime_error("cannot open " + path);
    std::string line;
    if (!std::getline(file_, line) || line.substr(0, 3) != "ply") fail("is not a PLY file");
    while (std::getline(file_, line)) {
      std::istringstream words(line);
      std::string word;
      words >> word;
      if (word == "format") {
        words >> word;
        if (word != "ascii" && word != "binary_little_endian")
          fail("has the format " + word + ": convert it to binary_little_endian or ascii");
        ascii_ = word == "ascii";
      } else if (word == "element") {
        PlyElement e;
        words >> e.name >> e.count;
        elements.push_back(e);
      } else if (word == "property" && !elements.empty()) {
        PlyProperty p;
        words >> p.type;
        if (p.type == "list") words >> p.list_count_type >> p.type;
        words >> p.name;
        elements.back().properties.push_back(p);
      } else if (word == "end_header") {
        checkCounts();
        return;
      }
    }
    fail("ends inside its header");
  }

  double value(const std::string& type) {
    if (ascii_) {
      double v;
      if (!(file_ >> v)) fail("ends too early");
      return v;
    }
    if (type == "float" || type == "float32") return get<float>();
    if (type == "double" || type == "float64") return get<double>();
    if (type == "uchar" || type == "uint8") return get<std::uint8_t>();
    if (type == "char" || type == "int8") return get<std::int8_t>();
    if (type == "ushort" || type == "uint16") return get<std::uint16_t>();
    if (type == "short" || type == "int16") return get<std::int16_t>();
    if (type == "int" || type == "int32") return get<std::int32_t>();
    if (type == "uint" || type == "uint32") return get<std::uint32_t>();
    fail("has a property of unknown type " + type);
  }

  std::vector<double> list(const PlyProperty& p) {
    const double count = value(p.list_count_type);
    if (count < 0 || count > 1e6) fail("has a list of impossible length");
    std::vector<double> values(static_cast<std::size_t>(count));
    for (double& v : values) v = value(p.type);
    return values;
  }

  void skip(const PlyElement& e) {
    for (std::size_t i = 0; i < e.count; ++i)
      for (const auto& p : e.properties)
        if (p.list_count_type.empty())
          value(p.type);
        else
          list(p);
  }

  [[noreturn]] void fail(const std::string& what) const { throw std::runtime_error(path_ + " " + what); }

  std::vector<PlyElement> elements;

 private:
  static std::size_t bytesOf(const std::string& type) {
    if (type == "double" || type == "float64") return 8;
    if (type == "char" || type == "uchar" || type == "int8" || type == "uint8") return 1;
    if (type == "short" || type == "ushort" || type == "int16" || type == "uint16") return 2;
    return 4;
  }

  // A header promises what it likes: what the rest of the file cannot hold is refused before anything is made of it.
  void checkCounts() {
    const std::streamoff begin = file_.tellg();
    file_.seekg(0, std::ios::end);
    auto left = static_cast<std::size_t>(std::max<std::streamoff>(0, file_.tellg() - begin));
    file_.seekg(begin);
    for (const PlyElement& e : elements) {
      std::size_t bytes = 0;  // the least that one takes
      for (const PlyProperty& p : e.properties) {
        const std::size_t binary = bytesOf(p.list_count_type.empty() ? p.type : p.list_count_type);
        bytes += ascii_ ? 1 : binary;
      }
      if (e.count > 0 && (bytes == 0 || e.count > left / bytes))
        fail("promises " + std::to_string(e.count) + " of its element '" + e.name + "' and has not the bytes for them");
      left -= e.count * bytes;
    }
  }

  template <typename T>
  double get() {
    T v;
    file_.read(reinterpret_cast<char*>(&v), sizeof(T));
    if (!file_) fail("ends too early");
    return static_cast<double>(v);
  }

  std::string path_;
  std::ifstream file_;
  bool ascii_ = false;
};

LabeledPoint readPoint(PlyReader& reader, const PlyElement& e) {
  LabeledPoint point;
  for (const auto& p : e.properties) {
    if (!p.list_count_type.empty()) {
      reader.list(p);
      continue;
    }
    const double v = reader.value(p.type);
    if (p.name == "x") point.position.x() = static_cast<float>(v);
    if (p.name == "y") point.position.y() = static_cast<float>(v);
    if (p.name == "z") point.position.z() = static_cast<float>(v);
    const auto byte = static_cast<std::uint8_t>(std::max(0.0, std::min(255.0, v)));
    if (p.name == "red") point.rgb[0] = byte;
    if (p.name == "green") point.rgb[1] = byte;
    if (p.name == "blue") point.rgb[2] = byte;
    if (p.name == "source") point.source = byte;
  }
  return point;
}

}  // namespace

double TriangleMesh::area() const {
  double area = 0;
  for (const auto& t : triangles) {
    const Eigen::Vector3d a = vertices[t[0]].cast<double>();
    area += 0.5 * (vertices[t[1]].cast<double>() - a).cross(vertices[t[2]].cast<double>() - a).norm();
  }
  return area;
}

void writePly(const std::string& path, const std::vector<LabeledPoint>& points) {
  const auto body = [&](std::ostream& out) {
    out << "ply\nformat binary_little_endian 1.0\ncomment source: 0 ground robot, 1 MAV\nelement vertex "
        << points.size()
        << "\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
           "property uchar blue\nproperty uchar source\nend_header\n";
    for (const auto& p : points) {
      for (int i = 0; i < 3; ++i) put(out, p.position[i]);
      for (int i = 0; i < 3; ++i) put(out, p.rgb[i]);
      put(out, p.source);
    }
  };
  writeAtomically(path, body, "ply");
}

std::vector<LabeledPoint> readPlyPoints(const std::string& path) {
  PlyReader reader(path);
  std::vector<LabeledPoint> points;
  for (const auto& e : reader.elements) {
    if (e.name != "vertex") {
      reader.skip(e);
      continue;
    }
    for (std::size_t i = 0; i < e.count; ++i) points.push_back(readPoint(reader, e));
  }
  return points;
}

void writePly(const std::string& path, const TriangleMesh& mesh) {
  const auto body = [&](std::ostream& out) {
    out << "ply\nformat binary_little_endian 1.0\nelement vertex " << mesh.vertices.size()
        << "\nproperty float x\nproperty float y\nproperty float z\nelement face " << mesh.triangles.size()
        << "\nproperty list uchar int vertex_indices\nend_header\n";
    for (const auto& v : mesh.vertices)
      for (int i = 0; i < 3; ++i) put(out, v[i]);
    for (const auto& t : mesh.triangles) {
      put(out, std::uint8_t{3});
      for (int i = 0; i < 3; ++i) put(out, static_cast<std::int32_t>(t[i]));
    }
  };
  writeAtomically(path, body, "ply");
}

TriangleMesh readPlyMesh(const std::string& path) {
  PlyReader reader(path);
  TriangleMesh mesh;
  const auto index = [&](double corner) {
    if (!(corner >= 0 && corner <= std::numeric_limits<int>::max())) reader.fail("names a vertex that cannot exist");
    return static_cast<int>(corner);
  };
  for (const auto& e : reader.elements) {
    if (e.name == "vertex") {
      for (std::size_t i = 0; i < e.count; ++i) mesh.vertices.push_back(readPoint(reader, e).position);
    } else if (e.name == "face") {
      for (std::size_t i = 0; i < e.count; ++i)
        for (const auto& p : e.properties) {
          if (p.list_count_type.empty()) {
            reader.value(p.type);
            continue;
          }
          const auto corners = reader.list(p);
          if (p.name != "vertex_indices" && p.name != "vertex_index") continue;
          for (std::size_t k = 2; k < corners.size(); ++k)
            mesh.triangles.emplace_back(index(corners[0]), index(corners[k - 1]), index(corners[k]));
        }
    } else {
      reader.skip(e);
    }
  }
  return mesh;
}

struct MeshScene::Impl {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
  std::vector<Eigen::Vector3f> vertices;
  std::vector<Eigen::Vector3i> triangles;

  ~Impl() {
    if (scene) rtcReleaseScene(scene);
    if (device) rtcReleaseDevice(device);
  }
};

MeshScene::MeshScene(const TriangleMesh& mesh) : impl_(std::make_unique<Impl>()) {
  if (mesh.triangles.empty()) throw std::invalid_argument("MeshScene: the mesh has no triangles");
  const int count = static_cast<int>(mesh.vertices.size());
  for (const auto& t : mesh.triangles)
    if (t.minCoeff() < 0 || t.maxCoeff() >= count)
      throw std::invalid_argument("MeshScene: a triangle names a vertex that does not exist");
  impl_->vertices = mesh.vertices;
  impl_->triangles = mesh.triangles;
  impl_->device = rtcNewDevice(nullptr);
  if (!impl_->device) throw std::runtime_error("MeshScene: Embree could not be started");
  impl_->scene = rtcNewScene(impl_->device);
  rtcSetSceneFlags(impl_->scene, RTC_SCENE_FLAG_ROBUST);
  RTCGeometry geometry = rtcNewGeometry(impl_->device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* v = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                        3 * sizeof(float), mesh.vertices.size()));
  for (const auto& p : mesh.vertices) v = std::copy(p.data(), p.data() + 3, v);
  auto* t = static_cast<unsigned*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                           3 * sizeof(unsigned), mesh.triangles.size()));
  for (const auto& i : mesh.triangles)
    for (int k = 0; k < 3; ++k) *t++ = static_cast<unsigned>(i[k]);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(impl_->scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(impl_->scene);
}

MeshScene::~MeshScene() = default;
MeshScene::MeshScene(MeshScene&&) noexcept = default;
MeshScene& MeshScene::operator=(MeshScene&&) noexcept = default;

std::optional<RayHit> MeshScene::cast(const Eigen::Vector3f& o, const Eigen::Vector3f& d, float max_distance) const {
  RTCRayHit r;
  r.ray = {o.x(), o.y(), o.z(), 1e-5f, d.x(), d.y(), d.z(), 0, max_distance, ~0u, 0, 0};
  r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(impl_->scene, &context, &r);
  if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  return RayHit{r.ray.tfar, static_cast<int>(r.hit.primID), Eigen::Vector2f(r.hit.u, r.hit.v),
                Eigen::Vector3f(r.hit.Ng_x, r.hit.Ng_y, r.hit.Ng_z).normalized()};
}

std::vector<RayHit> MeshScene::castMany(const Eigen::Vector3f& o, const std::vector<Eigen::Vector3f>& directions,
                                        float max_distance) const {
  constexpr std::size_t kPacket = 8;
  std::vector<RayHit> hits(directions.size());
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  for (std::size_t first = 0; first < directions.size(); first += kPacket) {
    alignas(32) int valid[kPacket];
    alignas(32) RTCRayHit8 r;
    for (std::size_t i = 0; i < kPacket; ++i) {
      valid[i] = first + i < directions.size() ? -1 : 0;
      const Eigen::Vector3f& d = directions[valid[i] ? first + i : first];
      r.ray.org_x[i] = o.x(), r.ray.org_y[i] = o.y(), r.ray.org_z[i] = o.z();
      r.ray.dir_x[i] = d.x(), r.ray.dir_y[i] = d.y(), r.ray.dir_z[i] = d.z();
      r.ray.tnear[i] = 1e-5f, r.ray.tfar[i] = max_distance, r.ray.time[i] = 0;
      r.ray.mask[i] = ~0u, r.ray.id[i] = 0, r.ray.flags[i] = 0;
      r.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
      r.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
    }
    rtcIntersect8(valid, impl_->scene, &context, &r);
    for (std::size_t i = 0; i < kPacket && first + i < directions.size(); ++i) {
      RayHit& hit = hits[first + i];
      hit.triangle = -1;
      if (r.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) continue;
      hit = {r.ray.tfar[i], static_cast<int>(r.hit.primID[i]), Eigen::Vector2f(r.hit.u[i], r.hit.v[i]),
             Eigen::Vector3f(r.hit.Ng_x[i], r.hit.Ng_y[i], r.hit.Ng_z[i]).normalized()};
    }
  }
  return hits;
}

bool MeshScene::occluded(const Eigen::Vector3f& o, const Eigen::Vector3f& d, float max_distance) const {
  RTCRay r = {o.x(), o.y(), o.z(), 1e-4f, d.x(), d.y(), d.z(), 0, max_distance, ~0u, 0, 0};
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded1(impl_->scene, &context, &r);
  return r.tfar < 0;
}

namespace {

// Nearest point of triangle abc to p (Ericson, Real-Time Collision Detection, 5.1.5: Voronoi regions).
Eigen::Vector3f closestOnTriangle(const Eigen::Vector3f& p, const Eigen::Vector3f& a, const Eigen::Vector3f& b,
                                  const Eigen::Vector3f& c) {
  const Eigen::Vector3f ab = b - a, ac = c - a, ap = p - a;
  const float d1 = ab.dot(ap), d2 = ac.dot(ap);
  if (d1 <= 0 && d2 <= 0) return a;
  const Eigen::Vector3f bp = p - b;
  const float d3 = ab.dot(bp), d4 = ac.dot(bp);
  if (d3 >= 0 && d4 <= d3) return b;
  const float vc = d1 * d4 - d3 * d2;
  // Where a and b are one point, the edges to c tell.
  if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 > d3) return a + d1 / (d1 - d3) * ab;
  const Eigen::Vector3f cp = p - c;
  const float d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d6 >= 0 && d5 <= d6) return c;
  const float vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + d2 / (d2 - d6) * ac;
  const float va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b);
  const float denominator = 1 / (va + vb + vc);
  return a + vb * denominator * ab + vc * denominator * ac;
}

struct DistanceQuery {
  const std::vector<Eigen::Vector3f>* vertices;
  const std::vector<Eigen::Vector3i>* triangles;
  Eigen::Vector3f point;
  float best;
};

bool visitTriangle(RTCPointQueryFunctionArguments* args) {
  auto& query = *static_cast<DistanceQuery*>(args->userPtr);
  const Eigen::Vector3i& t = (*query.triangles)[args->primID];
  const auto& v = *query.vertices;
  const float distance = (closestOnTriangle(query.point, v[t[0]], v[t[1]], v[t[2]]) - query.point).norm();
  if (!(distance < query.best)) return false;
  query.best = distance;
  args->query->radius = distance;
  return true;
}

}  // namespace

float MeshScene::distance(const Eigen::Vector3f& point, float max_distance) const {
  DistanceQuery state{&impl_->vertices, &impl_->triangles, point, max_distance};
  RTCPointQuery query;
  query.x = point.x();
  query.y = point.y();
  query.z = point.z();
  query.radius = max_distance;
  query.time = 0;
  RTCPointQueryContext context;
  rtcInitPointQueryContext(&context);
  rtcPointQuery(impl_->scene, &query, &context, visitTriangle, &state);
  return state.best;
}

}  // namespace air_ground_common
