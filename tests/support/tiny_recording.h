// SPDX-License-Identifier: Apache-2.0
// A drive of a few small images in the aiMotive layout, for tests. The world is a sphere of smooth
// colours around the car: colour is a function of direction, which a network of width 32 learns in
// a second.
#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include <nlohmann/json.hpp>

namespace redrive::testing {

constexpr int kTinyFrames = 4;
constexpr int kTinyFirstId = 100;
constexpr const char* kTinyFront = "F_MIDLONGRANGECAM_CL";  ///< opencv_pinhole, 48 x 32
constexpr const char* kTinyRear = "B_MIDRANGECAM_C";        ///< opencv_pinhole, 40 x 24
constexpr const char* kTinyLeft = "M_FISHEYE_L";            ///< mei, 44 x 36

/// Frames 100..103; the car drives 0.2 m a frame. `root` must not exist.
void write_tiny_recording(const std::filesystem::path& root);

std::filesystem::path tiny_calibration(const std::filesystem::path& root);
std::filesystem::path tiny_egomotion(const std::filesystem::path& root);
std::filesystem::path tiny_image(const std::filesystem::path& root, const std::string& camera,
                                 int id);

/// Reads a JSON file, changes it, writes it back.
void edit_json(const std::filesystem::path& file,
               const std::function<void(nlohmann::json&)>& change);

}  // namespace redrive::testing
