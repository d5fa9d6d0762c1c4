// SPDX-License-Identifier: Apache-2.0
// The man page and the bash completion of the packages.
#include <sstream>

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
  EXPECT_EQ(completed("train --max-s"), "--max-seconds --max-steps\n");
  EXPECT_EQ(completed("doctor --max-s"), "\n");
  EXPECT_EQ(completed("train some/fold"), "\n");  // readline completes files
  EXPECT_EQ(completed("train --method s"), "splat\n");
  EXPECT_EQ(completed("render --points-in w"), "world\n");
  EXPECT_EQ(completed("help tr"), "train\n");
}

TEST_F(EndToEnd, HelpFitsATerminalAndHasExamples) {
  const ProgramResult all = redrive({"help"});
  EXPECT_EQ(all.exit_code, kExitOk);
  for (const char* command : {"inspect", "align", "train", "resume", "plan", "eval", "render",
                              "view", "export", "figures", "bench", "doctor"}) {
    EXPECT_THAT(all.out, HasSubstr("\n  " + std::string(command) + " "));
    const ProgramResult help = redrive({"help", command});
    EXPECT_EQ(help.exit_code, kExitOk);
    EXPECT_THAT(help.out, HasSubstr("Examples\n  redrive " + std::string(command)));
    std::istringstream lines(help.out);
    for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 80u) << line;
  }
  // The default of the usual method, then of those that differ.
  EXPECT_THAT(redrive({"help", "train"}).out, HasSubstr("default: 120"));
}

TEST_F(EndToEnd, AMistypedWordIsNamedWithWhatWasMeant) {
  const auto error = [](const std::vector<std::string>& words) {
    const ProgramResult ended = redrive(words);
    EXPECT_EQ(ended.exit_code, kExitUsage);
    return ended.err;
  };
  EXPECT_THAT(error({"tarin", "x"}), HasSubstr("did you mean train?"));
  // Not: --out is required.
  EXPECT_THAT(error({"train", "x", "--otu", "y"}),
              HasSubstr("--otu: is no option of redrive train; did you mean --out?"));
  EXPECT_THAT(error({"train", "x", "--out", "y", "--method", "splt"}),
              HasSubstr("did you mean splat?"));
  EXPECT_THAT(error({"train", "x", "y", "--out", "z"}),
              HasSubstr("train y: is one argument too many"));
  EXPECT_THAT(error({"train", "x", "--out"}), HasSubstr("--out: needs a value"));
}

}  // namespace
}  // namespace redrive::testing
