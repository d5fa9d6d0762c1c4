// SPDX-License-Identifier: Apache-2.0
// redrive export on small runs.
#include "redrive/base/files/gzip.h"
#include "redrive/base/files/zip.h"
#include "redrive/recording/lidar/ply.h"
#include "redrive/report/html.h"
#include "redrive/train/files/state.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::AllOf;
using ::testing::ContainsRegex;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsSupersetOf;
using ::testing::Not;

class Export : public EndToEnd {
 protected:
  ProgramResult exported(const fs::path& run, const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {"export", run.string(), "--to", "splat-ply",
                                          file_.string()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(arguments);
  }

  const fs::path file_ = folder_ / "street.ply";
};

TEST_F(Export, WritesTheGaussiansOfARun) {
  const fs::path run = folder_ / "run";
  const ProgramResult trained =
      redrive({"train", drive_.string(), "--out", run.string(), "--method", "splat", "--max-steps",
               "20", "--max-gaussians", "2000", "--set", "initial.sky=500", "--threads", "2"});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.out << trained.err;
  const ProgramResult ended = exported(run);
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, HasSubstr(file_.string()));

  const TrainState state = load_checkpoint(run / "checkpoint.safetensors");
  const WorldGaussians world = state.model->as_gaussians()->world();
  const kernels::Gaussians& gaussians = world.gaussians;
  const std::vector<Eigen::Vector3d> points = read_ply(file_);
  ASSERT_GT(gaussians.n, 100u);
  ASSERT_EQ(points.size(), gaussians.n);
  for (std::size_t i = 0; i < points.size(); ++i)
    for (int k = 0; k < 3; ++k)
      ASSERT_EQ(points[i][k], gaussians.numbers[gaussian_slot(i, kPositionRow + k)]);

  const auto before = contents(folder_);
  const ProgramResult again = exported(run, {"--sh-degree", "0"});
  EXPECT_EQ(again.exit_code, kExitUsage);
  EXPECT_THAT(again.err, AllOf(HasSubstr("street.ply"), HasSubstr("exists; --force")));
  EXPECT_EQ(exported(run, {"--force", "--sh-degree", "2"}).exit_code, kExitUsage);
  const ProgramResult full =
      redrive({"export", run.string(), "--to", "splat-ply", "--force", file_.string()},
              /*file_limit_bytes=*/10000);
  EXPECT_EQ(full.exit_code, kExitIo) << full.out << full.err;
  EXPECT_EQ(contents(folder_), before) << "nothing half-written";

  ASSERT_EQ(exported(run, {"--force", "--sh-degree", "0"}).exit_code, kExitOk);
  EXPECT_EQ(before.at(file_.string()).size() - fs::file_size(file_),
            gaussians.n * 9 * sizeof(float) + 9 * std::string("property float f_rest_0\n").size());
  EXPECT_EQ(read_ply(file_).size(), gaussians.n);

  const fs::path spz = folder_ / "street.spz", page = folder_ / "street.html";
  ASSERT_EQ(redrive({"export", run.string(), "--to", "splat-spz", spz.string()}).exit_code, 0);
  EXPECT_EQ(gunzip(read_file(spz)).size(), 16 + gaussians.n * 29);
  const auto written = [&](const std::string& format, const fs::path& file) {
    const ProgramResult ended = redrive({"export", run.string(), "--to", format, file.string()});
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    return file;
  };
  EXPECT_TRUE(read_file(written("splat-gltf", folder_ / "street.glb")).starts_with("glTF"));
  EXPECT_THAT(ZipFile(written("splat-usd", folder_ / "street.usdz")).names(),
              ElementsAre("default.usda"));
  EXPECT_THAT(
      ZipFile(written("splatsim", folder_ / "scene.usdz")).names(),
      IsSupersetOf({"default.usda", "metadata.yaml", "scene.json", "chunks/chunk_000000.spz"}));
  const ProgramResult paged = redrive({"export", run.string(), "--to", "html", page.string()});
  if (paged.err.find("this build has no pages") != std::string::npos)
    GTEST_SKIP() << "the build had no node or npm";
  ASSERT_EQ(paged.exit_code, kExitOk) << paged.err;
  const std::string html = read_file(page);
  EXPECT_THAT(html, HasSubstr(base64(read_file(spz))));
  EXPECT_THAT(html, HasSubstr("camera_to_world"));
  EXPECT_THAT(html, Not(ContainsRegex("(src|href)=\"(https?:)?//"))) << "self-contained";
}

TEST_F(Export, RefusesWhatTheMethodDoesNotHave) {
  const fs::path run = trained("run", 2);
  const auto before = contents(folder_);
  const ProgramResult ended = exported(run);
  EXPECT_EQ(ended.exit_code, kExitUsage);
  EXPECT_THAT(ended.err, AllOf(HasSubstr("--to"), HasSubstr("splat-ply"), HasSubstr("nerf")));
  const ProgramResult page = redrive({"export", run.string(), "--to", "html", file_.string()});
  EXPECT_EQ(page.exit_code, kExitUsage);
  EXPECT_THAT(page.err, AllOf(HasSubstr("html"), HasSubstr("nerf")));
  EXPECT_EQ(redrive({"export", run.string(), file_.string()}).exit_code, kExitUsage)
      << "--to is missing";
  EXPECT_EQ(exported(folder_ / "no_run").exit_code, kExitBadInput);
  EXPECT_EQ(
      redrive({"export", run.string(), "--to", "splat-ply", folder_ / "no" / "a.ply"}).exit_code,
      kExitUsage);
  EXPECT_EQ(contents(folder_), before);
}

}  // namespace
}  // namespace redrive::testing
