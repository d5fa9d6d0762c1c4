// SPDX-License-Identifier: Apache-2.0
// The command line that trains a run.
#pragma once

#include <filesystem>
#include <string>

#include "redrive/train/run.h"

namespace redrive {

/// Quotes a word where a POSIX shell would change it.
std::string shell_word(const std::string& word);

/// Returns "redrive train RECORDING --method NAME ... --out RUN" for a shell: with the options that
/// differ from those which the command would choose by itself for the recording of `run`.
std::string train_command(const Run& run, const TrainOptions& options,
                          const std::filesystem::path& out);

}  // namespace redrive
