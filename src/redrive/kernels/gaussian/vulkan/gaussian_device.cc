// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/vulkan/gaussian_device.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/kernels/gaussian/vulkan/shaders.h"

namespace redrive::kernels::vulkan {
namespace {

constexpr std::uint32_t kUnusedAt = 15;  // a control word for totals that nobody reads

/// Update of shaders/adam.comp.
struct UpdateParameters {
  VkDeviceAddress numbers, moments, errors, gradients, new_errors, drawn, control;
  std::uint32_t n, bounded_colours, rows;
  float beta1, beta2, bias1, bias2, epsilon, min_log_scale, max_log_scale;
  float rates[kGaussianRows];
};

const Shader& shader_of(std::string_view name) {
  const auto shaders = gaussian_shaders();
  const auto at = std::ranges::find(shaders, name, &Shader::name);
  REDRIVE_CHECK(at != shaders.end());
  return *at;
}

}  // namespace

void run(Queue* queue, std::string_view shader, const Push& push, std::size_t groups,
         std::initializer_list<std::uint32_t> constants) {
  queue->dispatch(shader_of(shader), constants, push.bytes(), static_cast<std::uint32_t>(groups));
}

void GaussianDevice::run_indirect(std::string_view shader, const Push& push,
                                  const DeviceBuffer& control, std::size_t at,
                                  std::initializer_list<std::uint32_t> constants) {
  queue_.dispatch_indirect(shader_of(shader), constants, push.bytes(), control, at);
}

void GaussianDevice::scan(const DeviceBuffer& numbers, const DeviceBuffer& control,
                          std::uint32_t n_at, std::uint32_t total_at, std::size_t scanned) {
  const Push push(numbers, block_sums, control, numbers, numbers, n_at, total_at, std::uint32_t{0});
  run_indirect("scan0", push, control, scanned);
  run("scan1", push, 1);
  run_indirect("scan2", push, control, scanned);
}

void GaussianDevice::sort_pass(const SortBuffers& b, const DeviceBuffer& control,
                               std::uint32_t n_at, const Dispatches& by, std::uint32_t shift) {
  const DeviceBuffer& values = b.values ? *b.values : *b.keys;
  const Push push(*b.keys, values, *b.keys_out, *b.values_out, counts, control, n_at, shift,
                  std::uint32_t{b.values == nullptr});
  run_indirect("sort0", push, control, by.by_sorted_group());
  scan(counts, control, by.counts_word(), kUnusedAt, by.by_counts_scanned());
  run_indirect("sort1", push, control, by.by_sorted_group());
}

void GaussianDevice::upload_numbers(std::span<const float> numbers, std::uint64_t version) {
  queue_.grow(&numbers_, numbers.size_bytes());
  queue_.upload(numbers_, 0, numbers.data(), numbers.size_bytes());
  version_ = version;
  size_ = numbers.size();
}

const DeviceBuffer* GaussianDevice::held(const Gaussians& gaussians) {
  if (gaussians.version == 0) return nullptr;
  if (gaussians.version != version_ || gaussians.numbers.size() > size_) {
    if (!host_numbers_.empty()) return nullptr;
    upload_numbers(gaussians.numbers, gaussians.version);
  }
  return &numbers_;
}

void GaussianDevice::hold(const GaussianUpdate& update) {
  if (host_numbers_.data() == update.numbers.data() &&
      host_numbers_.size() == update.numbers.size())
    return;
  REDRIVE_CHECK(host_numbers_.empty());  // fetch() ends what was in training
  if (update.version == 0 || update.version != version_ || update.numbers.size() > size_)
    upload_numbers(update.numbers, update.version);
  queue_.grow(&moments_, update.moments.size_bytes());
  queue_.grow(&errors_in_training_, update.errors.size_bytes());
  queue_.upload(moments_, 0, update.moments.data(), update.moments.size_bytes());
  queue_.upload(errors_in_training_, 0, update.errors.data(), update.errors.size_bytes());
  host_numbers_ = update.numbers;
  host_moments_ = update.moments;
  host_errors_ = update.errors;
}

void GaussianDevice::fetch() {
  if (host_numbers_.empty()) return;
  queue_.download(numbers_, 0, host_numbers_.data(), host_numbers_.size_bytes());
  queue_.download(moments_, 0, host_moments_.data(), host_moments_.size_bytes());
  queue_.download(errors_in_training_, 0, host_errors_.data(), host_errors_.size_bytes());
  host_numbers_ = host_errors_ = {};
  host_moments_ = {};
  version_ = 0;
  queue_.finish();
}

void GaussianDevice::apply(const GaussianUpdate& update, std::size_t n, const DeviceBuffer* drawn,
                           const DeviceBuffer* control) {
  UpdateParameters u{};
  u.numbers = numbers_.address();
  u.moments = moments_.address();
  u.errors = errors_in_training_.address();
  u.gradients = gradients.address();
  u.new_errors = errors.address();
  u.drawn = (drawn ? *drawn : numbers_).address();
  u.control = (control ? *control : numbers_).address();
  u.n = static_cast<std::uint32_t>(n);
  u.bounded_colours =
      static_cast<std::uint32_t>(std::min<std::size_t>(update.bounded_colours, UINT32_MAX));
  for (int row = 0; row < kDistanceRow; ++row)
    u.rows |= std::uint32_t{is_seen(update.rows, row)} << row;
  u.beta1 = update.step.beta1;
  u.beta2 = update.step.beta2;
  u.bias1 = update.step.bias1;
  u.bias2 = update.step.bias2;
  u.epsilon = update.step.epsilon;
  u.min_log_scale = update.min_log_scale;
  u.max_log_scale = update.max_log_scale;
  std::ranges::copy(update.rates, u.rates);
  queue_.grow(&update_, sizeof u);
  queue_.upload(update_, 0, &u, sizeof u);
  if (drawn)
    run_indirect("adam", Push(update_), *control, Dispatches{0}.by_64());
  else
    run("adam_all", Push(update_), (n + 63) / 64);
}

}  // namespace redrive::kernels::vulkan
