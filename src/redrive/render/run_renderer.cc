// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/run_renderer.h"

#include <algorithm>
#include <array>
#include <bit>
#include <map>
#include <tuple>
#include <utility>
#include <variant>

#include "redrive/train/memory.h"

namespace redrive {
namespace {

constexpr std::size_t kKeptRayTables = 12;

bool is_same_lens(const Camera& a, const Camera& b) {
  if (std::tie(a.fx, a.fy, a.cx, a.cy, a.width, a.height) !=
          std::tie(b.fx, b.fy, b.cx, b.cy, b.width, b.height) ||
      a.model.index() != b.model.index())
    return false;
  return std::visit(
      [&](const auto& of_a) {
        using Model = std::decay_t<decltype(of_a)>;
        const auto bits = [](const Model& model) {
          using Numbers = typename Model::template Numbers<double>;
          const Numbers numbers = model.numbers();
          return std::bit_cast<std::array<std::uint64_t, sizeof(Numbers) / 8>>(numbers);
        };
        return bits(of_a) == bits(std::get<Model>(b.model));
      },
      a.model);
}

/// Whether a point in the axes of an object's box is the object, not its shadow or its light on the
/// road, which are among its Gaussians.
bool is_on_object(const Eigen::Vector3d& in_box, const Eigen::Vector3d& size_m) {
  constexpr double kBeside_m = 0.1, kAboveRoad_m = 0.05;  // mirrors; errors of boxes and depth
  const Eigen::Vector3d beyond = in_box.cwiseAbs() - size_m / 2;
  return beyond.maxCoeff() < kBeside_m && in_box.z() > kAboveRoad_m - size_m.z() / 2;
}

}  // namespace

void leave_out_shadows(const RayTable& rays, const ShutterPoses& poses, const Scene& traffic,
                       RenderedImage* image) {
  std::map<int, PixelPoses> box_from_camera;  // key: number
  for (const ShutterPoses::Actor& actor : poses.actors()) {
    std::vector<Rigid3d> keys;
    for (const PlainPose& key : actor.actor_from_camera) keys.push_back(rigid(key));
    box_from_camera.try_emplace(actor.number, ShutterPoses(keys, poses.by_column()), image->width,
                                image->height);
  }
  std::vector<std::uint16_t> ids(image->ids.size());
  for (std::size_t i = 0; i < rays.pixel.size(); ++i) {
    const std::size_t pixel = rays.pixel[i];
    const std::uint16_t number = image->ids[pixel];
    if (number == 0) continue;
    const Eigen::Vector3d in_camera =
        double(image->depth[pixel]) *
        Eigen::Map<const Eigen::Vector3f>(&rays.direction[3 * i]).cast<double>();
    if (is_on_object(box_from_camera.at(number).of(pixel) * in_camera,
                     traffic.actors[number - 1].size_m))
      ids[pixel] = number;
  }
  image->ids = std::move(ids);
}

std::vector<std::string> change_traffic(const Field& field, const std::optional<TrafficEdit>& edit,
                                        std::string_view actors, Scene* scene,
                                        ActorBodies* bodies) {
  std::vector<std::string> remarks;
  if (edit) {
    check_added(*edit, field.draws_actors());
    remarks = edit_actors(*edit, scene, bodies);
  }
  select_actors(actors, scene);
  return remarks;
}

RunRenderer::RunRenderer(std::shared_ptr<const Run> run, const kernels::BackendChoice& backend)
    : run_(std::move(run)), backend_(make_backend(backend, run_->options.method)) {}

Scene RunRenderer::with_traffic(const std::optional<TrafficEdit>& edit, std::string_view actors,
                                std::vector<std::string>* remarks) {
  Scene scene = run_->scene;
  *remarks = change_traffic(*run_->field(), edit, actors, &scene, &bodies_);
  return scene;
}

std::shared_ptr<const RayTable> RunRenderer::rays(const Camera& camera) {
  const auto known = std::ranges::find_if(
      tables_, [&](const auto& table) { return is_same_lens(table->camera, camera); });
  if (known != tables_.end()) {
    tables_.splice(tables_.begin(), tables_, known);
    return tables_.front();
  }
  check_rendering_memory(*run_, &camera);
  tables_.push_front(std::make_shared<const RayTable>(make_ray_table(camera, backend_->pool())));
  if (tables_.size() > kKeptRayTables) tables_.pop_back();
  return tables_.front();
}

RenderedImage RunRenderer::image(const ImageRequest& request, const Scene& traffic) {
  const std::shared_ptr<const RayTable> table = rays(request.camera.camera);
  RenderedImage image;
  image.labelled = request.labelled;
  const ShutterPoses poses =
      traffic.with_actors(ShutterPoses(request.world_from_camera, request.camera.readout_by_column),
                          request.camera, request.exposed_ns - request.camera.time_offset_ns);
  run_->field()->render_to(*backend_, *table, poses, request.exposure, &image);
  if (image.labelled) leave_out_shadows(*table, poses, traffic, &image);
  return image;
}

}  // namespace redrive
