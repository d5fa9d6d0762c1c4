// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/svg.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "redrive/report/html.h"

namespace redrive {
namespace {

constexpr double kLeft = 56, kRight = 14, kTop = 12, kBottom = 42;

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.5g", std::abs(value) < 1e-12 ? 0.0 : value);
  return text;
}

double tick_step(double range, double most) {
  const double power = std::pow(10, std::floor(std::log10(range / most)));
  for (const double factor : {1.0, 2.0, 5.0})
    if (range / (factor * power) <= most) return factor * power;
  return 10 * power;
}

struct Range {
  double low = std::numeric_limits<double>::infinity(), high = -low;

  void add(double value) {
    low = std::min(low, value);
    high = std::max(high, value);
  }
  double size() const { return high - low; }
  /// Neither empty nor without size, and a little wider.
  void finish(bool from_zero) {
    if (!(low <= high)) low = 0, high = 1;
    if (from_zero) low = 0;
    if (size() < 1e-9) high = low + 1;
    const double margin = 0.05 * size();
    if (!from_zero) low -= margin;
    high += margin;
  }
  void widen_to(double wanted) {
    const double more = std::max(0.0, wanted - size()) / 2;
    low -= more;
    high += more;
  }
};

std::string text_at(double x, double y, const std::string& anchor, const std::string& text,
                    const std::string& more = "") {
  return "<text x=\"" + number(x) + "\" y=\"" + number(y) + "\" text-anchor=\"" + anchor + "\" " + more + ">" +
         html_escape(text) + "</text>\n";
}

}  // namespace

std::string svg_colour(std::size_t index) {
  constexpr const char* kColours[] = {"#1f6fb4", "#d1495b", "#2e933c", "#8e5bb5",
                                      "#d98324", "#23909c", "#7a6f5d", "#c2548f"};
  return kColours[index % std::size(kColours)];
}

std::string svg_plot(const SvgPlot& plot) {
  Range x, y;
  for (const SvgCurve& curve : plot.curves)
    for (const Eigen::Vector2d& p : curve.points)
      if (p.allFinite()) {
        x.add(p.x());
        y.add(p.y());
      }
  x.finish(false);
  y.finish(plot.from_zero);
  const double across = plot.width_px - kLeft - kRight, up = plot.height_px - kTop - kBottom;
  if (plot.to_scale) {
    const double unit = std::max(x.size() / across, y.size() / up);
    x.widen_to(unit * across);
    y.widen_to(unit * up);
  }
  const auto at_x = [&](double value) { return kLeft + (value - x.low) / x.size() * across; };
  const auto at_y = [&](double value) { return kTop + (y.high - value) / y.size() * up; };
  const auto line = [](double x0, double y0, double x1, double y1, const char* colour) {
    return "<path d=\"M" + number(x0) + " " + number(y0) + "L" + number(x1) + " " + number(y1) + "\" stroke=\"" +
           colour + "\" fill=\"none\"/>\n";
  };

  const std::string width = std::to_string(plot.width_px), height = std::to_string(plot.height_px);
  std::string out = "<svg viewBox=\"0 0 " + width + " " + height +
                    "\" style=\"width:100%;overflow:visible;max-width:" + width +
                    "px\" font-size=\"12\" fill=\"#5f6b7a\" role=\"img\">\n";
  const double step_x = tick_step(x.size(), 8), step_y = tick_step(y.size(), 6);
  for (double v = std::ceil(x.low / step_x) * step_x; v <= x.high; v += step_x)
    out += line(at_x(v), kTop, at_x(v), kTop + up, "#eef1f5") + text_at(at_x(v), kTop + up + 15, "middle", number(v));
  for (double v = std::ceil(y.low / step_y) * step_y; v <= y.high; v += step_y)
    out += line(kLeft, at_y(v), kLeft + across, at_y(v), "#eef1f5") + text_at(kLeft - 6, at_y(v) + 4, "end", number(v));
  out += line(kLeft, kTop, kLeft, kTop + up, "#99a3af") + line(kLeft, kTop + up, kLeft + across, kTop + up, "#99a3af");
  out += text_at(kLeft + across / 2, plot.height_px - 8, "middle", plot.x_label);
  const double middle = kTop + up / 2;
  out += text_at(14, middle, "middle", plot.y_label, "transform=\"rotate(-90 14 " + number(middle) + ")\"");
  int in_key = 0;
  for (const SvgCurve& curve : plot.curves) {
    std::string path;
    bool pen_down = false;
    for (const Eigen::Vector2d& p : curve.points) {
      if (p.allFinite()) path += (pen_down ? "L" : "M") + number(at_x(p.x())) + " " + number(at_y(p.y()));
      pen_down = p.allFinite();
    }
    out += "<path d=\"" + path + "\" fill=\"none\" stroke=\"" + curve.colour + "\" stroke-width=\"" +
           number(curve.width_px) + "\"/>\n";
    if (!curve.label.empty())
      out += text_at(kLeft + across - 4, kTop + 12 + 15 * in_key++, "end", curve.label,
                     "style=\"fill:" + curve.colour + "\"");
  }
  for (const SvgText& text : plot.texts) out += text_at(at_x(text.at.x()), at_y(text.at.y()), "start", text.text);
  return out + "</svg>\n";
}

std::string svg_figure(const SvgPlot& plot, const std::string& caption) {
  return "<figure>" + svg_plot(plot) + "<figcaption>" + html_escape(caption) + "</figcaption></figure>\n";
}

}  // namespace redrive
