// SPDX-License-Identifier: Apache-2.0
// Building blocks of a self-contained HTML page.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "redrive/image/image.h"

namespace redrive {

std::string base64(std::string_view bytes);      ///< RFC 4648, section 4
std::string html_escape(std::string_view text);  ///< & < > " '
/// `digits` behind the decimal point; "-" for NaN; never "-0.0".
std::string fixed(double value, int digits);

/// data: URIs of a PNG file's bytes, and of an image as a JPEG of quality 90, a tenth of the size
/// of a photograph's PNG.
std::string png_data_uri(std::string_view png_bytes);
std::string jpeg_data_uri(const Image8& image);

std::string html_warning(const std::string& text);  ///< a highlighted paragraph
/// What a figure shows: in dark mode plots are inverted, images are not.
enum class FigureKind { kImage, kPlot };
std::string html_figure(const std::string& address, const std::string& caption,
                        FigureKind kind = FigureKind::kImage);
/// Figures side by side: as many as have room, the others below. Small ones have room for two on a
/// phone.
enum class FigureSize { kSmall, kLarge };
std::string html_row(const std::string& figures, FigureSize size);
/// A table whose first row is its head. Cells are text and are escaped. `numbers`: right-aligns all
/// columns but the first. On a narrow page each row of a table with more than three columns becomes
/// a paragraph of its cells, each below its head.
std::string html_table(const std::vector<std::vector<std::string>>& rows, bool numbers);
/// A list of names and values in as many columns as have room.
std::string html_pairs(const std::vector<std::pair<std::string, std::string>>& pairs);
std::string html_command(const std::string& command);  ///< for a terminal, wrapped
/// The page keeps to the reader's colour scheme and to the window's width.
std::string html_page(const std::string& title, const std::string& body);

}  // namespace redrive
