// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/zarr_reader.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include <blosc.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/gzip.h"
#include "redrive/base/files/indexed_tar.h"
#include "redrive/base/json_field.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr std::size_t kMostMetadataBytes = std::size_t{1} << 28, kMostValues = std::size_t{1} << 25,
                      kMostDimensions = 4, kMostChunks = 1 << 16;
constexpr const char* kV3Names[] = {"zarr.json", "zarr.json.cbor.xz"};

std::string below(const std::string& path, const std::string& name) {
  return path.empty() ? name : path + "/" + name;
}

/// The metadata of an array, .zarray.
struct Layout {
  char kind = 'f';       ///< numpy's: f, i, u, b
  std::size_t item = 0;  ///< bytes
  std::vector<std::size_t> shape, chunk;
  std::string compressor, separator = ".";
  std::optional<double> fill;

  static std::size_t product(const std::vector<std::size_t>& of) {
    std::size_t all = 1;
    for (const std::size_t n : of) all *= n;
    return all;
  }
};

std::vector<std::size_t> sizes_of(const JsonField& field, std::size_t least) {
  std::vector<std::size_t> sizes;
  if (!field.json().is_array() || field.size() > kMostDimensions)
    field.fail("must be an array of at most 4 sizes");
  std::size_t all = 1;
  for (std::size_t i = 0; i < field.size(); ++i) {
    const std::int64_t size = field.at(i).integer();
    if (size < static_cast<std::int64_t>(least) || std::uint64_t(size) > kMostValues)
      field.at(i).fail("must be at most 2^24, and a chunk not empty");
    sizes.push_back(static_cast<std::size_t>(size));
    all *= std::max<std::size_t>(1, sizes.back());
    if (all > kMostValues) field.fail("at most 2^24 values are read");
  }
  return sizes;
}

Layout parse_layout(const JsonField& about) {
  Layout layout;
  if (about.at("zarr_format").integer() != 2) about.at("zarr_format").fail("must be 2");
  if (about.at("order").string() != "C")
    about.at("order").fail("must be C, the last index fastest");
  if (about.has("filters") && !about.at("filters").json().is_null() &&
      !about.at("filters").json().empty())
    about.at("filters").fail("are not read");
  const JsonField dtype = about.at("dtype");
  const std::string type = dtype.string();
  const auto is = [&](std::string_view kinds, std::string_view sizes) {
    return type.size() == 3 && kinds.find(type[1]) != kinds.npos &&
           sizes.find(type[2]) != sizes.npos;
  };
  if (!(is("iu", "1248") || is("f", "48") || is("b", "1")) ||
      (type[0] != '<' && (type[0] != '|' || type[2] != '1')))
    dtype.fail("is not read: integers, floats of 4 or 8 bytes or booleans, little-endian");
  layout.kind = type[1];
  layout.item = static_cast<std::size_t>(type[2] - '0');
  layout.shape = sizes_of(about.at("shape"), 0);
  layout.chunk = sizes_of(about.at("chunks"), 1);
  if (layout.shape.size() != layout.chunk.size())
    about.at("chunks").fail("must have as many sizes as shape");
  if (about.has("dimension_separator") && !about.at("dimension_separator").json().is_null())
    layout.separator = about.at("dimension_separator").string();
  if (layout.separator != "." && layout.separator != "/")
    about.at("dimension_separator").fail("must be . or /");
  const JsonField compressor = about.at("compressor"), fill = about.at("fill_value");
  if (!compressor.json().is_null()) layout.compressor = compressor.at("id").string();
  for (const char* known : {"", "blosc", "zlib", "gzip"})
    if (layout.compressor == known) {
      if (fill.json().is_number()) layout.fill = fill.json().get<double>();
      if (fill.json() == "NaN") layout.fill = std::numeric_limits<double>::quiet_NaN();
      if (fill.json().is_boolean()) layout.fill = fill.json().get<bool>();
      return layout;
    }
  compressor.at("id").fail("is not read: blosc, zlib, gzip or null");
}

std::optional<std::string> unblosc(std::string_view packed, std::size_t size) {
  std::size_t holds = 0;
  if (blosc_cbuffer_validate(packed.data(), packed.size(), &holds) != 0 || holds != size)
    return std::nullopt;
  std::string bytes(size, '\0');
  if (blosc_decompress_ctx(packed.data(), bytes.data(), size, /*numinternalthreads=*/1) !=
      static_cast<int>(size))
    return std::nullopt;
  return bytes;
}

