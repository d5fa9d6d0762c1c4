// SPDX-License-Identifier: Apache-2.0
// A simulated drive with labels, read back by redrive's own reader.
#include <csignal>
#include <map>
#include <thread>

#include <nlohmann/json.hpp>

#include "redrive/camera/camera.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/parse/rigid_json.h"
#include "tests/e2e/traffic_testing.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;

class Simulated : public TrafficEndToEnd {
 protected:
  Simulated() {
    const ProgramResult trained = train_on(kSample, run_, 40, {});
    EXPECT_EQ(trained.exit_code, kExitOk) << trained.err;
  }
  std::vector<std::string> simulate(const fs::path& out, std::vector<std::string> more) const {
    more.insert(more.begin(), {"simulate", run_.string(), "--out", out.string()});
    return more;
  }

  static constexpr const char* kSample = REDRIVE_SAMPLES "/street_traffic";
  const fs::path run_ = folder_ / "run", out_ = folder_ / "out";
};

std::vector<Box> boxes_of(const Recording& recording, std::int64_t frame) {
  const auto file = std::ranges::find(recording.box_files, frame, &FrameFile::frame_id);
  return recording.reader->read_boxes(*file);
}

/// Half a metre to the left of the driven way.
TEST_F(Simulated, ADriveIsReadBack) {
  const ProgramResult made = redrive(
      simulate(out_, {"--path", "sideways:0.5", "--labels", "guesses", "--sensor", "hdl-32e"}));
  ASSERT_EQ(made.exit_code, kExitOk) << made.err;
  EXPECT_FALSE(fs::exists(out_.string() + ".unfinished"));
  const Recording was = open_recording(kSample, PoseSource::kGroundTruth),
                  now = open_recording(out_);
  ASSERT_EQ(now.frames.size(), was.frames.size());
  const Rigid3d left(Eigen::Translation3d(0, 0.5, 0));
  for (std::size_t f = 0; f < now.frames.size(); ++f)
    EXPECT_LT(((was.frames[f].global_from_body * left).inverse() * now.frames[f].global_from_body *
                   Eigen::Vector3d::Ones() -
               Eigen::Vector3d::Ones())
                  .norm(),
              1e-6);
  ASSERT_EQ(now.cameras.size(), 1u);
  const CameraCalibration& camera = now.cameras[0].calibration;
  EXPECT_EQ(camera.name, kTrafficCamera);
  EXPECT_EQ(camera.parameters, was.find_camera(kTrafficCamera)->calibration.parameters);
  EXPECT_EQ(now.cameras[0].images.size(), was.frames.size());
  EXPECT_GT(now.read_lidar(now.lidar_files[12]).size(), 5000u);
  const std::vector<Box> recorded = boxes_of(was, 1012), simulated = boxes_of(now, 1012);
  ASSERT_EQ(simulated.size(), recorded.size());
  for (std::size_t i = 0; i < recorded.size(); ++i) {
    EXPECT_EQ(simulated[i].object_id, recorded[i].object_id);
    EXPECT_EQ(simulated[i].type, recorded[i].type);
    // Training corrects the tracks of moving ones.
    EXPECT_LT(((left * simulated[i].body_from_box).translation() -
               recorded[i].body_from_box.translation())
                  .norm(),
              i == 0 ? 1e-4 : 0.3);
  }

  const Image8 image = read_image(now.cameras[0].images[12].path),
               expected = rendered(run_, {"--translate", "0,0.5,0"});
  ASSERT_EQ(image.rgb.size(), expected.rgb.size());
  int others = 0;
  for (std::size_t i = 0; i < image.rgb.size(); ++i) others += image.rgb[i] != expected.rgb[i];
  EXPECT_LT(others, 20) << "poses agree to rounding";

  const nlohmann::json labels = read_json(out_ / "labels/instances.json");
  EXPECT_EQ(labels.at("images").size(), 24u);
  int seen = 0;
  for (const nlohmann::json& label : labels.at("annotations")) {
    const nlohmann::json& of = labels.at("images")[label.at("image_id").get<std::size_t>() - 1];
    EXPECT_TRUE(fs::exists(out_ / "labels" / of.at("file_name").get<std::string>()));
    if (of.at("frame_id") != 1012) continue;
    const Image16 ids = read_png16(out_ / "labels/ids" / kTrafficCamera / "1012.png");
    EXPECT_EQ(std::ranges::count(ids.values, label.at("number").get<int>()), label.at("area"));
    ++seen;
  }
  EXPECT_EQ(seen, 2);
  for (const char* file : {"depth/%.png", "flow/%.flo", "guesses/%.png"}) {
    std::string path = file;
    path.replace(path.find('%'), 1, std::string(kTrafficCamera) + "/1012");
    EXPECT_TRUE(fs::exists(out_ / "labels" / path)) << path;
  }
}

