// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/windows.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <map>
#include <string>

#include "redrive/align/bundle/unobservable_extrinsics.h"
#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

/// Returns the part of the recording in a window. Cameras without an image there are left out.
Recording part_of(const Recording& recording, const FrameWindow& window) {
  Recording part = recording;
  part.frames.assign(recording.frames.begin() + window.begin,
                     recording.frames.begin() + window.end);
  const auto outside = [&](const FrameFile& file) {
    return file.frame_id < part.frames.front().id || file.frame_id > part.frames.back().id;
  };
  std::vector<RecordedCamera> cameras;
  for (RecordedCamera& camera : part.cameras)
    if (std::erase_if(camera.images, outside) == 0 || !camera.images.empty())
      cameras.push_back(std::move(camera));
  part.cameras = std::move(cameras);
  std::erase_if(part.lidar_files, outside);
  std::erase_if(part.box_files, outside);
  // A cloud is in the axes of the drive's first frame.
  if (window.begin > 0) part.points_file.clear();
  part.ground_truth_frames.clear();
  part.novel.clear();
  return part;
}

std::string frames_text(const Recording& recording, const FrameWindow& window) {
  return "frames " + std::to_string(recording.frames[window.begin].id) + ":" +
         std::to_string(recording.frames[window.end - 1].id);
}

/// Maps each camera of a part to its index in the drive.
std::vector<int> cameras_of(const Recording& recording, const Recording& part) {
  std::vector<int> indices;
  for (const RecordedCamera& camera : part.cameras)
    indices.push_back(static_cast<int>(recording.find_camera(camera.calibration.name) -
                                       recording.cameras.data()));
  return indices;
}

/// Sums of a camera's estimates over all windows.
class CameraSum {
 public:
  void add(const CameraCorrection& k, const CameraFit& fit) {
    for (int axis = 0; axis < kExtrinsicAxes; ++axis)
      if (k.extrinsic_sigmas[axis])
        extrinsics_[axis].push_back({k.extrinsics[axis], *k.extrinsic_sigmas[axis]});
    if (k.offset_sigma_s) offsets_.push_back({k.offset_s - k.initial_offset_s, *k.offset_sigma_s});
    if (k.readout_sigma_s)
      readouts_.push_back({k.readout_s - k.initial_readout_s, *k.readout_sigma_s});
    intrinsics_ += fit.used * k.intrinsics;
    used_ += fit.used;
  }

  /// Combines the estimates for the drive. Sets the model's camera.
  CameraCorrection combined(const BundlePriors& priors, double repeated,
                            RigModelCamera* camera) const {
    CameraCorrection result;
    result.name = camera->initial.name;
    for (int axis = 0; axis < kExtrinsicAxes; ++axis)
      if (const auto found = combine_estimates(extrinsics_[axis], priors.extrinsics[axis],
                                               /*robust=*/axis >= 3, repeated)) {
        result.extrinsics[axis] = found->change;
        result.extrinsic_sigmas[axis] = found->sigma;
        camera->extrinsics += found->change * body_axis_of_extrinsics(*camera, axis);
      }
    if (const auto found =
            combine_estimates(offsets_, priors.offset_s, /*robust=*/true, repeated)) {
      camera->offset_s += found->change;
      result.offset_sigma_s = found->sigma;
    }
    if (const auto found =
            combine_estimates(readouts_, priors.readout_s, /*robust=*/false, repeated)) {
      camera->readout_s += found->change;
      result.readout_sigma_s = found->sigma;
    }
    if (used_ > 0) camera->intrinsics = intrinsics_ / used_;
    result.intrinsics = camera->intrinsics;
    result.offset_s = camera->offset_s;
    result.initial_offset_s = camera->initial_offset_s();
    result.readout_s = camera->readout_s;
    result.initial_readout_s = camera->initial_readout_s();
    return result;
  }

 private:
  std::array<std::vector<NumberEstimate>, kExtrinsicAxes> extrinsics_;
  std::vector<NumberEstimate> offsets_, readouts_;
  Eigen::Vector3d intrinsics_ = Eigen::Vector3d::Zero();
  double used_ = 0;
};

