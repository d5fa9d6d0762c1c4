// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/rig_images.h"

#include <opencv2/imgproc.hpp>

#include "redrive/scene/masks.h"

namespace redrive {
namespace {

constexpr int kWidest = 800;

cv::Mat root_of_brightness(const Image8& image, int factor) {
  cv::Mat root(image.height, image.width, CV_32F), small;
  for (std::size_t i = 0; i < root.total(); ++i)
    root.ptr<float>()[i] = std::sqrt(255.0f / 3 * (image.rgb[3 * i] + image.rgb[3 * i + 1] + image.rgb[3 * i + 2]));
  const cv::Size size(image.width / factor, image.height / factor);
  cv::resize(root(cv::Rect({0, 0}, size * factor)), small, size, 0, 0, cv::INTER_AREA);
  small.convertTo(small, CV_8U);
  return small;
}

/// 255 where nothing within margin_px is left out.
cv::Mat with_margin(const std::vector<std::uint8_t>& used, int width, int height, int factor, int margin_px) {
  const cv::Mat given(height, width, CV_8U, const_cast<std::uint8_t*>(used.data()));
  const cv::Size small(width / factor, height / factor);
  cv::Mat usable;
  cv::resize((given != 0)(cv::Rect({0, 0}, small * factor)), usable, small, 0, 0, cv::INTER_AREA);
  const int size = 2 * margin_px + 1;
  cv::erode(usable == 255, usable, cv::getStructuringElement(cv::MORPH_ELLIPSE, {size, size}));
  return usable;
}

}  // namespace

std::vector<PlacedBox> RigImages::moving_at(int camera, int frame) const {
  if (moving.objects() == 0) return {};
  return moving.at(scene.frames[frame].t_ns + scene.rig[camera].time_offset_ns);
}

bool RigImages::may_be_static(int camera, int frame, const Eigen::Vector2d& pixel,
                              const std::vector<PlacedBox>& boxes) const {
  const cv::Mat& mask = usable[camera][frame];
  const auto x = static_cast<int>(std::lround(pixel.x())), y = static_cast<int>(std::lround(pixel.y()));
  if (x < 0 || y < 0 || x >= mask.cols || y >= mask.rows || mask.at<std::uint8_t>(y, x) == 0) return false;
  const auto ray = this->camera(camera).unproject(pixel);
  if (!ray) return false;
  const Rigid3d& pose = world_from_camera[camera][frame];
  return std::ranges::none_of(
      boxes, [&](const PlacedBox& box) { return box.meets(pose.translation(), pose.linear() * *ray); });
}

Eigen::Vector2d RigImages::recorded_pixel(int camera, const Eigen::Vector2d& pixel) const {
  return factor[camera] * (pixel.array() + 0.5) - 0.5;  // the inverse of Camera::downscaled
}

RigImages load_rig_images(const Recording& recording, const std::filesystem::path& mask_folder, int margin_px,
                          ThreadPool& pool) {
  Scene scene = make_scene(recording, {});
  std::vector<Image8> images(scene.views.size());
  pool.run(static_cast<int>(images.size()), [&](int i) { images[i] = load_view(scene, scene.views[i]); });
  const std::vector<Mask> masks = static_masks(scene, images, mask_folder, pool, recording.metric);

  RigImages rig{scene, {}, {}, {}, {}, {}, read_moving_objects(recording, scene)};
  const std::size_t cameras = scene.rig.size(), frames = scene.frames.size();
  rig.grey.assign(cameras, std::vector<cv::Mat>(frames));
  rig.usable = rig.grey;
  rig.world_from_camera.assign(cameras, std::vector<Rigid3d>(frames, Rigid3d::Identity()));
  std::vector<cv::Mat> of_camera;
  for (std::size_t c = 0; c < cameras; ++c) {
    const Camera& recorded = scene.rig[c].recorded;
    rig.factor.push_back((recorded.width + kWidest - 1) / kWidest);
    rig.model.push_back(recorded.downscaled(rig.factor[c]));
    of_camera.push_back(with_margin(masks[c].used, recorded.width, recorded.height, rig.factor[c], margin_px));
  }
  pool.run(static_cast<int>(images.size()), [&](int i) {
    const View& view = scene.views[i];
    Image8& image = images[i];
    const int factor = rig.factor[view.camera];
    rig.grey[view.camera][view.frame] = root_of_brightness(image, factor);
    rig.usable[view.camera][view.frame] =
        image.used.empty()
            ? of_camera[view.camera]
            : of_camera[view.camera] & with_margin(image.used, image.width, image.height, factor, margin_px);
    rig.world_from_camera[view.camera][view.frame] = scene.world_from_camera(view);
    image = {};
  });
  return rig;
}

}  // namespace redrive
