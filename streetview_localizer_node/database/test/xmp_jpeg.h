// JPEGs with XMP, as cameras of panoramas write them, and with an EXIF orientation, as telephones do.
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

/// A JPEG with this orientation (1 to 8) in its EXIF and nothing else.
inline std::string withOrientation(const std::vector<uchar>& jpeg, int orientation) {
  const char entries[] = "II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0";  // one, tag 0x112, a short
  std::string exif = std::string("Exif\0\0", 6) + std::string(entries, sizeof(entries) - 1);
  exif += static_cast<char>(orientation) + std::string(7, '\0');  // its value, no further directory
  const std::size_t length = exif.size() + 2;
  return std::string("\xFF\xD8\xFF\xE1") + static_cast<char>(length >> 8) + static_cast<char>(length & 255) + exif +
         std::string(jpeg.begin() + 2, jpeg.end());
}

}  // namespace streetview_localizer
