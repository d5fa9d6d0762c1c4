// SPDX-License-Identifier: Apache-2.0
// Curves of a run as PNG, drawn by gnuplot.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "redrive/train/run.h"

namespace redrive {

/// Mean of each value and its neighbours within `radius`, fewer at the ends.
std::vector<double> running_mean(const std::vector<double>& values, int radius);

/// gnuplot scripts of the training history, data inline: loss on a logarithmic axis, PSNR on a linear one; each row's value
/// thin, its running mean thick, the beginning of each epoch marked. They draw loss.png and psnr.png into their own folder.
std::string loss_script(const std::vector<MetricsRow>& rows, const std::string& title);
std::string psnr_script(const std::vector<MetricsRow>& rows, const std::string& title);

/// Writes folder/<name>.gnuplot and has gnuplot draw folder/<name>.png. IoError: gnuplot is not installed, or failed.
void draw_plot(const std::filesystem::path& folder, const std::string& name, const std::string& script);

}  // namespace redrive
