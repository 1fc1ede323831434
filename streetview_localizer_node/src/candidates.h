// From matches of an image with views of the database to poses, each judged on its own.
#pragma once

#include <numeric>
#include <string>
#include <vector>

#include "streetview_localizer/localizer.h"

namespace streetview_localizer {

/// Matches of the query with one view.
struct ViewMatches {
  int view = 0;
  std::vector<Match> matches;   // that survived k-VLD
  std::vector<int> supporters;  // of each
  std::vector<Match> dropped;   // by k-VLD: evidence against a pose
};

/// Matches with panoramas whose points may be used as one.
struct Group {
  std::vector<ViewMatches> parts;
  int size() const {
    return std::accumulate(parts.begin(), parts.end(), 0,
                           [](int n, const ViewMatches& p) { return n + static_cast<int>(p.matches.size()); });
  }
};

/// A pose, its verdict, and the matches behind it.
struct Candidate {
  PoseResult pose;
  Acceptance acceptance;
  std::vector<Correspondence> correspondences;
  std::vector<int> views;
  std::size_t kept = 0;  // the first correspondences; k-VLD dropped the others
  int panorama = -1, view = -1;
};

/// Thread-safe.
class CandidateFinder {
 public:
  /// All must outlive it.
  CandidateFinder(const StreetviewDatabase& database, const BackProjector& projector,
                  const StreetviewLocalizerSettings& settings)
      : database_(database), projector_(projector), settings_(settings) {}

  /// One for each group of `parts`, the largest first.
  std::vector<Candidate> find(std::vector<ViewMatches> parts, const Features& query, const CameraModel& camera,
                              const PosePrior& prior) const;

 private:
  std::vector<Group> grouped(std::vector<ViewMatches> parts) const;
  Candidate locate(const Group& group, const Features& query, const CameraModel& camera, const PosePrior& prior) const;
  std::vector<ViewRay> gather(const Group& group, const Features& query, Candidate* c) const;
  PointSource sourceOf(int panorama) const;
  void refine(const CameraModel& camera, const PosePrior& prior, const std::vector<ViewRay>& rays, Candidate* c) const;
  std::string againstModel(const Candidate& c) const;

  const View& view(int index) const { return database_.views[static_cast<std::size_t>(index)]; }
  const Panorama& panorama(int index) const { return database_.panoramas[static_cast<std::size_t>(index)]; }

  const StreetviewDatabase& database_;
  const BackProjector& projector_;
  const StreetviewLocalizerSettings& settings_;
};

}  // namespace streetview_localizer
