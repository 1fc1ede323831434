// Prints how far panoramas of a simulated city are from the truth before and after registration:
//   street_study FOLDER.city... [--mirror | --shift METRES] [--draw FOLDER] [--single]
// The folders are those that `simulate` writes for a street.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "simulated_street.h"
#include "streetview_localizer/geotags.h"
#include "streetview_localizer/panorama_registration.h"

using air_ground_common::Pose;
using namespace streetview_localizer;

namespace {

void printDistribution(const char* name, std::vector<double> values, const char* unit) {
  if (values.empty()) return;
  std::sort(values.begin(), values.end());
  double sum = 0;
  for (const double v : values) sum += v;
  std::printf("%-28s n %3zu  mean %.3f  median %.3f  90 %% %.3f  largest %.3f %s\n", name, values.size(),
              sum / values.size(), values[values.size() / 2], values[values.size() * 9 / 10], values.back(), unit);
}

struct Errors {
  std::vector<double> position, horizontal, orientation;
  void add(const Pose& pose, const Pose& truth) {
    position.push_back((pose.translation() - truth.translation()).norm());
    horizontal.push_back((pose.translation() - truth.translation()).head<2>().norm());
    orientation.push_back(air_ground_common::rotationAngle(pose.linear(), truth.linear()) * 180 / M_PI);
  }
  void print(const char* name) const {
    std::printf("%s\n", name);
    printDistribution("  position", position, "m");
    printDistribution("  horizontal", horizontal, "m");
    printDistribution("  orientation", orientation, "degrees");
  }
};

}  // namespace

int main(int argc, char** argv) {
  bool mirror = false;
  double shift = 0;
  std::string draw;
  std::vector<std::string> folders;
  for (int i = 1; i < argc; ++i) {
    if (!std::strcmp(argv[i], "--mirror")) {
      mirror = true;
    } else if (!std::strcmp(argv[i], "--shift") && i + 1 < argc) {
      shift = std::atof(argv[++i]);
    } else if (!std::strcmp(argv[i], "--draw") && i + 1 < argc) {
      draw = argv[++i];
    } else {
      folders.push_back(argv[i]);
    }
  }
  Errors raw, corrected;
  std::vector<double> nees;
  int wrong = 0;
  for (const std::string& folder : folders) {
    const CityModel city = testing::modelOfTruth(folder);
    RegistrationSettings settings;
    const PanoramaRegistrar registrar(city, settings);
    const auto truth = testing::truePoses(folder);
    std::vector<RegistrationInput> inputs;
    std::vector<Pose> truths;
    std::vector<std::string> names;
    for (const Geotag& geotag : readGeotags(folder + "/geotags.csv")) {
      const std::string id = geotag.image.substr(0, geotag.image.find('.'));
      if (!truth.count(id)) continue;
      RegistrationInput input;
      input.T_world_geotag = worldPose(geotag, city);
      input.T_world_geotag.translation() += shift * input.T_world_geotag.linear().col(0);
      input.load = [path = folder + "/panoramas/" + geotag.image, mirror] {
        cv::Mat image = cv::imread(path);
        if (mirror) cv::flip(image, image, 1);
        return image;
      };
      inputs.push_back(input);
      truths.push_back(truth.at(id));
      names.push_back(id);
    }
    const auto results = registrar.registerPanoramas(inputs);
    for (std::size_t i = 0; i < results.size(); ++i) {
      const RegistrationResult& result = results[i];
      const Pose& pose = result.T_world_panorama;
      raw.add(inputs[i].T_world_geotag, truths[i]);
      air_ground_common::Vector6d error;
      error.head<3>() = truths[i].translation() - pose.translation();
      error.tail<3>() = air_ground_common::logSO3(truths[i].linear() * pose.linear().transpose());
      const Eigen::Vector3d body = truths[i].linear().transpose() * error.head<3>();
      const double square = error.dot(result.covariance.ldlt().solve(error));
      std::printf(
          "%s raw %.2f m %.2f deg | %s x %.2f y %.2f z %.2f m, %.2f %.2f %.2f deg, stddev %.2f m %.2f deg, cost %.3f "
          "sky %.2f NEES %.1f %s\n",
          names[i].c_str(), raw.position.back(), raw.orientation.back(), result.accepted ? "corrected" : "kept     ",
          body.x(), body.y(), body.z(), error(3) * 180 / M_PI, error(4) * 180 / M_PI, error(5) * 180 / M_PI,
          result.position_stddev, result.orientation_stddev * 180 / M_PI, result.cost, result.inlier_ratio, square,
          result.reason.c_str());
      if (result.accepted) {
        corrected.add(pose, truths[i]);
        nees.push_back(square);
        if (error.head<3>().norm() > 1 || error.tail<3>().norm() > 0.0175) ++wrong;
      }
      if (!draw.empty()) {
        cv::imwrite(draw + "/" + names[i] + "_before.jpg",
                    registrar.drawOutline(inputs[i].load(), inputs[i].T_world_geotag));
        cv::imwrite(draw + "/" + names[i] + "_after.jpg", registrar.drawOutline(inputs[i].load(), pose));
      }
    }
    std::fflush(stdout);
  }
  raw.print("raw");
  corrected.print("corrected");
  printDistribution("NEES (6 expected)", nees, "");
  std::printf("corrected %zu of %zu, of these wrong by more than 1 m or 1 degree: %d\n", nees.size(),
              raw.position.size(), wrong);
}
