// SPDX-License-Identifier: Apache-2.0
// docs/hyperparameters.md lists the hyperparameters as the methods declare them. To write it anew:
// REDRIVE_WRITE_DOCS=1 build/dev/test_docs --gtest_filter='Hyperparameters.*'
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <utility>

#include <gtest/gtest.h>

#include "redrive/model/method.h"
#include "redrive/train/poses/pose_refinement.h"

namespace redrive {
namespace {

void write_table(Configurable& numbers, std::ostream& out) {
  out << "|name|default|meaning|\n|---|---|---|\n";
  for (const HyperparameterValue& value : hyperparameter_values(numbers)) {
    if (value.what.derived) continue;
    out << "|`" << value.what.name << "`";
    if (!value.what.option.empty()) out << " (`--" << value.what.option << "`)";
    out << "|" << value.text << "|" << value.what.help << "|\n";
  }
}

std::string document() {
  std::ostringstream out;
  out << "# Hyperparameters\n\n"
         "Written by `tests/docs/hyperparameters_test.cc`; do not edit. `train --set NAME=VALUE`\n"
         "sets a number of the method in use, and a name in parentheses is its own option. "
         "Numbers\n"
         "that follow from the recording are left out, and a recording may change a default, as a\n"
         "bounded scene does for grid; `RUN/config.json` has the values of a run.\n";
  for (const Method& method : methods()) {
    out << "\n## " << method.name << "\n\n";
    const char* before = "Defaults: ";
    for (const auto& [option, value] : method.defaults)
      out << std::exchange(before, ", ") << "`--" << option << "` " << value;
    before = method.defaults.empty() ? "Presets: " : ".\nPresets: ";
    for (const Preset& preset : method.presets)
      out << std::exchange(before, ", ") << "`" << preset.name << "` " << preset.text();
    out << ".\n\n";
    write_table(*method.make(), out);
  }
  out << "\n## Pose refinement\n\n";
  PoseRefinement refinement;
  write_table(refinement, out);
  return out.str();
}

TEST(Hyperparameters, AreDocumentedAsTheyAreDeclared) {
  const std::string file = REDRIVE_SOURCE "/docs/hyperparameters.md", expected = document();
  if (std::getenv("REDRIVE_WRITE_DOCS")) std::ofstream(file) << expected;
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  EXPECT_EQ(text.str(), expected);
}

}  // namespace
}  // namespace redrive
