#include "streetview_localizer/voting.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>
#include <unordered_map>
#include <utility>

namespace streetview_localizer {
namespace {

/// Numbers the query's places: features within the radius of an earlier one share its number.
std::vector<int> groupByPlace(const std::vector<int>& queried, const std::vector<cv::KeyPoint>& query, double radius) {
  std::unordered_map<std::int64_t, std::vector<int>> cells;  // of first features
  const auto cell = [&](float x) { return static_cast<std::int64_t>(std::floor(x / std::max(radius, 1e-3))); };
  const auto key = [](std::int64_t x, std::int64_t y) { return y * (std::int64_t{1} << 32) + x; };
  std::vector<int> group(queried.size(), -1);
  for (int i = 0; i < static_cast<int>(queried.size()); ++i) {
    const cv::Point2f p = query.at(queried[i]).pt;
    for (int dy = -1; dy <= 1 && group[i] < 0; ++dy)
      for (int dx = -1; dx <= 1 && group[i] < 0; ++dx) {
        const auto found = cells.find(key(cell(p.x) + dx, cell(p.y) + dy));
        if (found == cells.end()) continue;
        for (int first : found->second)
          if (group[i] < 0 && cv::norm(query[queried[first]].pt - p) <= radius) group[i] = first;
      }
    if (group[i] >= 0) continue;
    group[i] = i;
    cells[key(cell(p.x), cell(p.y))].push_back(i);
  }
  return group;
}

struct Ballot {
  double weight = 0;
  std::int32_t id = -1;
};

}  // namespace

std::vector<Vote> voteForPlaces(const std::vector<std::vector<Neighbor>>& neighbors, const std::vector<int>& queried,
                                const std::vector<cv::KeyPoint>& query, const std::vector<int>& place_of_id,
                                int place_count, const VotingSettings& settings) {
  if (neighbors.size() != queried.size())
    throw std::invalid_argument("voteForPlaces: one list of neighbours a queried feature is needed");
  const std::vector<int> group = groupByPlace(queried, query, settings.place_radius);
  std::map<std::pair<int, int>, Ballot> ballots;  // by place of the query and of the database
  for (std::size_t i = 0; i < neighbors.size(); ++i) {
    const std::vector<Neighbor>& list = neighbors[i];
    if (list.size() < 2 || list.back().id < 0 || list.back().distance <= 0) continue;
    const double farthest = list.back().distance * list.back().distance;
    for (const Neighbor& n : list) {
      if (n.distance > settings.max_distance) break;
      if (n.id < 0 || n.id >= static_cast<int>(place_of_id.size()) || place_of_id[n.id] < 0 ||
          place_of_id[n.id] >= place_count)
        throw std::invalid_argument("voteForPlaces: the index and the list of places do not belong together");
      const double weight = 1 - n.distance * n.distance / farthest;
      Ballot& ballot = ballots[{group[i], place_of_id[n.id]}];
      if (weight > ballot.weight) ballot = {weight, n.id};
    }
  }
  std::unordered_map<std::int32_t, int> votes_of_id;
  for (const auto& [pair, ballot] : ballots)
    if (ballot.id >= 0) ++votes_of_id[ballot.id];
  std::vector<Vote> votes(place_count);
  for (int p = 0; p < place_count; ++p) votes[p].place = p;
  for (const auto& [pair, ballot] : ballots) {
    if (ballot.id < 0) continue;
    votes[pair.second].score += ballot.weight / std::sqrt(static_cast<double>(votes_of_id[ballot.id]));
    ++votes[pair.second].voters;
  }
  votes.erase(std::remove_if(votes.begin(), votes.end(), [](const Vote& v) { return v.voters == 0; }), votes.end());
  const auto better = [](const Vote& a, const Vote& b) {
    return a.score != b.score ? a.score > b.score : a.place < b.place;
  };
  std::sort(votes.begin(), votes.end(), better);
  if (static_cast<int>(votes.size()) > settings.best) votes.resize(std::max(0, settings.best));
  return votes;
}

}  // namespace streetview_localizer
