// SPDX-License-Identifier: Apache-2.0
// A scene of nuScenes: the street with traffic, its two pinholes undistorted, in that layout.
#include <algorithm>
#include <array>
#include <map>
#include <set>

#include "redrive/image/image_io.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/scene/load_views.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr std::int64_t kRevolution_ns = 50'000'000, kColumn_ns = 46'080;
constexpr int kKeyEvery = 5;

bool earlier(const LidarPoint& a, const LidarPoint& b) { return a.t_ns < b.t_ns; }

class EndToEndNuScenes : public EndToEnd {
 protected:
  EndToEndNuScenes() {
    SceneOptions options;
    options.cameras = {"F_MIDRANGECAM_C", "F_MIDLONGRANGECAM_CL"};
    options.undistort = true;
    const Scene scene = make_scene(street_, options);
    tables_["scene"].push_back({{"token", "t"}, {"name", "scene-0001"}});
    for (std::size_t f = 0; f < scene.frames.size(); f += kKeyEvery)
      tables_["sample"].push_back({{"token", sample_of(f)},
                                   {"scene_token", "t"},
                                   // The laser points ahead 37.5 ms before its revolution ends.
                                   {"timestamp", (scene.frames[f].t_ns + 37'500'000) / 1000}});
    add_sensor("LIDAR_TOP", "lidar", street_.lidars[0].body_from_lidar, nlohmann::json::array());
    for (std::size_t c = 0; c < scene.rig.size(); ++c) {
      const Camera& camera = scene.rig[c].camera;
      add_sensor(kCameras[c], "camera", scene.rig[c].body_from_sensor,
                 {{camera.fx, 0, camera.cx}, {0, camera.fy, camera.cy}, {0, 0, 1}});
    }
    for (const View& view : scene.views) {
      const Image8 image = load_view(scene, view);
      const std::string name = std::string(kCameras[view.camera]) + "/" +
                               std::to_string(scene.frames[view.frame].id) + ".png";
      const fs::path path = folder_ / "samples" / name;
      fs::create_directories(path.parent_path());
      write_image(path, image);
      add_file(kCameras[view.camera], view.frame, scene.frames[view.frame].t_ns, "samples/" + name);
      tables_["sample_data"].back()["width"] = image.width;
      tables_["sample_data"].back()["height"] = image.height;
    }
    add_revolutions();
    add_boxes(scene);
    for (const auto& [table, records] : tables_) {
      fs::create_directories(folder_ / "v1.0-mini");
      write_file(folder_ / ("v1.0-mini/" + table + ".json"), records.dump(0));
    }
  }

  static std::string sample_of(std::size_t frame) {
    return "a" + std::to_string(
                     std::min<std::size_t>(20, (frame + kKeyEvery - 1) / kKeyEvery * kKeyEvery));
  }
  Rigid3d map_from_body(std::int64_t t_ns) const {
    return street_.frames[0].global_from_body.inverse() * pose_at(street_.frames, t_ns);
  }
  static nlohmann::json pose_fields(const Rigid3d& pose) {
    const Eigen::Quaterniond q(pose.linear());
    const Eigen::Vector3d t = pose.translation();
    return {{"rotation", {q.w(), q.x(), q.y(), q.z()}}, {"translation", {t.x(), t.y(), t.z()}}};
  }

  void add_sensor(const std::string& channel, const std::string& modality,
                  const Rigid3d& body_from_sensor, const nlohmann::json& intrinsic) {
    tables_["sensor"].push_back({{"token", channel}, {"channel", channel}, {"modality", modality}});
    nlohmann::json record = pose_fields(body_from_sensor);
    record.update({{"token", channel}, {"sensor_token", channel}, {"camera_intrinsic", intrinsic}});
    tables_["calibrated_sensor"].push_back(record);
  }

  void add_file(const std::string& channel, int frame, std::int64_t t_ns, const std::string& name) {
    const std::string token = channel + std::to_string(t_ns);
    tables_["sample_data"].push_back({{"token", token},
                                      {"sample_token", sample_of(static_cast<std::size_t>(frame))},
                                      {"ego_pose_token", token},
                                      {"calibrated_sensor_token", channel},
                                      {"filename", name},
                                      {"timestamp", t_ns / 1000},
                                      {"is_key_frame", frame % kKeyEvery == 0},
                                      {"width", 0},
                                      {"height", 0}});
    nlohmann::json record = pose_fields(map_from_body(t_ns / 1000 * 1000));
    record.update({{"token", token}, {"timestamp", t_ns / 1000}});
    tables_["ego_pose"].push_back(record);
  }

