// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <memory>

#include "redrive/bench/bench.h"
#include "redrive/bench/roofline.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/json_output.h"

namespace redrive {
namespace {

void print_rooflines(kernels::Backend& backend) {
  const std::vector<bench::StepCost> steps = bench::count_steps(backend);
  for (const bench::StepCost& step : steps) {
    std::printf("step of %.0f Gaussians, %d x %d: %.0f drawn, %.0f pairs\n", step.counts.gaussians,
                step.width, step.height, step.counts.drawn, step.counts.pairs);
    std::printf("%-16s %8s %8s", "stage", "MFLOP", "MB");
    for (const bench::Gpu& gpu : bench::kGpus) std::printf(" %16s", gpu.name);
    double least[std::size(bench::kGpus)] = {}, all[std::size(bench::kGpus)] = {};
    for (std::size_t i = 0; i < step.stages.size(); ++i) {
      const bench::StageCost& stage = step.stages[i];
      std::printf("\n%-16s %8.0f %8.1f", stage.stage.c_str(), 1e-6 * stage.flops,
                  1e-6 * stage.bytes);
      for (std::size_t k = 0; k < std::size(bench::kGpus); ++k) {
        const double ms = stage.estimated_ms(bench::kGpus[k], steps[0].stages[i]);
        least[k] += stage.least_ms(bench::kGpus[k]);
        all[k] += ms;
        std::printf("  %6.3f - %6.2f", stage.least_ms(bench::kGpus[k]), ms);
      }
    }
    std::printf("\n%-16s %8s %8s", "all", "", "");
    for (std::size_t k = 0; k < std::size(bench::kGpus); ++k)
      std::printf("  %6.3f - %6.2f", least[k], all[k]);
    std::printf("\n\n");
  }
  std::printf(
      "Estimated ms: what the published peaks allow for arithmetic and copies, and as much longer "
      "as the\nH200 took than its own in the step of %d x %d, the only one measured.\n",
      steps[0].width, steps[0].height);
}

}  // namespace

Action configure_bench(CLI::App& command) {
  struct Settings {
    kernels::BackendChoice backend;
    bench::Options options;
    bool json = false, roofline = false;
  };
  auto s = std::make_shared<Settings>();
  add_backend_options(command, &s->backend);
  add_json_option(command, &s->json);
  CLI::Option* const filter =
      command.add_option("--filter", s->options.filter,
                         "runs only benchmarks whose name contains this (default: all)");
  CLI::Option* const repetitions =
      command
          .add_option("--repetitions", s->options.repetitions,
                      "0..10000; 0: at least 5 and for 3 s, but one run where it takes over 20 s")
          ->capture_default_str();
  command
      .add_flag("--roofline", s->roofline,
                "instead: estimates of a training step of Gaussians on GPUs")
      ->excludes(filter, repetitions, command.get_option("--json"));
  return [s] {
    if (s->options.repetitions < 0 || s->options.repetitions > 10'000)
      throw UsageError("--repetitions", std::to_string(s->options.repetitions),
                       "must be in 0..10000");
    const auto backend = kernels::make_backend(s->backend);
    if (s->roofline) {
      print_rooflines(*backend);
      return kExitOk;
    }
    // Progress goes to stderr where stdout is for a script.
    std::FILE* out = s->json ? stderr : stdout;
    std::fprintf(out, "%s, %s\n", describe(*backend).c_str(), cpu_model_name().c_str());
    std::fprintf(out, "%-30s %10s %10s %11s %10s %9s %8s %7s  %s\n", "name", "median ms", "min ms",
                 "Msamples/s", "GFLOP", "GFLOP/s", "MB", "% roof", "limit");
    const bench::Report report = bench::run(*backend, s->options, [&](const bench::Result& r) {
      std::fprintf(out, "%-30s %10.3f %10.3f %11.2f %10.3f %9.1f %8.2f %7.1f  %s\n", r.name.c_str(),
                   r.median_ms, r.min_ms, 1e-6 * r.samples_per_s, 1e-9 * r.flops, r.gflops,
                   1e-6 * r.bytes, r.percent_of_roofline, r.memory_bound ? "copies" : "arithmetic");
      for (const auto& [stage, ms] : r.stages_ms)
        std::fprintf(out, "  %-28s %10.3f\n", stage.c_str(), ms);
      std::fflush(out);
    });
    std::fprintf(out,
                 "measured ceilings: %.0f GFLOP/s (%s), copies %.0f GB/s read and written; GFLOP "
                 "counts the formulas' arithmetic, of which folded layers save a tenth, MB inputs "
                 "and outputs\n",
                 report.ceilings.gflops, report.ceilings.arithmetic.c_str(),
                 report.ceilings.copy_gb_per_s);
    if (s->json) print_json(bench::to_json(report));
    return kExitOk;
  };
}

}  // namespace redrive
