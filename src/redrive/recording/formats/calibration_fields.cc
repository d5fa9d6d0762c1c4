// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/calibration_fields.h"

#include <cmath>
#include <cstdio>

namespace redrive {
namespace {

int side_from_json(const JsonField& field) {
  const double size = field.number();
  if (size < 1 || size > kMaxImageSize_px || size != std::floor(size))
    field.fail("expected whole pixels, 1 to 65536");
  return static_cast<int>(size);
}

}  // namespace

void image_size_from_json(const JsonField& width, const JsonField& height,
                          CameraCalibration* camera) {
  camera->width = side_from_json(width);
  camera->height = side_from_json(height);
  if (std::int64_t{camera->width} * camera->height > kMaxPixels)
    height.fail("expected at most 2^28 pixels in all");
}

double focal_length_from_json(const JsonField& field) {
  const double focal_length = field.number();
  if (!(focal_length > 0 && focal_length <= kMaxFocalLength_px))
    field.fail("expected a focal length in pixels, > 0 and <= 1e6");
  return focal_length;
}

double principal_point_from_json(const JsonField& field, int size) {
  const double c = field.number();
  if (c < -size || c > 2.0 * size) {
    field.fail("the principal point lies more than one image size (" + std::to_string(size) +
               " px) outside the image");
  }
  return c;
}

double parameter_from_json(const JsonField& field, const CameraParameter& parameter) {
  const double value = field.number();
  if (!(value >= parameter.min && value <= parameter.max)) {
    char rule[96];
    std::snprintf(rule, sizeof rule, "expected %g <= %.*s <= %g", parameter.min,
                  static_cast<int>(parameter.name.size()), parameter.name.data(), parameter.max);
    field.fail(rule);
  }
  return value;
}

}  // namespace redrive