/// Cameras of one's own: another lens and place, and the recorded one under another name.
TEST_F(Simulated, AnotherRigIsRendered) {
  nlohmann::json rig = nlohmann::json::parse(
      read_file(std::string(kSample) + "/sensor/calibration/calibration_true.json"));
  const nlohmann::json recorded = rig.at(kTrafficCamera);
  rig = {{"ROOF", {{"sensor_type", "lidar"}}},
         {"SAME", recorded},
         {"WIDE",
          {{"sensor_type", "camera"},
           {"model", "opencv_fisheye"},
           {"image_resolution_px", {200, 150}},
           {"focal_length_px", {70, 70}},
           {"principal_point_px", {99.5, 74.5}},
           {"distortion_coeffs", {0, 0, 0, 0}},
           {"RT_body_from_sensor", recorded.at("RT_body_from_sensor")}}}};
  const fs::path file = folder_ / "rig.json";
  write_file(file, rig.dump());
  const ProgramResult made = redrive(simulate(out_, {"--rig", file.string(), "--sensor", "none"}));
  ASSERT_EQ(made.exit_code, kExitOk) << made.err;
  EXPECT_THAT(made.out, HasSubstr("ROOF is no camera"));
  const Recording now = open_recording(out_);
  ASSERT_EQ(now.cameras.size(), 2u);
  EXPECT_EQ(now.cameras[0].calibration.name, "SAME");
  EXPECT_EQ(now.cameras[1].calibration.model, "opencv_fisheye");
  ASSERT_EQ(now.cameras[1].images.size(), 24u);
  const Image8 same = read_image(now.cameras[0].images[12].path),
               expected = rendered(run_, {"--exposure", "none"}),
               wide = read_image(now.cameras[1].images[12].path);
  EXPECT_EQ(wide.width, 200);
  ASSERT_EQ(same.rgb.size(), expected.rgb.size());
  int others = 0;
  for (std::size_t i = 0; i < same.rgb.size(); ++i) others += same.rgb[i] != expected.rgb[i];
  EXPECT_LT(others, 20) << "poses agree to rounding";
  const nlohmann::json labels = read_json(out_ / "labels/instances.json");
  EXPECT_EQ(labels.at("images").size(), 48u);
  EXPECT_EQ(
      redrive(simulate(folder_ / "other", {"--rig", (folder_ / "none.json").string()})).exit_code,
      kExitBadInput);
  rig["WIDE"]["focal_length_px"] = {0, 70};
  write_file(file, rig.dump());
  const ProgramResult refused = redrive(simulate(folder_ / "other", {"--rig", file.string()}));
  EXPECT_EQ(refused.exit_code, kExitBadInput);
  EXPECT_THAT(refused.err, HasSubstr("WIDE.focal_length_px"));
}

/// The boxes of large objects of a simulated drive by image and track: x, y, width, height.
std::map<std::pair<std::string, std::int64_t>, std::vector<double>> large_objects(
    const fs::path& drive) {
  constexpr double kLarge_px = 1500;
  const nlohmann::json coco = nlohmann::json::parse(read_file(drive / "labels/instances.json"));
  std::map<std::int64_t, std::string> files;
  for (const auto& image : coco["images"]) files[image["id"]] = image["file_name"];
  std::map<std::pair<std::string, std::int64_t>, std::vector<double>> objects;
  for (const auto& one : coco["annotations"])
    if (one["area"] > kLarge_px)
      objects[{files.at(one["image_id"]), one["track_id"]}] =
          one["bbox"].get<std::vector<double>>();
  return objects;
}

