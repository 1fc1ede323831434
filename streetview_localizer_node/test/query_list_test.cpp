#include "../tools/query_list.h"

#include <gtest/gtest.h>

#include <stdexcept>

#include "test_files.h"

namespace streetview_localizer {
namespace {

TEST(QueryList, AListOfCalibrationsIsAChoiceOfImages) {
  const TemporaryFolder folder;
  for (const char* name : {"b.JPG", "a.png", "c.jpeg", "notes.txt"}) folder.write(name, "");
  EXPECT_EQ(listImages(folder / ""), (std::vector<std::string>{"a.png", "b.JPG", "c.jpeg"}));
  const std::string list = folder.write("cameras.csv", "image fx fy cx cy\nc.jpeg 500 501 320 240\na.png,1,2,3,4\n");
  EXPECT_EQ(listCalibratedImages(folder / "", readCameraList(list), list),
            (std::vector<std::string>{"a.png", "c.jpeg"}));
  const std::string others = folder.write("others.csv", "d.jpg 500 500 320 240\n");
  EXPECT_EQ(messageOf([&] { listCalibratedImages(folder / "", readCameraList(others), others); }),
            "no image of " + (folder / "") + " is listed in " + others);
}

}  // namespace
}  // namespace streetview_localizer
