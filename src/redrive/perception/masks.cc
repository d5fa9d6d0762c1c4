// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/masks.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/base/progress.h"
#include "redrive/image/image_io.h"

#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"
#include "redrive/perception/ego_outline.h"
#include "redrive/scene/point_cloud.h"

namespace redrive {
namespace {

constexpr int kWorkingWidth = 320;  // width of the images for find_ego_outline
constexpr int kRowMargin = 2;       // rows above broken ones are dark, and JPEG blurs
constexpr std::uint8_t kBlack = 8, kBright = 50;

/// Selects training views of a camera; if there are many, pairs of neighbours spread over the
/// drive.
std::vector<std::size_t> choose_views(const Scene& scene, int camera) {
  std::vector<std::size_t> all;
  for (std::size_t i = 0; i < scene.views.size(); ++i)
    if (scene.views[i].camera == camera && !scene.views[i].held_out) all.push_back(i);
  if (all.size() <= kMostMaskViews) return all;
  std::vector<std::size_t> chosen;
  constexpr std::size_t kPairs = kMostMaskViews / 2;
  for (std::size_t p = 0; p < kPairs; ++p)
    for (const std::size_t next : {0, 1})
      chosen.push_back(all[p * (all.size() - 2) / (kPairs - 1) + next]);
  return chosen;
}

/// Brightness of one row in several images.
struct RowStatistics {
  double mean = 0;
  double over_columns = 0;  ///< standard deviation of the pixels' means
  double over_images = 0;   ///< RMS of the pixels' standard deviations
};

RowStatistics row_statistics(const std::vector<const Image8*>& images, int y) {
  const int width = images[0]->width;
  const double n = static_cast<double>(images.size()), count = 3.0 * width;
  const std::size_t row = std::size_t(3) * width * y;
  double sum = 0, squares_of_means = 0, variances = 0;
  for (std::size_t i = row; i < row + std::size_t(3) * width; ++i) {
    double values = 0, squares = 0;
    for (const Image8* image : images) {
      values += image->rgb[i];
      squares += double(image->rgb[i]) * image->rgb[i];
    }
    const double mean = values / n;
    sum += mean;
    squares_of_means += mean * mean;
    variances += std::max(0.0, squares / n - mean * mean);
  }
  const double mean = sum / count;
  return {mean, std::sqrt(std::max(0.0, squares_of_means / count - mean * mean)),
          std::sqrt(variances / count)};
}

/// Returns the number of broken rows at the bottom: bright, uniform, and constant over images that
/// differ elsewhere.
int broken_rows(const std::vector<const Image8*>& images) {
  const int height = images[0]->height;
  double change = 0;
  for (const int y : {height / 4, height / 2, height * 3 / 4})
    change = std::max(change, row_statistics(images, y).over_images);
  int broken = 0;
  for (; broken < height / 4; ++broken) {
    const RowStatistics row = row_statistics(images, height - 1 - broken);
    if (row.mean < kBright || row.over_columns > 12 || row.over_images >= std::min(2.0, change / 2))
      break;
  }
  return broken == 0 ? 0 : std::min(broken + kRowMargin, height);
}

/// Masks the pixels that are black in all images and connected to a corner, plus one pixel, since
/// JPEG blurs.
void mask_black_corners(const std::vector<const Image8*>& images, Mask* mask) {
  cv::Mat black(mask->height, mask->width, CV_8U, cv::Scalar(255));
  for (const Image8* image : images)
    for (std::size_t i = 0; i < black.total(); ++i)
      if (*std::max_element(&image->rgb[3 * i], &image->rgb[3 * i] + 3) > kBlack) black.data[i] = 0;
  for (const int y : {0, mask->height - 1})
    for (const int x : {0, mask->width - 1})
      if (black.at<std::uint8_t>(y, x) == 255) cv::floodFill(black, {x, y}, 1);
  cv::Mat outside = black == 1;
  cv::dilate(outside, outside, cv::Mat::ones(3, 3, CV_8U));
  for (std::size_t i = 0; i < outside.total(); ++i)
    if (outside.data[i]) mask->used[i] = 0;
}

/// Returns the first `rows` rows in grey, averaged to `size`.
cv::Mat grey_of(const Image8& image, int rows, cv::Size size) {
  const cv::Mat rgb(rows, image.width, CV_8UC3, const_cast<std::uint8_t*>(image.rgb.data()));
  cv::Mat grey, small;
  cv::transform(rgb, grey, cv::Matx13f(1 / 3.0f, 1 / 3.0f, 1 / 3.0f));
  grey.convertTo(grey, CV_32F);
  cv::resize(grey, small, size, 0, 0, cv::INTER_AREA);
  return small;
}

/// Masks the ego vehicle below find_ego_outline, and one pixel of its working size above it.
void mask_ego_vehicle(const Scene& scene, int camera, const std::vector<std::size_t>& views,
                      const std::vector<Image8>& images, int rows, Mask* mask) {
  const RigCamera& rig = scene.rig[camera];
  const int width = std::min(mask->width, kWorkingWidth);
  const cv::Size size(
      width, std::max(1, static_cast<int>(std::lround(double(rows) * width / mask->width))));
  const double x_scale = double(width) / mask->width, y_scale = double(size.height) / rows;
  Camera small = rig.camera;  // as Camera::downscaled
  small.fx *= x_scale;
  small.fy *= y_scale;
  small.cx = (small.cx + 0.5) * x_scale - 0.5;
  small.cy = (small.cy + 0.5) * y_scale - 0.5;
  small.width = size.width;
  small.height = size.height;
  std::vector<GreyView> grey;
  for (const std::size_t i : views) {
    const View& view = scene.views[i];
    grey.push_back({grey_of(images[i], rows, size), scene.world_from_body(view),
                    scene.frames[view.frame].t_ns + rig.time_offset_ns});
  }
  const std::vector<int> outline = find_ego_outline(small, rig.body_from_sensor, grey);
  for (int x = 0; x < mask->width; ++x) {
    const int first = outline[static_cast<std::size_t>((x + 0.5) * x_scale)];
    if (first == small.height) continue;
    for (int y = std::max(0, static_cast<int>((first - 1) / y_scale)); y < mask->height; ++y)
      mask->used[std::size_t(y) * mask->width + x] = 0;
  }
}

/// Returns the directions of all pixels in camera axes, [height, width], zero where there is no
/// ray.
std::vector<Eigen::Vector3f> directions_of(const Camera& camera) {
  std::vector<Eigen::Vector3f> directions(std::size_t(camera.width) * camera.height,
                                          Eigen::Vector3f::Zero());
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x)
      if (const auto direction = camera.unproject({x, y}))
        directions[std::size_t(y) * camera.width + x] = direction->cast<float>();
  return directions;
}

/// Masks the pixels whose rays intersect the box. Most are rejected by their angle to its centre.
void mask_box(const MovingBox& box, const Rigid3d& world_from_camera,
              const std::vector<Eigen::Vector3f>& directions, Mask* mask) {
  const Eigen::Vector3d centre =
      world_from_camera.inverse() * box.box_from_world.inverse().translation();
  const double distance_m = centre.norm(), radius_m = box.half_size_m.norm();
  // cos of the angular radius of the box's bounding sphere; from inside it, all directions.
  const double least_cos =
      distance_m > radius_m ? std::sqrt(1 - radius_m * radius_m / (distance_m * distance_m)) - 1e-6
                            : -2;
  const Eigen::Vector3f towards = distance_m > 0
                                      ? Eigen::Vector3f((centre / distance_m).cast<float>())
                                      : Eigen::Vector3f::UnitZ();
  for (std::size_t i = 0; i < directions.size(); ++i) {
    if (mask->used[i] == 0 || directions[i].isZero() || directions[i].dot(towards) < least_cos)
      continue;
    if (box.intersects(world_from_camera.translation(),
                       world_from_camera.linear() * directions[i].cast<double>()))
      mask->used[i] = 0;
  }
}

Mask without_moving_objects(const Scene& scene, const View& view, const Mask& of_camera,
                            const MovingObjects& moving,
                            const std::vector<Eigen::Vector3f>& directions) {
  Mask mask = of_camera;
  for (const MovingBox& box :
       moving.at(scene.frames[view.frame].t_ns + scene.rig[view.camera].time_offset_ns))
    mask_box(box, scene.world_from_camera(view), directions, &mask);
  return mask;
}

/// As object_map; `directions` returns the directions of the camera's pixels.
template <class Directions>
std::vector<std::uint32_t> object_map_of(const Scene& scene, const View& view,
                                         const MovingObjects& moving, Directions&& directions) {
  const RigCamera& rig = scene.rig[view.camera];
  const Rigid3d world_from_camera = scene.world_from_camera(view);
  std::vector<std::uint32_t> map(static_cast<std::size_t>(rig.camera.width) * rig.camera.height);
  std::vector<MovingBox> boxes = moving.at(scene.frames[view.frame].t_ns + rig.time_offset_ns);
  if (boxes.empty()) return map;
  const std::vector<Eigen::Vector3f>& of_pixels = directions();
  std::ranges::sort(boxes, std::greater<>(), [&](const MovingBox& box) {
    return (box.box_from_world * world_from_camera.translation()).norm();
  });
  for (const MovingBox& box : boxes) {  // nearer ones over farther ones
    Mask mask = full_mask(rig.camera.width, rig.camera.height);
    mask_box(box, world_from_camera, of_pixels, &mask);
    const auto object = std::ranges::find(moving.objects(), box.id, &MovingObject::id);
    for (std::size_t i = 0; i < map.size(); ++i)
      if (!mask.used[i]) map[i] = static_cast<std::uint32_t>(object - moving.objects().begin()) + 1;
  }
  return map;
}

}  // namespace

