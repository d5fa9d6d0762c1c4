// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/indexed_tar.h"

#include <cstring>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/base/files/xz_testing.h"

namespace redrive {
namespace {

TEST(IndexedTar, TarAndIndexHaveTheMembers) {
  const TemporaryFolder folder;
  const auto path = folder.path / "a.zarr.itar";
  const std::string deep = std::string(90, 'd') + "/" + std::string(99, 'n');
  const std::map<std::string, std::string> members = {
      {".zgroup", "{}"}, {"empty", ""}, {"whole", std::string(512, 'w')}, {deep, "x"}};
  IndexedTarWriter tar(path);
  for (const auto& [name, bytes] : members) tar.add(name, bytes);
  EXPECT_FALSE(std::filesystem::exists(path)) << "before it is whole";
  tar.finish();

  const std::string file = read_file(path);
  std::size_t end = 0;
  const auto walked = walk_tar(file, &end);
  ASSERT_EQ(walked.size(), members.size());
  for (const auto& [name, bytes] : members) EXPECT_EQ(walked.at(name).bytes, bytes) << name;

  ASSERT_EQ(file.size() % 512, 0u);
  const char* const last = file.data() + file.size() - 512;
  EXPECT_EQ(std::string_view(last, 4), "itar");
  std::uint32_t type = 0, size = 0;
  std::uint64_t offset = 0;
  std::memcpy(&type, last + 4, 4);
  std::memcpy(&offset, last + 8, 8);
  std::memcpy(&size, last + 16, 4);
  EXPECT_EQ(type, 1u);
  EXPECT_EQ(offset, end);
  const nlohmann::json index = nlohmann::json::from_cbor(unxz(file.substr(offset, size)));
  ASSERT_EQ(index["items"].size(), members.size());
  for (std::size_t i = 0; i < members.size(); ++i) {
    const std::string name = index["items"][i];
    EXPECT_EQ(index["offset_datas"][i], walked.at(name).offset) << name;
    EXPECT_EQ(index["sizes"][i], members.at(name).size()) << name;
  }
}

TEST(IndexedTar, RefusesNamesThatDoNotFit) {
  const TemporaryFolder folder;
  IndexedTarWriter tar(folder.path / "a.itar");
  EXPECT_THROW(tar.add(std::string(101, 'n'), ""), IoError);
  EXPECT_THROW(tar.add(std::string(160, 'd') + "/n" + std::string(90, 'n'), ""), IoError);
}

}  // namespace
}  // namespace redrive