/// Returns the `size` bytes of a chunk; nothing for a damaged one.
std::optional<std::string> unpack(const std::string& how, std::string packed, std::size_t size) {
  std::optional<std::string> bytes;
  if (how.empty()) bytes = std::move(packed);
  if (how == "blosc") bytes = unblosc(packed, size);
  if (how == "zlib" || how == "gzip") bytes = gunzip_at_most(size, packed);
  return bytes && bytes->size() == size ? bytes : std::nullopt;
}

template <class T>
double value_at(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<double>(value);
}

using Decode = double (*)(const char*);

Decode decoder(char kind, std::size_t item) {
  static_assert(std::endian::native == std::endian::little);
  if (kind == 'f') return item == 4 ? value_at<float> : value_at<double>;
  const bool is_signed = kind == 'i';
  switch (item) {
    case 1: return is_signed ? value_at<std::int8_t> : value_at<std::uint8_t>;
    case 2: return is_signed ? value_at<std::int16_t> : value_at<std::uint16_t>;
    case 4: return is_signed ? value_at<std::int32_t> : value_at<std::uint32_t>;
    default: return is_signed ? value_at<std::int64_t> : value_at<std::uint64_t>;
  }
}

class TarFiles : public ZarrFiles {
 public:
  explicit TarFiles(const fs::path& path) : tar_(open_bytes(path), path) {}

  std::optional<std::uint64_t> size(const std::string& key) const override {
    const auto member = tar_.members().find(key);
    return member == tar_.members().end() ? std::nullopt : std::optional(member->second.size);
  }
  std::string read(const std::string& key, std::size_t most) const override {
    return tar_.read(tar_.members().at(key), most);
  }
  std::vector<std::string> folders(const std::string& within) const override {
    std::vector<std::string> names;
    const std::string start = within.empty() ? "" : within + "/";
    const auto& members = tar_.members();
    auto it = members.lower_bound(start);
    while (it != members.end() && it->first.starts_with(start)) {
      const std::size_t slash = it->first.find('/', start.size());
      if (slash == std::string::npos) {
        ++it;
        continue;
      }
      names.push_back(it->first.substr(start.size(), slash - start.size()));
      constexpr char kAfterSlash = '/' + 1;
      it = members.lower_bound(it->first.substr(0, slash) + kAfterSlash);
    }
    std::ranges::sort(names);  // "a-b/" comes before "a/"
    return names;
  }

 private:
  IndexedTar tar_;
};

class FolderFiles : public ZarrFiles {
 public:
  explicit FolderFiles(fs::path root) : root_(std::move(root)) {}

  std::optional<std::uint64_t> size(const std::string& key) const override {
    std::error_code error;
    const std::uintmax_t size = fs::file_size(root_ / key, error);
    return error ? std::nullopt : std::optional<std::uint64_t>(size);
  }
  std::string read(const std::string& key, std::size_t most) const override {
    return read_head(root_ / key, most);
  }
  std::vector<std::string> folders(const std::string& within) const override {
    std::vector<std::string> names;
    std::error_code error;
    fs::directory_iterator it(root_ / within, error);
    for (const fs::directory_iterator end; !error && it != end; it.increment(error))
      if (std::error_code other; it->is_directory(other))
        names.push_back(it->path().filename().string());
    std::ranges::sort(names);
    return names;
  }

 private:
  fs::path root_;
};

std::unique_ptr<const ZarrFiles> open_files(const fs::path& path) {
  std::error_code error;
  if (fs::is_directory(path, error)) return std::make_unique<const FolderFiles>(path);
  return std::make_unique<const TarFiles>(path);
}

/// Moves to the next index within `sizes`, the last dimension fastest; false behind the last one.
bool next_index(const std::vector<std::size_t>& sizes, std::vector<std::size_t>* index) {
  for (std::size_t d = sizes.size(); d-- > 0;) {
    if (++(*index)[d] < sizes[d]) return true;
    (*index)[d] = 0;
  }
  return false;
}

/// Copies the part of a chunk that lies within the array. `place`: number of the chunk.
void copy_chunk(const Layout& layout, const std::vector<std::size_t>& place,
                const std::string& bytes, std::vector<double>* values) {
  const std::size_t dimensions = layout.shape.size();
  const Decode decode = decoder(layout.kind, layout.item);
  if (dimensions == 0) {
    values->front() = decode(bytes.data());
    return;
  }
  std::vector<std::size_t> within(dimensions);
  for (std::size_t d = 0; d < dimensions; ++d)
    within[d] = std::min(layout.chunk[d], layout.shape[d] - place[d] * layout.chunk[d]);
  const std::size_t row = within.back();
  std::vector<std::size_t> rows(within.begin(), within.end() - 1), index(rows.size());
  do {
    std::size_t from = 0, to = 0;
    for (std::size_t d = 0; d < dimensions; ++d) {
      const std::size_t i = d + 1 < dimensions ? index[d] : 0;
      from = from * layout.chunk[d] + i;
      to = to * layout.shape[d] + place[d] * layout.chunk[d] + i;
    }
    for (std::size_t i = 0; i < row; ++i)
      (*values)[to + i] = decode(bytes.data() + (from + i) * layout.item);
  } while (next_index(rows, &index));
}

}  // namespace