std::size_t Mask::left_out() const {
  return static_cast<std::size_t>(std::count(used.begin(), used.end(), 0));
}

Mask full_mask(int width, int height) {
  return {width, height, std::vector<std::uint8_t>(std::size_t(width) * height, 1)};
}

Mask read_mask(const std::filesystem::path& file, const RigCamera& camera, int downscale) {
  const Image8 image = read_image(file);
  if (image.width != camera.recorded.width || image.height != camera.recorded.height)
    throw InputError(
        file, "size", std::to_string(image.width) + " x " + std::to_string(image.height),
        "must be that of the images of " + camera.name + ", " +
            std::to_string(camera.recorded.width) + " x " + std::to_string(camera.recorded.height));
  Mask mask = full_mask(camera.camera.width, camera.camera.height);
  for (int y = 0; y < mask.height * downscale; ++y)
    for (int x = 0; x < mask.width * downscale; ++x)
      if (image.rgb[3 * (std::size_t(y) * image.width + x) + 1] < 128)
        mask.used[std::size_t(y / downscale) * mask.width + x / downscale] = 0;
  return mask;
}

void write_mask(const std::filesystem::path& file, const Mask& mask, const RigCamera& camera,
                int downscale) {
  Image8 image{camera.recorded.width, camera.recorded.height, {}};
  image.rgb.reserve(std::size_t(3) * image.width * image.height);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width;
         ++x) {  // rows and columns cut off by downscaling repeat their neighbours
      const int row = std::min(y / downscale, mask.height - 1),
                column = std::min(x / downscale, mask.width - 1);
      image.rgb.insert(image.rgb.end(), 3,
                       mask.used[std::size_t(row) * mask.width + column] ? 255 : 0);
    }
  write_image(file, image);
}