/// Sums of the estimates of all sensors over all windows.
class CalibrationSum {
 public:
  explicit CalibrationSum(std::size_t cameras) : cameras_(cameras) {}
  /// `cameras`: indices in the drive of the window's. `initial_elevation_rad`: the LiDAR's.
  void add(const AlignResult& window, const std::vector<int>& cameras,
           double initial_elevation_rad) {
    for (std::size_t c = 0; c < cameras.size(); ++c)
      cameras_[cameras[c]].add(window.camera_corrections[c], window.bundle.cameras[c]);
    if (window.lidar_elevation_sigma_rad)
      elevations_.push_back(
          {window.lidar_elevation_rad - initial_elevation_rad, *window.lidar_elevation_sigma_rad});
  }
  /// Combines the estimates for the drive. Sets the model's cameras.
  void combine(const BundlePriors& priors, double repeated, double initial_elevation_rad,
               RigModel* model, AlignResult* result) const {
    for (std::size_t c = 0; c < cameras_.size(); ++c) {
      result->camera_corrections.push_back(
          cameras_[c].combined(priors, repeated, &model->cameras[c]));
      result->cameras.push_back(model->corrected_calibration(static_cast<int>(c)));
    }
    result->lidar_elevation_rad = initial_elevation_rad;
    if (const auto found = combine_estimates(elevations_, priors.lidar_elevation_rad,
                                             /*robust=*/false, repeated)) {
      result->lidar_elevation_rad += found->change;
      result->lidar_elevation_sigma_rad = found->sigma;
    }
  }

 private:
  std::vector<CameraSum> cameras_;
  std::vector<NumberEstimate> elevations_;
};

void add_edges(const std::vector<std::optional<EdgeScore>>& of_part,
               const std::vector<int>& cameras, std::size_t n,
               std::vector<std::optional<EdgeScore>>* sums) {
  if (of_part.empty()) return;
  sums->resize(n);
  for (std::size_t c = 0; c < of_part.size(); ++c) {
    if (!of_part[c]) continue;
    std::optional<EdgeScore>& sum = (*sums)[cameras[c]];
    if (!sum) sum.emplace();
    sum->edges += of_part[c]->edges;
    sum->on_edges += of_part[c]->on_edges;
    sum->beside += of_part[c]->beside;
  }
}

/// RMS of `a` values with the RMS x and b with y.
double rms_of_both(double a, double x, double b, double y) {
  return a + b > 0 ? std::sqrt((a * x * x + b * y * y) / (a + b)) : 0;
}

/// Adds up the figures of a window's bundle adjustment.
void add_bundle(const BundleResult& of_part, const FrameWindow& window,
                const std::vector<int>& cameras, BundleResult* sum) {
  for (std::size_t c = 0; c < of_part.cameras.size(); ++c) {
    const CameraFit& fit = of_part.cameras[c];
    CameraFit& all = sum->cameras[cameras[c]];
    all.initial_px = rms_of_both(all.used, all.initial_px, fit.used, fit.initial_px);
    all.aligned_px = rms_of_both(all.used, all.aligned_px, fit.used, fit.aligned_px);
    all.sigma_px = rms_of_both(all.used, all.sigma_px, fit.used, fit.sigma_px);
    const int ties = of_part.ties_of_camera[c], ties_so_far = sum->ties_of_camera[cameras[c]];
    if (ties > 0) all.ties_m += (fit.ties_m - all.ties_m) * ties / (ties + ties_so_far);
    sum->ties_of_camera[cameras[c]] += ties;
    all.observations += fit.observations;
    all.used += fit.used;
  }
  sum->initial_lidar_rms_m = rms_of_both(sum->lidar_points, sum->initial_lidar_rms_m,
                                         of_part.lidar_points, of_part.initial_lidar_rms_m);
  sum->lidar_rms_m =
      rms_of_both(sum->lidar_points, sum->lidar_rms_m, of_part.lidar_points, of_part.lidar_rms_m);
  sum->tracks += of_part.tracks;
  sum->lidar_points += of_part.lidar_points;
  sum->patches += of_part.patches;
  for (ImageResidual residual : of_part.residuals) {
    residual.camera = cameras[residual.camera];
    residual.frame += window.begin;
    sum->residuals.push_back(residual);
  }
  for (const int f : of_part.unsupported_frames)  // the window before may have listed it, too
    if (sum->unsupported_frames.empty() || window.begin + f > sum->unsupported_frames.back())
      sum->unsupported_frames.push_back(window.begin + f);
  for (std::size_t f = 0; f < of_part.observations_in_frame.size(); ++f)
    sum->observations_in_frame[window.begin + f] += of_part.observations_in_frame[f];
  sum->converged = sum->converged && of_part.converged;
  sum->rounds = std::max(sum->rounds, of_part.rounds);
  sum->last_translation_m = std::max(sum->last_translation_m, of_part.last_translation_m);
  sum->last_rotation_rad = std::max(sum->last_rotation_rad, of_part.last_rotation_rad);
}

