// SPDX-License-Identifier: Apache-2.0
// Stores of NCore: reads what any files hold, or throws an InputError. The first byte chooses: 't'
// an indexed tar, else files as text, each a line "KEY SIZE" and its bytes.
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/base/files/indexed_tar.h"
#include "redrive/base/files/zarr_reader.h"
#include "redrive/recording/formats/ncore/ncore_cuboids.h"
#include "redrive/recording/formats/ncore/ncore_lens.h"
#include "redrive/recording/formats/ncore/ncore_scan.h"

namespace {

using namespace redrive;

void expect(bool condition) {
  if (!condition) __builtin_trap();
}

class Files : public ZarrFiles {
 public:
  explicit Files(std::string_view text) {
    files_[".zgroup"] = "{}";
    while (!text.empty()) {
      const std::string_view line = text.substr(0, text.find('\n'));
      text.remove_prefix(std::min(text.size(), line.size() + 1));
      const std::size_t space = line.find(' ');
      std::size_t size = 0;
      if (space != line.npos)
        std::from_chars(line.data() + space + 1, line.data() + line.size(), size);
      files_[std::string(line.substr(0, space))] = std::string(text.substr(0, size));
      text.remove_prefix(std::min(text.size(), size));
      if (text.starts_with('\n')) text.remove_prefix(1);
    }
  }
  std::optional<std::uint64_t> size(const std::string& key) const override {
    const auto file = files_.find(key);
    return file == files_.end() ? std::nullopt : std::optional<std::uint64_t>(file->second.size());
  }
  std::string read(const std::string& key, std::size_t most) const override {
    return files_.at(key).substr(0, most);
  }
  std::vector<std::string> folders(const std::string& within) const override {
    const std::string start = within.empty() ? "" : within + "/";
    std::vector<std::string> names;
    for (const auto& [key, bytes] : files_) {
      const std::size_t slash = key.find('/', start.size());
      if (key.starts_with(start) && slash != key.npos)
        names.push_back(key.substr(start.size(), slash - start.size()));
    }
    std::ranges::sort(names);
    names.erase(std::unique(names.begin(), names.end()), names.end());
    return names;
  }

 private:
  std::map<std::string, std::string> files_;
};

template <class Parse>
void attempt(const Parse& parse) {
  try {
    parse();
  } catch (const InputError&) {
  }
}

void read_store(std::string_view text) {
  const auto store = std::make_shared<const ZarrReader>(std::make_unique<Files>(text), "s");
  attempt([&] {
    const ZarrReader::Numbers numbers = store->numbers("a");
    std::size_t all = 1;
    for (const std::size_t size : numbers.shape) all *= size;
    expect(numbers.values.size() == all);
  });
  attempt([&] { expect(store->file("f", 100).size() <= 100); });
  const ncore::Component component{store, "c", "c"};
  ncore::Poses poses;
  attempt([&] {
    Recording recording;
    poses = ncore::read_poses(component, &recording);
    for (const FramePose& pose : poses.world_from_rig)
      expect(pose.global_from_body.matrix().allFinite());
  });
  if (!poses.world_from_rig.empty())
    attempt([&] {
      std::vector<std::string> impossible;
      for (const ncore::Cuboid& cuboid : ncore::read_cuboids(component, poses, &impossible))
        expect(cuboid.size_m.minCoeff() > 0);
    });
  attempt([&] {
    const nlohmann::json attributes = store->attributes("l");
    CameraCalibration camera;
    std::vector<Finding> findings;
    ncore::parse_lens(JsonField(attributes, "l"), &camera, &findings);
    expect(camera.width > 0);
  });
  attempt([&] {
    std::vector<DamagedRecord> damaged;
    for (const ncore::FrameSpan& span : ncore::read_spans(component, &damaged))
      attempt([&] {
        for (const LidarPoint& point :
             ncore::read_scan({store, span.group, span.end_us}, Rigid3d::Identity(), nullptr))
          expect(point.in_body_m.allFinite());
      });
  });
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::string_view text(reinterpret_cast<const char*>(data) + 1, size - 1);
  try {
    if (data[0] == 't') {
      const IndexedTar tar(std::make_unique<StringBytes>(std::string(text)), "t");
      for (const auto& [name, member] : tar.members())
        expect(tar.read(member, 1 << 16).size() <= size);
    } else {
      read_store(text);
    }
  } catch (const InputError&) {
  }
  return 0;
}
