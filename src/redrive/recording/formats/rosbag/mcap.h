// SPDX-License-Identifier: Apache-2.0
// Files in MCAP (https://mcap.dev/spec): records with an opcode and a length; messages in chunks,
// which may be LZ4 or Zstandard; and a summary at the end, which a recorder that crashed did not
// write.
#pragma once

#include <filesystem>
#include <memory>

#include "redrive/base/files/byte_source.h"
#include "redrive/recording/formats/rosbag/bag.h"

namespace redrive::rosbag {

/// Opens by the summary and the indices of messages. Without a summary all records are walked, and
/// a finding says what is cut off. InputError, which names `path`: no MCAP, an impossible length, a
/// compression that is not known.
std::unique_ptr<BagFile> open_mcap(std::unique_ptr<ByteSource> bytes,
                                   const std::filesystem::path& path);

}  // namespace redrive::rosbag
