// SPDX-License-Identifier: Apache-2.0
// make_drive OUT: makes a drive of any length (README.md).
#include <cmath>
#include <cstdio>
#include <exception>
#include <string>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/base/files/output_folder.h"
#include "tools/drive/write_drive.h"

int main(int argc, char** argv) {
  CLI::App app("Ray-casts a drive of any length down a street, in the aiMotive layout",
               "make_drive");
  std::string out;
  redrive::drive::DriveOptions options;
  int threads = 0;
  app.add_option("OUT", out, "folder to make")->required();
  app.add_option("--seed", options.seed, "another street and other errors")->capture_default_str();
  app.add_option("--length", options.length_m, "metres")
      ->check(CLI::Range(3.0, 100'000.0))
      ->capture_default_str();
  app.add_option("--spacing", options.spacing_m, "metres between frames, 0.1 s apart")
      ->check(CLI::Range(0.2, 5.0))
      ->capture_default_str();
  app.add_option("--loop", options.loop_m,
                 "metres, a multiple of 3, after which the road meets itself; 0: never")
      ->check(CLI::Range(0.0, 100'000.0))
      ->capture_default_str();
  app.add_option("--drift", options.drift,
                 "of the egomotion, in its lengths and, as much after 400 m, by its turns")
      ->check(CLI::Range(0.0, 0.1))
      ->capture_default_str();
  app.add_option("--cameras", options.cameras, "2: front pinholes; 4: and fisheyes to both sides")
      ->check(CLI::IsMember({2, 4}))
      ->capture_default_str();
  app.add_option("--size", options.size, "factor on the sides of images, 640 x 352")
      ->check(CLI::Range(0.05, 4.0))
      ->capture_default_str();
  app.add_option("--exposure", options.exposure, "RMS of the images' exposures, stops")
      ->check(CLI::Range(0.0, 3.0))
      ->capture_default_str();
  app.add_option("--lidar-beams", options.lidar_beams, "0: no LiDAR")
      ->check(CLI::Range(0, 128))
      ->capture_default_str();
  app.add_option("--novel-every", options.novel_every,
                 "frames between those with shifted views; 0: none")
      ->check(CLI::Range(0, 1'000'000))
      ->capture_default_str();
  app.add_option("--threads", threads, "0: all")->check(CLI::Range(0, 1024));
  CLI11_PARSE(app, argc, argv);
  try {
    if (options.loop_m > 0 && (options.loop_m < 240 || std::fmod(options.loop_m, 3) != 0))
      throw redrive::UsageError("--loop", std::to_string(options.loop_m),
                                "must be a multiple of 3 and at least 240");
    redrive::check_output_folder("OUT", out, false);
    redrive::ThreadPool pool(threads > 0 ? threads : redrive::hardware_threads());
    redrive::write_output_folder("OUT", out, false, [&](const std::filesystem::path& folder) {
      redrive::drive::write_drive(folder, options, pool);
    });
  } catch (const std::exception& error) {
    std::fprintf(stderr, "make_drive: %s\n", error.what());
    return 1;
  }
  return 0;
}
