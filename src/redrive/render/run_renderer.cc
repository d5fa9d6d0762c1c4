// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/run_renderer.h"

#include <algorithm>
#include <array>
#include <bit>
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

}  // namespace

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
  return render_image(*backend_, *run_->field(), *table,
                      traffic.with_actors(ShutterPoses(request.world_from_camera), request.camera,
                                          request.exposed_ns - request.camera.time_offset_ns),
                      request.exposure);
}

}  // namespace redrive
