#include <algorithm>
#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>

#include "polygons.h"

namespace streetview_localizer {
namespace {

using nlohmann::json;

const std::set<std::string> kBuildingTypes = {"Building",
                                              "BuildingPart",
                                              "BuildingInstallation",
                                              "BuildingConstructiveElement",
                                              "Bridge",
                                              "BridgePart",
                                              "BridgeInstallation",
                                              "BridgeConstructionElement",
                                              "BridgeConstructiveElement",
                                              "OtherConstruction"};
const std::set<std::string> kGroundTypes = {"Road",    "Railway",   "TransportSquare", "Waterway",
                                            "LandUse", "WaterBody", "PlantCover",      "TINRelief"};

std::optional<Surface> surfaceOfSemantic(const std::string& type) {
  if (type == "WallSurface") return Surface::kWall;
  if (type == "RoofSurface") return Surface::kRoof;
  if (type == "GroundSurface") return Surface::kGround;
  if (type == "ClosureSurface") return std::nullopt;
  return Surface::kOther;
}

class Reader {
 public:
  Reader(const std::string& path, int lod) : path_(path), lod_(lod) {}

  PolygonModel read() {
    std::ifstream file(path_);
    if (!file) throw std::runtime_error("cannot open " + path_);
    try {
      const json head = parseHead(&file);
      if (!head.is_object()) throw NoModel(path_ + " is JSON but not CityJSON");
      if (head.value("type", "") != "CityJSON") throw NoModel(path_ + " is JSON but not CityJSON");
      const std::string version = head.value("version", "");
      if (version.rfind("1.", 0) != 0 && version.rfind("2.", 0) != 0)
        throw std::runtime_error(path_ + " has CityJSON version '" + version +
                                 "': 1.0 to 2.0 are read; upgrade it with cjio");
      if (head.contains("metadata")) {
        const json& metadata = head["metadata"];
        for (const char* key : {"referenceSystem", "crs"})  // 1.0 also wrote {"crs": {"epsg": 7415}}
          if (metadata.contains(key)) {
            const json& value = metadata[key];
            if (value.is_string()) model_.srs = value.get<std::string>();
            if (value.is_object() && value.contains("epsg"))
              model_.srs = "EPSG:" + std::to_string(integer(value["epsg"]));
          }
      }
      if (head.contains("transform"))
        for (int i = 0; i < 3; ++i) {
          scale_[i] = head["transform"].at("scale").at(i).get<double>();
          translate_[i] = head["transform"].at("translate").at(i).get<double>();
        }
      objects(head);
      // CityJSONSeq: one feature a line after the first.
      std::string line;
      while (sequence_ && std::getline(file, line))
        if (line.find_first_not_of(" \t\r\n") != std::string::npos) {
          endsClosed(line);
          objects(json::parse(line));
        }
    } catch (const json::exception& e) {
      throw std::runtime_error(path_ + " is no valid CityJSON: " + e.what());
    }
    if (templates_ > 0)
      model_.remarks.push_back(path_ + ": " + std::to_string(templates_) +
                               " geometry instances (shared templates) were left out");
    return std::move(model_);
  }

 private:
  // True where all brackets that a text opens are closed at its end. Throws where they are nested deeper than anything
  // in CityJSON is (a MultiSolid's vertices): such trees overflow the stack of who walks them. The parser's own
  // callback would tell the depth as well, but takes time that grows with the square of the objects
  // (nlohmann/json 3.11).
  bool endsClosed(const std::string& text) const {
    constexpr int kDeepest = 64;
    int depth = 0;
    bool quoted = false;
    for (std::size_t i = 0; i < text.size(); ++i) {
      const char c = text[i];
      if (quoted) {
        if (c == '\\') ++i;
        if (c == '"') quoted = false;
      } else if (c == '"') {
        quoted = true;
      } else if (c == '{' || c == '[') {
        if (++depth > kDeepest) throw std::runtime_error(path_ + " is nested too deeply for CityJSON");
      } else if (c == '}' || c == ']') {
        --depth;
      }
    }
    return depth <= 0 && !quoted;
  }

