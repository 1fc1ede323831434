#include "visual_frontend/self_calibration.h"

namespace visual_frontend {

CameraModel withRadial(CameraModel camera, double change) {
  camera.k1 += change;
  camera.setDistortion(camera.distortionName(), camera.distortionCoefficients());  // its largest radius
  return camera;
}

}  // namespace visual_frontend
