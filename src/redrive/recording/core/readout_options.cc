// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/readout_options.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <optional>

#include "redrive/base/error.h"

namespace redrive {
namespace {

struct Readout {
  std::string camera;  ///< empty: all
  bool estimated = false;
  double ms = 0;
};

Readout parse_readout(const std::string& text) {
  const std::size_t colon = text.rfind(':');
  Readout readout;
  readout.camera = colon == std::string::npos ? "" : text.substr(0, colon);
  const std::string value = colon == std::string::npos ? text : text.substr(colon + 1);
  readout.estimated = value == "estimate";
  if (readout.estimated) return readout;
  const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), readout.ms);
  if (error != std::errc() || end != value.data() + value.size() ||
      !(std::abs(readout.ms) <= 1e3 * kMaxReadout_s))
    throw UsageError("--rolling-shutter", text,
                     "must be MS, CAM:MS, estimate or CAM:estimate with milliseconds in -200..200");
  return readout;
}

}  // namespace

std::vector<bool> apply_readout_options(const std::vector<std::string>& options,
                                        Recording* recording) {
  std::vector<std::optional<Readout>> of_camera(recording->cameras.size());
  for (const std::string& text : options) {
    const Readout readout = parse_readout(text);
    bool found = false;
    for (std::size_t c = 0; c < of_camera.size(); ++c)
      if (readout.camera.empty() || recording->cameras[c].calibration.name == readout.camera) {
        of_camera[c] = readout;
        found = true;
      }
    if (!found)
      throw UsageError("--rolling-shutter", text,
                       "the recording has no camera " + readout.camera + " with images");
  }
  std::vector<bool> estimated(of_camera.size(), false);
  for (std::size_t c = 0; c < of_camera.size(); ++c) {
    if (!of_camera[c]) continue;
    estimated[c] = of_camera[c]->estimated;
    if (!estimated[c])
      recording->cameras[c].calibration.readout_ns = std::llround(1e6 * of_camera[c]->ms);
  }
  return estimated;
}

bool estimates_readouts(const std::vector<std::string>& options) {
  return std::ranges::any_of(options,
                             [](const std::string& text) { return parse_readout(text).estimated; });
}

}  // namespace redrive
