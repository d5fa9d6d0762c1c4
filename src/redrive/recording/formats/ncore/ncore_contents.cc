// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/ncore/ncore_contents.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/math/upper_median.h"
#include "redrive/recording/core/damaged_text.h"

namespace redrive::ncore {
namespace {

namespace fs = std::filesystem;

std::int64_t middle_of(const FrameSpan& span) { return 500 * (span.start_us + span.end_us); }

}  // namespace

std::vector<FrameFile> Contents::add_images(const Component& sensor, bool rolling,
                                            std::int64_t* readout_ns,
                                            std::vector<DamagedRecord>* damaged) {
  std::vector<FrameFile> images;
  std::vector<double> spans_ns;
  const DamagedList list{sensor.name, damaged};
  for (const FrameSpan& span : read_spans(sensor, damaged))
    parse_record(&list, -1, [&] {
      const std::string array = span.group + "/image";
      const auto size = sensor.store->file_size(array);
      if (!size) throw InputError(sensor.store->path(), array, "", "is missing");
      const nlohmann::json attributes = sensor.store->attributes(array);
      const JsonField format =
          JsonField(attributes, sensor.store->path() / array / ".zattrs").at("format");
      const std::string word = format.string();
      if (word != "jpeg" && word != "jpg" && word != "png") format.fail("must be jpeg or png");
      const fs::path path =
          root_ / sensor.name / (std::to_string(span.end_us) + (word == "png" ? ".png" : ".jpg"));
      files_[path.string()] = {sensor.store, array, *size};
      images.push_back({middle_of(span), path});
      spans_ns.push_back(static_cast<double>(1000 * (span.end_us - span.start_us)));
    });
  std::ranges::stable_sort(images, {}, &FrameFile::frame_id);
  *readout_ns = rolling && !spans_ns.empty() ? std::llround(upper_median(std::move(spans_ns))) : 0;
  return images;
}

MaskFile Contents::add_mask(const Component& masks, const std::string& array,
                            const std::string& camera) {
  const auto size = masks.store->file_size(array);
  if (!size) throw InputError(masks.store->path(), array, "", "is missing");
  const fs::path path = root_ / camera / "ego.png";
  files_[path.string()] = {masks.store, array, *size};
  return {path, /*black_is_masked=*/false};
}

std::vector<FrameFile> Contents::add_scans(const Component& sensor, std::size_t lidar,
                                           std::vector<DamagedRecord>* damaged) {
  std::vector<FrameFile> scans;
  for (const FrameSpan& span : read_spans(sensor, damaged)) {
    const fs::path path = root_ / sensor.name / (std::to_string(span.end_us) + ".rays");
    scans_[path.string()] = {sensor.store, span.group, span.end_us};
    scans.push_back({middle_of(span), path, lidar});
  }
  return scans;
}

const Contents::Scan& Contents::scan(const fs::path& path) const {
  return scans_.at(path.string());
}

std::optional<std::uint64_t> Contents::size(const fs::path& path) const {
  if (const auto file = files_.find(path.string()); file != files_.end()) return file->second.size;
  if (scans_.contains(path.string())) return 1;  // many arrays
  return std::nullopt;
}

std::string Contents::read(const fs::path& path, std::size_t most) const {
  const Entry& entry = files_.at(path.string());
  return entry.store->file(entry.array, most);
}

}  // namespace redrive::ncore
