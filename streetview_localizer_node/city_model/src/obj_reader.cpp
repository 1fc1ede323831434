#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>

#include "polygons.h"

namespace streetview_localizer {
namespace {

struct Meaning {
  std::optional<Surface> surface;
  bool of_houses_too = false;  ///< some houses are called so: by the road they stand at, or for their ground floor
};

// Whole words alone: "academy_wall" is no digital elevation model ("dem").
Meaning meaningOf(const std::string& name) {
  Meaning meaning;
  std::string word;
  const auto isOneOf = [&](std::initializer_list<const char*> words) {
    return std::find(words.begin(), words.end(), word) != words.end();
  };
  for (const char c : name + " ") {
    if (std::isalpha(static_cast<unsigned char>(c))) {
      word += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
      continue;
    }
    if (isOneOf({"groundsurface", "terrain", "dtm", "dem"})) return {Surface::kGround, false};
    if (isOneOf({"ground", "road", "pavement", "sidewalk"})) return {Surface::kGround, true};
    if (isOneOf({"roof", "roofs", "roofsurface"})) meaning.surface = Surface::kRoof;
    if (isOneOf({"wall", "wallsurface", "walls", "facade", "facades"})) meaning.surface = Surface::kWall;
    word.clear();
  }
  return meaning;
}

/// How much of the faces under a name stands upright.
class Shape {
 public:
  void add(const Ring& ring) {
    constexpr double kUpright = 0.1, kStorey = 2;  // cosine; in the file's unit, which is hardly less than a foot
    constexpr double kNarrow = 0.05;               // in plan; what is in degrees is all narrower
    const Eigen::Vector3d area = areaVector(ring);
    Eigen::Vector3d low = ring[0], high = low;
    for (const Eigen::Vector3d& p : ring) low = low.cwiseMin(p), high = high.cwiseMax(p);
    const Eigen::Vector3d size = high - low;
    all_ += area.norm();
    if (std::abs(area.z()) < kUpright * area.norm() && size.z() >= kStorey && size.head<2>().norm() >= kNarrow)
      walls_ += area.norm();
  }
  /// Kerbs are low, and what ground needs of retaining walls is little beside the ground itself.
  bool isHouse() const { return walls_ > 0.2 * all_; }

 private:
  double walls_ = 0, all_ = 0;
};

/// Object, group, material that a face stands under.
using Names = std::array<std::string, 3>;

class Reader {
 public:
  Reader(const std::string& path, bool y_up) : path_(path), y_up_(y_up) {}

  PolygonModel read() {
    std::ifstream file(path_);
    if (!file) throw std::runtime_error("cannot open " + path_);
    std::string line;
    while (std::getline(file, line)) {
      ++number_;
      readLine(line);
    }
    if (faces_.empty()) throw NoModel(path_ + " has no faces");
    return model();
  }

 private:
  struct Face {
    Ring ring;
    std::size_t names;  ///< index in names_
  };

  [[noreturn]] void fail(const std::string& what) const {
    throw std::runtime_error(path_ + " line " + std::to_string(number_) + ": " + what);
  }

  void readLine(const std::string& line) {
    std::istringstream words(line);
    std::string key;
    words >> key;
    if (key == "v") {
      Eigen::Vector3d p;
      if (!(words >> p.x() >> p.y() >> p.z()) || !p.allFinite()) fail("a vertex needs three numbers");
      if (y_up_) p = Eigen::Vector3d(p.x(), -p.z(), p.y());
      vertices_.push_back(p);
    } else if (key == "o" || key == "g" || key == "usemtl") {
      std::string name;
      std::getline(words >> std::ws, name);
      name.erase(name.find_last_not_of(" \t\r") + 1);
      now_[key == "o" ? 0 : key == "g" ? 1 : 2] = name;
      if (key == "o") now_[1].clear();
      known_ = false;
    } else if (key == "f") {
      addFace(corners(&words));
    }
  }

