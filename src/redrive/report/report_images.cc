// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/report_images.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <span>

#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"
#include "redrive/base/evenly_spaced.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/base/rng.h"
#include "redrive/render/view_pose.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

/// Returns a caption with the scores of a rendering.
std::string scored_caption(kernels::Backend& backend, const std::string& what,
                           const RenderedImage& rendered, const Image8& ground_truth,
                           std::span<const float> depth_m = {}) {
  char text[96], depth[48] = "";
  const Score score = score_image(backend, rendered, ground_truth, depth_m);
  if (!std::isnan(score.depth_error))
    std::snprintf(depth, sizeof depth, ", depth error %.1f %%", 100 * score.depth_error);
  std::snprintf(text, sizeof text, " (PSNR %.1f dB, SSIM %.3f, FLIP %.3f", score.psnr_db,
                score.ssim, score.flip);
  return what + text + depth + ")";
}

/// Returns a view's recorded image in the form in which it is scored: masked, composited over the
/// background.
Image8 scored_image(const Run& run, const View& view) {
  Image8 image = load_view(run.scene, view);
  const Exclusions left_out = read_exclusions(run);
  apply_mask(view_mask(run.scene, view, left_out.masks[view.camera], left_out.moving), &image);
  image.alpha.clear();
  return image;
}

RenderedImage rendered_view(const Run& run, kernels::Backend& backend, const View& view) {
  return render_image(backend, *run.field(), run.scene.rig[view.camera].camera,
                      run.scene.shutter_poses(view), run.scene.exposure(view));
}

/// Returns the view of a camera at a frame in another run; null if there is none.
const View* same_view(const Run& run, const std::string& camera, std::int64_t frame_id) {
  for (const View& view : run.scene.views)
    if (run.scene.rig[view.camera].name == camera && run.scene.frames[view.frame].id == frame_id)
      return &view;
  return nullptr;
}

/// Returns "0.5 m", or "0.5" where the recording has no metric scale.
std::string length_text(const Run& run, double value) {
  char text[32];
  std::snprintf(text, sizeof text, run.recording.metric ? "%g m" : "%g", value);
  return text;
}

}  // namespace

std::string method_text(const Run& run) {
  char text[64];
  std::snprintf(text, sizeof text, "%s, %.1f min", run.field()->method(), run.state.seconds / 60);
  return text;
}

const View& figure_view(const Run& run, int camera) {
  std::vector<const View*> views;
  for (const View& view : run.scene.views)
    if (view.camera == camera && !view.held_out) views.push_back(&view);
  if (views.empty())  // a camera of a single, held-out frame
    for (const View& view : run.scene.views)
      if (view.camera == camera) views.push_back(&view);
  REDRIVE_CHECK(!views.empty());
  return *views[random_bits(random_key(run.state.seed, kStreamFigures, camera), 0) % views.size()];
}

