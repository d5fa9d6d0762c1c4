// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/zarr_store.h"

#include <gtest/gtest.h>

#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/base/files/zarr_testing.h"

namespace redrive {
namespace {

using nlohmann::json;

TEST(ZarrStore, HasGroupsArraysAndFiles) {
  const TemporaryFolder folder;
  const auto path = folder.path / "a.zarr.itar";
  std::vector<float> values;
  for (int i = 0; i < 6000; ++i) values.push_back(0.25f * static_cast<float>(i % 300));
  const std::string picture("\0picture", 8);
  ZarrStore out(path);
  out.array("a/b/values", "<f4", {2000, 3}, values, {{"unit", "m"}});
  out.file("a/picture", picture, {{"format", "png"}});
  out.group("a", {{"name", "A"}});
  out.finish();

  const WalkedStore store(path);
  for (const char* group : {"", "a/", "a/b/"})
    EXPECT_EQ(store.json(std::string(group) + ".zgroup"), json({{"zarr_format", 2}}));
  EXPECT_FALSE(store.members.contains(".zattrs"));
  EXPECT_EQ(store.attributes("a"), json({{"name", "A"}}));
  EXPECT_EQ(store.attributes("a/b/values"), json({{"unit", "m"}}));
  EXPECT_EQ(store.array<float>("a/b/values", "<f4", {2000, 3}), values);
  EXPECT_LT(store.bytes("a/b/values/0.0").size(), 4000u) << "packed";
  EXPECT_EQ(
      store.json("a/b/values/.zarray")["compressor"],
      json({{"id", "blosc"}, {"cname", "lz4"}, {"clevel", 5}, {"shuffle", 2}, {"blocksize", 0}}));
  EXPECT_EQ(store.bytes("a/picture/0"), picture);
  const json about = store.json("a/picture/.zarray");
  EXPECT_EQ(about["dtype"], "|S8");
  EXPECT_EQ(about["shape"], json::array());
  EXPECT_TRUE(about["compressor"].is_null());
  const json all = json::from_cbor(unxz(store.bytes(".zmetadata.cbor.xz")));
  EXPECT_EQ(all["zarr_consolidated_format"], 1);
  EXPECT_EQ(all["metadata"].size(), 8u);
  EXPECT_EQ(all["metadata"]["a/b/values/.zarray"], store.json("a/b/values/.zarray"));
}

}  // namespace
}  // namespace redrive
