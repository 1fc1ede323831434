#include "dense_fusion/field_memory.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <random>
#include <vector>

#include "dense_fusion/field.h"

namespace dense_fusion {
namespace {

constexpr std::size_t kPage = FieldMemory::kPage;

TEST(FieldMemory, WhatIsGivenBackServesTheNext) {
  FieldMemory memory;
  void* first = memory.take(10 * kPage);
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(first) % kPage, 0u);
  memory.giveBack(first);
  void* smaller = memory.take(8 * kPage - 100);
  EXPECT_EQ(smaller, first);
  EXPECT_NE(memory.take(8 * kPage), first) << "it is in use";
  memory.giveBack(smaller);
  EXPECT_EQ(memory.take(5 * kPage), first);
}

TEST(FieldMemory, SmallOnesLeaveLargeBlocksToOthers) {
  FieldMemory memory;
  void* large = memory.take(10 * kPage);
  memory.giveBack(large);
  EXPECT_NE(memory.take(2 * kPage), large);
}

TEST(FieldMemory, HoldsWhatWasOnceInUse) {
  std::mt19937 random(3);
  for (int trial = 0; trial < 20; ++trial) {
    FieldMemory memory;
    struct Taken {
      char* at;
      std::size_t bytes;
      char mark;
    };
    std::vector<Taken> taken;
    std::size_t used = 0, most = 0;
    for (int i = 0; i < 300; ++i) {
      if (taken.size() < 6 && random() % 2 == 0) {
        const std::size_t bytes = (1 + random() % 9) * kPage;
        char* at = static_cast<char*>(memory.take(bytes));
        const char mark = static_cast<char>(i);
        at[0] = at[bytes - 1] = mark;
        taken.push_back({at, bytes, mark});
        most = std::max(most, used += bytes);
      } else if (!taken.empty()) {
        std::swap(taken[random() % taken.size()], taken.back());
        EXPECT_EQ(taken.back().at[0], taken.back().mark) << "another's";
        EXPECT_EQ(taken.back().at[taken.back().bytes - 1], taken.back().mark) << "another's";
        memory.giveBack(taken.back().at);
        used -= taken.back().bytes;
        taken.pop_back();
      }
      ASSERT_LE(memory.held(), 2 * most);
    }
  }
}

TEST(FieldMemory, FieldsLiveInIt) {
  const std::size_t before = fieldMemory().held();
  const float* first;
  {
    Field<float> field(3 * kPage, 1.f);
    first = field.data();
    EXPECT_GT(fieldMemory().held(), before);
  }
  const Field<float> next(3 * kPage, 2.f);
  EXPECT_EQ(next.data(), first);
  EXPECT_EQ(*std::max_element(next.begin(), next.end()), 2.f);
}

}  // namespace
}  // namespace dense_fusion
