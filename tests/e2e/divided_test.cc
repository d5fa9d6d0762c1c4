// SPDX-License-Identifier: Apache-2.0
// The sample street in two blocks, rendered, scored and exported as one scene.
#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include "redrive/image/image_io.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr const char* kDividedCamera = "F_MIDLONGRANGECAM_CL";
// The drive has 24.8 m; the camera is 2 m ahead of the body, so at the border around frame 1020.
constexpr const char *kInFirst = "1005", *kInSecond = "1042", *kAtBorder = "1020";

class Divided : public EndToEnd {
 protected:
  void train() const {
    const ProgramResult ended =
        redrive({"train", REDRIVE_SAMPLES "/street", "--out", run_.string(), "--method", "splat",
                 "--cameras", kDividedCamera, "--downscale", "8", "--holdout-every", "8",
                 "--max-steps", "60", "--threads", "2", "--truth-poses", "--blocks", "13"});
    ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
    ASSERT_TRUE(fs::exists(block(1) / "checkpoint.safetensors"));
    ASSERT_FALSE(fs::exists(block(2)));
  }
  fs::path block(int index) const { return run_ / "blocks" / ("00" + std::to_string(index)); }

  ProgramResult render(const fs::path& run, const std::string& frame,
                       const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {"render",       run.string(), "--camera",
                                          kDividedCamera, "--frame",    frame,
                                          "--force",      "--out",      image_.string()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(arguments);
  }
  std::vector<std::uint8_t> rendered(const fs::path& run, const std::string& frame) const {
    const ProgramResult ended = render(run, frame);
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    return read_image(image_).rgb;
  }

  void scores_other_cameras_and_edits() const {
    const ProgramResult other =
        redrive({"eval", run_, "--json", "--max-images", "6", "--cameras", "F_MIDRANGECAM_C"});
    ASSERT_EQ(other.exit_code, kExitOk) << other.err;
    EXPECT_EQ(nlohmann::json::parse(other.out)["other_cameras"]["F_MIDRANGECAM_C"]["images"], 6);

    // What is rendered at an eighth of the size, whose left half is taken as changed.
    constexpr int kFactor = 8;
    const fs::path edited = folder_ / "edited";
    fs::create_directories(edited);
    write_file(edited / "edit.json", R"({"actors": {}})");
    for (const char* frame : {kInFirst, kInSecond}) {
      ASSERT_EQ(render(run_, frame).exit_code, kExitOk);
      const Image8 small = read_image(image_);
      Image8 image, changed;
      image.width = changed.width = kFactor * small.width;
      image.height = changed.height = kFactor * small.height;
      for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x)
          for (int c = 0; c < 3; ++c) {
            image.rgb.push_back(small.rgb[3 * (y / kFactor * small.width + x / kFactor) + c]);
            changed.rgb.push_back(x < image.width / 2 ? 255 : 0);
          }
      const std::string name = std::string(kDividedCamera) + "_" + frame;
      write_image(edited / (name + ".png"), image);
      write_image(edited / (name + "_changed.png"), changed);
    }
    const ProgramResult ended = redrive({"eval", run_, "--json", "--edited", edited});
    ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
    const nlohmann::json score = nlohmann::json::parse(ended.out)["edited"]["edited"];
    EXPECT_EQ(score["inside"]["images"], 2);
    EXPECT_GT(score["inside"]["psnr_db"], 45);  // 8 bits
    EXPECT_GT(score["outside"]["psnr_db"], 45);
  }
  void has_a_report() const {
    const ProgramResult ended = redrive({"figures", run_, "--max-images", "2"});
    ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
    EXPECT_TRUE(fs::exists(run_ / "figures/loss.png"));
    EXPECT_TRUE(fs::exists(run_ / "figures" / (std::string(kDividedCamera) + "_reproduced.png")));
    const std::string page = read_file(run_ / "report.html");
    for (const char* part :
         {"120 steps", "block 000", "block 001", "<span>--blocks</span> <span>12.", "held-out"})
      EXPECT_THAT(page, HasSubstr(part));
    EXPECT_THAT(page, Not(HasSubstr("No curves yet")));
  }

  const fs::path run_ = folder_ / "run", image_ = folder_ / "image.png";
};

/// Returns the largest difference of two images.
int largest_difference(const std::vector<std::uint8_t>& a, const std::vector<std::uint8_t>& b) {
  int most = 0;
  for (std::size_t i = 0; i < a.size(); ++i) most = std::max(most, std::abs(a[i] - b[i]));
  return most;
}

