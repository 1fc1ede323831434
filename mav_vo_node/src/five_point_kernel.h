// Newton's method on eight five-point problems at a time, on plain arrays.
#pragma once

namespace mav_vo {

constexpr int kFivePointLanes = 8;

/// p, c: rays of the earlier and the later image, [5][3][lanes]. q (rotation earlier from later, w x y z) and t (unit
/// direction): [4][lanes] and [3][lanes], start in, root out. residual: the largest |p . (t x R c)| of each lane, after
/// the last step.
void fivePointNewton(const double* p, const double* c, double* q, double* t, double* residual);

}  // namespace mav_vo
