// Prints what neighbours find of wrong poses in streets that `simulate --world street` writes:
//   neighbour_study FOLDER.city... [--draws N] [--threads N] [--verbose]
// One panorama in six is moved by 0.6 to 2 m along or across the street.
#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "simulated_street.h"
#include "streetview_localizer/geotags.h"
#include "streetview_localizer/neighbour_check.h"
#include "visual_frontend/pose_graph.h"

using air_ground_common::Pose;
using namespace streetview_localizer;

namespace {

bool verbose = false;
int threads = 2;

void printDistribution(const char* name, std::vector<double> values, const char* unit) {
  if (values.empty()) return;
  std::sort(values.begin(), values.end());
  const auto at = [&](double q) {
    return values[static_cast<std::size_t>(q * (static_cast<double>(values.size()) - 1))];
  };
  std::printf("%-34s n %4zu  median %.3f  90 %% %.3f  99 %% %.3f  largest %.3f %s\n", name, values.size(), at(0.5),
              at(0.9), at(0.99), values.back(), unit);
}

double inPlan(const Pose& a, const Pose& b) { return (a.translation() - b.translation()).head<2>().norm(); }
double degreesBetween(const Pose& a, const Pose& b) {
  return air_ground_common::rotationAngle(a.linear(), b.linear()) * 180 / M_PI;
}

struct Street {
  CityModel city;
  std::vector<NeighbourImage> images;
  std::vector<Pose> truth, geotags;
};

Street readStreet(const std::string& folder) {
  Street street;
  street.city = testing::modelOfTruth(folder);
  RegistrationSettings settings;
  settings.threads = threads;
  const PanoramaRegistrar registrar(street.city, settings);
  const auto truth = testing::truePoses(folder);
  std::vector<RegistrationInput> inputs;
  std::vector<std::string> names;
  for (const Geotag& geotag : readGeotags(folder + "/geotags.csv")) {
    const std::string id = geotag.image.substr(0, geotag.image.find('.'));
    if (!truth.count(id)) continue;
    RegistrationInput input;
    input.T_world_geotag = worldPose(geotag, street.city);
    input.load = [path = folder + "/panoramas/" + geotag.image] { return cv::imread(path); };
    inputs.push_back(input);
    street.truth.push_back(truth.at(id));
    street.geotags.push_back(input.T_world_geotag);
    names.push_back(id);
  }
  const auto results = registrar.registerPanoramas(inputs);
  for (std::size_t i = 0; i < results.size(); ++i) {
    NeighbourImage image;
    image.name = names[i];
    image.load = inputs[i].load;
    image.T_world_image = results[i].T_world_panorama;
    image.registered = results[i].accepted;
    image.position_stddev = results[i].position_stddev;
    image.orientation_stddev = results[i].orientation_stddev;
    street.images.push_back(image);
  }
  return street;
}

/// Of registered poses and their means with what neighbours measured, against the truth.
struct Averaging {
  std::vector<double> before, after, turn_before, turn_after;

  void add(const Street& street, const std::vector<NeighbourEdge>& edges, const NeighbourSettings& s) {
    std::vector<visual_frontend::PoseGraphNode> nodes(1);
    nodes[0].fixed = true;
    std::vector<visual_frontend::PoseGraphEdge> graph;
    for (std::size_t i = 0; i < street.images.size(); ++i) {
      const NeighbourImage& image = street.images[i];
      nodes.push_back({image.T_world_image, false});
      visual_frontend::PoseGraphEdge prior{0, static_cast<int>(i) + 1, image.T_world_image};
      const double p = image.registered ? image.position_stddev : 3,
                   o = image.registered ? image.orientation_stddev : 0.03;
      prior.covariance.diagonal() << p * p, p * p, p * p, o * o, o * o, o * o;
      prior.robust = true;
      graph.push_back(prior);
    }
    for (const NeighbourEdge& e : edges) {
      visual_frontend::PoseGraphEdge edge{e.a + 1, e.b + 1, e.T_a_b, e.covariance, true};
      edge.covariance.diagonal().head<3>().array() += s.measured_position * s.measured_position;
      edge.covariance.diagonal().tail<3>().array() += s.measured_angle * s.measured_angle;
      graph.push_back(edge);
    }
    visual_frontend::optimizePoseGraph(nodes, graph, {});
    for (std::size_t i = 0; i < street.images.size(); ++i) {
      if (!street.images[i].registered) continue;
      before.push_back(inPlan(street.images[i].T_world_image, street.truth[i]));
      after.push_back(inPlan(nodes[i + 1].T_map_camera, street.truth[i]));
      turn_before.push_back(degreesBetween(street.images[i].T_world_image, street.truth[i]));
      turn_after.push_back(degreesBetween(nodes[i + 1].T_map_camera, street.truth[i]));
    }
  }
};

struct Edges {
  std::vector<double> plan, turn, sigmas, disagreement, turn_disagreement;

