// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/server/redirect_file.h"

#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <string_view>

#include "redrive/base/error.h"

namespace redrive::view {

RedirectFile::RedirectFile(const std::string& address) {
  constexpr std::string_view kEnding = ".html";
  std::string name = (std::filesystem::temp_directory_path() / "redrive-view-XXXXXX").string() +
                     std::string(kEnding);
  // An unpredictable name, with mode 0600, and no link is followed.
  const int file = mkstemps(name.data(), static_cast<int>(kEnding.size()));
  if (file < 0) throw IoError(name, std::strerror(errno));
  path_ = name;
  const std::string text =
      "<!doctype html><meta charset=\"utf-8\"><title>redrive view</title>"
      "<meta http-equiv=\"refresh\" content=\"0; url=" +
      address + "\"><a href=\"" + address + "\">redrive view</a>\n";
  const bool written = write(file, text.data(), text.size()) == static_cast<ssize_t>(text.size());
  if (close(file) != 0 || !written) {
    unlink(name.c_str());
    throw IoError(name, "cannot be written");
  }
}

RedirectFile::~RedirectFile() { unlink(path_.c_str()); }

}  // namespace redrive::view
