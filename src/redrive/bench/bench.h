// SPDX-License-Identifier: Apache-2.0
// Times kernels, whole training steps and a whole image on one backend, with synthetic input,
// against its roofline (Williams, Waterman and Patterson, CACM 2009): arithmetic and
// copies at their measured peaks.
#pragma once

#include <functional>
#include <map>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/kernels/backend.h"

namespace redrive::bench {

struct Options {
  std::string filter;   ///< runs names that contain it; empty: all
  int repetitions = 0;  ///< 0: at least 5 and until 3 s have passed, after one warm-up; a single
                        ///< one where it takes over 20 s
};

struct Result {
  std::string name;
  double median_ms = 0, min_ms = 0;
  double samples_per_s =
      0;  ///< samples along rays (kernel/adam: parameters) per second, by the median
  /// Operations of the formulas as published, by the median; exp, division and square root count as
  /// one, a training step as three forward passes. Kernels may need fewer:
  /// kernels/nerf/cpu/folded_colour.h saves a tenth.
  double gflops = 0;
  double flops = 0,
         /// arithmetic and bytes of one run; bytes: inputs and outputs, each number once
      bytes = 0;
  /// The least time that the report's ceilings allow, in percent of the median. Exceeds 100 where a
  /// kernel saves arithmetic or its data is in a cache.
  double percent_of_roofline = 0;
  bool memory_bound = false;                ///< limited by copies rather than arithmetic
  std::map<std::string, double> stages_ms;  ///< Backend::take_stage_times, means
};

/// The measured roofline of all threads (bench/peak.h).
struct Ceilings {
  double gflops = 0;         ///< a multiply-add counts as two
  std::string arithmetic;    ///< the instruction set that was measured
  double copy_gb_per_s = 0;  ///< 1e9 bytes, read and written
};

struct Report {
  std::string cpu, backend, isa;  ///< isa "none" for ref
  int threads = 0;
  Ceilings ceilings;   ///< measured in this run
  std::string commit;  ///< commit of the build; empty if unknown
  std::vector<Result> results;
};

/// Runs the benchmarks; calls `on_result` after each. UsageError if the filter matches nothing.
Report run(kernels::Backend& backend, const Options& options,
           const std::function<void(const Result&)>& on_result);

nlohmann::json to_json(const Report& report);

}  // namespace redrive::bench
