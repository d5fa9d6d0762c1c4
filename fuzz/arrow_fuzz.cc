// SPDX-License-Identifier: Apache-2.0
// Arrow's files, as any table and as each one of Argoverse 2: parses any bytes or throws an
// InputError.
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/argoverse2/argoverse2_boxes.h"
#include "redrive/recording/formats/argoverse2/argoverse2_scan.h"
#include "redrive/recording/formats/argoverse2/argoverse2_tables.h"
#include "redrive/recording/parse/arrow_table.h"

namespace {

void tried(const std::function<void()>& parse) {
  try {
    parse();
  } catch (const redrive::InputError&) {
  }
}

void expect(bool condition) {
  if (!condition) __builtin_trap();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace redrive;
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  tried([&] {
    const ArrowTable table(bytes, "t");
    for (const char* column : {"x", "h", "s", "i", "t", "u", "b", "label", "kind"}) {
      tried([&] { expect(table.numbers(column).size() == table.rows()); });
      tried([&] { expect(table.integers(column).size() == table.rows()); });
      tried([&] { expect(table.texts(column).size() == table.rows()); });
    }
  });
  std::vector<FramePose> poses = {{0, 0, Rigid3d::Identity()}};
  tried([&] {
    poses = argoverse2::parse_poses(bytes, "t", nullptr);
    for (std::size_t i = 1; i < poses.size(); ++i) expect(poses[i].t_ns > poses[i - 1].t_ns);
  });
  tried([&] { argoverse2::parse_extrinsics(bytes, "t"); });
  tried([&] {
    for (const auto& [name, camera] : argoverse2::parse_intrinsics(bytes, "t"))
      expect(camera.width > 0 && camera.height > 0 && camera.parameters[0] > 0);
  });
  tried([&] {
    const auto points = argoverse2::parse_scan(bytes, "t", argoverse2::Lidar::kUp, 0, poses);
    for (const LidarPoint& point : points) expect(point.in_body_m.allFinite());
    argoverse2::sweep_timing(points, 0, poses[0].global_from_body);
  });
  tried([&] {
    std::vector<std::string> impossible;
    for (const argoverse2::Cuboid& cuboid : argoverse2::parse_cuboids(bytes, "t", &impossible))
      expect(cuboid.size_m.minCoeff() > 0 && !cuboid.track.empty());
  });
  return 0;
}
