// SPDX-License-Identifier: Apache-2.0
// Plots as PNG, drawn by gnuplot: the one way in which pages draw.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Core>

#include "redrive/train/run.h"

namespace redrive {

struct PlotAxes {
  std::string name;  ///< of the files: <name>.gnuplot, <name>.png
  std::string x_label, y_label;
  int width_px = 1200, height_px = 420, font_pt = 13;
};
/// The beginning of a script: a white picture, axes with a grid, the key beside them.
std::string plot_preamble(const PlotAxes& axes);
/// A string of a script, whatever is in it.
std::string gnuplot_string(const std::string& text);
/// Of distinct hue, by index: "#1f4e8c".
std::string plot_colour(std::size_t index);

/// Three numbers over time, each a curve.
struct TimeCurves {
  PlotAxes axes;
  std::array<const char*, 3> titles;
  std::vector<double> t_s;
  std::vector<Eigen::Vector3d> values;  ///< as t_s
  std::vector<Eigen::Vector3d> sigmas;  ///< as t_s, or none: bands of two of them to either side
  double bound = 0;  ///< dashed lines at +-bound where a curve comes to half of it; 0: none
};
std::string time_curves_script(const TimeCurves& curves);

/// Mean of each value and its neighbours within `radius`, fewer at the ends.
std::vector<double> running_mean(const std::vector<double>& values, int radius);

/// gnuplot scripts of the training history, data inline: loss on a logarithmic axis, PSNR on a
/// linear one; each row's value thin, its running mean thick, the beginning of each epoch marked.
/// They draw loss.png and psnr.png into their own folder.
std::string loss_script(const std::vector<MetricsRow>& rows, const std::string& title);
std::string psnr_script(const std::vector<MetricsRow>& rows, const std::string& title);

/// Writes folder/<name>.gnuplot and has gnuplot draw folder/<name>.png; makes the folder. IoError:
/// gnuplot is not installed, or failed.
void draw_plot(const std::filesystem::path& folder, const std::string& name,
               const std::string& script);
/// The same, and the picture as part of a page.
std::string plot_figure(const std::filesystem::path& folder, const std::string& name,
                        const std::string& script, const std::string& caption);

}  // namespace redrive
