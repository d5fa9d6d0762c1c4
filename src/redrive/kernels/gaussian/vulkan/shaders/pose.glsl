// SPDX-License-Identifier: Apache-2.0
// The pose from which a Gaussian is seen.
#include "formulas.glsl"

PlainCamera camera_of(Params p) {
  return PlainCamera(p.fx, p.fy, p.cx, p.cy, p.numbers_of_lens, p.max_radius2);
}

// The pose at a row, or column, of the image.
Pose pose_at(Params p, uint part, float line) {
  float q[4], centre[3];
  const uint first = part * p.n_keys * 7u;
  for (int k = 0; k < 4; ++k) q[k] = p.pose_keys.v[first + k];
  for (int k = 0; k < 3; ++k) centre[k] = p.pose_keys.v[first + 4 + k];
  const float position = p.row_scale * line + p.row_offset;
  for (uint key = 0u; key + 1u < p.n_keys; ++key) {
    const float share = clamp(position - float(key), 0.0, 1.0);
    const uint from = first + 7u * key;
    for (int k = 0; k < 4; ++k)
      q[k] += share * (p.pose_keys.v[from + 7u + k] - p.pose_keys.v[from + k]);
    for (int k = 0; k < 3; ++k)
      centre[k] += share * (p.pose_keys.v[from + 11u + k] - p.pose_keys.v[from + 4u + k]);
  }
  const float norm = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (int k = 0; k < 4; ++k) q[k] *= norm;
  Pose pose;
  rotation_from_quaternion(q, pose.rotation);
  pose.centre = centre;
  return pose;
}

// Returns whether the Gaussian is seen. A Gaussian's row depends on the pose, which depends on the
// row: three projections. rows: its position.
bool pose_of(Params p, PlainCamera c, uint gaussian, float rows[kGaussianRows], out Pose pose) {
  const uint part = part_of(p, gaussian);
  if ((p.parts.v[2u * part + 1u] & 1u) == 0u) return false;
  float mean[2], line = p.first_line;
  bool visible = true, seen = true;
  const uint iterations = p.n_keys > 1u ? 3u : 1u;
  for (uint k = 0u; k < iterations; ++k) {
    pose = pose_at(p, part, line);
    project_mean(c, pose, rows, mean, visible);
    if (p.bounds_means != 0u)
      seen = seen && visible && mean[0] > p.mean_left && mean[0] < p.mean_right &&
             mean[1] > p.mean_top && mean[1] < p.mean_bottom;
    line = p.by_column != 0u ? mean[0] : mean[1];
  }
  return visible && seen;
}

bool is_seen(uint by, int row) { return (kSeenRows[by] >> row & 1u) != 0u; }
// SeenBy of the camera.
uint seen_by() { return kModel == -1 ? 1u : 0u; }
