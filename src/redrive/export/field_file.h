// SPDX-License-Identifier: Apache-2.0
// A field as a file of its own formats: Gaussians for other programs.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "redrive/model/field.h"

namespace redrive {

/// Writes the file and returns its bytes, unpacked. `format`: ExportFormat::name. UsageError if the
/// field has no such format, IoError.
std::uint64_t write_field_file(const std::filesystem::path& file, const Field& field,
                               const std::string& format, const ExportOptions& options);

}  // namespace redrive