Mask find_static_mask(const Scene& scene, int camera, const std::vector<Image8>& images,
                      bool on_car) {
  REDRIVE_CHECK_OP(images.size(), ==, scene.views.size());
  const RigCamera& rig = scene.rig[camera];
  Mask mask = full_mask(rig.camera.width, rig.camera.height);
  std::vector<std::size_t> views = choose_views(scene, camera);
  std::erase_if(views, [&](std::size_t i) {  // damaged or fully masked views
    const std::vector<std::uint8_t>& used = images[i].used;
    return !used.empty() && std::ranges::count(used, 0) == std::ssize(used);
  });
  if (views.size() < 2) return mask;  // too few to find constant pixels
  std::vector<const Image8*> training_images;
  for (const std::size_t i : views) training_images.push_back(&images[i]);

  const int rows = mask.height - (on_car ? broken_rows(training_images) : 0);
  std::fill(mask.used.begin() + static_cast<std::ptrdiff_t>(rows) * mask.width, mask.used.end(), 0);
  if (rig.camera.info().image_circle) mask_black_corners(training_images, &mask);
  if (on_car) mask_ego_vehicle(scene, camera, views, images, rows, &mask);
  return mask;
}

std::vector<Mask> static_masks(const Scene& scene, const std::vector<Image8>& images,
                               const std::filesystem::path& folder, ThreadPool& pool, bool on_car) {
  std::vector<Mask> masks(scene.rig.size());
  Progress progress("finding masks", std::ssize(masks));
  pool.run(static_cast<int>(masks.size()), [&](int c) {
    const RigCamera& rig = scene.rig[c];
    const std::filesystem::path file = mask_file(folder, rig);
    const bool has_file = !folder.empty() && std::filesystem::exists(file);
    masks[c] = has_file ? read_mask(file, rig, scene.downscale)
                        : find_static_mask(scene, c, images, on_car);
    progress.count();
  });
  return masks;
}

