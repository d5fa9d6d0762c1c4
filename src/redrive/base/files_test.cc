// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files.h"

#include <csignal>
#include <filesystem>
#include <fstream>

#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class Files : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::path(testing::TempDir()) / ("redrive_files_" + std::to_string(getpid()));
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::size_t entries() const {
    return std::distance(fs::directory_iterator(folder_), fs::directory_iterator());
  }
  fs::path folder_;
};

TEST_F(Files, RoundTripOfAnyBytes) {
  std::string bytes(100'000, '\0');
  for (std::size_t i = 0; i < bytes.size(); ++i) bytes[i] = static_cast<char>(i * 7);
  write_file(folder_ / "a", bytes);
  EXPECT_EQ(read_file(folder_ / "a"), bytes);
  write_file(folder_ / "a", "");
  EXPECT_EQ(read_file(folder_ / "a"), "");
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, NewFileHasTheUsersPermissions) {
  const mode_t mask = umask(022);
  write_file(folder_ / "a", "x");
  umask(mask);
  struct stat status {};
  ASSERT_EQ(stat((folder_ / "a").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0644u);
}

TEST_F(Files, LeftoverOfAKilledProcessIsReplaced) {
  std::ofstream(folder_ / ".a.redrive-tmp") << "half a check";
  write_file(folder_ / "a", "whole");
  EXPECT_EQ(read_file(folder_ / "a"), "whole");
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, AFullDiskKeepsTheOldFileAndNoTemporary) {
  write_file(folder_ / "a", "old");
  // A limit on file size fails in the middle of a write just as a full disk does.
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit limit{1000, before.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &limit), 0);
  std::string message;
  try {
    write_file(folder_ / "a", std::string(5000, 'x'));
  } catch (const IoError& error) {
    message = error.what();
  }
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
  std::signal(SIGXFSZ, handler);
  EXPECT_THAT(message,
              testing::AllOf(HasSubstr((folder_ / "a").string()), HasSubstr("File too large")));
  EXPECT_EQ(read_file(folder_ / "a"), "old");
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, ReportsWriteErrors) {
  EXPECT_THROW(write_file(folder_ / "missing" / "a", "x"), IoError);
  fs::create_directory(folder_ / "d");
  EXPECT_THROW(write_file(folder_ / "d", "x"), IoError);
  EXPECT_EQ(entries(), 1u);
}

TEST_F(Files, ReportsReadErrors) {
  EXPECT_THROW(read_file(folder_ / "missing"), InputError);
  EXPECT_THROW(read_file(folder_), InputError);
}

TEST_F(Files, JsonErrorsNameFileAndPosition) {
  write_file(folder_ / "a.json", "{\"a\":\n  nan}");
  try {
    read_json(folder_ / "a.json");
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(),
                testing::AllOf(HasSubstr("a.json: not valid JSON"), HasSubstr("line 2, column 4")));
  }
  EXPECT_THROW(parse_json("[1e999]", "a.json"), InputError);
  EXPECT_THROW(parse_json("", "a.json"), InputError);
  EXPECT_THROW(parse_json(std::string(200'000, '['), "a.json"), InputError);
  EXPECT_EQ(parse_json("[1, 2]", "a.json").size(), 2u);
}

TEST(ParseJson, NestingIsLimited) {
  const auto nested = [](std::size_t depth) {
    return std::string(depth, '[') + std::string(depth, ']');
  };
  EXPECT_EQ(parse_json(nested(64), "a.json").dump(),
            nested(64));  // nesting up to the limit is accepted
  for (const std::size_t depth : {std::size_t{66}, std::size_t{1000000}}) {
    try {
      parse_json(nested(depth), "a.json");
      FAIL() << depth;
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), HasSubstr("deeper than 64"));
    }
  }
}

TEST_F(Files, ExtensionsAreComparedWithoutCase) {
  EXPECT_TRUE(has_extension("a/B.JPG", {".png", ".jpg"}));
  EXPECT_TRUE(has_extension("x.png", {".png", ".jpg"}));
  EXPECT_FALSE(has_extension("x.png.part", {".png", ".jpg"}));
  EXPECT_FALSE(has_extension("png", {".png"}));
}

}  // namespace
}  // namespace redrive
