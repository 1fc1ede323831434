// Pictures for the street world: facades with what makes each of them different, panes, signs, road, cars, people.
#pragma once

#include <opencv2/core/mat.hpp>

#include "air_ground_sim/street/street.h"

namespace air_ground_sim {

/// All pictures: CV_8UC3, R G B, row 0 at the top, `texel` [m] a pixel. The same arguments give the same picture.
cv::Mat paintFacade(const Building& building, Season season, double texel);

/// The pane of opening `index` of a building: frame, glass with what it mirrors, curtains or goods, a door's leaf.
cv::Mat paintPane(const Building& building, int index, Season season, double texel);

/// The underside and sides of reveals, balconies and ledges.
cv::Mat paintPlain(const cv::Vec3f& color, double width, double height, double texel, std::uint64_t seed);

/// Lettering over a shop; `blade`: the small sign that stands off the wall.
cv::Mat paintSign(const Building& building, int shop, bool blade, double width, double height, double texel);

/// Front of a balcony: bars, panel or wickerwork, and flower boxes in summer.
cv::Mat paintRailing(const Building& building, int index, Season season, double width, double height, double texel);

cv::Mat paintAwning(const Building& building, int shop, double width, double height, double texel);

cv::Mat paintRoof(const Building& building, double width, double height, double texel);

/// Road, kerb, sidewalk and what lies behind, over a patch of terrain.
cv::Mat paintGround(const Street& street, const Patch& patch, Season season);

/// Side of a car's body or cabin, of clothes, bark, leaves.
enum class Thing { kCarBody, kCarGlass, kClothes, kSkin, kBark, kLeaves };
cv::Mat paintThing(Thing thing, std::uint64_t seed, Season season, double width, double height, double texel);

/// Colour of the walls, for parts that are not on the facade.
cv::Vec3f wallColor(const Building& building);
cv::Vec3f trimColor(const Building& building);

/// Sky over the hemisphere: direction d at ((a + 1) / 2, (b + 1) / 2), (a, b) = (dx, dy) / (|dx| + |dy| + |dz|).
cv::Mat paintSky(Season season, std::uint64_t seed);

}  // namespace air_ground_sim
