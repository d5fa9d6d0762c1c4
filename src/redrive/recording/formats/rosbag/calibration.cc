// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/camera/lenses/opencv_coefficients.h"
#include "redrive/camera/models.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/formats/rosbag/rig.h"

namespace redrive::rosbag {
namespace {

/// InputError unless a camera can have these numbers.
void check_intrinsics(const CameraCalibration& camera, const std::string& topic,
                      const std::filesystem::path& bag) {
  const auto fail = [&](const std::string& field, double value, const char* rule) {
    throw InputError(bag, topic + " " + field, std::to_string(value), rule);
  };
  for (const int i : {0, 1})
    if (!(camera.parameters[std::size_t(i)] > 0 &&
          camera.parameters[std::size_t(i)] <= kMaxFocalLength_px))
      fail(i == 0 ? "fx" : "fy", camera.parameters[std::size_t(i)],
           "is pixels, above 0, at most 1e6");
  for (const int i : {2, 3}) {
    const double size = i == 2 ? camera.width : camera.height,
                 c = camera.parameters[std::size_t(i)];
    if (!(c >= -size && c <= 2 * size))
      fail(i == 2 ? "cx" : "cy", c, "is at most one image size outside the image");
  }
  const CameraModelInfo& model = *find_camera_model(camera.model);
  for (std::size_t i = 0; i < model.distortion.size(); ++i) {
    const CameraParameter& parameter = model.distortion[i];
    const double value = camera.parameters[4 + i];
    if (!(value >= parameter.min && value <= parameter.max))
      fail("d[" + std::to_string(i) + "]", value, "is no distortion of a lens");
  }
}

}  // namespace

CameraCalibration calibration_of(const CameraTopics& camera, const CameraInfo& info, int width,
                                 int height, const std::filesystem::path& bag,
                                 std::vector<Finding>* findings) {
  CameraCalibration out;
  if (camera.intrinsics) {
    out = *camera.intrinsics;
    check_intrinsics(out, "cameras." + camera.name + ".intrinsics", bag / kRigFile);
  } else {
    const double sx = 1.0 / std::max(1u, info.binning_x), sy = 1.0 / std::max(1u, info.binning_y);
    const auto n = info.d.size();
    const auto d = [&](std::size_t i) { return i < n && !camera.rectified ? info.d[i] : 0.0; };
    const auto refuse_from = [&](std::size_t first, const char* rule) {
      for (std::size_t i = first; i < n; ++i)
        if (d(i) != 0)
          throw InputError(bag, camera.info + " d[" + std::to_string(i) + "]",
                           std::to_string(info.d[i]), rule);
    };
    out.parameters = {0, 0, 0, 0};
    if (info.model == "plumb_bob" || info.model == "rational_polynomial" || camera.rectified ||
        (info.model.empty() && n <= 5)) {
      OpenCvCoefficients all;
      for (std::size_t i = 0; i < all.size(); ++i) all[i] = d(i);
      set_opencv_coefficients(all, &out);
      refuse_from(all.size(), "a tilted sensor is not supported, only 0");
    } else if (info.model == "equidistant" || info.model == "fisheye") {
      out.model = "opencv_fisheye";
      out.parameters.insert(out.parameters.end(), {d(0), d(1), d(2), d(3)});
      refuse_from(4, "a fisheye has four coefficients, further ones must be 0");
    } else {
      throw InputError(bag, camera.info + " distortion_model", info.model,
                       "is plumb_bob, rational_polynomial or equidistant; cameras." + camera.name +
                           ".intrinsics in rig.yaml takes other models");
    }
    const double fx = camera.rectified ? info.p[0] : info.k[0],
                 fy = camera.rectified ? info.p[5] : info.k[4],
                 cx = camera.rectified ? info.p[2] : info.k[2],
                 cy = camera.rectified ? info.p[6] : info.k[5];
    // K holds for the full image: its region of interest is cut out, then binned.
    out.parameters[0] = fx * sx;
    out.parameters[1] = fy * sy;
    out.parameters[2] = (cx - info.roi_x + 0.5) * sx - 0.5;
    out.parameters[3] = (cy - info.roi_y + 0.5) * sy - 0.5;
    out.width = static_cast<int>(std::min(
        kMaxImageSize_px, std::floor((info.roi_width ? info.roi_width : info.width) * sx)));
    out.height = static_cast<int>(std::min(
        kMaxImageSize_px, std::floor((info.roi_height ? info.roi_height : info.height) * sy)));
  }
  out.name = camera.name;
  out.readout_ns = std::llround(1e9 * camera.readout_s);
  if (width > 0 && (out.width != width || out.height != height)) {
    const std::string sizes =
        size_text(out.width, out.height) + ", the images have " + size_text(width, height);
    const double sx = double(width) / std::max(1, out.width),
                 sy = double(height) / std::max(1, out.height);
    constexpr double kSameAspect = 0.01;
    if (out.width > 0 && out.height > 0 && std::abs(sx / sy - 1) > kSameAspect)
      throw InputError(bag, camera.info, sizes, "is the size of its images, or a multiple of it");
    if (out.width > 0 && out.height > 0) {
      out.parameters[0] *= sx;
      out.parameters[1] *= sy;
      out.parameters[2] = (out.parameters[2] + 0.5) * sx - 0.5;
      out.parameters[3] = (out.parameters[3] + 0.5) * sy - 0.5;
      findings->push_back({camera.name, "scaled: CameraInfo is for " + sizes});
    }
    out.width = width;
    out.height = height;
  }
  if (out.width < 1 || out.height < 1 || std::int64_t{out.width} * out.height > kMaxPixels)
    throw InputError(bag, camera.info + " width, height", size_text(out.width, out.height),
                     "is 1 pixel or more, 2^28 in all at most");
  check_intrinsics(out, camera.info, bag);
  return out;
}

}  // namespace redrive::rosbag
