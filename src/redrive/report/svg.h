// SPDX-License-Identifier: Apache-2.0
// Small line drawings within a page, as SVG: curves over an axis, and drawings to scale.
#pragma once

#include <string>
#include <vector>

#include <Eigen/Core>

namespace redrive {

struct SvgCurve {
  std::vector<Eigen::Vector2d> points;  ///< NaN breaks the line
  std::string colour = "#1d2733";
  std::string label;  ///< in the key; empty: none
  double width_px = 1.6;
};
struct SvgText {
  Eigen::Vector2d at;
  std::string text;
};

struct SvgPlot {
  std::string x_label, y_label;
  std::vector<SvgCurve> curves;
  std::vector<SvgText> texts;
  bool to_scale = false;   ///< both axes have the same unit
  bool from_zero = false;  ///< y begins at 0
  int width_px = 560, height_px = 300;
};

/// Of distinct hue, by index.
std::string svg_colour(std::size_t index);
/// An <svg> element; its ticks are at 1, 2 or 5 times a power of ten.
std::string svg_plot(const SvgPlot& plot);
/// With a caption, as html_figure.
std::string svg_figure(const SvgPlot& plot, const std::string& caption);

}  // namespace redrive
