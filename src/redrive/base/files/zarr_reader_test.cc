// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/zarr_reader.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zlib.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/gzip.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/base/files/zarr_store.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

template <class T>
std::string bytes_of(const std::vector<T>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}

std::string deflate(const std::string& bytes) {
  std::string out(compressBound(bytes.size()), '\0');
  uLongf size = out.size();
  compress(reinterpret_cast<Bytef*>(out.data()), &size,
           reinterpret_cast<const Bytef*>(bytes.data()), bytes.size());
  return out.substr(0, size);
}

class ZarrReaderTest : public ::testing::Test {
 protected:
  ZarrReaderTest() { folder_.write("s/.zgroup", R"({"zarr_format": 2})"); }

  /// Writes .zarray of an array "a"; `more` replaces fields.
  void describe(const std::string& dtype, const nlohmann::json& shape, const nlohmann::json& chunks,
                const nlohmann::json& more = nlohmann::json::object()) {
    nlohmann::json about = {{"zarr_format", 2}, {"dtype", dtype},       {"shape", shape},
                            {"chunks", chunks}, {"order", "C"},         {"filters", nullptr},
                            {"fill_value", 0},  {"compressor", nullptr}};
    about.update(more);
    folder_.write("s/a/.zarray", about.dump());
  }
  ZarrReader::Numbers read() const { return ZarrReader(folder_.path / "s").numbers("a"); }
  std::string error() const {
    try {
      read();
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  }

  TemporaryFolder folder_;
};

TEST_F(ZarrReaderTest, ReadsWhatTheStoreWrites) {
  const auto path = folder_.path / "a.zarr.itar";
  std::vector<float> values;
  for (int i = 0; i < 6000; ++i) values.push_back(0.25f * static_cast<float>(i % 300));
  const std::vector<std::uint64_t> times{1'600'000'000'000'001, 1'600'000'000'000'002};
  const std::string picture("\0picture", 8);
  ZarrStore out(path);
  out.array("a/b/values", "<f4", {2000, 3}, values, {{"unit", "m"}});
  out.array("a-c/times", "<u8", {2}, times);
  out.file("a/picture", picture, {{"format", "png"}});
  out.group("a", {{"name", "A"}});
  out.finish();

  const ZarrReader store(path);
  EXPECT_THAT(store.names(""), ElementsAre("a", "a-c"));
  EXPECT_THAT(store.names("a"), ElementsAre("b", "picture"));
  EXPECT_THAT(store.names("nothing"), ElementsAre());
  EXPECT_EQ(store.attributes("a")["name"], "A");
  EXPECT_TRUE(store.attributes("a-c").empty());
  const ZarrReader::Numbers read = store.numbers("a/b/values");
  EXPECT_THAT(read.shape, ElementsAre(2000, 3));
  EXPECT_EQ(read.values, std::vector<double>(values.begin(), values.end()));
  EXPECT_THAT(store.numbers("a-c/times").values,
              ElementsAre(1'600'000'000'000'001.0, 1'600'000'000'000'002.0));
  EXPECT_EQ(store.file_size("a/picture"), 8u);
  EXPECT_EQ(store.file("a/picture", 100), picture);
  EXPECT_EQ(store.file("a/picture", 3), picture.substr(0, 3));
  EXPECT_TRUE(store.has_array("a/picture"));
  EXPECT_FALSE(store.has_array("a/b"));
}

TEST_F(ZarrReaderTest, JoinsChunks) {
  // 3 x 5 in chunks of 2 x 2: the last ones reach beyond the array, one is missing.
  for (const std::string separator : {".", "/"}) {
    describe("<i2", {3, 5}, {2, 2}, {{"dimension_separator", separator}, {"fill_value", -1}});
    for (int r = 0; r < 2; ++r)
      for (int c = 0; c < 3; ++c) {
        if (r == 0 && c == 1) continue;
        std::vector<std::int16_t> chunk;
        for (int i = 0; i < 4; ++i)
          chunk.push_back(static_cast<std::int16_t>(100 * (2 * r + i / 2) + 2 * c + i % 2));
        folder_.write("s/a/" + std::to_string(r) + separator + std::to_string(c), bytes_of(chunk));
      }
    EXPECT_THAT(read().values,
                ElementsAre(0, 1, -1, -1, 4, 100, 101, -1, -1, 104, 200, 201, 202, 203, 204));
  }
}

TEST_F(ZarrReaderTest, ReadsEveryTypeAndCompressor) {
  const std::vector<std::uint8_t> small{1, 255};
  describe("|u1", nlohmann::json::array({2}), nlohmann::json::array({2}));
  folder_.write("s/a/0", bytes_of(small));
  EXPECT_THAT(read().values, ElementsAre(1, 255));
  describe("|i1", nlohmann::json::array({2}), nlohmann::json::array({2}));
  EXPECT_THAT(read().values, ElementsAre(1, -1));
  describe("<f8", nlohmann::json::array(), nlohmann::json::array());
  folder_.write("s/a/0", bytes_of(std::vector<double>{0.5}));
  EXPECT_THAT(read().values, ElementsAre(0.5));
  EXPECT_TRUE(read().shape.empty());
  const std::string bytes = bytes_of(std::vector<std::int32_t>{-7, 8, 9});
  for (const auto& [id, packed] : {std::pair("zlib", deflate(bytes)), {"gzip", gzip(bytes)}}) {
    describe("<i4", nlohmann::json::array({3}), nlohmann::json::array({3}),
             {{"compressor", {{"id", id}}}});
    folder_.write("s/a/0", packed);
    EXPECT_THAT(read().values, ElementsAre(-7, 8, 9)) << id;
    folder_.write("s/a/0", packed.substr(0, packed.size() / 2));
    EXPECT_THAT(error(), HasSubstr("a/0: is damaged")) << id;
  }
  describe("<f4", nlohmann::json::array({0, 3}), nlohmann::json::array({1, 3}));
  EXPECT_TRUE(read().values.empty());
  describe("<f4", nlohmann::json::array({2}), nlohmann::json::array({4}), {{"fill_value", "NaN"}});
  std::filesystem::remove(folder_.path / "s/a/0");
  EXPECT_TRUE(std::isnan(read().values.at(1)));
}

TEST_F(ZarrReaderTest, NamesWhatItDoesNotRead) {
  const auto says = [&](const nlohmann::json& more, const char* what) {
    describe("<f4", nlohmann::json::array({2}), nlohmann::json::array({2}), more);
    EXPECT_THAT(error(), HasSubstr(what));
  };
  says({{"dtype", ">f4"}}, "dtype = \">f4\": is not read");
  says({{"dtype", "<c8"}}, "is not read");
  says({{"order", "F"}}, "must be C");
  says({{"filters", nlohmann::json::array({{{"id", "delta"}}})}}, "filters");
  says({{"compressor", {{"id", "lzma"}}}}, "compressor.id = \"lzma\": is not read");
  says({{"zarr_format", 3}}, "must be 2");
  says({{"shape", nlohmann::json::array({1 << 30})}}, "must be at most 2^24");
  says({{"chunks", nlohmann::json::array({0})}}, "a chunk not empty");
  says({{"chunks", nlohmann::json::array({2, 2})}}, "as many sizes as shape");
  says({{"shape", nlohmann::json::array({1 << 20})}, {"chunks", nlohmann::json::array({1})}},
       "must be at most 2^16");
  says({{"fill_value", nullptr}}, "a/0: is missing");
  folder_.write("s/a/0", "short");
  says(nlohmann::json::object(), "a/0: is damaged");
  folder_.write("s/a/0", std::string(10000, 'x'));
  says(nlohmann::json::object(), "10000 bytes: is too large");
  folder_.write("s/zarr.json", "{}");
  EXPECT_THAT(error(), HasSubstr("version 3 of zarr"));
}

TEST_F(ZarrReaderTest, DamagedTars) {
  const auto path = folder_.path / "a.zarr.itar";
  ZarrStore out(path);
  out.array("a", "<f4", {2}, std::vector<float>{1, 2});
  out.finish();
  const std::string whole = read_file(path);
  const auto error_of = [&](const std::string& bytes) {
    folder_.write("a.zarr.itar", bytes);
    try {
      ZarrReader(path).numbers("a");
    } catch (const InputError& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_EQ(error_of(whole), "");
  EXPECT_THAT(error_of(whole.substr(0, whole.size() - 512)), HasSubstr("may have been cut"));
  EXPECT_THAT(error_of(""), HasSubstr("may have been cut"));
  std::string bad = whole;
  bad[whole.size() - 512 + 8] ^= 1;  // place of the index
  EXPECT_THAT(error_of(bad), HasSubstr("index"));
  bad = whole;
  bad[whole.size() - 512 + 16 + 3] = 0x7f;  // its size
  EXPECT_THAT(error_of(bad), HasSubstr("beyond the end"));
  bad = whole;
  bad[whole.size() - 512 + 4] = 9;
  EXPECT_THAT(error_of(bad), HasSubstr("must be 1"));
}

}  // namespace
}  // namespace redrive
