#include "streetview_localizer/kvld.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "air_ground_common/units.h"

namespace streetview_localizer {
namespace {

constexpr int kDisks = LineDescriptor::kDisks, kHistogram = LineDescriptor::kHistogram;
constexpr int kDirections = LineDescriptor::kDirections;
constexpr float kMinimumRadius = 3;  // of a disk, at the level it is read from [px]
constexpr int kSmallestLevel = 48;   // [px]
constexpr double kBlank = 60;        // mean magnitude of the Scharr filter (16 a grey level) that is noise

/// Samples of a disk: a 5 x 5 grid without its corners.
constexpr int kSamples = 21;
std::array<cv::Point2f, kSamples> diskPattern() {
  std::array<cv::Point2f, kSamples> points;
  int count = 0;
  for (int y = -2; y <= 2; ++y)
    for (int x = -2; x <= 2; ++x)
      if (x * x + y * y <= 5) points[count++] = cv::Point2f(x / 2.5f, y / 2.5f);
  return points;
}

struct Edge {
  int a, b;  ///< indices of matches, a < b
};

using Complex = std::complex<float>;

/// A match as two points and the similarity that its keypoints define; the plane's vectors as complex numbers.
struct MatchFrame {
  MatchFrame(const cv::KeyPoint& q, const cv::KeyPoint& v)
      : query(q.pt.x, q.pt.y),
        view(v.pt.x, v.pt.y),
        view_from_query(
            std::polar(v.size / q.size, static_cast<float>((v.angle - q.angle) * air_ground_common::kDegree))),
        query_from_view(1.f / view_from_query) {}
  Complex query, view;
  Complex view_from_query, query_from_view;
};

/// Product without the standard's care for infinities, which costs a call.
Complex times(Complex a, Complex b) {
  return {a.real() * b.real() - a.imag() * b.imag(), a.real() * b.imag() + a.imag() * b.real()};
}

float lengthOf(Complex a) { return std::sqrt(std::norm(a)); }

float inconsistency(const MatchFrame& i, const MatchFrame& j, Complex q, Complex v) {
  const float in_view = lengthOf(times(i.view_from_query, q) - v) + lengthOf(times(j.view_from_query, q) - v);
  const float in_query = lengthOf(times(i.query_from_view, v) - q) + lengthOf(times(j.query_from_view, v) - q);
  return 0.25f * (in_view / lengthOf(v) + in_query / lengthOf(q));
}

/// Lines from each match to the nearest others that are geometrically consistent, each pair once.
std::vector<Edge> candidateEdges(const std::vector<MatchFrame>& frames, const KvldSettings& settings) {
  const int n = static_cast<int>(frames.size());
  const auto low = static_cast<float>(settings.min_length * settings.min_length);
  const auto high = static_cast<float>(settings.max_length * settings.max_length);
  std::vector<std::vector<int>> chosen(n);
#pragma omp parallel
  {
    std::vector<std::pair<float, int>> near;
#pragma omp for schedule(dynamic, 16)
    for (int i = 0; i < n; ++i) {
      near.clear();
      for (int j = 0; j < n; ++j) {
        const Complex q = frames[j].query - frames[i].query, v = frames[j].view - frames[i].view;
        const float length_q = std::norm(q), length_v = std::norm(v);
        if (length_q < low || length_q > high || length_v < low || length_v > high) continue;
        if (inconsistency(frames[i], frames[j], q, v) <= settings.max_geometric) near.emplace_back(length_q, j);
      }
      const std::size_t count = std::min<std::size_t>(settings.max_lines, near.size());
      std::partial_sort(near.begin(), near.begin() + count, near.end());
      for (std::size_t k = 0; k < count; ++k) chosen[i].push_back(near[k].second);
    }
  }
  std::vector<Edge> edges;
  for (int i = 0; i < n; ++i)
    for (int j : chosen[i]) {
      const bool also_from_j = std::find(chosen[j].begin(), chosen[j].end(), i) != chosen[j].end();
      if (i < j || !also_from_j) edges.push_back({std::min(i, j), std::max(i, j)});
    }
  return edges;
}

/// The triangle order of the survivors. Three points of a facade turn the same way in every image of its front; matches
/// to the wrong one of several equal windows, or to a mirrored facade, turn either way. Drops, worst first, the matches
/// whose triangles agree too seldom.
class OrderCheck {
 public:
  OrderCheck(const std::vector<MatchFrame>& frames, double min_agreement)
      : frames_(frames), min_agreement_(min_agreement) {}

