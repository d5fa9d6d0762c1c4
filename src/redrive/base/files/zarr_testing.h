// SPDX-License-Identifier: Apache-2.0
// For tests: reads a zarr group in a tar without the program's code, by walking through the tar.
#pragma once

#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include <blosc.h>
#include <nlohmann/json.hpp>

#include "redrive/base/files/xz_testing.h"

namespace redrive {

struct WalkedStore {
  std::map<std::string, TarMember> members;

  explicit WalkedStore(const std::filesystem::path& path) {
    std::ifstream in(path, std::ios::binary);
    std::size_t end = 0;
    members = walk_tar({std::istreambuf_iterator<char>(in), {}}, &end);
  }
  nlohmann::json json(const std::string& name) const {
    return nlohmann::json::parse(members.at(name).bytes);
  }
  nlohmann::json attributes(const std::string& path) const { return json(path + "/.zattrs"); }
  const std::string& bytes(const std::string& name) const { return members.at(name).bytes; }

  /// Values of an array of one chunk; throws unless it has this type and shape.
  template <class T>
  std::vector<T> array(const std::string& path, const std::string& dtype,
                       const std::vector<std::size_t>& shape) const {
    const nlohmann::json about = json(path + "/.zarray");
    if (about["dtype"] != dtype || about["shape"] != nlohmann::json(shape) ||
        about["chunks"] != about["shape"] || about["compressor"]["id"] != "blosc" ||
        about["zarr_format"] != 2 || about["order"] != "C")
      throw std::runtime_error(path + about.dump());
    std::string chunk;
    for (std::size_t i = 0; i < shape.size(); ++i) chunk += i == 0 ? "0" : ".0";
    const std::string& packed = bytes(path + "/" + chunk);
    std::size_t size = 0;
    if (blosc_cbuffer_validate(packed.data(), packed.size(), &size) != 0 || size % sizeof(T) != 0)
      throw std::runtime_error(path + ": Blosc");
    std::vector<T> values(size / sizeof(T));
    if (blosc_decompress_ctx(packed.data(), values.data(), size, 1) != static_cast<int>(size))
      throw std::runtime_error(path + ": Blosc");
    return values;
  }
};

}  // namespace redrive