  /// Cuts the street's points into revolutions, compensated to their ends, in columns of at
  /// most 32.
  void add_revolutions() {
    std::vector<LidarPoint> points;
    for (const FrameFile& file : street_.lidar_files)
      std::ranges::copy(street_.reader->read_lidar(file), std::back_inserter(points));
    std::ranges::sort(points, earlier);
    const std::int64_t first_ns = points[0].t_ns / 1000 * 1000;
    for (std::int64_t end_ns = first_ns + kRevolution_ns; end_ns < points.back().t_ns;
         end_ns += kRevolution_ns) {
      const Rigid3d lidar_from_map =
          (map_from_body(end_ns) * street_.lidars[0].body_from_lidar).inverse();
      constexpr std::size_t kColumns = kRevolution_ns / kColumn_ns + 1;
      std::vector<std::vector<const LidarPoint*>> columns(kColumns);
      for (const LidarPoint& point : points)
        if (point.t_ns > end_ns - kRevolution_ns && point.t_ns <= end_ns)
          columns[kColumns - 1 - static_cast<std::size_t>((end_ns - point.t_ns) / kColumn_ns)]
              .push_back(&point);
      std::string bytes;
      for (std::vector<const LidarPoint*>& column : columns) {
        column.resize(std::clamp<std::size_t>(column.size(), 1, 32));
        for (std::size_t ring = 0; ring < column.size(); ++ring) {
          Eigen::Vector3f in_lidar = Eigen::Vector3f::Zero();
          if (column[ring]) {
            const Eigen::Vector3d in_map =
                map_from_body(column[ring]->t_ns) * column[ring]->in_body_m.cast<double>();
            if (end_ns == first_ns + kRevolution_ns) first_revolution_in_map_.push_back(in_map);
            in_lidar = (lidar_from_map * in_map).cast<float>();
          }
          const std::array<float, 5> record = {in_lidar.x(), in_lidar.y(), in_lidar.z(),
                                               column[ring] ? 20.0f : 0.0f,
                                               static_cast<float>(32 - column.size() + ring)};
          bytes.append(reinterpret_cast<const char*>(record.data()), sizeof record);
        }
      }
      const std::string name = "sweeps/LIDAR_TOP/" + std::to_string(end_ns) + ".pcd.bin";
      fs::create_directories(folder_ / "sweeps/LIDAR_TOP");
      write_file(folder_ / name, bytes);
      add_file("LIDAR_TOP", 1, end_ns, name);
    }
  }

  void add_boxes(const Scene& scene) {
    tables_["category"].push_back({{"token", "c"}, {"name", "vehicle.car"}});
    for (std::size_t f = 0; f < scene.frames.size(); f += kKeyEvery)
      for (const FrameFile& file : street_.box_files) {
        if (file.frame_id != scene.frames[f].id) continue;
        for (const Box& box : street_.reader->read_boxes(file)) {
          const std::string object = "i" + std::to_string(box.object_id);
          nlohmann::json record = pose_fields(map_from_body(box.t_ns) * box.body_from_box);
          record.update({{"sample_token", sample_of(f)},
                         {"instance_token", object},
                         {"size", {box.size_m.y(), box.size_m.x(), box.size_m.z()}}});
          tables_["sample_annotation"].push_back(record);
          if (objects_.insert(object).second)
            tables_["instance"].push_back({{"token", object}, {"category_token", "c"}});
        }
      }
  }

  static constexpr const char* kCameras[] = {"CAM_FRONT", "CAM_FRONT_LEFT"};
  const Recording street_ =
      open_recording(REDRIVE_SAMPLES "/street_traffic", PoseSource::kGroundTruth);
  const fs::path scene_ = folder_ / "v1.0-mini/scene-0001";
  std::map<std::string, nlohmann::json> tables_;
  std::set<std::string> objects_;
  std::vector<Eigen::Vector3d> first_revolution_in_map_;
};

TEST_F(EndToEndNuScenes, IsInspectedTrainedAndResumed) {
  const ProgramResult inspected =
      redrive({"inspect", scene_.string(), "--json", "--report", (folder_ / "check").string()});
  ASSERT_EQ(inspected.exit_code, kExitOk) << inspected.out << inspected.err;
  const nlohmann::json found = nlohmann::json::parse(inspected.out);
  EXPECT_EQ(found["format"], "nuscenes");
  EXPECT_EQ(found["frames"]["count"], 24);
  EXPECT_EQ(found["box_files"], 22) << "up to 0.1 s after the last key frame";
  for (const nlohmann::json& camera : found["preflight"]["cameras"])
    EXPECT_EQ(camera["verdict"], "good") << camera;

  const std::string run = (folder_ / "run").string();
  const ProgramResult trained =
      redrive({"train", scene_.string(), "--out", run, "--downscale", "8", "--method", "grid",
               "--batch", "64", "--max-steps", "3", "--threads", "2"});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  EXPECT_THAT(trained.out, AllOf(HasSubstr("LiDAR returns"), HasSubstr("moving objects masked")));
  const ProgramResult resumed = redrive({"resume", run, "--max-steps", "4"});
  EXPECT_EQ(resumed.exit_code, kExitOk) << resumed.err;
}

// A column is up to 46 us off: 0.5 mm at 10 m/s.
TEST_F(EndToEndNuScenes, LidarPointsAreWhereTheyWere) {
  const Recording recording = open_recording(scene_);
  const std::vector<LidarPoint> points = recording.reader->read_lidar(recording.lidar_files[0]);
  std::size_t i = 0;
  for (const LidarPoint& point : points) {
    if (point.intensity == 0) continue;  // a column without a point
    ASSERT_LT(i, first_revolution_in_map_.size());
    const Eigen::Vector3d in_map =
        pose_at(recording.frames, point.t_ns) * point.in_body_m.cast<double>();
    ASSERT_LT((in_map - first_revolution_in_map_[i++]).norm(), 0.005);
  }
  EXPECT_EQ(i, first_revolution_in_map_.size());
  EXPECT_GT(i, 500u);
}

}  // namespace
}  // namespace redrive::testing
