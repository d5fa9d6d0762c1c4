// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/alignment.h"

#include <algorithm>
#include <cstdio>

#include "redrive/align/align_summary.h"
#include "redrive/align/bundle/unobservable_extrinsics.h"
#include "redrive/base/files/unfinished.h"
#include "redrive/math/angles.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/pose_files.h"
#include "redrive/report/align_page.h"
#include "redrive/report/html.h"

namespace redrive {
namespace {

void print_residual(const char* which, const TrajectoryRegistration& registration) {
  std::printf("%s trajectory against ground truth: %.2f cm, %.4f degrees RMS\n", which,
              100 * registration.residual_m, registration.residual_deg);
}

/// "+0.161 +- 0.010", or "unobservable".
std::string correction_text(double value, const std::optional<double>& sigma, int digits) {
  if (!sigma) return "unobservable";
  char text[64];
  std::snprintf(text, sizeof text, "%+.*f +- %.*f", digits, value, digits, *sigma);
  return text;
}

std::string edges_text(const std::vector<std::optional<EdgeScore>>& scores, std::size_t camera) {
  return camera < scores.size() && scores[camera] ? fixed(scores[camera]->score(), 3) : "-";
}

void print_cameras(const AlignResult& result) {
  std::printf("%-22s %16s %15s %15s %15s %16s\n", "camera", "observations", "error px",
              "edge score", "LiDAR ties", "offset ms");
  for (std::size_t c = 0; c < result.cameras.size(); ++c) {
    const CameraCorrection& k = result.camera_corrections[c];
    const CameraFit& fit = result.bundle.cameras[c];
    std::printf("%-22s %6d of %6d %6.2f -> %5.2f %15s %6d, %4.1f cm %16s\n", k.name.c_str(),
                fit.used, fit.observations, fit.initial_px, fit.aligned_px,
                (edges_text(result.initial_edges, c) + " -> " + edges_text(result.aligned_edges, c))
                    .c_str(),
                result.bundle.ties_of_camera[c], 100 * fit.ties_m,
                k.offset_sigma_s
                    ? correction_text(1e3 * k.offset_s, 1e3 * *k.offset_sigma_s, 2).c_str()
                    : (fixed(1e3 * k.offset_s, 2) + " unobservable").c_str());
  }
  std::printf("%-22s", "corrected by");
  for (int axis = 0; axis < kExtrinsicAxes; ++axis)
    std::printf(" %16s", (std::string(extrinsic_name(axis)) + (axis < 3 ? " cm" : " deg")).c_str());
  std::printf("\n");
  bool unobservable = false;
  for (const CameraCorrection& k : result.camera_corrections) {
    std::printf("%-22s", k.name.c_str());
    for (int axis = 0; axis < kExtrinsicAxes; ++axis) {
      const double unit = axis < 3 ? 100 : kDegreesPerRadian;
      const std::optional<double>& sigma = k.extrinsic_sigmas[axis];
      unobservable |= !sigma;
      std::printf(" %16s", correction_text(unit * k.extrinsics[axis],
                                           sigma ? std::optional(unit * *sigma) : std::nullopt,
                                           axis < 3 ? 1 : 3)
                               .c_str());
    }
    std::printf("\n");
  }
  if (unobservable)
    std::printf("unobservable: the drive does not determine it; it stays as calibrated\n");
}

void print_alignment(const AlignResult& result) {
  const BundleResult& bundle = result.bundle;
  print_cameras(result);
  for (const CameraCorrection& k : result.camera_corrections) {
    if (k.readout_sigma_s)
      std::printf("%s: readout %+.2f +- %.2f ms (initially %+.2f)\n", k.name.c_str(),
                  1e3 * k.readout_s, 1e3 * *k.readout_sigma_s, 1e3 * k.initial_readout_s);
    else if (k.readout_s != 0)
      std::printf("%s: readout %+.2f ms, initial value\n", k.name.c_str(), 1e3 * k.readout_s);
  }
  if (bundle.lidar_points > 0)
    std::printf("LiDAR: %d points on %d planar patches, %.2f -> %.2f cm RMS\n", bundle.lidar_points,
                bundle.patches, 100 * bundle.initial_lidar_rms_m, 100 * bundle.lidar_rms_m);
  if (const auto& elevation_sigma_rad = result.lidar_elevation_sigma_rad)
    std::printf("elevations of the LiDAR: %s degrees\n",
                correction_text(kDegreesPerRadian * result.lidar_elevation_rad,
                                kDegreesPerRadian * *elevation_sigma_rad, 3)
                    .c_str());
  const ShapeSigma sigma = worst_sigma(result);
  std::printf(
      "the trajectory's shape is known to %.2f cm and %.4f degrees (1 sigma, worst frame)\n",
      100 * sigma.translation_m, sigma.rotation_deg);
  for (const std::string& remark : result.remarks) std::printf("note: %s\n", remark.c_str());
  if (result.initial_vs_ground_truth) print_residual("initial", *result.initial_vs_ground_truth);
  if (result.aligned_vs_ground_truth) print_residual("aligned", *result.aligned_vs_ground_truth);
  std::printf("aligned in %.1f s\n", result.seconds);
  std::fflush(stdout);
}

}  // namespace

AlignResult align_verbose(const Recording& recording, AlignOptions options, ThreadPool& pool) {
  options.bundle.verbose = true;
  std::printf("aligning %s of %s: finding feature tracks and LiDAR returns\n",
              counted(recording.frames.size(), "frame").c_str(),
              counted(recording.cameras.size(), "camera").c_str());
  std::fflush(stdout);
  AlignResult result = align(recording, options, pool);
  print_alignment(result);
  return result;
}

PoseFiles aligned_pose_files(const Recording& recording, const AlignResult& result) {
  return recording.reader->make_pose_files(with_alignment(recording, result), result.frames,
                                           result.cameras);
}

void write_alignment(const std::filesystem::path& folder, const Recording& recording,
                     const AlignResult& result) {
  write_folder(folder, /*replace=*/false, [&](const std::filesystem::path& made) {
    write_pose_files(made, aligned_pose_files(recording, result));
    write_align_page(made, recording, result);
  });
}

}  // namespace redrive