// Of a drive in blocks, every image shows the objects of the same drive in one piece, also where
// one block fades into the next.
TEST_F(Simulated, BlocksHaveTheSameObjects) {
  const fs::path divided = folder_ / "divided", in_blocks = folder_ / "in_blocks";
  ASSERT_EQ(train_on(kSample, divided, 40, {"--blocks", "7"}).exit_code, kExitOk);
  ASSERT_TRUE(fs::exists(divided / "blocks/001"));
  const std::vector<std::string> more = {"--sensor", "none", "--labels", "masks"};
  ASSERT_EQ(redrive(simulate(out_, more)).exit_code, kExitOk);
  std::vector<std::string> arguments = simulate(in_blocks, more);
  arguments[1] = divided.string();
  const ProgramResult made = redrive(arguments);
  ASSERT_EQ(made.exit_code, kExitOk) << made.err;
  const auto whole = large_objects(out_), parts = large_objects(in_blocks);
  EXPECT_GT(whole.size(), 24u);
  std::size_t found = 0;
  for (const auto& [key, box] : whole) {
    const auto same = parts.find(key);
    if (same == parts.end()) continue;
    ++found;
    for (std::size_t k = 0; k < 4; ++k)
      EXPECT_NEAR(same->second[k], box[k], 12) << key.first << ' ' << key.second;
  }
  EXPECT_GE(found + 1, whole.size()) << "one may be just below the size";
}

Rigid3d rigid_of(const nlohmann::json& matrix) {
  return rigid_from_json(JsonField(matrix, "poses.json"));
}

// nuScenes has pinholes: labels are of its own images.
TEST_F(Simulated, LabelsAreOfTheFormatsImages) {
  const ProgramResult made =
      redrive(simulate(out_, {"--to", "nuscenes", "--labels", "masks", "--sensor", "none"}));
  ASSERT_EQ(made.exit_code, kExitOk) << made.err;
  EXPECT_THAT(made.out, HasSubstr("resampled to a pinhole"));
  const nlohmann::json labels = read_json(out_ / "labels/instances.json"),
                       poses = read_json(out_ / "labels/poses.json");
  const Recording now = open_recording(out_);
  const Camera pinhole = make_camera(now.cameras.at(0).calibration);
  std::size_t seen = 0;
  for (const nlohmann::json& image : labels.at("images")) {
    const Image8 own = read_image(out_ / std::string(image.at("drive_file"))),
                 shown = read_image(out_ / "labels" / std::string(image.at("file_name")));
    EXPECT_EQ(own.rgb, shown.rgb);
    const auto pose = std::ranges::find_if(poses.at("images"), [&](const nlohmann::json& other) {
      return other.at("file_name") == image.at("file_name");
    });
    const Rigid3d camera_from_world = rigid_of(pose->at("world_from_camera")).inverse();
    for (const nlohmann::json& label : labels.at("annotations")) {
      if (label.at("image_id") != image.at("id") || label.at("truncation") > 0.01) continue;
      const Rigid3d camera_from_box =
          camera_from_world *
          rigid_of(pose->at("world_from_box").at(std::to_string(int(label.at("track_id")))));
      const auto centre = pinhole.project(camera_from_box.translation());
      ASSERT_TRUE(centre);
      const std::vector<double> box = label.at("whole_bbox");
      EXPECT_NEAR(centre->x(), box[0] + box[2] / 2, 0.2 * box[2] + 2);
      EXPECT_NEAR(centre->y(), box[1] + box[3] / 2, 0.2 * box[3] + 2);
      ++seen;
    }
  }
  EXPECT_GT(seen, 20u);
}

TEST_F(Simulated, AKilledSimulationContinues) {
  const std::vector<std::string> arguments = simulate(out_, {"--sensor", "none"});
  const fs::path done = out_.string() + ".unfinished/done/" + kTrafficCamera + "/1003.json";
  Program killed(REDRIVE_BINARY, arguments);
  for (int i = 0; i < 60'000 && !fs::exists(done) && !fs::exists(out_); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  killed.send(SIGKILL);
  killed.wait();
  EXPECT_FALSE(fs::exists(out_));
  const ProgramResult continued = redrive(arguments);
  ASSERT_EQ(continued.exit_code, kExitOk) << continued.err;
  EXPECT_THAT(continued.out, HasSubstr("images were there"));
  const fs::path whole = folder_ / "whole";
  ASSERT_EQ(redrive(simulate(whole, {"--sensor", "none"})).exit_code, kExitOk);
  const auto a = contents(out_), b = contents(whole);
  ASSERT_EQ(a.size(), b.size());
  for (auto i = a.begin(), j = b.begin(); i != a.end(); ++i, ++j)
    EXPECT_TRUE(i->second == j->second) << i->first;
  EXPECT_EQ(redrive(arguments).exit_code, kExitUsage) << "it is there";
}

}  // namespace
}  // namespace redrive::testing
