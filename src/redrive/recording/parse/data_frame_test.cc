// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/data_frame.h"

#include <cmath>

#include "redrive/base/files/files.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/parse/data_frame_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::input_error;
using testing::PickledTable;

std::string error_of(const std::string& pickle) {
  return input_error([&] { DataFrame(pickle, "t.pkl"); });
}

/// A pickle of protocol 4 that makes an object of the global.
std::string call(const std::string& module, const std::string& name) {
  const auto text = [](const std::string& of) {
    return "\x8c" + std::string(1, static_cast<char>(of.size())) + of;
  };
  return "\x80\x04" + text(module) + text(name) + "\x93)R.";
}

std::string made_table() {
  PickledTable table;
  table.add("x", std::vector<double>{1.5, -2.25});
  table.add("d", std::vector<std::int64_t>{0, -1});
  table.add("label", std::vector<std::string>{"Car", "Bus"});
  return table.pickle();
}

// The files were written by pandas 1.5.3 and numpy 1.24, and with the state that pandas 1.0 keeps.
TEST(DataFrame, ReadsWhatPandasWrites) {
  for (const std::string name : {"1.0_protocol_2", "1.0_protocol_3", "1.5_protocol_2",
                                 "1.5_protocol_3", "1.5_protocol_4", "1.5_protocol_5"}) {
    SCOPED_TRACE(name);
    const std::string pickle =
        read_file(REDRIVE_SOURCE "/fuzz/corpus/data_frame/pandas_" + name + ".pkl");
    const DataFrame table(pickle, "t.pkl");
    ASSERT_EQ(table.rows(), 3u);
    EXPECT_EQ(table.numbers("x")[0], 1.5);
    EXPECT_EQ(table.numbers("x")[1], -2.25);
    EXPECT_TRUE(std::isnan(table.numbers("x")[2]));
    EXPECT_THAT(table.numbers("y"), ElementsAre(4, 5, 6));
    EXPECT_THAT(table.numbers("d"), ElementsAre(0, 1, -1));
    EXPECT_THAT(table.numbers("parked"), ElementsAre(1, 0, 1));
    EXPECT_THAT(table.texts("label"), ElementsAre("Car", "", "Bus"));
    EXPECT_FALSE(table.has("z"));
  }
  const std::string columns_first =
      read_file(REDRIVE_SOURCE "/fuzz/corpus/data_frame/columns_first.pkl");
  const DataFrame table(columns_first, "t.pkl");
  EXPECT_THAT(table.numbers("a"), ElementsAre(0, 2, 4));
  EXPECT_THAT(table.numbers("b"), ElementsAre(1, 3, 5));
}

TEST(DataFrame, ReadsWhatTheTestsWrite) {
  const std::string pickle = made_table();
  const DataFrame table(pickle, "t.pkl");
  EXPECT_THAT(table.numbers("x"), ElementsAre(1.5, -2.25));
  EXPECT_THAT(table.numbers("d"), ElementsAre(0, -1));
  EXPECT_THAT(table.texts("label"), ElementsAre("Car", "Bus"));
  EXPECT_THAT(input_error([&] { table.texts("x"); }), HasSubstr("x: the column must hold texts"));
  EXPECT_THAT(input_error([&] { table.numbers("label"); }), HasSubstr("must hold numbers"));
  EXPECT_THAT(input_error([&] { table.numbers("y"); }), HasSubstr("there is no such column"));
}

TEST(DataFrame, RefusesAllOtherObjects) {
  EXPECT_THAT(error_of(call("os", "system")),
              AllOf(HasSubstr("t.pkl: opcode 0x93 at byte 14"), HasSubstr("os system"),
                    HasSubstr("a pickle is read as data")));
  EXPECT_THAT(error_of("\x80\x02"
                       "cbuiltins\neval\n."),
              HasSubstr("builtins eval"));
  EXPECT_THAT(error_of(call("pandas.core.indexes.base", "Index")), HasSubstr("is no DataFrame"));
}

TEST(DataFrame, NamesOpcodeAndByteOfWhatCannotBe) {
  EXPECT_THAT(error_of(""), HasSubstr("at byte 0: goes on behind the end"));
  EXPECT_THAT(error_of("\x80\x01N."), AllOf(HasSubstr("at byte 0"), HasSubstr("protocols 2 to 5")));
  EXPECT_THAT(error_of("\x80\x03P1\n."), HasSubstr("opcode 0x50 at byte 2: is no opcode"));
  EXPECT_THAT(error_of("\x80\x03."), HasSubstr("takes a value from an empty stack"));
  EXPECT_THAT(error_of("\x80\x03Nt."), HasSubstr("has no mark before it"));
  EXPECT_THAT(error_of("\x80\x03(0."), HasSubstr("takes a value from an empty stack"));
  EXPECT_THAT(error_of("\x80\x03"
                       "a."),
              HasSubstr("empty stack"));
  EXPECT_THAT(error_of("\x80\x03NNa."), HasSubstr("needs a list on the stack"));
  EXPECT_THAT(error_of("\x80\x03}(Nu."), HasSubstr("has a key without a value"));
  EXPECT_THAT(error_of("\x80\x03h\x07."), HasSubstr("no value was kept under this number"));
  EXPECT_THAT(error_of("\x80\x03NNb."), HasSubstr("needs an object on the stack"));
  EXPECT_THAT(error_of("\x80\x03X\xff\xff\xff\x7f."), HasSubstr("(truncated?)"));
  const std::string whole = made_table();
  for (const std::size_t size : {whole.size() / 3, whole.size() / 2, whole.size() - 1})
    EXPECT_THAT(error_of(whole.substr(0, size)), HasSubstr("t.pkl")) << size;
}

TEST(DataFrame, TakesNoMoreThanTheFileHas) {
  const auto with = [](const std::string& from, const std::string& to) {
    std::string pickle = made_table();
    pickle.replace(pickle.find(from), from.size(), to);
    return error_of(pickle);
  };
  EXPECT_THAT(with("f8", "f4"), AllOf(HasSubstr("16 bytes"), HasSubstr("its shape needs 8")));
  EXPECT_THAT(with("f8", "c8"), HasSubstr("dtype = c8"));
  EXPECT_THAT(with(std::string("J\x02\0\0\0", 5), std::string("J\0\0\0\x7f", 5)),
              HasSubstr("shape = 2130706432"));
  EXPECT_THAT(with(std::string("J\0\0\0\0J\x01", 7), std::string("J\x03\0\0\0J\x01", 7)),
              HasSubstr("mgr_locs = 3"));
}

}  // namespace
}  // namespace redrive
