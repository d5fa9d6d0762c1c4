// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set: REDRIVE_ISA names the namespace. Projection and its adjoint;
// tiles and loss have files of their own.
#include "redrive/kernels/gaussian/cpu/gaussian_kernels.h"

#include "redrive/field/gaussian.h"
#include "redrive/kernels/cpu/simd/lane_math.h"
#include "redrive/kernels/gaussian/cpu/tile_kernels.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

constexpr int kVectors = kGaussianBlock / kLanes;  // vectors in a block
constexpr float kHalfLog2E = 0.72134752f;

using Pose = GaussianPose<LaneMath>;
using Projected = ProjectedGaussian<LaneMath>;

/// Computes the poses at the rows, or columns, on which the means fall.
REDRIVE_INLINE void pose_at(const ShutterKeys& shutter, Vf v, Pose* pose) {
  const Vf zero{}, one = splat(1.0f);
  Vf q[4], position = splat(shutter.row_scale) * v + splat(shutter.row_offset);
  for (int k = 0; k < 4; ++k) q[k] = splat(shutter.keys[k]);
  for (int k = 0; k < 3; ++k) pose->centre[k] = splat(shutter.keys[4 + k]);
  for (int key = 0; key + 1 < shutter.n; ++key) {
    const Vf part = minimum(maximum(position - splat(static_cast<float>(key)), zero), one);
    const float *const from = shutter.keys + 7 * key, *const to = from + 7;
    for (int k = 0; k < 4; ++k) q[k] += part * splat(to[k] - from[k]);
    for (int k = 0; k < 3; ++k) pose->centre[k] += part * splat(to[4 + k] - from[4 + k]);
  }
  const Vf norm = one / square_root(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
  for (int k = 0; k < 4; ++k) q[k] *= norm;
  Vf r[3][3];
  rotation_from_quaternion<LaneMath>(q, r);
  for (int k = 0; k < 9; ++k) pose->rotation[k] = r[k / 3][k % 3];
}

/// Hides lanes whose means lie outside ProjectionJob::means, where the job bounds them.
REDRIVE_INLINE void bound_means(const ProjectionJob& job, Projected* at) {
  if (!job.bounds_means) return;
  const Bounds& in = job.means;
  at->visible &= (at->mean[0] > splat(in.left)) & (at->mean[0] < splat(in.right)) &
                 (at->mean[1] > splat(in.top)) & (at->mean[1] < splat(in.bottom));
}

/// Projects the means. A Gaussian's row, or column, depends on the pose, which depends on the row:
/// three projections, the first from the pose at ShutterKeys::first.
template <class C>
REDRIVE_INLINE void project_means(const ProjectionJob& job, const C& camera, const Vf* rows,
                                  Pose* pose, Projected* out) {
  if (job.shutter.n == 1) {
    for (int k = 0; k < 9; ++k) pose->rotation[k] = splat(job.shutter.rotation[k]);
    for (int k = 0; k < 3; ++k) pose->centre[k] = splat(job.shutter.keys[4 + k]);
    project_mean<LaneMath>(camera, *pose, rows + kPositionRow, out);
    return bound_means(job, out);
  }
  Vf line = splat(job.shutter.first);
  Vi seen = line == line;
  for (int i = 0; i < 3; ++i) {
    pose_at(job.shutter, line, pose);
    project_mean<LaneMath>(camera, *pose, rows + kPositionRow, out);
    if (job.bounds_means) {
      bound_means(job, out);
      seen &= out->visible;
      out->visible = seen;
      if (lane_bits(seen) == 0) return;
    }
    line = job.shutter.by_column ? out->mean[0] : out->mean[1];
  }
}

/// Loads the rows that a camera sees.
template <SeenBy by>
REDRIVE_INLINE void load_rows(const float* block, int vector, Vf* rows) {
  for (int row = 0; row < kDistanceRow; ++row)
    if (is_seen(by, row)) rows[row] = load(block + row * kGaussianBlock + vector * kLanes);
}

template <class C>
REDRIVE_INLINE std::size_t project(const ProjectionJob& job, const C& camera, std::size_t begin,
                                   std::size_t end, RasterRecord* records, std::uint16_t* visible,
                                   std::uint64_t* keys) {
  std::size_t drawn = 0;
  for (std::size_t block = begin; block < end; ++block) {
    unsigned in_block = 0;
    for (int vector = 0; vector < kVectors; ++vector) {
      Vf rows[kDistanceRow];
      const float* const numbers = job.gaussians + block * kBlockSize;
      for (int k = 0; k < 3; ++k)
        rows[kPositionRow + k] =
            load(numbers + (kPositionRow + k) * kGaussianBlock + vector * kLanes);
      Pose pose;
      Projected at;
      project_means(job, camera, rows, &pose, &at);
      if (lane_bits(at.visible) == 0) continue;
      load_rows<kSeenBy<C>>(numbers, vector, rows);
      project_gaussian<LaneMath>(camera, pose, rows, &at);
      const Vf alpha = maximum(at.alpha, splat(1e-9f)), log2_alpha = logarithm_of_two(alpha);
      // alpha falls to kMinAlpha where half the squared Mahalanobis distance is log(alpha / min).
      const Vf reach =
          maximum(splat(2 * 0.69314718f) * (log2_alpha + splat(kLog2InverseMinAlpha)), Vf{});
      const Vf radius_x = square_root(reach * at.variance[0]),
               radius_y = square_root(reach * at.variance[1]);
      // Comparisons are false for values that are not finite.
      const unsigned bits =
          lane_bits(at.visible & (alpha > splat(kMinAlpha)) &
                    (at.mean[0] + radius_x > splat(job.pixels.left)) &
                    (at.mean[0] - radius_x < splat(job.pixels.right)) &
                    (at.mean[1] + radius_y > splat(job.pixels.top)) &
                    (at.mean[1] - radius_y < splat(job.pixels.bottom)) & (at.conic[0] > Vf{}) &
                    (at.conic[2] > Vf{}) & (magnitude_of(at.conic[1]) < splat(1e30f)));
      if (bits == 0) continue;
      in_block |= bits << (vector * kLanes);
      const Vf half = splat(-kHalfLog2E);
      alignas(64) float fields[13][kLanes], slope_y[kLanes], distance[kLanes];
      store(fields[0], at.mean[0]);
      store(fields[1], at.mean[1]);
      store(fields[2], half * at.conic[0]);
      store(fields[3], splat(2.0f) * half * at.conic[1]);
      store(fields[4], half * at.conic[2]);
      store(fields[5], log2_alpha);
      for (int k = 0; k < 3; ++k) store(fields[6 + k], maximum(at.colour[k], Vf{}));
      store(fields[9], at.slope[0]);
      store(fields[10], logarithm_of_two(at.length) * splat(0.69314718f));
      store(fields[11], radius_x);
      store(fields[12], radius_y);
      store(slope_y, at.slope[1]);
      store(distance, at.length);
      for (unsigned left = bits; left != 0; left &= left - 1) {
        const int lane = __builtin_ctz(left);
        const std::size_t id = block * kGaussianBlock + vector * kLanes + lane;
        float* const record = reinterpret_cast<float*>(&records[id]);
        for (int k = 0; k < 13; ++k) record[k] = fields[k][lane];
        std::uint32_t key;
        records[id].slope_y = slope_y[lane];
        std::memcpy(&key, &distance[lane], sizeof key);
        keys[drawn++] = std::uint64_t{key} << 32 | id;
      }
    }
    visible[block] = static_cast<std::uint16_t>(in_block);
  }
  return drawn;
}

std::size_t project(const ProjectionJob& job, std::size_t begin, std::size_t end,
                    RasterRecord* records, std::uint16_t* visible, std::uint64_t* keys) {
  return with_camera(
      job.camera, [&](const auto& camera) __attribute__((always_inline)) {
        return project(job, camera, begin, end, records, visible, keys);
      });
}

void project_points(const ProjectionJob& job, const float* points, std::size_t n, std::size_t begin,
                    std::size_t end, float* pixels) {
  with_camera(
      job.camera, [&](const auto& camera) __attribute__((always_inline)) {
        const Vf unseen = splat(__builtin_nanf(""));
        for (std::size_t i = begin; i < end; i += kLanes) {
          const int count = end - i < kLanes ? static_cast<int>(end - i) : kLanes;
          Vf rows[kPositionRow + 3];
          for (int k = 0; k < 3; ++k)
            rows[kPositionRow + k] = load_first(points + k * n + i, count);
          Pose pose;
          Projected at;
          project_means(job, camera, rows, &pose, &at);
          if (job.shutter.n > 1) {  // once more than a Gaussian
            pose_at(job.shutter, at.mean[job.shutter.by_column ? 0 : 1], &pose);
            project_mean<LaneMath>(camera, pose, rows + kPositionRow, &at);
          }
          for (int k = 0; k < 2; ++k)
            store_first(pixels + k * n + i, at.visible ? at.mean[k] : unseen, count);
        }
      });
}

/// The bits of vectors of optim/packed_moments.h.
REDRIVE_INLINE Vi load_words(const std::uint32_t* p) {
  return reinterpret_cast<Vi>(load(reinterpret_cast<const float*>(p)));
}
REDRIVE_INLINE void store_words(std::uint32_t* p, Vi words) {
  store(reinterpret_cast<float*>(p), reinterpret_cast<Vf>(words));
}
REDRIVE_INLINE Vf unpacked_first(Vi packed) {
  return reinterpret_cast<Vf>(packed & splat_int(-0x10000));
}
REDRIVE_INLINE Vf unpacked_second(Vi packed) {
  return reinterpret_cast<Vf>((packed & splat_int(0xffff)) << 15);
}
REDRIVE_INLINE Vi pack_moments(Vf first, Vf second) {
  return ((reinterpret_cast<Vi>(first) + splat_int(0x8000)) & splat_int(-0x10000)) |
         ((reinterpret_cast<Vi>(second) + splat_int(0x4000)) >> 15);
}

#ifdef __clang__
#define REDRIVE_ONE_COPY __attribute__((noinline))
#else
#define REDRIVE_ONE_COPY __attribute__((noinline, noclone))
#endif

/// Updates the rows of a block that are seen by their gradients. One copy of the code: compilers
/// contract products and sums in each copy as they like, and a step and an update must agree.
REDRIVE_ONE_COPY void update_block(const UpdateJob& job, const float* gradients,
                                   const float* errors, std::size_t block) {
  const Vf beta1 = splat(job.beta1), beta2 = splat(job.beta2), rest1 = splat(1 - job.beta1),
           rest2 = splat(1 - job.beta2), bias1 = splat(job.bias1), bias2 = splat(job.bias2),
           epsilon = splat(job.epsilon);
  for (int vector = 0; vector < kVectors; ++vector) {
    const std::size_t at = block * kBlockSize + static_cast<std::size_t>(vector) * kLanes;
    const float* const g = gradients + vector * kLanes;
    float* const p = job.numbers + at;
    std::uint32_t* const moments = job.moments + at;
    Vi drawn = load(g + kOpacityRow * kGaussianBlock) != Vf{};
    if (lane_bits(drawn) == 0) continue;
    for (int row = 0; row < kDistanceRow; ++row) {
      if (!is_seen(job.rows, row)) continue;
      const Vf gradient = load(g + row * kGaussianBlock);
      drawn &= gradient - gradient == Vf{};  // false for NaN and infinity
    }
    const Vf distance = load(p + kDistanceRow * kGaussianBlock);
    for (int row = 0; row < kDistanceRow; ++row) {
      if (!is_seen(job.rows, row)) continue;
      const std::size_t o = static_cast<std::size_t>(row) * kGaussianBlock;
      const Vi packed = load_words(moments + o);
      const Vf gradient = load(g + o), m = beta1 * unpacked_first(packed) + rest1 * gradient,
               v = beta2 * unpacked_second(packed) + rest2 * gradient * gradient;
      Vf rate = splat(job.rates[row]);
      if (row < kLogScaleRow) rate *= distance;
      const Vf old = load(p + o);
      Vf updated = old - rate * (m * bias1) / (square_root(v * bias2) + epsilon);
      if (block >= job.bounded_colours && row >= kColourRow && row < kHarmonicsRow)
        updated = minimum(maximum(updated, Vf{}), splat(1.0f));
      store_words(moments + o, drawn ? pack_moments(m, v) : packed);
      store(p + o, drawn ? updated : old);
    }
    float* const error = job.errors + block * kGaussianBlock + vector * kLanes;
    store(error, load(error) + (drawn ? load(errors + vector * kLanes) : Vf{}));
    // The two larger axes stay above the least scale, all below the largest.
    Vf s[3];
    for (int k = 0; k < 3; ++k) s[k] = load(p + (kLogScaleRow + k) * kGaussianBlock);
    const Vf log_distance = splat(0.69314718f) * logarithm_of_two(maximum(distance, splat(1e-6f)));
    const Vf least = splat(job.min_log_scale) + log_distance,
             most = splat(job.max_log_scale) + log_distance,
             smallest = minimum(s[0], minimum(s[1], s[2]));
    for (int k = 0; k < 3; ++k) {
      const Vf bounded = minimum(((s[k] > smallest) & (s[k] < least)) ? least : s[k], most);
      store(p + (kLogScaleRow + k) * kGaussianBlock, drawn ? bounded : s[k]);
    }
  }
}

template <class C>
REDRIVE_INLINE void project_backward(const ProjectionBackwardJob& job, const C& camera,
                                     std::size_t begin, std::size_t end) {
  Vf pose_sums[6] = {};
  alignas(64) float of_block[kBlockSize], errors_of_block[kGaussianBlock];
  for (std::size_t block = begin; block < end; ++block) {
    if (job.visible[block] == 0) continue;
    float *gradients = of_block, *errors = errors_of_block;
    if (job.update) {
      for (std::size_t i = 0; i < kBlockSize; i += kLanes) store(of_block + i, Vf{});
      for (int i = 0; i < kGaussianBlock; i += kLanes) store(errors_of_block + i, Vf{});
    } else {
      gradients = job.gradients ? job.gradients + block * kBlockSize : nullptr;
      errors = job.errors + block * kGaussianBlock;
    }
    for (int vector = 0; vector < kVectors; ++vector) {
      const unsigned bits = job.visible[block] >> (vector * kLanes) & ((1u << kLanes) - 1);
      if (bits == 0) continue;
      // Sums over the pairs of each Gaussian, in the order of the pairs, then by sum.
      alignas(64) float of_lane[kLanes][kRecordFloats] = {}, by_sum[kRecordFloats][kLanes];
      for (unsigned left = bits; left != 0; left &= left - 1) {
        const int lane = __builtin_ctz(left);
        const RasterRecord& record = job.records[block * kGaussianBlock + vector * kLanes + lane];
        const float* pair = job.sums + std::size_t{record.first_pair} * kRecordFloats;
        for (std::uint32_t i = 0; i < record.pairs; ++i, pair += kRecordFloats)
          for (int k = 0; k < kRecordFloats; k += kLanes)
            store(of_lane[lane] + k, load(of_lane[lane] + k) + load(pair + k));
      }
      Vf sum[kPairSums];
      for (int k = 0; k < kPairSums; ++k) {
        for (int lane = 0; lane < kLanes; ++lane) by_sum[k][lane] = of_lane[lane][k];
        sum[k] = load(by_sum[k]);
      }
      Vi drawn{};
      for (int lane = 0; lane < kLanes; ++lane) drawn[lane] = bits >> lane & 1 ? -1 : 0;
      float* const error = errors + vector * kLanes;
      store(error, load(error) + (drawn ? sum[kSumError] : Vf{}));
      if (!gradients) continue;

      Vf rows[kDistanceRow];
      load_rows<kSeenBy<C>>(job.gaussians + block * kBlockSize, vector, rows);
      Pose pose;
      Projected at;
      project_means(job, camera, rows, &pose, &at);
      project_gaussian<LaneMath>(camera, pose, rows, &at);
      const ProjectedGradient<LaneMath> gradient = gradient_of_sums<LaneMath>(sum, at);
      Vf d_rows[kDistanceRow];
      GaussianPoseGradient<LaneMath> d_pose;
      project_gaussian_adjoint<LaneMath>(camera, pose, rows, at, gradient, d_rows,
                                         job.d_pose ? &d_pose : nullptr);
      float* const out = gradients + vector * kLanes;
      for (int row = 0; row < kDistanceRow; ++row)
        if (is_seen(kSeenBy<C>, row))
          store(out + row * kGaussianBlock,
                load(out + row * kGaussianBlock) + (drawn ? d_rows[row] : Vf{}));
      if (job.d_pose)
        for (int k = 0; k < 3; ++k) {
          pose_sums[k] += drawn ? d_pose.translation[k] : Vf{};
          pose_sums[3 + k] += drawn ? d_pose.rotation[k] : Vf{};
        }
    }
    if (job.update) update_block(*job.update, gradients, errors, block);
  }
  if (job.d_pose)
    for (int k = 0; k < 6; ++k)
      for (int lane = 0; lane < kLanes; ++lane)
        job.d_pose[k] += static_cast<double>(pose_sums[k][lane]);
}

void project_backward(const ProjectionBackwardJob& job, std::size_t begin, std::size_t end) {
  with_camera(
      job.camera, [&](const auto& camera) __attribute__((always_inline)) {
        project_backward(job, camera, begin, end);
      });
}

void update(const UpdateJob& job, const float* gradients, const float* errors, std::size_t begin,
            std::size_t end) {
  for (std::size_t block = begin; block < end; ++block)
    update_block(job, gradients + block * kBlockSize, errors + block * kGaussianBlock, block);
}

}  // namespace

const GaussianKernels kGaussianKernels = {
    project,    project_points,   bin,    tile_forward, tile_backward,
    tile_parts, project_backward, update, loss_row,     kBlockRows};

}  // namespace redrive::kernels::REDRIVE_ISA
