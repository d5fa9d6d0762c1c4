// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/view_renderer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/eval/evaluate.h"
#include "redrive/math/angles.h"
#include "redrive/math/wgs84.h"
#include "redrive/model/method.h"
#include "redrive/perception/masks.h"
#include "redrive/render/normals.h"
#include "redrive/render/run_renderer.h"
#include "redrive/render/view_pose.h"
#include "redrive/report/report_images.h"
#include "redrive/scene/load_views.h"
#include "redrive/view/traffic.h"

namespace redrive::view {
namespace {

constexpr std::size_t kKeptTables = 12, kKeptImages = 8;
constexpr std::size_t kNamedObservers = 6;  ///< training images that a click names

/// Returns the entry of `key`, making it by `make` if it is not among the last `most`.
template <class Key, class Value, class Make>
Value cached(std::list<std::pair<Key, Value>>* entries, const Key& key, std::size_t most,
             const Make& make) {
  for (auto entry = entries->begin(); entry != entries->end(); ++entry)
    if (entry->first == key) {
      entries->splice(entries->begin(), *entries, entry);
      return entries->front().second;
    }
  entries->emplace_front(key, make());
  if (entries->size() > most) entries->pop_back();
  return entries->front().second;
}

[[noreturn]] void refuse(const char* field, const std::string& value, const char* rule) {
  throw InputError("message", field, value, rule);
}

/// Throws UsageError for a drive trained in blocks: a few images in a kilometre say nothing about
/// what was seen, and all of them would load every block.
void refuse_blocks(const Run& run, const char* what) {
  if (!run.blocks.empty())
    throw UsageError(what, "", "is shown of single blocks: redrive view RUN/blocks/000");
}

nlohmann::json three(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

/// Returns the upper three rows, row by row.
nlohmann::json matrix_rows(const Rigid3d& pose) {
  nlohmann::json rows = nlohmann::json::array();
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 4; ++column) rows.push_back(pose(row, column));
  return rows;
}

/// Copies the valid pixels of `strip`, which has the size of `image`.
void add_strip(const RenderedImage& strip, const RayTable& table, RenderedImage* image) {
  for (const std::uint32_t pixel : table.pixel) {
    for (int c = 0; c < 3; ++c) image->rgb[3 * pixel + c] = strip.rgb[3 * pixel + c];
    image->depth[pixel] = strip.depth[pixel];
    image->opacity[pixel] = strip.opacity[pixel];
    image->valid[pixel] = strip.valid[pixel];
  }
}

/// Cuts a table into `count` strips of whole rows; rows come in pairs, as ray marchers' squares.
std::vector<std::shared_ptr<const RayTable>> cut(const std::shared_ptr<const RayTable>& whole,
                                                 int count) {
  if (count <= 1) return {whole};
  std::vector<std::shared_ptr<const RayTable>> strips;
  const int rows = 2 * std::max(1, (whole->height + 2 * count - 1) / (2 * count));
  for (int row = 0; row < whole->height; row += rows) {
    const auto at = [&](int y) {
      return std::lower_bound(whole->pixel.begin(), whole->pixel.end(),
                              static_cast<std::uint32_t>(y) * whole->width);
    };
    const auto first = at(row), last = at(std::min(row + rows, whole->height));
    if (first == last) continue;
    auto strip = std::make_shared<RayTable>();
    strip->width = whole->width;
    strip->height = whole->height;
    strip->camera = whole->camera;
    strip->pixel_angle = whole->pixel_angle;
    strip->pixel.assign(first, last);
    strip->direction.assign(whole->direction.begin() + 3 * (first - whole->pixel.begin()),
                            whole->direction.begin() + 3 * (last - whole->pixel.begin()));
    strips.push_back(std::move(strip));
  }
  return strips.empty() ? std::vector{whole} : strips;
}

}  // namespace

bool RenderJob::step() {
  if (!field_) {
    image_.clear(placement_.camera.width, placement_.camera.height);
    return true;
  }
  const auto start = std::chrono::steady_clock::now();
  const RayTable& table = *strips_[next_];
  if (next_ == 0)
    field_->render_to(*backend_, table, placement_.poses(), placement_.exposure, &image_);
  else
    add_strip(render_image(*backend_, *field_, table, placement_.poses(), placement_.exposure),
              table, &image_);
  ++next_;
  seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return next_ == strips_.size();
}

ViewRenderer::ViewRenderer(const Run& run, kernels::Backend& backend)
    : run_(run),
      backend_(backend),
      marches_rays_(has_field() && !find_method(run.options.method)->rasterises),
      novel_(novel_ground_truths(run)) {}

nlohmann::json ViewRenderer::describe() const {
  const Scene& scene = run_.scene;
  nlohmann::json cameras = nlohmann::json::array(), frames = nlohmann::json::array(),
                 held_out = nlohmann::json::array(), novel = nlohmann::json::array();
  for (const RigCamera& camera : scene.rig)
    cameras.push_back({{"name", camera.name},
                       {"model", camera.camera.info().name},
                       {"width", camera.camera.width},
                       {"height", camera.camera.height},
                       {"body_from_sensor", matrix_rows(camera.body_from_sensor)}});
  for (const Frame& frame : scene.frames)
    frames.push_back(
        {{"id", frame.id}, {"t_s", 1e-9 * static_cast<double>(frame.t_ns - scene.frames[0].t_ns)}});
  for (std::size_t f = 0; f < scene.frames.size(); ++f)
    if (std::ranges::any_of(scene.views, [&](const View& view) {
          return view.held_out && view.frame == static_cast<int>(f);
        }))
      held_out.push_back(scene.frames[f].id);
  for (const NovelGroundTruth& set : novel_) {
    nlohmann::json views = nlohmann::json::array();
    for (std::size_t i = 0; i < set.size(); ++i)
      views.push_back({{"file", set.request(i).file},
                       {"camera", set.request(i).camera},
                       {"frame", set.request(i).frame_id}});
    novel.push_back({{"set", set.name()}, {"poses", set.poses_file().string()}, {"views", views}});
  }
  nlohmann::json start;  // the middle image of the first camera that has some
  if (!scene.views.empty()) {
    const int camera = scene.views.front().camera;
    const auto of_camera = std::ranges::count(scene.views, camera, &View::camera);
    start = {{"camera", scene.rig[camera].name},
             {"frame", scene.frames[scene.views[of_camera / 2].frame].id}};
  }
  return {{"kind", "hello"},
          {"run", has_field() ? run_.paths.root.string() : run_.recording.root.string()},
          {"method", has_field() ? run_.options.method : ""},
          {"step", run_.state.step},
          {"metric", scene.metric},
          {"ecef", run_.recording.global_frame == GlobalFrame::kEcef},
          {"lidar", !run_.recording.lidar_files.empty() && !run_.recording.lidars.empty()},
          {"boxes", !run_.recording.box_files.empty() || !run_.moving.objects().empty()},
          {"cameras", cameras},
          {"frames", frames},
          {"held_out", held_out},
          {"novel", novel},
          {"start", start},
          {"depth", has_field() ? depth_scale() : nlohmann::json()},
          {"objects", objects_to_json(scene)}};
}

/// Returns {"near_m", "far_m", "colours": ["#rrggbb", ..]}: the scale of the depth layer, in equal
/// steps of the logarithm.
nlohmann::json ViewRenderer::depth_scale() const {
  constexpr int kSteps = 16;
  RenderedImage ramp;
  ramp.clear(kSteps + 1, 1);
  for (int i = 0; i <= kSteps; ++i) {
    ramp.depth[i] = static_cast<float>(
        run_.scene.near_m * std::pow(farthest_shown_m() / run_.scene.near_m, 1.0 * i / kSteps));
    ramp.valid[i] = 1;
  }
  const Image8 colours = depth_colours(ramp, run_.scene.near_m, farthest_shown_m());
  nlohmann::json names = nlohmann::json::array();
  for (int i = 0; i <= kSteps; ++i) {
    char name[8];
    std::snprintf(name, sizeof name, "#%02x%02x%02x", colours.rgb[3 * i], colours.rgb[3 * i + 1],
                  colours.rgb[3 * i + 2]);
    names.push_back(name);
  }
  return {{"near_m", run_.scene.near_m}, {"far_m", farthest_shown_m()}, {"colours", names}};
}

double ViewRenderer::farthest_shown_m() const { return std::min(run_.scene.far_m, 100.0); }

std::shared_ptr<const GroundTruthView> ViewRenderer::ground_truth(const NovelView& novel) {
  const auto set = std::ranges::find(novel_, novel.set, &NovelGroundTruth::name);
  if (set == novel_.end()) refuse("novel.set", novel.set, "the recording has no such novel set");
  if (novel.index >= set->size())
    refuse("novel.index", std::to_string(novel.index), "the set has fewer views");
  return cached(&ground_truths_, novel, kKeptImages, [&] {
    return std::shared_ptr<const GroundTruthView>(
        std::make_shared<GroundTruthView>(set->load(novel.index)));
  });
}

Exposure ViewRenderer::exposure_of(const ViewRequest& request, const std::string& camera) const {
  if (request.exposure == "none") return {};
  if (request.exposure == "own") return exposure_at(run_.scene, camera, request.frame);
  const std::size_t colon = request.exposure.rfind(':');
  const std::string frame = colon == std::string::npos ? "" : request.exposure.substr(colon + 1);
  if (frame.empty() || frame.size() > 18 ||
      frame.find_first_not_of("0123456789") != std::string::npos)
    refuse("exposure", request.exposure, "must be own, none or CAMERA:FRAME");
  const Exposure exposure =
      exposure_at(run_.scene, request.exposure.substr(0, colon), std::stoll(frame));
  if (exposure.camera < 0)
    refuse("exposure", request.exposure, "the run has no such camera or frame");
  return exposure;
}

RigCamera ViewRenderer::requested_camera(const ViewRequest& request) const {
  if (request.mount) {
    const auto mounted = mounted_camera(request.mount->mount, request.mount->lens, run_.scene);
    if (!mounted) refuse("mount.lens", request.mount->lens.camera, "the run has no such camera");
    return *mounted;
  }
  const int index = run_.scene.camera_index(request.camera);
  if (index < 0) refuse("camera", request.camera, "the run has no such camera");
  return run_.scene.rig[index];
}

Placement ViewRenderer::place(const ViewRequest& request, const Scene& traffic) {
  if (request.novel) {
    const auto view = ground_truth(*request.novel);
    const auto set = std::ranges::find(novel_, request.novel->set, &NovelGroundTruth::name);
    const RequestedView& named = set->request(request.novel->index);
    const RigCamera& of_run = run_.scene.rig[run_.scene.camera_index(named.camera)];
    Placement placement{.camera_name = named.camera,
                        .frame = named.frame_id,
                        .camera = view->camera,
                        .world_from_camera = view->world_from_camera,
                        .world_from_body = view->world_from_camera *
                                           of_run.body_from_sensor.inverse(Eigen::Isometry),
                        .exposure = view->exposure};
    add_traffic(traffic, set->camera(request.novel->index), time_of(named.frame_id), &placement);
    if (request.exposure != "own") placement.exposure = exposure_of(request, named.camera);
    return placement;
  }
  const RigCamera camera = requested_camera(request);
  const auto body = world_from_body(run_.scene, request.frame, camera);
  if (!body) refuse("frame", std::to_string(request.frame), "the recording has no such frame");
  const Rigid3d body_from_sensor =
      turned_sensor(camera.body_from_sensor, kRadiansPerDegree * request.yaw_deg,
                    kRadiansPerDegree * request.pitch_deg);
  const Rigid3d world_from_camera =
      shifted_camera(run_.scene.global_from_world, *body, body_from_sensor, ShiftAxes::kBody,
                     Eigen::Vector3d(request.shift_m.data()));
  Placement placement{.camera_name = camera.name,
                      .frame = request.frame,
                      .camera = camera.camera,
                      .world_from_camera = world_from_camera,
                      .world_from_body = *body,
                      .exposure = exposure_of(request, camera.name)};
  add_traffic(traffic, camera, time_of(request.frame), &placement);
  return placement;
}

Placement ViewRenderer::place_at(const ViewRequest& request, const PathKey& key,
                                 const Scene& traffic) {
  ViewRequest mounted = request;
  mounted.shift_m = {};
  mounted.yaw_deg = mounted.pitch_deg = 0;
  mounted.novel.reset();
  mounted.mount.reset();
  Placement placement = place(mounted, traffic);
  placement.world_from_body =
      key.world_from_camera *
      (placement.world_from_camera.inverse(Eigen::Isometry) * placement.world_from_body);
  placement.world_from_camera = key.world_from_camera;
  add_traffic(traffic, requested_camera(mounted), drive_time_ns(key, run_.scene), &placement);
  return placement;
}

/// Sets the moving objects to those that the camera sees, exposed at a frame of this time; none
/// without a time.
void ViewRenderer::add_traffic(const Scene& traffic, const RigCamera& camera,
                               std::optional<std::int64_t> frame_ns, Placement* placement) const {
  placement->actors.clear();
  if (!frame_ns) return;
  placement->t_ns = *frame_ns + camera.time_offset_ns;
  placement->actors = traffic.with_actors(placement->world_from_camera, camera, *frame_ns).actors();
}

/// Returns the time of a frame of the recording.
std::optional<std::int64_t> ViewRenderer::time_of(std::int64_t frame) const {
  const auto found = std::ranges::find(run_.recording.frames, frame, &FramePose::id);
  if (found == run_.recording.frames.end()) return std::nullopt;
  return found->t_ns;
}

std::shared_ptr<const RayTable> ViewRenderer::table(const Camera& camera, const std::string& name,
                                                    int factor) {
  return cached(&tables_, {name, factor}, kKeptTables, [&] {
    return std::shared_ptr<const RayTable>(std::make_shared<RayTable>(
        make_ray_table(factor == 1 ? camera : camera.downscaled(factor), backend_.pool())));
  });
}

RenderJob ViewRenderer::begin(const ViewRequest& request, const Placement& placement, int factor,
                              double expected_s, double strip_s) {
  factor = std::clamp(factor, 1, std::min(placement.camera.width, placement.camera.height));
  RenderJob job;
  job.field_ = run_.field();
  job.backend_ = &backend_;
  job.placement_ = placement;
  job.factor_ = has_field() ? factor : 1;
  job.image_ = std::move(spare_);
  job.image_.labelled = request.layer == Layer::kActors && has_field() && !marches_rays_;
  if (!has_field()) {
    if (request.is_driven() || request.novel) job.recorded_ = reference(request);
    return job;
  }
  // Cameras of novel sets may have the name of a run's camera and another lens: tables are keyed by
  // both.
  const Camera& of = placement.camera;
  const std::string key = placement.camera_name + "/" + std::to_string(of.fx) + "/" +
                          std::to_string(of.cx) + "/" + std::to_string(of.cy);
  const int strips =
      marches_rays_ ? static_cast<int>(std::clamp(std::ceil(expected_s / strip_s), 1.0, 256.0)) : 1;
  job.table_ = table(placement.camera, key, factor);
  job.strips_ = cut(job.table_, strips);
  return job;
}

void ViewRenderer::reuse(RenderJob&& job) { spare_ = std::move(job.image_); }

Image8 ViewRenderer::colours(const RenderJob& job, Layer layer, const Scene& traffic) {
  const RenderedImage& image = job.image();
  if (job.recorded_) return *job.recorded_;
  switch (layer) {
    case Layer::kImage: return to_image8(image);
    case Layer::kDepth: return depth_colours(image, run_.scene.near_m, farthest_shown_m());
    case Layer::kNormals: return has_field() ? normals_image(image, *job.table_) : to_image8(image);
    case Layer::kOpacity: return opacity_image(image);
    case Layer::kCoverage:
      if (!has_field()) return to_image8(image);
      refuse_blocks(run_, "the coverage");
      if (!coverage_) coverage_ = std::make_unique<Coverage>(run_, backend_, /*at_once=*/false);
      while (!has_coverage_) has_coverage_ = !coverage_->step();
      return coverage_colours(
          image, coverage_->seen(job.strips_.front()->camera, job.placement().poses(), image));
    case Layer::kActors:
      if (!image.labelled) return to_image8(image);
      RenderedImage shown = image;
      leave_out_shadows(*job.table_, job.placement().poses(), traffic, &shown);
      return actor_colours(shown);
  }
  return {};
}

const View* ViewRenderer::find_view(const std::string& camera, std::int64_t frame) const {
  const int c = run_.scene.camera_index(camera), f = run_.scene.frame_index(frame);
  const auto view = std::ranges::find_if(
      run_.scene.views, [&](const View& view) { return view.camera == c && view.frame == f; });
  return view == run_.scene.views.end() ? nullptr : &*view;
}

std::shared_ptr<const Image8> ViewRenderer::reference(const ViewRequest& request) {
  if (request.novel) {
    const auto view = ground_truth(*request.novel);
    return {view, &view->image};
  }
  const View* const view = request.mount ? nullptr : find_view(request.camera, request.frame);
  if (!view) return nullptr;
  return cached(&references_, {request.camera, request.frame}, kKeptImages, [&] {
    return std::shared_ptr<const Image8>(std::make_shared<Image8>(load_view(run_.scene, *view)));
  });
}

std::optional<Mask> ViewRenderer::mask(const ViewRequest& request) {
  const View* const view =
      has_field() && !request.novel ? find_view(request.camera, request.frame) : nullptr;
  if (!view) return std::nullopt;
  if (!exclusions_) exclusions_ = read_exclusions(run_);
  return view_mask(run_.scene, *view, exclusions_->masks[view->camera], exclusions_->moving);
}

std::optional<double> ViewRenderer::psnr_db(const ViewRequest& request, const RenderJob& job) {
  const auto recorded = reference(request);
  if (!has_field() || !recorded || recorded->width != job.image().width ||
      recorded->height != job.image().height)
    return std::nullopt;
  if (request.novel) return score_image(backend_, job.image(), *recorded).psnr_db;
  Image8 masked = *recorded;
  apply_mask(*mask(request), &masked);
  return score_image(backend_, job.image(), masked).psnr_db;
}

ViewRenderer::Preparation ViewRenderer::prepare_coverage(double seconds) {
  if (has_coverage_) return Preparation::kReady;
  if (!has_field() || marches_rays_ || !run_.blocks.empty()) return Preparation::kNever;
  if (!coverage_) coverage_ = std::make_unique<Coverage>(run_, backend_, /*at_once=*/false);
  const auto start = std::chrono::steady_clock::now();
  while (!has_coverage_ &&
         std::chrono::steady_clock::now() - start < std::chrono::duration<double>(seconds))
    has_coverage_ = !coverage_->step();
  return has_coverage_ ? Preparation::kReady : Preparation::kMore;
}

double ViewRenderer::seen_share(const RenderJob& job) const {
  return coverage_->seen_share(job.strips_.front()->camera, job.placement().poses(), job.image());
}

nlohmann::json ViewRenderer::pick(const RenderJob& job, double u, double v,
                                  const Scene& traffic) const {
  const RenderedImage& image = job.image();
  const int x = std::clamp(static_cast<int>(u * image.width), 0, image.width - 1),
            y = std::clamp(static_cast<int>(v * image.height), 0, image.height - 1);
  const std::size_t at = static_cast<std::size_t>(y) * image.width + x;
  nlohmann::json answer = {{"pixel", {x, y}},
                           {"opacity", image.opacity[at]},
                           {"camera", job.placement().camera_name},
                           {"frame", job.placement().frame},
                           {"surface", false},
                           {"object", nullptr}};
  if (!has_field()) return answer;
  const auto direction = job.strips_.front()->camera.unproject(Eigen::Vector2d(x, y));
  const double depth_m = image.depth[at];
  const Placement& placement = job.placement();
  // As in eval/coverage.h: below 1/2 a ray hits nothing.
  const bool hits = direction && image.valid[at] && image.opacity[at] >= 0.5f &&
                    std::isfinite(depth_m) && depth_m > 0;
  if (direction && image.valid[at]) {
    const auto object =
        object_on_ray(traffic, placement.t_ns, placement.world_from_camera.translation(),
                      placement.world_from_camera.linear() * *direction);
    // In front of its box, by more than a surface is thick.
    if (object && (!hits || depth_m > 0.95 * object->from_m - 0.3)) answer["object"] = object->id;
  }
  if (!hits) return answer;
  const Eigen::Vector3d in_world = placement.world_from_camera * (depth_m * *direction);
  answer["surface"] = true;
  answer["depth_m"] = depth_m;
  answer["world_m"] = three(in_world);
  answer["body_m"] = three(placement.world_from_body.inverse(Eigen::Isometry) * in_world);
  if (run_.recording.global_frame == GlobalFrame::kEcef) {
    const Eigen::Vector3d in_ecef = run_.scene.global_from_world * in_world;
    const Geodetic place = geodetic_from_ecef(in_ecef.x(), in_ecef.y(), in_ecef.z());
    answer["ecef_m"] = three(in_ecef);
    answer["wgs84"] = {{"latitude_deg", kDegreesPerRadian * place.latitude_rad},
                       {"longitude_deg", kDegreesPerRadian * place.longitude_rad},
                       {"height_m", place.height_m}};
  }
  return answer;
}

void ViewRenderer::forget_field() {
  coverage_.reset();
  has_coverage_ = false;
  observers_.reset();
}

PointSearch ViewRenderer::begin_search(const Eigen::Vector3d& point_in_world) {
  refuse_blocks(run_, "the images that saw a point");
  if (!observers_) observers_ = std::make_unique<PointObservers>(run_, backend_);
  return observers_->begin(point_in_world);
}

bool ViewRenderer::step(PointSearch* search) { return observers_->step(search); }

nlohmann::json ViewRenderer::found(const PointSearch& search) const {
  nlohmann::json nearest = nlohmann::json::array();
  for (std::size_t i = 0; i < std::min(search.seen_by.size(), kNamedObservers); ++i) {
    const View& view = *search.seen_by[i];
    const Eigen::Vector3d eye = run_.scene.world_from_camera(view).translation();
    nearest.push_back({{"camera", run_.scene.rig[view.camera].name},
                       {"frame", run_.scene.frames[view.frame].id},
                       {"distance_m", (eye - search.point_in_world).norm()}});
  }
  return {{"seen", search.seen_by.size()},
          {"of", observers_->training_views()},
          {"nearest", std::move(nearest)}};
}

}  // namespace redrive::view