  // The whole file, or of a sequence its first line.
  json parseHead(std::ifstream* file) {
    std::string text;
    do std::getline(*file, text);
    while (*file && text.find_first_not_of(" \t\r\n\xEF\xBB\xBF") == std::string::npos);
    sequence_ = endsClosed(text);
    if (!sequence_) {
      text += '\n';
      text.append(std::istreambuf_iterator<char>(*file), std::istreambuf_iterator<char>());
      endsClosed(text);
    }
    return json::parse(text);
  }

  void objects(const json& j) {
    vertices_.clear();
    if (!j.contains("CityObjects")) return;
    for (const json& v : j.at("vertices")) {
      const Eigen::Vector3d p(v.at(0).get<double>(), v.at(1).get<double>(), v.at(2).get<double>());
      vertices_.push_back(p.cwiseProduct(scale_) + translate_);
    }
    const json& all = j["CityObjects"];
    std::map<std::string, int> index_of;
    for (const auto& [id, object] : all.items()) {
      const std::string type = object.at("type");
      const bool building = kBuildingTypes.count(type) > 0;
      if ((!building && kGroundTypes.count(type) == 0) || !object.contains("geometry")) continue;
      int index = -1;
      if (building) {
        const std::string root = rootOf(all, id);
        const auto inserted = index_of.emplace(root, static_cast<int>(model_.building_ids.size()));
        if (inserted.second) model_.building_ids.push_back(root);
        index = inserted.first->second;
      }
      const bool attached =
          type.find("Installation") != std::string::npos || type.find("Constructi") != std::string::npos;
      object_ = {type, index,
                 building ? (attached ? std::optional<Surface>(Surface::kOther) : std::nullopt)
                          : std::optional<Surface>(Surface::kGround)};
      geometries(object["geometry"], building);
    }
  }

  std::string rootOf(const json& all, std::string id) const {
    for (int depth = 0; depth < 8; ++depth) {
      const auto object = all.find(id);
      if (object == all.end() || !object->contains("parents") || (*object)["parents"].empty()) return id;
      const std::string parent = (*object)["parents"][0];
      if (all.contains(parent) && kBuildingTypes.count(all[parent].value("type", "")) == 0) return id;  // a group
      id = parent;
    }
    return id;
  }

  std::int64_t integer(const json& value) const {
    if (!value.is_number_integer()) throw std::runtime_error(path_ + " has something else where an integer must be");
    return value.get<std::int64_t>();
  }

  static int lodOf(const json& geometry) {
    if (!geometry.contains("lod")) return -1;
    const json& lod = geometry["lod"];
    const double level = lod.is_string() ? std::atof(lod.get<std::string>().c_str()) : lod.get<double>();
    return level >= 0 && level < 10 ? static_cast<int>(level) : -1;
  }

  void geometries(const json& list, bool building) {
    std::vector<std::vector<Polygon>> read(list.size());
    std::vector<double> areas(list.size(), 0);
    std::array<double, 4> area{};
    for (std::size_t g = 0; g < list.size(); ++g) {
      if (list[g].at("type") == "GeometryInstance") {
        ++templates_;
        continue;
      }
      // A wood as a solid reaches up to its crowns; as a surface it is the ground under it.
      if (object_.type == "PlantCover" && list[g]["type"].get<std::string>().find("Solid") != std::string::npos)
        continue;
      read[g] = polygons(list[g]);
      const int lod = lodOf(list[g]);
      // Of LoD 2.0 to 2.3 the fullest counts, not their sum.
      for (const Polygon& p : read[g]) areas[g] += areaVector(p.rings[0]).norm();
      if (lod >= 0 && lod <= 3) area[lod] = std::max(area[lod], areas[g]);
    }
    const int lod = chooseLod(area, lod_);
    if (building && lod < 0) return;
    // Several geometries of the level (2.0, 2.1, 2.2): the finest of those that are no mere part of the fullest.
    const auto wanted = [&](std::size_t g) { return !read[g].empty() && (lod < 0 || lodOf(list[g]) == lod); };
    double fullest = 0;
    for (std::size_t g = 0; g < list.size(); ++g)
      if (wanted(g)) fullest = std::max(fullest, areas[g]);
    int chosen = -1;
    for (std::size_t g = 0; g < list.size(); ++g)
      if (wanted(g) && areas[g] >= 0.5 * fullest && (chosen < 0 || lodText(list[g]) >= lodText(list[chosen])))
        chosen = static_cast<int>(g);
    if (chosen < 0) return;
    for (Polygon& p : read[chosen]) model_.polygons.push_back(std::move(p));
  }

