// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/html.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "redrive/image/jpeg.h"

namespace redrive {
namespace {

// Plots are drawn black on white. The dark page has the colour that their inverted white has:
// 255 (1 - 0.92) = 0x14; turning hues by half a circle leaves each curve its hue.
constexpr char kStyle[] = R"(
:root { color-scheme: light dark; --page: #fff; --ink: #1d2733; --faint: #5f6b7a; --line: #dde3ea;
  --panel: #f3f5f8; --alarm: #8c1d18; --alarm-panel: #fdeceb; --alarm-line: #b3261e; }
@media screen and (prefers-color-scheme: dark) {
  :root { --page: #141414; --ink: #e6e9ee; --faint: #a3adba; --line: #363c44; --panel: #20242a;
    --alarm: #ffb4ab; --alarm-panel: #3a1715; --alarm-line: #e46962; }
  figure.plot img { filter: invert(0.92) hue-rotate(180deg); } }
body { margin: 0 auto; max-width: 1560px; padding: 24px 32px 64px; background: var(--page);
  font: 15px/1.5 system-ui, sans-serif; color: var(--ink); overflow-wrap: anywhere; }
h1 { font-size: 26px; margin: 0 0 4px; }
h2 { font-size: 19px; margin: 36px 0 10px; padding-bottom: 4px;
  border-bottom: 1px solid var(--line); }
h3 { font-size: 15px; margin: 18px 0 8px; }
p { margin: 4px 0; color: var(--faint); }
p.score { display: flex; flex-wrap: wrap; gap: 0 20px; align-items: baseline; font-size: 19px;
  color: var(--ink); }
p.score strong { font-size: 34px; line-height: 1.3; }
p.warning { margin: 10px 0; padding: 8px 12px; color: var(--alarm); background: var(--alarm-panel);
  border-left: 4px solid var(--alarm-line); }
pre { margin: 6px 0 10px; padding: 10px 12px; border-radius: 3px; background: var(--panel);
  font-size: 13px; white-space: pre-wrap; }
pre span { display: inline-block; max-width: 100%; }
a { color: inherit; }
.row { display: grid; gap: 14px; margin: 8px 0;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, var(--least)), 1fr)); }
.small { --least: 220px; }
.large { --least: 380px; }
figure { margin: 0; min-width: 0; }
figure.plot { max-width: 720px; }
figure img { display: block; width: 100%; height: auto; max-height: 85vh; object-fit: contain;
  object-position: left top; border-radius: 3px; }
figcaption { font-size: 13px; color: var(--faint); padding: 3px 0 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; overflow-wrap: normal; }
th, td { text-align: left; padding: 4px 18px 4px 0; border-bottom: 1px solid var(--line);
  vertical-align: top; }
th { color: var(--faint); font-weight: 600; }
table.numbers th:not(:first-child), table.numbers td:not(:first-child) { text-align: right; }
dl { columns: 300px; column-gap: 32px; margin: 8px 0; }
dl div { display: flex; gap: 16px; justify-content: space-between; break-inside: avoid;
  padding: 3px 0; border-bottom: 1px solid var(--line); }
dt { color: var(--faint); white-space: nowrap; }
dd { margin: 0; text-align: right; }
@media screen and (max-width: 720px) {
  body { padding: 16px 16px 48px; }
  .small { --least: 150px; }
  table { overflow-wrap: anywhere; }
  table.many, table.many tbody, table.many td { display: block; }
  table.many tr { display: flex; flex-wrap: wrap; gap: 4px 18px; padding: 6px 0;
    border-bottom: 1px solid var(--line); }
  table.many tr:first-child, table.many td:empty { display: none; }
  table.many td { border: 0; padding: 0; text-align: left !important; }
  table.many td:first-child { flex: 0 0 100%; font-weight: 600; }
  table.many td:not(:first-child)::before { content: attr(data-head); display: block;
    font-size: 12px; color: var(--faint); } }
@media print { body { max-width: none; padding: 0; } figure { break-inside: avoid; } }
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

std::string html_figure(const std::string& address, const std::string& caption, FigureKind kind) {
  const std::string text = html_escape(caption);
  return std::string(kind == FigureKind::kPlot ? "<figure class=\"plot\">" : "<figure>") +
         "<img src=\"" + address + "\" alt=\"" + text + "\"><figcaption>" + text +
         "</figcaption></figure>\n";
}

std::string html_row(const std::string& figures, FigureSize size) {
  std::string out = "<div class=\"row ";
  out += size == FigureSize::kSmall ? "small" : "large";
  return out + "\">\n" + figures + "</div>\n";
}

std::string html_table(const std::vector<std::vector<std::string>>& rows, bool numbers) {
  constexpr std::size_t kFew = 3;  // columns that a phone has room for
  const bool many = !rows.empty() && rows[0].size() > kFew;
  std::string out =
      std::string("<table class=\"") + (numbers ? "numbers" : "") + (many ? " many" : "") + "\">\n";
  for (std::size_t r = 0; r < rows.size(); ++r) {
    const std::string tag = r == 0 ? "th" : "td";
    out += "<tr>";
    for (std::size_t c = 0; c < rows[r].size(); ++c) {
      const bool named = many && r > 0 && c > 0;
      out += "<" + tag + (named ? " data-head=\"" + html_escape(rows[0][c]) + "\">" : ">") +
             html_escape(rows[r][c]) + "</" + tag + ">";
    }
    out += "</tr>\n";
  }
  return out + "</table>\n";
}

std::string html_pairs(const std::vector<std::pair<std::string, std::string>>& pairs) {
  std::string out = "<dl>\n";
  for (const auto& [name, value] : pairs)
    out += "<div><dt>" + html_escape(name) + "</dt><dd>" + html_escape(value) + "</dd></div>\n";
  return out + "</dl>\n";
}

std::string html_command(const std::string& command) {
  // Each word is a block of its own: lines would also break behind the dashes of options.
  std::string words = "<span>" + html_escape(command) + "</span>";
  for (std::size_t at = 0; (at = words.find(' ', at)) != std::string::npos;) {
    constexpr std::string_view kBetween = "</span> <span>";
    words.replace(at, 1, kBetween);
    at += kBetween.size();
  }
  return "<pre><code>" + words + "</code></pre>\n";
}

std::string html_page(const std::string& title, const std::string& body) {
  return "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
         "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>" +
         html_escape(title) + "</title>\n<style>" + kStyle + "</style>\n</head>\n<body>\n" + body +
         "</body>\n</html>\n";
}

}  // namespace redrive
