// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/seam_exposure.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/methods/grid/tiny_grid_model_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

/// An image of camera 0 whose log gains are x_a + g in one block and x_b + g in the other.
SharedImage image_of(int a, double x_a, int b, double x_b, double g) {
  const auto gains = [&](double x) { return LogGains{x + g, 2 * x + g, -x + g}; };
  return {0, a, b, gains(x_a), gains(x_b)};
}

TEST(SeamExposure, FindsTheFactorOfEachBlock) {
  // Their mean is 0, as the solution's is.
  const double x[] = {0.3, -0.1, -0.2};
  std::vector<SharedImage> images;
  for (const double g : {-0.5, 0.0, 0.4}) {
    images.push_back(image_of(0, x[0], 1, x[1], g));
    images.push_back(image_of(1, x[1], 2, x[2], g));
  }
  const SeamExposure found = solve_seam_exposure({"F"}, 3, images);
  for (int b = 0; b < 3; ++b) {
    EXPECT_NEAR(found.of(b, "F")[0], x[b], 1e-12);
    EXPECT_NEAR(found.of(b, "F")[1], 2 * x[b], 1e-12);
    EXPECT_NEAR(found.of(b, "F")[2], -x[b], 1e-12);
  }
}

TEST(SeamExposure, AveragesImagesThatDisagree) {
  const SeamExposure found =
      solve_seam_exposure({"F"}, 2, {image_of(0, 0.1, 1, 0, 0), image_of(0, 0.3, 1, 0, 0)});
  EXPECT_NEAR(found.of(0, "F")[0] - found.of(1, "F")[0], 0.2, 1e-12);
}

TEST(SeamExposure, SumsToZeroInEachGroupOfBlocks) {
  // Blocks 0 and 1 share an image, 2 and 3 do, 4 shares none.
  const SeamExposure found =
      solve_seam_exposure({"F", "B"}, 5, {image_of(0, 0.4, 1, 0, 0), image_of(2, 0.2, 3, 0, 0.1)});
  EXPECT_NEAR(found.of(0, "F")[0], 0.2, 1e-12);
  EXPECT_NEAR(found.of(1, "F")[0], -0.2, 1e-12);
  EXPECT_NEAR(found.of(2, "F")[0], 0.1, 1e-12);
  EXPECT_NEAR(found.of(3, "F")[0], -0.1, 1e-12);
  EXPECT_NEAR(found.of(4, "F")[0], 0, 1e-12);
  EXPECT_EQ(found.of(0, "B"), LogGains{}) << "no image of that camera is shared";
  EXPECT_EQ(found.of(0, "other"), LogGains{});
}

TEST(ImageLogGains, AreInterpolatedBetweenKnots) {
  GridModel model;
  make_tiny(model);
  const std::vector<ModelTensor> tensors = model.tensors();
  const auto tensor = std::ranges::find(tensors, "appearance", &ModelTensor::name);
  ASSERT_NE(tensor, tensors.end());
  // [cameras, knots, 3]: knots 0 and 1 of camera 1, a log gain is 0.05 times its parameter.
  float* const knots = model.parameters.data() + tensor->offset + 3 * model.appearance.knots;
  for (int k = 0; k < 3; ++k) {
    knots[k] = 0;
    knots[3 + k] = static_cast<float>(4 * k);
  }
  const LogGains at_knot = image_log_gains(model, {1, 0.5f}),
                 between = image_log_gains(model, {1, 0.25f});
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(at_knot[k], 0.2 * k, 1e-6);
    EXPECT_NEAR(between[k], 0.1 * k, 1e-6);
  }
  EXPECT_EQ(image_log_gains(model, {-1, 0}), LogGains{});
}

TEST(SeamExposure, IsWrittenAndRead) {
  const TemporaryFolder folder;
  EXPECT_EQ(read_seam_exposure(folder.path, 2).of(1, "F"), LogGains{}) << "no file yet";
  SeamExposure written = {{"F", "B"},
                          {{{0.1, 1.0 / 3, 0}, {0, 0, 0}}, {{-0.1, 0, 0}, {1, 2, 3}}},
                          {{1, {{-0.1f, 0.7f}}}, {0.3f, {}}}};
  written.lidar_gains[1].blind.insert(77);
  write_seam_exposure(folder.path, written);
  const SeamExposure read = read_seam_exposure(folder.path, 2);
  EXPECT_EQ(read.cameras, written.cameras);
  EXPECT_EQ(read.log_gains, written.log_gains);
  EXPECT_EQ(read.lidar_gains, written.lidar_gains);
}

TEST(SeamExposure, BadFilesAreNamed) {
  const auto error_of = [](const std::string& text) -> std::string {
    try {
      parse_seam_exposure(text, "RUN/exposure.json", 1);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  const auto with = [](const std::string& cameras, const std::string& log_gains) {
    return R"({"format": "redrive-exposure-1", "cameras": )" + cameras + R"(, "log_gains": )" +
           log_gains + "}";
  };
  EXPECT_EQ(error_of(with(R"(["F"])", "[[[0, 0, 0]]]")), "");
  EXPECT_THAT(error_of(R"({"format": "x"})"), HasSubstr("format"));
  EXPECT_THAT(error_of(with(R"(["F", "F"])", "[[]]")), HasSubstr("cameras[1]"));
  EXPECT_THAT(error_of(with(R"(["F"])", "[]")), HasSubstr("log_gains"));
  EXPECT_THAT(error_of(with(R"(["F"])", "[[]]")), HasSubstr("log_gains[0]"));
  EXPECT_THAT(error_of(with(R"(["F"])", "[[[0, 0]]]")), HasSubstr("log_gains[0][0]"));
  EXPECT_THAT(error_of(with(R"(["F"])", "[[[0, 0, 99]]]")), HasSubstr("log_gains[0][0]"));
}

}  // namespace
}  // namespace redrive
