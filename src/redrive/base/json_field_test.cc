// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/json_field.h"

#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"

namespace redrive {
namespace {

std::string message_of(const std::function<void()>& action) {
  try {
    action();
  } catch (const InputError& error) {
    return error.what();
  }
  return "no error";
}

class JsonFieldTest : public ::testing::Test {
 protected:
  const nlohmann::json json_ =
      parse_json(R"({"CAM": {"f": [1, 2.5], "n": 7, "x": 7.5, "whole": 3.0, "s": "mei",
    "big": 18446744073709551615, "m": [[1,2,3,4],[5,6,7,8],[9,10,11,12],[0,0,0,1]],
      "ragged": [[1],[2],[3],[4]]}})",
                 "c.json");
  const JsonField root_{json_, "c.json"};
  const JsonField cam_ = root_.at("CAM");
};

TEST_F(JsonFieldTest, ReadsValues) {
  EXPECT_TRUE(root_.has("CAM"));
  EXPECT_FALSE(root_.has("X"));
  EXPECT_FALSE(cam_.at("n").has("X"));
  EXPECT_EQ(cam_.at("f").numbers(2), (std::vector<double>{1, 2.5}));
  EXPECT_EQ(cam_.at("f").size(), 2u);
  EXPECT_EQ(cam_.at("f").at(1).number(), 2.5);
  EXPECT_EQ(cam_.at("f").at(1).field(), "CAM.f[1]");
  EXPECT_EQ(cam_.at("n").integer(), 7);
  EXPECT_EQ(cam_.at("n").number(), 7.0);
  EXPECT_EQ(cam_.at("whole").integer(), 3);
  EXPECT_EQ(cam_.at("s").string(), "mei");
  EXPECT_EQ(root_.keys(), (std::vector<std::string>{"CAM"}));
  const Eigen::Matrix4d m = cam_.at("m").matrix4();
  EXPECT_EQ(m(0, 3), 4);
  EXPECT_EQ(m(1, 0), 5);
}

TEST_F(JsonFieldTest, ErrorsNameFileFieldAndValue) {
  EXPECT_EQ(message_of([&] { cam_.at("k"); }), "c.json: CAM.k: missing");
  EXPECT_EQ(message_of([&] { cam_.at("s").number(); }),
            "c.json: CAM.s = \"mei\": a number was expected");
  EXPECT_EQ(message_of([&] { cam_.at("x").integer(); }),
            "c.json: CAM.x = 7.5: an integer was expected");
  EXPECT_EQ(message_of([&] { cam_.at("big").integer(); }),
            "c.json: CAM.big = 18446744073709551615: too large");
  EXPECT_EQ(message_of([&] { cam_.at("n").string(); }), "c.json: CAM.n = 7: a string was expected");
  EXPECT_EQ(message_of([&] { cam_.at("f").numbers(3); }),
            "c.json: CAM.f = [1,2.5]: an array of 3 numbers was expected");
  EXPECT_EQ(message_of([&] { cam_.at("f").at(2); }),
            "c.json: CAM.f = [1,2.5]: has 2 elements, more were expected");
  EXPECT_EQ(message_of([&] { cam_.at("n").at(0); }), "c.json: CAM.n = 7: an array was expected");
  EXPECT_EQ(message_of([&] { cam_.at("n").at("k"); }), "c.json: CAM.n = 7: an object was expected");
  EXPECT_EQ(message_of([&] { cam_.at("n").keys(); }), "c.json: CAM.n = 7: an object was expected");
  EXPECT_EQ(message_of([&] { cam_.at("n").size(); }),
            "c.json: CAM.n = 7: an array or object was expected");
  EXPECT_EQ(message_of([&] { cam_.at("ragged").matrix4(); }),
            "c.json: CAM.ragged[0] = [1]: an array of 4 numbers was expected");
  EXPECT_EQ(message_of([&] { cam_.at("f").matrix4(); }),
            "c.json: CAM.f = [1,2.5]: a 4x4 matrix (four rows) was expected");
}

TEST_F(JsonFieldTest, ErrorsTruncateLongValuesAndEscapeBadUtf8) {
  const nlohmann::json json = std::string(500, '\xff');
  EXPECT_LT(message_of([&] { JsonField(json, "c.json").number(); }).size(), 200u);
}

}  // namespace
}  // namespace redrive
