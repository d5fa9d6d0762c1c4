// SPDX-License-Identifier: Apache-2.0
// redrive serve as AlpaSim and CARLA use it, on a run of samples/street_traffic.
#include <stdlib.h>
#include <unistd.h>

#include <fstream>
#include <sstream>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/zip.h"
#include "redrive/image/png.h"
#include "redrive/render/open_to_render.h"
#include "redrive/serve/rpc/rpc_client_testing.h"
#include "redrive/serve/rpc_library.h"
#include "redrive/serve/run_service.h"
#include "tests/support/program.h"

namespace redrive::serve {
namespace {

namespace fs = std::filesystem;
using redrive::testing::Program;
using redrive::testing::ProgramResult;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::UnorderedElementsAre;

constexpr const char* kFront = "F_MIDLONGRANGECAM_CL";
constexpr std::uint64_t kMuch = std::uint64_t{1} << 40;

/// A folder with the scenes `one`, `two` and `three`, which are the same run.
class ServeTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    std::string name = (fs::temp_directory_path() / "redrive-serve-XXXXXX").string();
    folder_ = mkdtemp(name.data());
    const ProgramResult trained =
        Program(REDRIVE_BINARY,
                {"train", REDRIVE_SAMPLES "/street_traffic", "--downscale", "4", "--max-steps",
                 "60", "--truth-poses", "--out", (folder_ / "one").string()})
            .wait();
    ASSERT_EQ(trained.exit_code, 0) << trained.err;
    for (const char* other : {"two", "three"})
      fs::copy(folder_ / "one", folder_ / other, fs::copy_options::recursive);
    run_ = std::make_shared<const redrive::Run>(open_to_render(folder_ / "one"));
  }
  static void TearDownTestSuite() {
    run_.reset();
    fs::remove_all(folder_);
  }

  explicit ServeTest(std::uint64_t memory = kMuch)
      : store_({folder_}, {.threads = 2}, memory),
        service_(&store_),
        server_(start_rpc_server({}, &service_)),
        client_(server_->port()) {}

  const Scene& scene() const { return run_->scene; }
  std::uint64_t start_us(int frame) const {
    return static_cast<std::uint64_t>(scene().frames[frame].t_ns / 1000);
  }

  static Rigid3d pose_of(const sensorsim::Pose& pose) {
    Rigid3d out = Rigid3d::Identity();
    out.linear() =
        Eigen::Quaterniond(pose.quat().w(), pose.quat().x(), pose.quat().y(), pose.quat().z())
            .normalized()
            .toRotationMatrix();
    out.translation() << pose.vec().x(), pose.vec().y(), pose.vec().z();
    return out;
  }

  sensorsim::Cameras::Camera camera(const std::string& scene = "one",
                                    const std::string& name = kFront) const {
    sensorsim::OfScene request;
    request.set_scene_id(scene);
    sensorsim::Cameras cameras;
    const grpc::Status status = client_.call("get_available_cameras", request, &cameras);
    EXPECT_TRUE(status.ok()) << status.error_message();
    for (const auto& one : cameras.available_cameras())
      if (one.logical_id() == name) return one;
    ADD_FAILURE() << name;
    return {};
  }

  /// An image of the first camera at a frame, with the objects where they were recorded.
  sensorsim::ImageRequest image_request(const std::string& scene_id = "one", int frame = 12) const {
    sensorsim::ImageRequest request;
    request.set_scene_id(scene_id);
    const sensorsim::Cameras::Camera front = camera(scene_id);
    *request.mutable_camera_intrinsics() = front.intrinsics();
    request.set_resolution_w(front.intrinsics().resolution_w());
    request.set_resolution_h(front.intrinsics().resolution_h());
    request.set_frame_start_us(start_us(frame));
    request.set_frame_end_us(start_us(frame) + 1);
    const std::int64_t t_ns = scene().frames[frame].t_ns;
    const Rigid3d pose = scene().world_from_body(t_ns) * pose_of(front.rig_to_camera());
    fill_pose(pose, request.mutable_sensor_pose()->mutable_start_pose());
    fill_pose(pose, request.mutable_sensor_pose()->mutable_end_pose());
    for (const MovingObject& actor : scene().actors) {
      const auto box = actor.world_from_box(t_ns);
      if (!box) continue;
      sensorsim::DynamicObject* const object = request.add_dynamic_objects();
      object->set_track_id(std::to_string(actor.id));
      fill_pose(*box, object->mutable_pose_pair()->mutable_start_pose());
      fill_pose(*box, object->mutable_pose_pair()->mutable_end_pose());
    }
    request.set_image_format(1);
    return request;
  }

