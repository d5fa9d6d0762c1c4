// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/headline.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/kernels/backend.h"
#include "redrive/report/html.h"
#include "redrive/scene/scene_testing.h"
#include "redrive/train/files/blocks.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

class Headline : public ::testing::Test {
 protected:
  Headline() {
    run_.recording = make_test_recording(folder_.path);
    run_.options.recording = folder_.path.string();
    run_.options.method = "nerf";
    run_.options.holdout_every = 3;
    apply_preset(&run_.options, {"recording", "method", "holdout-every"});
    run_.scene = make_scene(run_.recording, scene_options(run_.options));
    run_.state.model = make_run_model(run_.options, run_.scene);
    record_hyperparameters(*run_.state.model, &run_.options);
    run_.state.step = 1200;
    run_.state.seconds = 90;
    run_.paths.root = "/runs/a/";
    scored_.run = &run_;
    scored_.evaluation.overall = {.psnr_db = 23.031, .ssim = 0.7175, .flip = 0.1669, .images = 4};
  }
  std::string html(const ScoredRun* compared = nullptr) const {
    return headline(scored_, compared, *backend_, "<images>");
  }
  const TemporaryFolder folder_;
  redrive::Run run_;
  ScoredRun scored_{};
  const std::unique_ptr<kernels::Backend> backend_ = kernels::make_ref_backend();
};

TEST_F(Headline, BeginsWithTheScoreThenImagesThenTheCommand) {
  const std::string page = html();
  std::size_t at = 0;
  const std::string made =
      "redrive train " + folder_.path.string() + " --method nerf --holdout-every 3 --out /runs/a\n";
  for (const std::string& part :
       {html_escape(folder_.path.filename().string()),
        std::string("PSNR <strong>23.03 dB</strong>"), std::string("SSIM 0.718"),
        std::string("FLIP 0.167"), std::string("4 held-out images"), std::string("<images>"),
        html_command(made.substr(0, made.size() - 1)),
        std::string("2 cameras: FISHEYE, FRONT; 6 frames"), std::string("1200 steps in 1.5 min")}) {
    const std::size_t found = page.find(part, at);
    ASSERT_NE(found, std::string::npos) << part << " after " << page.substr(0, at);
    at = found;
  }
  EXPECT_THAT(page, Not(HasSubstr("class=\"warning\"")));
}

TEST_F(Headline, SaysWhatIsMissingWithTheCommandThatMakesIt) {
  scored_.evaluation.held_out = false;
  run_.state.step = 0;
  EXPECT_THAT(html(), AllOf(HasSubstr("4 training images, which training saw"),
                            HasSubstr("No frame was held out"),
                            HasSubstr("<span>3</span> <span>--out</span> "
                                      "<span>/runs/a-held-out</span>"),
                            HasSubstr(html_command("redrive resume /runs/a"))));
}

TEST_F(Headline, ABlockHasACommandForItsPartOfTheDrive) {
  const std::filesystem::path whole = folder_.path / "drive";
  run_.paths.root = whole / "blocks" / "003";
  std::filesystem::create_directories(run_.paths.root);
  write_file(blocks_file(whole), "");
  EXPECT_THAT(html(), AllOf(HasSubstr("a block of " + whole.string() + ", "),
                            HasSubstr("<span>" + whole.string() + "-003</span></code>")));
}

TEST_F(Headline, NamesTheComparedRun) {
  ScoredRun other = scored_;
  other.evaluation.overall.psnr_db = 19.5;
  EXPECT_THAT(html(&other),
              HasSubstr("Compared with nerf, 1.5 min: PSNR 19.50 dB, SSIM 0.718, FLIP 0.167 on 4 "
                        "held-out images."));
}

TEST_F(Headline, ShowsTheMedian) {
  EXPECT_EQ(median_view(scored_), nullptr);
  for (const double psnr_db : {30.0, 10.0, std::nan(""), 20.0, 25.0}) {
    View view = run_.scene.views[0];
    view.frame = static_cast<int>(scored_.images.size());
    scored_.images.emplace_back(view, Score{.psnr_db = psnr_db});
  }
  ASSERT_NE(median_view(scored_), nullptr);
  EXPECT_EQ(median_view(scored_)->frame, 3) << "20 dB of 10, 20, 25 and 30";
}

}  // namespace
}  // namespace redrive
