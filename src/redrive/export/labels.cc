// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/labels.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/scene/project_shutter.h"

namespace redrive {
namespace {

constexpr float kInfinity_m = 1e6f;  // background
constexpr float kOpaque = 0.5f;

/// Pixels that show the static world, or one object. Poses are in the axes of the first camera at
/// its middle line, which move along with what the pixels show.
struct MovingPixels {
  std::vector<std::uint32_t> rays;           ///< entries of the RayTable
  std::vector<Eigen::Affine3f> from_line;    ///< [lines of the first camera]; empty: one pose
  std::vector<PlainPose> from_later_camera;  ///< keys
};

MovingPixels moving_pixels(std::span<const PlainPose> now, std::span<const PlainPose> later,
                           bool by_column, int lines) {
  std::vector<Rigid3d> keys;
  for (const PlainPose& key : now) keys.push_back(rigid(key));
  const ShutterPoses poses(keys, by_column);
  const Rigid3d middle_from_axes = poses.at(0.5).inverse(Eigen::Isometry);
  MovingPixels out;
  for (const PlainPose& key : later)
    out.from_later_camera.push_back(plain(middle_from_axes * rigid(key)));
  for (int line = 0; poses.is_rolling() && line < lines; ++line)
    out.from_line.emplace_back(
        Rigid3d(middle_from_axes * poses.at(row_fraction(line, lines))).cast<float>());
  return out;
}

nlohmann::json coco_box(const PixelBox& box) {
  return {box.left, box.top, box.right - box.left, box.bottom - box.top};
}

PixelBox clipped(PixelBox box, int width, int height) {
  return {std::clamp(box.left, 0.0, double(width)), std::clamp(box.top, 0.0, double(height)),
          std::clamp(box.right, 0.0, double(width)), std::clamp(box.bottom, 0.0, double(height))};
}

/// Returns the box of an object's pixels without its shadow, and with what is beyond the sides of
/// the image that it touches.
PixelBox whole_box(PixelBox box, const std::optional<PixelBox>& projected, int width, int height) {
  if (!projected) return box;
  box.left = box.left <= 0 ? projected->left : std::max(box.left, projected->left);
  box.top = box.top <= 0 ? projected->top : std::max(box.top, projected->top);
  box.right = box.right >= width ? projected->right : std::min(box.right, projected->right);
  box.bottom = box.bottom >= height ? projected->bottom : std::min(box.bottom, projected->bottom);
  return box;
}

/// Returns the smallest box around two.
PixelBox around(const PixelBox& a, const PixelBox& b) {
  return {std::min(a.left, b.left), std::min(a.top, b.top), std::max(a.right, b.right),
          std::max(a.bottom, b.bottom)};
}

/// What an image's ids show of an object.
struct Visible {
  PixelBox box{1e9, 1e9, -1, -1};
  std::uint32_t pixels = 0;
};

/// Returns them by number.
std::vector<Visible> visible_parts(const RenderedImage& image) {
  const int most = image.seen.empty() ? 0 : image.seen.back().number;
  std::vector<Visible> visible(1 + most);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const int number = image.ids[static_cast<std::size_t>(y) * image.width + x];
      if (number == 0 || number > most) continue;
      PixelBox& box = visible[number].box;
      box = {std::min(box.left, double(x)), std::min(box.top, double(y)),
             std::max(box.right, x + 1.0), std::max(box.bottom, y + 1.0)};
      ++visible[number].pixels;
    }
  return visible;
}

}  // namespace

double overlap(const PixelBox& a, const PixelBox& b) {
  const PixelBox both{std::max(a.left, b.left), std::max(a.top, b.top), std::min(a.right, b.right),
                      std::min(a.bottom, b.bottom)};
  const double united = a.area() + b.area() - both.area();
  return united > 0 ? both.area() / united : 0;
}

