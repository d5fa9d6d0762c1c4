// SPDX-License-Identifier: Apache-2.0
// Writes videos: H.264 in an MP4 file, by FFmpeg's libraries. They are loaded when the first video
// is written, so that the program neither needs nor loads them otherwise.
#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "redrive/image/image.h"

namespace redrive {

/// Returns why this program cannot write videos here, naming what is missing; nothing where it can.
std::optional<std::string> video_obstacle();

/// A video that is written image by image under a temporary name in the file's folder.
class VideoWriter {
 public:
  /// width, height: size of the images, at least 2; an odd column or row at the end is left out,
  /// since colours are stored for 2 x 2 pixels. fps: images a second, 1..240, in steps of 0.001.
  /// There must be no video_obstacle(). IoError if the file cannot be created.
  VideoWriter(const std::filesystem::path& file, int width, int height, double fps);
  ~VideoWriter();  ///< removes the temporary file unless finish() has returned
  VideoWriter(const VideoWriter&) = delete;
  VideoWriter& operator=(const VideoWriter&) = delete;

  void add(const Image8& image);  ///< IoError
  /// Completes the file and gives it its name; replaces what has it. IoError.
  void finish();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace redrive
