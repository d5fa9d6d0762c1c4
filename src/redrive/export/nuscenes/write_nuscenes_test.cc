// SPDX-License-Identifier: Apache-2.0
// A drive as a scene of nuScenes, read back, and its tables.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/export/made_drive_testing.h"
#include "redrive/export/nuscenes/nuscenes_terms.h"
#include "redrive/image/image_io.h"

namespace redrive {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class WriteNuScenes : public MadeDrive {
 protected:
  WriteNuScenes() {
    recording_.cameras[1].calibration.parameters = {22, 20, 11.5, 7.5, 0, 0, 0, 0, 0};
    reader_->has_ring = true;
  }
  Recording written() {
    notes_ = write_nuscenes(out_, drive(), pool_, stop_);
    return open_recording(out_);
  }
  nlohmann::json table(const std::string& name) const {
    return nlohmann::json::parse(read_file(out_ / "v1.0-redrive" / (name + ".json")));
  }
  /// Times count from 10 s before the first frame.
  std::int64_t later_ns() const { return 10'000'000'000 - recording_.frames[0].t_ns; }
  /// The pose of the first frame is the map's origin.
  Rigid3d map_from_global() const { return recording_.frames[0].global_from_body.inverse(); }
};

TEST_F(WriteNuScenes, ComesBack) {
  const Recording now = written();
  EXPECT_EQ(now.format, "nuscenes");
  EXPECT_TRUE(now.findings.empty()) << now.findings[0].what;
  EXPECT_TRUE(now.damaged.empty());
  ASSERT_EQ(now.cameras.size(), 2u);
  const Scene scene = make_scene(now, {}), before = make_scene(recording_, {});
  ASSERT_EQ(scene.views.size(), before.views.size());
  for (const View& view : scene.views) {
    const std::size_t was = scene.rig[view.camera].camera.fx == 22 ? 1 : 0;
    const std::int64_t t_ns = scene.frames[view.frame].t_ns + scene.rig[view.camera].time_offset_ns;
    const Rigid3d expected = map_from_global() * pose_at(recording_.frames, t_ns - later_ns()) *
                             recording_.cameras[was].calibration.body_from_sensor;
    const Rigid3d found = scene.global_from_world * scene.world_from_camera(view);
    EXPECT_LT((found.translation() - expected.translation()).norm(), 1e-6);
    EXPECT_LT((found.linear() - expected.linear()).norm(), 1e-6);
  }
  const auto pinhole = std::ranges::find_if(
      now.cameras, [&](const RecordedCamera& camera) { return camera.calibration.fx() == 22; });
  ASSERT_NE(pinhole, now.cameras.end());
  EXPECT_EQ(read_file(pinhole->images[3].path), read_file(recording_.cameras[1].images[3].path));
}

// Static points stay where they are in the world. The file has no times: columns are spread over
// the least interval of two scans, where the made scanner turns once in 0.1 s.
TEST_F(WriteNuScenes, PointsStayInTheWorld) {
  const Recording now = written();
  ASSERT_EQ(now.lidar_files.size(), 5u);
  double least_ns = 1e9;
  for (std::size_t f = 1; f < 5; ++f)
    least_ns =
        std::min(least_ns, double(recording_.frames[f].t_ns - recording_.frames[f - 1].t_ns));
  const double off_ns = 1e6 + std::abs(1e8 - least_ns);
  for (std::size_t f = 0; f < 5; ++f) {
    const auto points = now.read_lidar(now.lidar_files[f]),
               were = recording_.read_lidar(recording_.lidar_files[f]);
    ASSERT_EQ(points.size(), were.size());
    for (std::size_t i = 0; i < points.size(); i += 7) {
      const Eigen::Vector3d found = pose_at(now.frames, points[i].t_ns) *
                                    points[i].in_body_m.cast<double>(),
                            expected =
                                map_from_global() * (pose_at(recording_.frames, were[i].t_ns) *
                                                     were[i].in_body_m.cast<double>());
      EXPECT_LT((found - expected).norm(), 1e-5);
      EXPECT_NEAR(double(points[i].t_ns), double(were[i].t_ns + later_ns()), off_ns);
      EXPECT_EQ(points[i].intensity, were[i].intensity);
      EXPECT_EQ(points[i].ring, 3);
    }
  }
}

TEST_F(WriteNuScenes, BoxesFitTheReturnsOnThem) {
  written();
  const nlohmann::json annotations = table("sample_annotation"), instances = table("instance"),
                       samples = table("sample");
  ASSERT_EQ(instances.size(), 3u);
  ASSERT_EQ(annotations.size(), 3 * samples.size());
  for (const nlohmann::json& annotation : annotations) {
    EXPECT_EQ(annotation["size"], nlohmann::json({2, 4, 1.5}));
    EXPECT_EQ(annotation["visibility_token"], "4");
  }
  // No return of the made scanner lies within a box.
  EXPECT_EQ(annotations[0]["num_lidar_pts"], 0);
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("CAR is vehicle.car, Pedestrian is human.ped")));
  const Recording now = open_recording(out_);
  const auto boxes = now.reader->read_boxes(now.box_files[0]);
  ASSERT_EQ(boxes.size(), 3u);
  for (const Box& box : boxes) {
    const Rigid3d in_map = pose_at(now.frames, box.t_ns) * box.body_from_box;
    EXPECT_NEAR(in_map.translation().z(), 0.75, 1e-6);
    if (box.type != "vehicle.car" || in_map.translation().y() < 7.5) continue;
    EXPECT_NEAR(in_map.translation().x(), 10, 1e-6) << "the parked car";
  }
}