std::vector<std::uint32_t> run_lengths(const std::vector<std::uint16_t>& ids, int width, int height,
                                       int number, const PixelBox& within) {
  std::vector<std::uint32_t> runs;
  const int first = static_cast<int>(within.left), end = static_cast<int>(within.right);
  std::uint32_t run = static_cast<std::uint32_t>(first * height);
  bool inside = false;
  for (int x = first; x < end; ++x)
    for (int y = 0; y < height; ++y) {
      const bool now = ids[static_cast<std::size_t>(y) * width + x] == number;
      if (now != inside) {
        runs.push_back(run);
        run = 0;
        inside = now;
      }
      ++run;
    }
  const std::uint32_t rest = static_cast<std::uint32_t>((width - end) * height);
  if (inside && rest > 0) {
    runs.push_back(run);
    run = 0;
  }
  runs.push_back(run + rest);
  return runs;
}

std::optional<PixelBox> projected_box(const Camera& camera, bool by_column,
                                      const ShutterPoses::Actor& actor,
                                      const Eigen::Vector3d& size_m) {
  std::vector<Rigid3d> keys;
  for (const PlainPose& key : actor.actor_from_camera) keys.push_back(rigid(key));
  const ShutterPoses poses(keys, by_column);
  const Rigid3d camera_from_actor = poses.at(0.5).inverse(Eigen::Isometry);
  PixelBox box{1e9, 1e9, -1e9, -1e9};
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3d sign(corner & 1 ? 1 : -1, corner & 2 ? 1 : -1, corner & 4 ? 1 : -1);
    const auto seen =
        project_shutter(camera, poses, camera_from_actor, sign.cwiseProduct(size_m) / 2);
    if (!seen) return std::nullopt;
    box.left = std::min(box.left, seen->pixel.x() + 0.5);
    box.right = std::max(box.right, seen->pixel.x() + 0.5);
    box.top = std::min(box.top, seen->pixel.y() + 0.5);
    box.bottom = std::max(box.bottom, seen->pixel.y() + 0.5);
  }
  return box;
}

nlohmann::json annotations_of(const RenderedImage& image, const Camera& camera,
                              const ShutterPoses& poses, const Scene& scene) {
  nlohmann::json out = nlohmann::json::array();
  const std::vector<Visible> visible = visible_parts(image);
  for (const SeenActor& seen : image.seen) {
    const Visible& here = visible[seen.number];
    if (here.pixels == 0) continue;
    const MovingObject& object = scene.actors[seen.number - 1];
    const auto actor = std::ranges::find(poses.actors(), seen.number, &ShutterPoses::Actor::number);
    const PixelBox rendered{double(seen.left), double(seen.top), seen.right + 1.0,
                            seen.bottom + 1.0},
        projected_part =
            whole_box(rendered,
                      actor == poses.actors().end()
                          ? std::nullopt
                          : projected_box(camera, poses.by_column(), *actor, object.size_m),
                      image.width, image.height),
        whole = around(here.box, projected_part);
    const double within = clipped(whole, image.width, image.height).area();
    out.push_back(
        {{"track_id", object.id},
         {"category", object.type},
         {"number", seen.number},
         {"bbox", coco_box(here.box)},
         {"whole_bbox", coco_box(whole)},
         {"area", here.pixels},
         {"iscrowd", 0},
         {"segmentation",
          {{"size", {image.height, image.width}},
           {"counts", run_lengths(image.ids, image.width, image.height, seen.number, here.box)}}},
         {"occlusion", 1 - std::min(1.0, double(seen.visible) / seen.whole)},
         {"truncation", whole.area() > 0 ? 1 - within / whole.area() : 0}});
  }
  return out;
}

nlohmann::json coco_document(const std::vector<nlohmann::json>& images) {
  nlohmann::json document{{"info", {{"description", "labels of images that redrive rendered"}}},
                          {"images", nlohmann::json::array()},
                          {"annotations", nlohmann::json::array()},
                          {"categories", nlohmann::json::array()}};
  std::map<std::string, int> categories;
  for (const nlohmann::json& image : images)
    for (const nlohmann::json& annotation : image.at("annotations"))
      categories.emplace(annotation.at("category").get<std::string>(), 0);
  int next = 0;
  for (auto& [name, id] : categories) {
    id = ++next;
    document["categories"].push_back({{"id", id}, {"name", name}});
  }
  for (nlohmann::json image : images) {
    const auto image_id = document["images"].size() + 1;
    for (nlohmann::json annotation : image.at("annotations")) {
      annotation["id"] = document["annotations"].size() + 1;
      annotation["image_id"] = image_id;
      annotation["category_id"] = categories.at(annotation.at("category").get<std::string>());
      annotation.erase("category");
      document["annotations"].push_back(std::move(annotation));
    }
    image.erase("annotations");
    image["id"] = image_id;
    document["images"].push_back(std::move(image));
  }
  return document;
}

