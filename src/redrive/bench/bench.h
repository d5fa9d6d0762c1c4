// SPDX-License-Identifier: Apache-2.0
// Times kernels, whole training steps and a whole picture through one backend, on synthetic input of formulas.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/kernels/kernels.h"

namespace redrive::bench {

struct Options {
  std::string filter;  ///< only names that contain it; empty: all
  int repetitions =
      0;  ///< 0: at least 5 and until 3 s have passed, after one warm-up; one run alone where it takes over 20 s
};

struct Result {
  std::string name;
  double median_ms = 0, min_ms = 0;
  double samples_per_s = 0;  ///< points along rays (kernel/adam: parameters) by the median
  /// Arithmetic of the formula as the paper writes it, by the median; exp, division and square root count as one, a training step as
  /// three forward passes. Not what a kernel makes of it: kernels/cpu/folded_colour.h saves a tenth of it.
  double gflops = 0;
  double percent_of_peak = 0;  ///< of Report::peak_gflops; may pass 100 for that reason
};

struct Report {
  std::string cpu, backend, isa;  ///< isa "none" for ref
  int threads = 0;
  double peak_gflops = 0;  ///< bench/peak.h, all threads, measured in this run
  std::string commit;      ///< of the build; empty if unknown
  std::vector<Result> results;
};

/// UsageError if the filter matches nothing. `on_result` sees each result as it comes.
Report run(kernels::Backend& backend, const Options& options, const std::function<void(const Result&)>& on_result);

nlohmann::json to_json(const Report& report);

}  // namespace redrive::bench
