// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/rig/rig_images.h"
#include "redrive/base/progress.h"

#include <opencv2/imgproc.hpp>

#include "redrive/base/opencv_threads.h"
#include "redrive/perception/feature_flow.h"
#include "redrive/perception/masks.h"
#include "redrive/scene/load_views.h"

namespace redrive {
namespace {

cv::Mat root_of_brightness(const Image8& image) {
  std::array<std::uint8_t, 766> root;
  for (int sum = 0; sum < 766; ++sum)
    root[sum] = static_cast<std::uint8_t>(std::lround(std::sqrt(255.0 * sum / 3)));
  cv::Mat grey(image.height, image.width, CV_8U);
  for (std::size_t i = 0; i < grey.total(); ++i)
    grey.data[i] = root[image.rgb[3 * i] + image.rgb[3 * i + 1] + image.rgb[3 * i + 2]];
  return grey;
}

/// 255 where no pixel within margin_px is masked.
cv::Mat with_margin(const cv::Mat& used, int margin_px) {
  cv::Mat usable;
  const int size = 2 * margin_px + 1;
  cv::erode(used != 0, usable, cv::getStructuringElement(cv::MORPH_ELLIPSE, {size, size}));
  return usable;
}
cv::Mat with_margin(const std::vector<std::uint8_t>& used, const Camera& camera, int margin_px) {
  return with_margin(
      cv::Mat(camera.height, camera.width, CV_8U, const_cast<std::uint8_t*>(used.data())),
      margin_px);
}

}  // namespace

std::vector<MovingBox> RigImages::moving_at(int camera, int frame) const {
  if (moving.objects().empty()) return {};
  return moving.at(scene.frames[frame].t_ns + scene.rig[camera].time_offset_ns);
}

bool RigImages::may_be_static(int camera, int frame, const Eigen::Vector2d& pixel,
                              const std::vector<MovingBox>& boxes) const {
  const cv::Mat& mask = usable[camera][frame];
  const auto x = static_cast<int>(std::lround(pixel.x())),
             y = static_cast<int>(std::lround(pixel.y()));
  if (x < 0 || y < 0 || x >= mask.cols || y >= mask.rows || mask.at<std::uint8_t>(y, x) == 0)
    return false;
  const auto ray = this->camera(camera).unproject(pixel);
  if (!ray) return false;
  const Rigid3d& pose = world_from_camera[camera][frame];
  return std::ranges::none_of(boxes, [&](const MovingBox& box) {
    return box.intersects(pose.translation(), pose.linear() * *ray);
  });
}

RigImages load_rig_images(const Recording& recording, const std::filesystem::path& mask_folder,
                          int margin_px, ThreadPool& pool) {
  Scene scene = make_scene(recording, {});
  std::vector<Image8> images(scene.views.size());
  DamagedViews damaged;
  const ViewLoader load(scene, pool, &damaged);
  {
    Progress progress("decoding images", std::ssize(images));
    pool.run(static_cast<int>(images.size()), [&](int i) {
      images[i] = load(scene.views[i]);
      progress.count();
    });
  }
  const std::vector<Mask> masks = static_masks(scene, images, mask_folder, pool, recording.metric);

  RigImages rig{scene,
                {},
                {},
                {},
                {},
                {},
                read_moving_objects(recording, scene),
                damaged.judge(recording, scene)};
  const std::size_t cameras = scene.rig.size(), frames = scene.frames.size();
  rig.grey.assign(cameras, std::vector<cv::Mat>(frames));
  rig.usable = rig.grey;
  rig.world_from_camera.assign(cameras, std::vector<Rigid3d>(frames, Rigid3d::Identity()));
  std::vector<cv::Mat> of_camera;
  rig.factor.assign(cameras, 1);
  for (std::size_t c = 0; c < cameras; ++c) {
    rig.model.push_back(scene.rig[c].recorded);
    of_camera.push_back(with_margin(masks[c].used, rig.model[c], margin_px));
  }
  pool.run(static_cast<int>(images.size()), [&](int i) {
    const View& view = scene.views[i];
    Image8& image = images[i];
    if (damaged.contains(view)) return;
    rig.grey[view.camera][view.frame] = root_of_brightness(image);
    cv::Mat& usable = rig.usable[view.camera][view.frame] = of_camera[view.camera];
    if (!image.used.empty())
      usable = usable & with_margin(image.used, rig.model[view.camera], margin_px);
    rig.world_from_camera[view.camera][view.frame] = scene.world_from_camera(view);
    image = {};
  });
  return rig;
}

RigImages downscaled_to_width(const RigImages& full, int max_width, int margin_px,
                              ThreadPool& pool) {
  RigImages rig = full;  // matrices are shared until they are replaced
  pool.run(rig.cameras(), [&](int c) {
    const int factor = (full.model[c].width + max_width - 1) / max_width;
    if (factor == 1) return;
    rig.factor[c] = factor * full.factor[c];
    rig.model[c] = full.model[c].downscaled(factor);
    for (int f = 0; f < rig.frames(); ++f)
      if (!full.grey[c][f].empty()) {
        rig.grey[c][f] = averaged(full.grey[c][f], factor);
        // Usable pixels already are margin_px full-size pixels from masked ones: adds the remaining
        // distance.
        rig.usable[c][f] =
            with_margin(averaged(full.usable[c][f], factor) == 255, margin_px - margin_px / factor);
      }
  });
  return rig;
}

}  // namespace redrive
