#include <cctype>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>

#include "polygons.h"

namespace streetview_localizer {
namespace {

// Whole words alone: "academy_wall" is no digital elevation model ("dem").
std::optional<Surface> surfaceOfName(const std::string& name) {
  std::optional<Surface> surface;
  std::string word;
  for (const char c : name + " ") {
    if (std::isalpha(static_cast<unsigned char>(c))) {
      word += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
      continue;
    }
    for (const char* w : {"ground", "groundsurface", "terrain", "road", "pavement", "sidewalk", "dtm", "dem"})
      if (word == w) return Surface::kGround;
    if (word == "roof" || word == "roofs" || word == "roofsurface") surface = Surface::kRoof;
    if (word == "wall" || word == "wallsurface" || word == "walls" || word == "facade" || word == "facades")
      surface = Surface::kWall;
    word.clear();
  }
  return surface;
}

}  // namespace

// Vertices, faces with any number of corners, `o` and `g` names. A building is an object (`o`), or where the file has
// none, a group (`g`); groups inside an object, and materials, may tell walls from roofs and ground by their names.
PolygonModel readObj(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot open " + path);
  PolygonModel model;
  std::vector<Eigen::Vector3d> vertices;
  std::map<std::string, int> ids;
  std::string line, object, group, material;
  int number = 0;
  const auto fail = [&](const std::string& what) {
    throw std::runtime_error(path + " line " + std::to_string(number) + ": " + what);
  };
  while (std::getline(file, line)) {
    ++number;
    std::istringstream words(line);
    std::string key;
    words >> key;
    if (key == "v") {
      Eigen::Vector3d p;
      if (!(words >> p.x() >> p.y() >> p.z()) || !p.allFinite()) fail("a vertex needs three numbers");
      vertices.push_back(p);
    } else if (key == "o" || key == "g" || key == "usemtl") {
      std::string name;
      std::getline(words >> std::ws, name);
      name.erase(name.find_last_not_of(" \t\r") + 1);
      (key == "o" ? object : key == "g" ? group : material) = name;
      if (key == "o") group.clear();
    } else if (key == "f") {
      Polygon polygon;
      Ring ring;
      std::string corner;
      while (words >> corner) {
        long i = 0;
        try {
          i = std::stol(corner);  // stops at the slash of vertex/texture/normal
        } catch (const std::exception&) {
          fail("'" + corner + "' is no corner of a face");
        }
        const long index = i < 0 ? static_cast<long>(vertices.size()) + i : i - 1;
        if (i == 0 || index < 0 || index >= static_cast<long>(vertices.size()))
          fail("face corner " + corner + " names a vertex that does not exist");
        ring.push_back(vertices[static_cast<std::size_t>(index)]);
      }
      if (ring.size() < 3) fail("a face needs three corners");
      polygon.rings.push_back(ring);
      for (const std::string* name : {&material, &group, &object})
        if (!polygon.surface) polygon.surface = surfaceOfName(*name);
      if (polygon.surface == Surface::kGround && surfaceOfName(object.empty() ? group : object) == Surface::kGround) {
        model.polygons.push_back(polygon);
        continue;
      }
      const std::string& id = object.empty() ? group : object;
      const auto inserted = ids.emplace(id, static_cast<int>(model.building_ids.size()));
      if (inserted.second) model.building_ids.push_back(id.empty() ? "building" : id);
      polygon.building = inserted.first->second;
      model.polygons.push_back(polygon);
    }
  }
  if (model.polygons.empty()) throw NoModel(path + " has no faces");
  return model;
}

}  // namespace streetview_localizer