  grpc::Status render(const sensorsim::ImageRequest& request, std::string* bytes) const {
    sensorsim::ImageReply reply;
    const grpc::Status status = client_.call("render_rgb", request, &reply);
    *bytes = reply.image_bytes();
    return status;
  }
  Image8 rendered(const sensorsim::ImageRequest& request) const {
    std::string bytes;
    const grpc::Status status = render(request, &bytes);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return decode_png(bytes, "reply");
  }

  /// The image of a request by RunRenderer, with the recorded traffic or without.
  static Image8 expected(const sensorsim::ImageRequest& request, bool traffic,
                         std::vector<Rigid3d> poses, std::int64_t readout_ns = 0,
                         bool by_column = false) {
    RunRenderer renderer(run_, {.threads = 2});
    const Scene& scene = run_->scene;
    const int index = scene.camera_index(kFront);
    ImageRequest image{scene.rig[index]};
    image.camera.readout_ns = readout_ns;
    image.camera.readout_by_column = by_column;
    image.world_from_camera = std::move(poses);
    image.exposed_ns =
        static_cast<std::int64_t>(request.frame_start_us() + request.frame_end_us()) * 500;
    image.exposure = scene.exposure(index, image.exposed_ns - image.camera.time_offset_ns);
    Scene changed = scene;
    if (!traffic) changed.actors.clear();
    return to_image8(renderer.image(image, changed));
  }

  inline static fs::path folder_;
  inline static std::shared_ptr<const redrive::Run> run_;
  SceneStore store_;
  RunService service_;
  std::unique_ptr<RpcServer> server_;
  RpcClient client_;
};

/// Largest difference of a channel, and the share of pixels that differ.
std::pair<int, double> difference(const Image8& a, const Image8& b) {
  EXPECT_EQ(a.rgb.size(), b.rgb.size());
  int most = 0;
  double differ = 0;
  for (std::size_t i = 0; i < std::min(a.rgb.size(), b.rgb.size()); ++i) {
    const int apart = std::abs(int{a.rgb[i]} - int{b.rgb[i]});
    most = std::max(most, apart);
    differ += apart > 0;
  }
  return {most, differ / static_cast<double>(a.rgb.size())};
}

