// SPDX-License-Identifier: Apache-2.0
// REDRIVE_PAGE is the folder of the compressed files (cmake/view_page.cmake).
#include "redrive/view/page.h"

#include <array>
#include <string_view>

#define EMBED(symbol, file)                                                               \
  asm(".section .rodata\n.global redrive_page_" #symbol "\n.global redrive_page_" #symbol \
      "_end\nredrive_page_" #symbol ":\n.incbin \"" REDRIVE_PAGE "/" file                 \
      "\"\nredrive_page_" #symbol "_end:\n.byte 0\n.previous\n");                         \
  extern "C" const char redrive_page_##symbol[], redrive_page_##symbol##_end[];

EMBED(html, "index.html.gz")
EMBED(script, "viewer.js.gz")
EMBED(style, "viewer.css.gz")
EMBED(scene_html, "scene.html.gz")
EMBED(scene_script, "scene.js.gz")

namespace redrive::view {

std::span<const PageFile> page_files() {
  static const std::array<PageFile, 3> files = {
      PageFile{"", "text/html; charset=utf-8", {redrive_page_html, redrive_page_html_end}},
      PageFile{"viewer.js",
               "text/javascript; charset=utf-8",
               {redrive_page_script, redrive_page_script_end}},
      PageFile{
          "viewer.css", "text/css; charset=utf-8", {redrive_page_style, redrive_page_style_end}}};
  return files[1].gzip_bytes.empty() ? std::span<const PageFile>{} : files;
}

ScenePageFiles scene_page_files() {
  return {{redrive_page_scene_html, redrive_page_scene_html_end},
          {redrive_page_scene_script, redrive_page_scene_script_end}};
}

}  // namespace redrive::view
