// SPDX-License-Identifier: Apache-2.0
// Rays, drags and edits of boxes on a plane road, by formulas.
#include "redrive/view/traffic.h"

#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/edit/edit_actors.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"
#include "redrive/view/overlay.h"

namespace redrive::view {
namespace {

using Eigen::Vector3d;
using ::testing::HasSubstr;

constexpr double kTolerance = 1e-9;

/// A pinhole of 200 x 100 with f = 100, 1.5 m above the world's origin, that looks along x.
Placement placement() {
  Placement placement;
  placement.camera.model = OpenCvPinhole{};
  placement.camera.width = 200;
  placement.camera.height = 100;
  placement.camera.fx = placement.camera.fy = 100;
  placement.camera.cx = 99.5;
  placement.camera.cy = 49.5;
  placement.world_from_camera = Rigid3d::Identity();
  placement.world_from_camera.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  placement.world_from_camera.translation() = Vector3d(0, 0, 1.5);
  placement.t_ns = 500'000'000;
  return placement;
}

/// A box of 4 x 2 x 1.5 m that stands on the road for a second.
MovingObject car(std::int64_t id, double x, double y, double heading_deg = 0) {
  MovingObject car{.id = id, .type = "CAR", .size_m = {4, 2, 1.5}, .keys = {}};
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = Eigen::AngleAxisd(heading_deg * M_PI / 180, Vector3d::UnitZ()).matrix();
  pose.translation() = Vector3d(x, y, 0.75);
  for (int i = 0; i <= 10; ++i) car.keys.push_back({100'000'000ll * i, pose, Vector3d::Zero()});
  return car;
}

Scene road(std::vector<MovingObject> cars) {
  Scene scene;
  for (int i = 0; i <= 10; ++i) scene.add_frame({i, 100'000'000ll * i, Rigid3d::Identity()});
  scene.actors = std::move(cars);
  return scene;
}

TEST(Traffic, FindsTheObjectThatARayEntersFirst) {
  const Scene scene = road({car(3, 10, 0), car(7, 20, 0)});
  const Vector3d eye(0, 0, 1.5), to_centre = (Vector3d(10, 0, 0.75) - eye);
  const auto hit = object_on_ray(scene, 500'000'000, eye, to_centre.normalized());
  ASSERT_TRUE(hit);
  EXPECT_EQ(hit->id, 3);
  EXPECT_NEAR(hit->from_m, 0.8 * to_centre.norm(), kTolerance);  // its rear is at x = 8
  EXPECT_EQ(object_on_ray(scene, 500'000'000, Vector3d(15, 0, 1), Vector3d::UnitX())->id, 7);
  EXPECT_FALSE(object_on_ray(scene, 500'000'000, eye, Vector3d(1, 0.2, 0).normalized()));
  EXPECT_FALSE(object_on_ray(scene, 500'000'000, eye, -to_centre.normalized()));
  EXPECT_FALSE(object_on_ray(scene, 5'000'000'000, eye, to_centre.normalized())) << "its track";
  const Scene removed =
      edited_traffic(scene, parse_traffic_edit(R"({"actors": {"3": {"remove": true}}})", "e"))
          .scene;
  EXPECT_EQ(object_on_ray(removed, 500'000'000, eye, to_centre.normalized())->id, 7);
}

/// Returns the answer to a drag from a pixel of one point on the road to a pixel of another.
nlohmann::json drag(const std::vector<double>& from, const std::vector<double>& to,
                    DragMessage message, const Scene& scene, const std::string& edit = "{}") {
  const auto pixel = [](const std::vector<double>& on_road) {
    return std::array<double, 2>{(100 - 100 * on_road[1] / on_road[0]) / 200,
                                 (50 + 100 * 1.5 / on_road[0]) / 100};
  };
  message.from = pixel(from);
  message.to = pixel(to);
  const TrafficEdit parsed = parse_traffic_edit(edit, "edit.json");
  return dragged(message, placement(), edited_traffic(scene, parsed).scene, parsed);
}

void expect_shift(const nlohmann::json& answer, const Vector3d& expected) {
  ASSERT_TRUE(answer.contains("shift_m")) << answer;
  for (int k = 0; k < 3; ++k)
    EXPECT_NEAR(answer["shift_m"][k].get<double>(), expected[k], kTolerance) << answer;
}

TEST(Traffic, DragsABaseOnTheRoad) {
  const DragMessage message{.object = 3};
  expect_shift(drag({10, 0}, {20, 1}, message, road({car(3, 10, 0)})), {10, 1, 0});
  // In its own axes: ahead is the world's y.
  expect_shift(drag({10, 0}, {20, 1}, message, road({car(3, 10, 0, 90)})), {1, -10, 0});
  // From where it was shifted when the drag began, in its axes before the turn.
  const DragMessage shifted{.object = 3, .shift_m = {2, 0, 0.5}, .turn_deg = 90};
  const std::string edit = R"({"actors": {"3": {"shift_m": [7, 1, 0.5], "turn_deg": 90}}})";
  const auto answer = drag({12, 0}, {20, 0}, shifted, road({car(3, 10, 0)}), edit);
  // Its base is half a metre above the road: 1 m below the eye instead of 1.5 m.
  ASSERT_TRUE(answer.contains("shift_m")) << answer;
  const double row = 100 * 1 / 12.0 + 100 * 1.5 / 20 - 100 * 1.5 / 12;
  EXPECT_NEAR(answer["shift_m"][0].get<double>(), 100 / row - 10, kTolerance);
  EXPECT_NEAR(answer["shift_m"][2].get<double>(), 0.5, kTolerance);
  // A copy, too.
  const std::string copy = R"({"copies": [{"of": 3, "id": 9, "shift_m": [0, 2, 0]}]})";
  const DragMessage of_copy{.object = 9, .shift_m = {0, 2, 0}};
  expect_shift(drag({10, 2}, {10, -1}, of_copy, road({car(3, 10, 0)}), copy), {0, -1, 0});
}

TEST(Traffic, TurnsByTheHandle) {
  DragMessage message{.object = 3, .turns = true};
  const nlohmann::json left = drag({13, 0}, {10, 3}, message, road({car(3, 10, 0)}));
  EXPECT_NEAR(left["turn_deg"].get<double>(), 90, 1e-6) << left;
  message.turn_deg = 90;
  message.shift_m = {1, 0, 0};
  const nlohmann::json back = drag({11, 3}, {14, 3}, message, road({car(3, 10, 0)}),
                                   R"({"actors": {"3": {"shift_m": [1, 0, 0]}}})");
  EXPECT_NEAR(back["turn_deg"].get<double>(), 45, 1e-6) << back;
}

TEST(Traffic, DragsNothingBeyondTheHorizonOrTheDrive) {
  const Scene scene = road({car(3, 10, 0)});
  DragMessage message{.object = 3, .from = {0.5, 0.65}, .to = {0.5, 0.4}};
  EXPECT_TRUE(dragged(message, placement(), scene, {}).empty());
  message.to = {0.5, 0.55};
  EXPECT_FALSE(dragged(message, placement(), scene, {}).empty());
  message.object = 5;
  EXPECT_TRUE(dragged(message, placement(), scene, {}).empty());
  message.object = 3;
  Placement later = placement();
  later.t_ns = 5'000'000'000;
  EXPECT_TRUE(dragged(message, later, scene, {}).empty());
}

TEST(Traffic, DrawsABoxAndItsHandle) {
  const std::vector<OverlayLine> lines = object_lines(placement(), car(3, 10, 0));
  ASSERT_EQ(lines.size(), 5u);
  EXPECT_EQ(lines[0].label, "CAR 3");
  EXPECT_STREQ(lines[4].kind, "handle");
  Placement later = placement();
  later.t_ns = 5'000'000'000;
  EXPECT_TRUE(object_lines(later, car(3, 10, 0)).empty());
}

TEST(Traffic, AHandleLiesOutsideOfTheOutline) {
  for (const double heading_deg : {0, 45, 90, 180, 225, 300})
    for (const double x : {7, 10, 30}) {
      const std::vector<OverlayLine> lines = object_lines(placement(), car(3, x, 0, heading_deg));
      ASSERT_EQ(lines.size(), 5u) << heading_deg << " degrees, " << x << " m";
      Eigen::AlignedBox2d outline;  // the hull lies within
      for (const OverlayLine& line : lines)
        if (line.kind == std::string("object"))
          for (const Eigen::Vector2d& point : line.points) outline.extend(point);
      const Eigen::Vector2d tip = lines[4].points.back();
      EXPECT_TRUE(tip.minCoeff() > 0 && tip.maxCoeff() < 1);
      // Above, below or beside all of it, but for headings whose outline is no rectangle.
      if (heading_deg == 0 || heading_deg == 180) {
        EXPECT_FALSE(outline.contains(tip)) << heading_deg << " degrees, " << x << " m";
      }
    }
  const auto handle_in_axes = [](const Placement& from) {
    return *handle_in_box(from, *car(3, 10, 0).world_from_box(0), {4, 2, 1.5});
  };
  EXPECT_LT(handle_in_axes(placement()).x(), 4) << "seen from behind it hides what is ahead of it";
  Placement above = placement();
  above.world_from_camera.translation() = Vector3d(10, 0, 15);
  above.world_from_camera.linear() << 0, -1, 0, -1, 0, 0, 0, 0, -1;  // down, ahead is up
  EXPECT_NEAR(handle_in_axes(above).x(), std::sqrt(5) + 1, kTolerance) << "ahead of it";
  EXPECT_NEAR(handle_in_axes(above).y(), 0, kTolerance);
}

std::string refusal(const Scene& scene, const nlohmann::json& edit) {
  try {
    edited_traffic(scene, parse_traffic_edit(edit.dump(), "edit.json"));
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(Traffic, BoundsEdits) {
  const Scene scene = road({car(3, 10, 0)});
  nlohmann::json edit = {{"copies", nlohmann::json::array()}};
  for (int i = 0; i < 100; ++i) edit["copies"].push_back({{"of", 3}, {"id", 100 + i}});
  EXPECT_EQ(refusal(scene, edit), "");
  edit["copies"].push_back({{"of", 3}, {"id", 200}});
  EXPECT_THAT(refusal(scene, edit), HasSubstr("copies"));
  const auto track_until = [](double time_s) {
    return nlohmann::json{{"actors",
                           {{"3",
                             {{"track",
                               {{{"time_s", 0}, {"position_m", {0, 0, 0}}},
                                {{"time_s", time_s}, {"position_m", {9, 0, 0}}}}}}}}}};
  };
  EXPECT_EQ(refusal(scene, track_until(61)), "");
  EXPECT_THAT(refusal(scene, track_until(61.5)), HasSubstr("actors.3.track[1].time_s"));
  EXPECT_THAT(refusal(scene, {{"actors", {{"4", {{"remove", true}}}}}}), HasSubstr("actors.4"));
}

TEST(Traffic, RefusesBodiesOfOtherFiles) {
  const auto with_body = [](const std::string& file) {
    return parse_traffic_edit(
        nlohmann::json{{"actors", {{"3", {{"body", {{"file", file}}}}}}}}.dump(), "edit.json");
  };
  EXPECT_NO_THROW(check_body_files(with_body("car.ply"), with_body("car.ply")));
  EXPECT_NO_THROW(check_body_files({}, {}));
  EXPECT_THROW(check_body_files(with_body("/etc/passwd"), with_body("car.ply")), InputError);
  EXPECT_THROW(check_body_files(with_body("car.ply"), {}), InputError);
}

TEST(Traffic, BeginsWithTheChosenObjects) {
  const Scene scene = road({car(3, 10, 0), car(7, 20, 0)});
  EXPECT_EQ(first_edit(scene, "all", "").text, "");
  const auto ids = [&](const std::string& actors, const std::string& file) {
    const FirstEdit first = first_edit(scene, actors, file);
    std::vector<std::int64_t> ids;
    for (const MovingObject& actor :
         edited_traffic(scene, parse_traffic_edit(first.text, "edit.json")).scene.actors)
      ids.push_back(actor.id);
    return ids;
  };
  EXPECT_EQ(ids("none", ""), std::vector<std::int64_t>{});
  EXPECT_EQ(ids("7", ""), std::vector<std::int64_t>{7});
  TemporaryFolder folder;
  const std::filesystem::path file = folder.path / "edit.json";
  std::ofstream(file) << R"({"actors": {"3": {"shift_m": [10, 0, 0]}},
                             "copies": [{"of": 3, "id": 8}, {"of": 7, "id": 9}]})";
  EXPECT_EQ(ids("all", file), (std::vector<std::int64_t>{3, 7, 8, 9}));
  EXPECT_EQ(ids("7,9", file), (std::vector<std::int64_t>{7, 9}));
  EXPECT_THAT(first_edit(scene, "all", file).remarks,
              ::testing::Contains("objects 3 and 7 overlap"));
  EXPECT_THROW(first_edit(scene, "5", file), UsageError);
  std::ofstream(file) << R"({"actors": {"5": {}}})";
  EXPECT_THROW(first_edit(scene, "all", file), InputError);
}

/// A run without a model, whose object 7 drives 10 m ahead of the first pose.
class TrafficPlacement : public testing::Test {
 protected:
  TrafficPlacement() {
    run_.recording = make_test_recording(folder_.path, 3);
    run_.scene = make_scene(run_.recording, {});
    MovingObject object = car(7, 10, 0);
    for (std::size_t i = 0; i < object.keys.size(); ++i) {
      object.keys[i].t_ns += 1'000'000'000;
      object.keys[i].world_from_box.translation().x() += static_cast<double>(i);
    }
    run_.scene.actors = {object};
  }
  TemporaryFolder folder_;
  redrive::Run run_;
  PaintBackend backend_{[](const auto&, const auto&) { return std::array<float, 3>{}; }};
};

TEST_F(TrafficPlacement, MovesWithTheTimeOfAPath) {
  ViewRenderer renderer(run_, backend_);
  ViewRequest request;
  request.camera = "FRONT";
  request.frame = 12;
  Rigid3d pose = Rigid3d::Identity();
  pose.translation() = Vector3d(1, 2, 3);
  const Placement placed = renderer.place_at(
      request, {.t_s = 9, .world_from_camera = pose, .drive_s = 0.05}, run_.scene);
  EXPECT_EQ(placed.t_ns, 1'050'000'000) << "neither the frame's time nor the path's";
  ASSERT_EQ(placed.actors.size(), 1u);
  const Rigid3d world_from_actor =
      pose * rigid(placed.actors[0].actor_from_camera[0]).inverse(Eigen::Isometry);
  EXPECT_NEAR(world_from_actor.translation().x(), 10.5, 1e-5);
  EXPECT_EQ(renderer.place(request).t_ns, run_.recording.frames[2].t_ns);
}

TEST_F(TrafficPlacement, DescribesObjects) {
  const nlohmann::json objects = objects_to_json(run_.scene);
  ASSERT_EQ(objects.size(), 1u);
  EXPECT_EQ(objects[0]["id"], 7);
  EXPECT_EQ(objects[0]["type"], "CAR");
  EXPECT_EQ(objects[0]["frames"], (nlohmann::json{10, 12}));
  EXPECT_EQ(objects[0]["nearest"]["camera"], "FRONT");
}

}  // namespace
}  // namespace redrive::view
