// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/arrow_table.h"

#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/parse/arrow_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using testing::ArrowFile;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::input_error;

const std::optional<arrow::Codec> kCodecs[] = {std::nullopt, arrow::Codec::kLz4Frame,
                                               arrow::Codec::kZstd};

// The file was written by apache-arrow 21 for JavaScript.
TEST(ArrowTable, ReadsWhatAnotherProgramWrites) {
  const std::string file = REDRIVE_SOURCE "/fuzz/corpus/arrow/javascript.feather",
                    bytes = read_file(file);
  const ArrowTable table(bytes, "t.feather");
  ASSERT_EQ(table.rows(), 3u);
  EXPECT_EQ(table.numbers("x")[1], -2.25);
  EXPECT_TRUE(std::isnan(table.numbers("x")[2]));
  EXPECT_THAT(table.numbers("h"), ElementsAre(0.5, -3, 1024));
  EXPECT_THAT(table.numbers("s"), ElementsAre(0.25, 8, -1));
  EXPECT_THAT(table.numbers("i"), ElementsAre(-1, 2, 300));
  EXPECT_THAT(table.integers("t"), ElementsAre(315966253572412942, 0, -5));
  EXPECT_EQ(table.numbers("u")[0], 18446744073709551616.0);
  EXPECT_THAT(table.integers("b"), ElementsAre(1, 0, 1));
  EXPECT_THAT(table.texts("label"), ElementsAre("Car", "", "Fußgänger"));
  EXPECT_THAT(table.texts("kind"), ElementsAre("A", "B", "A"));
  EXPECT_FALSE(table.has("z"));
  EXPECT_EQ(arrow_rows(file), 3u);
}

TEST(ArrowTable, ReadsEachTypeFromEachCodecAndBatch) {
  std::vector<double> doubles;
  std::vector<float> floats;
  std::vector<Eigen::half> halves;
  std::vector<std::int64_t> longs;
  std::vector<std::uint8_t> bytes;
  std::vector<bool> bools;
  std::vector<std::string> texts;
  for (int i = 0; i < 257; ++i) {
    doubles.push_back(0.1 * i);
    floats.push_back(0.1f * float(i));
    halves.push_back(Eigen::half(float(i) / 8));
    longs.push_back(315966253572412942 - i);
    bytes.push_back(static_cast<std::uint8_t>(i % 256));
    bools.push_back(i % 3 == 0);
    texts.push_back(i % 5 == 0 ? "" : "word" + std::to_string(i % 7));
  }
  for (const auto& codec : kCodecs)
    for (const std::size_t batches : {1u, 3u}) {
      ArrowFile file(codec, batches);
      file.add("double", doubles);
      file.leave_out({0, 200});
      file.add("float", floats);
      file.add("half", halves);
      file.add_other("fixed", arrow::Type::Decimal, doubles.size());
      file.add("long", longs);
      file.add("byte", bytes);
      file.add("bool", bools);
      file.add("text", texts);
      file.leave_out({3});
      file.add("word", texts);
      file.make_dictionary();
      const std::string written = file.bytes();
      const ArrowTable table(written, "t.feather");
      ASSERT_EQ(table.rows(), 257u);
      const auto read = table.numbers("double");
      const auto read_texts = table.texts("text");
      for (std::size_t i = 0; i < 257; ++i) {
        if (i == 0 || i == 200)
          EXPECT_TRUE(std::isnan(read[i]));
        else
          EXPECT_EQ(read[i], doubles[i]);
        EXPECT_EQ(read_texts[i], i == 3 ? "" : texts[i]);
      }
      EXPECT_EQ(table.numbers("float"), std::vector<double>(floats.begin(), floats.end()));
      EXPECT_EQ(table.numbers("half"), std::vector<double>(halves.begin(), halves.end()));
      EXPECT_EQ(table.integers("long"), longs);
      EXPECT_EQ(table.integers("byte"), std::vector<std::int64_t>(bytes.begin(), bytes.end()));
      EXPECT_EQ(table.numbers("bool"), std::vector<double>(bools.begin(), bools.end()));
      EXPECT_EQ(table.texts("word"), texts);
    }
}

