// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/lenses/opencv_coefficients.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/camera/lenses/opencv_thin_prism.h"

namespace redrive {
namespace {

template <class Model>
constexpr std::size_t kCount = Model::kDistortion.size();

}  // namespace

void set_opencv_coefficients(const OpenCvCoefficients& coefficients, CameraCalibration* camera) {
  std::size_t n = coefficients.size();
  while (n > 0 && coefficients[n - 1] == 0) --n;
  const auto set = [&](const char* model, std::size_t count) {
    camera->model = model;
    camera->parameters.resize(4);
    camera->parameters.insert(camera->parameters.end(), coefficients.begin(),
                              coefficients.begin() + static_cast<std::ptrdiff_t>(count));
  };
  if (n <= kCount<OpenCvPinhole>)
    set(OpenCvPinhole::kName, kCount<OpenCvPinhole>);
  else if (n <= kCount<OpenCvRational>)
    set(OpenCvRational::kName, kCount<OpenCvRational>);
  else
    set(OpenCvThinPrism::kName, kCount<OpenCvThinPrism>);
}

std::optional<OpenCvCoefficients> opencv_coefficients(const CameraCalibration& camera) {
  if (camera.model != OpenCvPinhole::kName && camera.model != OpenCvRational::kName &&
      camera.model != OpenCvThinPrism::kName)
    return std::nullopt;
  OpenCvCoefficients all{};
  REDRIVE_CHECK_OP(camera.parameters.size(), <=, 4 + all.size());
  std::copy(camera.parameters.begin() + 4, camera.parameters.end(), all.begin());
  return all;
}

}  // namespace redrive
