// SPDX-License-Identifier: Apache-2.0
// The viewer over loopback, on a run whose images are a formula of the ray.
#include "redrive/view/viewer.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "redrive/render/view_pose.h"
#include "redrive/view/viewer_testing.h"

namespace redrive::view {
namespace {

using ::testing::HasSubstr;

TEST_F(ViewerTest, DescribesTheRun) {
  const auto client = connect();
  const nlohmann::json hello = next(*client).header;
  EXPECT_EQ(hello["kind"], "hello");
  ASSERT_EQ(hello["cameras"].size(), 2u);
  EXPECT_EQ(hello["cameras"][0]["name"], "FISHEYE");
  EXPECT_EQ(hello["cameras"][1]["width"], 24);
  EXPECT_EQ(hello["cameras"][1]["body_from_sensor"][3], 2);
  ASSERT_EQ(hello["frames"].size(), 3u);
  EXPECT_EQ(hello["frames"][1]["id"], 11);
  EXPECT_NEAR(hello["frames"][1]["t_s"].get<double>(), 1 / 15.0, 1e-6);
  EXPECT_EQ(hello["held_out"], (nlohmann::json{10, 12}));
  EXPECT_EQ(hello["lidar"], false);
  EXPECT_EQ(hello["sensors"][0], "vlp-16");
}

TEST_F(ViewerTest, RendersAScan) {
  const auto client = connect();
  nlohmann::json request = view(1);
  client->send_message(request.dump());
  EXPECT_TRUE(full_image(*client, 1).header["scan"].is_null());
  request["id"] = 2;
  request["scan"] = {{"sensor", "vlp-16"}, {"colour", "range"}};
  client->send_message(request.dump());
  const nlohmann::json header = full_image(*client, 2).header;
  EXPECT_EQ(header["trouble"], "");
  EXPECT_EQ(header["scan"]["returns"], header["scan"]["rays"]);  // all 2 m away
  request["id"] = 3;
  request["scan"]["sensor"] = "recorded";
  client->send_message(request.dump());
  const nlohmann::json without = full_image(*client, 3).header;
  EXPECT_THAT(without["trouble"].get<std::string>(), HasSubstr("no LiDAR revolution"));
  EXPECT_TRUE(without["scan"].is_null());
  request["scan"]["sensor"] = "none";
  client->send_message(request.dump());
  wait_for(*client, "closed");
}

TEST_F(ViewerTest, SendsTheImageThatRenderWrites) {
  const auto client = connect();
  nlohmann::json request = view(1);
  request["shift_m"] = {0.5, -1, 0.25};
  request["yaw_deg"] = 20;
  request["pitch_deg"] = -10;
  client->send_message(request.dump());
  const Received received = full_image(*client, 1);
  EXPECT_EQ(received.header["camera"], "FRONT");
  const RigCamera& camera = run_.scene.rig[run_.scene.camera_index("FRONT")];
  const Rigid3d world_from_camera =
      shifted_camera(run_.scene.global_from_world, *world_from_body(run_.scene, 11, camera),
                     turned_sensor(camera.body_from_sensor, 20 * M_PI / 180, -10 * M_PI / 180),
                     ShiftAxes::kBody, {0.5, -1, 0.25});
  const Image8 expected =
      to_image8(render_image(backend_, *run_.state.model, camera.camera, world_from_camera));
  ASSERT_EQ(received.image.rgb.size(), expected.rgb.size());
  double sum = 0;
  for (std::size_t i = 0; i < expected.rgb.size(); ++i)
    sum += std::pow(double(received.image.rgb[i]) - expected.rgb[i], 2);
  EXPECT_LT(std::sqrt(sum / static_cast<double>(expected.rgb.size())), 3);  // JPEG
}

TEST_F(ViewerTest, SendsTheImageOfAMount) {
  const auto client = connect();
  nlohmann::json request = view(1);
  request["mount"] = {{"at", "1,0.5,2,30,-10,5"}, {"lens", "pinhole:80:32x20"}};
  request["reference"] = true;
  client->send_message(request.dump());
  const Received received = full_image(*client, 1);
  const RigCamera camera = *mounted_camera(*parse_mount("1,0.5,2,30,-10,5"),
                                           *parse_lens("pinhole:80:32x20"), run_.scene);
  const Image8 expected =
      to_image8(render_image(backend_, *run_.state.model, camera.camera,
                             *world_from_body(run_.scene, 11, camera) * camera.body_from_sensor));
  EXPECT_EQ(received.image.width, 32);
  ASSERT_EQ(received.image.rgb.size(), expected.rgb.size());
  double sum = 0;
  for (std::size_t i = 0; i < expected.rgb.size(); ++i)
    sum += std::pow(double(received.image.rgb[i]) - expected.rgb[i], 2);
  EXPECT_LT(std::sqrt(sum / static_cast<double>(expected.rgb.size())), 3);  // JPEG
  EXPECT_EQ(wait_for(*client, "no_reference").header["key"], "mount");
  request["id"] = 2;
  request["mount"]["lens"] = "FISHEYE";
  client->send_message(request.dump());
  EXPECT_EQ(full_image(*client, 2).image.width, 20);
  request["id"] = 3;
  request["mount"]["lens"] = "REAR";
  client->send_message(request.dump());
  EXPECT_THAT(wait_for(*client, "error").header["text"].get<std::string>(), HasSubstr("REAR"));
}

TEST_F(ViewerTest, SendsTheRecordedImageAndTheScore) {
  const auto client = connect();
  nlohmann::json request = view(1, "FISHEYE", 10);
  request["reference"] = true;
  client->send_message(request.dump());
  const Received reference = wait_for(*client, "reference");
  EXPECT_EQ(reference.header["key"], "FISHEYE:10");
  EXPECT_EQ(reference.image.width, 20);
  const nlohmann::json score = wait_for(*client, "score").header;
  EXPECT_EQ(score["id"], 1);
  EXPECT_GT(score["psnr_db"].get<double>(), 0);
  std::filesystem::remove(folder_.path / "FISHEYE_11.png");  // the recording moves away
  request = view(2, "FISHEYE", 11);
  request["reference"] = true;
  client->send_message(request.dump());
  EXPECT_THAT(wait_for(*client, "no_reference").header["text"].get<std::string>(),
              HasSubstr("FISHEYE_11.png"));
  client->send_message(view(3).dump());
  EXPECT_EQ(full_image(*client, 3).header["frame"], 11);
}

TEST_F(ViewerTest, SaysHowFarBesideTheDriveACameraIs) {
  const auto client = connect();
  client->send_message(view(1).dump());
  EXPECT_NEAR(full_image(*client, 1).header["beside"].get<double>(), 0, 1e-6);
  nlohmann::json request = view(2);
  request["shift_m"] = {0, 2, 0};
  client->send_message(request.dump());
  EXPECT_NEAR(full_image(*client, 2).header["beside"].get<double>(), 2, 0.1);  // it curves
}

TEST_F(ViewerTest, ParsesWhereImagesAreMade) {
  Viewer idle(std::shared_ptr<const redrive::Run>(&run_, [](auto*) {}), backend_);
  ServerOptions options;
  options.token = "t";
  Server server(options, &idle);
  idle.use(server);
  auto client = std::make_unique<LoopbackClient>(server.port());
  const std::string host = "127.0.0.1:" + std::to_string(server.port());
  client->upgrade("/t/socket", host, "http://" + host);
  client->send_message(R"({"type": "train", "paused": true})");
  client->send_message("no JSON");
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  EXPECT_FALSE(idle.paused()) << "the server's thread only keeps texts";
  for (int i = 0; i < 100 && !idle.paused(); ++i) idle.work(/*waits=*/true);
  EXPECT_TRUE(idle.paused());
  std::optional<LoopbackClient::Message> message;
  do message = client->receive_message();
  while (message && message->opcode != 8);  // it is closed, or there is a time limit
  client.reset();
  for (int i = 0; i < 100 && idle.has_clients(); ++i) idle.work(/*waits=*/true);
  EXPECT_FALSE(idle.has_clients());
  EXPECT_FALSE(idle.paused()) << "nobody is left who could let training go on";
}

TEST_F(ViewerTest, FindsThePointOfAPixel) {
  const auto client = connect();
  client->send_message(view(1).dump());
  full_image(*client, 1);
  client->send_message(R"({"type": "pick", "id": 5, "at": [0.5, 0.5]})");
  const nlohmann::json picked = wait_for(*client, "picked").header;
  EXPECT_EQ(picked["id"], 5);
  EXPECT_EQ(picked["surface"], true);
  EXPECT_EQ(picked["pixel"], (nlohmann::json{12, 8}));
  EXPECT_EQ(picked["depth_m"], 2);
  const RigCamera& camera = run_.scene.rig[run_.scene.camera_index("FRONT")];
  const Eigen::Vector3d in_body = camera.body_from_sensor * (2 * *camera.camera.unproject({12, 8}));
  const Eigen::Vector3d in_ecef = run_.recording.frames[1].global_from_body * in_body;
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(picked["body_m"][k].get<double>(), in_body[k], 1e-6);
    EXPECT_NEAR(picked["ecef_m"][k].get<double>(), in_ecef[k], 1e-6);
  }
  EXPECT_NEAR(picked["wgs84"]["latitude_deg"].get<double>(), 47.5, 0.3);  // Budapest
  EXPECT_NEAR(picked["wgs84"]["longitude_deg"].get<double>(), 19.0, 0.3);
}

TEST_F(ViewerTest, NamesTheTrainingImagesThatSawAPoint) {
  const auto client = connect();
  client->send_message(view(1).dump());
  full_image(*client, 1);
  client->send_message(R"({"type": "pick", "id": 5, "at": [0.5, 0.5]})");
  const nlohmann::json seen = wait_for(*client, "seen_by").header;
  EXPECT_EQ(seen["id"], 5);
  EXPECT_EQ(seen["of"], 2);    // images of frame 11: 10 and 12 are held out
  EXPECT_EQ(seen["seen"], 1);  // FISHEYE looks to the left
  EXPECT_EQ(seen["nearest"][0]["camera"], "FRONT");
  EXPECT_EQ(seen["nearest"][0]["frame"], 11);
  EXPECT_NEAR(seen["nearest"][0]["distance_m"].get<double>(), 2, 1e-6);
}

TEST_F(ViewerTest, SendsMasksWithDrivenImages) {
  const auto client = connect();
  nlohmann::json request = view(1);
  request["overlays"] = {"masks"};
  client->send_message(request.dump());
  EXPECT_GT(full_image(*client, 1).header["mask"], 0);
  request["id"] = 2;
  request["layer"] = "normals";
  request["shift_m"] = {0, 1, 0};
  client->send_message(request.dump());
  EXPECT_EQ(full_image(*client, 2).header["mask"], 0);
}

TEST_F(ViewerTest, DropsWhatIsOvertakenAndWaitsForThePage) {
  const auto client = connect();
  for (int id = 1; id <= 300; ++id) client->send_message(view(id).dump());
  // Nothing is acknowledged: no more than two images come.
  std::this_thread::sleep_for(std::chrono::milliseconds(400));
  client->send_message(R"({"type": "pick", "id": 1, "at": [0, 0]})");
  int images = 0;
  for (std::string kind; kind != "picked" && kind != "closed";) {
    kind = next(*client).header["kind"];
    images += kind == "image";
  }
  EXPECT_GE(images, 1);
  EXPECT_LE(images, 2);
  client->send_message(R"({"type": "shown", "sequence": 2})");
  client->send_message(view(301).dump());
  EXPECT_EQ(full_image(*client, 301).header["id"], 301);
}

TEST_F(ViewerTest, ShowsANewerRunToItsPages) {
  const auto client = connect();
  EXPECT_EQ(next(*client).header["step"], 0);
  client->send_message(view(1).dump());
  EXPECT_EQ(full_image(*client, 1).image.width, 24);
  auto newer = std::make_shared<redrive::Run>();
  newer->recording = run_.recording;
  newer->options = run_.options;
  newer->paths.root = folder_.path / "run\xff";  // not UTF-8
  newer->scene = make_scene(run_.recording, {.downscale = 2});
  newer->state.model = make_painted_model();
  newer->state.step = 500;
  happens({newer, ""});
  EXPECT_EQ(wait_for(*client, "hello").header["step"], 500);
  EXPECT_EQ(full_image(*client, 1).image.width, 12);
  happens({nullptr, "the run is gone"});
  EXPECT_EQ(wait_for(*client, "problem").header["text"], "the run is gone");
  client->send_message(view(2).dump());
  EXPECT_EQ(full_image(*client, 2).image.width, 12);
  const auto later = connect();
  EXPECT_EQ(wait_for(*later, "problem").header["text"], "the run is gone");
  happens({nullptr, ""});
  EXPECT_EQ(wait_for(*later, "problem").header["text"], "");
}

TEST_F(ViewerTest, ServesClientsInTurn) {
  const auto one = connect(), two = connect();
  for (int id = 1; id <= 20; ++id) {
    one->send_message(view(id).dump());
    two->send_message(view(id, "FISHEYE", 12).dump());
    EXPECT_EQ(full_image(*one, id).header["camera"], "FRONT");
    EXPECT_EQ(full_image(*two, id).header["camera"], "FISHEYE");
  }
}

TEST_F(ViewerTest, SaysWhatItCannotShow) {
  const auto client = connect();
  client->send_message(view(1, "REAR").dump());
  EXPECT_THAT(wait_for(*client, "error").header["text"].get<std::string>(), HasSubstr("REAR"));
  client->send_message(view(2, "FRONT", 99).dump());
  EXPECT_EQ(wait_for(*client, "error").header["id"], 2);
  nlohmann::json request = view(3);
  request["exposure"] = "FRONT:99";
  client->send_message(request.dump());
  EXPECT_EQ(wait_for(*client, "error").header["id"], 3);
  request = view(4);
  request["novel"] = {{"set", "left_1"}, {"index", 0}};
  client->send_message(request.dump());
  EXPECT_THAT(wait_for(*client, "error").header["text"].get<std::string>(), HasSubstr("left_1"));
  client->send_message(view(5).dump());
  EXPECT_EQ(full_image(*client, 5).header["frame"], 11);
  client->send_message("nonsense");
  EXPECT_EQ(wait_for(*client, "nothing").header["kind"], "closed");
}

nlohmann::json path_message(const nlohmann::json& save) {
  return {{"type", "path"},
          {"fps", 10},
          {"keyframes",
           {{{"time_s", 0}, {"camera", "FRONT"}, {"frame_id", 10}},
            {{"time_s", 2}, {"camera", "FRONT"}, {"frame_id", 11}, {"shift_body_m", {1, 2, 0}}}}},
          {"save", save}};
}

TEST_F(ViewerTest, ShowsViewsOnAPath) {
  const auto client = connect();
  client->send_message(path_message(nullptr).dump());
  nlohmann::json request = view(1, "FRONT", 10);
  request["path_s"] = 2;
  client->send_message(request.dump());
  const Image8 on_path = full_image(*client, 1).image;
  request = view(2, "FRONT", 11);
  request["shift_m"] = {1, 2, 0};
  client->send_message(request.dump());
  const Image8 last_key = full_image(*client, 2).image;
  EXPECT_EQ(on_path.rgb, last_key.rgb);
  request = view(3, "FRONT", 10);
  request["path_s"] = 1;
  client->send_message(request.dump());
  EXPECT_NE(full_image(*client, 3).image.rgb, last_key.rgb);
}

TEST_F(ViewerTest, SavesAndLoadsPaths) {
  const auto client = connect();
  EXPECT_EQ(wait_for(*client, "paths").header["names"], nlohmann::json::array());
  const nlohmann::json save = {{"name", "left"}, {"overwrite", false}};
  client->send_message(path_message(save).dump());
  nlohmann::json answer = wait_for(*client, "paths").header;
  EXPECT_EQ(answer["saved"], "left");
  EXPECT_EQ(answer["names"], std::vector<std::string>{"left"});
  client->send_message(path_message(save).dump());
  EXPECT_THAT(wait_for(*client, "paths").header["error"].get<std::string>(), HasSubstr("exists"));
  client->send_message(R"({"type": "load_path", "name": "left"})");
  answer = wait_for(*client, "paths").header;
  EXPECT_EQ(answer["loaded"]["keyframes"][1]["shift_body_m"], (std::vector<double>{1, 2, 0}));
  client->send_message(R"({"type": "load_path", "name": "other"})");
  EXPECT_TRUE(wait_for(*client, "paths").header.contains("error"));
  client->send_message(R"({"type": "load_path", "name": "../config"})");
  EXPECT_EQ(wait_for(*client, "nothing").header["kind"], "closed");
}

/// A recording without a run.
class RecordingViewerTest : public ViewerTest {
 protected:
  RecordingViewerTest() : ViewerTest(/*with_model=*/false) {}
};

TEST_F(RecordingViewerTest, ShowsImagesWhereTheyWereTaken) {
  const auto client = connect();
  EXPECT_EQ(next(*client).header["method"], "");
  client->send_message(view(1, "FISHEYE", 12).dump());
  const Image8 recorded = read_image(folder_.path / "FISHEYE_12.png");
  const Received driven = full_image(*client, 1);
  ASSERT_EQ(driven.image.rgb.size(), recorded.rgb.size());
  EXPECT_NEAR(driven.image.rgb[3 * 150], recorded.rgb[3 * 150], 12);  // JPEG
  nlohmann::json request = view(2, "FISHEYE", 12);
  request["shift_m"] = {0, 1, 0};
  request["layer"] = "coverage";
  request["overlays"] = {"trajectory"};
  client->send_message(request.dump());
  const Received beside = full_image(*client, 2);
  EXPECT_EQ(*std::ranges::max_element(beside.image.rgb), 0);
  client->send_message(R"({"type": "pick", "id": 3, "at": [0.5, 0.5]})");
  EXPECT_EQ(wait_for(*client, "picked").header["surface"], false);
  client->send_message(path_message({{"name", "a"}, {"overwrite", false}}).dump());
  EXPECT_TRUE(wait_for(*client, "paths").header.contains("error"));
  EXPECT_TRUE(std::filesystem::is_empty(run_.paths.root)) << "nothing is written";
}

TEST_F(ViewerTest, DrawsTheTrajectoryAndTheFrusta) {
  const auto client = connect();
  nlohmann::json request = view(1, "FRONT", 10);
  request["shift_m"] = {-3, 0, 1};
  request["overlays"] = {"trajectory", "frusta", "lidar", "boxes"};
  client->send_message(request.dump());
  const nlohmann::json header = full_image(*client, 1).header;
  EXPECT_EQ(header["points"], 0);
  std::set<std::string> kinds, labels;
  for (const nlohmann::json& line : header["lines"]) {
    kinds.insert(line["kind"]);
    labels.insert(line["label"]);
    EXPECT_EQ(line["points"].size() % 2, 0u);
  }
  EXPECT_EQ(kinds, (std::set<std::string>{"trajectory", "frustum"}));
  EXPECT_TRUE(labels.contains("FRONT"));
}

}  // namespace
}  // namespace redrive::view
