// SPDX-License-Identifier: Apache-2.0
#include "redrive/bench/bench.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/bench/peak.h"

namespace redrive::bench {
namespace {

TEST(Peak, IsMeasuredForEveryUsableIsa) {
  ThreadPool pool(1);
  // 1 GFLOP/s is less than one operation per cycle; 100 TFLOP/s is beyond any core.
  const double portable = measure_peak_gflops(std::nullopt, pool);
  EXPECT_GT(portable, 1);
  for (const Isa isa : all_isas()) {
    if (const auto why = isa_obstacle(isa)) {
      std::printf("%s: %s\n", std::string(isa_name(isa)).c_str(), why->c_str());
      continue;
    }
    const double gflops = measure_peak_gflops(isa, pool);
    EXPECT_GT(gflops, 1) << isa_name(isa);
    EXPECT_LT(gflops, 1e5) << isa_name(isa);
  }
}

TEST(Bench, ReportsTheFilteredBenchmarks) {
  const auto backend = kernels::make_ref_backend();
  int seen = 0;
  const Report report = run(*backend, {"kernel/adam", 2}, [&](const Result& result) {
    ++seen;
    EXPECT_EQ(result.name, "kernel/adam");
  });
  ASSERT_EQ(report.results.size(), 1u);
  EXPECT_EQ(seen, 1);
  const Result& r = report.results[0];
  EXPECT_GT(r.min_ms, 0);
  EXPECT_GE(r.median_ms, r.min_ms);
  // The figures are consistent: 14 operations per parameter.
  EXPECT_NEAR(r.gflops, 14e-9 * r.samples_per_s, 1e-12 * r.gflops);
  const double parameters = r.flops / 14,
               ms = 1e3 * 1e-9 * 32 * parameters / report.ceilings.copy_gb_per_s;
  EXPECT_EQ(r.bytes, 32 * parameters) << "four numbers read and written";
  EXPECT_TRUE(r.memory_bound);
  EXPECT_NEAR(r.percent_of_roofline, 100 * ms / r.median_ms, 1e-9 * r.percent_of_roofline);

  const nlohmann::json json = to_json(report);
  for (const char* key :
       {"cpu", "isa", "backend", "threads", "peak_gflops", "peak_arithmetic", "peak_copied_gb_s"})
    EXPECT_TRUE(json["machine"].contains(key)) << key;
  for (const char* key : {"name", "median_ms", "min_ms", "samples_per_s", "flops", "bytes",
                          "gflops", "percent_of_roofline", "limit"})
    EXPECT_TRUE(json["results"][0].contains(key)) << key;
  EXPECT_EQ(json["machine"]["backend"], "ref");
}

TEST(Peak, CopiesAreMeasured) {
  ThreadPool pool(2);
  const double gb_s = measure_copy_gb_per_s(pool);
  EXPECT_GT(gb_s, 0.1);
  EXPECT_LT(gb_s, 1e4);
}

TEST(Bench, RejectsAFilterWithoutMatches) {
  const auto backend = kernels::make_ref_backend();
  EXPECT_THROW(run(*backend, {"no such kernel", 1}, [](const Result&) {}), UsageError);
}

}  // namespace
}  // namespace redrive::bench
