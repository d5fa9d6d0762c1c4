// SPDX-License-Identifier: Apache-2.0
// redrive plan, and a drive whose images do not fit into --memory.
#include <nlohmann/json.hpp>

#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class Plan : public EndToEnd {
 protected:
  ProgramResult planned(const std::vector<std::string>& more, const std::string& frames) const {
    std::vector<std::string> arguments = {
        "plan", street_.string(), "--frames", frames,        "--max-steps",
        "1000", "--threads",      "2",        "--downscale", "4"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(arguments);
  }

  const fs::path street_ = fs::path(REDRIVE_SAMPLES) / "street";
};

TEST_F(Plan, TellsWhatADividedDriveCosts) {
  const auto before = contents(folder_);
  const ProgramResult ended =
      planned({"--blocks", "5", "--machines", "2", "--cores", "4", "--memory", "2GiB", "--json"},
              "1000:1019");
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  const nlohmann::json plan = nlohmann::json::parse(ended.out);
  EXPECT_EQ(plan.at("frames"), 20);
  EXPECT_EQ(plan.at("machines").at("cores"), 4);
  const nlohmann::json& blocks = plan.at("blocks");
  ASSERT_GE(blocks.size(), 2u);
  double sum = 0, way_m = 0;
  for (const nlohmann::json& block : blocks) {
    EXPECT_GT(block.at("images"), 0);
    EXPECT_LE(block.at("length_m"), 5);
    EXPECT_GT(block.at("reads_bytes"), 0);
    EXPECT_FALSE(block.at("streams"));
    sum += block.at("prepare_s").get<double>() + block.at("train_s").get<double>();
    way_m += block.at("length_m").get<double>();
  }
  EXPECT_NEAR(way_m, plan.at("length_m").get<double>(), 1e-6);
  const int ranks = 2 * plan.at("ranks_per_machine").get<int>();
  EXPECT_GE(plan.at("seconds").get<double>() * ranks, 0.999 * sum);
  EXPECT_LE(plan.at("seconds").get<double>(), 1.001 * sum);
  EXPECT_GT(plan.at("core_rates").at("step_s"), 0);
  EXPECT_EQ(contents(folder_), before) << "nothing written";
}

TEST_F(Plan, CountsMemoryForTheCoresOfAMachine) {
  const auto memory_bytes = [&](const char* cores) {
    const ProgramResult ended = planned({"--cores", cores, "--json"}, "1000:1003");
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    return nlohmann::json::parse(ended.out).at("memory_bytes").get<std::int64_t>();
  };
  // 4 MiB a thread at least, of which a cache takes nothing away.
  EXPECT_GT(memory_bytes("34"), memory_bytes("2") + 32 * (4 << 20));
}

TEST_F(Plan, PrintsATable) {
  const ProgramResult ended = planned({"--blocks", "5"}, "1000:1019");
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  for (const char* line :
       {"drive ", "blocks ", "rates ", "machines ", "time ", "memory ", "disk ", "traffic "})
    EXPECT_THAT(ended.out, HasSubstr(line));
}

TEST_F(Plan, RefusesWhatTrainingWouldRefuse) {
  EXPECT_EQ(planned({"--memory", "50000000"}, "1000:1003").exit_code, kExitUsage);
  EXPECT_EQ(planned({"--blocks", "-1"}, "1000:1003").exit_code, kExitUsage);
  EXPECT_EQ(planned({"--machines", "0"}, "1000:1003").exit_code, kExitUsage);
  EXPECT_EQ(redrive({"plan", (folder_ / "none").string()}).exit_code, kExitBadInput);
}

// The estimate says how much memory suffices for a part of the images.
TEST_F(Plan, ImagesThatDoNotFitAreDecodedWhenNeeded) {
  const auto train = [&](const std::string& name, const std::string& memory) {
    return redrive({"train", street_.string(), "--out", (folder_ / name).string(), "--frames",
                    "1000:1029", "--max-steps", "30", "--threads", "2", "--max-gaussians", "5000",
                    "--truth-poses", "--memory", memory});
  };
  const ProgramResult refused = train("refused", "50000000");
  EXPECT_EQ(refused.exit_code, kExitUsage);
  const std::string needs = "needs about ";
  const std::size_t at = refused.err.find(needs);
  ASSERT_NE(at, std::string::npos) << refused.err;
  const double least_gib = std::stod(refused.err.substr(at + needs.size()));
  const ProgramResult whole = train("whole", "4GiB");
  ASSERT_EQ(whole.exit_code, kExitOk) << whole.err;
  EXPECT_THAT(whole.out, Not(HasSubstr("decoded when needed")));
  const ProgramResult streamed = train("streamed", std::to_string(least_gib + 0.006) + "GiB");
  ASSERT_EQ(streamed.exit_code, kExitOk) << streamed.err;
  EXPECT_THAT(streamed.out, AllOf(HasSubstr("decoded when needed"), HasSubstr("s for images; ")));
  const auto metrics = [&](const char* run) {
    const std::string text = read_file(folder_ / run / "metrics.jsonl");
    return nlohmann::json::parse(text.substr(0, text.find('\n')));
  };
  EXPECT_EQ(metrics("streamed").at("loss"), metrics("whole").at("loss"));
  EXPECT_FALSE(metrics("whole").contains("image_wait_s"));
}

}  // namespace
}  // namespace redrive::testing
