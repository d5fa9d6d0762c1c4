// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/moving_file.h"

#include <string>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive {
namespace {

TEST(MovingFile, IsReadAsItWasWritten) {
  const TemporaryFolder folder;
  MovingObject object;
  object.id = -3;
  object.size_m = {4.25, 1.75, 1.5};
  for (int k = 0; k < 4; ++k) {
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = Eigen::AngleAxisd(0.1 * k, Eigen::Vector3d::UnitZ()).matrix();
    pose.translation() = Eigen::Vector3d(0.1 * k, 2, 0.75);
    object.keys.push_back({1'000'000'000 + k * 100'000'000ll, pose, Eigen::Vector3d::Zero()});
  }
  const std::filesystem::path file = folder.path / "moving.json";
  EXPECT_TRUE(read_moving_file(file).empty());
  write_moving_file(file, {object});
  const auto read = read_moving_file(file);
  ASSERT_EQ(read.size(), 1u);
  EXPECT_EQ(read[0].id, -3);
  EXPECT_EQ(read[0].size_m, object.size_m);
  ASSERT_EQ(read[0].keys.size(), 4u);
  for (int k = 0; k < 4; ++k) {
    EXPECT_EQ(read[0].keys[k].t_ns, object.keys[k].t_ns);
    // Sine and cosine of an angle in degrees and back.
    EXPECT_TRUE(read[0].keys[k].world_from_box.isApprox(object.keys[k].world_from_box, 1e-11));
    EXPECT_NEAR(read[0].keys[k].velocity_in_world_m_per_s.x(), 1, 1e-12);
  }
}

TEST(MovingFile, HasTheSameBitsWhenItIsWrittenAgain) {
  std::vector<MovingObject> objects(1);
  objects[0].id = -1;
  objects[0].size_m = {4.25, 1.75, 1.5};
  for (int k = 0; k < 200; ++k) {
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = Eigen::AngleAxisd(0.0314159 * k - 3, Eigen::Vector3d::UnitZ()).matrix();
    pose.translation() = Eigen::Vector3d(k / 3.0, -k / 7.0, 0.75);
    objects[0].keys.push_back({1'000'000'000 + k * 100'000'000ll, pose, Eigen::Vector3d::Zero()});
  }
  const auto once = as_in_moving_file(objects), twice = as_in_moving_file(once);
  for (std::size_t k = 0; k < once[0].keys.size(); ++k) {
    EXPECT_EQ(once[0].keys[k].world_from_box.matrix(), twice[0].keys[k].world_from_box.matrix());
    EXPECT_EQ(once[0].keys[k].velocity_in_world_m_per_s,
              twice[0].keys[k].velocity_in_world_m_per_s);
  }
}

TEST(MovingFile, RejectsWhatCannotBeAnObject) {
  const auto parse = [](const std::string& objects) {
    return parse_moving_objects(R"({"objects": [)" + objects + "]}", "moving.json");
  };
  const std::string begin = R"({"id": -1, "size_m": [4, 2, 1], "keys": [)",
                    key = R"({"t_ns": 5, "position_m": [1, 2, 3], "yaw_deg": 4})";
  EXPECT_EQ(parse("").size(), 0u);
  EXPECT_EQ(parse(begin + key + "]}").size(), 1u);
  for (const std::string& bad :
       {begin + "]}", begin + key + "," + key + "]}",                        // no key, no order
        begin + key + "]}," + begin + key + "]}",                            // twice
        begin + R"({"t_ns": -5, "position_m": [1, 2, 3], "yaw_deg": 4}]})",  //
        begin + R"({"t_ns": 5, "position_m": [1, 2], "yaw_deg": 4}]})",      //
        begin + R"({"t_ns": 5, "position_m": [1, 2, 3], "yaw_deg": 400}]})",
        std::string(R"({"id": -1, "size_m": [4, -2, 1], "keys": [)") + key + "]}"})
    EXPECT_THROW(parse(bad), InputError) << bad;
  EXPECT_THROW(parse_moving_objects("[]", "moving.json"), InputError);
}

}  // namespace
}  // namespace redrive
