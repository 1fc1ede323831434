#include "streetview_localizer/recent_cache.h"

#include <gtest/gtest.h>

#include <atomic>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace streetview_localizer {
namespace {

std::size_t bytesOf(const std::string& text) { return text.size(); }

TEST(RecentCache, KeepsWhatWasAskedForLastWithinItsBytes) {
  RecentCache<std::string> cache(10, bytesOf);
  std::vector<int> made;
  const auto get = [&](int number, std::size_t size) {
    return cache.get(number, [&] {
      made.push_back(number);
      return std::string(size, static_cast<char>('a' + number));
    });
  };
  get(0, 4), get(1, 4), get(0, 4);
  EXPECT_EQ(get(2, 4), "cccc");  // and 1 has to go
  get(0, 4), get(2, 4), get(1, 4);
  EXPECT_EQ(made, (std::vector<int>{0, 1, 2, 1}));
  EXPECT_EQ(get(3, 100), std::string(100, 'd'));
  get(3, 100);
  EXPECT_EQ(made.back(), 3) << "too large, but all there is";
  get(1, 4);
  EXPECT_EQ(made, (std::vector<int>{0, 1, 2, 1, 3, 1}));
}

TEST(RecentCache, WhatCannotBeMadeIsAskedForAgain) {
  RecentCache<std::string> cache(10, bytesOf);
  const auto fails = []() -> std::string { throw std::runtime_error("unreadable"); };
  EXPECT_THROW(cache.get(0, fails), std::runtime_error);
  EXPECT_EQ(cache.get(0, [] { return std::string("read"); }), "read");
}

TEST(RecentCache, ThreadsGetOneThing) {
  RecentCache<std::string> cache(1000, bytesOf);
  std::atomic<int> inside{0}, kept{0};
  const auto ask = [&](char letter) {
    return cache.get(0, [&] {
      ++inside;
      while (inside < 2) std::this_thread::yield();  // both make one
      return std::string(1, letter);
    });
  };
  std::string a, b;
  std::thread first([&] { a = ask('a'); }), second([&] { b = ask('b'); });
  first.join();
  second.join();
  EXPECT_EQ(a, b);
  EXPECT_EQ(cache.get(0, [&] { return ++kept, std::string("c"); }), a);
  EXPECT_EQ(kept, 0);
}

}  // namespace
}  // namespace streetview_localizer
