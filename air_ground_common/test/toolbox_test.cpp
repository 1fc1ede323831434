#include <gtest/gtest.h>

#include <thread>

#include "air_ground_common/niceness.h"
#include "air_ground_common/statistics.h"
#include "air_ground_common/text.h"

namespace air_ground_common {
namespace {

TEST(Statistics, QuantilesAreOrderStatistics) {
  const std::vector<double> values{7, 1, 9, 3, 5};
  EXPECT_EQ(quantile(values, 0), 1);
  EXPECT_EQ(quantile(values, 0.25), 3);
  EXPECT_EQ(median(values), 5);
  EXPECT_EQ(quantile(values, 0.9), 9);  // rank 3.6
  EXPECT_EQ(quantile(values, 1), 9);
  EXPECT_EQ(median(std::vector<float>{4, 1, 3, 2}), 3);
  EXPECT_EQ(median(std::vector<float>{2}), 2);
  EXPECT_TRUE(std::isnan(median(std::vector<double>{})));
}

TEST(Niceness, IsOfTheThreadAndThoseThatItStarts) {
  const auto own = [] { return getpriority(PRIO_PROCESS, 0); };
  const int before = own();
  int given = 0, inherited = 0, within = 0;
  std::thread([&] {
    air_ground_common::giveWay(0);
    EXPECT_EQ(own(), before);
    air_ground_common::giveWay(17);
    given = own();
    std::thread([&] { inherited = own(); }).join();
  }).join();
  std::thread([&] {
    air_ground_common::giveWayWithin(12);
    within = own();
  }).join();
  EXPECT_EQ(within, 12);
  EXPECT_EQ(given, 17);
  EXPECT_EQ(inherited, 17);
  EXPECT_EQ(own(), before);
}

TEST(Text, IsFormattedWhateverItsLength) {
  EXPECT_EQ(formatted("%s: %.2f m, %zu of %d", "end", 1.005, std::size_t{3}, -4), "end: 1.00 m, 3 of -4");
  EXPECT_EQ(formatted("%s", std::string(5000, 'x').c_str()), std::string(5000, 'x'));
  EXPECT_EQ(formatted("%s", ""), "");
}

}  // namespace
}  // namespace air_ground_common