std::vector<float> optical_flow(const RenderedImage& image, const RayTable& rays,
                                const ShutterPoses& now, const ShutterPoses& later,
                                kernels::Backend& backend) {
  const std::size_t width = image.width;
  const bool by_column = now.by_column();
  std::vector<std::optional<MovingPixels>> moving(1);  // index: number
  const auto add = [&](int number, std::span<const PlainPose> from, std::span<const PlainPose> to) {
    if (number >= std::ssize(moving)) moving.resize(number + 1);
    moving[number] = moving_pixels(from, to, by_column, by_column ? image.width : image.height);
  };
  add(0, now.keys(), later.keys());
  for (const ShutterPoses::Actor& actor : now.actors()) {
    const auto then = std::ranges::find(later.actors(), actor.number, &ShutterPoses::Actor::number);
    const auto seen = std::ranges::find(image.seen, actor.number, &SeenActor::number);
    const bool articulated = seen != image.seen.end() && seen->articulated;
    if (then != later.actors().end() && !articulated)
      add(actor.number, actor.actor_from_camera, then->actor_from_camera);
  }
  moving[0]->rays.reserve(rays.pixel.size());
  for (std::size_t i = 0; i < rays.pixel.size(); ++i) {
    const std::size_t number = image.ids[rays.pixel[i]];
    if (number < moving.size() && moving[number])
      moving[number]->rays.push_back(static_cast<std::uint32_t>(i));
  }

  kernels::GaussianCamera camera;
  camera.camera = make_plain_camera(rays.camera, std::numeric_limits<double>::infinity());
  camera.image_rows = static_cast<float>(by_column ? image.width : image.height);
  camera.by_column = by_column;
  std::vector<float> flow(2 * image.depth.size(), kUnknownFlow);
  constexpr std::size_t kRaysPerRange = 4096;
  std::vector<float> points, pixels;
  for (const auto& part : moving) {
    if (!part || part->rays.empty()) continue;
    const std::size_t n = part->rays.size();
    points.resize(3 * n);
    pixels.resize(2 * n);
    backend.pool().run_ranges(n, kRaysPerRange, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        const std::size_t i = part->rays[k], pixel = rays.pixel[i];
        const bool solid = image.opacity[pixel] >= kOpaque && image.depth[pixel] > 0;
        Eigen::Vector3f at = (solid ? image.depth[pixel] : kInfinity_m) *
                             Eigen::Map<const Eigen::Vector3f>(&rays.direction[3 * i]);
        if (!part->from_line.empty())
          at = part->from_line[by_column ? pixel % width : pixel / width] * at;
        for (int c = 0; c < 3; ++c) points[c * n + k] = at[c];
      }
    });
    camera.world_from_camera = part->from_later_camera;
    backend.gaussians().project_points(camera, points, pixels);
    backend.pool().run_ranges(n, kRaysPerRange, [&](std::size_t begin, std::size_t end) {
      for (std::size_t k = begin; k < end; ++k) {
        const std::size_t pixel = rays.pixel[part->rays[k]];
        const float u = pixels[k], v = pixels[n + k];
        if (std::isnan(u)) continue;
        flow[2 * pixel] = u - static_cast<float>(pixel % width);
        flow[2 * pixel + 1] = v - static_cast<float>(pixel / width);
      }
    });
  }
  return flow;
}

std::string make_flo(const std::vector<float>& flow, int width, int height) {
  const std::int32_t size[2] = {width, height};
  std::string bytes = "PIEH";
  bytes.append(reinterpret_cast<const char*>(size), sizeof size);
  bytes.append(reinterpret_cast<const char*>(flow.data()), flow.size() * sizeof(float));
  return bytes;
}

}  // namespace redrive
