// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/photographs.h"

#include "redrive/base/files.h"
#include "redrive/recording/frame_files.h"
#include "redrive/recording/wording.h"

namespace redrive::photographs {

void report_unread_points(const std::vector<std::filesystem::path>& folders,
                          const std::filesystem::path& read, std::vector<Finding>* findings) {
  std::vector<std::string> unread;
  for (const std::filesystem::path& folder : folders)
    for (const std::filesystem::path& file : list_folder(folder))
      if (has_extension(file, {".ply", ".pcd", ".las", ".laz"}) && file != read)
        unread.push_back(file.filename().string());
  if (!unread.empty())
    findings->push_back(
        {"points", counted(unread.size(), "cloud") + " not read: " + first_few(unread)});
}

}  // namespace redrive::photographs
