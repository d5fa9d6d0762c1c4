// SPDX-License-Identifier: Apache-2.0
// Moving objects as a file, RUN/masks/moving.json:
//   {"objects": [{"id": -1, "size_m": [length, width, height],
//                 "keys": [{"t_ns": .., "position_m": [x, y, z], "yaw_deg": ..}, ..]}, ..]}
// Positions of box centres in the run's world, times of the recording's clock that increase.
#pragma once

#include <filesystem>
#include <string_view>
#include <vector>

#include "redrive/scene/moving_object.h"

namespace redrive {

/// MovingObject::type of objects that nobody annotated (perception/find_moving.h).
inline constexpr const char* kFound = "FOUND";

/// Sets the velocity of each key from the neighbouring positions.
void set_velocities(MovingObject* object);

/// InputError naming a field that is missing, of another type or out of range, or a repeated id.
std::vector<MovingObject> parse_moving_objects(std::string_view text,
                                               const std::filesystem::path& file);
/// Returns FOLDER/moving.json, for a folder of masks.
std::filesystem::path moving_file(const std::filesystem::path& masks);
/// Returns none where the file does not exist.
std::vector<MovingObject> read_moving_file(const std::filesystem::path& file);
/// Returns objects as read_moving_file would after write_moving_file. Doing so again changes
/// nothing.
std::vector<MovingObject> as_in_moving_file(const std::vector<MovingObject>& objects);
/// Keeps only the yaw of rotations, to 1e-9 degrees.
void write_moving_file(const std::filesystem::path& file, const std::vector<MovingObject>& objects);

}  // namespace redrive
