// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/vulkan/vulkan_raster.h"

#include <algorithm>
#include <bit>
#include <limits>

#include "redrive/base/error.h"
#include "redrive/kernels/gaussian/centre_boxes.h"
#include "redrive/kernels/gaussian/check_gaussian_sizes.h"
#include "redrive/kernels/gaussian/shutter_keys.h"
#include "redrive/kernels/gaussian/vulkan/shader_parameters.h"

namespace redrive::kernels::vulkan {
namespace {

constexpr std::size_t kWord = 4, kRecordBytes = 64, kSumFloats = 16, kFewestPairs = 1 << 16;
constexpr BlockShape kBlocks{8, 4};
/// common.glsl.
constexpr std::size_t kSegment = 256, kStateFloats = 5;
constexpr int kDepthShifts[] = {8, 16, 24};  // the bits of a distance down to 2^-16 of it

template <class T>
void grow_for(Queue& queue, DeviceBuffer* buffer, std::size_t n) {
  queue.grow(buffer, n * sizeof(T));
}

/// Appends a block to the bytes of an upload; returns its offset.
template <class T>
std::size_t append(std::span<const T> block, std::vector<std::byte>* bytes) {
  const std::size_t at = (bytes->size() + 15) / 16 * 16;
  bytes->resize(at + std::max<std::size_t>(block.size_bytes(), 1));
  if (!block.empty()) std::memcpy(bytes->data() + at, block.data(), block.size_bytes());
  return at;
}

}  // namespace

std::uint32_t VulkanRaster::model() const {
  return static_cast<std::uint32_t>(camera_.camera.model);
}

void VulkanRaster::forward(const GaussianCamera& camera, const Gaussians& gaussians,
                           const RasterOptions& options) {
  check_rasterise(camera, gaussians, options);
  camera_ = camera;
  gaussians_ = gaussians;
  options_ = options;
  size_ = raster_size(camera.camera.width, camera.camera.height);
  Queue& queue = shared_.queue();
  numbers_ = shared_.held(gaussians);
  if (!numbers_) {
    queue.grow(&own_numbers_, gaussians.numbers.size_bytes());
    numbers_ = &own_numbers_;
  }
  max_pairs_ = std::max(max_pairs_, kFewestPairs);
  allocate();
  if (numbers_ == &own_numbers_)
    queue.upload(own_numbers_, 0, gaussians.numbers.data(), gaussians.numbers.size_bytes());
  if (has_ranges()) upload_ranges();
  write_inputs();
  record_forward();
  complete_ = on_host_ = false;
}

void VulkanRaster::upload_ranges() {
  Queue& queue = shared_.queue();
  const std::span<const float> all = options_.log_range;
  if (options_.ranged.empty()) {
    queue.upload(log_range_, 0, all.data(), all.size_bytes());
    return;
  }
  std::vector<std::uint32_t> words;
  for (const std::uint32_t pixel : options_.ranged) {
    words.push_back(pixel);
    words.push_back(std::bit_cast<std::uint32_t>(all[pixel]));
  }
  grow_for<std::uint32_t>(queue, &ranged_, words.size());
  queue.upload(ranged_, 0, words.data(), words.size() * kWord);
  queue.fill(log_range_, all.size_bytes(), std::bit_cast<std::uint32_t>(kNoRange));
  const auto n = static_cast<std::uint32_t>(options_.ranged.size());
  shared_.run("ranged", Push(log_range_, ranged_, n), (n + 255) / 256);
}

void VulkanRaster::allocate() {
  Queue& queue = shared_.queue();
  const std::size_t n = gaussian_blocks(gaussians_.n) * kGaussianBlock, plane = size_.plane(),
                    tiles = plane / (kTileSide * kTileSide), most = std::max(n, max_pairs_);
  const auto plane_of = [&](DeviceBuffer* buffer, std::size_t planes) {
    const std::size_t bytes = planes * plane * sizeof(float);
    if (buffer->bytes() >= bytes) return;
    queue.grow(buffer, bytes);
    queue.fill(*buffer, buffer->bytes(), 0);  // unwanted tiles are read, too
  };
  queue.grow(&control_, kControlWords * kWord);
  queue.grow(&records_, n * kRecordBytes);
  for (DeviceBuffer* words : {&depth_key_, &drawn_, &shared_.keys[0], &shared_.keys[1],
                              &shared_.ids[0], &shared_.ids[1], &shared_.first})
    queue.grow(words, n * kWord);
  for (DeviceBuffer* words : {&pair_gaussian_, &pair_blocks_, &slots_, &shared_.slots,
                              &shared_.tile_keys[0], &shared_.tile_keys[1]})
    queue.grow(words, max_pairs_ * kWord);
  const std::size_t states = max_pairs_ / kSegment;
  queue.grow(&segments_, states * kWord);
  queue.grow(&states_, states * kSegment * kStateFloats * sizeof(float));
  const std::size_t counts = (most / 4096 + 1) * 256;
  queue.grow(&shared_.counts, counts * kWord);
  queue.grow(&shared_.block_sums, (std::max(most, counts) / 2048 + 1) * kWord);
  queue.grow(&ranges_, (tiles + 1) * kWord);
  plane_of(&rgb_, 3);
  plane_of(&transmittance_, 1);
  plane_of(&depth_, 1);
  plane_of(&last_, 1);
  if (options_.parts) {
    plane_of(&shown_, 1);
    queue.grow(&extents_, camera_.parts.size() * sizeof(PartExtent));
  }
  if (!has_ranges()) return;
  plane_of(&range_error_, 1);
  plane_of(&log_range_, 1);
}

std::uint64_t VulkanRaster::training_bytes(std::size_t n, std::size_t pixels) {
  // Buffers that allocate(), backward() and GaussianDevice::hold() make.
  constexpr std::uint64_t kPerGaussian = kRecordBytes + kSumFloats * kWord +
                                         (3 * kGaussianRows + 2 + 7) * kWord,
                          kPerPair =
                              kSumFloats * kWord + 6 * kWord + kStateFloats * kWord + kWord / 4;
  // Images with ranges, which most pixels may have, and of VulkanLoss slopes and a target's window
  // with the pixels beside it.
  constexpr std::uint64_t kPerPixel = (8 + 6 + 2 + 9) * kWord + 2 * (3 + 1 + 1);
  // 1.5 pairs a Gaussian were counted in windows of drives; a first image may have more.
  const std::uint64_t pairs = std::max<std::uint64_t>(2 * n, kFewestPairs),
                      bytes = kPerGaussian * n + kPerPair * pairs + kPerPixel * pixels;
  return bytes + bytes / 8;  // Queue::grow
}

void VulkanRaster::write_inputs() {
  Queue& queue = shared_.queue();
  const std::size_t tiles_x = size_.stride / kTileSide, tiles_y = size_.rows / kTileSide,
                    tiles = tiles_x * tiles_y;
  input_bytes_.assign(sizeof(ShaderParameters), std::byte{});
  const std::size_t n_keys = camera_.world_from_camera.size();
  std::vector<float> keys = shutter_keys(camera_.world_from_camera);
  std::vector<std::uint32_t> parts = {0, 1};
  std::uint32_t object = 0;
  for (const GaussianPart& part : camera_.parts) {
    std::vector<float> of_part = shutter_keys(part.part_from_camera);
    of_part.resize(n_keys * kKeyFloats);
    keys.insert(keys.end(), of_part.begin(), of_part.end());
    parts.push_back(static_cast<std::uint32_t>(part.first_block));
    object += !part.continues;
    parts.push_back(object << 1 | !part.part_from_camera.empty());
  }
  parts_ = parts.size() / 2;
  std::vector<std::uint32_t> wanted(tiles, 1);
  if (!options_.tiles.empty()) std::ranges::copy(options_.tiles, wanted.begin());
  std::vector<float> boxes, extents;
  if (has_centres()) {
    boxes.resize(tiles * 4 * kBlocks.blocks());
    extents.resize(2 * (tiles_x + tiles_y));
    find_boxes(size_, camera_.centres, kBlocks, shared_.pool(), boxes.data(), extents);
  }
  const std::size_t keys_at = append<float>(keys, &input_bytes_),
                    parts_at = append<std::uint32_t>(parts, &input_bytes_),
                    wanted_at = append<std::uint32_t>(wanted, &input_bytes_),
                    boxes_at = append<float>(boxes, &input_bytes_),
                    extents_at = append<float>(extents, &input_bytes_),
                    u_at = append(camera_.centres.u, &input_bytes_),
                    v_at = append(camera_.centres.v, &input_bytes_);
  queue.grow(&inputs_, input_bytes_.size());
  const VkDeviceAddress inputs = inputs_.address();
  ShaderParameters p{};
  p.numbers = numbers_->address();
  p.pose_keys = inputs + keys_at;
  p.parts = inputs + parts_at;
  p.records = records_.address();
  p.depth_key = depth_key_.address();
  p.drawn = drawn_.address();
  p.by_depth = shared_.ids[1].address();
  p.pair_first = shared_.first.address();
  p.pair_gaussian = pair_gaussian_.address();
  p.pair_blocks = pair_blocks_.address();
  p.ranges = ranges_.address();
  p.control = control_.address();
  p.wanted = inputs + wanted_at;
  p.centre_u = inputs + u_at;
  p.centre_v = inputs + v_at;
  p.boxes = inputs + boxes_at;
  p.extents = inputs + extents_at;
  p.rgb = rgb_.address();
  p.transmittance = transmittance_.address();
  p.depth = depth_.address();
  p.range_error = (has_ranges() ? range_error_ : depth_).address();
  p.log_range = (has_ranges() ? log_range_ : depth_).address();
  p.last = last_.address();
  p.states = states_.address();
  p.segments = segments_.address();
  p.n = static_cast<std::uint32_t>(gaussians_.n);
  p.n_parts = static_cast<std::uint32_t>(parts_);
  p.max_pairs = static_cast<std::uint32_t>(max_pairs_);
  set_camera(camera_, size_, &p);
  std::ranges::copy(options_.background, p.background);
  std::memcpy(input_bytes_.data(), &p, sizeof p);
  queue.upload(inputs_, 0, input_bytes_.data(), input_bytes_.size());
}

void VulkanRaster::record_depth_order() {
  const std::uint32_t n = static_cast<std::uint32_t>(gaussians_.n), unused = 0,
                      groups_of_row = shared_.queue().groups_of_row();
  const Dispatches by{0};
  const Push flags(depth_key_, shared_.block_sums, control_, drawn_, shared_.keys[0], unused,
                   kDrawnAt, n);
  const std::size_t groups = (gaussians_.n + 2047) / 2048;
  shared_.run("flags0", flags, groups);
  shared_.run("flags1", flags, 1);
  shared_.run("flags2", flags, groups);
  shared_.run("plan", Push(control_, kDrawnAt, unused, n, groups_of_row, unused), 1);
  shared_.queue().stamp("compact");
  const DeviceBuffer* values = &drawn_;
  int from = 0;
  for (const int shift : kDepthShifts) {
    const int to = 1 - from;
    shared_.sort_pass({&shared_.keys[from], values, &shared_.keys[to], &shared_.ids[to]}, control_,
                      kDrawnAt, by, static_cast<std::uint32_t>(shift));
    values = &shared_.ids[to];
    from = to;
  }
  shared_.queue().stamp("sort by depth");
}

void VulkanRaster::record_pairs() {
  const std::size_t tiles = size_.plane() / (kTileSide * kTileSide);
  const std::uint32_t centres = has_centres(), set = 1;
  const Dispatches by_gaussian{0}, by_pair{1};
  const int passes = (std::bit_width(tiles) + 7) / 8;
  // The first keys lie so that the last slots lie in slots_.
  const Push push(inputs_, shared_.tile_keys[0]);
  shared_.run_indirect("pairs0", push, control_, by_gaussian.by_256(), {centres});
  shared_.scan(shared_.first, control_, kDrawnAt, kPairsAt, by_gaussian.by_scanned());
  shared_.run("plan",
              Push(control_, kPairsAt, set, static_cast<std::uint32_t>(max_pairs_),
                   shared_.queue().groups_of_row(), static_cast<std::uint32_t>(tiles)),
              1);
  shared_.queue().fill(shared_.tile_keys[0], max_pairs_ * kWord, UINT32_MAX);
  shared_.run_indirect("pairs1", push, control_, by_gaussian.by_256(), {centres});
  shared_.queue().stamp("pairs");
  const DeviceBuffer* values = nullptr;
  for (int pass = 0; pass < passes; ++pass) {
    const DeviceBuffer* const out = (passes - 1 - pass) % 2 == 0 ? &slots_ : &shared_.slots;
    shared_.sort_pass({&shared_.tile_keys[pass % 2], values, &shared_.tile_keys[1 - pass % 2], out},
                      control_, kPairsAt, by_pair, static_cast<std::uint32_t>(8 * pass));
    values = out;
  }
  shared_.queue().fill(ranges_, (tiles + 1) * kWord, 0);
  shared_.queue().fill(segments_, max_pairs_ / kSegment * kWord, UINT32_MAX);
  shared_.run_indirect("ranges", Push(inputs_, shared_.tile_keys[passes % 2]), control_,
                       by_pair.by_256());
  shared_.queue().stamp("sort by tile");
}

void VulkanRaster::record_forward() {
  Queue& queue = shared_.queue();
  const std::size_t tiles = size_.plane() / (kTileSide * kTileSide);
  queue.fill(control_, kControlWords * kWord, 0);
  queue.stamp("upload");
  shared_.run("project", Push(inputs_), (gaussians_.n + 127) / 128, {model()});
  queue.stamp("project");
  record_depth_order();
  record_pairs();
  shared_.run("tile_forward", Push(inputs_, slots_), tiles, {has_centres(), has_ranges()});
  queue.stamp("forward");
  if (options_.parts) record_parts();
}

void VulkanRaster::record_parts() {
  Queue& queue = shared_.queue();
  const std::vector<PartExtent> none(objects_of(camera_.parts));
  queue.upload(extents_, 0, none.data(), none.size() * sizeof(PartExtent));
  shared_.run("tile_parts", Push(inputs_, slots_, shown_, extents_),
              size_.plane() / (kTileSide * kTileSide), {has_centres()});
  queue.stamp("parts");
}

void VulkanRaster::fetch_parts() {
  Queue& queue = shared_.queue();
  const std::size_t plane = size_.plane();
  std::vector<std::uint32_t> shown(plane);
  image_.extents.resize(objects_of(camera_.parts));
  queue.download(shown_, 0, shown.data(), plane * kWord);
  queue.download(extents_, 0, image_.extents.data(), image_.extents.size() * sizeof(PartExtent));
  queue.finish();
  if (image_.parts.size() < plane) image_.parts = Buffer<std::uint16_t>(plane);
  std::ranges::transform(shown, image_.parts.data(),
                         [](std::uint32_t part) { return static_cast<std::uint16_t>(part); });
}

bool VulkanRaster::overflowed() {
  const std::size_t found = control_words_[kOverflowAt];
  complete_ = found == 0;
  if (complete_) return false;
  max_pairs_ = found + found / 4;
  allocate();
  write_inputs();
  record_forward();
  return true;
}

void VulkanRaster::complete() {
  while (!complete_) {
    shared_.queue().download(control_, 0, control_words_, sizeof control_words_);
    shared_.queue().finish();
    overflowed();
  }
}

RasterCounts VulkanRaster::counts() {
  complete();
  return {control_words_[kDrawnAt], control_words_[kPairsAt]};
}

const RasterImage& VulkanRaster::image() {
  complete();
  if (on_host_) return image_;
  const auto fetch = [&](const DeviceBuffer& from, std::size_t planes, Buffer<float>* to) {
    const std::size_t n = planes * size_.plane();
    if (to->size() < n) *to = Buffer<float>(n);
    shared_.queue().download(from, 0, to->data(), n * sizeof(float));
  };
  image_.size = size_;
  fetch(rgb_, 3, &image_.rgb);
  fetch(transmittance_, 1, &image_.transmittance);
  if (options_.depth) fetch(depth_, 1, &image_.depth);
  if (has_ranges()) fetch(range_error_, 1, &image_.range_error);
  if (options_.parts) fetch_parts();
  shared_.queue().finish();
  on_host_ = true;
  return image_;
}

void VulkanRaster::allocate_backward() {
  Queue& queue = shared_.queue();
  const std::size_t n = gaussian_blocks(gaussians_.n) * kGaussianBlock, plane = size_.plane();
  grow_for<float>(queue, &d_rgb_, 3 * plane);
  grow_for<float>(queue, &d_transmittance_, plane);
  grow_for<float>(queue, &error_, plane);
  if (has_ranges()) grow_for<float>(queue, &d_range_, plane);
  grow_for<float>(queue, &shared_.pair_sums, max_pairs_ * kSumFloats);
  grow_for<float>(queue, &shared_.sums, n * kSumFloats);
  grow_for<float>(queue, &shared_.gradients, n * kGaussianRows);
  grow_for<float>(queue, &shared_.errors, n);
  grow_for<float>(queue, &shared_.pose_sums, 6 * parts_);
}

ImageLossOutput VulkanRaster::backward(
    const ImageLossInput& target, const PixelWeights& weights, const GaussianDerivatives& to,
    std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) {
  Queue& queue = shared_.queue();
  if (to.update) shared_.hold(*to.update);
  do {
    allocate_backward();
    LossPlanes planes{size_,     &rgb_,           &d_rgb_,          &error_,
                      &control_, &transmittance_, &d_transmittance_};
    if (has_ranges()) {
      planes.range_error = &range_error_;
      planes.log_range = &log_range_;
      planes.d_range = &d_range_;
    }
    loss_.record(planes, target, weights);
    queue.download(control_, 0, control_words_, sizeof control_words_);
    // The host goes on with the loss while the device works at the rest.
    queue.split();
    record_backward(to, !d_poses.empty());
    queue.submit();
    queue.wait_first();
  } while (overflowed());
  take_results(to, d_poses);
  ImageLossOutput out = loss_.result();
  if (to.update && !is_finite(out))
    std::ranges::fill(d_poses, GaussianPoseGradient<NumberMath<double>>{});
  return out;
}

void VulkanRaster::backward(const RasterGradient& gradient, const GaussianDerivatives& to,
                            std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) {
  check_rasterise_backward(camera_, gaussians_, options_, gradient, to, d_poses.size());
  Queue& queue = shared_.queue();
  complete();
  if (to.update) shared_.hold(*to.update);
  allocate_backward();
  const auto send = [&](std::span<const float> from, const DeviceBuffer& buffer) {
    queue.upload(buffer, 0, from.data(), from.size_bytes());
  };
  send(gradient.d_rgb, d_rgb_);
  send(gradient.d_transmittance, d_transmittance_);
  send(gradient.error, error_);
  if (has_ranges()) send(gradient.d_range, d_range_);
  record_backward(to, !d_poses.empty());
  queue.submit();
  take_results(to, d_poses);
}

void VulkanRaster::record_backward(const GaussianDerivatives& to, bool with_poses) {
  Queue& queue = shared_.queue();
  const std::size_t n = gaussian_blocks(gaussians_.n) * kGaussianBlock;
  ShaderParameters p;
  std::memcpy(&p, input_bytes_.data(), sizeof p);
  p.d_rgb = d_rgb_.address();
  p.d_transmittance = d_transmittance_.address();
  p.error = error_.address();
  p.d_range = (has_ranges() ? d_range_ : error_).address();
  p.pair_sums = shared_.pair_sums.address();
  p.sums = shared_.sums.address();
  p.gradients = shared_.gradients.address();
  p.errors = shared_.errors.address();
  queue.upload(inputs_, 0, &p, sizeof p);
  if (!to.update) {
    queue.fill(shared_.gradients, n * kGaussianRows * sizeof(float), 0);
    queue.fill(shared_.errors, n * sizeof(float), 0);
  }
  const Dispatches by{0}, by_pair{1};
  queue.stamp("upload");
  shared_.run_indirect("tile_backward", Push(inputs_, slots_), control_, by_pair.by_segment(),
                       {has_centres(), has_ranges()});
  queue.stamp("backward");
  shared_.run_indirect("sum_pairs", Push(inputs_), control_, by.by_16());
  queue.stamp("sum pairs");
  shared_.run_indirect("adjoint", Push(inputs_, std::uint32_t{with_poses}), control_, by.by_64(),
                       {model()});
  queue.stamp("adjoint");
  if (with_poses) {
    shared_.run("pose_sums", Push(inputs_, shared_.pose_sums), parts_);
    pose_sums_.resize(6 * parts_);
    queue.download(shared_.pose_sums, 0, pose_sums_.data(), pose_sums_.size() * sizeof(float));
  }
  if (to.update) {
    shared_.apply(*to.update, gaussians_.n, &drawn_, &control_);
    queue.stamp("update");
    return;
  }
  gradients_.resize(to.gradients.size());
  errors_.resize(to.errors.size());
  queue.download(shared_.gradients, 0, gradients_.data(), gradients_.size() * sizeof(float));
  queue.download(shared_.errors, 0, errors_.data(), errors_.size() * sizeof(float));
}

void VulkanRaster::take_results(const GaussianDerivatives& to,
                                std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) {
  if (to.update && d_poses.empty()) return;  // the host does not wait
  shared_.queue().finish();
  for (std::size_t s = 0; s < d_poses.size(); ++s)
    for (int k = 0; k < 3; ++k) {
      d_poses[s].translation[k] = static_cast<double>(pose_sums_[6 * s + k]);
      d_poses[s].rotation[k] = static_cast<double>(pose_sums_[6 * s + 3 + k]);
    }
  if (to.update) return;
  for (std::size_t i = 0; i < gradients_.size(); ++i) to.gradients[i] += gradients_[i];
  for (std::size_t i = 0; i < errors_.size(); ++i) to.errors[i] += errors_[i];
}

}  // namespace redrive::kernels::vulkan
