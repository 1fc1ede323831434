// Relative poses from images, and what they say of poses that fit the model at a wrong place.
#include "streetview_localizer/neighbour_check.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <vector>

#include "air_ground_common/linear_algebra.h"
#include "neighbour_stage.h"
#include "relative_pose.h"
#include "synthetic_street.h"
#include "test_files.h"

namespace streetview_localizer {
namespace {

using air_ground_common::expSO3;
using air_ground_common::logSO3;
using air_ground_common::Matrix6d;
using air_ground_common::Pose;
using air_ground_common::rotationAngle;
using air_ground_common::Vector6d;
using Outcome = NeighbourOutcome::Kind;
using Verdict = NeighbourVerdict::Kind;

constexpr double kHeading = 0.4;  // of the street, from x towards y
const Eigen::Vector3d kAlong(std::cos(kHeading), std::sin(kHeading), 0);

double inPlan(const Pose& a, const Pose& b) { return (a.translation() - b.translation()).head<2>().norm(); }

/// A street with panoramas 10 m apart, each turned another way, as fine as the time of a test allows.
class PaintedStreet {
 public:
  explicit PaintedStreet(int panoramas) {
    SyntheticStreetSettings street_settings;
    street_settings.seed = 77;
    street_settings.heading = kHeading;
    street_settings.length = 80;
    street_settings.occluders = false;
    street_settings.image_width = 1536;
    street = std::make_unique<SyntheticStreet>(street_settings);
    projector = std::make_unique<BackProjector>(street->model());
    settings.views.width = 256, settings.views.height = 424;
    settings.features.double_image = true;
    std::mt19937_64 random(5);
    std::normal_distribution<double> noise(0, 0.06);
    for (int i = 0; i < panoramas; ++i) {
      Pose pose = street->panoramaPose(15 + 10.0 * i, &random);
      pose.linear() = Eigen::AngleAxisd(0.5 * i, Eigen::Vector3d::UnitZ()) * pose.linear();
      truth.push_back(pose);
      NeighbourImage image;
      image.name = "p" + std::to_string(i);
      image.load = [picture = street->render(pose)] { return picture; };
      image.T_world_image = pose;
      image.T_world_image.translation() += Eigen::Vector3d(noise(random), noise(random), noise(random));
      image.position_stddev = 0.13;
      image.orientation_stddev = 0.002;
      images.push_back(image);
    }
  }

  std::vector<NeighbourOutcome> outcomes(const std::vector<NeighbourImage>& taken) const {
    const auto edges = measureNeighbours(taken, *projector, settings, 2);
    RegistrationSettings registration;
    registration.threads = 2;
    return settleNeighbours(taken, judgeNeighbours(taken, edges, settings), street->model(), registration, settings);
  }