/// Corrections of the initial poses by joined ones. The deviations of a window's shape, frame by
/// frame, are increased by the deviations of joining.
std::vector<Correction> corrections_of(const RigModel& initial, const JoinedTrajectory& joined,
                                       const std::vector<Vector6d>& shape_sigma) {
  std::vector<Correction> corrections;
  const Rigid3d world_from_global = initial.global_from_world.inverse(Eigen::Isometry);
  for (std::size_t f = 0; f < joined.frames.size(); ++f) {
    const Rigid3d change = initial.initial_frames[f].world_from_body.inverse(Eigen::Isometry) *
                           (world_from_global * joined.frames[f].global_from_body);
    Correction correction;
    correction.value << change.translation(), so3_log(change.linear());
    correction.sigma = (shape_sigma[f].cwiseAbs2() + joined.variance[f]).cwiseSqrt();
    corrections.push_back(correction);
  }
  return corrections;
}

/// Returns what the figures of the windows do not say by themselves.
std::vector<std::string> remarks_on(const AlignResult& result, const AlignOptions& options,
                                    std::size_t windows, const JoinedTrajectory& joined,
                                    bool any_lidar) {
  std::vector<std::string> remarks;
  char text[300];
  std::snprintf(text, sizeof text,
                "aligned in %zu windows of at most %d frames; where two overlap, they agree to "
                "%.2f cm and %.4f degrees RMS",
                windows, options.window, 100 * joined.seam_m, joined.seam_rad * kDegreesPerRadian);
  remarks.emplace_back(text);
  if (!any_lidar)
    remarks.emplace_back(
        "no LiDAR: the scale of the drive, and a rotation and time offset common to all cameras, "
        "are the egomotion's");
  for (std::size_t c = 0; c < result.camera_corrections.size(); ++c) {
    const CameraCorrection& k = result.camera_corrections[c];
    if (result.bundle.cameras[c].used == 0)
      remarks.push_back(
          k.name +
          ": no image point to use; its extrinsics and time offset keep their initial "
          "values");
    else if (!k.offset_sigma_s)
      remarks.push_back(k.name +
                        ": the time offset is unobservable in every window: it keeps its "
                        "initial value");
    if (options.bundle.estimates_readout(c) && !k.readout_sigma_s)
      remarks.push_back(k.name +
                        ": the readout is unobservable in every window: it keeps its "
                        "initial value");
  }
  return remarks;
}

AlignOptions with_fixed_cameras(AlignOptions options) {
  options.bundle.fixed_cameras = true;
  options.bundle.readouts.clear();
  options.bundle.intrinsics = false;
  return options;
}

/// Makes room for the figures of windows, which add_bundle() adds.
BundleResult empty_bundle(std::size_t cameras, int frames) {
  BundleResult bundle;
  bundle.cameras.resize(cameras);
  bundle.ties_of_camera.assign(cameras, 0);
  bundle.offset_index.resize(cameras);
  bundle.readout_index.resize(cameras);
  bundle.observations_in_frame.assign(frames, 0);
  bundle.converged = true;
  return bundle;
}

}  // namespace

std::optional<NumberEstimate> combine_estimates(const std::vector<NumberEstimate>& windows,
                                                double prior, bool robust, double repeated) {
  // Estimates from the observations of a single window, without the prior that its result contains.
  std::vector<NumberEstimate> alone;
  double information = 0, sum = 0;
  for (const NumberEstimate& window : windows) {
    const double of_prior = 1 / (prior * prior + (robust ? window.change * window.change : 0)),
                 both = 1 / (window.sigma * window.sigma), own = both - of_prior;
    if (!(own > 0.01 * both)) continue;
    alone.push_back({window.change * both / own, 1 / std::sqrt(own)});
    information += own;
    sum += window.change * both;
  }
  if (alone.empty()) return std::nullopt;
  const double mean = sum / information,
               of_prior = 1 / (prior * prior + (robust ? mean * mean : 0));
  double chi2 = 0;
  for (const NumberEstimate& window : alone)
    chi2 += std::pow((window.change - mean) / window.sigma, 2);
  const double disagreement =
      alone.size() > 1 ? std::max(1.0, chi2 / static_cast<double>(alone.size() - 1)) : 1;
  const double own = information / (repeated * disagreement);
  return NumberEstimate{mean * own / (own + of_prior), 1 / std::sqrt(own + of_prior)};
}