  /// Of the given indices, those that remain; empty when fewer than half would.
  std::vector<int> run(const std::vector<int>& kept) const {
    std::vector<int> now = kept;
    while (now.size() >= 4) {
      std::vector<double> score(now.size());
      const int n = static_cast<int>(now.size());
      for (int i = 0; i < n; ++i) score[i] = agreement(now, i);
      // The bad ones pull everyone down: take away only the worst before looking again.
      std::vector<double> sorted = score;
      std::sort(sorted.begin(), sorted.end());
      if (sorted.front() >= min_agreement_) break;
      const double limit = std::min(min_agreement_, std::max(sorted[now.size() / 10], sorted.front() + 1e-9));
      std::vector<int> next;
      for (int i = 0; i < n; ++i)
        if (score[i] >= limit) next.push_back(now[i]);
      if (2 * next.size() < kept.size()) return {};
      now = std::move(next);
    }
    return now;
  }

 private:
  static constexpr int kTriangles = 100;

  /// Share of triangles of match i with two others that turn the same way in both images; 1 when there is none to
  /// judge.
  double agreement(const std::vector<int>& set, int i) const {
    const int n = static_cast<int>(set.size());
    int same = 0, judged = 0;
    std::uint32_t state = 2463534242u + 7919u * static_cast<std::uint32_t>(i);
    const auto other = [&] {  // xorshift
      state ^= state << 13;
      state ^= state >> 17;
      state ^= state << 5;
      return set[state % static_cast<std::uint32_t>(n)];
    };
    const MatchFrame& a = frames_[set[i]];
    for (int t = 0; t < kTriangles; ++t) {
      const MatchFrame &b = frames_[other()], &c = frames_[other()];
      const float in_query = turn(a.query, b.query, c.query), in_view = turn(a.view, b.view, c.view);
      if (std::min(std::abs(in_query), std::abs(in_view)) < kFlat) continue;
      ++judged;
      same += (in_query > 0) == (in_view > 0);
    }
    return judged < kTriangles / 10 ? 1 : static_cast<double>(same) / judged;
  }

  static constexpr float kFlat = 0.15f;  // sine of the angle below which a triangle has no clear sense

  /// Sine of the angle at a from b to c; 0 for points that coincide.
  static float turn(Complex a, Complex b, Complex c) {
    const Complex u = b - a, v = c - a;
    const float lengths = lengthOf(u) * lengthOf(v);
    return lengths > 0 ? (u.real() * v.imag() - u.imag() * v.real()) / lengths : 0;
  }

  const std::vector<MatchFrame>& frames_;
  const double min_agreement_;
};

/// Removes matches with too few supporters until none is left to remove; then, of matches that share a feature, all but
/// the best supported, and starts again.
class Pruning {
 public:
  Pruning(const std::vector<Match>& matches, const std::vector<Edge>& edges, int min_supporters)
      : matches_(matches),
        min_supporters_(min_supporters),
        neighbours_(matches.size()),
        alive_(matches.size(), true),
        count_(matches.size(), 0) {
    for (const Edge& e : edges) {
      neighbours_[e.a].push_back(e.b);
      neighbours_[e.b].push_back(e.a);
    }
    for (std::size_t i = 0; i < matches.size(); ++i) count_[i] = static_cast<int>(neighbours_[i].size());
  }

  KvldResult run() {
    do {
      dropUnsupported();
    } while (dropCompeting());
    KvldResult result;
    for (std::size_t i = 0; i < matches_.size(); ++i) {
      if (!alive_[i]) continue;
      result.kept.push_back(static_cast<int>(i));
      result.supporters.push_back(count_[i]);
    }
    return result;
  }

 private:
  void drop(int i) {
    alive_[i] = false;
    for (int j : neighbours_[i]) --count_[j];
  }

  void dropUnsupported() {
    for (bool changed = true; changed;) {
      changed = false;
      for (std::size_t i = 0; i < matches_.size(); ++i) {
        if (!alive_[i] || count_[i] >= min_supporters_) continue;
        drop(static_cast<int>(i));
        changed = true;
      }
    }
  }

  bool dropCompeting() {
    bool any = false;
    for (const bool by_query : {true, false}) {
      std::vector<int> order;
      for (std::size_t i = 0; i < matches_.size(); ++i)
        if (alive_[i]) order.push_back(static_cast<int>(i));
      const auto feature = [&](int i) { return by_query ? matches_[i].query : matches_[i].view; };
      std::sort(order.begin(), order.end(), [&](int a, int b) {
        if (feature(a) != feature(b)) return feature(a) < feature(b);
        if (count_[a] != count_[b]) return count_[a] > count_[b];
        return matches_[a].distance != matches_[b].distance ? matches_[a].distance < matches_[b].distance : a < b;
      });
      for (std::size_t k = 1; k < order.size(); ++k)
        if (feature(order[k]) == feature(order[k - 1])) {
          drop(order[k]);
          any = true;
        }
    }
    return any;
  }

