// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/alignment.h"

#include <algorithm>
#include <cstdio>

#include "redrive/math/angles.h"
#include "redrive/recording/pose_files.h"
#include "redrive/report/align_page.h"

namespace redrive {
namespace {

void print_residual(const char* which, const TrajectoryRegistration& registration) {
  std::printf("%s trajectory against ground truth: %.2f cm, %.4f degrees RMS\n", which,
              100 * registration.residual_m, registration.residual_deg);
}

void print_alignment(const AlignResult& result) {
  const BundleResult& bundle = result.bundle;
  std::printf("%-22s %16s %15s %26s %8s %14s %16s\n", "camera", "observations", "error px",
              "yaw pitch roll deg", "+-", "translation cm", "offset ms");
  for (std::size_t c = 0; c < result.cameras.size(); ++c) {
    const CameraCorrection& k = result.camera_corrections[c];
    const CameraFit& fit = bundle.cameras[c];
    std::printf(
        "%-22s %7d of %6d %6.2f -> %5.2f    %+7.3f %+7.3f %+7.3f %8.3f %7.1f +- %3.1f %+7.2f ",
        k.name.c_str(), fit.used, fit.observations, fit.initial_px, fit.aligned_px,
        k.rotation_in_body.z() * kDegreesPerRadian, k.rotation_in_body.y() * kDegreesPerRadian,
        k.rotation_in_body.x() * kDegreesPerRadian,
        k.extrinsics.sigma.tail<3>().maxCoeff() * kDegreesPerRadian,
        100 * k.extrinsics.value.head<3>().norm(), 100 * k.extrinsics.sigma.head<3>().maxCoeff(),
        1e3 * k.offset_s);
    if (k.offset_sigma_s)
      std::printf("+- %5.2f\n", 1e3 * *k.offset_sigma_s);
    else
      std::printf("unobservable\n");
  }
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
  double sigma_m = 0, sigma_rad = 0;
  for (const Correction& c : result.corrections) {
    sigma_m = std::max(sigma_m, c.sigma.head<3>().norm());
    sigma_rad = std::max(sigma_rad, c.sigma.tail<3>().norm());
  }
  std::printf(
      "the trajectory's shape is known to %.2f cm and %.4f degrees (1 sigma, worst frame)\n",
      100 * sigma_m, sigma_rad * kDegreesPerRadian);
  for (const std::string& remark : result.remarks) std::printf("note: %s\n", remark.c_str());
  if (result.initial_vs_ground_truth) print_residual("initial", *result.initial_vs_ground_truth);
  if (result.aligned_vs_ground_truth) print_residual("aligned", *result.aligned_vs_ground_truth);
  std::printf("aligned in %.1f s\n", result.seconds);
  std::fflush(stdout);
}

}  // namespace

AlignResult align_verbose(const Recording& recording, AlignOptions options, ThreadPool& pool) {
  options.bundle.verbose = true;
  std::printf("aligning %zu frames of %zu cameras: finding feature tracks and LiDAR returns\n",
              recording.frames.size(), recording.cameras.size());
  std::fflush(stdout);
  AlignResult result = align(recording, options, pool);
  print_alignment(result);
  return result;
}

void write_alignment(const std::filesystem::path& folder, const Recording& recording,
                     const AlignResult& result) {
  write_pose_files(folder,
                   recording.reader->make_pose_files(recording, result.frames, result.cameras));
  write_align_page(folder, recording, result);
}

}  // namespace redrive
