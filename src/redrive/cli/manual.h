// SPDX-License-Identifier: Apache-2.0
// Generates the man page and the bash completion from the registered commands and options.
#pragma once

#include <string>

#include <CLI/App.hpp>

namespace redrive {

/// Adds `--generate man|bash-completion`, which prints one of them and exits with success. Must be
/// called after all commands were added. `version`: for the man page's footer.
void add_generate_option(CLI::App& app, const std::string& version);

}  // namespace redrive