  const std::vector<Match>& matches_;
  const int min_supporters_;
  std::vector<std::vector<int>> neighbours_;
  std::vector<bool> alive_;
  std::vector<int> count_;
};

}  // namespace

std::size_t GradientPyramid::bytes() const {
  std::size_t sum = 0;
  for (const Level& level : levels_) sum += level.gradients.size() * sizeof(Gradient);
  return sum;
}

GradientPyramid::GradientPyramid(const cv::Mat& image) {
  if (image.empty() || (image.type() != CV_8UC1 && image.type() != CV_8UC3))
    throw std::invalid_argument("GradientPyramid: the image must have 8 bits and 1 or 3 channels");
  cv::Mat grey = image;
  if (image.channels() == 3) cv::cvtColor(image, grey, cv::COLOR_BGR2GRAY);
  cv::Mat smooth;
  cv::GaussianBlur(grey, smooth, cv::Size(3, 3), 0.8);
  while (true) {
    cv::Mat dx, dy, magnitude, angle;
    cv::Scharr(smooth, dx, CV_32F, 1, 0);
    cv::Scharr(smooth, dy, CV_32F, 0, 1);
    cv::cartToPolar(dx, dy, magnitude, angle);
    Level level{smooth.cols, smooth.rows, std::vector<Gradient>(smooth.total())};
    const float *m = magnitude.ptr<float>(), *a = angle.ptr<float>();
    for (std::size_t i = 0; i < level.gradients.size(); ++i)
      level.gradients[i] = {static_cast<std::uint16_t>(m[i]),
                            static_cast<std::uint16_t>(static_cast<int>(a[i] * (65536 / (2 * M_PI))) & 0xFFFF)};
    levels_.push_back(std::move(level));
    if (std::min(smooth.cols, smooth.rows) / 2 < kSmallestLevel) break;
    cv::Mat half;
    cv::pyrDown(smooth, half);
    smooth = half;
  }
}

LineDescriptor describeLine(const GradientPyramid& pyramid, cv::Point2f from, cv::Point2f to) {
  static const std::array<cv::Point2f, kSamples> pattern = diskPattern();
  LineDescriptor line;
  const cv::Point2f along = to - from;
  const float length = std::sqrt(along.dot(along));
  if (!(length > 0)) return line;
  float radius = std::max(kMinimumRadius, length / (kDisks + 1)), scale = 1;
  std::size_t l = 0;
  for (; radius >= 2 * kMinimumRadius && l + 1 < pyramid.levels().size(); ++l) {
    radius /= 2;
    scale /= 2;
  }
  const GradientPyramid::Level& level = pyramid.levels()[l];
  const cv::Point2f unit = along / length, x = unit * radius;
  const auto turn = static_cast<std::uint16_t>(
      static_cast<int>(std::lround(std::atan2(unit.y, unit.x) * (65536 / (2 * M_PI)))) & 0xFFFF);
  int dx[kSamples], dy[kSamples], reach = 0;
  for (int k = 0; k < kSamples; ++k) {
    dx[k] = cvRound(pattern[k].x * x.x - pattern[k].y * x.y);
    dy[k] = cvRound(pattern[k].x * x.y + pattern[k].y * x.x);
    reach = std::max({reach, std::abs(dx[k]), std::abs(dy[k])});
  }

  // The disks may leave the image a little: what is outside counts as blank.
  float sums[kDisks], total = 0;
  float directions[kDisks][kDirections + 1] = {};  // the last is the first again
  for (int u = 0; u < kDisks; ++u) {
    const cv::Point2f centre = (from + along * (static_cast<float>(u + 1) / (kDisks + 1))) * scale;
    const int cx = cvRound(centre.x), cy = cvRound(centre.y);
    const bool inside = cx >= reach && cy >= reach && cx < level.width - reach && cy < level.height - reach;
    const GradientPyramid::Gradient* middle =
        level.gradients.data() + static_cast<std::ptrdiff_t>(cy) * level.width + cx;
    float sum = 0;
    for (int k = 0; k < kSamples; ++k) {
      if (!inside && (cx + dx[k] < 0 || cy + dy[k] < 0 || cx + dx[k] >= level.width || cy + dy[k] >= level.height))
        continue;
      const GradientPyramid::Gradient g = middle[dy[k] * level.width + dx[k]];
      const int relative = static_cast<std::uint16_t>(g.angle - turn) * kDirections;
      const int bin = relative >> 16;
      const float part = static_cast<float>(relative & 0xFFFF) * (1 / 65536.f) * g.magnitude;
      directions[u][bin] += g.magnitude - part;
      directions[u][bin + 1] += part;
      sum += g.magnitude;
    }
    directions[u][0] += directions[u][kDirections];
    sums[u] = sum;
    total += sum;
  }
  if (total < kBlank * kDisks * kSamples) return line;
  line.valid = true;
  constexpr int kWide = kDirections / kHistogram;
  static_assert(kWide == 3, "a histogram bin is three directions");
  for (int u = 0; u < kDisks; ++u) {
    int main = 0;
    for (int w = 1; w < kDirections; ++w)
      if (directions[u][w] > directions[u][main]) main = w;
    line.main_direction[u] = main;
    line.contrast[u] = sums[u] > 0 ? directions[u][main] / sums[u] * std::sqrt(sums[u] / total) : 0;
    // Bin w stands for the direction w; histogram bin v for v * kWide and its two neighbours.
    for (int v = 0; v < kHistogram; ++v) {
      const int w = v * kWide;
      line.histogram[u][v] =
          (directions[u][w == 0 ? kDirections - 1 : w - 1] + directions[u][w] + directions[u][w + 1]) / total;
    }
  }
  return line;
}

double lineDistance(const LineDescriptor& a, const LineDescriptor& b, double histogram_weight) {
  if (!a.valid || !b.valid) return 1;
  float histogram = 0, angle = 0, weight = 0;
  for (int u = 0; u < kDisks; ++u) {
    for (int v = 0; v < kHistogram; ++v) histogram += std::abs(a.histogram[u][v] - b.histogram[u][v]);
    const int d = std::abs(a.main_direction[u] - b.main_direction[u]);
    const float w = a.contrast[u] + b.contrast[u];
    angle += w * static_cast<float>(std::min(d, kDirections - d));
    weight += w;
  }
  return histogram_weight * 0.5 * histogram + (1 - histogram_weight) * angle / (weight * (kDirections / 2));
}

double geometricInconsistency(const cv::KeyPoint& query_i, const cv::KeyPoint& view_i, const cv::KeyPoint& query_j,
                              const cv::KeyPoint& view_j) {
  const MatchFrame i(query_i, view_i), j(query_j, view_j);
  return inconsistency(i, j, j.query - i.query, j.view - i.view);
}

KvldResult filterKvld(const GradientPyramid& query_image, const GradientPyramid& view_image,
                      const std::vector<cv::KeyPoint>& query, const std::vector<cv::KeyPoint>& view,
                      const std::vector<Match>& matches, const KvldSettings& settings) {
  for (const Match& m : matches)
    if (m.query < 0 || m.query >= static_cast<int>(query.size()) || m.view < 0 ||
        m.view >= static_cast<int>(view.size()))
      throw std::invalid_argument("filterKvld: a match names a keypoint that is not there");
  std::vector<MatchFrame> frames;
  for (const Match& m : matches) frames.emplace_back(query[m.query], view[m.view]);
  const std::vector<Edge> candidates = candidateEdges(frames, settings);
  const int count = static_cast<int>(candidates.size());
  std::vector<char> consistent(candidates.size(), 0);
#pragma omp parallel for schedule(dynamic, 64)
  for (int e = 0; e < count; ++e) {
    const Match &a = matches[candidates[e].a], &b = matches[candidates[e].b];
    const LineDescriptor in_query = describeLine(query_image, query[a.query].pt, query[b.query].pt);
    const LineDescriptor in_view = describeLine(view_image, view[a.view].pt, view[b.view].pt);
    consistent[e] = lineDistance(in_query, in_view, settings.histogram_weight) <= settings.max_photometric;
  }
  std::vector<Edge> edges;
  for (int e = 0; e < count; ++e)
    if (consistent[e]) edges.push_back(candidates[e]);
  KvldResult supported = Pruning(matches, edges, settings.min_supporters).run();
  if (settings.min_order_agreement <= 0) return supported;
  const std::vector<int> ordered = OrderCheck(frames, settings.min_order_agreement).run(supported.kept);
  KvldResult result;
  for (std::size_t i = 0; i < supported.kept.size(); ++i) {
    if (!std::binary_search(ordered.begin(), ordered.end(), supported.kept[i])) continue;
    result.kept.push_back(supported.kept[i]);
    result.supporters.push_back(supported.supporters[i]);
  }
  return result;
}

}  // namespace streetview_localizer
