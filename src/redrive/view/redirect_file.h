// SPDX-License-Identifier: Apache-2.0
// The file by which --open hands the page's address to a browser: a program's arguments can be read
// by every user of the machine, and the address holds the token.
#pragma once

#include <filesystem>
#include <string>

namespace redrive::view {

/// A page that leads to an address. Its file can be read by this user alone and is removed with it.
class RedirectFile {
 public:
  /// Throws IoError where no file can be made.
  explicit RedirectFile(const std::string& address);
  ~RedirectFile();
  RedirectFile(const RedirectFile&) = delete;
  RedirectFile& operator=(const RedirectFile&) = delete;

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace redrive::view
