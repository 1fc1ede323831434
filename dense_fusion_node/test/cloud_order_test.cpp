#include "dense_fusion/cloud_order.h"

#include <gtest/gtest.h>

#include <string>

namespace dense_fusion {
namespace {

using Order = CloudOrder<std::string>;
using Clouds = std::vector<std::string>;

TEST(CloudOrder, NewCloudsGoOutAtOnce) {
  Order order;
  EXPECT_FALSE(order.welcome()) << "there is nothing that a first subscriber could have missed";
  order.served();
  order.add(10, "a");
  EXPECT_EQ(order.due(1), Clouds{"a"});
  EXPECT_EQ(order.due(1), Clouds{}) << "twice";
}

TEST(CloudOrder, WhatIsKeptGoesBeforeWhatIsNew) {
  Order order;
  order.add(10, "a");
  order.add(20, "b");
  EXPECT_EQ(order.due(0), (Clouds{"a", "b"}));
  order.add(30, "c");
  EXPECT_EQ(order.due(1), Clouds{}) << "it has the connection, but has not been served";
  const auto share = order.welcome();
  ASSERT_TRUE(share);
  EXPECT_EQ(share->first, 10);
  EXPECT_EQ(share->last, 20) << "what waits for all comes with them";
  order.add(40, "d");
  EXPECT_EQ(order.due(1), Clouds{}) << "it is being served";
  EXPECT_TRUE(order.stands(*share));
  order.served();
  EXPECT_EQ(order.due(2), Clouds{}) << "another has come meanwhile";
  EXPECT_EQ(order.welcome()->last, 20);
  order.served();
  EXPECT_EQ(order.due(2), (Clouds{"c", "d"}));
  EXPECT_EQ(order.welcome()->last, 40);
}

TEST(CloudOrder, WhoLeavesHoldsNobodyUp) {
  Order order;
  order.welcome();
  order.served();
  order.left();
  order.add(10, "a");
  EXPECT_EQ(order.due(1), Clouds{}) << "another, that has not been served";
  EXPECT_EQ(order.due(0), Clouds{"a"});
}

TEST(CloudOrder, NothingOfAMapThatHasEnded) {
  Order order;
  order.add(10, "a");
  order.due(0);
  const auto share = order.welcome();
  order.add(20, "b");
  order.startMap();
  EXPECT_FALSE(order.stands(*share));
  order.served();
  EXPECT_EQ(order.due(1), Clouds{});
  EXPECT_FALSE(order.welcome());
  order.served();
  order.add(5, "c");
  EXPECT_EQ(order.due(2), Clouds{"c"});
  EXPECT_EQ(order.welcome()->first, 5);
}

}  // namespace
}  // namespace dense_fusion
