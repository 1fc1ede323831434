// JPEGs with XMP, as cameras of panoramas write them.
#pragma once

#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "air_ground_common/text.h"

namespace streetview_localizer {

/// What stands around the properties of Google's panoramas (Photo Sphere XMP); attributes go right behind kXmpBegin.
constexpr char kXmpBegin[] =
    "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\"><rdf:RDF xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\">"
    "<rdf:Description xmlns:GPano=\"http://ns.google.com/photos/1.0/panorama/\"";
constexpr char kXmpEnd[] = "</rdf:RDF></x:xmpmeta>";

/// A grey image with this packet in its APP1 segment.
inline std::string jpegWithXmp(const cv::Size& size, const std::string& packet) {
  std::vector<uchar> jpeg;
  cv::imencode(".jpg", cv::Mat(size, CV_8UC1, cv::Scalar(90)), jpeg);
  const std::string xmp = "http://ns.adobe.com/xap/1.0/" + std::string(1, '\0') + packet;
  const std::size_t length = xmp.size() + 2;
  return std::string("\xFF\xD8\xFF\xE1") + static_cast<char>(length >> 8) + static_cast<char>(length & 255) + xmp +
         std::string(jpeg.begin() + 2, jpeg.end());
}

/// One that says of itself which part of a sphere it shows.
inline std::string panoramaJpeg(const cv::Size& size, const cv::Size& cropped, const cv::Size& full) {
  return jpegWithXmp(size, kXmpBegin +
                               air_ground_common::formatted(
                                   " GPano:CroppedAreaImageWidthPixels=\"%d\" GPano:CroppedAreaImageHeightPixels=\"%d\""
                                   " GPano:FullPanoWidthPixels=\"%d\" GPano:FullPanoHeightPixels=\"%d\"/>",
                                   cropped.width, cropped.height, full.width, full.height) +
                               kXmpEnd);
}

}  // namespace streetview_localizer