ZarrReader::ZarrReader(const fs::path& path) : ZarrReader(open_files(path), path) {}

ZarrReader::ZarrReader(std::unique_ptr<const ZarrFiles> files, const fs::path& path)
    : path_(path), files_(std::move(files)) {
  for (const char* const name : kV3Names)
    if (files_->size(name))
      fail(name, "",
           "is of version 3 of zarr; version 2 is read, in which NCore writes by default");
  if (!files_->size(".zgroup")) fail(".zgroup", "", "is missing: this is no group of zarr");
}

bool ZarrReader::has_array(const std::string& array) const {
  return files_->size(below(array, ".zarray")).has_value();
}

Json ZarrReader::metadata(const std::string& key) const {
  const auto size = files_->size(key);
  if (!size) fail(key, "", "is missing");
  if (*size > kMostMetadataBytes)
    fail(key, std::to_string(*size) + " bytes", "must be at most 2^28");
  return parse_json(files_->read(key, *size), path_ / key);
}

Json ZarrReader::attributes(const std::string& of) const {
  const std::string key = below(of, ".zattrs");
  if (!files_->size(key)) return Json::object();
  Json attributes = metadata(key);
  if (!attributes.is_object()) fail(key, "", "must be an object");
  return attributes;
}

ZarrReader::Numbers ZarrReader::numbers(const std::string& array) const {
  const std::string key = below(array, ".zarray");
  const Json about = metadata(key);
  const Layout layout = parse_layout(JsonField(about, path_ / key));
  Numbers out{layout.shape, {}};
  const std::size_t all = Layout::product(layout.shape);
  if (all == 0) return out;
  out.values.assign(all, layout.fill.value_or(0));
  std::vector<std::size_t> counts;
  for (std::size_t d = 0; d < layout.shape.size(); ++d)
    counts.push_back((layout.shape[d] + layout.chunk[d] - 1) / layout.chunk[d]);
  const std::size_t chunks = Layout::product(counts);
  if (chunks > kMostChunks) fail(key, std::to_string(chunks) + " chunks", "must be at most 2^16");
  if (chunks > 1 && chunks > 4 * kMostValues / Layout::product(layout.chunk))
    fail(key, std::to_string(chunks) + " chunks", "are too many of this size");
  std::vector<std::size_t> place(counts.size());
  const std::size_t chunk_bytes = Layout::product(layout.chunk) * layout.item;
  do {
    std::string name;
    for (const std::size_t i : place)
      name += (name.empty() ? "" : layout.separator) + std::to_string(i);
    if (name.empty()) name = "0";
    const std::string chunk = below(array, name);
    const auto packed = files_->size(chunk);
    if (!packed && layout.fill) continue;
    if (!packed) fail(chunk, "", "is missing");
    if (*packed > chunk_bytes + chunk_bytes / 8 + 4096)
      fail(chunk, std::to_string(*packed) + " bytes",
           "is too large for " + std::to_string(chunk_bytes) + " bytes packed");
    const auto bytes = unpack(layout.compressor, files_->read(chunk, *packed), chunk_bytes);
    if (!bytes) fail(chunk, "", "is damaged");
    copy_chunk(layout, place, *bytes, &out.values);
  } while (next_index(counts, &place));
  return out;
}

std::optional<std::uint64_t> ZarrReader::file_size(const std::string& array) const {
  return files_->size(below(array, "0"));
}

std::string ZarrReader::file(const std::string& array, std::size_t most) const {
  const std::string key = below(array, ".zarray");
  const Json about = metadata(key);
  const JsonField layout(about, path_ / key);
  if (!layout.at("dtype").string().starts_with("|S") || !layout.at("shape").json().empty())
    layout.at("dtype").fail("must be |S without dimensions: a file");
  if (!layout.at("compressor").json().is_null())
    layout.at("compressor").fail("must be null: images are packed already");
  const auto size = file_size(array);
  if (!size) fail(below(array, "0"), "", "is missing");
  return files_->read(below(array, "0"), std::min<std::uint64_t>(*size, most));
}

void ZarrReader::fail(const std::string& field, const std::string& value,
                      const std::string& rule) const {
  throw InputError(path_, field, value, rule);
}

}  // namespace redrive
