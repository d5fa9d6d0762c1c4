// SPDX-License-Identifier: Apache-2.0
// NCore's and NuRec's terms for cameras and objects.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "redrive/camera/camera.h"

namespace redrive::ncore {

/// Whether NCore has exactly this camera.
bool has_model(const CameraCalibration& camera);

/// Returns {"type": .., "parameters": {..}} as NCore has them: rows are exposed one after the
/// other, and the principal point counts from the corner of the first pixel, f-theta's from its
/// centre. Models that it does not have keep redrive's name and "parameters" beyond fx, fy, cx and
/// cy.
nlohmann::ordered_json camera_model(const CameraCalibration& camera, const Camera& lens);

/// Returns NuRec's word for a type of object: "automobile", "person", ...
std::string class_of(const std::string& type);
/// Returns class_of(type) for people and vehicles of four wheels, and keeps the words of other
/// types, such as cones and bicycles.
std::string class_of_box(const std::string& type);

}  // namespace redrive::ncore
