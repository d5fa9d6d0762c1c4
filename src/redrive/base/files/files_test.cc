// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/files.h"

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

/// Returns the message of read_file's InputError.
std::string refusal(const fs::path& file, std::uint64_t most = kMaxTextBytes) {
  try {
    return "read: " + read_file(file, most).substr(0, 20);
  } catch (const InputError& error) {
    return error.what();
  }
}

TEST_F(Files, RegularFilesAloneAreRead) {
  ASSERT_EQ(mkfifo((folder_ / "pipe").c_str(), 0600), 0);  // without a writer: must not block
  fs::create_symlink("/dev/zero", folder_ / "endless");
  for (const char* file : {"pipe", "endless"}) {
    EXPECT_THAT(refusal(folder_ / file), HasSubstr("is a pipe or a device")) << file;
    EXPECT_THROW(read_head(folder_ / file, 10), InputError) << file;
    EXPECT_THROW(read_blocks(folder_ / file, [](std::string_view) {}), InputError) << file;
  }
}

TEST_F(Files, SizesAreBounded) {
  write_file(folder_ / "a", "12345");
  EXPECT_EQ(read_file(folder_ / "a", 5), "12345");
  EXPECT_THAT(refusal(folder_ / "a", 4), HasSubstr("size = 5 bytes: such a file may have 4"));
  fs::resize_file(folder_ / "a", std::uintmax_t{1} << 40);  // sparse
  for (const std::uint64_t most : {kMaxTextBytes, kMaxImageBytes, kMaxDataBytes})
    EXPECT_THAT(refusal(folder_ / "a", most), HasSubstr("1099511627776 bytes")) << most;
  EXPECT_EQ(read_head(folder_ / "a", 7), std::string("12345\0\0", 7));
}

TEST_F(Files, BlocksAreTheWholeFile) {
  std::string bytes(3'000'001, 'x'), joined;
  bytes.back() = 'y';
  write_file(folder_ / "a", bytes);
  read_blocks(folder_ / "a", [&](std::string_view block) { joined += block; });
  EXPECT_EQ(joined, bytes);
  EXPECT_EQ(read_head(folder_ / "a", 4'000'000), bytes);
}

TEST_F(Files, FoldersAreMadeWithin) {
  make_folders_within(folder_, "a/b");
  make_folders_within(folder_, "a/b");
  EXPECT_TRUE(fs::is_directory(folder_ / "a/b"));
  fs::create_directory(folder_ / "elsewhere");
  fs::create_directory_symlink(folder_ / "elsewhere", folder_ / "a/link");
  EXPECT_THROW(make_folders_within(folder_ / "a", "link"), IoError);
  EXPECT_THROW(make_folders_within(folder_ / "a", "link/c"), IoError);
  EXPECT_TRUE(fs::is_empty(folder_ / "elsewhere"));
  write_file(folder_ / "file", "");
  EXPECT_THROW(make_folders_within(folder_, "file"), IoError);
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
  // As Python writes them: text, which is no number where one is expected.
  EXPECT_EQ(parse_json(R"({"NaN": [NaN, -Infinity, "a \" NaN"], "b": Infinity})", "a.json").dump(),
            R"({"NaN":["NaN","-Infinity","a \" NaN"],"b":"Infinity"})");
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

TEST(ParseJson, BracketsInStringsAreNoLevels) {
  const std::string text = R"(["\"[[)" + std::string(100, '[') + R"(", {"\\": 1}])";
  EXPECT_EQ(parse_json(text, "a.json").size(), 2u);
}

// With time in the square of their number these take an hour.
TEST(ParseJson, ManyObjectsTakeLinearTime) {
  std::string text = "{\"first\": {}";
  for (int i = 0; i < 500'000; ++i) text += ",\n\"" + std::to_string(i) + "\": {\"x\": [1]}";
  EXPECT_EQ(parse_json(text + "}", "a.json").size(), 500'001u);
}

TEST_F(Files, ExtensionsAreComparedWithoutCase) {
  EXPECT_TRUE(has_extension("a/B.JPG", {".png", ".jpg"}));
  EXPECT_TRUE(has_extension("x.png", {".png", ".jpg"}));
  EXPECT_FALSE(has_extension("x.png.part", {".png", ".jpg"}));
  EXPECT_FALSE(has_extension("png", {".png"}));
}

}  // namespace
}  // namespace redrive
