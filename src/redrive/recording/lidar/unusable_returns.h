// SPDX-License-Identifier: Apache-2.0
// Returns of a scan that cannot be used: directions without a return, which drivers write as NaN or
// as the sensor's own place, and values that no sensor measures; and such points of clouds.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <optional>

#include "redrive/base/error.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/core/wording.h"

namespace redrive {

/// One in this many values of a scan may be impossible, at most; more mean another unit.
constexpr std::size_t kOneImpossibleOf = 20;

/// Whether x, y, z and intensity or reflectance stand for a direction without a return.
inline bool is_missing_return(const float* values) {
  const bool at_sensor = values[0] == 0 && values[1] == 0 && values[2] == 0;
  return at_sensor ||
         !std::all_of(values, values + 4, [](float value) { return std::isfinite(value); });
}

/// A finding about points of a cloud that are left out; nothing without any.
inline std::optional<Finding> points_left_out(const std::filesystem::path& file,
                                              std::size_t left_out) {
  if (left_out == 0) return std::nullopt;
  return Finding{file.filename().string(),
                 counted(left_out, "point") + " not finite or further than 1e7 away, left out"};
}

class UnusableReturns {
 public:
  /// `all`: the returns of the scan.
  explicit UnusableReturns(std::size_t all) : all_(all) {}

  void add_missing() { ++missing_; }
  /// Counts an impossible value. Throws the first one's error if there are too many.
  void add_impossible(const InputError& error) {
    if (!first_) first_.emplace(error);
    if (++impossible_ * kOneImpossibleOf > all_) throw *first_;
  }
  std::size_t count() const { return missing_ + impossible_; }

 private:
  std::size_t all_, missing_ = 0, impossible_ = 0;
  std::optional<InputError> first_;
};

}  // namespace redrive