ImageRow camera_image_row(const Run& run, kernels::Backend& backend, int camera,
                          const Run* compared) {
  const RigCamera& rig = run.scene.rig[camera];
  const View& view = figure_view(run, camera);
  const Frame& frame = run.scene.frames[view.frame];
  const Image8 original = scored_image(run, view);
  const RayTable table = make_ray_table(rig.camera, backend.pool());
  const auto render_shifted = [&](ShiftAxes axes, double x_m) {
    std::vector<Rigid3d> keys;  // poses of the image's own shutter
    for (const Rigid3d& world_from_body : run.scene.body_during(view))
      keys.push_back(shifted_camera(run.scene.global_from_world, world_from_body,
                                    rig.body_from_sensor, axes, Eigen::Vector3d(x_m, 0, 0)));
    return render_image(
        backend, *run.field(), table,
        run.scene.with_actors(ShutterPoses(keys, rig.readout_by_column), rig, frame.t_ns),
        run.scene.exposure(view));
  };
  const RenderedImage reproduced = render_shifted(ShiftAxes::kBody, 0);

  ImageRow row;
  row.title = rig.name + ", frame " + std::to_string(frame.id);
  row.images.push_back({rig.name + "_original", "original", original});
  row.images.push_back({rig.name + "_reproduced",
                        scored_caption(backend, "reproduced", reproduced, original),
                        to_image8(reproduced)});
  if (const View* const same = compared ? same_view(*compared, rig.name, frame.id) : nullptr) {
    const RenderedImage other = rendered_view(*compared, backend, *same);
    if (other.width == original.width && other.height == original.height)
      row.images.push_back({rig.name + "_beside",
                            scored_caption(backend, method_text(*compared), other, original),
                            to_image8(other)});
  }
  row.images.push_back(
      {rig.name + "_perturbed",
       "shifted by " + length_text(run, kPerturbation_m) + " along x of the body (forward)",
       to_image8(render_shifted(ShiftAxes::kBody, kPerturbation_m))});
  row.images.push_back(
      {rig.name + "_perturbed_camera_axes",
       "shifted by " + length_text(run, kPerturbation_m) + " along x of the camera (to its right)",
       to_image8(render_shifted(ShiftAxes::kCamera, kPerturbation_m))});
  row.images.push_back({rig.name + "_depth",
                        "depth, " + length_text(run, run.scene.near_m) + " (blue) to " +
                            length_text(run, run.scene.far_m) + " (red), logarithmic",
                        depth_colours(reproduced, run.scene.near_m, run.scene.far_m)});
  return row;
}

ImageRow headline_image_row(const Run& run, kernels::Backend& backend, const View& view,
                            const Run* compared, const View* same) {
  const Image8 recorded = scored_image(run, view);
  const RenderedImage rendered = rendered_view(run, backend, view);
  ImageRow row;
  row.title = run.scene.rig[view.camera].name + ", frame " +
              std::to_string(run.scene.frames[view.frame].id);
  row.images.push_back({"headline_recorded",
                        row.title + (view.held_out ? ", held out" : "") + ": as recorded",
                        recorded});
  row.images.push_back(
      {"headline_rendered",
       scored_caption(backend, compared ? "rendered by this run" : "rendered", rendered, recorded),
       to_image8(rendered)});
  if (!compared || !same) return row;
  const RenderedImage other = rendered_view(*compared, backend, *same);
  if (other.width == recorded.width && other.height == recorded.height)
    row.images.push_back({"headline_beside",
                          scored_caption(backend, method_text(*compared), other, recorded),
                          to_image8(other)});
  return row;
}

ImageRow novel_image_row(const Run& run, kernels::Backend& backend,
                         const NovelGroundTruth& ground_truth, const Coverage& coverage,
                         const Run* compared) {
  REDRIVE_CHECK_OP(ground_truth.size(), >, 0u);
  const GroundTruthView view = ground_truth.load(evenly_spaced(ground_truth.size(), 1)[0]);
  const RenderedImage rendered =
      render_image(backend, *run.field(), view.camera, view.poses, view.exposure);
  const Image8 image = to_image8(rendered);
  const std::vector<std::uint8_t> seen =
      coverage.seen(view.camera, view.world_from_camera, rendered);
  const auto valid = std::count(rendered.valid.begin(), rendered.valid.end(), 1);
  char share[96];
  std::snprintf(share, sizeof share,
                "coverage: %.1f %% seen by a training image; unseen pixels in red",
                100.0 * static_cast<double>(std::count(seen.begin(), seen.end(), 1)) /
                    static_cast<double>(valid));
  const std::string& set = ground_truth.name();
  ImageRow row;
  row.title = set + ": " + view.name;
  row.images.push_back({set + "_truth", "ground truth", view.image});
  row.images.push_back({set + "_render",
                        scored_caption(backend, "rendered", rendered, view.image, view.depth_m),
                        image});
  if (compared)
    for (const NovelGroundTruth& same : novel_ground_truths(*compared)) {
      if (same.name() != set || same.size() != ground_truth.size()) continue;
      const GroundTruthView there = same.load(evenly_spaced(same.size(), 1)[0]);
      const RenderedImage other =
          render_image(backend, *compared->field(), there.camera, there.poses, there.exposure);
      row.images.push_back(
          {set + "_beside",
           scored_caption(backend, method_text(*compared), other, there.image, there.depth_m),
           to_image8(other)});
    }
  row.images.push_back({set + "_difference",
                        "difference, " + std::to_string(kDifferenceGain) + " times",
                        difference(image, view.image)});
  row.images.push_back({set + "_coverage", share, coverage_colours(rendered, seen)});
  return row;
}

