// SPDX-License-Identifier: Apache-2.0
// Building blocks of a self-contained page.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "redrive/image/image.h"

namespace redrive {

std::string base64(std::string_view bytes);      ///< RFC 4648, section 4
std::string html_escape(std::string_view text);  ///< & < > " '
std::string fixed(double value, int digits);  ///< so many behind the point; "-" for NaN, no "-0.0"

/// data: addresses of a PNG file's bytes, and of an image (as a JPEG of quality 90: photographs, a
/// tenth of a PNG).
std::string png_data_uri(std::string_view png_bytes);
std::string jpeg_data_uri(const Image8& image);

std::string html_warning(const std::string& text);  ///< a paragraph that is seen
std::string html_figure(const std::string& address, const std::string& caption);
/// First row: head. Cells are text and are escaped; columns after the first are right-aligned if
/// `numbers`.
std::string html_table(const std::vector<std::vector<std::string>>& rows, bool numbers);
std::string html_page(const std::string& title, const std::string& body);

}  // namespace redrive
