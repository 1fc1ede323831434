// Prints what the correction makes of photographs of synthetic streets: photograph_study FIRST_SEED LAST_SEED
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "air_ground_common/units.h"
#include "streetview_localizer/panorama_registration.h"
#include "synthetic_street.h"

int main(int argc, char** argv) {
  using namespace streetview_localizer;
  using air_ground_common::Pose;
  if (argc != 3) {
    std::fprintf(stderr, "usage: photograph_study FIRST_SEED LAST_SEED\n");
    return 1;
  }
  using air_ground_common::kDegree;
  air_ground_common::CameraModel camera;  // 75 degrees wide
  camera.width = 1024, camera.height = 768;
  camera.fx = camera.fy = 512 / std::tan(37.5 * kDegree);
  camera.cx = 511.5, camera.cy = 383.5, camera.k1 = -0.02;
  for (int seed = std::atoi(argv[1]); seed <= std::atoi(argv[2]); ++seed) {
    SyntheticStreetSettings settings;
    settings.seed = seed;
    const SyntheticStreet street(settings);
    const PanoramaRegistrar registrar(street.model());
    std::mt19937_64 random(seed * 31 + 5);
    for (const double along : {30.0, 60.0, 90.0}) {
      for (const double heading : {0.0, 45.0, 90.0, 180.0, 225.0}) {
        Pose truth = street.panoramaPose(along, &random);
        truth.linear() = air_ground_common::yawPose(heading * kDegree, Eigen::Vector3d::Zero()).linear() *
                         truth.linear() * air_ground_common::expSO3({0, -0.2, 0});
        const Pose geotag = drawGeotag(truth, &random);
        const RegistrationResult r = registrar.registerPhotograph(street.photograph(camera, truth), camera, geotag);
        std::printf("seed %d, %2.0f m along, %3.0f deg: geotag wrong by %.2f m; ", seed, along, heading,
                    (geotag.translation() - truth.translation()).norm());
        if (r.accepted)
          std::printf("corrected, wrong by %.2f m (stddev %.2f), %.2f deg (%.2f)\n",
                      (r.T_world_panorama.translation() - truth.translation()).norm(), r.position_stddev,
                      air_ground_common::rotationAngle(r.T_world_panorama.linear(), truth.linear()) / kDegree,
                      r.orientation_stddev / kDegree);
        else
          std::printf("refused: %s\n", r.reason.c_str());
      }
    }
  }
  return 0;
}
