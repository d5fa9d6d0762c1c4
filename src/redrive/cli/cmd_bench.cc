// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <memory>

#include <nlohmann/json.hpp>

#include "redrive/bench/bench.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"

namespace redrive {

Action configure_bench(CLI::App& command) {
  struct Settings {
    kernels::BackendChoice backend;
    bench::Options options;
    bool json = false;
  };
  auto s = std::make_shared<Settings>();
  add_backend_options(command, &s->backend);
  command.add_flag("--json", s->json, "print the results as JSON alone");
  command.add_option("--filter", s->options.filter, "only benchmarks whose name contains this (default: all)");
  command.add_option("--repetitions", s->options.repetitions,
                     "0..10000; 0: at least 5 and for 3 s, once where one run takes over 20 s (default: 0)");
  return [s] {
    if (s->options.repetitions < 0 || s->options.repetitions > 10'000)
      throw UsageError("--repetitions", std::to_string(s->options.repetitions), "must be in 0..10000");
    const auto backend = make_checked_backend(s->backend);
    // Progress goes to stderr where stdout is for a script.
    std::FILE* out = s->json ? stderr : stdout;
    std::fprintf(out, "%s, %s\n%-30s %12s %12s %12s %10s %8s\n", describe(*backend).c_str(), cpu_model_name().c_str(),
                 "name", "median ms", "min ms", "Msamples/s", "GFLOP/s", "% peak");
    const bench::Report report = bench::run(*backend, s->options, [&](const bench::Result& r) {
      std::fprintf(out, "%-30s %12.3f %12.3f %12.2f %10.1f %8.1f\n", r.name.c_str(), r.median_ms, r.min_ms,
                   1e-6 * r.samples_per_s, r.gflops, r.percent_of_peak);
      std::fflush(out);
    });
    std::fprintf(
        out,
        "measured peak: %.0f GFLOP/s; the figures count the paper's arithmetic, of which folded layers save a tenth\n",
        report.peak_gflops);
    if (s->json) std::printf("%s\n", bench::to_json(report).dump(2).c_str());
    return kExitOk;
  };
}

}  // namespace redrive
