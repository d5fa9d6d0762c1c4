// SPDX-License-Identifier: Apache-2.0
// --json, the same for every command that prints figures.
#pragma once

#include <cstdio>
#include <vector>

#include <CLI/App.hpp>
#include <nlohmann/json.hpp>

#include "redrive/recording/core/recording.h"

namespace redrive {

inline void add_json_option(CLI::App& command, bool* json) {
  command.add_flag("--json", *json, "JSON on standard output instead of text");
}

/// Prints UTF-8, which file names need not be.
template <class Json>
void print_json(const Json& json) {
  std::printf("%s\n", json.dump(2, ' ', false, Json::error_handler_t::replace).c_str());
}

inline nlohmann::json findings_to_json(const std::vector<Finding>& findings) {
  nlohmann::json list = nlohmann::json::array();
  for (const Finding& finding : findings)
    list.push_back({{"subject", finding.subject}, {"what", finding.what}});
  return list;
}

}  // namespace redrive
