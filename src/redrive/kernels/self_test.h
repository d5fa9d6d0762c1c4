// SPDX-License-Identifier: Apache-2.0
// Whether a backend computes what `ref` does, asked of a handful of small stages before `--backend
// auto` takes it: a few tenths of a second. The whole of it is for tests/conformance.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "redrive/kernels/backend.h"

namespace redrive::kernels {

/// The first stage that is off, and by how much, or what the backend died of; nothing where all is
/// well.
std::optional<std::string> self_test(Backend& backend);

/// The backend that `make` makes of a GPU, or null where its self-test fails, which is said on
/// stderr.
std::unique_ptr<Backend> make_if_self_test_passes(
    const std::function<std::unique_ptr<Backend>()>& make);

}  // namespace redrive::kernels
