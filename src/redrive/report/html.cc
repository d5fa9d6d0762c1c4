// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/html.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "redrive/image/jpeg.h"

namespace redrive {
namespace {

constexpr char kStyle[] = R"(
:root { color-scheme: light; --ink: #1d2733; --faint: #5f6b7a; --line: #dde3ea; }
body { margin: 0 auto; max-width: 1560px; padding: 24px 32px 64px;
  font: 15px/1.5 system-ui, sans-serif; color: var(--ink); }
h1 { font-size: 26px; margin: 0 0 4px; }
h2 { font-size: 19px; margin: 36px 0 10px; padding-bottom: 4px;
  border-bottom: 1px solid var(--line); }
h3 { font-size: 15px; margin: 18px 0 8px; }
p { margin: 4px 0; color: var(--faint); }
p.warning { margin: 10px 0; padding: 8px 12px; color: #8c1d18; background: #fdeceb;
  border-left: 4px solid #b3261e; }
.row { display: grid; grid-auto-flow: column; grid-auto-columns: minmax(240px, 1fr); gap: 14px;
  overflow-x: auto; }
figure { margin: 0; }
figure img { display: block; width: 100%; height: auto; border-radius: 3px; }
figcaption { font-size: 13px; color: var(--faint); padding: 3px 0 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 4px 22px 4px 0; border-bottom: 1px solid var(--line);
  vertical-align: top; }
th { color: var(--faint); font-weight: 600; }
table.numbers th:not(:first-child), table.numbers td:not(:first-child) { text-align: right; }
@media print { body { max-width: none; padding: 0; }
  .row { grid-auto-columns: minmax(0, 1fr); break-inside: avoid; } }
)";

}  // namespace

std::string base64(std::string_view bytes) {
  static constexpr char kDigits[] =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    unsigned bits = 0;
    const std::size_t have = std::min<std::size_t>(3, bytes.size() - i);
    for (std::size_t k = 0; k < 3; ++k)
      bits = bits << 8 | (k < have ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k) out += k <= have ? kDigits[bits >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

std::string fixed(double value, int digits) {
  if (std::isnan(value)) return "-";
  if (std::abs(value) <= 0.5 * std::pow(10, -digits)) value = 0;  // or there would be "-0.00"
  char text[64];
  std::snprintf(text, sizeof text, "%.*f", digits, value);
  return text;
}

std::string html_escape(std::string_view text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&': out += "&amp;"; break;
      case '<': out += "&lt;"; break;
      case '>': out += "&gt;"; break;
      case '"': out += "&quot;"; break;
      case '\'': out += "&#39;"; break;
      default: out += c;
    }
  }
  return out;
}

std::string png_data_uri(std::string_view png_bytes) {
  return "data:image/png;base64," + base64(png_bytes);
}

std::string jpeg_data_uri(const Image8& image) {
  constexpr int kQuality = 90;
  return "data:image/jpeg;base64," + base64(encode_jpeg(image, kQuality));
}

std::string html_warning(const std::string& text) {
  return "<p class=\"warning\">Warning: " + html_escape(text) + "</p>\n";
}

std::string html_figure(const std::string& address, const std::string& caption) {
  const std::string text = html_escape(caption);
  return "<figure><img src=\"" + address + "\" alt=\"" + text + "\"><figcaption>" + text +
         "</figcaption></figure>\n";
}

std::string html_table(const std::vector<std::vector<std::string>>& rows, bool numbers) {
  std::string out =
      std::string("<div class=\"wide\"><table") + (numbers ? " class=\"numbers\"" : "") + ">\n";
  for (std::size_t r = 0; r < rows.size(); ++r) {
    const std::string tag = r == 0 ? "th" : "td";
    out += "<tr>";
    for (const std::string& cell : rows[r])
      out += "<" + tag + ">" + html_escape(cell) + "</" + tag + ">";
    out += "</tr>\n";
  }
  return out + "</table></div>\n";
}

std::string html_page(const std::string& title, const std::string& body) {
  return "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
         "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>" +
         html_escape(title) + "</title>\n<style>" + kStyle + "</style>\n</head>\n<body>\n" + body +
         "</body>\n</html>\n";
}

}  // namespace redrive
