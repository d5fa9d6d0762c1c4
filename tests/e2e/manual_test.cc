// SPDX-License-Identifier: Apache-2.0
// The man page and the bash completion of the packages.
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;
using ::testing::StartsWith;

TEST_F(EndToEnd, TheManPageNamesCommandsOptionsAndExitCodes) {
  const ProgramResult man = redrive({"--generate", "man"});
  ASSERT_EQ(man.exit_code, kExitOk) << man.err;
  EXPECT_THAT(man.out, StartsWith(".TH REDRIVE 1"));
  for (const char* text : {".SS \\fBredrive train\\fR", "\\fB\\-\\-holdout\\-every\\fR",
                           "\\fIRECORDING\\fR", ".SH EXIT STATUS", "\\fB130\\fR"})
    EXPECT_THAT(man.out, HasSubstr(text));
}

TEST_F(EndToEnd, BashCompletesCommandsAndTheirOptions) {
  const ProgramResult script = redrive({"--generate", "bash-completion"});
  ASSERT_EQ(script.exit_code, kExitOk) << script.err;
  write_file(folder_ / "completion", script.out);
  const auto completed = [&](const std::string& line) {
    const std::string words =
        "COMP_WORDS=(redrive " + line + "); COMP_CWORD=$((${#COMP_WORDS[@]} - 1))";
    return Program("/bin/bash", {"-c", "source " + (folder_ / "completion").string() + "; " +
                                           words + "; _redrive; echo ${COMPREPLY[@]}"})
        .wait()
        .out;
  };
  EXPECT_EQ(completed("ali"), "align\n");
  EXPECT_EQ(completed("train --max-s"), "--max-steps --max-seconds\n");
  EXPECT_EQ(completed("doctor --max-s"), "\n");
  EXPECT_EQ(completed("train some/fold"), "\n");  // readline completes files
}

}  // namespace
}  // namespace redrive::testing