std::vector<Mask> static_masks(const Scene& scene, const ViewLoader& load,
                               const std::filesystem::path& folder, ThreadPool& pool, bool on_car) {
  std::vector<Mask> masks;
  Progress progress("finding masks", std::ssize(scene.rig));
  for (int c = 0; c < static_cast<int>(scene.rig.size()); ++c, progress.count()) {
    const RigCamera& rig = scene.rig[c];
    const std::filesystem::path file = mask_file(folder, rig);
    if (!folder.empty() && std::filesystem::exists(file)) {
      masks.push_back(read_mask(file, rig, scene.downscale));
      continue;
    }
    const std::vector<std::size_t> chosen = choose_views(scene, c);
    std::vector<Image8> images(scene.views.size());
    pool.run(static_cast<int>(chosen.size()),
             [&](int i) { images[chosen[i]] = load(scene.views[chosen[i]]); });
    masks.push_back(find_static_mask(scene, c, images, on_car));
  }
  return masks;
}

std::filesystem::path mask_file(const std::filesystem::path& folder, const RigCamera& camera) {
  return folder / (camera.name + ".png");
}

void write_masks(const std::filesystem::path& folder, const std::vector<Mask>& masks,
                 const Scene& scene) {
  REDRIVE_CHECK_OP(masks.size(), ==, scene.rig.size());
  for (std::size_t c = 0; c < masks.size(); ++c)
    if (masks[c].left_out() > 0)
      write_mask(mask_file(folder, scene.rig[c]), masks[c], scene.rig[c], scene.downscale);
}

std::vector<Mask> read_masks(const std::filesystem::path& folder, const Scene& scene) {
  std::vector<Mask> masks;
  for (const RigCamera& rig : scene.rig) {
    const std::filesystem::path file = mask_file(folder, rig);
    masks.push_back(std::filesystem::exists(file) ? read_mask(file, rig, scene.downscale)
                                                  : full_mask(rig.camera.width, rig.camera.height));
  }
  return masks;
}

Mask view_mask(const Scene& scene, const View& view, const Mask& of_camera,
               const MovingObjects& moving) {
  if (moving.objects().empty()) return of_camera;
  return without_moving_objects(scene, view, of_camera, moving,
                                directions_of(scene.rig[view.camera].camera));
}

