#include <tinyxml2.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <map>
#include <stdexcept>

#include "polygons.h"

namespace streetview_localizer {
namespace {

using tinyxml2::XMLElement;

// CityGML 1.0, 2.0 and 3.0 differ in namespaces and little else here: elements are known by their local names.
const char* localName(const XMLElement& e) {
  const char* colon = std::strchr(e.Name(), ':');
  return colon ? colon + 1 : e.Name();
}

bool is(const XMLElement& e, std::initializer_list<const char*> names) {
  const char* name = localName(e);
  return std::any_of(names.begin(), names.end(), [&](const char* n) { return std::strcmp(name, n) == 0; });
}

const char* attribute(const XMLElement& e, const char* local_name) {
  for (const auto* a = e.FirstAttribute(); a; a = a->Next()) {
    const char* colon = std::strchr(a->Name(), ':');
    if (std::strcmp(colon ? colon + 1 : a->Name(), local_name) == 0) return a->Value();
  }
  return nullptr;
}

struct FoundPolygon {
  Polygon polygon;
  std::string id;  // gml:id
  int lod = -1;
};

// What is known on the way down from a city object to a polygon.
struct Context {
  std::optional<Surface> surface;
  int lod = -1;
  bool reversed = false;
  bool surfaces_only = false;  // solids are passed over
  int dimension = 3;
};

class Reader {
 public:
  Reader(const std::string& path, int lod) : path_(path), lod_(lod) {}

  PolygonModel read() {
    tinyxml2::XMLDocument document;
    if (document.LoadFile(path_.c_str()) != tinyxml2::XML_SUCCESS)
      throw std::runtime_error(path_ + " is not well-formed XML: " + document.ErrorStr());
    const XMLElement* root = document.RootElement();
    if (!root || !is(*root, {"CityModel", "FeatureCollection"})) throw NoModel(path_ + " is XML but not CityGML");
    for (const XMLElement* e = root->FirstChildElement(); e; e = e->NextSiblingElement()) {
      if (is(*e, {"boundedBy"})) findSrs(*e);
      if (is(*e, {"cityObjectMember", "featureMember", "featureMembers", "member"}))
        for (const XMLElement* object = e->FirstChildElement(); object; object = object->NextSiblingElement())
          cityObject(*object);
    }
    if (implicit_ > 0)
      model_.remarks.push_back(path_ + ": " + std::to_string(implicit_) +
                               " implicit geometries (shared templates) were left out");
    if (unread_ > 0)
      model_.remarks.push_back(path_ + ": " + std::to_string(unread_) +
                               " polygons without three coordinates a corner, or three corners, were left out");
    return std::move(model_);
  }

 private:
  void findSrs(const XMLElement& e) {
    if (!model_.srs.empty()) return;
    if (const char* srs = e.Attribute("srsName")) {
      model_.srs = srs;
      return;
    }
    for (const XMLElement* c = e.FirstChildElement(); c; c = c->NextSiblingElement()) findSrs(*c);
  }

  void cityObject(const XMLElement& e) {
    if (is(e, {"Building", "Bridge", "BuildingPart", "BuildingUnit", "BridgePart", "OtherConstruction"})) {
      const char* id = attribute(e, "id");
      model_.building_ids.push_back(id ? id : "building_" + std::to_string(model_.building_ids.size()));
      const std::size_t before = model_.polygons.size();
      building(e, static_cast<int>(model_.building_ids.size()) - 1);
      if (model_.polygons.size() == before) model_.building_ids.pop_back();
    } else if (is(e, {"ReliefFeature", "TINRelief", "Road", "Railway", "Square", "Track", "TransportationComplex",
                      "TrafficSpace", "LandUse", "WaterBody", "PlantCover"})) {
      std::vector<FoundPolygon> found;
      std::vector<const XMLElement*> parts;
      Context context;
      context.surface = Surface::kGround;
      // A wood as a solid reaches up to its crowns; as a surface it is the ground under it.
      context.surfaces_only = is(e, {"PlantCover"});
      collect(e, context, &found, &parts);
      for (FoundPolygon& f : found) f.polygon.theme = localName(e);
      keepLod(&found, -1, /*any_lod=*/true);
    }
  }

  // A building and its parts share one id; each part has its own choice of LoD.
  void building(const XMLElement& e, int index) {
    std::vector<FoundPolygon> found;
    std::vector<const XMLElement*> parts;
    hrefs_.clear();
    collect(e, Context(), &found, &parts);
    for (FoundPolygon& f : found) {
      // A solid may hold the polygons that a wall or roof only refers to.
      const auto href = hrefs_.find(f.id);
      if (!f.polygon.surface && !f.id.empty() && href != hrefs_.end()) f.polygon.surface = href->second;
    }
    keepLod(&found, index, /*any_lod=*/false);
    for (const XMLElement* part : parts) building(*part, index);
  }

  void keepLod(std::vector<FoundPolygon>* found, int index, bool any_lod) {
    std::array<double, 4> area{};
    for (const FoundPolygon& f : *found)
      if (f.lod >= 0 && f.lod <= 3) area[f.lod] += areaVector(f.polygon.rings[0]).norm();
    const int lod = chooseLod(area, lod_);
    for (FoundPolygon& f : *found) {
      if (any_lod ? (lod >= 0 && f.lod >= 0 && f.lod != lod) : (lod < 0 || f.lod != lod)) continue;
      f.polygon.building = index;
      model_.polygons.push_back(std::move(f.polygon));
    }
  }

