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

/// A JPEG whose EXIF has one tag, of a value below 256, and nothing else.
inline std::string withExifTag(const std::vector<uchar>& jpeg, int tag, int value) {
  std::string exif = std::string("Exif\0\0II*\0\x08\0\0\0\x01\0", 16);  // a directory of one
  exif += static_cast<char>(tag & 255);
  exif += static_cast<char>(tag >> 8);
  exif += std::string("\x03\0\x01\0\0\0", 6) + static_cast<char>(value) + std::string(7, '\0');  // one short
  const std::size_t length = exif.size() + 2;
  return std::string("\xFF\xD8\xFF\xE1") + static_cast<char>(length >> 8) + static_cast<char>(length & 255) + exif +
         std::string(jpeg.begin() + 2, jpeg.end());
}

/// With this orientation (1 to 8).
inline std::string withOrientation(const std::vector<uchar>& jpeg, int orientation) {
  return withExifTag(jpeg, 0x112, orientation);
}

}  // namespace streetview_localizer
