// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/safetensors.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"

namespace redrive {
namespace {

static_assert(std::endian::native == std::endian::little,
              "safetensors is little endian, and so is all that redrive runs on");

constexpr std::size_t kMaxHeader = 100'000'000;  // the format's own limit

std::string shown(const nlohmann::json& json) {
  return json.dump(-1, ' ', true, nlohmann::json::error_handler_t::replace).substr(0, 80);
}

struct Extent {
  std::size_t begin = 0, end = 0;
  std::string name;
};

void parse_metadata(const nlohmann::json& entry, const std::string& field,
                    const std::filesystem::path& file, Safetensors* out) {
  if (!entry.is_object()) throw InputError(file, field, shown(entry), "must be an object");
  for (const auto& [key, value] : entry.items()) {
    if (!value.is_string())
      throw InputError(file, field + "." + key, shown(value), "must be a text");
    out->metadata[key] = value.get<std::string>();
  }
}

/// Writes where the tensor lies in the file's data.
Safetensors::Tensor parse_tensor(const std::string& name, const nlohmann::json& entry,
                                 std::string_view data, const std::filesystem::path& file,
                                 Extent* extent) {
  if (!entry.is_object() || !entry.contains("dtype") || !entry.contains("shape") ||
      !entry.contains("data_offsets"))
    throw InputError(file, name, shown(entry), "must have dtype, shape and data_offsets");
  if (entry["dtype"] != "F32" && entry["dtype"] != "U32")
    throw InputError(file, name + ".dtype", shown(entry["dtype"]), "must be F32 or U32");
  const auto whole = [&](const nlohmann::json& list, const char* field) {
    std::vector<std::int64_t> numbers;
    if (!list.is_array() || list.size() > 8)
      throw InputError(file, name + "." + field, shown(list), "must be a short list");
    for (const nlohmann::json& number : list) {
      if (!number.is_number_unsigned() || number.get<std::uint64_t>() > data.size())
        throw InputError(file, name + "." + field, shown(list),
                         "must be whole numbers that fit in the file's data");
      numbers.push_back(number.get<std::int64_t>());
    }
    return numbers;
  };
  Safetensors::Tensor tensor;
  tensor.shape = whole(entry["shape"], "shape");
  const std::vector<std::int64_t> offsets = whole(entry["data_offsets"], "data_offsets");
  if (offsets.size() != 2 || offsets[0] > offsets[1])
    throw InputError(file, name + ".data_offsets", shown(entry["data_offsets"]),
                     "must be begin and end within the data");
  extent->begin = static_cast<std::size_t>(offsets[0]);
  extent->end = static_cast<std::size_t>(offsets[1]);
  const std::size_t bytes = extent->end - extent->begin;
  std::size_t count = 1;  // one check per factor rules out overflow, since each factor is
                          // at most the size of the data
  for (const std::int64_t size : tensor.shape) {
    count *= static_cast<std::size_t>(size);
    if (count > data.size()) break;
  }
  if (count > data.size() || count * sizeof(float) != bytes)
    throw InputError(file, name + ".shape", shown(entry["shape"]),
                     "does not match its data of " + std::to_string(bytes) + " bytes");
  tensor.is_float = entry["dtype"] == "F32";
  tensor.data = data.substr(extent->begin, bytes);
  for (std::size_t i = 0; tensor.is_float && i < count; ++i) {
    float value = 0;
    std::memcpy(&value, tensor.data.data() + i * sizeof value, sizeof value);
    if (!std::isfinite(value))
      throw InputError(file, name + "[" + std::to_string(i) + "]", std::to_string(value),
                       "must be finite");
  }
  return tensor;
}

/// Refuses tensors that do not tile the file's data.
void check_tiling(std::vector<Extent> extents, std::size_t size,
                  const std::filesystem::path& file) {
  std::sort(extents.begin(), extents.end(), [](const Extent& a, const Extent& b) {
    return std::tie(a.begin, a.end) < std::tie(b.begin, b.end);
  });
  std::size_t reached = 0;
  for (const Extent& extent : extents) {
    if (extent.begin != reached)
      throw InputError(file, extent.name + ".data_offsets", std::to_string(extent.begin),
                       "overlaps or leaves a hole: " + std::to_string(reached) +
                           " follows from the tensors before");
    reached = extent.end;
  }
  if (reached != size)
    throw InputError(
        file, "", std::to_string(size) + " bytes of data",
        "the header speaks of " + std::to_string(reached) + " (truncated, or not ours)");
}

}  // namespace

std::vector<std::string_view> SafetensorsFile::parts() const {
  std::vector<std::string_view> parts{header};
  for (const SafetensorsEntry& entry : entries)
    if (entry.words.empty())
      parts.emplace_back(reinterpret_cast<const char*>(entry.values.data()),
                         entry.values.size_bytes());
    else
      parts.emplace_back(reinterpret_cast<const char*>(entry.words.data()),
                         entry.words.size_bytes());
  return parts;
}

SafetensorsFile make_safetensors(const std::map<std::string, std::string>& metadata,
                                 std::vector<SafetensorsEntry> entries) {
  nlohmann::json header = nlohmann::json::object();
  header["__metadata__"] = metadata;
  std::size_t offset = 0;
  for (const SafetensorsEntry& entry : entries) {
    const std::size_t end = offset + entry.values.size_bytes() + entry.words.size_bytes();
    header[entry.name] = {{"dtype", entry.words.empty() ? "F32" : "U32"},
                          {"shape", entry.shape},
                          {"data_offsets", {offset, end}}};
    offset = end;
  }
  std::string text = header.dump();
  text.resize((text.size() + 7) / 8 * 8, ' ');
  const std::uint64_t length = text.size();
  std::string with_length(reinterpret_cast<const char*>(&length), sizeof length);
  return {with_length + text, std::move(entries)};
}

Safetensors parse_safetensors(std::string_view bytes, const std::filesystem::path& file) {
  std::uint64_t length = 0;
  if (bytes.size() < sizeof length)
    throw InputError(file, "", std::to_string(bytes.size()) + " bytes", "truncated");
  std::memcpy(&length, bytes.data(), sizeof length);
  const std::size_t rest = bytes.size() - sizeof length;
  if (length < 2 || length > rest || length > kMaxHeader)
    throw InputError(file, "header length", std::to_string(length),
                     "must fit in the file's " + std::to_string(rest) + " bytes");
  const nlohmann::json header = parse_json(bytes.substr(sizeof length, length), file);
  const std::string_view data = bytes.substr(sizeof length + length);
  if (!header.is_object()) throw InputError(file, "header", shown(header), "must be an object");

  Safetensors result;
  std::vector<Extent> extents;
  for (const auto& [name, entry] : header.items()) {
    if (name == "__metadata__") {
      parse_metadata(entry, name, file, &result);
      continue;
    }
    Extent& extent = extents.emplace_back();
    extent.name = name;
    result.tensors.emplace(name, parse_tensor(name, entry, data, file, &extent));
  }
  check_tiling(std::move(extents), data.size(), file);
  return result;
}

}  // namespace redrive
