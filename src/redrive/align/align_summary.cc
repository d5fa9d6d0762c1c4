// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/align_summary.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "redrive/math/angles.h"

namespace redrive {
namespace {

nlohmann::json null_or(const std::optional<double>& value, double unit = 1) {
  return value ? nlohmann::json(unit * *value) : nullptr;
}

nlohmann::json score_or_null(const std::vector<std::optional<EdgeScore>>& scores,
                             std::size_t camera) {
  const bool known = camera < scores.size() && scores[camera];
  return known ? nlohmann::json(scores[camera]->score()) : nullptr;
}

nlohmann::json camera_to_json(const AlignResult& result, std::size_t camera) {
  const CameraCorrection& k = result.camera_corrections[camera];
  const CameraFit& fit = result.bundle.cameras[camera];
  nlohmann::json three[4];  // translation and its sigma, rotation and its sigma
  for (int axis = 0; axis < 6; ++axis) {
    const double unit = axis < 3 ? 1 : kDegreesPerRadian;
    three[axis / 3 * 2].push_back(unit * k.extrinsics[axis]);
    three[axis / 3 * 2 + 1].push_back(
        null_or(k.extrinsic_sigmas[static_cast<std::size_t>(axis)], unit));
  }
  return {{"observations", fit.observations},
          {"used", fit.used},
          {"error_px", {{"initial", fit.initial_px}, {"aligned", fit.aligned_px}}},
          {"edge_score",
           {{"initial", score_or_null(result.initial_edges, camera)},
            {"aligned", score_or_null(result.aligned_edges, camera)}}},
          {"lidar_ties",
           {{"points", result.bundle.ties_of_camera[camera]}, {"residual_m", fit.ties_m}}},
          {"translation_m", three[0]},
          {"translation_sigma_m", three[1]},
          {"rotation_deg", three[2]},
          {"rotation_sigma_deg", three[3]},
          {"time_offset_s", k.offset_s},
          {"time_offset_sigma_s", null_or(k.offset_sigma_s)},
          {"readout_s", k.readout_s},
          {"readout_sigma_s", null_or(k.readout_sigma_s)}};
}

}  // namespace

ShapeSigma worst_sigma(const AlignResult& result) {
  ShapeSigma worst;
  for (const Correction& c : result.corrections) {
    worst.translation_m = std::max(worst.translation_m, c.sigma.head<3>().norm());
    worst.rotation_deg = std::max(worst.rotation_deg, kDegreesPerRadian * c.sigma.tail<3>().norm());
  }
  return worst;
}

nlohmann::json alignment_to_json(const AlignResult& result) {
  const BundleResult& bundle = result.bundle;
  const ShapeSigma sigma = worst_sigma(result);
  nlohmann::json json = {
      {"frames", result.frames.size()},
      {"cameras", nlohmann::json::object()},
      {"lidar", nullptr},
      {"trajectory",
       {{"translation_sigma_m", sigma.translation_m}, {"rotation_sigma_deg", sigma.rotation_deg}}},
      {"ground_truth", nullptr},
      {"remarks", result.remarks},
      {"seconds", result.seconds}};
  for (std::size_t c = 0; c < result.camera_corrections.size(); ++c)
    json["cameras"][result.camera_corrections[c].name] = camera_to_json(result, c);
  if (bundle.lidar_points > 0)
    json["lidar"] = {
        {"points", bundle.lidar_points},
        {"patches", bundle.patches},
        {"residual_m", {{"initial", bundle.initial_lidar_rms_m}, {"aligned", bundle.lidar_rms_m}}},
        {"elevation_deg", kDegreesPerRadian * result.lidar_elevation_rad},
        {"elevation_sigma_deg", null_or(result.lidar_elevation_sigma_rad, kDegreesPerRadian)}};
  if (result.initial_vs_ground_truth && result.aligned_vs_ground_truth)
    json["ground_truth"] = {{"initial", registration_to_json(*result.initial_vs_ground_truth)},
                            {"aligned", registration_to_json(*result.aligned_vs_ground_truth)}};
  return json;
}

}  // namespace redrive
