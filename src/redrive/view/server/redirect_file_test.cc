// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/server/redirect_file.h"

#include <sys/stat.h>

#include <optional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"

namespace redrive::view {
namespace {

TEST(RedirectFileTest, IsReadByThisUserAloneAndGoesInTheEnd) {
  const std::string address = "http://127.0.0.1:7007/0123456789abcdef/";
  std::optional<RedirectFile> file(std::in_place, address), other(std::in_place, address);
  EXPECT_NE(file->path(), other->path());
  struct stat status {};
  ASSERT_EQ(stat(file->path().c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0600u);
  EXPECT_THAT(read_file(file->path()), testing::HasSubstr("0; url=" + address + "\""));
  const std::filesystem::path path = file->path();
  file.reset();
  EXPECT_FALSE(std::filesystem::exists(path));
}

}  // namespace
}  // namespace redrive::view
