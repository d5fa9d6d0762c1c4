// SPDX-License-Identifier: Apache-2.0
// TFRecord files of TensorFlow: records of u64 length, u32 checksum of the length, the bytes and
// u32 checksum of the bytes, little-endian.
#pragma once

#include <filesystem>
#include <vector>

#include "redrive/base/files/byte_source.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/parse/proto_reader.h"

namespace redrive::waymo {

/// Returns the places of the records, whose lengths fit their checksums. A file that is cut loses
/// its last record, which goes to `damaged`. InputError: no such file.
std::vector<ByteSpan> list_records(const ByteSource& bytes, const std::filesystem::path& file,
                                   std::vector<DamagedRecord>* damaged);

}  // namespace redrive::waymo
