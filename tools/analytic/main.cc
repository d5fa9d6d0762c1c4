// SPDX-License-Identifier: Apache-2.0
// make_analytic_recording OUT [--seed N] [--frames N]: how samples/analytic was made.
#include <cstdio>
#include <exception>
#include <string>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>

#include "redrive/base/cpu_features.h"
#include "tools/analytic/recording_writer.h"

int main(int argc, char** argv) {
  CLI::App app("Ray-casts an analytic courtyard into a recording in the aiMotive layout",
               "make_analytic_recording");
  std::string out;
  redrive::analytic::DriveOptions options;
  app.add_option("OUT", out, "folder to make")->required();
  app.add_option("--seed", options.seed, "places and colours of crates and balls")
      ->capture_default_str();
  app.add_option("--frames", options.frames, "at 15 Hz")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    redrive::ThreadPool pool(redrive::hardware_threads());
    redrive::analytic::write_recording(out, options, pool);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "make_analytic_recording: %s\n", error.what());
    return 1;
  }
  return 0;
}
