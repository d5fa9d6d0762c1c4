// SPDX-License-Identifier: Apache-2.0
// Masks: kept in the run, editable, and excluded from scores.
#include <nlohmann/json.hpp>

#include "redrive/image/image_io.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class EndToEndMasks : public EndToEnd {
 protected:
  EndToEndMasks() { fs::create_directory(masks_); }
  /// Writes a white mask with columns [x0, x1) black.
  static void write(const fs::path& file, int width, int height, int x0, int x1) {
    Image8 image{width, height, std::vector<std::uint8_t>(3 * width * height, 255)};
    for (int i = 0; i < 3 * width * height; ++i)
      if (i / 3 % width >= x0 && i / 3 % width < x1) image.rgb[i] = 0;
    write_image(file, image);
  }
  ProgramResult train(const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = {"--cameras", kTinyFront,    "--epochs",
                                          "1000",      "--max-steps", "3"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(train_arguments(folder_ / "run", arguments));
  }
  nlohmann::json score() const {
    const ProgramResult ended = redrive({"eval", (folder_ / "run").string(), "--json"});
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    return nlohmann::json::parse(ended.out).at("cameras").at(kTinyFront);
  }

  const fs::path masks_ = folder_ / "masks",
                 of_front_ = masks_ / (std::string(kTinyFront) + ".png"),
                 kept_ = folder_ / "run" / "masks" / (std::string(kTinyFront) + ".png");
};

// 4 frames of 48 x 32 pixels.
TEST_F(EndToEndMasks, MasksAreKeptEditedAndNotScored) {
  write(of_front_, 48, 32, 24, 48);
  const ProgramResult trained = train({"--masks", masks_.string()});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  EXPECT_THAT(trained.out,
              AllOf(HasSubstr("48 x 32, 50.0 % masked"), HasSubstr("3072 training pixels")));
  EXPECT_EQ(read_image(kept_).rgb, read_image(of_front_).rgb);
  EXPECT_EQ(score().at("masked_pixels"), 4 * 24 * 32);

  write(kept_, 48, 32, 0, 12);
  const ProgramResult resumed = redrive({"resume", (folder_ / "run").string(), "--max-steps", "6"});
  ASSERT_EQ(resumed.exit_code, kExitOk) << resumed.err;
  EXPECT_THAT(resumed.out, AllOf(HasSubstr("25.0 % masked"), HasSubstr("4608 training pixels")));
  const nlohmann::json masked = score();
  EXPECT_EQ(masked.at("masked_pixels"), 4 * 12 * 32);
  fs::remove(kept_);
  EXPECT_EQ(score().at("masked_pixels"), 0);
  EXPECT_NE(score().at("psnr_db"), masked.at("psnr_db"));
}

TEST_F(EndToEndMasks, RefusesAMaskOfAnotherSize) {
  write(of_front_, 40, 32, 0, 1);
  const auto message = AllOf(HasSubstr(std::string(kTinyFront) + ".png"), HasSubstr("size"),
                             HasSubstr("40 x 32"), HasSubstr("48 x 32"));
  const ProgramResult refused = train({"--masks", masks_.string()});
  EXPECT_EQ(refused.exit_code, kExitBadInput);
  EXPECT_THAT(refused.err, message);
  EXPECT_FALSE(fs::exists(folder_ / "run"));

  ASSERT_EQ(train({}).exit_code, kExitOk);
  fs::copy_file(of_front_, kept_);
  const std::string run = (folder_ / "run").string();
  for (const std::vector<std::string>& words :
       {std::vector<std::string>{"resume", run, "--max-steps", "1000"}, {"eval", run}}) {
    const ProgramResult ended = redrive(words);
    EXPECT_EQ(ended.exit_code, kExitBadInput) << words[0];
    EXPECT_THAT(ended.err, message) << words[0];
  }
}

// 0.6 m are too short to find the ego vehicle.
TEST_F(EndToEndMasks, KeepsAllPixelsOfAShortDrive) {
  const ProgramResult trained = train({});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  EXPECT_THAT(trained.out, Not(HasSubstr("masked")));
  EXPECT_TRUE(fs::is_empty(folder_ / "run" / "masks"));
  EXPECT_EQ(score().at("masked_pixels"), 0);
}

}  // namespace
}  // namespace redrive::testing
