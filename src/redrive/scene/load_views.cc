// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/load_views.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/base/progress.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/scene/resample.h"

namespace redrive {
namespace {

/// Shares the image's memory.
cv::Mat as_mat(Image8& image) { return {image.height, image.width, CV_8UC3, image.rgb.data()}; }

/// A plane of the image's size; shares the memory of `values`.
cv::Mat plane(const Image8& image, std::vector<std::uint8_t>& values) {
  return {image.height, image.width, CV_8UC1, values.data()};
}

Image8 from_mat(const cv::Mat& rgb) {
  Image8 image{rgb.cols, rgb.rows, std::vector<std::uint8_t>(3 * rgb.total())};
  rgb.copyTo(as_mat(image));
  return image;
}

void check_recorded_size(const std::filesystem::path& path, int width, int height,
                         const RigCamera& rig) {
  if (width != rig.recorded.width || height != rig.recorded.height)
    throw InputError(path, "size", size_text(width, height),
                     "the calibration of " + rig.name + " has " +
                         size_text(rig.recorded.width, rig.recorded.height));
}

ResampleMap make_undistort_map(const RigCamera& rig) {
  return make_resample_map(rig.recorded.undistorted(), rig.recorded);
}

/// Sets `used` of the image from its mask file.
void load_mask(const MaskFile& mask, Image8* image) {
  if (mask.path.empty()) return;
  const Image8 mask_image = read_image(mask.path);
  if (mask_image.width != image->width || mask_image.height != image->height)
    throw InputError(mask.path, "size", size_text(mask_image.width, mask_image.height),
                     "the image that it masks has " + size_text(image->width, image->height));
  image->used.resize(std::size_t(image->width) * image->height);
  for (std::size_t i = 0; i < image->used.size(); ++i) {
    const std::uint8_t* rgb = &mask_image.rgb[3 * i];
    const bool black = rgb[0] == 0 && rgb[1] == 0 && rgb[2] == 0;
    image->used[i] = black == mask.black_is_masked ? 0 : 255;
  }
}

/// Composites the image over the background; keeps alpha.
void composite(const std::filesystem::path& path, Background background, Image8* image) {
  if (background == Background::kNone) {
    if (std::any_of(image->alpha.begin(), image->alpha.end(),
                    [](std::uint8_t alpha) { return alpha != 255; }))
      throw UsageError(
          "--background", "",
          "must be white, black or random: " + path.string() + " has transparent pixels");
    image->alpha.clear();
    return;
  }
  if (image->alpha.empty())
    throw UsageError("--background", "",
                     "is for images with alpha, and " + path.string() + " has none");
  const auto behind = static_cast<int>(255 * background_colour(background)[0]);
  for (std::size_t i = 0; i < image->rgb.size(); ++i) {
    const int alpha = image->alpha[i / 3];
    image->rgb[i] =
        static_cast<std::uint8_t>((alpha * image->rgb[i] + (255 - alpha) * behind + 127) / 255);
  }
}

/// `map`: null unless the scene undistorts.
Image8 load_with_map(const Scene& scene, const View& view, const ResampleMap* map) {
  const RigCamera& rig = scene.rig[view.camera];
  Image8 image = read_image(view.image);
  check_recorded_size(view.image, image.width, image.height, rig);
  composite(view.image, scene.background, &image);
  load_mask(view.mask, &image);
  if (!map && scene.downscale == 1) return image;

  const int width = rig.camera.width, height = rig.camera.height, factor = scene.downscale;
  const auto undistort = [&](std::vector<std::uint8_t>* values, int channels, std::uint8_t border) {
    if (map && !values->empty())
      *values = resample(*map, *values, image.width, image.height, channels, border);
  };
  undistort(&image.rgb, 3, 0);
  undistort(&image.alpha, 1, 0);
  undistort(&image.used, 1, 255);
  const auto reduced = [&](const cv::Mat& full) {
    cv::Mat mat = full;
    if (factor > 1) {
      cv::Mat small;
      cv::resize(mat(cv::Rect(0, 0, width * factor, height * factor)), small, {width, height}, 0, 0,
                 cv::INTER_AREA);
      mat = small;
    }
    return mat;
  };
  const auto reduced_plane = [&](std::vector<std::uint8_t>& values) {
    const cv::Mat mat = reduced(plane(image, values));
    return std::vector<std::uint8_t>(mat.begin<std::uint8_t>(), mat.end<std::uint8_t>());
  };
  Image8 result = from_mat(reduced(as_mat(image)));
  if (!image.alpha.empty()) result.alpha = reduced_plane(image.alpha);
  if (!image.used.empty()) {
    result.used = reduced_plane(image.used);
    for (std::uint8_t& used : result.used) used = used == 255 ? 255 : 0;
  }
  return result;
}

}  // namespace

Image8 load_view(const Scene& scene, const View& view) {
  if (!scene.undistort) return load_with_map(scene, view, nullptr);
  const ResampleMap map = make_undistort_map(scene.rig[view.camera]);
  return load_with_map(scene, view, &map);
}

std::vector<float> load_depth(const std::filesystem::path& path, const RigCamera& rig) {
  constexpr std::uint16_t kUnknown = 0, kBeyond = 65535;
  const Image16 depth_mm = read_png16(path);
  check_recorded_size(path, depth_mm.width, depth_mm.height, rig);
  const Camera& camera = rig.camera;
  std::vector<float> depth_m(static_cast<std::size_t>(camera.width) * camera.height, 0.0f);
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const auto direction = camera.unproject({x, y});
      const auto recorded = direction ? rig.recorded.project(*direction) : std::nullopt;
      if (!recorded) continue;
      const long u = std::lround(recorded->x()), v = std::lround(recorded->y());
      if (u < 0 || v < 0 || u >= depth_mm.width || v >= depth_mm.height) continue;
      const std::uint16_t value = depth_mm.values[static_cast<std::size_t>(v) * depth_mm.width + u];
      if (value != kUnknown && value != kBeyond)
        depth_m[static_cast<std::size_t>(y) * camera.width + x] = 0.001f * value;
    }
  return depth_m;
}

