// SPDX-License-Identifier: Apache-2.0
// Compares a few small stages of a backend with `ref` before `--backend auto` takes it, in a few
// tenths of a second. tests/conformance compares all stages.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "redrive/kernels/backend.h"

namespace redrive::kernels {

/// Returns the first stage that disagrees and its error, or the message of an exception from the
/// backend; nothing if all agree.
std::optional<std::string> self_test(Backend& backend);

/// Returns the backend that `make` makes, or null if its self-test fails, which is reported on
/// stderr.
std::unique_ptr<Backend> make_if_self_test_passes(
    const std::function<std::unique_ptr<Backend>()>& make);

}  // namespace redrive::kernels
