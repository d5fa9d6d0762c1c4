// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/models.h"

#include <algorithm>
#include <array>
#include <utility>

#include "redrive/base/error.h"

namespace redrive {
namespace {

template <class Model>
constexpr CameraModelInfo make_info() {
  static_assert(Model::kTypical.size() == Model::kDistortion.size() + Model::kOther.size());
  return {Model::kName,
          Model::kDistortion,
          Model::kOther,
          Model::kTransformsNames,
          Model::kTypical,
          Model::kPerspective,
          Model::kImageCircle,
          [](std::span<const double> parameters) -> CameraModel { return Model(parameters); }};
}

constexpr auto kModels = []<std::size_t... i>(std::index_sequence<i...>) {
  return std::array{make_info<std::variant_alternative_t<i, CameraModel>>()...};
}
(std::make_index_sequence<std::variant_size_v<CameraModel>>());

}  // namespace

std::span<const CameraModelInfo> camera_models() { return kModels; }

const CameraModelInfo* find_camera_model(std::string_view name) {
  const auto found = std::ranges::find(kModels, name, &CameraModelInfo::name);
  return found == kModels.end() ? nullptr : &*found;
}

std::string camera_model_names() {
  std::string names;
  for (const CameraModelInfo& model : kModels)
    names += (names.empty() ? "" : ", ") + std::string(model.name);
  return names;
}

const CameraModelInfo& info_of(const CameraModel& model) { return kModels[model.index()]; }

std::vector<double> distortion(const CameraCalibration& calibration) {
  const CameraModelInfo* model = find_camera_model(calibration.model);
  REDRIVE_CHECK(model);
  const auto first = calibration.parameters.begin() + 4;
  return {first, first + static_cast<std::ptrdiff_t>(model->distortion.size())};
}

std::vector<std::pair<std::string, double>> other_parameters(const CameraCalibration& calibration) {
  const CameraModelInfo* model = find_camera_model(calibration.model);
  REDRIVE_CHECK(model);
  std::vector<std::pair<std::string, double>> parameters;
  std::size_t index = 4 + model->distortion.size();
  for (const CameraParameter& parameter : model->other)
    parameters.emplace_back(parameter.name, calibration.parameters.at(index++));
  return parameters;
}

}  // namespace redrive