  void add(const Street& street, const std::vector<NeighbourEdge>& edges) {
    for (const NeighbourEdge& e : edges) {
      const Pose T_a_b = street.truth[e.a].inverse() * street.truth[e.b];
      const Eigen::Vector3d off = T_a_b.translation() - e.T_a_b.translation();
      plan.push_back(off.head<2>().norm());
      turn.push_back(degreesBetween(T_a_b, e.T_a_b));
      sigmas.push_back(std::sqrt(off.dot(e.covariance.topLeftCorner<3, 3>().ldlt().solve(off))));
      if (!street.images[e.a].registered || !street.images[e.b].registered) continue;
      const Pose predicted = street.images[e.a].T_world_image * e.T_a_b;
      disagreement.push_back(inPlan(predicted, street.images[e.b].T_world_image));
      turn_disagreement.push_back(degreesBetween(predicted, street.images[e.b].T_world_image));
      if (verbose)
        std::printf(
            "  %s %s: baseline %.1f m, wrong by %.2f m %.2f deg, stated %.2f m %.2f deg; disagrees by %.2f m %.2f "
            "deg\n",
            street.images[e.a].name.c_str(), street.images[e.b].name.c_str(), T_a_b.translation().norm(), plan.back(),
            turn.back(), std::sqrt(e.covariance.topLeftCorner<3, 3>().trace() / 3),
            std::sqrt(e.covariance.bottomRightCorner<3, 3>().trace() / 3) * 180 / M_PI, disagreement.back(),
            turn_disagreement.back());
    }
  }
};

struct Counts {
  int all = 0, anew = 0, refused = 0, doubtful = 0, gained = 0, wrong_after = 0;
  void add(const NeighbourOutcome& outcome, const Pose& truth) {
    ++all;
    anew += outcome.kind == NeighbourOutcome::Kind::kAnew;
    refused += outcome.kind == NeighbourOutcome::Kind::kRefused;
    doubtful += outcome.kind == NeighbourOutcome::Kind::kDoubtful;
    gained += outcome.kind == NeighbourOutcome::Kind::kGained;
    const bool sure =
        outcome.kind != NeighbourOutcome::Kind::kRefused && outcome.kind != NeighbourOutcome::Kind::kDoubtful;
    wrong_after += sure && outcome.position_stddev < 1 && inPlan(outcome.T_world_image, truth) > 0.5;
  }
  void print(const char* name) const {
    std::printf("%-26s %4d: registered anew %d, refused %d, doubtful %d, gained %d; wrong by 0.5 m and not said %d\n",
                name, all, anew, refused, doubtful, gained, wrong_after);
  }
};

struct Study {
  NeighbourSettings settings;
  Edges edges;
  Averaging averaging;
  Counts unmoved, moved[3], beside, refused, withheld;  // moved: 0.6 to 1, 1 to 1.5, 1.5 to 2 m
  std::vector<double> before, after, gained;

  std::vector<NeighbourOutcome> run(const Street& street, std::vector<NeighbourEdge>* measured) const {
    const BackProjector projector(street.city);
    *measured = measureNeighbours(street.images, projector, settings, threads);
    RegistrationSettings registration;
    registration.threads = threads;
    return settleNeighbours(street.images, judgeNeighbours(street.images, *measured, settings), street.city,
                            registration, settings);
  }

  void addUnmoved(const Street& street) {
    std::vector<NeighbourEdge> measured;
    const auto start = std::chrono::steady_clock::now();
    const auto outcomes = run(street, &measured);
    std::printf("  %zu images, %zu pairs measured, %.2f s an image\n", street.images.size(), measured.size(),
                std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() /
                    static_cast<double>(street.images.size()));
    edges.add(street, measured);
    averaging.add(street, measured, settings);
    for (std::size_t i = 0; i < outcomes.size(); ++i) {
      if (!outcomes[i].remark.empty())
        std::printf("  %s %s\n", street.images[i].name.c_str(), outcomes[i].remark.c_str());
      (street.images[i].registered ? unmoved : refused).add(outcomes[i], street.truth[i]);
      if (outcomes[i].kind == NeighbourOutcome::Kind::kGained)
        std::printf("  %s gained, wrong by %.2f m\n", street.images[i].name.c_str(),
                    inPlan(outcomes[i].T_world_image, street.truth[i]));
    }
  }