TEST_F(WriteNuScenes, CountsTheReturnsOnObjects) {
  const auto reader = std::make_shared<OnObjects>();
  reader->frames = recording_.frames;
  recording_.reader = reader;
  written();
  std::vector<int> counts;
  for (const nlohmann::json& annotation : table("sample_annotation"))
    counts.push_back(annotation["num_lidar_pts"]);
  counts.resize(3);
  EXPECT_THAT(counts, ElementsAre(7 + 8, 8 + 9, 9));
}

// Every token leads to a record, every chain to its end and every path to a file, as nuScenes'
// devkit needs.
TEST_F(WriteNuScenes, TablesRefer) {
  written();
  std::map<std::string, std::set<std::string>> tokens;
  for (const char* name :
       {"category", "attribute", "visibility", "instance", "sensor", "calibrated_sensor",
        "ego_pose", "log", "scene", "sample", "sample_data", "sample_annotation", "map"})
    for (const nlohmann::json& record : table(name))
      EXPECT_TRUE(tokens[name].insert(record["token"]).second) << name;
  EXPECT_EQ(tokens["category"].size(), 23u);
  for (const nlohmann::json& file : table("sample_data")) {
    EXPECT_TRUE(tokens["sample"].contains(file["sample_token"]));
    EXPECT_TRUE(tokens["ego_pose"].contains(file["ego_pose_token"]));
    EXPECT_TRUE(tokens["calibrated_sensor"].contains(file["calibrated_sensor_token"]));
    EXPECT_TRUE(std::filesystem::exists(out_ / std::string(file["filename"])));
    const std::string folder = file["is_key_frame"] ? "samples/" : "sweeps/";
    EXPECT_TRUE(std::string(file["filename"]).starts_with(folder));
  }
  for (const char* name : {"sample", "sample_data", "sample_annotation"}) {
    std::map<std::string, nlohmann::json> by_token;
    for (const nlohmann::json& record : table(name)) by_token[record["token"]] = record;
    for (const auto& [token, record] : by_token)
      if (record["next"] != "") {
        EXPECT_EQ(by_token.at(record["next"])["prev"], token);
      }
  }
  for (const nlohmann::json& annotation : table("sample_annotation"))
    EXPECT_TRUE(tokens["instance"].contains(annotation["instance_token"]));
  for (const nlohmann::json& instance : table("instance")) {
    EXPECT_TRUE(tokens["category"].contains(instance["category_token"]));
    EXPECT_TRUE(tokens["sample_annotation"].contains(instance["first_annotation_token"]));
  }
  const nlohmann::json scene = table("scene")[0];
  EXPECT_TRUE(tokens["sample"].contains(scene["first_sample_token"]));
  EXPECT_EQ(scene["nbr_samples"], tokens["sample"].size());
  for (const nlohmann::json& sensor : table("calibrated_sensor"))
    EXPECT_TRUE(tokens["sensor"].contains(sensor["sensor_token"]));
  EXPECT_EQ(table("map")[0]["log_tokens"][0], table("log")[0]["token"]);
  EXPECT_TRUE(std::filesystem::exists(out_ / std::string(table("map")[0]["filename"])));
}

TEST_F(WriteNuScenes, FisheyesBecomePinholes) {
  const Recording now = written();
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("resampled to a pinhole")));
  for (const RecordedCamera& camera : now.cameras) {
    EXPECT_EQ(camera.calibration.model, "opencv_pinhole");
    EXPECT_EQ(read_image(camera.images[0].path).width, camera.calibration.width);
  }
}

RecordedCamera camera_at(const std::string& name, double left_deg) {
  RecordedCamera camera;
  camera.calibration.name = name;
  Eigen::Matrix3d body_from_ahead;
  body_from_ahead << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  camera.calibration.body_from_sensor.linear() =
      Eigen::AngleAxisd(left_deg * M_PI / 180, Eigen::Vector3d::UnitZ()) * body_from_ahead;
  return camera;
}

TEST(NuScenesTerms, ChannelsLookTheSameWay) {
  EXPECT_THAT(
      nuscenes::channels_of({camera_at("wide", 4), camera_at("narrow", 1),
                             camera_at("left side", 90), camera_at("CAM_BACK", 170),
                             camera_at("rear", 181), camera_at("rear", 180)}),
      ElementsAre("CAM_WIDE", "CAM_FRONT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_REAR", "CAM_REAR_2"));
}

TEST(NuScenesTerms, CategoriesOfOtherDataSets) {
  for (const auto& [type, category] :
       std::map<std::string, std::string>{{"CAR", "vehicle.car"},
                                          {"Van", "vehicle.car"},
                                          {"Pickup Truck", "vehicle.car"},
                                          {"BOX_TRUCK", "vehicle.truck"},
                                          {"vehicle.bus.bendy", "vehicle.bus.bendy"},
                                          {"SCHOOL_BUS", "vehicle.bus.rigid"},
                                          {"Cyclist", "vehicle.bicycle"},
                                          {"MOTORCYCLIST", "vehicle.motorcycle"},
                                          {"Person_sitting", "human.pedestrian.adult"},
                                          {"Tram", "Tram"},
                                          {"Construction Cone", "movable_object.trafficcone"},
                                          {"Carriage", "Carriage"},
                                          {"RAILED_VEHICLE", "RAILED_VEHICLE"}})
    EXPECT_EQ(nuscenes::category_of(type), category) << type;
}

}  // namespace
}  // namespace redrive
