// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/seam_exposure.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Dense>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/json_field.h"
#include "redrive/field/appearance.h"
#include "redrive/train/files/gains_json.h"

namespace redrive {
namespace {

constexpr const char* kExposureFormat = "redrive-exposure-1";
constexpr double kMaxLogGain = 20;

}  // namespace

int SeamExposure::camera_index(const std::string& name) const {
  const auto found = std::ranges::find(cameras, name);
  return found == cameras.end() ? -1 : static_cast<int>(found - cameras.begin());
}

LogGains SeamExposure::of(std::size_t block, const std::string& camera) const {
  const int index = camera_index(camera);
  return index < 0 ? LogGains{} : log_gains[block][index];
}

SeamExposure solve_seam_exposure(std::vector<std::string> cameras, int blocks,
                                 const std::vector<SharedImage>& images) {
  SeamExposure result;
  result.cameras = std::move(cameras);
  result.log_gains.assign(static_cast<std::size_t>(blocks),
                          std::vector<LogGains>(result.cameras.size(), LogGains{}));
  for (std::size_t c = 0; c < result.cameras.size(); ++c) {
    // Normal equations of x_a - x_b = log g_a - log g_b: a graph's Laplacian, singular by a
    // constant for each group of blocks that images connect.
    Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(blocks, blocks);
    Eigen::MatrixXd right = Eigen::MatrixXd::Zero(blocks, 3);
    for (const SharedImage& image : images) {
      if (image.camera != static_cast<int>(c)) continue;
      const int a = image.block_a, b = image.block_b;
      normal(a, a) += 1;
      normal(b, b) += 1;
      normal(a, b) -= 1;
      normal(b, a) -= 1;
      for (int k = 0; k < 3; ++k) {
        const double quotient = image.log_gains_a[k] - image.log_gains_b[k];
        right(a, k) += quotient;
        right(b, k) -= quotient;
      }
    }
    const Eigen::MatrixXd solution = normal.completeOrthogonalDecomposition().solve(right);
    for (int b = 0; b < blocks; ++b)
      for (int k = 0; k < 3; ++k) result.log_gains[b][c][k] = solution(b, k);
  }
  return result;
}

LogGains image_log_gains(Trainee& model, const Exposure& exposure) {
  const std::vector<ModelTensor> tensors = model.tensors();
  const auto tensor = std::ranges::find(tensors, "appearance", &ModelTensor::name);
  if (tensor == tensors.end()) return {};
  AppearanceConfig config;
  config.cameras = static_cast<int>(tensor->shape.at(0));
  config.knots = static_cast<int>(tensor->shape.at(1));
  for (const HyperparameterValue& value : hyperparameter_values(model))
    if (value.what.name == "appearance.knot_spacing_s")
      config.knot_spacing_s = std::stof(value.text);
  const std::array<float, 3> gains =
      colour_gains(config, model.parameters.data() + tensor->offset, exposure);
  return {std::log(gains[0]), std::log(gains[1]), std::log(gains[2])};
}

std::filesystem::path exposure_file(const std::filesystem::path& run) {
  return run / "exposure.json";
}

SeamExposure read_seam_exposure(const std::filesystem::path& run, std::size_t blocks) {
  std::error_code error;
  if (!std::filesystem::exists(exposure_file(run), error))
    return {{}, std::vector<std::vector<LogGains>>(blocks)};
  return parse_seam_exposure(read_file(exposure_file(run)), exposure_file(run), blocks);
}

void write_seam_exposure(const std::filesystem::path& run, const SeamExposure& exposure) {
  write_file(exposure_file(run), seam_exposure_text(exposure));
}

SeamExposure parse_seam_exposure(std::string_view bytes, const std::filesystem::path& file,
                                 std::size_t blocks) {
  const nlohmann::json document = parse_json(bytes, file);
  const JsonField root(document, file);
  if (root.at("format").string() != kExposureFormat)
    root.at("format").fail(std::string("must be ") + kExposureFormat);
  SeamExposure exposure;
  const JsonField cameras = root.at("cameras");
  if (!cameras.json().is_array()) cameras.fail("must be a list of names");
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    exposure.cameras.push_back(cameras.at(c).string());
    if (exposure.camera_index(exposure.cameras.back()) != static_cast<int>(c))
      cameras.at(c).fail("is named twice");
  }
  const JsonField list = root.at("log_gains");
  if (!list.json().is_array() || list.size() != blocks)
    list.fail("must have an entry for each of " + std::to_string(blocks) + " blocks");
  for (std::size_t b = 0; b < blocks; ++b) {
    const JsonField entry = list.at(b);
    if (!entry.json().is_array() || entry.size() != exposure.cameras.size())
      entry.fail("must have an entry for each of " + std::to_string(exposure.cameras.size()) +
                 " cameras");
    std::vector<LogGains>& of_block = exposure.log_gains.emplace_back();
    for (std::size_t c = 0; c < entry.size(); ++c) {
      const std::vector<double> three = entry.at(c).numbers(3);
      for (const double value : three)
        if (std::abs(value) > kMaxLogGain) entry.at(c).fail("must be three numbers in -20..20");
      of_block.push_back({three[0], three[1], three[2]});
    }
  }
  if (root.has("lidar_gains")) exposure.lidar_gains = gains_from_json(root.at("lidar_gains"));
  return exposure;
}

std::string seam_exposure_text(const SeamExposure& exposure) {
  const nlohmann::ordered_json json = {{"format", kExposureFormat},
                                       {"cameras", exposure.cameras},
                                       {"log_gains", exposure.log_gains},
                                       {"lidar_gains", gains_to_json(exposure.lidar_gains)}};
  return json.dump(2) + "\n";
}

}  // namespace redrive
