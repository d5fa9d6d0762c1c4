// SPDX-License-Identifier: Apache-2.0
// Building blocks of a self-contained HTML page.
#pragma once

#include <string>
#include <string_view>
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
std::string html_figure(const std::string& address, const std::string& caption);
/// A table whose first row is its head. Cells are text and are escaped. `numbers`: right-aligns all
/// columns but the first.
std::string html_table(const std::vector<std::vector<std::string>>& rows, bool numbers);
std::string html_page(const std::string& title, const std::string& body);

}  // namespace redrive