namespace {

/// Returns an image in grey, half of each pixel in the colour, 0..256, that `tint(pixel)` has;
/// null: none. Invalid pixels stay black.
template <class Tint>
Image8 tinted(const RenderedImage& image, const Tint& tint) {
  Image8 out = to_image8(image);
  for (std::size_t i = 0; i < image.valid.size(); ++i) {
    if (!image.valid[i]) continue;
    std::uint8_t* const rgb = &out.rgb[3 * i];
    const int grey = (rgb[0] + 2 * rgb[1] + rgb[2]) / 4;
    const std::optional<std::array<int, 3>> colour = tint(i);
    for (int c = 0; c < 3; ++c)
      rgb[c] = static_cast<std::uint8_t>(colour ? ((*colour)[c] + grey) / 2 : grey);
  }
  return out;
}

/// Returns the colour of an object. Neighbouring numbers have colours far apart.
std::array<int, 3> colour_of(int number) {
  constexpr double kGoldenRatio = 0.618033988749895;
  const double hue = 6 * std::fmod(0.08 + kGoldenRatio * (number - 1), 1.0);
  std::array<int, 3> rgb;
  for (int c = 0; c < 3; ++c) {
    const double off = std::abs(std::remainder(hue - 2 * c, 6.0));
    rgb[c] = static_cast<int>(256 * std::clamp(2 - off, 0.0, 1.0));
  }
  return rgb;
}

}  // namespace

Image8 coverage_colours(const RenderedImage& image, const std::vector<std::uint8_t>& seen) {
  REDRIVE_CHECK_OP(image.valid.size(), ==, seen.size());
  return tinted(image, [&](std::size_t i) {
    return seen[i] ? std::nullopt : std::optional(std::array{256, 0, 0});
  });
}

Image8 actor_colours(const RenderedImage& image) {
  return tinted(image, [&](std::size_t i) {
    return image.ids[i] == 0 ? std::nullopt : std::optional(colour_of(image.ids[i]));
  });
}

Image8 depth_colours(const RenderedImage& image, double near_m, double far_m) {
  cv::Mat levels(image.height, image.width, CV_8UC1), colours;
  for (std::size_t i = 0; i < image.depth.size(); ++i) {
    const double depth_m = std::clamp<double>(image.depth[i], near_m, far_m);
    const double unit = std::log(depth_m / near_m) / std::log(far_m / near_m);
    levels.data[i] = static_cast<std::uint8_t>(std::lround(255 * unit));
  }
  cv::applyColorMap(levels, colours, cv::COLORMAP_TURBO);  // BGR
  Image8 out{image.width, image.height, std::vector<std::uint8_t>(3 * image.depth.size())};
  for (std::size_t i = 0; i < image.depth.size(); ++i)
    for (int c = 0; c < 3; ++c)
      out.rgb[3 * i + c] = image.valid[i] ? colours.data[3 * i + 2 - c] : 40;
  return out;
}

Image8 difference(const Image8& a, const Image8& b) {
  REDRIVE_CHECK_OP(a.rgb.size(), ==, b.rgb.size());
  Image8 out{a.width, a.height, std::vector<std::uint8_t>(a.rgb.size())};
  for (std::size_t i = 0; i < a.rgb.size(); ++i)
    out.rgb[i] =
        static_cast<std::uint8_t>(std::min(255, kDifferenceGain * std::abs(a.rgb[i] - b.rgb[i])));
  return out;
}

}  // namespace redrive
