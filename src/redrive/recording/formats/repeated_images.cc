// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/repeated_images.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <fstream>
#include <numbers>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/base/files/file_container.h"
#include "redrive/base/files/files.h"
#include "redrive/base/parallel.h"
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

/// An image file that is opened when its bytes are compared, and once.
class ComparedFile {
 public:
  explicit ComparedFile(const std::filesystem::path& path) : path_(&path) {
    std::error_code failed;
    const std::uintmax_t bytes = std::filesystem::file_size(path, failed);
    if (!failed) bytes_ = bytes;
  }
  const std::filesystem::path& path() const { return *path_; }
  std::uintmax_t bytes() const { return bytes_; }  ///< 0 also for a file that is missing
  std::ifstream& stream() {
    if (!stream_.is_open()) stream_.open(*path_, std::ios::binary);
    return stream_;
  }

 private:
  const std::filesystem::path* path_;
  std::uintmax_t bytes_ = 0;
  std::ifstream stream_;
};

/// Whether two files hold the same image: compressed pixels of different images differ all over.
bool holds_same(ComparedFile& a, ComparedFile& b) {
  if (container_of(a.path())) return holds_same_bytes(a.path(), b.path());
  if (a.bytes() == 0 || b.bytes() == 0) return false;
  const std::uintmax_t larger = std::max(a.bytes(), b.bytes()),
                       smaller = std::min(a.bytes(), b.bytes());
  if (larger - smaller > kMetadataBytes) return false;
  const auto equal = [&](bool from_end) {
    return equal_bytes(a.stream(), b.stream(), a.bytes(), b.bytes(), from_end);
  };
  const std::uintmax_t begin = equal(false);
  if (begin == larger) return true;
  if (smaller < kLeastBytes) return false;
  return static_cast<double>(begin + equal(true)) >= kEqualShare * static_cast<double>(larger);
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

/// Returns for each image of a camera whether it holds the pixels of the one before.
std::vector<char> find_repetitions(const RecordedCamera& camera, ThreadPool* pool) {
  std::vector<char> repeats(camera.images.size());
  constexpr std::size_t kGrain = 64;
  pool->run_ranges(repeats.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    std::size_t i = std::max<std::size_t>(begin, 1);
    for (ComparedFile before(camera.images[i - 1].path); i < end; ++i) {
      ComparedFile file(camera.images[i].path);
      repeats[i] = holds_same(before, file) && is_image(file.path(), camera.calibration);
      before = std::move(file);
    }
  });
  return repeats;
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
  ThreadPool pool(hardware_threads());
  for (RecordedCamera& camera : recording->cameras) {
    const std::vector<char> repeats = find_repetitions(camera, &pool);
    std::vector<ImageFile> kept;
    std::vector<std::int64_t> repeated;
    const Rigid3d* first = nullptr;  // where the present pixels appeared first
    for (std::size_t i = 0; i < camera.images.size(); ++i) {
      const ImageFile& image = camera.images[i];
      const Rigid3d* const pose = pose_of(image);
      const bool same = repeats[i] != 0;
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