  std::unique_ptr<SyntheticStreet> street;
  std::unique_ptr<BackProjector> projector;
  NeighbourSettings settings;
  std::vector<Pose> truth;
  std::vector<NeighbourImage> images;
};

const PaintedStreet& sixPanoramas() {
  static const PaintedStreet street(6);
  return street;
}

TEST(RelativePose, IsThatOfTheTwoPanoramasWhereverTheFirstIsTakenToBeAlongTheStreet) {
  const PaintedStreet& s = sixPanoramas();
  const auto features = [&](int i) {
    return bearingFeaturesOf(s.images[i].load(), s.settings.views, s.settings.features);
  };
  const BearingFeatures a = features(1), b = features(2);
  const Pose expected = s.truth[1].inverse() * s.truth[2];
  const std::vector<Match> matches = matchBearings(a, b);
  for (const double off : {0.0, 1.2, -1.2}) {
    Pose T_world_a = s.truth[1];
    T_world_a.translation() += off * kAlong;
    const auto measured = measureRelativePose(a, T_world_a, b, matches, *s.projector);
    ASSERT_TRUE(measured) << off;
    EXPECT_LT((measured->T_a_b.translation() - expected.translation()).norm(), 0.3) << off;  // of 10 m
    EXPECT_LT(rotationAngle(measured->T_a_b.linear(), expected.linear()), 0.006) << off;
    EXPECT_GT(measured->inliers, 30);
    EXPECT_TRUE(air_ground_common::isPositiveDefinite(measured->covariance));
  }
}

TEST(RelativePose, TurnedRoundItIsTheInverseWithTheErrorsOfTheInverse) {
  RelativePose relative;
  relative.T_a_b.linear() = expSO3({0.2, -0.3, 1.9});
  relative.T_a_b.translation() << 8, -3, 0.5;
  Matrix6d root = Matrix6d::Random() * 0.002;
  relative.covariance = root * root.transpose();
  const RelativePose turned = inverted(relative);
  EXPECT_LT((turned.T_a_b * relative.T_a_b).translation().norm(), 1e-12);
  Matrix6d scatter = Matrix6d::Zero();
  for (int column = 0; column < 6; ++column) {  // to first order the columns of the root span the errors
    Pose wrong = relative.T_a_b;
    wrong.translation() += root.col(column).head<3>();
    wrong.linear() = expSO3(root.col(column).tail<3>()) * wrong.linear();
    const Pose T_b_a = wrong.inverse();
    Vector6d error;
    error.head<3>() = T_b_a.translation() - turned.T_a_b.translation();
    error.tail<3>() = logSO3(T_b_a.linear() * turned.T_a_b.linear().transpose());
    scatter += error * error.transpose();
  }
  EXPECT_LT((scatter - turned.covariance).norm(), 0.03 * scatter.norm());
}

TEST(NeighbourCheck, WhatIsRightStaysAsItIs) {
  const PaintedStreet& s = sixPanoramas();
  const auto outcomes = s.outcomes(s.images);
  for (std::size_t i = 0; i < outcomes.size(); ++i) {
    EXPECT_EQ(outcomes[i].kind, Outcome::kKept) << i << " " << outcomes[i].remark;
    EXPECT_TRUE(outcomes[i].T_world_image.matrix() == s.images[i].T_world_image.matrix());
    EXPECT_EQ(outcomes[i].position_stddev, 0.13);
  }
}

TEST(NeighbourCheck, OneThatStandsElsewhereIsFoundAndTheOthersStay) {
  const PaintedStreet& s = sixPanoramas();
  std::vector<NeighbourImage> images = s.images;
  images[2].T_world_image.translation() += 1.2 * kAlong;
  const auto outcomes = s.outcomes(images);
  for (std::size_t i = 0; i < outcomes.size(); ++i)
    EXPECT_EQ(outcomes[i].kind == Outcome::kKept, i != 2) << i << " " << outcomes[i].remark;
  ASSERT_TRUE(outcomes[2].kind == Outcome::kAnew || outcomes[2].kind == Outcome::kRefused);
  if (outcomes[2].kind == Outcome::kAnew) {
    EXPECT_LT(inPlan(outcomes[2].T_world_image, s.truth[2]), 0.4);
  }
  EXPECT_NE(outcomes[2].remark.find("its neighbours p"), std::string::npos) << outcomes[2].remark;
  // The street runs 23 degrees north of east, and they place it back: west or south-west.
  EXPECT_NE(outcomes[2].remark.find("west of where its outline fits"), std::string::npos) << outcomes[2].remark;
}

TEST(NeighbourCheck, BetweenTwoNobodyDecides) {
  const PaintedStreet& s = sixPanoramas();
  std::vector<NeighbourImage> images = {s.images[2], s.images[3]};
  for (const NeighbourOutcome& outcome : s.outcomes(images)) EXPECT_EQ(outcome.kind, Outcome::kKept) << outcome.remark;
  images[0].T_world_image.translation() += 1.6 * kAlong;
  const auto outcomes = s.outcomes(images);
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(outcomes[i].kind, Outcome::kDoubtful);
    EXPECT_TRUE(outcomes[i].T_world_image.matrix() == images[i].T_world_image.matrix());
    EXPECT_GT(outcomes[i].position_stddev, 0.8);
    EXPECT_LT(outcomes[i].position_stddev, 1.5);
    EXPECT_NE(outcomes[i].remark.find("which is right cannot be told"), std::string::npos);
  }
  images[1].fixed = true;  // stored: a witness, no more
  const auto beside_stored = s.outcomes(images);
  EXPECT_EQ(beside_stored[0].kind, Outcome::kDoubtful);
  EXPECT_EQ(beside_stored[1].kind, Outcome::kKept);
}

TEST(NeighbourCheck, WhatTheRegistrationRefusedIsRegisteredWhereItsNeighboursPlaceIt) {
  const PaintedStreet& s = sixPanoramas();
  std::vector<NeighbourImage> images = s.images;
  images[3].registered = false;
  images[3].T_world_image.translation() += 4 * kAlong;
  images[3].position_stddev = 3;
  const auto outcomes = s.outcomes(images);
  EXPECT_EQ(outcomes[2].kind, Outcome::kKept);
  ASSERT_EQ(outcomes[3].kind, Outcome::kGained);
  EXPECT_LT(inPlan(outcomes[3].T_world_image, s.truth[3]), 0.4);
  EXPECT_LT(outcomes[3].position_stddev, 0.5);
}

TEST(NeighbourStage, TakesTheConclusionsOverIntoTheBuildAndLeavesWhatIsStored) {
  const PaintedStreet& s = sixPanoramas();
  TemporaryFolder folder;
  std::vector<BuildItem> items;
  for (int i = 1; i < 4; ++i) {
    BuildItem item;
    item.path = folder / (s.images[i].name + ".png");
    cv::imwrite(item.path, s.images[i].load());
    item.panorama.id = s.images[i].name;
    item.panorama.registered = true;
    item.panorama.T_world_geotag.translation() = s.truth[i].translation() + Eigen::Vector3d(3, 2, 0);
    item.panorama.T_world_panorama = s.images[i].T_world_image;
    item.panorama.position_stddev = 0.13, item.panorama.orientation_stddev = 0.002;
    items.push_back(item);
  }
  items[1].panorama.T_world_panorama.translation() += 1.2 * kAlong;
  const std::vector<BuildItem> before = items;
  BuildSettings settings;
  settings.neighbours = s.settings;
  settings.threads = 2;
  BuildReport report;
  int stored = 1;
  const auto compare = [&] {
    items = before;
    report = BuildReport();
    compareNeighbours(
        settings, *s.projector,
        [&](const BuildItem& item) { return stored >= 0 && item.panorama.id == before[stored].panorama.id; },
        [](const std::string&, int done, int all) { EXPECT_LE(done, all); }, &items, &report);
  };
  const auto unchanged = [&](int i) {
    return items[i].panorama.T_world_panorama.matrix() == before[i].panorama.T_world_panorama.matrix() &&
           items[i].panorama.registered && items[i].panorama.remark.empty();
  };
  compare();
  EXPECT_TRUE(unchanged(1));
  stored = -1;
  compare();
  EXPECT_GE(report.neighbour_pairs, 2);  // the one in the middle with both
  EXPECT_TRUE(unchanged(0) && unchanged(2));
  const Panorama& p = items[1].panorama;
  if (p.registered) {
    EXPECT_LT(inPlan(p.T_world_panorama, s.truth[2]), 0.4);
    ASSERT_EQ(report.corrected_anew.size(), 1u);
    EXPECT_EQ(report.corrected_anew[0].image, "p2");
  } else {
    EXPECT_EQ(p.remark.find("pose not corrected: its neighbours p1, p3 place it 1."), 0u) << p.remark;
    EXPECT_TRUE(p.T_world_panorama.matrix() == p.T_world_geotag.matrix());
    EXPECT_GT(p.position_stddev, 2);
  }
  settings.check_neighbours = false;
  compare();
  EXPECT_TRUE(unchanged(1));
}

/// A row of images 10 m apart, and the relative poses of each with so many before it, without any pictures.
class Row {
 public:
  explicit Row(int count, int reach = 2) {
    for (int i = 0; i < count; ++i) {
      NeighbourImage image;
      image.T_world_image = air_ground_common::yawPose(0.3 * i, Eigen::Vector3d(10.0 * i, 0, 2));
      image.position_stddev = 0.13, image.orientation_stddev = 0.002;
      images.push_back(image);
      for (int j = std::max(0, i - reach); j < i; ++j)
        edges.push_back({j, i, images[j].T_world_image.inverse() * image.T_world_image, Matrix6d::Identity() * 1e-6});
    }
  }
  std::vector<Verdict> verdicts() const {
    std::vector<Verdict> kinds;
    for (const NeighbourVerdict& v : judgeNeighbours(images, edges, {})) kinds.push_back(v.kind);
    return kinds;
  }
  std::vector<NeighbourImage> images;
  std::vector<NeighbourEdge> edges;
};

constexpr Verdict kFine = Verdict::kUnopposed, kWrong = Verdict::kContradicted, kDoubt = Verdict::kDoubtful;

TEST(NeighbourVote, TheOneThatMostContradictIsWrongAlsoAtTheEnd) {
  Row row(6);
  EXPECT_EQ(row.verdicts(), std::vector<Verdict>(6, kFine));
  for (int wrong = 0; wrong < 6; ++wrong) {
    Row moved = row;
    moved.images[wrong].T_world_image.translation().x() += 1.2;
    std::vector<Verdict> expected(6, kFine);
    expected[wrong] = kWrong;
    EXPECT_EQ(moved.verdicts(), expected) << wrong;
    const NeighbourVerdict verdict = judgeNeighbours(moved.images, moved.edges, {})[wrong];
    EXPECT_LT(inPlan(verdict.T_world_image, row.images[wrong].T_world_image), 1e-9);
    EXPECT_LT(rotationAngle(verdict.T_world_image.linear(), row.images[wrong].T_world_image.linear()), 1e-9);
  }
  row.images[2].T_world_image.linear() = expSO3({0, 0, 0.03}) * row.images[2].T_world_image.linear();
  EXPECT_EQ(row.verdicts()[2], kWrong);  // by its heading alone
}

TEST(NeighbourVote, TwoWrongOnesSideBySideAreFound) {
  Row row(8);
  for (const int wrong : {3, 4})
    row.images[wrong].T_world_image.translation().x() += 1.5;  // the same facade's next row of windows
  const auto kinds = row.verdicts();
  for (int i = 0; i < 8; ++i) EXPECT_EQ(kinds[i] == kWrong, i == 3 || i == 4) << i;
}

TEST(NeighbourVote, ARightOneBetweenTwoWrongOnesIsNotRefused) {
  Row row(7, 1);
  for (const int wrong : {2, 4}) row.images[wrong].T_world_image.translation().x() += 1.5;
  EXPECT_EQ(row.verdicts()[3], kDoubt);  // its neighbours agree, but others contradict them
  // Moved in different ways they do not agree, and are found.
  row.images[4].T_world_image.translation().x() -= 3;
  for (int i = 0; i < 7; ++i) EXPECT_EQ(row.verdicts()[i], i == 2 || i == 4 ? kWrong : kFine) << i;
}

TEST(NeighbourVote, OneWrongMeasurementDoesNothing) {
  Row row(6);
  row.edges[4].T_a_b.translation().x() += 3;  // a shift by a window
  EXPECT_EQ(row.verdicts(), std::vector<Verdict>(6, kFine));
}

TEST(NeighbourVote, HalfAgainstHalfIsDoubted) {
  Row row(4);
  for (const int other : {2, 3}) row.images[other].T_world_image.translation().x() += 1.5;
  for (const Verdict kind : row.verdicts()) EXPECT_NE(kind, kWrong);
  EXPECT_EQ(row.verdicts()[1], kDoubt);
  // Small differences are no contradiction.
  Row small(2);
  small.images[1].T_world_image.translation().x() += 0.45;
  EXPECT_EQ(small.verdicts(), std::vector<Verdict>(2, kFine));
}

}  // namespace
}  // namespace streetview_localizer
