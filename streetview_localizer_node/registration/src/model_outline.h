// The city model as the registration needs it: which of its edges a camera at a place sees, and as what.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include "air_ground_common/mesh.h"
#include "streetview_localizer/city_model.h"

namespace streetview_localizer::registration {

/// An edge between two faces that are not coplanar, or of one face only.
struct ModelEdge {
  Eigen::Vector3d a, b;
  int building = -1;
  bool vertical = false;
  bool eave = false;  ///< top of a wall: eaves, gutter or cornice may stand out there
};

/// A point of the outline: beyond the edge, on the side `outside`, lies something else.
struct OutlineSample {
  enum class Kind { kSky, kFoot };  ///< what is beyond: the sky (roofs, free corners) or the ground below the wall
  Kind kind = Kind::kSky;
  Eigen::Vector3d point, direction;  ///< world; `direction` of the edge, unit length
  Eigen::Vector3d outside;           ///< unit vector across the edge and the line of sight, to the other side
  int building = -1;
  bool eave = false;
  double weight = 0;  ///< angle that the sample stands for [rad]
};

/// The seen part of a vertical edge, the corner of a building.
struct OutlineVertical {
  Eigen::Vector3d foot, top;  ///< [m]
  int building = -1;
  bool boundary = false;  ///< beyond it lies another building or the sky, not the same building's next wall
};

struct Outline {
  std::vector<OutlineSample> samples;
  std::vector<OutlineVertical> verticals;
};

/// Elevation (its tangent) of the highest building in each of `bins` directions, azimuth counted like the columns of a
/// panorama: bin i looks to (1/2 - (i + 1/2) / bins) 2 pi. And at which horizontal distance, of which building (-1:
/// none).
struct SkyProfile {
  std::vector<float> tangent, distance;
  std::vector<int> building;
};

struct GroundGuess {
  double height = 0;     ///< [m]
  bool known = false;    ///< from the model's terrain
  bool guessed = false;  ///< from the feet of the walls around: good to half a metre
};

class ModelOutline {
 public:
  /// Throws std::invalid_argument for a model without buildings or lists of unequal length.
  explicit ModelOutline(const CityModel& model);

  /// Edges with a point within `radius` of `position`, in plan.
  std::vector<ModelEdge> edgesNear(const Eigen::Vector3d& position, double radius) const;

  static void skyProfile(const std::vector<ModelEdge>& edges, const Eigen::Vector3d& position, int bins,
                         SkyProfile* profile);

  Outline visible(const std::vector<ModelEdge>& edges, const Eigen::Vector3d& position) const;

  /// Height of the ground below a place [m]; empty where the model has none.
  std::optional<double> groundHeight(double x, double y) const;

  /// The same, or where the model has no terrain a guess from the buildings.
  GroundGuess groundGuess(const Eigen::Vector3d& position) const;

  /// True when a place lies inside a building: an odd number of its surfaces, undersides too, above it.
  bool insideBuilding(const Eigen::Vector3d& position) const;

  const air_ground_common::MeshScene& scene() const { return *scene_; }
  const air_ground_common::TriangleMesh& mesh() const { return mesh_; }
  int building(int triangle) const { return building_[triangle]; }
  /// True for walls, roofs and what is fixed to them.
  bool solid(int triangle) const { return solid_[triangle]; }
  int buildings() const { return building_count_; }

 private:
  /// What the rays to both sides of a place on an edge meet.
  struct EdgeView {
    int own_sides = 0;  ///< that show the edge's own building, there; 0 also where the place is hidden
    Eigen::Vector3d across = Eigen::Vector3d::Zero();  ///< unit vector from side -1 to side 1
    int outside = 0;                                   ///< the side that shows something else, -1 or 1
    bool sky = false;                                  ///< which is the sky
    bool boundary = false;                             ///< sky, ground or another building
  };
  EdgeView lookAside(const ModelEdge& edge, const Eigen::Vector3d& p, const Eigen::Vector3d& direction,
                     const Eigen::Vector3d& position) const;
  void addEdge(const ModelEdge& edge, const Eigen::Vector3d& position, Outline* outline) const;
  void addFeet(const Eigen::Vector3d& position, Outline* outline) const;

  air_ground_common::TriangleMesh mesh_;  // buildings and ground
  std::vector<int> building_;
  std::vector<char> solid_;
  std::vector<ModelEdge> edges_;
  std::vector<Eigen::Vector3d> feet_;  // one a building
  int building_count_ = 0;
  std::unique_ptr<air_ground_common::MeshScene> scene_, ground_;
  float above_ = std::numeric_limits<float>::lowest();  ///< the highest of the ground [m]
};

}  // namespace streetview_localizer::registration
