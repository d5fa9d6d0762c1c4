// SPDX-License-Identifier: Apache-2.0
#include "redrive/serve/run_service.h"

#include <algorithm>
#include <cmath>
#include <future>
#include <set>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/image/jpeg.h"
#include "redrive/image/png.h"
#include "redrive/render/lidar_scan.h"
#include "redrive/render/run_camera.h"

namespace redrive::serve {
namespace {

/// Images in work for a request: more would wait in memory for their encoding.
constexpr std::size_t kMaxEncoding = 4;
/// Room for the fields around an image in a message.
constexpr std::size_t kImageFields = 1024;
constexpr int kUsualQuality = 92;
/// Longest exposure of an image or a scan, within which objects are interpolated.
constexpr std::int64_t kLongestFrame_ns = 500'000'000;

[[noreturn]] void refuse(StatusCode code, const std::string& message) {
  throw RequestError(code, message);
}

/// Returns what `make` returns. Errors become RequestErrors.
template <class Make>
auto answered(const Make& make) -> decltype(make()) {
  try {
    return make();
  } catch (const RequestError&) {
    throw;
  } catch (const UsageError& error) {
    refuse(
        error.option == "--memory" ? StatusCode::kResourceExhausted : StatusCode::kInvalidArgument,
        error.what());
  } catch (const InputError& error) {
    refuse(StatusCode::kFailedPrecondition, error.what());
  } catch (const std::bad_alloc&) {
    refuse(StatusCode::kResourceExhausted, "there is no memory left");
  } catch (const std::exception& error) {
    refuse(StatusCode::kInternal, error.what());
  }
}

void check_cancelled(const Cancelled& cancelled) {
  if (cancelled()) refuse(StatusCode::kCancelled, "cancelled");
}

std::string us_text(std::int64_t t_ns) { return std::to_string(t_ns / 1000) + " us"; }

void check_time(const SensorQuery& query, const Scene& scene) {
  if (query.end_ns < query.start_ns)
    refuse(StatusCode::kInvalidArgument, "frame_end_us is before frame_start_us");
  if (query.end_ns - query.start_ns > kLongestFrame_ns)
    refuse(StatusCode::kInvalidArgument, "a frame may last " + us_text(kLongestFrame_ns) +
                                             ", not " + us_text(query.end_ns - query.start_ns));
  // Cameras expose a little before and after the pose of their frame.
  const std::int64_t first_ns = scene.trajectory.front().t_ns - kLongestFrame_ns,
                     last_ns = scene.trajectory.back().t_ns + kLongestFrame_ns;
  if (query.start_ns < first_ns || query.end_ns > last_ns)
    refuse(StatusCode::kOutOfRange, "frame of " + us_text(query.start_ns) + " to " +
                                        us_text(query.end_ns) + ": the drive is from " +
                                        us_text(first_ns) + " to " + us_text(last_ns));
}

/// Returns the named objects, with the poses of the request alone.
std::vector<MovingObject> placed_objects(const SensorQuery& query, const Scene& scene) {
  std::vector<MovingObject> placed;
  std::set<std::string> named;
  for (const TrackPose& track : query.objects) {
    const auto known = std::ranges::find_if(scene.actors, [&](const MovingObject& actor) {
      return std::to_string(actor.id) == track.track;
    });
    if (known == scene.actors.end()) {
      std::vector<std::string> ids;
      for (const MovingObject& actor : scene.actors) ids.push_back(std::to_string(actor.id));
      refuse(StatusCode::kInvalidArgument, "track_id = " + track.track + ": " +
                                               (ids.empty() ? "the scene draws no moving objects"
                                                            : unknown_name(track.track, ids)));
    }
    if (!named.insert(track.track).second)
      refuse(StatusCode::kInvalidArgument, "track_id = " + track.track + ": is named twice");
    MovingObject object{.id = known->id, .type = known->type, .size_m = known->size_m, .keys = {}};
    object.keys = {{query.start_ns, track.local_from_box.start, Eigen::Vector3d::Zero()}};
    if (query.end_ns > query.start_ns)
      object.keys.push_back({query.end_ns, track.local_from_box.end, Eigen::Vector3d::Zero()});
    placed.push_back(std::move(object));
  }
  return placed;
}

/// Returns the camera of a lens at its own size.
Camera camera_of_lens(const Lens& lens, const Scene& scene) {
  if (lens.ftheta) {
    CameraCalibration camera = lens.camera;
    try {
      set_ftheta(*lens.ftheta, "", "ftheta_param.", &camera);
      if (lens.windshield)
        set_windshield(*lens.windshield, "", "bivariate_windshield_model_param.", &camera);
    } catch (const InputError& error) {
      refuse(StatusCode::kInvalidArgument, error.field + " = " + error.value + ": " + error.rule);
    }
    return make_camera(camera);
  }
  if (lens.camera.model.empty()) {
    const int index = scene.camera_index(lens.camera.name);
    if (index >= 0) return scene.rig[index].camera;
    std::vector<std::string> names;
    for (const RigCamera& rig : scene.rig) names.push_back(rig.name);
    refuse(StatusCode::kInvalidArgument,
           "camera_intrinsics has no lens, and logical_id = " + lens.camera.name + " is " +
               unknown_name(lens.camera.name, names));
  }
  const CameraModelInfo& model = *find_camera_model(lens.camera.model);
  const auto check = [](std::string_view name, double value, double min, double max) {
    if (!(value >= min && value <= max))
      refuse(StatusCode::kInvalidArgument, std::string(name) + " = " + std::to_string(value) +
                                               ": must be in " + std::to_string(min) + ".." +
                                               std::to_string(max));
  };
  constexpr double kMost_px = 1e6;
  const std::vector<double>& p = lens.camera.parameters;
  check("focal_length_x", p.at(0), 1e-3, kMost_px);
  check("focal_length_y", p.at(1), 1e-3, kMost_px);
  check("principal_point_x", p.at(2), -kMost_px, kMost_px);
  check("principal_point_y", p.at(3), -kMost_px, kMost_px);
  for (std::size_t k = 0; k < model.distortion.size(); ++k)
    check(model.distortion[k].name, p.at(4 + k), model.distortion[k].min, model.distortion[k].max);
  return make_camera(lens.camera);
}

/// Returns the camera at the size of the image.
Camera camera_of(const ImageQuery& query, const Scene& scene) {
  constexpr int kMostSide = 16384;
  Camera camera = camera_of_lens(query.lens, scene);
  const int width = query.width > 0 ? query.width : camera.width,
            height = query.height > 0 ? query.height : camera.height;
  if (width < 1 || height < 1 || width > kMostSide || height > kMostSide ||
      std::size_t{3} * width * height > kMaxReplyBytes - kImageFields)
    refuse(width < 1 || height < 1 ? StatusCode::kInvalidArgument : StatusCode::kResourceExhausted,
           "resolution = " + std::to_string(width) + " x " + std::to_string(height) +
               ": must be 1 to 16384 pixels a side, and 64 MiB in all");
  if (camera.width > 0 && camera.height > 0 && (width != camera.width || height != camera.height)) {
    const double by_x = static_cast<double>(width) / camera.width,
                 by_y = static_cast<double>(height) / camera.height;
    camera.fx *= by_x;
    camera.fy *= by_y;
    camera.cx = (camera.cx + 0.5) * by_x - 0.5;
    camera.cy = (camera.cy + 0.5) * by_y - 0.5;
  }
  camera.width = width;
  camera.height = height;
  return camera;
}

/// Sets poses and readout of a shutter.
void expose(const ImageQuery& query, ImageRequest* request) {
  const PosePair& poses = query.local_from_sensor;
  const bool moves = poses.start.matrix() != poses.end.matrix();
  const std::int64_t readout_ns = query.end_ns - query.start_ns;
  request->camera.readout_by_column =
      query.lens.shutter == Shutter::kLeftToRight || query.lens.shutter == Shutter::kRightToLeft;
  switch (query.lens.shutter) {
    case Shutter::kRightToLeft:
    case Shutter::kBottomToTop:
      if (!moves) break;
      request->world_from_camera = {poses.end, poses.start};
      request->camera.readout_ns = -readout_ns;
      return;
    case Shutter::kUnknown:
    case Shutter::kLeftToRight:
    case Shutter::kTopToBottom:
      if (!moves) break;
      request->world_from_camera = {poses.start, poses.end};
      request->camera.readout_ns = readout_ns;
      return;
    case Shutter::kGlobal: break;
  }
  request->world_from_camera = {moves ? interpolate(poses.start, poses.end, 0.5) : poses.start};
}

Image8 rendered(const ImageQuery& query, OpenScene* open) {
  const Scene& scene = open->run->scene;
  check_time(query, scene);
  if (query.format != static_cast<int>(ImageFormat::kPng) &&
      query.format != static_cast<int>(ImageFormat::kJpeg) &&
      query.format != static_cast<int>(ImageFormat::kPlanar))
    refuse(StatusCode::kInvalidArgument, "image_format = " + std::to_string(query.format) +
                                             ": must be 1 (PNG), 2 (JPEG) or 4 (RGB_UINT8_PLANAR)");
  if (query.ego_mask)
    refuse(StatusCode::kInvalidArgument, "insert_ego_mask: the scene has no ego masks");
  if (!(query.quality >= 0 && query.quality <= 100))
    refuse(StatusCode::kInvalidArgument, "image_quality: must be in 0..100");
  ImageRequest request;
  request.camera.name = query.lens.camera.name;
  request.camera.camera = camera_of(query, scene);
  request.exposed_ns = query.start_ns + (query.end_ns - query.start_ns) / 2;
  expose(query, &request);
  if (const int index = scene.camera_index(request.camera.name); index >= 0)
    request.exposure = scene.exposure(index, request.exposed_ns - scene.rig[index].time_offset_ns);
  Scene placed;
  if (!query.objects.empty()) placed.actors = placed_objects(query, scene);
  const std::lock_guard lock(open->rendering);
  return to_image8(open->renderer.image(request, query.objects.empty() ? scene : placed));
}

std::string encoded(const Image8& image, int format, float quality) {
  if (format == static_cast<int>(ImageFormat::kPng)) return encode_png(image);
  if (format == static_cast<int>(ImageFormat::kJpeg))
    return encode_jpeg(
        image, quality > 0 ? std::max(1, static_cast<int>(std::lround(quality))) : kUsualQuality);
  const std::size_t pixels = image.rgb.size() / 3;
  std::string planes(image.rgb.size(), '\0');
  for (std::size_t i = 0; i < pixels; ++i)
    for (std::size_t k = 0; k < 3; ++k)
      planes[k * pixels + i] = static_cast<char>(image.rgb[3 * i + k]);
  return planes;
}

/// Returns the firings of a sensor's revolution, spread evenly over the frame.
LidarFirings firings_during(const LidarSensor& sensor, const ScanQuery& query) {
  LidarFirings firings = sensor.revolution(0);
  const auto first = static_cast<double>(firings.t_ns.front()),
             lasts = std::max(1.0, static_cast<double>(firings.t_ns.back()) - first),
             frame = static_cast<double>(query.end_ns - query.start_ns);
  for (std::int64_t& t_ns : firings.t_ns)
    t_ns = query.start_ns + std::llround((static_cast<double>(t_ns) - first) / lasts * frame);
  return firings;
}

}  // namespace

std::vector<SceneCamera> RunService::cameras(const std::string& scene) {
  return answered([&] {
    const std::shared_ptr<OpenScene> open = store_.get(scene);
    std::vector<SceneCamera> cameras;
    for (const RigCamera& rig : open->run->scene.rig) {
      SceneCamera one{{calibration_of(*open->run, rig)}, {}};
      one.lens.shutter = rig.readout_ns == 0 ? Shutter::kGlobal
                         : rig.readout_ns > 0
                             ? rig.readout_by_column ? Shutter::kLeftToRight : Shutter::kTopToBottom
                         : rig.readout_by_column ? Shutter::kRightToLeft
                                                 : Shutter::kBottomToTop;
      if (const auto* fisheye = std::get_if<OpenCvFisheye>(&rig.camera.model))
        one.lens.max_angle_rad = fisheye->max_angle_rad;
      one.lens.ftheta = ftheta_intrinsics(one.lens.camera);
      one.lens.windshield = windshield_polynomials(one.lens.camera);
      one.rig_from_camera = rig.body_from_sensor;
      cameras.push_back(std::move(one));
    }
    return cameras;
  });
}

std::vector<TimedPose> RunService::trajectory(const std::string& scene) {
  return answered([&] {
    const std::shared_ptr<OpenScene> open = store_.get(scene);
    std::vector<TimedPose> poses;
    for (const FramePose& pose : open->run->scene.trajectory)
      poses.push_back({pose.t_ns, open->run->scene.world_from_body(pose.t_ns)});
    return poses;
  });
}

std::vector<ImageAnswer> RunService::images(std::span<const ImageQuery> queries,
                                            const Cancelled& cancelled) {
  std::vector<ImageAnswer> answers(queries.size());
  std::vector<std::future<std::string>> encoding(queries.size());
  std::size_t collected = 0, bytes = 0;
  const auto collect = [&] {
    if (encoding[collected].valid()) answers[collected].bytes = encoding[collected].get();
    bytes += answers[collected].bytes.size() + kImageFields;
    if (bytes > kMaxReplyBytes)
      refuse(StatusCode::kResourceExhausted, "the images exceed 64 MiB together");
    ++collected;
  };
  for (std::size_t i = 0; i < queries.size(); ++i) {
    check_cancelled(cancelled);
    const ImageQuery& query = queries[i];
    try {
      Image8 image = answered([&] { return rendered(query, store_.get(query.scene).get()); });
      encoding[i] = std::async(queries.size() > 1 ? std::launch::async : std::launch::deferred,
                               [image = std::move(image), &query] {
                                 return encoded(image, query.format, query.quality);
                               });
    } catch (const RequestError& error) {
      answers[i] = {error.code, error.what()};
    }
    if (i + 1 - collected >= kMaxEncoding) collect();
  }
  while (collected < queries.size()) collect();
  return answers;
}

ScanAnswer RunService::scan(const ScanQuery& query, const Cancelled& cancelled) {
  return answered([&] {
    check_cancelled(cancelled);
    const std::shared_ptr<OpenScene> open = store_.get(query.scene);
    const Run& run = *open->run;
    if (!run.scene.metric)
      refuse(StatusCode::kFailedPrecondition, "photographs have neither metres nor times");
    check_time(query, run.scene);
    const auto& known = known_lidar_sensors();
    const auto sensor = std::ranges::find(known, query.sensor, &LidarSensor::name);
    REDRIVE_CHECK(sensor != known.end());
    const PosePair& poses = query.local_from_sensor;
    Scene motion;  // whose body is the sensor
    motion.trajectory = {{0, query.start_ns, poses.start},
                         {1, std::max(query.end_ns, query.start_ns + 1), poses.end}};
    motion.actors = query.objects.empty() ? run.scene.actors : placed_objects(query, run.scene);
    const LidarFirings firings = firings_during(*sensor, query);
    const ScanOptions options{.min_range_m = sensor->min_range_m,
                              .max_range_m = sensor->max_range_m,
                              .axes = PointAxes::kWorld,
                              .seed = {}};
    LidarScan scan;
    {
      const std::lock_guard lock(open->rendering);
      scan = render_scan(open->renderer.backend(), *run.field(), firings, SensorMotion{motion},
                         options);
    }
    const Rigid3d sensor_from_local = poses.end.inverse(Eigen::Isometry);
    ScanAnswer answer;
    for (const LidarRecord& point : scan.points) {
      const Eigen::Vector3f at = (sensor_from_local * point.position_m).cast<float>();
      answer.xyz.insert(answer.xyz.end(), at.data(), at.data() + 3);
      answer.intensity.push_back(std::clamp(point.intensity, 0.0f, 1.0f));
    }
    return answer;
  });
}

}  // namespace redrive::serve
