// SPDX-License-Identifier: Apache-2.0
// Times kernels, whole training steps and a whole picture through one backend, on synthetic input
// of formulas, against its roofline (Williams, Waterman and Patterson, CACM 2009): arithmetic and
// copies, each as fast as they were measured.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/kernels/backend.h"

namespace redrive::bench {

struct Options {
  std::string filter;   ///< only names that contain it; empty: all
  int repetitions = 0;  ///< 0: at least 5 and until 3 s have passed, after one warm-up; one run
                        ///< alone where it takes over 20 s
};

struct Result {
  std::string name;
  double median_ms = 0, min_ms = 0;
  double samples_per_s = 0;  ///< points along rays (kernel/adam: parameters) by the median
  /// Arithmetic of the formula as the paper writes it, by the median; exp, division and square root
  /// count as one, a training step as three forward passes. Not what a kernel makes of it:
  /// kernels/cpu/folded_colour.h saves a tenth of it.
  double gflops = 0;
  double flops = 0,
         bytes = 0;  ///< of one run; of bytes those that the formula is given and gives, each once
  /// The least time that the report's ceilings leave for these, of the median. May pass 100: by
  /// what a kernel saves of the arithmetic, and where its numbers were in a cache.
  double percent_of_roofline = 0;
  bool memory_bound = false;  ///< rather than by arithmetic: which ceiling leaves that time
};

struct Report {
  std::string cpu, backend, isa;  ///< isa "none" for ref
  int threads = 0;
  std::string gpu;             ///< where that computes; empty else
  kernels::Ceilings ceilings;  ///< measured in this run: the backend's own, or those of all threads
                               ///< (bench/peak.h)
  std::string commit;          ///< of the build; empty if unknown
  std::vector<Result> results;
};

/// UsageError if the filter matches nothing. `on_result` sees each result as it comes.
Report run(kernels::Backend& backend, const Options& options,
           const std::function<void(const Result&)>& on_result);

nlohmann::json to_json(const Report& report);

}  // namespace redrive::bench
