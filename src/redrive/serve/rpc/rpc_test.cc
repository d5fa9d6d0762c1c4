// SPDX-License-Identifier: Apache-2.0
// Messages and the server, over loopback, with a service that answers by rule.
#include <atomic>
#include <chrono>
#include <functional>
#include <random>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <google/protobuf/stubs/logging.h>

#include "redrive/serve/rpc/rpc_client_testing.h"

namespace redrive::serve {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// Keeps the last query; its images are the names of their cameras, and "bad" has none.
class MadeService : public SensorService {
 public:
  std::vector<std::string> scenes() const override { return {"a", "b"}; }
  std::vector<std::string> loaded_scenes() const override { return {"b"}; }
  std::vector<SceneCamera> cameras(const std::string& scene) override {
    if (scene != "a") throw RequestError(StatusCode::kNotFound, "scene_id = " + scene);
    SceneCamera camera;
    camera.lens.camera = {"front", "opencv_rational", {9, 8, 4.5, 3.5, 1, 2, 7, 8, 3, 4, 5, 6}};
    camera.lens.camera.width = 10;
    camera.lens.camera.height = 6;
    camera.lens.shutter = Shutter::kBottomToTop;
    camera.rig_from_camera.translation() << 1, 2, 3;
    return {camera, {{{"odd", "mei", std::vector<double>(9)}}, Rigid3d::Identity()}};
  }
  std::vector<TimedPose> trajectory(const std::string&) override {
    return {{5'000'000, Rigid3d::Identity()}, {6'000'000, Rigid3d::Identity()}};
  }
  std::vector<ImageAnswer> images(std::span<const ImageQuery> queries,
                                  const Cancelled& cancelled) override {
    std::vector<ImageAnswer> answers;
    for (const ImageQuery& query : queries) {
      image = query;
      answers.push_back(
          {query.lens.camera.name == "bad" ? StatusCode::kOutOfRange : StatusCode::kOk,
           query.lens.camera.name});
    }
    ++in_work;
    while (holds && !cancelled()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    if (cancelled()) ++stopped;
    --in_work;
    return answers;
  }
  ScanAnswer scan(const ScanQuery& query, const Cancelled&) override {
    last_scan = query;
    return {{1, 2, 3, 4, 5, 6}, {0.25f, 1}};
  }

  ImageQuery image;
  ScanQuery last_scan;
  std::atomic<bool> holds{false};
  std::atomic<int> in_work{0}, stopped{0};
};

void set_pose(double x, sensorsim::Pose* pose) {
  pose->mutable_vec()->set_x(static_cast<float>(x));
  pose->mutable_quat()->set_w(1);
}

sensorsim::ImageRequest image_request(const std::string& camera = "front") {
  sensorsim::ImageRequest request;
  request.set_scene_id("a");
  request.set_resolution_w(20);
  request.set_resolution_h(12);
  sensorsim::CameraSpec* const spec = request.mutable_camera_intrinsics();
  spec->set_logical_id(camera);
  spec->set_resolution_w(10);
  spec->set_resolution_h(6);
  spec->set_shutter_type(1);
  spec->mutable_opencv_pinhole_param()->set_focal_length_x(9);
  spec->mutable_opencv_pinhole_param()->set_principal_point_x(5);
  for (const double k : {1, 2, 3}) spec->mutable_opencv_pinhole_param()->add_radial_coeffs(k);
  request.set_frame_start_us(5000);
  request.set_frame_end_us(6000);
  set_pose(1, request.mutable_sensor_pose()->mutable_start_pose());
  set_pose(2, request.mutable_sensor_pose()->mutable_end_pose());
  sensorsim::DynamicObject* const object = request.add_dynamic_objects();
  object->set_track_id("7");
  *object->mutable_pose_pair() = request.sensor_pose();
  request.set_image_format(1);
  return request;
}

class RpcTest : public ::testing::Test {
 protected:
  RpcTest() : server_(redrive_start_grpc({.version = "1.2"}, &service_)) {}

