// SPDX-License-Identifier: Apache-2.0
// States of training with made numbers, and damage to the checkpoints that they are written to.
#pragma once

#include <cstring>
#include <functional>
#include <span>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"
#include "redrive/optim/packed_moments.h"
#include "redrive/train/files/safetensors.h"
#include "redrive/train/train_testing.h"

namespace redrive {

/// A state in which every value differs from its initial one.
inline TrainState midway(TrainState state) {
  for (std::size_t i = 0; i < state.adam.first_moment.size(); ++i) {
    state.adam.first_moment[i] = random_unit(1, i) - 0.5f;
    state.adam.second_moment[i] = random_unit(2, i) * 1e-30f;
  }
  for (std::size_t i = 0; i < state.adam.packed.size(); ++i)
    state.adam.packed[i] = pack_moments(random_unit(3, i) - 0.5f, random_unit(4, i));
  for (std::size_t i = 0; i < state.adam.errors.size(); ++i)
    state.adam.errors[i] = random_unit(5, i);
  state.step = 123456789012;
  state.pixels_drawn = 9876543210987;
  state.seconds = 0.1 + 0.2;
  state.seed = 18446744073709551615ull;
  state.restarts = 2;
  state.bad_steps = 1;
  state.skipped_steps = 4;
  state.watch = {3, 0.1, 0.2, 1.0 / 3};
  state.rollbacks = 3;
  state.rate_factor = 0.125;
  state.loss_watch = {1ull << 60, 99999.5, 0.1, 1.0 / 7, 2};
  state.window = {7, 7168, 0.7, 0.6, 1e-9, {0.25, 1.0 / 3}};
  return state;
}

inline void expect_equal(std::span<const float> a, std::span<const float> b) {
  ASSERT_EQ(a.size(), b.size());
  EXPECT_EQ(std::memcmp(a.data(), b.data(), a.size_bytes()), 0);
}

/// A parsed checkpoint: header as JSON, and the data.
struct CheckpointParts {
  nlohmann::json header;
  std::string data;

  explicit CheckpointParts(const std::string& bytes) {
    std::uint64_t length = 0;
    std::memcpy(&length, bytes.data(), 8);
    header = nlohmann::json::parse(bytes.substr(8, length));
    data = bytes.substr(8 + length);
  }
  std::string bytes() const {
    std::string text = header.dump();
    text.resize((text.size() + 7) / 8 * 8, ' ');
    const std::uint64_t length = text.size();
    return std::string(reinterpret_cast<const char*>(&length), 8) + text + data;
  }
};

/// Message of the InputError about a checkpoint; empty without one.
inline std::string checkpoint_error(const std::string& bytes) {
  try {
    parse_checkpoint(bytes, "run/checkpoint.safetensors");
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

struct CheckpointDamage {
  const char* name;
  std::function<void(CheckpointParts&)> apply;
  const char* message;  ///< part of the message
};

/// Changes an entry of the metadata.
inline auto with_metadata(const char* key, const char* value) {
  return [=](CheckpointParts& parts) { parts.header["__metadata__"][key] = value; };
}

/// Expects that each damage to a good checkpoint is rejected with the file's name and its message.
inline void expect_rejected(const std::string& good, std::span<const CheckpointDamage> table) {
  for (const CheckpointDamage& damage : table) {
    CheckpointParts parts(good);
    damage.apply(parts);
    const std::string what = checkpoint_error(parts.bytes());
    EXPECT_THAT(what, ::testing::HasSubstr("run/checkpoint.safetensors")) << damage.name;
    EXPECT_THAT(what, ::testing::HasSubstr(damage.message)) << damage.name;
  }
}

}  // namespace redrive