TEST_F(Divided, IsRenderedScoredAndExportedAsOneScene) {
  train();
  EXPECT_EQ(rendered(run_, kInFirst), rendered(block(0), kInFirst));
  EXPECT_EQ(rendered(run_, kInSecond), rendered(block(1), kInSecond));
  const auto both = rendered(run_, kAtBorder), first = rendered(block(0), kAtBorder),
             second = rendered(block(1), kAtBorder);
  ASSERT_GT(largest_difference(first, second), 4);
  for (std::size_t i = 0; i < both.size(); ++i) {
    EXPECT_GE(both[i] + 1, std::min(first[i], second[i]));
    EXPECT_LE(both[i] - 1, std::max(first[i], second[i]));
  }
  EXPECT_NE(both, first);
  EXPECT_NE(both, second);

  const ProgramResult scored = redrive({"eval", run_.string(), "--json", "--max-images", "6"});
  ASSERT_EQ(scored.exit_code, kExitOk) << scored.err;
  const nlohmann::json json = nlohmann::json::parse(scored.out);
  ASSERT_EQ(json["blocks"].size(), 2u);
  double sum_db = 0;
  int images = 0;
  for (const char* name : {"000", "001"}) {
    const nlohmann::json& part = json["blocks"][name]["overall"];
    sum_db += part["images"].get<int>() * part["psnr_db"].get<double>();
    images += part["images"].get<int>();
    EXPECT_GT(json["blocks"][name]["novel"]["left_0.5"]["images"], 0);
  }
  EXPECT_EQ(json["overall"]["images"], images);
  EXPECT_NEAR(json["overall"]["psnr_db"], sum_db / images, 1e-9);
  const ProgramResult table = redrive({"eval", run_.string(), "--max-images", "2"});
  EXPECT_THAT(table.out, AllOf(HasSubstr("block 000"), HasSubstr("block 001")));
  const nlohmann::json alone =
      nlohmann::json::parse(redrive({"eval", block(0).string(), "--json"}).out);
  EXPECT_FALSE(alone.contains("blocks"));

  const fs::path path = folder_ / "path", ply = folder_ / "a.ply", points = folder_ / "points.ply";
  ASSERT_EQ(
      redrive({"render", "path", run_.string(), "drive", "--fps", "4", "--out", path}).exit_code,
      kExitOk);
  EXPECT_GT(contents(path).size(), 5u);
  const auto vertices = [&](const fs::path& run) {
    const ProgramResult ended =
        redrive({"export", run.string(), "--to", "splat-ply", "--force", ply.string()});
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    const std::string bytes = read_file(ply), key = "element vertex ";
    return std::stoul(bytes.substr(bytes.find(key) + key.size(), 20));
  };
  const std::size_t whole = vertices(run_);
  EXPECT_GT(whole, 0u);
  EXPECT_LT(whole, vertices(block(0)) + vertices(block(1)));
  EXPECT_EQ(redrive({"export", run_.string(), "--to", "ply", points}).exit_code, kExitOk);

  const ProgramResult paged =
      redrive({"export", run_.string(), "--to", "html", folder_ / "a.html"});
  if (paged.err.find("this build has no pages") == std::string::npos) {
    EXPECT_EQ(paged.exit_code, kExitOk) << paged.err;
  }

  scores_other_cameras_and_edits();
  has_a_report();
}

TEST_F(Divided, ABlockThatIsNotThereIsNamedWhereItIsNeeded) {
  train();
  const fs::path checkpoint = block(1) / "checkpoint.safetensors";
  write_file(checkpoint, read_file(checkpoint).substr(0, 1000));
  EXPECT_EQ(render(run_, kInFirst).exit_code, kExitOk);
  ProgramResult ended = render(run_, kInSecond);
  EXPECT_EQ(ended.exit_code, kExitBadInput);
  EXPECT_THAT(ended.err, AllOf(HasSubstr("block 001"), HasSubstr("checkpoint.safetensors"),
                               HasSubstr("redrive resume")));
  fs::remove(checkpoint);
  EXPECT_EQ(render(run_, kInFirst).exit_code, kExitOk);
  ended = render(run_, kInSecond);
  EXPECT_EQ(ended.exit_code, kExitBadInput);
  EXPECT_THAT(ended.err, AllOf(HasSubstr("block 001 is not trained"), HasSubstr("redrive resume")));
  write_file(run_ / "blocks.json", "{}");
  EXPECT_EQ(render(run_, kInFirst).exit_code, kExitBadInput);
}

}  // namespace
}  // namespace redrive::testing
