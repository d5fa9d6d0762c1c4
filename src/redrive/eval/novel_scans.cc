// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/novel_scans.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/eval/novel_ground_truth.h"
#include "redrive/recording/formats/frame_files.h"

namespace redrive {
namespace {

/// Returns the first view of a frame; null if there is none.
const RequestedView* view_of(const ViewRequests& poses, std::int64_t frame_id) {
  const auto view = std::ranges::find(poses.views, frame_id, &RequestedView::frame_id);
  return view == poses.views.end() ? nullptr : &*view;
}

}  // namespace

std::vector<NovelScans> novel_scans(const Run& run, std::vector<Finding>* findings) {
  std::vector<NovelScans> out;
  if (run.recording.lidars.empty()) return out;
  for (const NovelSet& set : run.recording.novel) {
    NovelScans scans{set.name,
                     {},
                     list_frame_files(set.poses_file.parent_path() / "lidar", "frame_",
                                      {".laz", ".las"}, "novel/" + set.name + "/lidar", findings)};
    std::erase_if(scans.files,
                  [&](const FrameFile& file) { return run.scene.frame_index(file.frame_id) < 0; });
    if (scans.files.empty()) continue;
    scans.poses = read_view_requests(set.poses_file);
    for (const FrameFile& file : scans.files)
      if (!view_of(scans.poses, file.frame_id))
        throw InputError(
            set.poses_file, "images", "",
            "must have a view of frame " + std::to_string(file.frame_id) + ", which has a scan");
    out.push_back(std::move(scans));
  }
  return out;
}

std::optional<LidarScore> score_novel_scans(const Run& run, kernels::Backend& backend,
                                            const TrajectoryRegistration& alignment,
                                            const NovelScans& scans, const MovingObjects& left_out,
                                            Progress* progress) {
  const Scene& scene = run.scene;
  Recording recording;
  recording.frames = run.recording.frames;
  recording.lidars = run.recording.lidars;
  recording.reader = run.recording.reader;
  LidarScores scores(run, backend, left_out);
  for (const FrameFile& file : scans.files) {
    recording.lidar_files = {file};
    const LidarReturns returns = load_lidar_returns(
        recording, scene, MovingObjects(), backend.pool(), {.repeated = true, .lost = true});
    if (returns.damaged) throw InputError(file.path, "", "", returns.damaged->what);
    const auto frame = static_cast<std::size_t>(scene.frame_index(file.frame_id));
    const RequestedView& view = *view_of(scans.poses, file.frame_id);
    const Rigid3d own = scene.world_from_body(scene.frames[frame].t_ns);
    const Rigid3d novel = view.global_from_body
                              ? world_from_ground_truth(run, alignment) * *view.global_from_body
                              : own * Eigen::Translation3d(*view.shift_body_m);
    const Rigid3d own_from_sensor =
        own.inverse(Eigen::Isometry) * novel * returns.sensors[0].body_from_sensor;
    scores.add(returns,
               [&](std::int64_t t_ns) { return scene.world_from_body(t_ns) * own_from_sensor; });
    if (progress) progress->count();
  }
  return scores.score();
}

}  // namespace redrive
