// SPDX-License-Identifier: Apache-2.0
// Whether two runs ended alike, and how far a run is.
#pragma once

#include <signal.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "redrive/train/run.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {

inline bool bit_equal(std::span<const float> a, std::span<const float> b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size_bytes()) == 0;
}
inline bool bit_equal(std::span<const std::uint32_t> a, std::span<const std::uint32_t> b) {
  return std::ranges::equal(a, b);
}

inline void expect_same_end(const fs::path& a, const fs::path& b) {
  const TrainState x = load_checkpoint(a / "checkpoint.safetensors"),
                   y = load_checkpoint(b / "checkpoint.safetensors");
  EXPECT_EQ(x.step, y.step);
  EXPECT_TRUE(bit_equal(x.model->parameters, y.model->parameters));
  EXPECT_TRUE(bit_equal(x.adam.first_moment, y.adam.first_moment));
  EXPECT_TRUE(bit_equal(x.adam.second_moment, y.adam.second_moment));
  EXPECT_TRUE(bit_equal(x.adam.packed, y.adam.packed));
  const std::vector<MetricsRow> p = read_metrics({a}), q = read_metrics({b});
  ASSERT_EQ(p.size(), q.size());
  for (std::size_t i = 0; i < p.size(); ++i) {
    EXPECT_EQ(p[i].step, q[i].step);
    EXPECT_EQ(p[i].loss, q[i].loss);
    EXPECT_EQ(p[i].psnr_db, q[i].psnr_db);
  }
}

/// Waits until the run has written `rows` rows of metrics; false if it takes a minute.
inline bool wait_for_rows(const fs::path& run, std::size_t rows) {
  for (int i = 0; i < 6000; ++i) {
    if (fs::exists(run / "config.json") && read_metrics({run}).size() >= rows) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return false;
}

/// Starts a training by `arguments`, kills it with SIGKILL once the run `parts` has so many rows of
/// metrics, and resumes it, for each of `rows`; then resumes it to its end. Expects the end of
/// `whole`.
inline void expect_same_end_when_killed(const fs::path& whole, const fs::path& parts,
                                        const std::vector<std::string>& arguments,
                                        const std::vector<std::size_t>& rows) {
  const std::vector<std::string> resume = {"resume", parts.string()};
  for (const std::size_t n : rows) {
    Program program(REDRIVE_BINARY, fs::exists(parts) ? resume : arguments);
    ASSERT_TRUE(wait_for_rows(parts, n));
    program.send(SIGKILL);
    EXPECT_EQ(program.wait().signal, SIGKILL);
  }
  const ProgramResult ended = Program(REDRIVE_BINARY, resume).wait();
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  expect_same_end(whole, parts);
}

}  // namespace redrive::testing