TEST_F(ServeTest, ImagesAreThoseOfRunRenderer) {
  sensorsim::ImageRequest request = image_request();
  ASSERT_GT(request.dynamic_objects_size(), 0);
  const Rigid3d pose = pose_of(request.sensor_pose().start_pose());
  // Boxes travel as floats.
  const Image8 with = rendered(request), should = expected(request, true, {pose});
  EXPECT_LE(difference(with, should).second, 1e-3);
  const Image8 without = expected(request, false, {pose});
  EXPECT_GT(difference(without, with).first, 20) << "objects are not drawn";
  request.mutable_dynamic_objects()->DeleteSubrange(1, request.dynamic_objects_size() - 1);
  for (sensorsim::Pose* const far :
       {request.mutable_dynamic_objects(0)->mutable_pose_pair()->mutable_start_pose(),
        request.mutable_dynamic_objects(0)->mutable_pose_pair()->mutable_end_pose()})
    far->mutable_vec()->set_z(-1000);
  EXPECT_EQ(rendered(request).rgb, without.rgb) << "objects that are not named are drawn";
  request.clear_dynamic_objects();
  EXPECT_EQ(rendered(request).rgb, expected(request, true, {pose}).rgb);

  Rigid3d later = pose;
  later.translation().x() += 0.5;
  fill_pose(later, request.mutable_sensor_pose()->mutable_end_pose());
  later = pose_of(request.sensor_pose().end_pose());
  request.set_frame_end_us(request.frame_start_us() + 30'000);
  request.mutable_camera_intrinsics()->set_shutter_type(1);
  EXPECT_EQ(rendered(request).rgb, expected(request, true, {pose, later}, 30'000'000).rgb);
  request.mutable_camera_intrinsics()->set_shutter_type(3);
  EXPECT_EQ(rendered(request).rgb, expected(request, true, {later, pose}, -30'000'000).rgb);
  request.mutable_camera_intrinsics()->set_shutter_type(5);
  EXPECT_EQ(rendered(request).rgb, expected(request, true, {interpolate(pose, later, 0.5)}).rgb);
  request.mutable_camera_intrinsics()->set_shutter_type(2);
  EXPECT_EQ(rendered(request).rgb, expected(request, true, {pose, later}, 30'000'000, true).rgb);
  request.mutable_camera_intrinsics()->set_shutter_type(4);
  EXPECT_EQ(rendered(request).rgb, expected(request, true, {later, pose}, -30'000'000, true).rgb);
}

TEST_F(ServeTest, EncodesAsAsked) {
  sensorsim::ImageRequest request = image_request();
  const Image8 png = rendered(request);
  std::string planar, jpeg;
  request.set_image_format(4);
  ASSERT_TRUE(render(request, &planar).ok());
  ASSERT_EQ(planar.size(), png.rgb.size());
  const std::size_t pixels = planar.size() / 3;
  for (std::size_t i = 0; i < pixels; ++i)
    for (std::size_t k = 0; k < 3; ++k)
      ASSERT_EQ(static_cast<std::uint8_t>(planar[k * pixels + i]), png.rgb[3 * i + k]);
  request.set_image_format(2);
  request.set_image_quality(95);
  ASSERT_TRUE(render(request, &jpeg).ok());
  EXPECT_EQ(jpeg.substr(0, 2), "\xff\xd8");
  request.set_image_format(1);
  request.set_resolution_w(2 * request.resolution_w());
  EXPECT_EQ(rendered(request).width, 2 * png.width);
  request.mutable_camera_intrinsics()->mutable_opencv_fisheye_param()->set_focal_length_x(50);
  request.mutable_camera_intrinsics()->mutable_opencv_fisheye_param()->set_focal_length_y(50);
  EXPECT_EQ(rendered(request).height, png.height);
}

// An f-theta lens of the first power is a fisheye without distortion; either polynomial says so.
TEST_F(ServeTest, RendersFThetaLenses) {
  constexpr double kFocal_px = 50;
  sensorsim::ImageRequest request = image_request();
  sensorsim::CameraSpec* const lens = request.mutable_camera_intrinsics();
  const double cx = lens->resolution_w() / 2.0, cy = lens->resolution_h() / 2.0;
  sensorsim::Fisheye* const fisheye = lens->mutable_opencv_fisheye_param();
  fisheye->set_focal_length_x(kFocal_px);
  fisheye->set_focal_length_y(kFocal_px);
  fisheye->set_principal_point_x(cx);
  fisheye->set_principal_point_y(cy);
  const Image8 expected = rendered(request);
  for (const std::uint32_t reference : {1u, 2u}) {
    sensorsim::FTheta* const ftheta = lens->mutable_ftheta_param();
    ftheta->set_principal_point_x(cx - 0.5);
    ftheta->set_principal_point_y(cy - 0.5);
    ftheta->set_reference_poly(reference);
    ftheta->clear_pixeldist_to_angle_poly();
    ftheta->clear_angle_to_pixeldist_poly();
    for (const double k : {0.0, 1 / kFocal_px}) ftheta->add_pixeldist_to_angle_poly(k);
    for (const double k : {0.0, kFocal_px}) ftheta->add_angle_to_pixeldist_poly(k);
    const Image8 image = rendered(request);
    ASSERT_EQ(image.rgb.size(), expected.rgb.size());
    int most = 0;
    for (std::size_t i = 0; i < image.rgb.size(); ++i)
      most = std::max(most, std::abs(int{image.rgb[i]} - int{expected.rgb[i]}));
    EXPECT_LE(most, 1) << reference;
  }
  // A glass that leaves rays as they are, or turns them by a pixel, within 50 degrees from the
  // axis.
  sensorsim::Windshield* const glass = lens->mutable_bivariate_windshield_model_param();
  for (const double k : {0.0, 1.0, 0.0}) glass->add_horizontal_poly(k);
  for (const double k : {0.0, 0.0, 1.0}) glass->add_vertical_poly(k);
  const auto difference = [&](const Image8& image) {
    constexpr double kMost_rad = 0.87;
    double sum = 0, n = 0;
    for (int y = 0; y < image.height; ++y)
      for (int x = 0; x < image.width; ++x) {
        if (std::hypot(x + 0.5 - cx, y + 0.5 - cy) > kMost_rad * kFocal_px) continue;
        for (int k = 0; k < 3; ++k, ++n) {
          const auto i = static_cast<std::size_t>(3 * (y * image.width + x) + k);
          sum += std::abs(int{image.rgb[i]} - int{expected.rgb[i]});
        }
      }
    return sum / n;
  };
  EXPECT_LT(difference(rendered(request)), 0.1);
  glass->set_horizontal_poly(0, 1 / kFocal_px);
  EXPECT_GT(difference(rendered(request)), 1);
  glass->mutable_horizontal_poly()->RemoveLast();
  std::string bytes;
  EXPECT_THAT(render(request, &bytes).error_message(),
              HasSubstr("bivariate_windshield_model_param.horizontal_poly = 2 numbers"));
}

TEST_F(ServeTest, RefusesByName) {
  using Change = std::function<void(sensorsim::ImageRequest&)>;
  const std::vector<std::tuple<Change, grpc::StatusCode, const char*>> cases = {
      {[](auto& r) { r.set_scene_id("onee"); }, grpc::StatusCode::NOT_FOUND, "one"},
      {[](auto& r) { r.mutable_dynamic_objects(0)->set_track_id("77"); },
       grpc::StatusCode::INVALID_ARGUMENT, "track_id = 77"},
      {[](auto& r) { *r.add_dynamic_objects() = r.dynamic_objects(0); },
       grpc::StatusCode::INVALID_ARGUMENT, "twice"},
      {[](auto& r) { r.set_frame_end_us(r.frame_end_us() + 100'000'000); },
       grpc::StatusCode::INVALID_ARGUMENT, "500000 us"},
      {[](auto& r) { r.set_frame_start_us(1), r.set_frame_end_us(2); },
       grpc::StatusCode::OUT_OF_RANGE, "the drive is from"},
      {[](auto& r) { r.set_frame_end_us(r.frame_start_us() - 1); },
       grpc::StatusCode::INVALID_ARGUMENT, "frame_end_us"},
      {[](auto& r) { r.set_image_format(5); }, grpc::StatusCode::INVALID_ARGUMENT,
       "image_format = 5"},
      {[](auto& r) { r.set_insert_ego_mask(true); }, grpc::StatusCode::INVALID_ARGUMENT,
       "ego mask"},
      {[](auto& r) { r.set_resolution_w(16384), r.set_resolution_h(16384); },
       grpc::StatusCode::RESOURCE_EXHAUSTED, "16384 x 16384"},
      {[](auto& r) {
         r.mutable_camera_intrinsics()->mutable_ftheta_param()->set_reference_poly(2);
       },
       grpc::StatusCode::INVALID_ARGUMENT, "ftheta_param.angle_to_pixeldist_poly"},
      {[](auto& r) {
         r.mutable_camera_intrinsics()->mutable_opencv_pinhole_param()->set_focal_length_x(NAN);
       },
       grpc::StatusCode::INVALID_ARGUMENT, "focal_length_x"},
      {[](auto& r) {
         r.mutable_camera_intrinsics()->clear_opencv_pinhole_param();
         r.mutable_camera_intrinsics()->set_logical_id("F_MIDLONGRANGECAM");
       },
       grpc::StatusCode::INVALID_ARGUMENT, kFront}};
  for (const auto& [change, code, text] : cases) {
    sensorsim::ImageRequest request = image_request();
    change(request);
    std::string bytes;
    const grpc::Status status = render(request, &bytes);
    EXPECT_EQ(status.error_code(), code) << text << ": " << status.error_message();
    EXPECT_THAT(status.error_message(), HasSubstr(text));
  }
}

TEST_F(ServeTest, ScansLieInTheSensorAtTheEndOfTheSpin) {
  sensorsim::ScanRequest request;
  request.set_scene_id("one");
  request.set_frame_start_us(start_us(12));
  request.set_frame_end_us(start_us(12) + 100'000);
  Rigid3d start = scene().world_from_body(scene().frames[12].t_ns), end = start;
  start.translation().z() += 2;
  end.translation() += Eigen::Vector3d(1, 0, 2.5);
  fill_pose(start, request.mutable_sensor_pose()->mutable_start_pose());
  fill_pose(end, request.mutable_sensor_pose()->mutable_end_pose());
  for (const std::uint32_t type : {0, 1}) {
    request.mutable_lidar_config()->set_lidar_type(type);
    sensorsim::ScanReply scan;
    const grpc::Status status = client_.call("render_lidar", request, &scan);
    ASSERT_TRUE(status.ok()) << status.error_message();
    ASSERT_GT(scan.num_points(), 1000u);
    ASSERT_EQ(scan.point_xyzs_size(), 3 * static_cast<int>(scan.num_points()));
    ASSERT_EQ(scan.point_intensities_size(), static_cast<int>(scan.num_points()));
    std::vector<float> heights;
    for (int i = 0; i < scan.point_intensities_size(); ++i) {
      EXPECT_GE(scan.point_intensities(i), 0);
      EXPECT_LE(scan.point_intensities(i), 1);
      // The road ahead, between 8 and 12 m.
      const float x = scan.point_xyzs(3 * i), y = scan.point_xyzs(3 * i + 1);
      if (x > 8 && x < 12 && std::abs(y) < 2) heights.push_back(scan.point_xyzs(3 * i + 2));
    }
    ASSERT_GT(heights.size(), 20u);
    std::ranges::nth_element(heights, heights.begin() + static_cast<int>(heights.size() / 2));
    EXPECT_NEAR(heights[heights.size() / 2], -2.5, 0.2);
  }
}

/// Start, rollout, frames, batches and bundles, for three scenes.
TEST_F(ServeTest, PlaysAlpaSimsOrder) {
  sensorsim::Version version;
  ASSERT_TRUE(client_.call("get_version", sensorsim::OfScene(), &version).ok());
  sensorsim::Scenes scenes;
  ASSERT_TRUE(client_.call("get_available_scenes", sensorsim::OfScene(), &scenes).ok());
  ASSERT_THAT(scenes.scene_ids(), ElementsAre("one", "three", "two"));
  for (const std::string& id : scenes.scene_ids()) {
    sensorsim::OfScene masks;
    ASSERT_TRUE(client_.call("get_available_ego_masks", sensorsim::OfScene(), &masks).ok());
    sensorsim::AggregatedRequest bundle;
    sensorsim::BatchRequest batch;
    for (int frame = 4; frame < 8; ++frame) {
      sensorsim::ImageRequest request = image_request(id, frame);
      request.set_image_format(2);
      request.set_image_quality(95);
      std::string bytes;
      ASSERT_TRUE(render(request, &bytes).ok());
      *bundle.add_rgb_requests() = request;
      *batch.add_items()->mutable_request() = request;
    }
    sensorsim::AggregatedReply both;
    ASSERT_TRUE(client_.call("render_aggregated", bundle, &both).ok());
    ASSERT_EQ(both.rgb_returns_size(), 4);
    sensorsim::BatchReply images;
    ASSERT_TRUE(client_.call("batch_render_rgb", batch, &images).ok());
    for (int i = 0; i < 4; ++i) {
      EXPECT_TRUE(images.items(i).success());
      EXPECT_EQ(images.items(i).result().image_bytes(), both.rgb_returns(i).image_bytes());
    }
  }
}

/// The other name of the service, planar images, frames of a microsecond, one camera after another.
TEST_F(ServeTest, PlaysCarlasOrder) {
  const RpcClient carla(server_->port(), kServiceNames[1]);
  sensorsim::Version version;
  ASSERT_TRUE(carla.call("get_version", sensorsim::OfScene(), &version).ok());
  sensorsim::Scenes scenes;
  ASSERT_TRUE(carla.call("get_available_scenes", sensorsim::OfScene(), &scenes).ok());
  for (const std::string& id : scenes.scene_ids()) {
    sensorsim::BatchRequest batch;
    for (int frame = 4; frame < 6; ++frame) {
      *batch.add_items()->mutable_request() = image_request(id, frame);
      batch.mutable_items(frame - 4)->mutable_request()->set_image_format(4);
    }
    sensorsim::BatchReply images;
    ASSERT_TRUE(carla.call("batch_render_rgb", batch, &images).ok());
    for (const auto& item : images.items()) {
      EXPECT_TRUE(item.success()) << item.error_message();
      EXPECT_EQ(item.result().image_bytes().size(), 3u * 120 * 66);
    }
  }
}

/// Two of the scenes fit.
class ScarceServeTest : public ServeTest {
 protected:
  static std::uint64_t bytes_of_scene() {
    return (std::uint64_t{32} << 20) + 2 * fs::file_size(folder_ / "one/checkpoint.safetensors");
  }
  ScarceServeTest() : ServeTest(2 * bytes_of_scene()) {}
  std::vector<std::string> loaded() const {
    sensorsim::LoadedScenes reply;
    EXPECT_TRUE(client_.call("get_loaded_scenes", sensorsim::OfScene(), &reply).ok());
    std::vector<std::string> ids;
    for (const auto& one : reply.scenes()) ids.push_back(one.scene_id());
    return ids;
  }
};

TEST_F(ScarceServeTest, ClosesTheSceneThatWasNotUsedForLongest) {
  EXPECT_THAT(loaded(), ElementsAre());
  for (const char* id : {"one", "two", "one", "three"}) camera(id);
  EXPECT_THAT(loaded(), ElementsAre("three", "one"));
  SceneStore small({folder_}, {.threads = 1}, bytes_of_scene() - 1);
  try {
    small.get("one");
    FAIL();
  } catch (const RequestError& error) {
    EXPECT_EQ(error.code, StatusCode::kResourceExhausted);
    EXPECT_THAT(error.what(), HasSubstr("scene one"));
  }
}

TEST_F(ServeTest, SaysWhichFileOfASceneIsDamaged) {
  const fs::path broken = folder_ / "more/broken";
  fs::create_directories(folder_ / "more");
  fs::copy(folder_ / "one", broken, fs::copy_options::recursive);
  fs::resize_file(broken / "checkpoint.safetensors", 1000);
  SceneStore store({folder_ / "more"}, {.threads = 1}, kMuch);
  RunService service(&store);
  try {
    service.cameras("broken");
    FAIL();
  } catch (const RequestError& error) {
    EXPECT_EQ(error.code, StatusCode::kFailedPrecondition);
    EXPECT_THAT(error.what(), HasSubstr("broken/checkpoint.safetensors"));
  }
  EXPECT_THAT(service.loaded_scenes(), ElementsAre());
}

TEST_F(ServeTest, WhatCannotBeRenderedIsLeftOutOfAFolder) {
  const fs::path folder = folder_ / "mixed", empty = folder / "empty";
  fs::create_directories(empty);
  fs::copy(folder_ / "one", folder / "good", fs::copy_options::recursive);
  fs::copy_file(folder_ / "one/config.json", empty / "config.json");
  write_file(folder / "text.usdz", "no zip");
  write_zip(folder / "foreign.usdz",
            std::vector<ZipMember>{{"data_info.json", R"({"sequence_id": "foreign"})"}});
  const SceneStore store({folder}, {.threads = 1}, kMuch);
  EXPECT_THAT(store.ids(), ElementsAre("good"));
  EXPECT_THAT(
      store.left_out(),
      UnorderedElementsAre(HasSubstr("empty: its run has no checkpoint"), HasSubstr("text.usdz"),
                           HasSubstr("foreign.usdz: it has no run of redrive")));
  EXPECT_THROW(SceneStore({folder / "foreign.usdz"}, {.threads = 1}, kMuch), InputError);
}

TEST_F(ServeTest, ABundleNeedsNoRecordingAndRendersTheBitsOfItsRun) {
  const fs::path bundles = folder_ / "bundles", made = bundles / "one.usdz",
                 moved = bundles / "elsewhere.usdz";
  fs::create_directories(bundles);
  const ProgramResult exported =
      Program(REDRIVE_BINARY, {"export", (folder_ / "one").string(), "--to", "usdz-scene",
                               "--voxel", "0.5", made.string()})
          .wait();
  ASSERT_EQ(exported.exit_code, 0) << exported.err;
  EXPECT_THAT(exported.out, AllOf(HasSubstr("scene one"), HasSubstr("map.xodr: 1 road"),
                                  HasSubstr("a lane to its left")));
  const ProgramResult inspected = Program(REDRIVE_BINARY, {"inspect", made.string()}).wait();
  EXPECT_EQ(inspected.exit_code, 0) << inspected.out << inspected.err;
  EXPECT_THAT(inspected.out,
              AllOf(HasSubstr("AlpaSim: nothing is missing"),
                    HasSubstr("CARLA: nothing is missing"), HasSubstr("its run is inside")));
  // The same bundle on a machine without the recording.
  const ZipFile zip(made);
  std::vector<std::string> bytes;
  std::vector<ZipMember> members;
  for (const std::string& name : zip.names()) {
    bytes.push_back(zip.read(made / name, kMaxDataBytes));
    if (name != "redrive/config.json") continue;
    nlohmann::json config = nlohmann::json::parse(bytes.back());
    config["recording"] = "/nowhere";
    bytes.back() = config.dump();
  }
  for (const std::string& name : zip.names()) members.push_back({name, bytes[members.size()]});
  write_zip(moved, members);
  fs::remove(made);

  SceneStore store({bundles}, {.threads = 2}, kMuch);
  EXPECT_THAT(store.ids(), ElementsAre("one"));
  RunService service(&store);
  ImageQuery query;
  query.scene = "one";
  query.format = static_cast<int>(ImageFormat::kPlanar);
  std::vector<ImageQuery> queries;
  for (const SceneCamera& camera : service_.cameras("one"))
    for (const int frame : {3, 12}) {
      query.start_ns = query.end_ns = scene().frames[frame].t_ns;
      query.local_from_sensor.start = query.local_from_sensor.end =
          scene().world_from_body(query.start_ns) * camera.rig_from_camera;
      query.lens = camera.lens;
      queries.push_back(query);
    }
  const auto never = [] { return false; };
  const std::vector<ImageAnswer> from_run = service_.images(queries, never),
                                 from_bundle = service.images(queries, never);
  for (std::size_t i = 0; i < queries.size(); ++i) {
    EXPECT_EQ(from_bundle[i].code, StatusCode::kOk) << from_bundle[i].bytes;
    EXPECT_TRUE(from_bundle[i].bytes == from_run[i].bytes) << queries[i].lens.camera.name;
  }
  const std::vector<TimedPose> here = service.trajectory("one"), there = service_.trajectory("one");
  ASSERT_EQ(here.size(), there.size());
  for (std::size_t i = 0; i < here.size(); ++i)
    EXPECT_EQ(here[i].local_from_rig.matrix(), there[i].local_from_rig.matrix());
}

std::size_t resident_bytes() {
  std::ifstream file("/proc/self/statm");
  std::size_t size = 0, resident = 0;
  file >> size >> resident;
  return resident * static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
}

TEST_F(ServeTest, ManyRequestsFromFourClientsTakeNoMemory) {
  const sensorsim::ImageRequest request = image_request();
  const auto many = [&](int each) {
    std::vector<std::thread> clients;
    for (int c = 0; c < 4; ++c)
      clients.emplace_back([&] {
        const RpcClient own(server_->port());
        sensorsim::ImageReply reply;
        for (int i = 0; i < each; ++i) EXPECT_TRUE(own.call("render_rgb", request, &reply).ok());
      });
    for (std::thread& client : clients) client.join();
  };
  many(100);
  const std::size_t before = resident_bytes();
  many(400);
  // A leaked reply of 24 kB would be 38 MB.
  EXPECT_LT(resident_bytes(), before + (10 << 20));
}

TEST_F(ServeTest, TheProgramServesUntilItIsInterrupted) {
  Program program(REDRIVE_BINARY, {"serve", folder_.string(), "--port", "0"});
  ASSERT_TRUE(program.wait_for_output("Ctrl-C"));
  program.send(SIGINT);
  const ProgramResult ended = program.wait();
  EXPECT_EQ(ended.exit_code, 0) << ended.err;
  EXPECT_THAT(ended.out, AllOf(HasSubstr("scene two"), HasSubstr("127.0.0.1:")));
  const std::string port = std::to_string(server_->port());
  const ProgramResult taken =
      Program(REDRIVE_BINARY, {"serve", folder_.string(), "--port", port}).wait();
  EXPECT_EQ(taken.exit_code, kExitUsage);
  EXPECT_THAT(taken.err, AllOf(HasSubstr("--port"), HasSubstr(port)));
  EXPECT_EQ(Program(REDRIVE_BINARY, {"serve", "/proc/self/fd"}).wait().exit_code, kExitUsage);
}

TEST_F(ServeTest, StopsBetweenTheImagesOfARequest) {
  ImageQuery query;
  query.scene = "one";
  query.start_ns = query.end_ns = scene().frames[12].t_ns;
  query.lens.camera.name = kFront;
  query.format = static_cast<int>(ImageFormat::kPlanar);
  const std::vector<ImageQuery> queries(5, query);
  int asked = 0;
  EXPECT_EQ(service_.images(queries, [] { return false; }).size(), 5u);
  try {
    service_.images(queries, [&] { return ++asked == 3; });
    FAIL();
  } catch (const RequestError& error) {
    EXPECT_EQ(error.code, StatusCode::kCancelled);
  }
  EXPECT_EQ(asked, 3);
}

TEST_F(ServeTest, EncryptsByACertificate) {
  const fs::path certificate = folder_ / "certificate.pem", key = folder_ / "key.pem";
  const ProgramResult made =
      Program("/usr/bin/openssl",
              {"req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj",
               "/CN=localhost", "-addext", "subjectAltName=DNS:localhost", "-keyout", key.string(),
               "-out", certificate.string()})
          .wait();
  ASSERT_EQ(made.exit_code, 0) << made.err;
  RpcOptions options;
  options.certificate = read_file(certificate);
  options.key = read_file(key);
  const auto server = start_rpc_server(options, &service_);
  sensorsim::Scenes scenes;
  EXPECT_FALSE(RpcClient(server->port()).call("get_available_scenes", scenes, &scenes).ok());
  grpc::SslCredentialsOptions trusted;
  trusted.pem_root_certs = options.certificate;
  const RpcClient client(server->port(), kServiceNames[0], grpc::SslCredentials(trusted),
                         "localhost");
  const grpc::Status status = client.call("get_available_scenes", scenes, &scenes);
  EXPECT_TRUE(status.ok()) << status.error_message();
  EXPECT_EQ(scenes.scene_ids_size(), 3);
  EXPECT_EQ(Program(REDRIVE_BINARY, {"serve", folder_.string(), "--certificate", key.string()})
                .wait()
                .exit_code,
            kExitUsage);
}

}  // namespace
}  // namespace redrive::serve