TEST(ArrowTable, NamesTheColumnThatCannotBeRead) {
  ArrowFile file(std::nullopt);
  file.add("x", std::vector<double>{1, 2});
  file.leave_out({1});
  file.add_other("when", arrow::Type::Date, 2);
  file.add("n", std::vector<std::int64_t>{1, 2});
  file.leave_out({0});
  file.add("big", std::vector<std::uint64_t>{~std::uint64_t{0}, 1});
  const std::string bytes = file.bytes();
  const ArrowTable table(bytes, "t.feather");
  EXPECT_THAT(input_error([&] { table.numbers("y"); }),
              HasSubstr("t.feather: y: there is no such column"));
  EXPECT_THAT(input_error([&] { table.texts("x"); }),
              HasSubstr("x = FloatingPoint: the column must hold texts"));
  EXPECT_THAT(input_error([&] { table.integers("x"); }), HasSubstr("must hold integers"));
  EXPECT_THAT(input_error([&] { table.numbers("when"); }), HasSubstr("when = Date"));
  EXPECT_THAT(input_error([&] { table.integers("n"); }), HasSubstr("n = row 0: has no value"));
  EXPECT_THAT(input_error([&] { table.integers("big"); }),
              HasSubstr("big = 18446744073709551615: at most"));
}

TEST(ArrowTable, RefusesWhatIsNoWholeFile) {
  const auto error = [](const std::string& bytes) {
    return input_error([&] {
      const ArrowTable table(bytes, "t.feather");
      table.numbers("x");
    });
  };
  ArrowFile file;
  file.add("x", std::vector<double>(100, 1.5));
  const std::string whole = file.bytes();
  EXPECT_EQ(ArrowTable(whole, "t.feather").numbers("x"), std::vector<double>(100, 1.5));
  EXPECT_THAT(error(""), HasSubstr("does not begin with ARROW1"));
  EXPECT_THAT(error("FEA1" + whole), HasSubstr("Feather, version 1"));
  EXPECT_THAT(error(whole.substr(0, whole.size() - 1)), HasSubstr("truncated"));
  EXPECT_THAT(error(whole.substr(0, 8) + whole.substr(whole.size() - 300)),
              HasSubstr("record batch"));
  std::string damaged = whole;
  const std::size_t frame = whole.find("\x04\x22\x4d\x18");  // magic of LZ4's frames
  ASSERT_NE(frame, std::string::npos);
  damaged[frame + 20] = static_cast<char>(damaged[frame + 20] ^ 0x5a);
  EXPECT_THAT(error(damaged), HasSubstr("x: has damaged LZ4"));
  damaged = whole;
  damaged[frame - 8] = static_cast<char>(0xff);  // the size before it, which is 800
  EXPECT_THAT(error(damaged), HasSubstr("x"));
}

TEST(ArrowTable, SizesAreBounded) {
  // 1 GB of zeros in some kilobytes, as a column of 100 rows.
  ArrowFile file(arrow::Codec::kZstd);
  file.add("x", std::vector<double>(100, 0.0));
  std::string bytes = file.bytes();
  const std::size_t frame = bytes.find("\x28\xb5\x2f\xfd");
  ASSERT_NE(frame, std::string::npos);
  const std::int64_t claimed = std::int64_t{1} << 30;
  std::memcpy(bytes.data() + frame - 8, &claimed, 8);
  EXPECT_THAT(input_error([&] { ArrowTable(bytes, "t.feather").numbers("x"); }),
              AllOf(HasSubstr("x = 1073741824 bytes"), HasSubstr("its rows need only 800")));
}

TEST(ArrowTable, AnyDamagedByteIsReadOrNamed) {
  ArrowFile file(arrow::Codec::kLz4Frame, 2);
  file.add("x", std::vector<double>(50, 1.5));
  file.add("t", std::vector<std::string>(50, "text"));
  file.make_dictionary();
  const std::string whole = file.bytes();
  for (std::size_t i = 0; i < whole.size(); ++i)
    for (const int flip : {0x01, 0x80, 0xff}) {
      std::string bytes = whole;
      bytes[i] = static_cast<char>(bytes[i] ^ flip);
      try {
        const ArrowTable table(bytes, "t.feather");
        EXPECT_EQ(table.numbers("x").size(), table.rows());
        EXPECT_EQ(table.texts("t").size(), table.rows());
      } catch (const InputError&) {
      }
    }
}

}  // namespace
}  // namespace redrive
