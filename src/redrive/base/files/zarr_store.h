// SPDX-License-Identifier: Apache-2.0
// Writes a zarr group, version 2 of the format, into an indexed tar, as NCore's stores have it:
// each array is one chunk; arrays of numbers are packed by Blosc (lz4, level 5, bits shuffled); all
// metadata once more in .zmetadata.cbor.xz.
#pragma once

#include <cstdint>
#include <filesystem>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json.hpp>

#include "redrive/base/files/indexed_tar.h"

namespace redrive {

/// Paths are relative to the root, which is "", without a "/" at their ends. Each is written once.
class ZarrStore {
 public:
  using Json = nlohmann::ordered_json;

  explicit ZarrStore(const std::filesystem::path& path) : tar_(path) {}  ///< IoError

  /// Makes a group and the groups that it lies in, where they are missing.
  void group(const std::string& path);
  /// Makes a group with attributes. Other groups in it may exist already.
  void group(const std::string& path, const Json& attributes);
  /// dtype: numpy's, "<f4", "|u1", ... bytes: row-major, at least one value. An empty `attributes`
  /// is none.
  void array(const std::string& path, const char* dtype, const std::vector<std::size_t>& shape,
             std::string_view bytes, const Json& attributes = {});
  template <class T>
  void array(const std::string& path, const char* dtype, const std::vector<std::size_t>& shape,
             const std::vector<T>& values, const Json& attributes = {}) {
    array(path, dtype, shape,
          std::string_view(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)),
          attributes);
  }
  /// Makes an array of no dimensions whose value is a file.
  void file(const std::string& path, std::string_view bytes, const Json& attributes);
  /// Completes the file. IoError.
  void finish();

 private:
  void metadata(const std::string& name, const Json& value);
  void array_metadata(const std::string& path, const std::string& dtype,
                      const std::vector<std::size_t>& shape, const Json& compressor,
                      const Json& attributes);

  IndexedTarWriter tar_;
  std::set<std::string> groups_;
  Json metadata_ = Json::object();
};

}  // namespace redrive
