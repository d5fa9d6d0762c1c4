// SPDX-License-Identifier: Apache-2.0
// Opens a run or a divided run (train/files/blocks.h) for rendering.
#pragma once

#include <filesystem>

#include "redrive/train/run.h"

namespace redrive {

/// Opens a run as open_run, or a divided run as one: with the whole drive's recording and scene and
/// a DividedField (render/divided_field.h), whose blocks are loaded when an image needs them.
/// Blocks in memory have a quarter of what --memory allows together. Where moving objects are
/// drawn, each block is opened once for its corrections of their tracks. Errors as open_run; a
/// block that is missing or damaged is an InputError when it is needed.
Run open_to_render(const std::filesystem::path& root, std::optional<double> max_damaged = {});

}  // namespace redrive
