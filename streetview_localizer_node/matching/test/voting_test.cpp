#include "streetview_localizer/voting.h"

#include <gtest/gtest.h>

#include <random>
#include <stdexcept>

namespace streetview_localizer {
namespace {

/// Four places with 100 descriptors each; 50 query features far apart.
class VotingTest : public ::testing::Test {
 protected:
  VotingTest() {
    for (int id = 0; id < 400; ++id) place_of_id_.push_back(id / 100);
    for (int i = 0; i < 50; ++i) {
      query_.emplace_back(20.f * static_cast<float>(i % 10), 20.f * static_cast<float>(i / 10), 5.f);
      queried_.push_back(i);
      neighbors_.emplace_back();
    }
  }

  std::vector<Vote> vote() const { return voteForPlaces(neighbors_, queried_, query_, place_of_id_, 4); }

  std::vector<int> place_of_id_, queried_;
  std::vector<cv::KeyPoint> query_;
  std::vector<std::vector<Neighbor>> neighbors_;
};

TEST_F(VotingTest, DistinctNeighborsBeatMoreAmbiguousOnes) {
  // 20 features have one clear neighbour in place 2; 30 have five equal ones, in place 1 and elsewhere.
  for (int i = 0; i < 50; ++i) {
    if (i < 20)
      neighbors_[i] = {{200 + i, 100.f}, {300 + i, 290.f}, {100 + i, 300.f}};
    else
      neighbors_[i] = {{100 + i, 200.f}, {i, 203.f}, {300 + i, 205.f}};
  }
  const auto votes = vote();
  ASSERT_GE(votes.size(), 2u);
  EXPECT_EQ(votes[0].place, 2);
  EXPECT_EQ(votes[0].voters, 20);
  EXPECT_NEAR(votes[0].score, 20 * (1 - 1. / 9), 1e-5);
  EXPECT_GT(votes[0].score, 5 * votes[1].score);
}

TEST_F(VotingTest, ManyVotesForOneDescriptorAreABurst) {
  // 30 repeated windows of the query all find descriptor 150 of place 1; 10 features find ten of place 3.
  for (int i = 0; i < 50; ++i) {
    if (i < 30)
      neighbors_[i] = {{150, 100.f}, {20, 300.f}};
    else if (i < 40)
      neighbors_[i] = {{300 + i, 100.f}, {20, 300.f}};
    else
      neighbors_[i] = {{10, 400.f}, {20, 410.f}};  // too far to vote
  }
  const auto votes = vote();
  ASSERT_EQ(votes[0].place, 3);
  EXPECT_EQ(votes[1].place, 1);
  EXPECT_NEAR(votes[1].score / votes[0].score, std::sqrt(30.) / 10, 1e-5);
}

TEST_F(VotingTest, OnePlaceOfTheQueryHasOneVoteForOnePlace) {
  // The features of the first row, moved to one point (as from ten virtual views), find ten descriptors of place 0.
  for (int i = 0; i < 10; ++i) {
    query_[i].pt = cv::Point2f(5.f + 0.1f * static_cast<float>(i), 5.f);
    neighbors_[i] = {{i, 100.f + static_cast<float>(i)}, {i + 10, 150.f}, {399, 300.f}};
  }
  for (int i = 10; i < 12; ++i) neighbors_[i] = {{100 + i, 100.f}, {399, 300.f}};
  const auto votes = vote();
  ASSERT_EQ(votes[0].place, 1);
  EXPECT_EQ(votes[0].voters, 2);
  EXPECT_EQ(votes[1].place, 0);
  EXPECT_EQ(votes[1].voters, 1);
  EXPECT_NEAR(votes[1].score, 1 - 1. / 9, 1e-5);
}

TEST_F(VotingTest, TakesTheTruePlaceFromNoise) {
  std::mt19937 random(1);
  std::uniform_int_distribution<int> any(0, 399);
  std::uniform_real_distribution<float> near(120, 200), far(250, 320);
  for (int i = 0; i < 50; ++i) {
    for (int k = 0; k < 5; ++k) neighbors_[i].push_back({any(random), far(random)});
    if (i % 5 == 0) neighbors_[i][0] = {200 + i, near(random)};
    std::sort(neighbors_[i].begin(), neighbors_[i].end(),
              [](const Neighbor& a, const Neighbor& b) { return a.distance < b.distance; });
  }
  EXPECT_EQ(vote()[0].place, 2);
}

TEST_F(VotingTest, RefusesIdsWithoutPlaceAndAcceptsNothing) {
  EXPECT_TRUE(vote().empty());
  neighbors_[0] = {{400, 100.f}, {1, 200.f}};
  EXPECT_THROW(vote(), std::invalid_argument);
}

}  // namespace
}  // namespace streetview_localizer