AlignResult align_in_windows(const Recording& recording, const AlignOptions& options,
                             const AlignPart& align_part) {
  const auto start = std::chrono::steady_clock::now();
  const int n = static_cast<int>(recording.frames.size());
  const std::size_t n_cameras = recording.cameras.size();
  const std::vector<FrameWindow> windows = cut_windows(n, options.window);
  const auto align_named = [&](std::size_t k, const Recording& part, const AlignOptions& by) {
    if (options.bundle.verbose) {
      std::printf("%s, window %zu of %zu%s\n", frames_text(recording, windows[k]).c_str(), k + 1,
                  windows.size(), by.bundle.fixed_cameras ? ", with the cameras of all" : "");
      std::fflush(stdout);
    }
    try {
      return align_part(windows[k], part, by);
    } catch (const InsufficientDataError& error) {
      throw InsufficientDataError(
          recording.root,
          frames_text(recording, windows[k]) + " determine no poses; " + error.what(),
          std::to_string(windows.size()) + " windows");
    }
  };

  AlignResult result;
  CalibrationSum sums(n_cameras);
  std::vector<Vector6d> shape_sigma(n, Vector6d::Zero());
  bool any_lidar = false;
  double frames_in_windows = 0;
  for (std::size_t k = 0; k < windows.size(); ++k) {
    const Recording part = part_of(recording, windows[k]);
    const std::vector<int> cameras = cameras_of(recording, part);
    AlignOptions by = options;
    by.bundle.readouts.clear();
    for (const int camera : cameras)
      by.bundle.readouts.push_back(options.bundle.estimates_readout(camera));
    const AlignResult aligned = align_named(k, part, by);
    sums.add(aligned, cameras, first_elevation_rad(recording));
    for (int i = 0; i < windows[k].size(); ++i) {
      Vector6d& sigma = shape_sigma[windows[k].begin + i];
      sigma = sigma.cwiseMax(aligned.corrections[i].sigma);
    }
    add_edges(aligned.initial_edges, cameras, n_cameras, &result.initial_edges);
    add_edges(aligned.aligned_edges, cameras, n_cameras, &result.aligned_edges);
    result.damaged.insert(result.damaged.end(), aligned.damaged.begin(), aligned.damaged.end());
    any_lidar = any_lidar || aligned.bundle.lidar_points > 0;
    frames_in_windows += windows[k].size();
  }

  RigModel model = make_rig_model(recording);
  sums.combine(options.bundle.priors, frames_in_windows / n, first_elevation_rad(recording), &model,
               &result);
  const AlignOptions fixed = with_fixed_cameras(options);
  const Rigid3d world_from_global = model.global_from_world.inverse(Eigen::Isometry);
  result.bundle = empty_bundle(n_cameras, n);
  std::vector<WindowTrajectory> trajectories;
  for (std::size_t k = 0; k < windows.size(); ++k) {
    Recording part = part_of(recording, windows[k]);
    const std::vector<int> cameras = cameras_of(recording, part);
    for (std::size_t c = 0; c < cameras.size(); ++c)
      part.cameras[c].calibration = result.cameras[cameras[c]];
    if (!part.lidars.empty()) part.lidars[0].elevation_rad = result.lidar_elevation_rad;
    const AlignResult aligned = align_named(k, part, fixed);
    const int before = k > 0 ? windows[k - 1].end - windows[k].begin : 0,
              after = k + 1 < windows.size() ? windows[k].end - windows[k + 1].begin : 0;
    trajectories.push_back(window_trajectory(windows[k], aligned.frames, aligned.bundle.covariance,
                                             aligned.bundle.robust_covariance, before, after,
                                             world_from_global));
    add_bundle(aligned.bundle, windows[k], cameras, &result.bundle);
  }
  const JoinedTrajectory joined = join_trajectories(trajectories, world_from_global);
  result.frames = joined.frames;
  result.corrections = corrections_of(model, joined, shape_sigma);

  result.remarks = remarks_on(result, options, windows.size(), joined, any_lidar);
  register_with_ground_truth(recording, &result);
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

AlignResult align_in_windows(const Recording& recording, const AlignOptions& options,
                             ThreadPool& pool) {
  std::map<int, std::vector<Track>> tracks;  // key: the window's first frame
  return align_in_windows(
      recording, options,
      [&](const FrameWindow& window, const Recording& part, const AlignOptions& by) {
        if (!by.bundle.fixed_cameras) return align_whole(part, by, pool, &tracks[window.begin]);
        const std::vector<Track> kept = std::move(tracks[window.begin]);
        return align_with(part, kept,
                          subsample_evenly(load_align_samples(part, by, pool), kMaxPlaneSamples),
                          by, pool);
      });
}

}  // namespace redrive
