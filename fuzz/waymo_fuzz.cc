// SPDX-License-Identifier: Apache-2.0
// Segments of Waymo: reads any bytes or throws an InputError. The first byte chooses: 'r' records
// with their checksums, else a frame.
#include <cstddef>
#include <cstdint>
#include <string>

#include "redrive/base/error.h"
#include "redrive/recording/formats/waymo/tfrecord.h"
#include "redrive/recording/formats/waymo/waymo_frame.h"
#include "redrive/recording/formats/waymo/waymo_scan.h"

namespace {

using namespace redrive;

void expect(bool condition) {
  if (!condition) __builtin_trap();
}

void read_frame(const ByteSource& bytes) {
  const ByteSpan all{0, bytes.size()};
  std::vector<Finding> findings;
  const waymo::Context context = waymo::parse_context(bytes, all, "f", &findings);
  for (const auto& [number, camera] : context.cameras)
    expect(camera.calibration.width > 0 && camera.calibration.parameters.size() == 9);
  std::vector<std::string> impossible;
  std::vector<DamagedRecord> damaged;
  const waymo::Frame frame = waymo::parse_frame(bytes, all, 0, "f", &impossible, &damaged);
  for (const waymo::Image& image : frame.images)
    expect(image.jpeg.begin < image.jpeg.end && image.jpeg.end <= bytes.size());
  for (const waymo::LabelledBox& box : frame.boxes) expect(box.size_m.minCoeff() > 0);
  for (const waymo::RangeImage& image : frame.range_images) {
    const auto laser = context.lasers.find(image.laser);
    if (laser == context.lasers.end()) continue;
    const waymo::Revolution revolution{frame.t_ns, frame.t_ns + 1, frame.world_from_body};
    const std::vector<FramePose> poses{{0, frame.t_ns, frame.world_from_body}};
    try {
      for (const LidarPoint& point :
           waymo::read_scan(bytes, image, laser->second, revolution, poses, "f", nullptr))
        expect(point.in_body_m.allFinite());
    } catch (const InputError&) {
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const StringBytes bytes(std::string(reinterpret_cast<const char*>(data) + 1, size - 1));
  try {
    if (data[0] == 'r') {
      std::vector<DamagedRecord> damaged;
      for (const ByteSpan& record : waymo::list_records(bytes, "f", &damaged))
        expect(record.begin <= record.end && record.end <= bytes.size());
    } else {
      read_frame(bytes);
    }
  } catch (const InputError&) {
  }
  return 0;
}
