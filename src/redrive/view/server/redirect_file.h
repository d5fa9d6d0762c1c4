// SPDX-License-Identifier: Apache-2.0
// The file by which --open passes the page's address to a browser: every user of the machine can
// read a program's arguments, and the address holds the token.
#pragma once

#include <filesystem>
#include <string>

namespace redrive::view {

/// A page that redirects to an address. Only this user can read its file, which is removed with the
/// object.
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