std::vector<std::uint32_t> object_map(const Scene& scene, const View& view,
                                      const MovingObjects& moving) {
  return object_map_of(scene, view, moving,
                       [&] { return directions_of(scene.rig[view.camera].camera); });
}

namespace {

void apply_to_all(const ViewMasker& masker, const Scene& scene, ThreadPool& pool,
                  std::vector<Image8>* images) {
  Progress progress("masking images", std::ssize(*images));
  pool.run(static_cast<int>(images->size()), [&](int i) {
    if (!scene.views[i].held_out) masker.apply(scene.views[i], &(*images)[i]);
    progress.count();
  });
}

}  // namespace

void mark_objects(const Scene& scene, const MovingObjects& objects, ThreadPool& pool,
                  std::vector<Image8>* images) {
  apply_to_all(ViewMasker(scene, {}, {}, objects, pool), scene, pool, images);
}

void apply_mask(const Mask& mask, Image8* image) {
  REDRIVE_CHECK_OP(image->width, ==, mask.width);
  REDRIVE_CHECK_OP(image->height, ==, mask.height);
  if (mask.left_out() == 0) return;
  if (image->used.empty()) image->used.assign(mask.used.size(), 255);
  for (std::size_t i = 0; i < mask.used.size(); ++i)
    if (!mask.used[i]) image->used[i] = 0;
}

ViewMasker::ViewMasker(const Scene& scene, std::vector<Mask> of_cameras, MovingObjects masked,
                       MovingObjects marked, ThreadPool& pool)
    : scene_(scene),
      of_cameras_(std::move(of_cameras)),
      masked_(std::move(masked)),
      marked_(std::move(marked)),
      directions_(scene.rig.size()) {
  REDRIVE_CHECK(of_cameras_.empty() || of_cameras_.size() == scene.rig.size());
  if (!masked_.objects().empty() || !marked_.objects().empty())
    pool.run(static_cast<int>(directions_.size()),
             [&](int c) { directions_[c] = directions_of(scene.rig[c].camera); });
}

void ViewMasker::apply(const View& view, Image8* image) const {
  const std::vector<Eigen::Vector3f>& directions = directions_[view.camera];
  if (!of_cameras_.empty())
    apply_mask(without_moving_objects(scene_, view, of_cameras_[view.camera], masked_, directions),
               image);
  if (marked_.objects().empty()) return;
  const std::vector<std::uint32_t> map = object_map_of(
      scene_, view, marked_, [&]() -> const auto& { return directions; });
  if (std::ranges::none_of(map, [](std::uint32_t object) { return object != 0; })) return;
  if (image->used.empty()) image->used.assign(map.size(), 255);
  for (std::size_t pixel = 0; pixel < map.size(); ++pixel)
    if (map[pixel] != 0 && image->used[pixel] != 0) image->used[pixel] = kMovingPixel;
}

void apply_masks(const Scene& scene, const std::vector<Mask>& camera_masks,
                 const MovingObjects& moving, ThreadPool& pool, std::vector<Image8>* images) {
  REDRIVE_CHECK_OP(camera_masks.size(), ==, scene.rig.size());
  REDRIVE_CHECK_OP(images->size(), ==, scene.views.size());
  apply_to_all(ViewMasker(scene, camera_masks, moving, {}, pool), scene, pool, images);
}

Image8 overlay(const Image8& image, const Mask& mask) {
  REDRIVE_CHECK_OP(image.rgb.size(), ==, 3 * mask.used.size());
  Image8 tinted = image;
  for (std::size_t i = 0; i < mask.used.size(); ++i) {
    if (mask.used[i]) continue;
    tinted.rgb[3 * i] = static_cast<std::uint8_t>((image.rgb[3 * i] + 255) / 2);
    tinted.rgb[3 * i + 1] = image.rgb[3 * i + 1] / 2;
    tinted.rgb[3 * i + 2] = image.rgb[3 * i + 2] / 2;
  }
  return tinted;
}

}  // namespace redrive
