// The three kinds of index; built new, or from a data file when `data_path` is not empty.
#pragma once

#include <memory>
#include <string>

#include "streetview_localizer/descriptor_index.h"

namespace streetview_localizer {

std::unique_ptr<DescriptorIndex> makeBruteForceIndex(const cv::Mat& descriptors, const IndexSettings& settings);
std::unique_ptr<DescriptorIndex> makeFlannIndex(const cv::Mat& descriptors, const IndexSettings& settings,
                                                const std::string& data_path);
std::unique_ptr<DescriptorIndex> makeHnswIndex(const cv::Mat& descriptors, const IndexSettings& settings,
                                               const std::string& data_path);

}  // namespace streetview_localizer
