// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/mcap.h"

#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/formats/rosbag/mcap_testing.h"

namespace redrive::rosbag {
namespace {

using ::testing::HasSubstr;
using testing::input_error;
using testing::McapWriter;

std::string data_of(int i) {
  return "message " + std::to_string(i) + std::string(600, char('a' + i % 26));
}

/// A file of two topics with 20 messages each, in several chunks.
std::string file_with(McapWriter::Options options) {
  McapWriter writer(options);
  const auto a = writer.channel("/a", "std_msgs/msg/String", "string data"),
             b = writer.channel("/b", "std_msgs/msg/String", "string data");
  for (int i = 0; i < 40; ++i) writer.message(i % 2 == 0 ? a : b, 1000 + i, data_of(i));
  return writer.finish();
}

std::unique_ptr<BagFile> opened_mcap(const std::string& text) {
  return open_mcap(std::make_unique<StringBytes>(text), "a.mcap");
}

std::string findings_of(const BagFile& file) {
  std::string all;
  for (const Finding& finding : file.findings())
    all += finding.subject + ": " + finding.what + "\n";
  return all;
}

std::string read_message(const BagFile& file, const Message& message,
                         std::size_t most = kAllBytes) {
  std::string out;
  file.read(std::span(&message, 1), most,
            [&](std::size_t, std::string_view bytes) { out = bytes; });
  return out;
}

void expect_all_messages(const BagFile& file, const std::string& what) {
  ASSERT_EQ(file.topics().size(), 2u) << what;
  for (int t = 0; t < 2; ++t) {
    const Topic& topic = file.topics()[std::size_t(t)];
    EXPECT_EQ(topic.name, t == 0 ? "/a" : "/b") << what;
    EXPECT_EQ(topic.type, "std_msgs/msg/String") << what;
    EXPECT_EQ(topic.encoding, "cdr") << what;
    EXPECT_EQ(topic.schema, "string data") << what;
    ASSERT_EQ(topic.messages.size(), 20u) << what;
    for (int i = 0; i < 20; ++i) {
      const Message& message = topic.messages[std::size_t(i)];
      EXPECT_EQ(message.log_ns, 1000 + 2 * i + t) << what;
      EXPECT_EQ(read_message(file, message), data_of(2 * i + t)) << what;
      EXPECT_EQ(read_message(file, message, 12), data_of(2 * i + t).substr(0, 12)) << what;
      EXPECT_EQ(read_message(file, message, 1 << 20), data_of(2 * i + t)) << what;
    }
  }
}

TEST(Mcap, ReadsEachWayOfWriting) {
  for (const std::string compression : {"", "lz4", "zstd"})
    for (const std::size_t chunk : {0, 3000})
      for (const bool summary : {true, false})
        for (const bool index : {true, false}) {
          const std::string what = compression + " " + std::to_string(chunk) + " " +
                                   std::to_string(summary) + std::to_string(index);
          const auto file = opened_mcap(file_with({.compression = compression,
                                                   .chunk_bytes = chunk,
                                                   .summary = summary,
                                                   .message_index = index}));
          expect_all_messages(*file, what);
          EXPECT_EQ(findings_of(*file).empty(), summary) << what << findings_of(*file);
        }
}

TEST(Mcap, CountsWhatIsCutOff) {
  const std::string whole = file_with({.compression = "lz4", .chunk_bytes = 3000});
  for (const std::size_t cut : {whole.size() - 1, whole.size() * 3 / 4, whole.size() / 3}) {
    const auto file = opened_mcap(whole.substr(0, cut));
    EXPECT_THAT(findings_of(*file), HasSubstr("no summary")) << cut;
    std::size_t messages = 0;
    for (const Topic& topic : file->topics()) messages += topic.messages.size();
    EXPECT_GT(messages, 5u) << cut;
    for (const Topic& topic : file->topics())
      for (const Message& message : topic.messages)
        EXPECT_THAT(read_message(*file, message), HasSubstr("message"));
  }
  EXPECT_THAT(findings_of(*opened_mcap(whole.substr(0, whole.size() / 2))),
              HasSubstr("at its end are cut off and not read"));
}

TEST(Mcap, ChecksCrcs) {
  for (const std::string compression : {"", "lz4"}) {
    std::string text = file_with({.compression = compression, .chunk_bytes = 3000});
    const std::size_t at = text.find("message 0");
    ASSERT_NE(at, text.npos);
    text[at + 3] = 'b';
    const auto file = opened_mcap(text);
    EXPECT_THAT(input_error([&] { read_message(*file, file->topics()[0].messages[0]); }),
                AllOf(HasSubstr("a.mcap"), HasSubstr("CRC")));
    EXPECT_THAT(read_message(*file, file->topics()[0].messages[19]), HasSubstr("message 38"));
  }
  std::string text = file_with({.compression = "", .chunk_bytes = 3000});
  text[text.rfind("std_msgs")] = 'S';
  const auto walked = opened_mcap(text);
  EXPECT_THAT(findings_of(*walked), HasSubstr("the CRC of its summary is wrong"));
  expect_all_messages(*walked, "walked");
}

TEST(Mcap, NamesWrongLengths) {
  EXPECT_THAT(input_error([] { opened_mcap(""); }), HasSubstr("is empty"));
  EXPECT_THAT(input_error([] { opened_mcap("SQLite format 3"); }), HasSubstr("is no MCAP"));
  const std::string good = file_with({.compression = "lz4", .chunk_bytes = 3000, .crc = false});
  // The last chunk's index, from its end: sizes of the records, unpacked and packed.
  const std::size_t end = good.size() - 8 - 29;
  for (const auto& [back, rule] : {std::pair{8, "at most 2^30"}, {16, "do not fit the file"}}) {
    std::string text = good;
    text[end - std::size_t(back) + 5] = '\x10';
    EXPECT_THAT(input_error([&] { opened_mcap(text); }), HasSubstr(rule));
  }
  std::string unknown = good;
  unknown.replace(unknown.rfind("lz4"), 3, "lz5");
  EXPECT_THAT(input_error([&] { opened_mcap(unknown); }),
              AllOf(HasSubstr("compression"), HasSubstr("lz5")));
  std::string message = file_with({.compression = "", .chunk_bytes = 3000, .crc = false});
  message[message.find("message 0") - 22 - 8 + 2] = '\x7f';
  const auto file = opened_mcap(message);
  EXPECT_THAT(input_error([&] { read_message(*file, file->topics()[0].messages[0]); }),
              HasSubstr("is longer than what holds it"));
}

TEST(Mcap, NamesMissingSchemasAndChannels) {
  McapWriter writer({.chunk_bytes = 3000});
  const auto a = writer.channel("/a", "std_msgs/msg/String", "");
  writer.message(a, 5, "x");
  writer.message(77, 6, "y");
  const auto file = opened_mcap(writer.finish());
  EXPECT_THAT(findings_of(*file), AllOf(HasSubstr("the schema is missing of /a"),
                                        HasSubstr("1 message of channels that it does not list")));
}

}  // namespace
}  // namespace redrive::rosbag
