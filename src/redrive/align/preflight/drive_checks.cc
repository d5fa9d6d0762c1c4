// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/preflight/drive_checks.h"

#include <algorithm>
#include <cstdio>

#include <opencv2/core.hpp>

#include "redrive/base/opencv_threads.h"
#include "redrive/image/image_head.h"
#include "redrive/recording/core/pose_jumps.h"
#include "redrive/recording/core/wording.h"

namespace redrive {
namespace {

constexpr int kBlack = 2;       // largest grey value of a black image, 0..255
constexpr int kBlackRoot = 23;  // the same in the square root of brightness: sqrt(2 * 255)
constexpr std::size_t kReturns = 20'000;
constexpr double kFewReturns = 0.001;  // share of returns in images below which it is reported
constexpr double kFocalFactor = 1.5;   // EXIF is rounded and refers to film of another format

/// Views of one camera by time.
struct CameraViews {
  int camera = 0;
  std::vector<std::pair<std::int64_t, Rigid3d>> camera_from_world;  ///< ascending by t_ns
};

std::vector<CameraViews> views_by_camera(const Scene& scene) {
  std::vector<CameraViews> all(scene.rig.size());
  for (const View& view : scene.views) {
    CameraViews& of_camera = all[view.camera];
    of_camera.camera = view.camera;
    of_camera.camera_from_world.emplace_back(
        scene.frames[view.frame].t_ns + scene.rig[view.camera].time_offset_ns,
        scene.world_from_camera(view).inverse(Eigen::Isometry));
  }
  return all;
}

bool is_in_image(const Camera& camera, const Eigen::Vector3d& in_camera) {
  const auto pixel = camera.project(in_camera);
  return pixel && pixel->x() > -0.5 && pixel->y() > -0.5 && pixel->x() < camera.width - 0.5 &&
         pixel->y() < camera.height - 0.5;
}

/// Whether the camera sees the point in its view nearest in time.
bool sees(const Scene& scene, const CameraViews& of_camera, const Eigen::Vector3d& in_world,
          std::int64_t t_ns) {
  const auto& views = of_camera.camera_from_world;
  if (views.empty()) return false;
  auto at = std::ranges::lower_bound(views, t_ns, {}, [](const auto& view) { return view.first; });
  if (at == views.end() || (at != views.begin() && t_ns - (at - 1)->first < at->first - t_ns)) --at;
  return is_in_image(scene.rig[of_camera.camera].camera, at->second * in_world);
}

}  // namespace

SharedCheck check_motion(const Recording& recording) {
  SharedCheck check{"motion", Verdict::kGood, "each pose agrees with the frames around it"};
  const std::vector<Finding> faults =
      describe_pose_faults(recording.frames, find_pose_faults(recording.frames));
  if (faults.empty()) return check;
  check.verdict = Verdict::kUsable;
  check.why.clear();
  for (const Finding& fault : faults) check.why += (check.why.empty() ? "" : "; ") + fault.what;
  return check;
}

SharedCheck check_lidar_in_images(const Scene& scene, const LidarReturns& lidar) {
  SharedCheck check{"lidar", Verdict::kCannotTell, "no return to look for in the images"};
  if (lidar.n == 0) return check;
  const std::vector<CameraViews> cameras = views_by_camera(scene);
  const std::size_t step = 1 + lidar.n / kReturns;
  std::size_t all = 0, seen = 0;
  LidarPoses poses(scene, lidar);
  for (std::size_t i = 0; i < lidar.n; i += step, ++all) {
    const Eigen::Vector3d in_world = poses.in_world(i);
    seen += std::ranges::any_of(cameras, [&](const CameraViews& camera) {
      return sees(scene, camera, in_world, lidar.t_ns[i]);
    });
  }
  const double share = static_cast<double>(seen) / static_cast<double>(all);
  char text[160];
  if (share < kFewReturns) {
    check.verdict = Verdict::kWrong;
    std::snprintf(text, sizeof text,
                  "%zu of %zu returns lie in an image: the LiDAR's extrinsics, unit or times are "
                  "wrong",
                  seen, all);
  } else {
    check.verdict = Verdict::kGood;
    std::snprintf(text, sizeof text, "%.0f %% of the returns lie in an image", 100 * share);
  }
  check.why = text;
  return check;
}

bool is_black(const Image8& image) {
  return !image.rgb.empty() && std::ranges::max(image.rgb) <= kBlack;
}

std::vector<Finding> find_black_images(const RigImages& images) {
  std::vector<Finding> findings;
  for (int c = 0; c < images.cameras(); ++c) {
    std::vector<std::int64_t> black;
    for (int f = 0; f < images.frames(); ++f) {
      const cv::Mat& grey = images.grey[c][f];
      double most = 0;
      if (!grey.empty()) cv::minMaxLoc(grey, nullptr, &most);
      if (!grey.empty() && most <= kBlackRoot) black.push_back(images.scene.frames[f].id);
    }
    if (!black.empty())
      findings.push_back(
          {images.scene.rig[c].name, counted(black.size(), "image") + " black: frame" +
                                         (black.size() == 1 ? " " : "s ") + first_few(black)});
  }
  return findings;
}

std::optional<Finding> contradicted_focal_length(const RecordedCamera& camera) {
  const CameraCalibration& calibration = camera.calibration;
  const CameraModelInfo* const model = find_camera_model(calibration.model);
  if (!model || !model->perspective || camera.images.empty()) return std::nullopt;
  const auto head = read_image_head(camera.images.front().path);
  const std::optional<double> focal_px = head ? head->focal_px() : std::nullopt;
  if (!focal_px) return std::nullopt;
  const double said_px = *focal_px * calibration.width / head->width,
               ratio = calibration.fx() / said_px;
  if (ratio < kFocalFactor && ratio > 1 / kFocalFactor) return std::nullopt;
  char what[200];
  std::snprintf(
      what, sizeof what,
      "its images name a focal length of %.0f mm on film, %.0f px, and the calibration has "
      "%.0f px: another lens, or another size of the images",
      *head->film_focal_mm, said_px, calibration.fx());
  return Finding{calibration.name, what};
}

}  // namespace redrive
