// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/poses_section.h"

#include <numbers>

#include "redrive/report/html.h"
#include "redrive/report/plot.h"
#include "redrive/train/pose_refiner.h"

namespace redrive {
namespace {

constexpr double kTurnInDegrees = 180 / std::numbers::pi;
constexpr int kWidth_px = 1200, kHeight_px = 560, kFont_pt = 14;  // as the curves of training

/// A sentence, as HTML.
std::string source_of(const Run& run) {
  const TrainOptions& options = run.options;
  if (options.ground_truth_poses)
    return "The exact ones that the recording ships (<code>--truth-poses</code>).";
  if (!has_external_poses(options)) return "As recorded.";
  std::string out = "Aligned before training ";
  if (options.align)
    out += "(<code>--align</code>).";
  else
    out += "(<code>--poses " + html_escape(options.poses) + "</code>).";
  // Beside the report, and not there when the report alone was handed on: the sentence says what it
  // needs without the link.
  std::error_code error;
  if (std::filesystem::is_regular_file(run.paths.poses() / "report.html", error))
    out += " <a href=\"poses/report.html\">What that changed.</a>";
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
      {"", "ahead (cm)", "left (cm)", "up (cm)", "moved (cm)", "roll (deg)", "pitch (deg)",
       "yaw (deg)", "turned (deg)", "exposed later (ms)", ""}};
  for (const CameraChange& camera : changes.cameras) {
    std::vector<std::string> row{camera.name};
    const Eigen::Vector3d moved_cm = 100 * camera.pose.translation_m,
                          rotation_deg = kTurnInDegrees * camera.pose.rotation_rad;
    for (const double value : moved_cm) row.push_back(fixed(value, 2));
    row.push_back(fixed(moved_cm.norm(), 2));
    for (const double value : rotation_deg) row.push_back(fixed(value, 3));
    row.insert(row.end(), {fixed(rotation_deg.norm(), 3), fixed(1e3 * camera.time_offset_s, 2),
                           camera.pose.at_bound ? "at its bound" : ""});
    rows.push_back(row);
  }
  const int at_bound = changes.frames_at_bound();
  rows.push_back({"frames, RMS", "", "", "", fixed(100 * changes.translation_m, 2), "", "", "",
                  fixed(kTurnInDegrees * changes.rotation_rad, 3), "",
                  at_bound > 0 ? std::to_string(at_bound) + " at their bounds" : ""});
  return rows;
}

}  // namespace

std::string frame_translations_script(const Scene& scene, const PoseChanges& changes) {
  return curves_script(scene, changes, &PoseChange::translation_m, 100,
                       {{"poses_moved", "time (s)", "moved (cm)", kWidth_px, kHeight_px, kFont_pt},
                        {"ahead", "left", "up"},
                        {},
                        {},
                        {},
                        100.0 * kMaxTranslation_m});
}

std::string frame_rotations_script(const Scene& scene, const PoseChanges& changes) {
  return curves_script(
      scene, changes, &PoseChange::rotation_rad, kTurnInDegrees,
      {{"poses_turned", "time (s)", "turned (degrees)", kWidth_px, kHeight_px, kFont_pt},
       {"roll", "pitch", "yaw"},
       {},
       {},
       {},
       kTurnInDegrees * kMaxRotation_rad});
}

std::string poses_section(const Run& run, const std::filesystem::path& figures) {
  std::string out = "<h2>Poses</h2>\n<p>" + source_of(run);
  if (!run.state.poses.refines()) return out + " Training left them as they are.</p>\n";
  const PoseChanges changes = pose_changes(run.scene, run.state.poses.corrections);
  const std::string bounds =
      fixed(100 * kMaxTranslation_m, 0) + " cm and " + fixed(kTurnInDegrees * kMaxRotation_rad, 1) +
      " degrees along each axis, cameras also at " + fixed(1e3 * kMaxTimeOffset_s, 0) + " ms";
  out +=
      " While training, each frame, each camera on the body and each camera's clock were corrected "
      "by what their "
      "rays say of them (<code>--refine-poses</code>).</p>\n";
  if (const std::string which = at_bound(changes); !which.empty())
    out += html_warning("Corrections run against their bounds (" + bounds + "): " + which +
                        ". What is further off is put right by redrive align; redrive inspect "
                        "--report says whether "
                        "calibration and clocks fit the images.");
  out += html_table(rows_of(changes), true) +
         "<p>In the axes of the body, added to what training began with. What all cameras have in "
         "common is in the "
         "frames. Corrections end at " +
         bounds + ".</p>\n<div class=\"row\">\n" +
         plot_figure(figures, "poses_moved", frame_translations_script(run.scene, changes),
                     "how far each frame was moved") +
         plot_figure(figures, "poses_turned", frame_rotations_script(run.scene, changes),
                     "how far each frame was turned") +
         "</div>\n";
  return out;
}

}  // namespace redrive
