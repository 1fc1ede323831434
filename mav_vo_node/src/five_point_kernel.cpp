#include "five_point_kernel.h"

#include <cmath>

#include "air_ground_common/clones.h"

namespace mav_vo {

namespace {
constexpr int L = kFivePointLanes;
constexpr int kIterations = 9;
using Lane = double[L];
}  // namespace

AIR_GROUND_CLONES void fivePointNewton(const double* p, const double* c, double* q, double* t, double* residual) {
  const auto P = [&](int i, int k) { return p + (3 * i + k) * L; };
  const auto C = [&](int i, int k) { return c + (3 * i + k) * L; };
  for (int iteration = 0; iteration <= kIterations; ++iteration) {
    Lane R[9], b1[3], b2[3];  // rotation, tangents of the unit sphere at t
    for (int l = 0; l < L; ++l) {
      const double w = q[l], x = q[L + l], y = q[2 * L + l], z = q[3 * L + l];
      R[0][l] = 1 - 2 * (y * y + z * z);
      R[1][l] = 2 * (x * y - w * z);
      R[2][l] = 2 * (x * z + w * y);
      R[3][l] = 2 * (x * y + w * z);
      R[4][l] = 1 - 2 * (x * x + z * z);
      R[5][l] = 2 * (y * z - w * x);
      R[6][l] = 2 * (x * z - w * y);
      R[7][l] = 2 * (y * z + w * x);
      R[8][l] = 1 - 2 * (x * x + y * y);
      // Frame without branches (Duff et al. 2017).
      const double tx = t[l], ty = t[L + l], tz = t[2 * L + l];
      const double sign = std::copysign(1.0, tz), a = -1 / (sign + tz), b = tx * ty * a;
      b1[0][l] = 1 + sign * tx * tx * a;
      b1[1][l] = sign * b;
      b1[2][l] = -sign * tx;
      b2[0][l] = b;
      b2[1][l] = sign + ty * ty * a;
      b2[2][l] = -ty;
    }
    // Row i: residual p . (t x r) with r = R c; by rotation r x (p x t); by t: r x p along the tangents.
    Lane J[5][5], f[5];
    for (int i = 0; i < 5; ++i) {
      for (int l = 0; l < L; ++l) {
        const double cx = C(i, 0)[l], cy = C(i, 1)[l], cz = C(i, 2)[l];
        const double rx = R[0][l] * cx + R[1][l] * cy + R[2][l] * cz, ry = R[3][l] * cx + R[4][l] * cy + R[5][l] * cz,
                     rz = R[6][l] * cx + R[7][l] * cy + R[8][l] * cz;
        const double px = P(i, 0)[l], py = P(i, 1)[l], pz = P(i, 2)[l];
        const double tx = t[l], ty = t[L + l], tz = t[2 * L + l];
        const double ux = py * tz - pz * ty, uy = pz * tx - px * tz, uz = px * ty - py * tx;  // p x t
        J[i][0][l] = ry * uz - rz * uy;
        J[i][1][l] = rz * ux - rx * uz;
        J[i][2][l] = rx * uy - ry * ux;
        const double nx = ry * pz - rz * py, ny = rz * px - rx * pz, nz = rx * py - ry * px;  // r x p
        f[i][l] = tx * nx + ty * ny + tz * nz;
        J[i][3][l] = b1[0][l] * nx + b1[1][l] * ny + b1[2][l] * nz;
        J[i][4][l] = b2[0][l] * nx + b2[1][l] * ny + b2[2][l] * nz;
      }
    }
    if (iteration == kIterations) {
      for (int l = 0; l < L; ++l) residual[l] = 0;
      for (int i = 0; i < 5; ++i) {
        for (int l = 0; l < L; ++l) {
          const double e = std::abs(f[i][l]);
          residual[l] = e <= residual[l] ? residual[l] : e;  // keeps what is not a number
        }
      }
      return;
    }
    // J step = -f by modified Gram-Schmidt on the columns: no pivots, so all lanes do the same.
    Lane U[5][5], g[5];
    for (int k = 0; k < 5; ++k) {
      for (int l = 0; l < L; ++l) {
        double norm2 = 1e-300;
        for (int i = 0; i < 5; ++i) norm2 += J[i][k][l] * J[i][k][l];
        const double norm = std::sqrt(norm2), inverse = 1 / norm;
        U[k][k][l] = norm;
        double dot = 0;
        for (int i = 0; i < 5; ++i) {
          J[i][k][l] *= inverse;
          dot -= J[i][k][l] * f[i][l];
        }
        g[k][l] = dot;
      }
      for (int m = k + 1; m < 5; ++m) {
        for (int l = 0; l < L; ++l) {
          double dot = 0;
          for (int i = 0; i < 5; ++i) dot += J[i][k][l] * J[i][m][l];
          U[k][m][l] = dot;
          for (int i = 0; i < 5; ++i) J[i][m][l] -= dot * J[i][k][l];
        }
      }
    }
    for (int k = 4; k >= 0; --k) {
      for (int l = 0; l < L; ++l) {
        double value = g[k][l];
        for (int m = k + 1; m < 5; ++m) value -= U[k][m][l] * g[m][l];
        g[k][l] = value / U[k][k][l];
      }
    }
    for (int l = 0; l < L; ++l) {
      // No step beyond half a radian: the linear model holds no farther.
      const double size2 =
          g[0][l] * g[0][l] + g[1][l] * g[1][l] + g[2][l] * g[2][l] + g[3][l] * g[3][l] + g[4][l] * g[4][l];
      const double s = size2 > 0.25 ? 0.5 / std::sqrt(size2) : 1.0;
      // R = exp(g) R to first order, as a quaternion from the left.
      const double x = 0.5 * s * g[0][l], y = 0.5 * s * g[1][l], z = 0.5 * s * g[2][l];
      const double w0 = q[l], x0 = q[L + l], y0 = q[2 * L + l], z0 = q[3 * L + l];
      const double w1 = w0 - x * x0 - y * y0 - z * z0, x1 = x0 + x * w0 + y * z0 - z * y0,
                   y1 = y0 + y * w0 + z * x0 - x * z0, z1 = z0 + z * w0 + x * y0 - y * x0;
      const double n = 1 / std::sqrt(w1 * w1 + x1 * x1 + y1 * y1 + z1 * z1);
      q[l] = n * w1;
      q[L + l] = n * x1;
      q[2 * L + l] = n * y1;
      q[3 * L + l] = n * z1;
      const double u = s * g[3][l], v = s * g[4][l];
      const double tx = t[l] + u * b1[0][l] + v * b2[0][l], ty = t[L + l] + u * b1[1][l] + v * b2[1][l],
                   tz = t[2 * L + l] + u * b1[2][l] + v * b2[2][l];
      const double m = 1 / std::sqrt(tx * tx + ty * ty + tz * tz);
      t[l] = m * tx;
      t[L + l] = m * ty;
      t[2 * L + l] = m * tz;
    }
  }
}

}  // namespace mav_vo