void DamagedViews::add(const View& view, const std::string& why) {
  const std::lock_guard lock(mutex_);
  why_[{view.camera, view.frame}] = why;
}

bool DamagedViews::contains(const View& view) const {
  const std::lock_guard lock(mutex_);
  return why_.contains({view.camera, view.frame});
}

std::vector<Finding> DamagedViews::judge(const Recording& recording, const Scene& scene) const {
  const std::lock_guard lock(mutex_);
  // Photographs are judged together, since each may have its own camera.
  const auto group_of = [&](int camera) {
    return recording.metric ? scene.rig[camera].name : std::string("images");
  };
  std::map<std::string, std::vector<DamagedRecord>> groups;
  for (const auto& [view, why] : why_)
    groups[group_of(view.first)].push_back(
        {group_of(view.first), scene.frames[view.second].id, why});
  std::vector<Finding> findings;
  for (const auto& [name, records] : groups) {
    const auto of_group = std::ranges::count_if(
        scene.views, [&, &name = name](const View& view) { return group_of(view.camera) == name; });
    findings.push_back(*judge_damaged(recording, records, static_cast<std::size_t>(of_group)));
  }
  return findings;
}

ViewLoader::ViewLoader(const Scene& scene, ThreadPool& pool, DamagedViews* damaged)
    : damaged_(damaged), maps_(scene.undistort ? scene.rig.size() : 0) {
  scene_.rig = scene.rig;
  scene_.downscale = scene.downscale;
  scene_.undistort = scene.undistort;
  scene_.background = scene.background;
  pool.run(static_cast<int>(maps_.size()),
           [&](int camera) { maps_[camera] = make_undistort_map(scene.rig[camera]); });
}

Image8 ViewLoader::operator()(const View& view) const {
  const ResampleMap* const map = maps_.empty() ? nullptr : &maps_[view.camera];
  if (!damaged_) return load_with_map(scene_, view, map);
  try {
    return load_with_map(scene_, view, map);
  } catch (const InputError& error) {
    if (damaged_->is_closed() && !damaged_->contains(view)) throw;
    damaged_->add(view, error.what());
  }
  const Camera& camera = scene_.rig[view.camera].camera;
  const std::size_t pixels = static_cast<std::size_t>(camera.width) * camera.height;
  Image8 image{camera.width, camera.height, std::vector<std::uint8_t>(3 * pixels)};
  if (scene_.background != Background::kNone) image.alpha.resize(pixels);
  image.used.resize(pixels);
  return image;
}

std::vector<Image8> load_views(const Scene& scene, ThreadPool& pool, DamagedViews* damaged) {
  const ViewLoader load(scene, pool, damaged);
  std::vector<Image8> images(scene.views.size());
  Progress progress("decoding images", std::ssize(images));
  pool.run(static_cast<int>(images.size()), [&](int i) {
    const View& view = scene.views[i];
    Image8 image = load(view);
    if (!view.held_out) images[i] = std::move(image);
    progress.count();
  });
  return images;
}

}  // namespace redrive