  void addMoved(Street street, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> u(0, 1);
    std::vector<int> order;
    for (std::size_t i = 0; i < street.images.size(); ++i)
      if (street.images[i].registered) order.push_back(static_cast<int>(i));
    std::shuffle(order.begin(), order.end(), random);
    std::map<int, double> shifts;
    for (std::size_t k = 0; k < (order.size() + 3) / 6; ++k) {
      NeighbourImage& image = street.images[order[k]];
      const double shift = 0.6 + 1.4 * u(random), angle = u(random) < 0.7 ? 0 : M_PI / 2,
                   sign = u(random) < 0.5 ? -1 : 1;
      // Panoramas of the simulated car look along the street.
      const double yaw = air_ground_common::yawOf(street.truth[order[k]].linear()) + angle;
      image.T_world_image.translation() += sign * shift * Eigen::Vector3d(std::cos(yaw), std::sin(yaw), 0);
      shifts[order[k]] = shift;
    }
    std::vector<NeighbourEdge> measured;
    const auto outcomes = run(street, &measured);
    for (std::size_t i = 0; i < outcomes.size(); ++i) {
      if (!street.images[i].registered) continue;
      const auto shift = shifts.find(static_cast<int>(i));
      if (shift == shifts.end()) {
        beside.add(outcomes[i], street.truth[i]);
      } else {
        moved[shift->second < 1 ? 0 : shift->second < 1.5 ? 1 : 2].add(outcomes[i], street.truth[i]);
      }
      before.push_back(inPlan(street.images[i].T_world_image, street.truth[i]));
      if (outcomes[i].kind != NeighbourOutcome::Kind::kRefused)
        after.push_back(inPlan(outcomes[i].T_world_image, street.truth[i]));
      if (verbose && (shift != shifts.end() || !outcomes[i].remark.empty()))
        std::printf("  %s moved by %.2f m: %d %s, now wrong by %.2f m\n", street.images[i].name.c_str(),
                    shift == shifts.end() ? 0 : shift->second, static_cast<int>(outcomes[i].kind),
                    outcomes[i].remark.c_str(), inPlan(outcomes[i].T_world_image, street.truth[i]));
    }
  }

  /// One in six as if the registration had refused it.
  void addRefused(Street street, unsigned seed) {
    for (std::size_t i = seed % 6; i < street.images.size(); i += 6) {
      street.images[i].registered = false;
      street.images[i].T_world_image = street.geotags[i];
      street.images[i].position_stddev = 3, street.images[i].orientation_stddev = 0.033;
    }
    std::vector<NeighbourEdge> measured;
    const auto outcomes = run(street, &measured);
    for (std::size_t i = 0; i < outcomes.size(); ++i) {
      if (street.images[i].registered) continue;
      withheld.add(outcomes[i], street.truth[i]);
      if (outcomes[i].kind == NeighbourOutcome::Kind::kGained)
        gained.push_back(inPlan(outcomes[i].T_world_image, street.truth[i]));
    }
  }

  void print() const {
    printDistribution("relative pose, in plan", edges.plan, "m");
    printDistribution("relative pose, angle", edges.turn, "degrees");
    printDistribution("relative pose, sigmas", edges.sigmas, "");
    printDistribution("prediction - registration, in plan", edges.disagreement, "m");
    printDistribution("prediction - registration, angle", edges.turn_disagreement, "degrees");
    printDistribution("registered, in plan", averaging.before, "m");
    printDistribution("averaged, in plan", averaging.after, "m");
    printDistribution("registered, angle", averaging.turn_before, "degrees");
    printDistribution("averaged, angle", averaging.turn_after, "degrees");
    unmoved.print("no pose moved");
    moved[0].print("moved by 0.6 to 1 m");
    moved[1].print("moved by 1 to 1.5 m");
    moved[2].print("moved by 1.5 to 2 m");
    beside.print("not moved, beside them");
    refused.print("refused by registration");
    withheld.print("taken for refused");
    printDistribution("gained, in plan", gained, "m");
    printDistribution("with moved ones, before", before, "m");
    printDistribution("with moved ones, after", after, "m");
  }
};

}  // namespace

int main(int argc, char** argv) {
  int draws = 3;
  std::vector<std::string> folders;
  for (int i = 1; i < argc; ++i) {
    if (!std::strcmp(argv[i], "--draws") && i + 1 < argc) {
      draws = std::atoi(argv[++i]);
    } else if (!std::strcmp(argv[i], "--threads") && i + 1 < argc) {
      threads = std::atoi(argv[++i]);
    } else if (!std::strcmp(argv[i], "--verbose")) {
      verbose = true;
    } else {
      folders.push_back(argv[i]);
    }
  }
  Study study;
  unsigned seed = 6;
  for (const std::string& folder : folders) {
    const Street street = readStreet(folder);
    std::printf("%s\n", folder.c_str());
    study.addUnmoved(street);
    for (int draw = 0; draw < draws; ++draw) study.addMoved(street, ++seed);
    if (draws > 0) study.addRefused(street, ++seed);
    std::fflush(stdout);
  }
  study.print();
}
