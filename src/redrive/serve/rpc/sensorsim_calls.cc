// SPDX-License-Identifier: Apache-2.0
#include "redrive/serve/rpc/sensorsim_calls.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <map>
#include <utility>

#include "redrive/camera/lenses/opencv_coefficients.h"
#include "sensorsim.pb.h"

namespace redrive::serve {
namespace {

static_assert(std::endian::native == std::endian::little, "buffers of points are little endian");

constexpr std::int64_t kNanoseconds = 1000;  // a microsecond has
constexpr std::uint32_t kApi[] = {0, 1, 0};

[[noreturn]] void refuse(const std::string& field, const std::string& value,
                         const std::string& rule) {
  throw RequestError(StatusCode::kInvalidArgument,
                     field + (value.empty() ? "" : " = " + value) + ": " + rule);
}

std::int64_t time_of(std::uint64_t us, const char* field) {
  constexpr std::uint64_t kMost_us = std::uint64_t{1} << 53;  // the year 2255
  if (us > kMost_us) refuse(field, std::to_string(us), "must be microseconds, at most 2^53");
  return static_cast<std::int64_t>(us) * kNanoseconds;
}

Rigid3d pose_of(const sensorsim::Pose& pose, const std::string& field) {
  constexpr double kMostAway_m = 1e6, kNorm = 1e-2;
  const Eigen::Vector3d at(pose.vec().x(), pose.vec().y(), pose.vec().z());
  const Eigen::Quaterniond turn(pose.quat().w(), pose.quat().x(), pose.quat().y(), pose.quat().z());
  if (!(at.cwiseAbs().maxCoeff() <= kMostAway_m) || !at.allFinite())
    refuse(field + ".vec", "", "must be metres, at most 1e6");
  if (!(std::abs(turn.norm() - 1) <= kNorm))
    refuse(field + ".quat", "", "must be a unit quaternion");
  Rigid3d out = Rigid3d::Identity();
  out.linear() = turn.normalized().toRotationMatrix();
  out.translation() = at;
  return out;
}

PosePair pair_of(bool given, const sensorsim::PosePair& pair, const std::string& field) {
  if (!given || !pair.has_start_pose() || !pair.has_end_pose())
    refuse(field, "", "must have start_pose and end_pose");
  return {pose_of(pair.start_pose(), field + ".start_pose"),
          pose_of(pair.end_pose(), field + ".end_pose")};
}

void write_pose(const Rigid3d& pose, sensorsim::Pose* out) {
  const Eigen::Quaterniond turn(pose.linear());
  out->mutable_vec()->set_x(static_cast<float>(pose.translation().x()));
  out->mutable_vec()->set_y(static_cast<float>(pose.translation().y()));
  out->mutable_vec()->set_z(static_cast<float>(pose.translation().z()));
  out->mutable_quat()->set_w(static_cast<float>(turn.w()));
  out->mutable_quat()->set_x(static_cast<float>(turn.x()));
  out->mutable_quat()->set_y(static_cast<float>(turn.y()));
  out->mutable_quat()->set_z(static_cast<float>(turn.z()));
}

/// Returns `n` coefficients, 0 where fewer were given.
template <class Given>
std::vector<double> coefficients(const Given& given, int n, const char* field) {
  if (given.size() > n)
    refuse(field, std::to_string(given.size()) + " numbers",
           "must have at most " + std::to_string(n));
  std::vector<double> all(given.begin(), given.end());
  all.resize(static_cast<std::size_t>(n));
  return all;
}

/// Returns fx, fy, cx, cy.
template <class Params>
std::vector<double> focal_and_centre(const Params& p) {
  return {p.focal_length_x(), p.focal_length_y(), p.principal_point_x() - 0.5,
          p.principal_point_y() - 0.5};
}

template <class Params>
void write_focal_and_centre(const CameraCalibration& camera, Params* p) {
  p->set_focal_length_x(camera.fx());
  p->set_focal_length_y(camera.fy());
  p->set_principal_point_x(camera.cx() + 0.5);
  p->set_principal_point_y(camera.cy() + 0.5);
}

void read_pinhole(const sensorsim::Pinhole& p, CameraCalibration* camera) {
  const std::vector<double> k = coefficients(p.radial_coeffs(), 6, "radial_coeffs"),
                            t = coefficients(p.tangential_coeffs(), 2, "tangential_coeffs"),
                            s = coefficients(p.thin_prism_coeffs(), 4, "thin_prism_coeffs");
  camera->parameters = focal_and_centre(p);
  set_opencv_coefficients({k[0], k[1], t[0], t[1], k[2], k[3], k[4], k[5], s[0], s[1], s[2], s[3]},
                          camera);
}

void read_fisheye(const sensorsim::Fisheye& p, CameraCalibration* camera) {
  camera->model = "opencv_fisheye";
  camera->parameters = focal_and_centre(p);
  for (const double k : coefficients(p.radial_coeffs(), 4, "radial_coeffs"))
    camera->parameters.push_back(k);
}

enum ReferencePolynomial { kPixeldistToAngle = 1, kAngleToPixeldist = 2 };

FThetaIntrinsics read_ftheta(const sensorsim::FTheta& p) {
  if (p.reference_poly() != kPixeldistToAngle && p.reference_poly() != kAngleToPixeldist)
    refuse("ftheta_param.reference_poly", std::to_string(p.reference_poly()), "must be 1 or 2");
  FThetaIntrinsics lens{.cx = p.principal_point_x(),
                        .cy = p.principal_point_y(),
                        .angle_is_reference = p.reference_poly() == kPixeldistToAngle,
                        .max_angle_rad = p.max_angle()};
  lens.pixeldist_to_angle.assign(p.pixeldist_to_angle_poly().begin(),
                                 p.pixeldist_to_angle_poly().end());
  lens.angle_to_pixeldist.assign(p.angle_to_pixeldist_poly().begin(),
                                 p.angle_to_pixeldist_poly().end());
  if (p.has_linear_cde()) {
    lens.c = p.linear_cde().linear_c();
    lens.d = p.linear_cde().linear_d();
    lens.e = p.linear_cde().linear_e();
  }
  return lens;
}

void write_ftheta(const FThetaIntrinsics& lens, sensorsim::FTheta* p) {
  p->set_principal_point_x(lens.cx);
  p->set_principal_point_y(lens.cy);
  p->set_reference_poly(lens.angle_is_reference ? kPixeldistToAngle : kAngleToPixeldist);
  for (const double k : lens.pixeldist_to_angle) p->add_pixeldist_to_angle_poly(k);
  for (const double k : lens.angle_to_pixeldist) p->add_angle_to_pixeldist_poly(k);
  p->set_max_angle(lens.max_angle_rad);
  p->mutable_linear_cde()->set_linear_c(lens.c);
  p->mutable_linear_cde()->set_linear_d(lens.d);
  p->mutable_linear_cde()->set_linear_e(lens.e);
}

WindshieldPolynomials read_windshield(const sensorsim::Windshield& p) {
  if (p.reference_poly() > 1)
    refuse("bivariate_windshield_model_param.reference_poly", std::to_string(p.reference_poly()),
           "must be 0 or 1");
  WindshieldPolynomials glass;
  const auto copy = [](const auto& from, std::vector<double>* to) {
    to->assign(from.begin(), from.end());
  };
  copy(p.horizontal_poly(), &glass.horizontal);
  copy(p.vertical_poly(), &glass.vertical);
  copy(p.horizontal_poly_inverse(), &glass.horizontal_inverse);
  copy(p.vertical_poly_inverse(), &glass.vertical_inverse);
  return glass;
}

void write_windshield(const WindshieldPolynomials& glass, sensorsim::Windshield* p) {
  for (const double k : glass.horizontal) p->add_horizontal_poly(k);
  for (const double k : glass.vertical) p->add_vertical_poly(k);
  for (const double k : glass.horizontal_inverse) p->add_horizontal_poly_inverse(k);
  for (const double k : glass.vertical_inverse) p->add_vertical_poly_inverse(k);
}

Lens lens_of(const sensorsim::CameraSpec& spec) {
  Lens lens;
  lens.camera.name = spec.logical_id();
  switch (spec.camera_param_case()) {
    case sensorsim::CameraSpec::kFthetaParam: lens.ftheta = read_ftheta(spec.ftheta_param()); break;
    case sensorsim::CameraSpec::kOpencvPinholeParam:
      read_pinhole(spec.opencv_pinhole_param(), &lens.camera);
      break;
    case sensorsim::CameraSpec::kOpencvFisheyeParam:
      read_fisheye(spec.opencv_fisheye_param(), &lens.camera);
      break;
    case sensorsim::CameraSpec::CAMERA_PARAM_NOT_SET: break;
  }
  if (spec.has_bivariate_windshield_model_param()) {
    if (!lens.ftheta)
      throw RequestError(StatusCode::kUnimplemented,
                         "bivariate_windshield_model_param: windshields are modelled before "
                         "ftheta_param alone");
    lens.windshield = read_windshield(spec.bivariate_windshield_model_param());
  }
  lens.camera.width = static_cast<int>(std::min(spec.resolution_w(), 1u << 20));
  lens.camera.height = static_cast<int>(std::min(spec.resolution_h(), 1u << 20));
  if (spec.shutter_type() > static_cast<unsigned>(Shutter::kGlobal))
    refuse("shutter_type", std::to_string(spec.shutter_type()), "must be 0 to 5");
  lens.shutter = static_cast<Shutter>(spec.shutter_type());
  return lens;
}

/// Writes a lens; the parameters of models that the protocol does not have are left out.
void write_lens(const Lens& lens, sensorsim::CameraSpec* spec) {
  const CameraCalibration& camera = lens.camera;
  spec->set_logical_id(camera.name);
  spec->set_resolution_w(static_cast<std::uint32_t>(camera.width));
  spec->set_resolution_h(static_cast<std::uint32_t>(camera.height));
  spec->set_shutter_type(static_cast<std::uint32_t>(lens.shutter));
  if (const std::optional<OpenCvCoefficients> all = opencv_coefficients(camera)) {
    sensorsim::Pinhole* const out = spec->mutable_opencv_pinhole_param();
    write_focal_and_centre(camera, out);
    for (const std::size_t k : {0, 1, 4, 5, 6, 7}) out->add_radial_coeffs((*all)[k]);
    for (const std::size_t k : {2, 3}) out->add_tangential_coeffs((*all)[k]);
    for (const std::size_t k : {8, 9, 10, 11}) out->add_thin_prism_coeffs((*all)[k]);
  } else if (camera.model == "opencv_fisheye") {
    sensorsim::Fisheye* const out = spec->mutable_opencv_fisheye_param();
    write_focal_and_centre(camera, out);
    for (std::size_t k = 4; k < 8; ++k) out->add_radial_coeffs(camera.parameters.at(k));
    out->set_max_angle(lens.max_angle_rad);
  } else if (lens.ftheta) {
    write_ftheta(*lens.ftheta, spec->mutable_ftheta_param());
    if (lens.windshield)
      write_windshield(*lens.windshield, spec->mutable_bivariate_windshield_model_param());
  }
}

/// What images and scans have in common.
template <class Request>
void read_sensor(const Request& request, SensorQuery* query) {
  query->scene = request.scene_id();
  query->start_ns = time_of(request.frame_start_us(), "frame_start_us");
  query->end_ns = time_of(request.frame_end_us(), "frame_end_us");
  query->local_from_sensor =
      pair_of(request.has_sensor_pose(), request.sensor_pose(), "sensor_pose");
  for (const sensorsim::DynamicObject& object : request.dynamic_objects())
    query->objects.push_back(
        {object.track_id(), pair_of(object.has_pose_pair(), object.pose_pair(),
                                    "dynamic_objects[" + object.track_id() + "].pose_pair")});
}

ImageQuery image_query(const sensorsim::ImageRequest& request) {
  ImageQuery query;
  read_sensor(request, &query);
  query.lens = lens_of(request.camera_intrinsics());
  query.width = static_cast<int>(std::min(request.resolution_w(), 1u << 20));
  query.height = static_cast<int>(std::min(request.resolution_h(), 1u << 20));
  query.format = static_cast<int>(std::min(request.image_format(), 1000u));
  query.quality = request.image_quality();
  query.ego_mask = request.insert_ego_mask();
  return query;
}

ScanQuery scan_query(const sensorsim::ScanRequest& request) {
  constexpr const char* kSensors[] = {"pandar128", "at128"};
  ScanQuery query;
  read_sensor(request, &query);
  const std::uint32_t type = request.lidar_config().lidar_type();
  if (type >= std::size(kSensors))
    refuse("lidar_type", std::to_string(type), "must be 0 (PANDAR128) or 1 (AT128)");
  query.sensor = kSensors[type];
  return query;
}

void write_scan(const ScanAnswer& scan, sensorsim::ScanReply* reply) {
  const auto bytes = [](const std::vector<float>& v) {
    return std::string(reinterpret_cast<const char*>(v.data()), sizeof(float) * v.size());
  };
  reply->mutable_point_xyzs()->Add(scan.xyz.begin(), scan.xyz.end());
  reply->mutable_point_intensities()->Add(scan.intensity.begin(), scan.intensity.end());
  reply->set_num_points(static_cast<std::uint32_t>(scan.intensity.size()));
  reply->set_point_xyzs_buffer(bytes(scan.xyz));
  reply->set_point_intensities_buffer(bytes(scan.intensity));
}

void check_items(int items) {
  if (static_cast<std::size_t>(items) > kMaxItems)
    throw RequestError(StatusCode::kResourceExhausted,
                       std::to_string(items) + " images and scans: at most " +
                           std::to_string(kMaxItems) + " in a request");
}

struct Call {
  const std::string& bytes;
  const RpcOptions& options;
  SensorService& service;
  const Cancelled& cancelled;

