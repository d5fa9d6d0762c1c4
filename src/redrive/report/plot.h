// SPDX-License-Identifier: Apache-2.0
// Plots as PNG, drawn by gnuplot. All pages draw this way.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "redrive/train/run.h"

namespace redrive {

/// Width of every plot. Pages show it at a half to a third of that, so its font is large.
constexpr int kPlotWidth_px = 1000;

struct PlotAxes {
  std::string name;  ///< name of the files: <name>.gnuplot, <name>.png
  std::string x_label, y_label;
  int height_px = 560;
};
/// Returns the height of a plot whose key has this many cameras, each in a row of its own.
int height_with_cameras(std::size_t cameras);
/// The beginning of a script: terminal, axes with a grid, the key above them.
std::string plot_preamble(const PlotAxes& axes);
/// Quotes any text as a string of a script.
std::string gnuplot_string(const std::string& text);
/// Returns axis ranges to scale: the ranges of a box with a margin, widened to the plot's aspect
/// ratio.
std::string equal_axes(const Eigen::AlignedBox2d& shown, double margin);
/// Returns the colour of curve `index`, of distinct hue: "#1f4e8c".
std::string plot_colour(std::size_t index);

/// Three values over time, a curve each.
struct TimeCurves {
  PlotAxes axes;
  std::array<const char*, 3> titles;
  std::vector<double> t_s;
  std::vector<Eigen::Vector3d> values;  ///< as t_s
  std::vector<Eigen::Vector3d> sigmas;  ///< as t_s, or empty; drawn as bands of +-2 sigma
  double bound = 0;  ///< dashed lines at +-bound where a curve exceeds half of it; 0: none
};
std::string time_curves_script(const TimeCurves& curves);

/// Returns the mean of each value and its neighbours within `radius`, fewer at the ends.
std::vector<double> running_mean(const std::vector<double>& values, int radius);

/// gnuplot scripts of the training history, data inline, which draw loss.png and psnr.png into
/// their own folder: loss on a logarithmic axis where it falls far, PSNR on a linear one; each
/// row's value thin, the running mean thick, the beginning of each epoch marked.
std::string loss_script(const std::vector<MetricsRow>& rows);
std::string psnr_script(const std::vector<MetricsRow>& rows);

/// Creates the folder, writes folder/<name>.gnuplot and has gnuplot draw folder/<name>.png.
/// IoError: gnuplot is not installed, or failed.
void draw_plot(const std::filesystem::path& folder, const std::string& name,
               const std::string& script);
/// Draws the plot and returns it as a figure of a page.
std::string plot_figure(const std::filesystem::path& folder, const std::string& name,
                        const std::string& script, const std::string& caption);

}  // namespace redrive
