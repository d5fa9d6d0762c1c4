// SPDX-License-Identifier: Apache-2.0
// Images of sensor_msgs/Image as PPM (image/ppm.h), which read_image takes.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "redrive/recording/formats/rosbag/messages.h"

namespace redrive::rosbag {

/// Whether as_ppm takes pixels of an encoding (sensor_msgs/image_encodings.hpp): 8 bits a channel,
/// colour, grey, Bayer patterns, YUV 4:2:2.
bool is_known_encoding(const std::string& encoding);

/// Bytes that as_ppm returns. The encoding must be known.
std::uint64_t ppm_bytes(const ImageMessage& image);

/// Converts, up to the first `most` bytes; colours of a Bayer pattern are interpolated, YUV is
/// BT.601. InputError, which names `file`: the data does not fit the size.
std::string as_ppm(const ImageMessage& image, std::size_t most, const std::filesystem::path& file);

}  // namespace redrive::rosbag