  template <class Request>
  Request request() const {
    Request parsed;
    if (!parsed.ParseFromString(bytes))
      throw RequestError(StatusCode::kInvalidArgument, "the request is no message of this method");
    return parsed;
  }
};

std::string get_version(const Call& call) {
  sensorsim::Version reply;
  reply.set_version_id("redrive " + call.options.version);
  reply.mutable_grpc_api_version()->set_major(kApi[0]);
  reply.mutable_grpc_api_version()->set_minor(kApi[1]);
  reply.mutable_grpc_api_version()->set_patch(kApi[2]);
  return reply.SerializeAsString();
}

std::string get_available_scenes(const Call& call) {
  sensorsim::Scenes reply;
  for (std::string& id : call.service.scenes()) reply.add_scene_ids(std::move(id));
  return reply.SerializeAsString();
}

std::string get_loaded_scenes(const Call& call) {
  sensorsim::LoadedScenes reply;
  for (const std::string& id : call.service.loaded_scenes()) {
    sensorsim::LoadedScenes::Scene* const scene = reply.add_scenes();
    scene->set_scene_id(id);
    scene->set_loaded_instance_count(1);
    scene->set_reusable_instance_count(1);
  }
  reply.set_loaded_instance_capacity(static_cast<std::uint32_t>(call.service.scenes().size()));
  return reply.SerializeAsString();
}

std::string get_available_cameras(const Call& call) {
  sensorsim::Cameras reply;
  for (const SceneCamera& camera :
       call.service.cameras(call.request<sensorsim::OfScene>().scene_id())) {
    sensorsim::Cameras::Camera* const out = reply.add_available_cameras();
    write_lens(camera.lens, out->mutable_intrinsics());
    write_pose(camera.rig_from_camera, out->mutable_rig_to_camera());
    out->set_logical_id(camera.lens.camera.name);
  }
  return reply.SerializeAsString();
}

std::string get_available_trajectories(const Call& call) {
  sensorsim::Trajectories reply;
  sensorsim::Trajectory* const out = reply.add_available_trajectories()->mutable_trajectory();
  for (const TimedPose& pose :
       call.service.trajectory(call.request<sensorsim::OfScene>().scene_id())) {
    sensorsim::PoseAtTime* const one = out->add_poses();
    write_pose(pose.local_from_rig, one->mutable_pose());
    one->set_timestamp_us(static_cast<std::uint64_t>(pose.t_ns / kNanoseconds));
  }
  return reply.SerializeAsString();
}

/// Returns the message without masks.
std::string get_available_ego_masks(const Call&) { return {}; }

std::string render_rgb(const Call& call) {
  const ImageQuery query = image_query(call.request<sensorsim::ImageRequest>());
  ImageAnswer answer = std::move(call.service.images({&query, 1}, call.cancelled).at(0));
  if (answer.code != StatusCode::kOk) throw RequestError(answer.code, answer.bytes);
  sensorsim::ImageReply reply;
  reply.set_image_bytes(std::move(answer.bytes));
  return reply.SerializeAsString();
}

/// An image that cannot be made costs itself alone.
std::string batch_render_rgb(const Call& call) {
  const auto request = call.request<sensorsim::BatchRequest>();
  check_items(request.items_size());
  sensorsim::BatchReply reply;
  std::vector<ImageQuery> queries;
  std::vector<int> asked;
  for (int i = 0; i < request.items_size(); ++i) {
    sensorsim::BatchReply::Item* const out = reply.add_items();
    out->set_camera_name(request.items(i).camera_name());
    try {
      queries.push_back(image_query(request.items(i).request()));
      asked.push_back(i);
    } catch (const RequestError& error) {
      out->set_error_message(error.what());
    }
  }
  std::vector<ImageAnswer> answers = call.service.images(queries, call.cancelled);
  for (std::size_t k = 0; k < answers.size(); ++k) {
    sensorsim::BatchReply::Item* const out = reply.mutable_items(asked[k]);
    out->set_success(answers[k].code == StatusCode::kOk);
    if (out->success())
      out->mutable_result()->set_image_bytes(std::move(answers[k].bytes));
    else
      out->set_error_message(answers[k].bytes);
  }
  return reply.SerializeAsString();
}

std::string render_lidar(const Call& call) {
  sensorsim::ScanReply reply;
  write_scan(call.service.scan(scan_query(call.request<sensorsim::ScanRequest>()), call.cancelled),
             &reply);
  return reply.SerializeAsString();
}

std::string render_aggregated(const Call& call) {
  const auto request = call.request<sensorsim::AggregatedRequest>();
  check_items(request.rgb_requests_size() + request.lidar_requests_size());
  std::vector<ImageQuery> queries;
  for (const sensorsim::ImageRequest& image : request.rgb_requests())
    queries.push_back(image_query(image));
  sensorsim::AggregatedReply reply;
  for (ImageAnswer& answer : call.service.images(queries, call.cancelled)) {
    if (answer.code != StatusCode::kOk) throw RequestError(answer.code, answer.bytes);
    reply.add_rgb_returns()->set_image_bytes(std::move(answer.bytes));
  }
  for (const sensorsim::ScanRequest& scan : request.lidar_requests())
    write_scan(call.service.scan(scan_query(scan), call.cancelled), reply.add_lidar_returns());
  return reply.SerializeAsString();
}

using Method = std::string (*)(const Call&);

Method method_at(std::string_view path) {
  static const std::map<std::string_view, Method> kMethods = {
      {"get_version", get_version},
      {"get_available_scenes", get_available_scenes},
      {"get_loaded_scenes", get_loaded_scenes},
      {"get_available_cameras", get_available_cameras},
      {"get_available_trajectories", get_available_trajectories},
      {"get_available_ego_masks", get_available_ego_masks},
      {"render_rgb", render_rgb},
      {"batch_render_rgb", batch_render_rgb},
      {"render_lidar", render_lidar},
      {"render_aggregated", render_aggregated}};
  const std::size_t slash = path.rfind('/');
  if (path.starts_with('/') && slash > 0 &&
      std::ranges::count(kServiceNames, path.substr(1, slash - 1)) > 0)
    if (const auto found = kMethods.find(path.substr(slash + 1)); found != kMethods.end())
      return found->second;
  throw RequestError(StatusCode::kUnimplemented, std::string(path) + " is unknown");
}

}  // namespace

std::string answer_call(std::string_view path, const std::string& request,
                        const RpcOptions& options, SensorService* service,
                        const Cancelled& cancelled) {
  std::string reply = method_at(path)({request, options, *service, cancelled});
  if (reply.size() > kMaxReplyBytes)
    throw RequestError(StatusCode::kResourceExhausted, "the reply exceeds 64 MiB");
  return reply;
}

}  // namespace redrive::serve
