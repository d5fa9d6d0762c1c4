// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/poses_section.h"

#include "redrive/math/angles.h"
#include "redrive/report/html.h"
#include "redrive/report/plot.h"

namespace redrive {
namespace {

/// Returns the source of the poses as a sentence in HTML.
std::string source_of(const Run& run) {
  const TrainOptions& options = run.options;
  if (options.ground_truth_poses)
    return "The ground truth that the recording ships (<code>--truth-poses</code>).";
  if (!has_external_poses(options)) return "As recorded.";
  std::string out = "Aligned before training ";
  if (options.align)
    out += "(<code>--align</code>).";
  else
    out += "(<code>--poses " + html_escape(options.poses) + "</code>).";
  // The relative link breaks if only the report is passed on, so nothing depends on it.
  std::error_code error;
  if (std::filesystem::is_regular_file(run.paths.poses() / "report.html", error))
    out += " <a href=\"poses/report.html\">Report of the alignment.</a>";
  return out;
}

std::string curves_script(const Scene& scene, const PoseChanges& changes,
                          Eigen::Vector3d PoseChange::*part, double scale, TimeCurves curves) {
  for (std::size_t f = 0; f < changes.frames.size(); ++f) {
    curves.t_s.push_back(1e-9 * static_cast<double>(scene.frames[f].t_ns - scene.frames[0].t_ns));
    curves.values.push_back(scale * changes.frames[f].*part);
  }
  return time_curves_script(curves);
}

std::vector<std::vector<std::string>> rows_of(const PoseChanges& changes) {
  std::vector<std::vector<std::string>> rows{
      {"camera", "forward (cm)", "left (cm)", "up (cm)", "translation (cm)", "roll (deg)",
       "pitch (deg)", "yaw (deg)", "rotation (deg)", "time offset (ms)", "bounds"}};
  for (const CameraChange& camera : changes.cameras) {
    std::vector<std::string> row{camera.name};
    const Eigen::Vector3d translation_cm = 100 * camera.pose.translation_m,
                          rotation_deg = kDegreesPerRadian * camera.pose.rotation_rad;
    for (const double value : translation_cm) row.push_back(fixed(value, 2));
    row.push_back(fixed(translation_cm.norm(), 2));
    for (const double value : rotation_deg) row.push_back(fixed(value, 3));
    row.insert(row.end(), {fixed(rotation_deg.norm(), 3), fixed(1e3 * camera.time_offset_s, 2),
                           camera.pose.at_bound ? "at its bound" : ""});
    rows.push_back(row);
  }
  const int at_bound = changes.frames_at_bound();
  rows.push_back({"frames, RMS", "", "", "", fixed(100 * changes.translation_m, 2), "", "", "",
                  fixed(kDegreesPerRadian * changes.rotation_rad, 3), "",
                  at_bound > 0 ? std::to_string(at_bound) + " at their bounds" : ""});
  return rows;
}

}  // namespace

std::string frame_translations_script(const Scene& scene, const PoseChanges& changes) {
  return curves_script(scene, changes, &PoseChange::translation_m, 100,
                       {{"poses_moved", "time (s)", "translation (cm)"},
                        {"forward", "left", "up"},
                        {},
                        {},
                        {},
                        100.0 * changes.bounds.translation_m});
}

std::string frame_rotations_script(const Scene& scene, const PoseChanges& changes) {
  return curves_script(scene, changes, &PoseChange::rotation_rad, kDegreesPerRadian,
                       {{"poses_turned", "time (s)", "rotation (deg)"},
                        {"roll", "pitch", "yaw"},
                        {},
                        {},
                        {},
                        kDegreesPerRadian * changes.bounds.rotation_rad});
}

std::string poses_section(const Run& run, const std::filesystem::path& figures) {
  std::string out = "<h2>Poses</h2>\n<p>" + source_of(run);
  if (!run.state.poses.refines()) return out + " Not refined by training.</p>\n";
  const PoseChanges changes =
      pose_changes(run.scene, run.state.poses.corrections, pose_refinement(run.options).bounds);
  const std::string bounds = fixed(100 * changes.bounds.translation_m, 0) + " cm and " +
                             fixed(kDegreesPerRadian * changes.bounds.rotation_rad, 1) +
                             " degrees along each axis, cameras also at " +
                             fixed(1e3 * changes.bounds.time_offset_s, 0) + " ms";
  out +=
      " Training refined the pose of each frame and the extrinsics and time offset of each camera "
      "(<code>--refine-poses</code>).</p>\n";
  if (const std::string which = at_bound(changes); !which.empty())
    out += html_warning("Corrections are at their bounds (" + bounds + "): " + which +
                        ". redrive align corrects larger errors; redrive inspect --report checks "
                        "calibration and time offsets against the images.");
  out +=
      html_table(rows_of(changes), true) +
      "<p>In the axes of the body, relative to the initial poses. The part that all cameras "
      "share is in the frames. Corrections are bounded by " +
      bounds + ".</p>\n" +
      html_row(plot_figure(figures, "poses_moved", frame_translations_script(run.scene, changes),
                           "translation of each frame") +
                   plot_figure(figures, "poses_turned", frame_rotations_script(run.scene, changes),
                               "rotation of each frame"),
               FigureSize::kLarge);
  return out;
}

}  // namespace redrive
