// SPDX-License-Identifier: Apache-2.0
// Poses of a shutter as the kernels take them.
#pragma once

#include <span>
#include <vector>

#include "redrive/math/plain_pose.h"

namespace redrive::kernels {

constexpr int kKeyFloats = 7;

/// Returns [poses, kKeyFloats]: quaternion w x y z of camera_from_world, then the position of the
/// camera. Quaternions of neighbours are on the same half of the sphere.
inline std::vector<float> shutter_keys(std::span<const PlainPose> poses) {
  std::vector<float> keys;
  for (const PlainPose& pose : poses) {
    // The inverse of a rotation is the conjugate of its quaternion x, y, z, w.
    float key[kKeyFloats] = {
        static_cast<float>(pose.quaternion[3]), static_cast<float>(-pose.quaternion[0]),
        static_cast<float>(-pose.quaternion[1]), static_cast<float>(-pose.quaternion[2])};
    if (!keys.empty()) {
      const float* const before = &keys[keys.size() - kKeyFloats];
      float dot = 0;
      for (int k = 0; k < 4; ++k) dot += before[k] * key[k];
      for (int k = 0; dot < 0 && k < 4; ++k) key[k] = -key[k];
    }
    for (int k = 0; k < 3; ++k) key[4 + k] = static_cast<float>(pose.translation[k]);
    keys.insert(keys.end(), key, key + kKeyFloats);
  }
  return keys;
}

}  // namespace redrive::kernels
