// SPDX-License-Identifier: Apache-2.0
// scripts/ctest, on presets whose tests are lines of shell.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

using ::testing::HasSubstr;

class SkippedTests : public ::testing::Test {
 protected:
  SkippedTests() {
    fs::create_directories(folder_.path / "scripts");
    fs::copy_file(fs::path(REDRIVE_SOURCE) / "scripts/ctest", folder_.path / "scripts/ctest");
    fs::create_directories(folder_.path / "build/made");
  }
  /// Runs the script on a preset with these tests. Returns whether it passed.
  bool passes(const std::string& tests) {
    std::ofstream(folder_.path / "build/made/CTestTestfile.cmake") << tests;
    const std::string root = folder_.path.string();
    const int status =
        std::system((root + "/scripts/ctest made >" + root + "/printed 2>&1").c_str());
    std::ostringstream text;
    text << std::ifstream(folder_.path / "printed").rdbuf();
    printed_ = text.str();
    return status == 0;
  }
  /// Returns a test that GoogleTest would skip with this reason.
  static std::string skipped(const std::string& name, const std::string& why) {
    return "add_test(" + name + " printf \"f.cc:3: Skipped\\n%s\\n[  SKIPPED ]\\n\" [[" + why +
           "]])\nset_tests_properties(" + name +
           " PROPERTIES SKIP_REGULAR_EXPRESSION \"SKIPPED\")\n";
  }

  TemporaryFolder folder_;
  std::string printed_;
};

TEST_F(SkippedTests, MayLackWhatNobodyCanInstall) {
  EXPECT_TRUE(passes("add_test(A true)\n" +
                     skipped("Drive.IsRead", "\"/shared/data/drive\" is not here") +
                     skipped("Isa.IsFast", "avx512: the processor lacks avx512f")))
      << printed_;
  EXPECT_THAT(printed_, HasSubstr("1 skipped, \"/shared/data/drive\" is not here: Drive.IsRead"));
  EXPECT_THAT(printed_, HasSubstr("1 skipped, avx512: the processor lacks avx512f: Isa.IsFast"));
}

TEST_F(SkippedTests, MayNotLackWhatSetupInstalls) {
  EXPECT_FALSE(passes(skipped("Video.IsRead", "there is no ffprobe (Debian package ffmpeg)")));
  EXPECT_THAT(printed_, HasSubstr("must not be skipped"));
  EXPECT_FALSE(
      passes("add_test(Browser sh -c \"echo 'skipped: there is no chromium'; exit 77\")\n"
             "set_tests_properties(Browser PROPERTIES SKIP_RETURN_CODE 77)\n"));
  EXPECT_THAT(printed_, HasSubstr("1 skipped, there is no chromium: Browser"));
}

TEST_F(SkippedTests, NoTestAndAFailedOneFail) {
  EXPECT_FALSE(passes(""));
  EXPECT_FALSE(passes("add_test(A false)\n"));
  EXPECT_TRUE(passes("add_test(A true)\n")) << printed_;
}

}  // namespace
}  // namespace redrive
