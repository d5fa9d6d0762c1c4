// SPDX-License-Identifier: Apache-2.0
// The SQLite storage of rosbag2 (.db3): tables topics and messages.
#pragma once

#include <filesystem>
#include <memory>

#include "redrive/recording/formats/rosbag/bag.h"

namespace redrive::rosbag {

/// InputError: no database, a damaged one, other tables.
std::unique_ptr<BagFile> open_sqlite(const std::filesystem::path& path);

}  // namespace redrive::rosbag
