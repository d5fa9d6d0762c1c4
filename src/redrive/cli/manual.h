// SPDX-License-Identifier: Apache-2.0
// The man page and the completion for bash, made from the registered commands and options.
#pragma once

#include <string>

#include <CLI/App.hpp>

namespace redrive {

/// Adds `--generate man|bash-completion`, which prints one of them and ends with success. To be
/// called when all commands are there; `version` stands in the man page's footer.
void add_generate_option(CLI::App& app, const std::string& version);

}  // namespace redrive
