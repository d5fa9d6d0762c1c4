// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace redrive {

/// Returns the text that printf would print.
std::string formatted(const char* format, ...) __attribute__((format(printf, 1, 2)));

}  // namespace redrive
