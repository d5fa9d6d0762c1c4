// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/repeated_images.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <fstream>
#include <numbers>

#include "redrive/base/error.h"
#include "redrive/base/files/file_container.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/damaged_records.h"

namespace redrive {
namespace {

constexpr double kMoved_m = 0.05, kMoved_rad = 0.5 * std::numbers::pi / 180;
constexpr std::uintmax_t kMetadataBytes = 256;  // times, comments
constexpr std::uintmax_t kLeastBytes = 4096;    // smaller files have to be equal in all bytes
constexpr double kEqualShare = 0.95;            // share of the bytes, from both ends of the files

/// Returns the number of equal bytes at the beginning of two files, or, with `from_end`, at their
/// end.
std::uintmax_t equal_bytes(std::ifstream& a, std::ifstream& b, std::uintmax_t a_size,
                           std::uintmax_t b_size, bool from_end) {
  constexpr std::uintmax_t kBlock = 1 << 14;
  const std::uintmax_t size = std::min(a_size, b_size);
  std::array<char, kBlock> of_a, of_b;
  for (std::uintmax_t done = 0; done < size;) {
    const std::uintmax_t n = std::min(kBlock, size - done);
    const auto read = [&](std::ifstream& file, std::uintmax_t file_size, char* block) {
      file.seekg(static_cast<std::streamoff>(from_end ? file_size - done - n : done));
      return bool(file.read(block, static_cast<std::streamsize>(n)));
    };
    if (!read(a, a_size, of_a.data()) || !read(b, b_size, of_b.data())) return 0;
    std::uintmax_t equal = 0;
    while (equal < n &&
           (from_end ? of_a[n - 1 - equal] == of_b[n - 1 - equal] : of_a[equal] == of_b[equal]))
      ++equal;
    done += equal;
    if (equal < n) return done;
  }
  return size;
}

/// Whether two files in a container hold the same image, equal in all bytes. Damaged ones are not.
bool holds_same_bytes(const std::filesystem::path& a, const std::filesystem::path& b) {
  constexpr std::size_t kHead = 1 << 14;
  try {
    return file_bytes(a) == file_bytes(b) && read_head(a, kHead) == read_head(b, kHead) &&
           read_file(a, kMaxImageBytes) == read_file(b, kMaxImageBytes);
  } catch (const InputError&) {
    return false;
  }
}

/// Whether two files hold the same image: compressed pixels of different images differ all over.
bool holds_same(const std::filesystem::path& a, const std::filesystem::path& b) {
  if (container_of(a)) return holds_same_bytes(a, b);
  std::error_code failed;
  const std::uintmax_t a_size = std::filesystem::file_size(a, failed);
  if (failed) return false;
  const std::uintmax_t b_size = std::filesystem::file_size(b, failed);
  if (failed || a_size == 0 || b_size == 0) return false;
  const std::uintmax_t larger = std::max(a_size, b_size), smaller = std::min(a_size, b_size);
  if (larger - smaller > kMetadataBytes) return false;
  std::ifstream file_a(a, std::ios::binary), file_b(b, std::ios::binary);
  const std::uintmax_t begin = equal_bytes(file_a, file_b, a_size, b_size, false);
  if (begin == larger) return true;
  if (smaller < kLeastBytes) return false;
  return static_cast<double>(begin + equal_bytes(file_a, file_b, a_size, b_size, true)) >=
         kEqualShare * static_cast<double>(larger);
}

/// Damaged files may be equal, too: they are left to leave_out_damaged.
bool is_image(const std::filesystem::path& file, const CameraCalibration& camera) {
  try {
    check_image(file, camera, /*whole=*/false);
    return true;
  } catch (const InputError&) {
    return false;
  }
}

double distance(const Rigid3d& a, const Rigid3d& b) {
  return (a.translation() - b.translation()).norm();
}

}  // namespace

void leave_out_repeated_images(Recording* recording) {
  if (!recording->metric) return;
  const auto pose_of = [&](const ImageFile& image) -> const Rigid3d* {
    const auto frame =
        std::ranges::lower_bound(recording->frames, image.frame_id, {}, &FramePose::id);
    return frame != recording->frames.end() && frame->id == image.frame_id
               ? &frame->global_from_body
               : nullptr;
  };
  for (RecordedCamera& camera : recording->cameras) {
    std::vector<ImageFile> kept;
    std::vector<std::int64_t> repeated;
    const Rigid3d* first = nullptr;  // where the present pixels appeared first
    for (std::size_t i = 0; i < camera.images.size(); ++i) {
      const ImageFile& image = camera.images[i];
      const Rigid3d* const pose = pose_of(image);
      const bool same = i > 0 && holds_same(camera.images[i - 1].path, image.path) &&
                        is_image(image.path, camera.calibration);
      if (!same) first = pose;
      if (same && first && pose &&
          (distance(*first, *pose) > kMoved_m ||
           Eigen::AngleAxisd(first->linear().transpose() * pose->linear()).angle() > kMoved_rad))
        repeated.push_back(image.frame_id);
      else
        kept.push_back(image);
    }
    if (repeated.empty()) continue;
    if (kept.size() == 1) {
      recording->findings.push_back(
          {camera.calibration.name, "all " + counted(camera.images.size(), "image") +
                                        " have the same pixels, while the poses move on"});
      continue;
    }
    camera.images = std::move(kept);
    recording->findings.push_back(
        {camera.calibration.name, counted(repeated.size(), "image") +
                                      " left out, which repeat the pixels of the one before "
                                      "while the poses move on: frame" +
                                      (repeated.size() == 1 ? " " : "s ") + first_few(repeated)});
  }
}

}  // namespace redrive
