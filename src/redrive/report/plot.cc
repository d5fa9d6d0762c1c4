// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/plot.h"

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <limits>
#include <sstream>

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/processes/interruption.h"
#include "redrive/image/image_io.h"
#include "redrive/report/html.h"

namespace redrive {
namespace {

constexpr std::size_t kMeanParts = 60;  // the running mean spans 1/60 of the run to either side
constexpr int kLabelledEpochs = 6;      // more labels would overlap

/// The differences between the two plots.
struct Axis {
  const char* name;  ///< name of the files
  const char* label;
  std::string setup;  ///< gnuplot lines
  double MetricsRow::*value;
};

std::string history_script(const std::vector<MetricsRow>& rows, const Axis& axis) {
  std::ostringstream out;
  out.precision(8);
  out << plot_preamble({axis.name, "step", axis.label}) << axis.setup
      << "set grid noxtics\nset offsets 0, 0, graph 0.12, 0\nset xrange [0:"
      << (rows.empty() ? 1 : rows.back().step) << "]\n";
  const int epochs = rows.empty() ? 0 : rows.back().epoch + 1;
  std::int64_t unlabelled_from = 0;  // the step
  for (std::size_t i = 0; i < rows.size(); ++i) {
    if (i > 0 && rows[i].epoch == rows[i - 1].epoch) continue;
    const std::int64_t step = i == 0 ? 0 : rows[i - 1].step;
    if (i > 0)
      out << "set arrow from " << step << ", graph 0 to " << step
          << ", graph 1 nohead dt 3 lc rgb '#aaaaaa'\n";
    if (epochs <= kLabelledEpochs && step >= unlabelled_from) {
      unlabelled_from = step + rows.back().step / kLabelledEpochs;
      out << "set label 'epoch " << rows[i].epoch + 1 << "' at " << step
          << ", graph 0.97 offset 0.5,0 tc rgb '#888888'\n";
    }
  }
  std::vector<double> values;
  for (const MetricsRow& row : rows) values.push_back(row.*axis.value);
  const int radius = static_cast<int>(rows.size() / kMeanParts);
  const std::vector<double> means = running_mean(values, radius);
  out << "$history << end\n";
  for (std::size_t i = 0; i < rows.size(); ++i)
    out << rows[i].step << ' ' << values[i] << ' ' << means[i] << '\n';
  out << "end\nplot ";
  if (radius > 0) out << "$history using 1:2 with lines lw 2 lc rgb '#a9c4e6' title 'as logged', ";
  out << "$history using 1:3 with lines lw 3 lc rgb '#1f4e8c' title '"
      << (radius > 0 ? "running mean" : "as logged") << "'\n";
  return out.str();
}

}  // namespace

std::string gnuplot_string(const std::string& text) {
  std::string out = "'";
  // Single quotes take everything literally, but gnuplot misreads '' at a string's beginning.
  for (const char c : text) out += c == '\'' ? std::string(R"('."'".')") : std::string(1, c);
  return out + "'";
}

std::string equal_axes(const Eigen::AlignedBox2d& shown, double margin) {
  constexpr double kUpPerAcross = 0.5;
  const Eigen::Vector2d size = shown.sizes().array() + 2 * margin;
  const double across = std::max(size.x(), size.y() / kUpPerAcross);
  const Eigen::Vector2d half(across / 2, across / 2 * kUpPerAcross), low = shown.center() - half,
                                                                     high = shown.center() + half;
  std::ostringstream out;
  out << "set size ratio -1\nset xrange [" << low.x() << ':' << high.x() << "]\nset yrange ["
      << low.y() << ':' << high.y() << "]\n";
  return out.str();
}

std::string plot_colour(std::size_t index) {
  constexpr const char* kColours[] = {"#1f4e8c", "#c2571a", "#3a7d44", "#7a4a9e",
                                      "#8a6d1b", "#20808d", "#c2548f", "#5f6b7a"};
  return kColours[index % std::size(kColours)];
}

int height_with_cameras(std::size_t cameras) {
  constexpr int kRow_px = 34;  // height of a key's row at the font's size
  return 520 + kRow_px * static_cast<int>(cameras);
}

std::string plot_preamble(const PlotAxes& axes) {
  std::ostringstream out;
  out << "set terminal pngcairo size " << kPlotWidth_px << "," << axes.height_px
      << " font 'DejaVu Sans,20' background '#ffffff' noenhanced\nset output "
      << gnuplot_string(axes.name + ".png.part") << "\nset xlabel " << gnuplot_string(axes.x_label)
      << "\nset ylabel " << gnuplot_string(axes.y_label)
      << "\nset grid lc rgb '#dddddd' lt 1\nset border 3 lc rgb '#666666'\nset tics nomirror\n"
      << "set key tmargin left horizontal Left reverse samplen 2 width 1\n";
  return out.str();
}

std::string time_curves_script(const TimeCurves& curves) {
  REDRIVE_CHECK_OP(curves.values.size(), ==, curves.t_s.size());
  const bool bands = !curves.sigmas.empty();
  double most = 0;
  for (const Eigen::Vector3d& value : curves.values)
    most = std::max(most, value.cwiseAbs().maxCoeff());
  std::ostringstream out;
  out.precision(6);
  out << plot_preamble(curves.axes)
      << "set style fill transparent solid 0.2 noborder\nset autoscale xfix\n"
      << "set xzeroaxis lt 1 lc rgb '#999999'\n"
      << (most > 0 || bands ? "" : "set yrange [-1:1]\n") << "$data << end\n";
  for (std::size_t i = 0; i < curves.t_s.size(); ++i) {
    out << curves.t_s[i];
    for (int k = 0; k < 3; ++k) {
      const double value = curves.values[i][k], band = bands ? 2 * curves.sigmas[i][k] : 0;
      out << ' ' << value << ' ' << value - band << ' ' << value + band;
    }
    out << '\n';
  }
  out << "end\nplot ";
  for (int k = 0; k < 3; ++k) {
    const std::string colour = " lc rgb '" + plot_colour(k) + "' ";
    out << (k ? ", " : "");
    if (bands)
      out << "$data using 1:" << 3 * k + 3 << ":" << 3 * k + 4 << " with filledcurves" << colour
          << "notitle, ";
    out << "$data using 1:" << 3 * k + 2 << " with lines lw 3" << colour << "title "
        << gnuplot_string(curves.titles[k]);
  }
  if (curves.bound > 0 && 2 * most > curves.bound)
    for (const double bound : {curves.bound, -curves.bound})
      out << ", " << bound << " with lines dt 2 lw 2 lc rgb '#b3261e' "
          << (bound > 0 ? "title 'bound'" : "notitle");
  out << '\n';
  return out.str();
}

std::vector<double> running_mean(const std::vector<double>& values, int radius) {
  std::vector<double> means(values.size());
  const int size = static_cast<int>(values.size());
  for (int i = 0; i < size; ++i) {
    const int first = std::max(0, i - radius), last = std::min(size - 1, i + radius);
    double sum = 0;
    for (int k = first; k <= last; ++k) sum += values[k];
    means[i] = sum / (last - first + 1);
  }
  return means;
}

std::string loss_script(const std::vector<MetricsRow>& rows) {
  // Labels at 1, 2 and 5 of each decade, and a margin of a tenth of a decade: a whole run often
  // stays within one decade. A shorter axis would show fewer than two labels.
  constexpr double kLeastRatio = 3;
  double low = std::numeric_limits<double>::infinity(), high = 0;
  for (const MetricsRow& row : rows)
    if (row.loss > 0) low = std::min(low, row.loss), high = std::max(high, row.loss);
  std::ostringstream setup;
  if (high >= kLeastRatio * low) {
    setup << "set logscale y\nset format y '%g'\nset ytics (";
    for (int decade = -8; decade <= 1; ++decade)
      for (const int digit : {1, 2, 5})
        setup << (decade == -8 && digit == 1 ? "" : ", ") << digit << "e" << decade;
    const double margin = std::max(1.25, std::pow(high / low, 0.15));  // labels of epochs
    setup << ")\nset yrange [" << 0.8 * low << ":" << margin * high << "]\n";
  }
  return history_script(rows, {"loss", "training loss", setup.str(), &MetricsRow::loss});
}

std::string psnr_script(const std::vector<MetricsRow>& rows) {
  return history_script(rows, {"psnr", "PSNR (dB)", "", &MetricsRow::psnr_db});
}

void draw_plot(const std::filesystem::path& folder, const std::string& name,
               const std::string& script) {
  const std::filesystem::path script_file = folder / (name + ".gnuplot"),
                              image = folder / (name + ".png"),
                              part = folder / (name + ".png.part");
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) throw IoError(folder, error.message());
  write_file(script_file, script);