  void collect(const XMLElement& e, Context context, std::vector<FoundPolygon>* found,
               std::vector<const XMLElement*>* parts) {
    const char* name = localName(e);
    if (std::strncmp(name, "lod", 3) == 0 && name[3] >= '0' && name[3] <= '4') {
      context.lod = name[3] - '0';
      if (std::strstr(name, "Implicit")) {
        ++implicit_;
        return;
      }
    }
    if (is(e, {"interiorRoom", "BuildingRoom", "Room", "ClosureSurface", "InteriorWallSurface", "CeilingSurface",
               "FloorSurface", "appearance", "appearanceMember", "address"}))
      return;
    if (context.surfaces_only && is(e, {"Solid", "CompositeSolid", "MultiSolid"})) return;
    if (is(e, {"WallSurface"})) context.surface = Surface::kWall;
    if (is(e, {"RoofSurface"})) context.surface = Surface::kRoof;
    if (is(e, {"GroundSurface"})) context.surface = Surface::kGround;
    if (is(e, {"Window", "Door", "WindowSurface", "DoorSurface", "OuterCeilingSurface", "OuterFloorSurface",
               "BuildingInstallation", "BridgeConstructionElement", "BridgeInstallation"}))
      context.surface = Surface::kOther;
    if (is(e, {"OrientableSurface"})) {
      const char* orientation = attribute(e, "orientation");
      if (orientation && orientation[0] == '-') context.reversed = !context.reversed;
    }
    if (const char* dimension = attribute(e, "srsDimension")) context.dimension = std::atoi(dimension);
    if (const char* srs = e.Attribute("srsName"); srs && model_.srs.empty()) model_.srs = srs;
    if (const char* href = attribute(e, "href"); href && href[0] == '#' && context.surface)
      hrefs_.emplace(href + 1, *context.surface);
    if (is(e, {"Polygon", "PolygonPatch", "Triangle", "Rectangle"})) {
      FoundPolygon f;
      if (!polygon(e, context, &f.polygon)) {
        ++unread_;
        return;
      }
      if (const char* id = attribute(e, "id")) f.id = id;
      f.lod = context.lod;
      found->push_back(std::move(f));
      return;
    }
    for (const XMLElement* c = e.FirstChildElement(); c; c = c->NextSiblingElement()) {
      if (is(*c, {"consistsOfBuildingPart", "buildingPart", "consistsOfBridgePart", "bridgePart"})) {
        if (const XMLElement* part = c->FirstChildElement()) parts->push_back(part);
        continue;
      }
      collect(*c, context, found, parts);
    }
  }

  bool polygon(const XMLElement& e, const Context& context, Polygon* polygon) {
    polygon->surface = context.surface;
    for (const XMLElement* c = e.FirstChildElement(); c; c = c->NextSiblingElement()) {
      if (!is(*c, {"exterior", "interior", "outerBoundaryIs", "innerBoundaryIs"})) continue;
      const XMLElement* linear_ring = c->FirstChildElement();
      if (!linear_ring) continue;
      Ring r = ring(*linear_ring, context.dimension);
      if (r.size() < 3) {
        if (polygon->rings.empty()) return false;
        continue;
      }
      if (context.reversed) std::reverse(r.begin(), r.end());
      polygon->rings.push_back(std::move(r));
    }
    return !polygon->rings.empty();
  }

  /// Of a LinearRing, or of a Ring of curves; empty where its corners have no three coordinates.
  Ring ring(const XMLElement& e, int dimension) {
    Ring ring;
    if (!collectCorners(e, dimension, &ring)) return {};
    const auto same = [](const Eigen::Vector3d& a, const Eigen::Vector3d& b) { return (a - b).norm() < 1e-9; };
    if (!is(e, {"LinearRing"})) ring.erase(std::unique(ring.begin(), ring.end(), same), ring.end());  // ends of curves
    while (ring.size() > 1 && same(ring.back(), ring.front())) ring.pop_back();
    for (const Eigen::Vector3d& p : ring)
      if (!p.allFinite()) return {};
    return ring;
  }

  /// Adds the corners that an element holds, in itself or in those in it. False where they have no three coordinates.
  bool collectCorners(const XMLElement& e, int dimension, Ring* ring) {
    if (const char* d = attribute(e, "srsDimension")) dimension = std::atoi(d);
    for (const XMLElement* c = e.FirstChildElement(); c; c = c->NextSiblingElement())
      if (!collectCorners(*c, dimension, ring)) return false;
    if (!is(e, {"posList", "pos", "coordinates"}) || !e.GetText()) return true;
    if (dimension != 3) return false;
    std::vector<double> values;
    for (const char* p = e.GetText(); *p;) {
      char* end = nullptr;
      const double v = std::strtod(p, &end);
      if (end == p) {
        if (!std::strchr(" \t\r\n,", *p))
          throw std::runtime_error(path_ + " line " + std::to_string(e.GetLineNum()) +
                                   ": not a number in a coordinate list");
        ++p;
        continue;
      }
      values.push_back(v);
      p = end;
    }
    for (std::size_t i = 0; i + 2 < values.size(); i += 3) ring->emplace_back(values[i], values[i + 1], values[i + 2]);
    return true;
  }

  std::string path_;
  int lod_;
  PolygonModel model_;
  std::map<std::string, Surface> hrefs_;
  int implicit_ = 0, unread_ = 0;
};

}  // namespace

PolygonModel readCityGml(const std::string& path, int lod) { return Reader(path, lod).read(); }

}  // namespace streetview_localizer
