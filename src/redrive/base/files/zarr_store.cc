// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/zarr_store.h"

#include <blosc.h>

#include "redrive/base/error.h"
#include "redrive/base/files/xz.h"

namespace redrive {
namespace {

constexpr int kBloscLevel = 5;

std::string below(const std::string& path, const char* name) {
  return path.empty() ? name : path + "/" + name;
}

std::string blosc(std::string_view bytes, std::size_t item) {
  std::string packed(bytes.size() + BLOSC_MAX_OVERHEAD, '\0');
  const int size =
      blosc_compress_ctx(kBloscLevel, BLOSC_BITSHUFFLE, item, bytes.size(), bytes.data(),
                         packed.data(), packed.size(), BLOSC_LZ4_COMPNAME,
                         /*blocksize=*/0, /*numinternalthreads=*/1);
  REDRIVE_CHECK_OP(size, >, 0);
  packed.resize(static_cast<std::size_t>(size));
  return packed;
}

}  // namespace

void ZarrStore::metadata(const std::string& name, const Json& value) {
  tar_.add(name, value.dump());
  metadata_.get_ref<Json::object_t&>().emplace_back(name, value);  // no search: each is new
}

void ZarrStore::group(const std::string& path) {
  if (!groups_.insert(path).second) return;
  if (!path.empty()) {
    const std::size_t slash = path.rfind('/');
    group(slash == path.npos ? "" : path.substr(0, slash));
  }
  metadata(below(path, ".zgroup"), {{"zarr_format", 2}});
}

void ZarrStore::group(const std::string& path, const Json& attributes) {
  group(path);
  metadata(below(path, ".zattrs"), attributes);
}

void ZarrStore::array_metadata(const std::string& path, const std::string& dtype,
                               const std::vector<std::size_t>& shape, const Json& compressor,
                               const Json& attributes) {
  group(path.substr(0, path.rfind('/')));
  metadata(below(path, ".zarray"), {{"zarr_format", 2},
                                    {"shape", shape},
                                    {"chunks", shape},
                                    {"dtype", dtype},
                                    {"compressor", compressor},
                                    {"fill_value", nullptr},
                                    {"order", "C"},
                                    {"filters", nullptr}});
  if (!attributes.empty()) metadata(below(path, ".zattrs"), attributes);
}

void ZarrStore::array(const std::string& path, const char* dtype,
                      const std::vector<std::size_t>& shape, std::string_view bytes,
                      const Json& attributes) {
  const std::size_t item = std::stoul(dtype + 2);
  std::size_t expected = item;
  std::string chunk;
  for (const std::size_t size : shape) {
    expected *= size;
    chunk += chunk.empty() ? "0" : ".0";
  }
  REDRIVE_CHECK_OP(bytes.size(), >, 0u);
  REDRIVE_CHECK_OP(bytes.size(), ==, expected);
  array_metadata(path, dtype, shape,
                 {{"id", "blosc"},
                  {"cname", BLOSC_LZ4_COMPNAME},
                  {"clevel", kBloscLevel},
                  {"shuffle", BLOSC_BITSHUFFLE},
                  {"blocksize", 0}},
                 attributes);
  tar_.add(below(path, chunk.c_str()), blosc(bytes, item));
}

void ZarrStore::file(const std::string& path, std::string_view bytes, const Json& attributes) {
  array_metadata(path, "|S" + std::to_string(bytes.size()), {}, nullptr, attributes);
  tar_.add(below(path, "0"), bytes);
}

void ZarrStore::finish() {
  const std::vector<std::uint8_t> cbor =
      Json::to_cbor({{"zarr_consolidated_format", 1}, {"metadata", metadata_}});
  tar_.add(".zmetadata.cbor.xz", xz({reinterpret_cast<const char*>(cbor.data()), cbor.size()}));
  tar_.finish();
}

}  // namespace redrive