  const std::string argument = name + ".gnuplot";
  char* const arguments[] = {const_cast<char*>("gnuplot"), const_cast<char*>(argument.c_str()),
                             nullptr};
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addchdir_np(&actions, folder.c_str());
  pid_t child = 0;
  const int failed = posix_spawnp(&child, "gnuplot", &actions, nullptr, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  if (failed == ENOENT)
    throw IoError(image, "gnuplot is not installed (Debian package gnuplot-nox)");
  if (failed)
    throw IoError(image, std::string("gnuplot could not be started: ") + std::strerror(failed));
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  check_interruption();  // Ctrl-C at a terminal ends gnuplot, too
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    std::filesystem::remove(part, error);
    throw IoError(image, "gnuplot failed on " + script_file.string());
  }
  try {
    read_image(part);  // gnuplot exits with 0 even where the disk was full
  } catch (const InputError& broken) {
    std::filesystem::remove(part, error);
    throw IoError(image, std::string("gnuplot wrote a truncated image: ") + broken.what());
  }
  std::filesystem::rename(part, image, error);
  if (error) throw IoError(image, error.message());
}

std::string plot_figure(const std::filesystem::path& folder, const std::string& name,
                        const std::string& script, const std::string& caption) {
  draw_plot(folder, name, script);
  return html_figure(png_data_uri(read_file(folder / (name + ".png"))), caption, FigureKind::kPlot);
}

}  // namespace redrive