  void addFace(Ring ring) {
    if (!known_) {
      const auto [entry, is_new] = index_of_names_.emplace(now_, names_.size());
      if (is_new) names_.push_back(now_);
      index_ = entry->second;
      for (std::size_t depth = 0; depth < shapes_now_.size(); ++depth) shapes_now_[depth] = &shapes_[upTo(now_, depth)];
      known_ = true;
    }
    for (Shape* shape : shapes_now_) shape->add(ring);
    faces_.push_back({std::move(ring), index_});
  }

  Ring corners(std::istringstream* words) const {
    Ring ring;
    std::string corner;
    while (*words >> corner) {
      long i = 0;
      try {
        i = std::stol(corner);  // stops at the slash of vertex/texture/normal
      } catch (const std::exception&) {
        fail("'" + corner + "' is no corner of a face");
      }
      const long index = i < 0 ? static_cast<long>(vertices_.size()) + i : i - 1;
      if (i == 0 || index < 0 || index >= static_cast<long>(vertices_.size()))
        fail("face corner " + corner + " names a vertex that does not exist");
      ring.push_back(vertices_[static_cast<std::size_t>(index)]);
    }
    if (ring.size() < 3) fail("a face needs three corners");
    return ring;
  }

  /// The names down to the object, its group, or the material in that.
  static Names upTo(Names names, std::size_t depth) {
    for (std::size_t i = depth + 1; i < names.size(); ++i) names[i].clear();
    return names;
  }

  std::optional<Surface> surfaceOf(const Names& names, std::size_t depth) const {
    const Meaning meaning = meaningOf(names[depth]);
    if (meaning.of_houses_too && shapes_.at(upTo(names, depth)).isHouse()) return std::nullopt;
    return meaning.surface;
  }

  PolygonModel model() {
    struct Kind {
      std::optional<Surface> surface;
      bool terrain = false;
    };
    std::vector<Kind> kinds;
    for (const Names& names : names_) {
      Kind kind;
      for (const std::size_t depth : {2, 1, 0})
        if (!kind.surface) kind.surface = surfaceOf(names, depth);
      kind.terrain = kind.surface == Surface::kGround && surfaceOf(names, names[0].empty() ? 1 : 0) == Surface::kGround;
      kinds.push_back(kind);
    }
    PolygonModel model;
    std::map<std::string, int> ids;
    for (Face& face : faces_) {
      const Names& names = names_[face.names];
      const Kind& kind = kinds[face.names];
      Polygon polygon;
      polygon.rings.push_back(std::move(face.ring));
      polygon.surface = kind.surface;
      if (!kind.terrain) {
        const std::string& id = names[0].empty() ? names[1] : names[0];
        const auto inserted = ids.emplace(id, static_cast<int>(model.building_ids.size()));
        if (inserted.second) model.building_ids.push_back(id.empty() ? "building" : id);
        polygon.building = inserted.first->second;
      }
      model.polygons.push_back(std::move(polygon));
    }
    return model;
  }

  const std::string path_;
  const bool y_up_;
  int number_ = 0;  ///< of the line
  std::vector<Eigen::Vector3d> vertices_;
  Names now_;
  bool known_ = false;     ///< now_ is: what follows belongs to it
  std::size_t index_ = 0;  ///< in names_
  std::array<Shape*, 3> shapes_now_{};
  std::vector<Names> names_;
  std::map<Names, std::size_t> index_of_names_;
  std::map<Names, Shape> shapes_;  ///< by the names down to a depth
  std::vector<Face> faces_;
};

}  // namespace

// Vertices, faces with any number of corners, `o` and `g` names. A building is an object (`o`), or where the file has
// none, a group (`g`); groups inside an object, and materials, may tell walls from roofs and ground by their names.
PolygonModel readObj(const std::string& path, bool y_up) { return Reader(path, y_up).read(); }

}  // namespace streetview_localizer
