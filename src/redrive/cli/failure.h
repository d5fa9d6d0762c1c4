// SPDX-License-Identifier: Apache-2.0
// Exit codes of errors (base/error.h).
#pragma once

#include <string>

#include "redrive/base/error.h"

namespace redrive {

struct Failure {
  ExitCode code = kExitInternal;
  std::string message;
};

/// Returns exit code and message of the exception that is being handled.
Failure current_failure();

/// Prints it to standard error and returns its exit code.
ExitCode print_failure();

}  // namespace redrive
