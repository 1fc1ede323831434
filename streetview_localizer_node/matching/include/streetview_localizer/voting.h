// Step 3 of the matching: the nearest descriptors of the whole database vote for the places they come from.
#pragma once

#include <cstdint>
#include <vector>

#include "streetview_localizer/types.h"

namespace streetview_localizer {

/// A descriptor of the database near one of the query's.
struct Neighbor {
  std::int32_t id = -1;  ///< row in the index; -1: none
  float distance = 0;    ///< as in Features
};

struct VotingSettings {
  int best = 8;               ///< places returned at most
  double max_distance = 330;  ///< farther neighbours do not vote
  double place_radius =
      2;  ///< features of the query nearer than this are one place, with one vote for each of the database's [px]
};

struct Vote {
  int place = 0;     ///< as in place_of_id
  double score = 0;  ///< sum of the weights
  int voters = 0;    ///< places of the query that voted
};

/// `neighbors[i]`: of query feature queried[i], ascending in distance, all of the same number k. `place_of_id`: the
/// panorama, or view, that each row of the index belongs to; `place_count` of them. A neighbour's weight is how much
/// nearer it is than the farthest of the k, (d_k^2 - d^2) / d_k^2 (local naive Bayes, McCann and Lowe 2012): what is
/// everywhere in the database, as the same window a hundred times, is near k times and weighs nothing, like a frequent
/// word under idf. Against bursts (Jegou, Douze and Schmid 2009): of one query feature's neighbours in one place only
/// the nearest votes, features of one place of the query have one vote for one place of the database, and n votes for
/// one and the same descriptor of the database, as from the query's own repeated windows, weigh sqrt(n) together. Best
/// first; ties by the lower place. Throws std::invalid_argument when an id has no place.
std::vector<Vote> voteForPlaces(const std::vector<std::vector<Neighbor>>& neighbors, const std::vector<int>& queried,
                                const std::vector<cv::KeyPoint>& query, const std::vector<int>& place_of_id,
                                int place_count, const VotingSettings& settings = {});

}  // namespace streetview_localizer