  static std::string lodText(const json& geometry) { return geometry.contains("lod") ? geometry["lod"].dump() : ""; }

  /// Null where there is none.
  static const json& memberOf(const json& object, const char* name) {
    static const json kNone;
    const auto found = object.find(name);
    return found == object.end() ? kNone : *found;
  }

  std::vector<Polygon> polygons(const json& geometry) const {
    std::vector<Polygon> out;
    const std::string type = geometry.at("type");
    const json& boundaries = geometry.at("boundaries");
    const json& semantics = memberOf(geometry, "semantics");
    const json &values = memberOf(semantics, "values"), &surfaces = memberOf(semantics, "surfaces");
    const auto shell = [&](const json& polygons_of_shell, const json& values_of_shell) {
      for (std::size_t i = 0; i < polygons_of_shell.size(); ++i) {
        const bool listed = values_of_shell.is_array() && i < values_of_shell.size();
        addPolygon(polygons_of_shell[i], listed ? values_of_shell[i] : values_of_shell, surfaces, &out);
      }
    };
    const auto child = [](const json& v, std::size_t i) -> const json& {
      return v.is_array() ? (i < v.size() ? v[i] : memberOf(v, "")) : v;
    };
    if (type == "MultiSurface" || type == "CompositeSurface") {
      shell(boundaries, values);
    } else if (type == "Solid") {
      if (!boundaries.empty()) shell(boundaries[0], child(values, 0));  // the shells after the first are hollows inside
    } else if (type == "MultiSolid" || type == "CompositeSolid") {
      for (std::size_t s = 0; s < boundaries.size(); ++s)
        if (!boundaries[s].empty()) shell(boundaries[s][0], child(child(values, s), 0));
    }
    return out;
  }

  void addPolygon(const json& rings, const json& value, const json& surfaces, std::vector<Polygon>* out) const {
    Polygon polygon;
    polygon.building = object_.building;
    polygon.surface = object_.surface;
    if (polygon.building < 0) polygon.theme = object_.type;
    if (value.is_number_integer() && !object_.surface) {
      const json& semantic = surfaces.at(value.get<std::size_t>());
      const std::string type = semantic.value("type", "");
      if (type == "ClosureSurface") return;
      polygon.surface = surfaceOfSemantic(type);
    }
    for (const json& indices : rings) {
      Ring ring;
      for (const json& i : indices) {
        const auto index = static_cast<std::size_t>(integer(i));
        if (index >= vertices_.size())
          throw std::runtime_error(path_ + ": vertex " + std::to_string(index) + " does not exist");
        ring.push_back(vertices_[index]);
      }
      while (ring.size() > 1 && ring.back() == ring.front()) ring.pop_back();
      if (ring.size() < 3) {
        if (polygon.rings.empty()) return;
        continue;
      }
      polygon.rings.push_back(std::move(ring));
    }
    if (!polygon.rings.empty()) out->push_back(std::move(polygon));
  }

  struct Object {
    std::string type;
    int building = -1;
    std::optional<Surface> surface;
  };

  std::string path_;
  int lod_;
  PolygonModel model_;
  Eigen::Vector3d scale_ = Eigen::Vector3d::Ones(), translate_ = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector3d> vertices_;
  Object object_;
  bool sequence_ = false;
  int templates_ = 0;
};

}  // namespace

PolygonModel readCityJson(const std::string& path, int lod) { return Reader(path, lod).read(); }

}  // namespace streetview_localizer
