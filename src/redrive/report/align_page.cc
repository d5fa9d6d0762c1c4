// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/align_page.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <functional>
#include <sstream>

#include "redrive/align/bundle/unobservable_extrinsics.h"
#include "redrive/base/files/files.h"
#include "redrive/base/formatted.h"
#include "redrive/base/progress.h"
#include "redrive/math/angles.h"
#include "redrive/report/html.h"
#include "redrive/report/plot.h"

namespace redrive {
namespace {

constexpr std::size_t kPointsShown = 4000;  // residuals shown of a camera, at most

double seconds_of(const Recording& recording, std::size_t frame) {
  return 1e-9 * static_cast<double>(recording.frames[frame].t_ns - recording.frames.front().t_ns);
}

/// Plots three components of the corrections over time: from component `first` on, times `scale`.
std::string corrections_script(const Recording& recording, const AlignResult& result,
                               const PlotAxes& axes, int first, double scale,
                               const std::array<const char*, 3>& titles) {
  TimeCurves curves{axes, titles, {}, {}, {}};
  for (std::size_t f = 0; f < result.corrections.size(); ++f) {
    curves.t_s.push_back(seconds_of(recording, f));
    curves.values.push_back(scale * result.corrections[f].value.segment<3>(first));
    curves.sigmas.push_back(scale * result.corrections[f].sigma.segment<3>(first));
  }
  return time_curves_script(curves);
}

/// Plots the trajectory from above in the axes of the first body, with the corrections as arrows of
/// ten times their length.
std::string trajectory_script(const Recording& recording, const AlignResult& result,
                              const std::string& name) {
  std::ostringstream out;
  out.precision(7);
  out << plot_preamble({name, "forward of the first frame (m)", "left of it (m)"})
      << "set size ratio -1\n$data << end\n";
  const Rigid3d first_from_global =
      recording.frames.front().global_from_body.inverse(Eigen::Isometry);
  for (std::size_t f = 0; f < result.frames.size(); ++f) {
    const Eigen::Vector3d initial = first_from_global *
                                    recording.frames[f].global_from_body.translation(),
                          aligned =
                              first_from_global * result.frames[f].global_from_body.translation(),
                          moved = 10 * (aligned - initial);
    out << initial.x() << ' ' << initial.y() << ' ' << aligned.x() << ' ' << aligned.y() << ' '
        << moved.x() << ' ' << moved.y() << '\n';
  }
  out << "end\nplot $data using 1:2 with linespoints pt 7 ps 0.5 lc rgb '#aaaaaa' title "
         "'initial', $data using 3:4 with linespoints pt 7 ps 0.5 lc rgb '#1f4e8c' title "
         "'aligned', $data using 1:2:5:6 with vectors nohead lc "
         "rgb '#c2571a' title "
         "'correction x 10'\n";
  return out.str();
}

/// Plots the RMS reprojection error of each camera by frame: thin before, thick after.
std::string by_frame_script(const Recording& recording, const AlignResult& result,
                            const std::string& name) {
  const std::size_t cameras = result.cameras.size(), frames = result.frames.size();
  std::vector<std::vector<std::array<double, 3>>> sums(frames,
                                                       std::vector<std::array<double, 3>>(cameras));
  for (const ImageResidual& r : result.bundle.residuals) {
    std::array<double, 3>& sum = sums[r.frame][r.camera];
    sum[0] += 1;
    sum[1] += r.initial_px.squaredNorm();
    sum[2] += r.aligned_px.squaredNorm();
  }
  std::ostringstream out;
  out.precision(5);
  out << plot_preamble({name, "time (s)", "RMS (px)", height_with_cameras(cameras)})
      << "set logscale y\n$data << end\n";
  for (std::size_t f = 0; f < frames; ++f) {
    out << seconds_of(recording, f);
    for (const auto& sum : sums[f])
      for (const int k : {1, 2})
        out << ' ' << (sum[0] > 0 ? formatted("%.5g", std::sqrt(sum[k] / sum[0])) : "NaN");
    out << '\n';
  }
  out << "end\nplot ";
  for (std::size_t c = 0; c < cameras; ++c) {
    const std::string colour = plot_colour(c);
    out << (c ? ", " : "") << "$data using 1:" << 2 * c + 2 << " with lines lw 2 dt 3 lc rgb '"
        << colour << "' notitle"
        << ", $data using 1:" << 2 * c + 3 << " with lines lw 3 lc rgb '" << colour << "' title "
        << gnuplot_string(result.cameras[c].name);
  }
  out << "\n";
  return out.str();
}

/// Plots the reprojection errors of one camera as points.
std::string scatter_script(const AlignResult& result, int camera, const std::string& name) {
  std::vector<const ImageResidual*> of_camera;
  for (const ImageResidual& r : result.bundle.residuals)
    if (r.camera == camera) of_camera.push_back(&r);
  std::ostringstream out;
  out.precision(4);
  const double reach = std::max(1.0, 3 * result.bundle.cameras[camera].initial_px);
  out << plot_preamble({name, "error in x (px)", "error in y (px)", 760})
      << "set size ratio 1\nset xrange [" << -reach << ":" << reach << "]\nset yrange [" << -reach
      << ":" << reach << "]\n$data << end\n";
  const std::size_t step = 1 + of_camera.size() / kPointsShown;
  for (std::size_t i = 0; i < of_camera.size(); i += step)
    out << of_camera[i]->initial_px.x() << ' ' << of_camera[i]->initial_px.y() << ' '
        << of_camera[i]->aligned_px.x() << ' ' << of_camera[i]->aligned_px.y() << '\n';
  out << "end\nplot $data using 1:2 with points pt 7 ps 0.25 lc rgb '#d9a06f' notitle, "
         "$data using 3:4 with points pt 7 ps 0.25 lc rgb '#1f4e8c' notitle, "
         "NaN with points pt 7 ps 1.2 lc rgb '#d9a06f' title 'before', "
         "NaN with points pt 7 ps 1.2 lc rgb '#1f4e8c' title 'after'\n";
  return out.str();
}

/// Reprojection errors, edge scores, ties and times of each camera.
std::vector<std::vector<std::string>> camera_rows(const AlignResult& result) {
  std::vector<std::vector<std::string>> rows{
      {"camera", "observations used", "before px", "after px", "edges before", "edges after",
       "LiDAR ties", "off by cm", "time offset ms", "\u00b1 ms"}};
  const bool rolling = std::ranges::any_of(
      result.camera_corrections,
      [](const CameraCorrection& k) { return k.readout_s != 0 || k.readout_sigma_s; });
  if (rolling) rows[0].insert(rows[0].end(), {"readout ms", "\u00b1 ms"});
  const auto edges = [](const std::vector<std::optional<EdgeScore>>& scores, std::size_t c) {
    return c < scores.size() && scores[c] ? fixed(scores[c]->score(), 3) : "-";
  };
  for (std::size_t c = 0; c < result.cameras.size(); ++c) {
    const CameraFit& fit = result.bundle.cameras[c];
    const CameraCorrection& k = result.camera_corrections[c];
    const int ties = result.bundle.ties_of_camera[c];
    rows.push_back(
        {k.name, formatted("%d of %d", fit.used, fit.observations),
         formatted("%.2f", fit.initial_px), formatted("%.2f", fit.aligned_px),
         edges(result.initial_edges, c), edges(result.aligned_edges, c), std::to_string(ties),
         ties > 0 ? formatted("%.1f", 100 * fit.ties_m) : "-", formatted("%+.2f", 1e3 * k.offset_s),
         k.offset_sigma_s ? formatted("%.2f", 1e3 * *k.offset_sigma_s) : "unobservable"});
    if (rolling) {
      rows.back().push_back(formatted("%+.2f", 1e3 * k.readout_s));
      rows.back().push_back(k.readout_sigma_s ? formatted("%.2f", 1e3 * *k.readout_sigma_s)
                                              : "not refined");
    }
  }
  return rows;
}

/// Plots the correlation of the images' contrast with the LiDAR's intensities over time offsets.
std::string contrast_script(const AlignResult& result, const std::string& name) {
  const std::vector<ContrastFit>& fits = result.bundle.contrast;
  std::ostringstream out;
  out.precision(5);
  out << plot_preamble({name, "time offset, added to the calibration's (ms)",
                        "correlation, relative to its maximum", height_with_cameras(fits.size())})
      << "$data << end\n";
  const std::size_t steps = fits.empty() ? 0 : fits[0].correlation.size();
  for (std::size_t k = 0; k < steps; ++k) {
    out << 1e3 * kContrastStep_s * (static_cast<double>(k) - static_cast<double>(steps / 2));
    for (const ContrastFit& fit : fits)
      out << ' '
          << formatted("%.5g",
                       fit.correlation[k] / std::max(1e-9, std::ranges::max(fit.correlation)));
    out << '\n';
  }
  out << "end\nset yrange [0:1.05]\nplot ";
  for (std::size_t c = 0; c < fits.size(); ++c)
    out << (c ? ", " : "") << "$data using 1:" << c + 2 << " with lines lw 3 lc rgb '"
        << plot_colour(c) << "' title " << gnuplot_string(result.cameras[c].name);
  out << "\n";
  return out.str();
}

/// Corrections of the cameras' extrinsics in body axes.
std::vector<std::vector<std::string>> extrinsics_rows(const AlignResult& result) {
  std::vector<std::vector<std::string>> rows{{"camera"}};
  for (int axis = 0; axis < kExtrinsicAxes; ++axis)
    rows[0].push_back(std::string(extrinsic_name(axis)) + (axis < 3 ? " cm" : " deg"));
  for (const CameraCorrection& k : result.camera_corrections) {
    rows.push_back({k.name});
    for (int axis = 0; axis < kExtrinsicAxes; ++axis) {
      const double unit = axis < 3 ? 100 : kDegreesPerRadian;
      const int digits = axis < 3 ? 1 : 3;
      rows.back().push_back(k.extrinsic_sigmas[axis]
                                ? formatted("%+.*f \u00b1 %.*f", digits, unit * k.extrinsics[axis],
                                            digits, unit * *k.extrinsic_sigmas[axis])
                                : "unobservable");
    }
  }
  return rows;
}

std::vector<std::vector<std::string>> contrast_rows(const AlignResult& result) {
  std::vector<std::vector<std::string>> rows{
      {"camera", "cells compared", "highest correlation", "at, ms", "\u00b1 ms"}};
  for (std::size_t c = 0; c < result.bundle.contrast.size(); ++c) {
    const ContrastFit& fit = result.bundle.contrast[c];
    rows.push_back({result.cameras[c].name, std::to_string(fit.cells),
                    formatted("%.3f", std::ranges::max(fit.correlation)),
                    fit.observable ? formatted("%+.2f", 1e3 * fit.offset_s) : "no peak: not used",
                    fit.observable ? formatted("%.2f", 1e3 * fit.sigma_s) : ""});
  }
  return rows;
}

std::string lidar_paragraph(const AlignResult& result) {
  std::string text = formatted(
      "<p>Distance of LiDAR points from their planes: RMS %.2f cm before, "
      "%.2f cm after",
      100 * result.bundle.initial_lidar_rms_m, 100 * result.bundle.lidar_rms_m);
  if (const auto& sigma_rad = result.lidar_elevation_sigma_rad)
    text +=
        formatted("; elevations corrected by %+.3f \u00b1 %.3f degrees",
                  kDegreesPerRadian * result.lidar_elevation_rad, kDegreesPerRadian * *sigma_rad);
  return text + "</p>\n";
}

}  // namespace

void write_align_page(const std::filesystem::path& folder, const Recording& recording,
                      const AlignResult& result) {
  const auto drawn = [&](const std::string& name, const std::string& script,
                         const std::string& caption) {
    return plot_figure(folder / "figures", name, script, caption);
  };
  const Progress progress("drawing the page");
  const BundleResult& bundle = result.bundle;
  std::string body = "<h1>Aligned poses</h1>\n<p>" + html_escape(recording.root.string()) + ": " +
                     formatted(
                         "%zu frames, %d tracks of image points, %d LiDAR points on %d flat "
                         "patches; %d rounds, %.0f s",
                         result.frames.size(), bundle.tracks, bundle.lidar_points, bundle.patches,
                         bundle.rounds, result.seconds) +
                     "</p>\n";
  for (const std::string& remark : result.remarks) body += "<p>" + html_escape(remark) + "</p>\n";
  body += "<h2>Cameras</h2>\n" + html_table(camera_rows(result), true) +
          "<p>Reprojection errors are RMS over the observations used, with each point triangulated "
          "anew. Edges: how well steps of the LiDAR's depth lie on edges of the images, 0.5 by "
          "chance to 1; a dash: the LiDAR is too sparse. LiDAR ties: image points on surfaces that "
          "the LiDAR measured, and the median of their distances from them.</p>\n" +
          html_table(extrinsics_rows(result), true) +
          "<p>Corrections of the cameras' extrinsics along the body's axes (forward, left, up) and "
          "about them (roll, pitch, yaw). \u00b1 is one standard deviation, with the observations "
          "of one point, and the LiDAR returns of one patch, correlated, and with errors that all "
          "observations share. Unobservable: the drive does not determine it; it stays as "
          "calibrated.</p>\n";
  if (bundle.lidar_points > 0) body += lidar_paragraph(result);
  if (!bundle.contrast.empty())
    body += "<h2>Time offsets by the LiDAR</h2>\n" + html_table(contrast_rows(result), true) +
            html_row(drawn("contrast", contrast_script(result, "contrast"),
                           "correlation of LiDAR intensities (lane markings, signs, posts) with "
                           "image brightness, as if the camera had been exposed at another time"),
                     FigureSize::kLarge);
  if (result.aligned_vs_ground_truth)
    body +=
        "<h2>Errors against the ground truth</h2>\n" +
        html_table({{"trajectory", "position cm RMS", "rotation deg RMS"},
                    {"initial", formatted("%.2f", 100 * result.initial_vs_ground_truth->residual_m),
                     formatted("%.4f", result.initial_vs_ground_truth->residual_deg)},
                    {"aligned", formatted("%.2f", 100 * result.aligned_vs_ground_truth->residual_m),
                     formatted("%.4f", result.aligned_vs_ground_truth->residual_deg)}},
                   true) +
        "<p>After a rigid alignment of the whole trajectory.</p>\n";
  body +=
      "<h2>Trajectory</h2>\n" +
      html_row(
          drawn(
              "position",
              corrections_script(recording, result, {"position", "time (s)", "translation (cm)"}, 0,
                                 100, {extrinsic_name(0), extrinsic_name(1), extrinsic_name(2)}),
              "correction of each frame's position, in the axes of the body; bands: two standard "
              "deviations of the trajectory's shape") +
              drawn(
                  "rotation",
                  corrections_script(recording, result, {"rotation", "time (s)", "rotation (deg)"},
                                     3, kDegreesPerRadian,
                                     {extrinsic_name(3), extrinsic_name(4), extrinsic_name(5)}),
                  "correction of each frame's rotation") +
              drawn("trajectory", trajectory_script(recording, result, "trajectory"),
                    "from above, to scale"),
          FigureSize::kLarge);
  if (!bundle.residuals.empty()) {
    std::string figures =
        drawn("errors_by_frame", by_frame_script(recording, result, "errors_by_frame"),
              "by frame; dotted: before, solid: after");
    for (std::size_t c = 0; c < result.cameras.size(); ++c) {
      if (bundle.cameras[c].used == 0) continue;
      const std::string name = "errors_" + result.cameras[c].name;
      figures +=
          drawn(name, scatter_script(result, static_cast<int>(c), name), result.cameras[c].name);
    }
    body += "<h2>Reprojection errors</h2>\n" + html_row(figures, FigureSize::kLarge);
  }
  write_file(folder / "report.html", html_page("Aligned poses", body));
}

}  // namespace redrive
