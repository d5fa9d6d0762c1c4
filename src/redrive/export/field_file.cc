// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/field_file.h"

#include <array>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/zip.h"

namespace redrive {
namespace {

ExportFormat find_format(const Field& field, const std::string& name) {
  std::string known;
  for (const ExportFormat& format : field.export_formats()) {
    if (format.name == name) return format;
    known += (known.empty() ? "; it has " : ", ") + format.name;
  }
  throw UsageError(
      "--to", name,
      "the run is of method " + std::string(field.method()) + ", which has no such format" + known);
}

}  // namespace

std::uint64_t write_field_file(const std::filesystem::path& file, const Field& field,
                               const std::string& format, const ExportOptions& options) {
  const ExportFormat found = find_format(field, format);
  const std::string bytes = found.encode(options);
  if (found.zip_member.empty())
    write_file(file, bytes);
  else
    write_zip(file, std::array{ZipMember{found.zip_member, bytes}});
  return bytes.size();
}

}  // namespace redrive
