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
  for (const char* text :
       {".SS \\fBredrive train\\fR", ".SS \\fBredrive render lidar\\fR",
        "\\fB\\-\\-holdout\\-every\\fR", "\\fIRECORDING\\fR", ".SH EXIT STATUS", "\\fB130\\fR"})
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
  EXPECT_EQ(completed("render lidar --points-in w"), "world\n");
  EXPECT_EQ(completed("render po"), "poses\n");
  EXPECT_EQ(completed("render path --se"), "--seconds\n");
  EXPECT_EQ(completed("render RUN --no"), "--normals\n");  // image is meant
  EXPECT_EQ(completed("help tr"), "train\n");
  EXPECT_EQ(completed("help render li"), "lidar\n");
}

TEST_F(EndToEnd, HelpFitsATerminalAndHasExamples) {
  const ProgramResult all = redrive({"help"});
  EXPECT_EQ(all.exit_code, kExitOk);
  for (const char* command :
       {"inspect", "align", "train", "resume", "plan", "eval", "render", "view", "serve", "export",
        "simulate", "figures", "bench", "doctor"}) {
    EXPECT_THAT(all.out, HasSubstr("\n  " + std::string(command) + " "));
    const ProgramResult help = redrive({"help", command});
    EXPECT_EQ(help.exit_code, kExitOk);
    EXPECT_THAT(help.out, HasSubstr("Examples\n  redrive " + std::string(command)));
    std::istringstream lines(help.out);
    for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 80u) << line;
  }
  // The default of the usual method, then of those that differ.
  const std::string train = redrive({"help", "train"}).out;
  EXPECT_THAT(train, HasSubstr("default: 120"));
  EXPECT_THAT(train, ::testing::Not(HasSubstr("\nOptions\n"))) << "every option has a group";
}

TEST_F(EndToEnd, RenderHasSubcommands) {
  const ProgramResult all = redrive({"help", "render"}), none = redrive({"render"});
  EXPECT_EQ(all.exit_code, kExitOk);
  EXPECT_EQ(none.exit_code, kExitUsage);
  EXPECT_EQ(none.out, all.out);
  EXPECT_EQ(redrive({"render", "--help"}).out, all.out);
  EXPECT_THAT(all.out, HasSubstr("is none of these, image is meant"));
  for (const std::string name : {"image", "mount", "poses", "path", "lidar"}) {
    EXPECT_THAT(all.out, HasSubstr("\n  " + name + " "));
    const ProgramResult help = redrive({"help", "render", name});
    EXPECT_EQ(help.exit_code, kExitOk);
    EXPECT_EQ(redrive({"render", name, "--help"}).out, help.out);
    EXPECT_THAT(help.out, HasSubstr("Examples\n  redrive render " + name));
    std::istringstream lines(help.out);
    for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 80u) << line;
  }
  EXPECT_EQ(redrive({"render", "RUN", "--help"}).out, redrive({"help", "render", "image"}).out);
}

TEST_F(EndToEnd, OptionsOfOtherSubcommandsAreNamedWithTheirs) {
  const auto error = [](const std::vector<std::string>& more) {
    std::vector<std::string> words = {"render", "RUN"};
    words.insert(words.end(), more.begin(), more.end());
    const ProgramResult ended = redrive(words);
    EXPECT_EQ(ended.exit_code, kExitUsage);
    return ended.err;
  };
  EXPECT_THAT(error({"--poses", "POSES.json", "--out", "d"}),
              HasSubstr("--poses: is no option of redrive render image; it is redrive render poses "
                        "RUN POSES.json --out DIR"));
  EXPECT_THAT(error({"--path", "drive", "--out", "d"}), HasSubstr("redrive render path RUN PATH"));
  EXPECT_THAT(error({"--out", "a.las", "--lidar", "64"}), HasSubstr("redrive render lidar RUN"));
  EXPECT_THAT(error({"--mount=0,0,0,0,0,0"}), HasSubstr("redrive render mount RUN --mount"));
  EXPECT_THAT(error({"--points-in", "body"}),
              HasSubstr("is no option of redrive render image, but one of redrive render lidar"));
  const ProgramResult mistyped = redrive({"render", "lidr", "RUN", "--out", "a.las"});
  EXPECT_EQ(mistyped.exit_code, kExitUsage);
  EXPECT_THAT(mistyped.err, HasSubstr("did you mean lidar?"));
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