  MadeService service_;
  std::unique_ptr<RpcServer> server_;
};

TEST_F(RpcTest, AnswersUnderEveryName) {
  for (const std::string_view name : kServiceNames) {
    const RpcClient client(server_->port(), name);
    sensorsim::Version version;
    ASSERT_TRUE(client.call("get_version", sensorsim::Scenes(), &version).ok());
    EXPECT_EQ(version.version_id(), "redrive 1.2");
    sensorsim::Scenes scenes;
    ASSERT_TRUE(client.call("get_available_scenes", scenes, &scenes).ok());
    EXPECT_THAT(scenes.scene_ids(), ElementsAre("a", "b"));
  }
  sensorsim::Scenes any;
  const grpc::Status status = RpcClient(server_->port()).call("get_server_config", any, &any);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::UNIMPLEMENTED);
  EXPECT_THAT(status.error_message(), HasSubstr("get_server_config"));
}

TEST_F(RpcTest, SaysThatItIsHealthy) {
  const RpcClient client(server_->port(), "grpc.health.v1.Health");
  sensorsim::OfScene service;  // field 1 is a string there, too; the reply's is 1: serving
  service.set_scene_id(std::string(kServiceNames[1]));
  sensorsim::LidarSpec unused;
  grpc::Status status = client.call("Check", service, &unused);
  EXPECT_TRUE(status.ok()) << status.error_message();
  EXPECT_EQ(unused.SerializeAsString(), std::string("\x08\x01"));
  service.set_scene_id("other");
  EXPECT_EQ(client.call("Check", service, &unused).error_code(), grpc::StatusCode::NOT_FOUND);
}

TEST_F(RpcTest, DescribesScenes) {
  const RpcClient client(server_->port());
  sensorsim::OfScene scene;
  scene.set_scene_id("a");
  sensorsim::Cameras cameras;
  ASSERT_TRUE(client.call("get_available_cameras", scene, &cameras).ok());
  ASSERT_EQ(cameras.available_cameras_size(), 2);
  const auto& front = cameras.available_cameras(0);
  EXPECT_EQ(front.rig_to_camera().vec().y(), 2);
  EXPECT_EQ(front.intrinsics().opencv_pinhole_param().principal_point_x(), 5);
  EXPECT_THAT(front.intrinsics().opencv_pinhole_param().radial_coeffs(),
              ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_THAT(front.intrinsics().opencv_pinhole_param().tangential_coeffs(), ElementsAre(7, 8));
  EXPECT_EQ(front.intrinsics().shutter_type(), 3u);
  EXPECT_EQ(cameras.available_cameras(1).logical_id(), "odd");
  EXPECT_EQ(cameras.available_cameras(1).intrinsics().camera_param_case(),
            sensorsim::CameraSpec::CAMERA_PARAM_NOT_SET);

  sensorsim::Trajectories trajectories;
  ASSERT_TRUE(client.call("get_available_trajectories", scene, &trajectories).ok());
  EXPECT_EQ(trajectories.available_trajectories(0).trajectory().poses(1).timestamp_us(), 6000u);
  sensorsim::LoadedScenes loaded;
  ASSERT_TRUE(client.call("get_loaded_scenes", scene, &loaded).ok());
  EXPECT_EQ(loaded.scenes(0).scene_id(), "b");
  EXPECT_TRUE(client.call("get_available_ego_masks", scene, &loaded).ok());
  scene.set_scene_id("c");
  const grpc::Status status = client.call("get_available_cameras", scene, &cameras);
  EXPECT_EQ(status.error_code(), grpc::StatusCode::NOT_FOUND);
  EXPECT_EQ(status.error_message(), "scene_id = c");
}

TEST_F(RpcTest, ReadsRequests) {
  const RpcClient client(server_->port());
  sensorsim::ImageReply reply;
  ASSERT_TRUE(client.call("render_rgb", image_request(), &reply).ok());
  EXPECT_EQ(reply.image_bytes(), "front");
  const ImageQuery& query = service_.image;
  EXPECT_EQ(query.scene, "a");
  EXPECT_EQ(query.width, 20);
  EXPECT_EQ(query.start_ns, 5'000'000);
  EXPECT_EQ(query.end_ns, 6'000'000);
  EXPECT_EQ(query.lens.camera.model, "opencv_pinhole");
  EXPECT_THAT(query.lens.camera.parameters, ElementsAre(9, 0, 4.5, -0.5, 1, 2, 0, 0, 3));
  EXPECT_EQ(query.lens.shutter, Shutter::kTopToBottom);
  EXPECT_EQ(query.local_from_sensor.end.translation().x(), 2);
  ASSERT_EQ(query.objects.size(), 1u);
  EXPECT_EQ(query.objects[0].track, "7");
  EXPECT_EQ(query.objects[0].local_from_box.start.translation().x(), 1);

  sensorsim::ImageRequest prism = image_request();
  prism.mutable_camera_intrinsics()->mutable_opencv_pinhole_param()->add_thin_prism_coeffs(0.5);
  ASSERT_TRUE(client.call("render_rgb", prism, &reply).ok());
  EXPECT_EQ(service_.image.lens.camera.model, "opencv_thin_prism");
  EXPECT_THAT(service_.image.lens.camera.parameters,
              ElementsAre(9, 0, 4.5, -0.5, 1, 2, 0, 0, 3, 0, 0, 0, 0.5, 0, 0, 0));

  sensorsim::ScanRequest scan;
  scan.mutable_lidar_config()->set_lidar_type(1);
  *scan.mutable_sensor_pose() = image_request().sensor_pose();
  sensorsim::ScanReply points;
  ASSERT_TRUE(client.call("render_lidar", scan, &points).ok());
  EXPECT_EQ(service_.last_scan.sensor, "at128");
  EXPECT_EQ(points.num_points(), 2u);
  EXPECT_THAT(points.point_xyzs(), ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_EQ(points.point_intensities_buffer().size(), 8u);
}

TEST_F(RpcTest, ReadsFThetaLenses) {
  sensorsim::ImageRequest request = image_request();
  sensorsim::FTheta* const lens = request.mutable_camera_intrinsics()->mutable_ftheta_param();
  lens->set_principal_point_x(9.5);
  lens->set_reference_poly(2);
  for (const double k : {0.0, 8.0, 4.0}) lens->add_angle_to_pixeldist_poly(k);
  lens->mutable_linear_cde()->set_linear_c(2);
  lens->mutable_linear_cde()->set_linear_d(0.5);
  lens->set_max_angle(1.5);
  sensorsim::Windshield* const glass =
      request.mutable_camera_intrinsics()->mutable_bivariate_windshield_model_param();
  glass->set_reference_poly(1);
  for (const double k : {0.1, 0.9, 0.2}) glass->add_horizontal_poly_inverse(k);
  sensorsim::ImageReply reply;
  ASSERT_TRUE(RpcClient(server_->port()).call("render_rgb", request, &reply).ok());
  const std::optional<FThetaIntrinsics>& read = service_.image.lens.ftheta;
  ASSERT_TRUE(read);
  EXPECT_FALSE(read->angle_is_reference);
  EXPECT_THAT(read->angle_to_pixeldist, ElementsAre(0, 8, 4));
  EXPECT_EQ(read->cx, 9.5);
  EXPECT_EQ(read->d, 0.5);
  EXPECT_EQ(read->max_angle_rad, 1.5);
  const std::optional<WindshieldPolynomials>& windshield = service_.image.lens.windshield;
  ASSERT_TRUE(windshield);
  EXPECT_THAT(windshield->horizontal_inverse, ElementsAre(0.1, 0.9, 0.2));
}

TEST_F(RpcTest, RefusesByName) {
  const RpcClient client(server_->port());
  using Change = std::function<void(sensorsim::ImageRequest&)>;
  const std::vector<std::tuple<Change, grpc::StatusCode, const char*>> cases = {
      {[](auto& r) { r.mutable_camera_intrinsics()->mutable_ftheta_param(); },
       grpc::StatusCode::INVALID_ARGUMENT, "ftheta_param.reference_poly"},
      {[](auto& r) { r.mutable_camera_intrinsics()->mutable_bivariate_windshield_model_param(); },
       grpc::StatusCode::UNIMPLEMENTED, "windshield"},
      {[](auto& r) {
         sensorsim::CameraSpec* const lens = r.mutable_camera_intrinsics();
         lens->mutable_ftheta_param()->set_reference_poly(2);
         lens->mutable_bivariate_windshield_model_param()->set_reference_poly(2);
       },
       grpc::StatusCode::INVALID_ARGUMENT, "bivariate_windshield_model_param.reference_poly"},
      {[](auto& r) {
         for (int k = 0; k < 5; ++k)
           r.mutable_camera_intrinsics()->mutable_opencv_pinhole_param()->add_thin_prism_coeffs(1);
       },
       grpc::StatusCode::INVALID_ARGUMENT, "thin_prism_coeffs"},
      {[](auto& r) { r.mutable_camera_intrinsics()->set_shutter_type(9); },
       grpc::StatusCode::INVALID_ARGUMENT, "shutter_type"},
      {[](auto& r) { r.clear_sensor_pose(); }, grpc::StatusCode::INVALID_ARGUMENT, "sensor_pose"},
      {[](auto& r) { r.mutable_sensor_pose()->mutable_end_pose()->mutable_quat()->set_w(3); },
       grpc::StatusCode::INVALID_ARGUMENT, "sensor_pose.end_pose.quat"},
      {[](auto& r) { r.mutable_sensor_pose()->mutable_end_pose()->mutable_vec()->set_z(NAN); },
       grpc::StatusCode::INVALID_ARGUMENT, "sensor_pose.end_pose.vec"},
      {[](auto& r) { r.mutable_dynamic_objects(0)->clear_pose_pair(); },
       grpc::StatusCode::INVALID_ARGUMENT, "dynamic_objects[7].pose_pair"},
      {[](auto& r) { r.set_frame_end_us(~std::uint64_t{0}); }, grpc::StatusCode::INVALID_ARGUMENT,
       "frame_end_us"},
      {[](auto& r) { r.mutable_camera_intrinsics()->set_logical_id("bad"); },
       grpc::StatusCode::OUT_OF_RANGE, "bad"}};
  for (const auto& [change, code, text] : cases) {
    sensorsim::ImageRequest request = image_request();
    change(request);
    sensorsim::ImageReply reply;
    const grpc::Status status = client.call("render_rgb", request, &reply);
    EXPECT_EQ(status.error_code(), code) << text << ": " << status.error_message();
    EXPECT_THAT(status.error_message(), HasSubstr(text));
  }
}

TEST_F(RpcTest, AnItemOfABatchFailsAlone) {
  sensorsim::BatchRequest request;
  for (const char* name : {"front", "bad", "ftheta"}) {
    request.add_items()->set_camera_name(name);
    *request.mutable_items(request.items_size() - 1)->mutable_request() = image_request(name);
  }
  request.mutable_items(2)->mutable_request()->mutable_camera_intrinsics()->mutable_ftheta_param();
  sensorsim::BatchReply reply;
  const RpcClient client(server_->port());
  ASSERT_TRUE(client.call("batch_render_rgb", request, &reply).ok());
  EXPECT_TRUE(reply.items(0).success());
  EXPECT_EQ(reply.items(0).result().image_bytes(), "front");
  EXPECT_FALSE(reply.items(1).success());
  EXPECT_EQ(reply.items(1).error_message(), "bad");
  EXPECT_THAT(reply.items(2).error_message(), HasSubstr("ftheta_param"));

  sensorsim::AggregatedRequest bundle;
  *bundle.add_rgb_requests() = image_request();
  *bundle.add_lidar_requests()->mutable_sensor_pose() = image_request().sensor_pose();
  sensorsim::AggregatedReply both;
  ASSERT_TRUE(client.call("render_aggregated", bundle, &both).ok());
  EXPECT_EQ(both.rgb_returns(0).image_bytes(), "front");
  EXPECT_EQ(both.lidar_returns(0).num_points(), 2u);
  for (int i = 0; i < 1000; ++i) bundle.add_rgb_requests();
  EXPECT_EQ(client.call("render_aggregated", bundle, &both).error_code(),
            grpc::StatusCode::RESOURCE_EXHAUSTED);
}

template <class Condition>
bool eventually(const Condition& condition) {
  for (int i = 0; i < 5000 && !condition(); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  return condition();
}

TEST_F(RpcTest, StopsWhatAClientCancels) {
  service_.holds = true;
  const RpcClient client(server_->port());
  grpc::ClientContext context;
  std::thread caller([&] {
    sensorsim::ImageReply reply;
    EXPECT_EQ(client.call("render_rgb", image_request(), &reply, &context).error_code(),
              grpc::StatusCode::CANCELLED);
  });
  EXPECT_TRUE(eventually([&] { return service_.in_work == 1; }));
  context.TryCancel();
  caller.join();
  EXPECT_TRUE(eventually([&] { return service_.stopped == 1; }));
}

TEST_F(RpcTest, RefusesWhatItCannotQueue) {
  service_.holds = true;
  const RpcClient client(server_->port());
  std::atomic<int> refused{0}, answered{0};
  std::vector<std::thread> callers;
  for (int i = 0; i < 100; ++i)
    callers.emplace_back([&] {
      sensorsim::ImageReply reply;
      const grpc::Status status = client.call("render_rgb", image_request(), &reply);
      ++(status.ok() ? answered : refused);
      EXPECT_TRUE(status.ok() || status.error_code() == grpc::StatusCode::RESOURCE_EXHAUSTED);
    });
  EXPECT_TRUE(eventually([&] { return refused >= 100 - 64 - 4; }));
  service_.holds = false;
  for (std::thread& caller : callers) caller.join();
  EXPECT_GE(answered, 64);
}

TEST_F(RpcTest, TakesMalformedMessages) {
  const std::string valid = [] {
    sensorsim::BatchRequest batch;
    *batch.add_items()->mutable_request() = image_request();
    return batch.SerializeAsString();
  }();
  std::mt19937 random(1);
  google::protobuf::SetLogHandler(nullptr);
  int wrong = 0;
  for (int i = 0; i < 3000; ++i) {
    std::string bytes = valid.substr(0, 1 + random() % valid.size());
    for (unsigned k = random() % 4; k-- > 0;)
      bytes[random() % bytes.size()] = static_cast<char>(random());
    for (const char* method : {"batch_render_rgb", "render_rgb", "render_aggregated",
                               "render_lidar", "get_available_cameras"})
      try {
        answer_call("/" + std::string(kServiceNames[0]) + "/" + method, bytes, {}, &service_,
                    [] { return false; });
      } catch (const RequestError&) {
        ++wrong;
      }
  }
  EXPECT_GT(wrong, 3000);
}

}  // namespace
}  // namespace redrive::serve
