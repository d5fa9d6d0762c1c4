// SPDX-License-Identifier: Apache-2.0
// Training options as texts by name, from the command line or from Python.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "redrive/train/files/options.h"

namespace redrive {

/// Values of training options by name. A flag has an empty value; only fields that repeat have
/// several.
using GivenFields = std::map<std::string, std::vector<std::string>>;

std::vector<std::string> given_names(const GivenFields& given);
/// Returns the field of this name, which must exist.
TrainField field_named(const std::string& name);
/// Sets the given options; rules that involve several of them are not checked.
void parse_given(const GivenFields& given, TrainOptions* options);
/// Returns the options of a new run, checked, with the method's and the preset's defaults and an
/// absolute path of the recording. UsageError.
TrainOptions options_of_new_run(const GivenFields& given);

}  // namespace redrive
