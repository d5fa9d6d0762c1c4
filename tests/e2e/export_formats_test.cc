// SPDX-License-Identifier: Apache-2.0
// redrive export to the formats of other programs, read back.
#include <cmath>

#include <nlohmann/json.hpp>

#include "redrive/image/image_io.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/ply.h"
#include "redrive/scene/scene.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class ExportFormats : public EndToEnd {
 protected:
  ExportFormats() {
    edit_json(tiny_calibration(drive_), [](nlohmann::json& calibration) {
      calibration[kTinyFront]["time_offset_s"] = 0.02;
      calibration[kTinyRear]["readout_s"] = 0.03;
    });
    // A wall 8 m ahead of the first frame, all of which the front camera sees.
    std::vector<PlyPoint> wall;
    for (int y = -4; y <= 4; ++y)
      for (int z = 0; z < 4; ++z)
        wall.push_back({{8, 0.5f * static_cast<float>(y), static_cast<float>(z)}, {0, 0, 0}, {}});
    write_file(drive_ / "points.ply", make_ply(wall, false));
  }

  ProgramResult exported(const fs::path& from, const std::string& format,
                         const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {"export", from.string(), "--to",      format,
                                          "--out",  out_.string(), "--threads", "2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(arguments);
  }

  const fs::path out_ = folder_ / "out";
};

/// The view of `scene` whose image is called so.
const View* find_view(const Scene& scene, const fs::path& stem) {
  for (const View& view : scene.views)
    if (view.image.stem() == stem) return &view;
  return nullptr;
}

/// Compares poses in the drive's scene and, where the lens is the same, the direction of every 5th
/// pixel.
void expect_same_rays(const fs::path& drive, const fs::path& out) {
  const Scene before = make_scene(open_recording(drive), {});
  const Recording recording = open_recording(out);
  const Scene after = make_scene(recording, {});
  ASSERT_EQ(after.views.size(), before.views.size());
  ASSERT_EQ(after.rig.size(), before.rig.size());
  for (const View& view : before.views) {
    const RigCamera& rig = before.rig[view.camera];
    const View* same = find_view(after, view.image.stem());
    ASSERT_TRUE(same) << view.image;
    const Rigid3d expected = before.world_from_camera(view),
                  found = after.global_from_world * after.world_from_camera(*same);
    EXPECT_LT((expected.translation() - found.translation()).norm(), 1e-6) << view.image;
    EXPECT_LT((expected.linear() - found.linear()).norm(), 1e-6) << view.image;
    const Camera& camera = after.rig[same->camera].recorded;
    if (rig.name == kTinyLeft) {
      EXPECT_EQ(camera.info().name, "opencv_fisheye") << "neither format has mei";
      continue;
    }
    for (int y = 0; y < camera.height; y += 5)
      for (int x = 0; x < camera.width; x += 5) {
        const auto direction = rig.recorded.unproject({double(x), double(y)});
        if (!direction) continue;
        const auto pixel = camera.project(*direction);
        ASSERT_TRUE(pixel);
        EXPECT_LT((*pixel - Eigen::Vector2d(x, y)).norm(), 1e-4) << x << ' ' << y;
      }
  }
}

/// Compares the resampled fisheye with the colours of the sphere that the drive's images show.
void expect_resampled(const fs::path& drive, const fs::path& out) {
  const Scene before = make_scene(open_recording(drive), {}),
              after = make_scene(open_recording(out), {});
  const View* view = find_view(after, tiny_image("", kTinyLeft, kTinyFirstId).stem());
  ASSERT_TRUE(view);
  const Image8 recorded = read_image(tiny_image(drive, kTinyLeft, kTinyFirstId)),
               image = read_image(view->image), mask = read_image(view->mask.path);
  const Camera& from = before.rig[before.camera_index(kTinyLeft)].recorded;
  const Camera& to = after.rig[view->camera].recorded;
  double difference = 0;
  int compared = 0, masked = 0;
  for (int y = 1; y + 1 < to.height; ++y)
    for (int x = 1; x + 1 < to.width; ++x) {
      const std::size_t i = 3 * (static_cast<std::size_t>(y) * to.width + x);
      const auto pixel = from.project(*to.unproject({double(x), double(y)}));
      if (mask.rgb[i] == 0) {
        ++masked;
        continue;
      }
      ASSERT_TRUE(pixel);
      const auto u = static_cast<std::size_t>(std::lround(pixel->x())),
                 v = static_cast<std::size_t>(std::lround(pixel->y()));
      ++compared;
      for (std::size_t k = 0; k < 3; ++k)
        difference += std::abs(image.rgb[i + k] - recorded.rgb[3 * (v * recorded.width + u) + k]);
    }
  EXPECT_GT(compared, 600);
  // The colours change by up to 17 levels a pixel, and the nearest pixel is a third of one away.
  EXPECT_LT(difference / (3 * compared), 8);
  EXPECT_GT(masked, 10) << "beyond the edge of the recorded image";
}

TEST_F(ExportFormats, ColmapComesBackWithTheSameRays) {
  const ProgramResult ended = exported(drive_, "colmap");
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  EXPECT_THAT(ended.out, AllOf(HasSubstr("12 images of 3 cameras"), HasSubstr("36 points"),
                               HasSubstr("rolling shutter of " + std::string(kTinyRear)),
                               HasSubstr("time offsets of " + std::string(kTinyFront)),
                               HasSubstr("the lens of " + std::string(kTinyLeft) + " (mei)")));
  expect_same_rays(drive_, out_);
  expect_resampled(drive_, out_);
  EXPECT_EQ(
      read_file(out_ / "images" / kTinyFront / tiny_image("", kTinyFront, kTinyFirstId).filename()),
      read_file(tiny_image(drive_, kTinyFront, kTinyFirstId)))
      << "not encoded again";
  for (const char* kind : {"bin", "txt"}) {
    const Recording recording = open_recording(out_);
    EXPECT_EQ(recording.format, "colmap");
    const auto points = recording.reader->read_points(recording);
    ASSERT_EQ(points.size(), 36u) << kind;
    for (const StaticPoint& point : points) EXPECT_NEAR(point.in_global.x(), 8, 1e-5);
    for (const char* file : {"cameras.bin", "images.bin", "points3D.bin"})
      fs::remove(out_ / "sparse/0" / file);
  }
  expect_same_rays(drive_, out_);  // text
}

TEST_F(ExportFormats, TransformsComeBackWithTheSameRays) {
  const ProgramResult ended = exported(drive_, "transforms");
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  expect_same_rays(drive_, out_);
  expect_resampled(drive_, out_);
  const Recording recording = open_recording(out_);
  EXPECT_EQ(recording.reader->read_points(recording).size(), 36u);
}

// Poses of every image in the axes of the first one: frames may have other times, and the world is
// the body at the first of them.
void expect_same_poses(const fs::path& drive, const fs::path& out,
                       const std::map<std::string, std::string>& names) {
  const Scene before = make_scene(open_recording(drive), {}),
              after = make_scene(open_recording(out), {});
  ASSERT_EQ(after.rig.size(), names.size());
  std::optional<Rigid3d> before_from_after;
  for (const View& view : after.views) {
    const std::string& was = names.at(after.rig[view.camera].name);
    const std::int64_t id = after.frames[view.frame].id;
    const View* same = find_view(before, tiny_image("", was, static_cast<int>(id)).stem());
    ASSERT_TRUE(same) << id;
    const Rigid3d expected = before.world_from_camera(*same);
    if (!before_from_after)
      before_from_after = expected * after.world_from_camera(view).inverse(Eigen::Isometry);
    const Rigid3d found = *before_from_after * after.world_from_camera(view);
    EXPECT_LT((expected.translation() - found.translation()).norm(), 1e-6) << view.image;
    EXPECT_LT((expected.linear() - found.linear()).norm(), 1e-6) << view.image;
  }
}

TEST_F(ExportFormats, Kitti360ComesBackAndTrains) {
  const ProgramResult ended = exported(drive_, "kitti360");
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  EXPECT_THAT(
      ended.out,
      AllOf(HasSubstr("4 frames, poses as recorded"), HasSubstr("changed: M_FISHEYE_L is image_02"),
            HasSubstr("not exported: rolling shutter of image_0"),
            HasSubstr("not exported: the static point cloud"), HasSubstr("not ECEF")));
  const bool front_first =
      ended.out.find(std::string(kTinyFront) + " is image_00") != std::string::npos;
  expect_same_poses(drive_, out_,
                    {{front_first ? "image_00" : "image_01", kTinyFront},
                     {front_first ? "image_01" : "image_00", kTinyRear},
                     {"image_02", kTinyLeft}});
  const ProgramResult table = redrive({"inspect", out_.string()});
  EXPECT_EQ(table.exit_code, kExitOk) << table.out << table.err;
  EXPECT_THAT(table.out, HasSubstr("(kitti360)"));
  const ProgramResult trained =
      redrive({"train", out_.string(), "--out", (folder_ / "run").string(), "--method", "nerf",
               "--width", "32", "--samples", "12", "--batch", "128", "--max-steps", "2",
               "--threads", "2", "--frames", "101:103"});
  EXPECT_EQ(trained.exit_code, kExitOk) << trained.out << trained.err;
}

TEST_F(ExportFormats, KittiComesBack) {
  const ProgramResult ended = exported(drive_, "kitti");
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("not exported: camera M_FISHEYE_L (mei)"));
  EXPECT_THAT(ended.out, HasSubstr(std::string(kTinyFront) + " is image_02"));
  ProgramResult table;
  for (const auto& entry : fs::recursive_directory_iterator(out_))
    if (entry.path().filename().string().ends_with("_sync"))
      table = redrive({"inspect", entry.path().string()});
  EXPECT_EQ(table.exit_code, kExitOk) << table.out << table.err;
  EXPECT_THAT(table.out, AllOf(HasSubstr("(kitti)"), HasSubstr("ids 0 to 3")));
}

TEST_F(ExportFormats, AimotiveKeepsWhatTheRunUses) {
  const fs::path run = trained("run", 2, {"--cameras", kTinyFront});
  const ProgramResult ended = exported(run, "aimotive");
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  EXPECT_THAT(ended.out,
              AllOf(HasSubstr("4 frames, poses of the run"), HasSubstr("not exported: the field")));
  const Recording recording = open_recording(out_);
  ASSERT_EQ(recording.cameras.size(), 1u);
  EXPECT_NEAR(static_cast<double>(recording.cameras[0].calibration.time_offset_ns), 20e6, 2e6);
  EXPECT_EQ(recording.reader->read_points(recording).size(), 36u);
  EXPECT_EQ(exported(run, "aimotive", {"--force", "--frames", "101:102"}).exit_code, kExitUsage);
}

TEST_F(ExportFormats, NcoreIsASequenceAndItsStore) {
  const fs::path run = trained("run", 2, {"--cameras", kTinyFront});
  const ProgramResult ended = exported(run, "ncore");
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  EXPECT_THAT(ended.out, AllOf(HasSubstr("4 frames, poses of the run"),
                               HasSubstr("not exported: the static point cloud")));
  const std::string name = drive_.filename().string();
  const nlohmann::json sequence = read_json(out_ / (name + ".json"));
  EXPECT_EQ(sequence.at("version"), "v4");
  const nlohmann::json& store = sequence.at("component_stores").at(0);
  EXPECT_TRUE(fs::is_regular_file(out_ / store.at("path").get<std::string>()));
  EXPECT_TRUE(store.at("components").at("cameras").contains(kTinyFront));
  EXPECT_EQ(store.at("components").at("cameras").size(), 1u);
  // Images follow the poses by about 20 ms.
  const nlohmann::json& interval = sequence.at("sequence_timestamp_interval_us");
  const auto frames = open_recording(drive_).frames;
  EXPECT_NEAR(interval.at("stop").get<double>() - interval.at("start").get<double>(),
              1e-3 * static_cast<double>(frames.back().t_ns - frames.front().t_ns) + 20e3, 2e3);

  for (const int frame : {0, 1})  // a single one would only cost its own record
    write_file(tiny_image(drive_, kTinyLeft, kTinyFirstId + frame),
               "no image " + std::to_string(frame));
  fs::remove_all(out_);
  EXPECT_EQ(exported(drive_, "ncore").exit_code, kExitBadInput);
  EXPECT_FALSE(fs::exists(out_));
}

TEST_F(ExportFormats, FramesOfARecording) {
  ASSERT_EQ(exported(drive_, "aimotive", {"--frames", "101:102"}).exit_code, kExitOk);
  const Recording part = open_recording(out_);
  ASSERT_EQ(part.frames.size(), 2u);
  EXPECT_EQ(part.frames[0].id, 101);
  EXPECT_TRUE(part.points_file.empty()) << "it is in the axes of frame 100";
  // Poses of only these frames, as align --frames writes them, restrict the recording to them.
  fs::create_directories(folder_ / "poses/sensor");
  fs::copy(out_ / "sensor/gnssins", folder_ / "poses/sensor/gnssins");
  fs::copy(out_ / "sensor/calibration", folder_ / "poses/sensor/calibration");
  const ProgramResult ended =
      exported(drive_, "aimotive", {"--force", "--poses", (folder_ / "poses").string()});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("2 frames, poses of --poses"));
  const ProgramResult inspected =
      redrive({"inspect", drive_.string(), "--json", "--frames", ":101"});
  EXPECT_EQ(nlohmann::json::parse(inspected.out).at("frames").at("count"), 2);
  const ProgramResult none = redrive({"inspect", drive_.string(), "--frames", "7:8"});
  EXPECT_EQ(none.exit_code, kExitUsage);
  EXPECT_THAT(none.err, HasSubstr("100:103"));
}

TEST_F(ExportFormats, RunsKeepTheirPosesAndTheirSplit) {
  const fs::path run = trained("run", 20, {"--holdout-every", "2", "--cameras", kTinyFront});
  const ProgramResult ended = exported(run, "transforms");
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  EXPECT_THAT(ended.out, AllOf(HasSubstr("4 images of 1 camera, poses of the run"),
                               HasSubstr("not exported: the field")));
  const nlohmann::json transforms = read_json(out_ / "transforms.json");
  EXPECT_EQ(transforms.at("test_filenames").size(), 2u);
  EXPECT_EQ(transforms.at("camera_model"), "OPENCV");

  const fs::path cloud = folder_ / "cloud.ply";
  const ProgramResult points =
      redrive({"export", run.string(), "--to", "ply", "--out", cloud.string(), "--threads", "2"});
  if (points.exit_code == kExitOk)
    EXPECT_GT(read_ply(cloud).size(), 0u);
  else  // a field of 20 steps may be transparent
    EXPECT_THAT(points.err, HasSubstr("no opaque surface"));
}

TEST_F(ExportFormats, WritesTheMeshOfARun) {
  const fs::path run = folder_ / "run", file = folder_ / "mesh.ply";
  const ProgramResult trained =
      redrive({"train", drive_.string(), "--out", run.string(), "--method", "splat", "--max-steps",
               "200", "--max-gaussians", "4000", "--set", "initial.sky=500", "--threads", "2"});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.out << trained.err;
  const auto before = contents(folder_);
  const auto mesh = [&](const fs::path& to, const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = {"export", run.string(), "--to", "mesh", to.string()};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(arguments);
  };
  const ProgramResult other = mesh(folder_ / "mesh.stl");
  EXPECT_EQ(other.exit_code, kExitUsage);
  EXPECT_THAT(other.err, HasSubstr(".ply, .obj or .glb"));
  EXPECT_EQ(mesh(file, {"--voxel", "0"}).exit_code, kExitUsage);
  EXPECT_EQ(contents(folder_), before);

  const ProgramResult ended = mesh(file, {"--voxel", "0.5"});
  if (ended.err.find("libopenvdb-dev") != std::string::npos)
    GTEST_SKIP() << "the build makes no meshes";
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  EXPECT_THAT(ended.out, AllOf(HasSubstr("triangles"), HasSubstr("voxels of 0.5 m")));
  EXPECT_THAT(read_file(file), HasSubstr("element face"));
  EXPECT_GT(read_ply(file).size(), 100u);
  EXPECT_EQ(mesh(file).exit_code, kExitUsage) << "exists";
  EXPECT_EQ(mesh(file, {"--force", "--voxel", "0.5"}).exit_code, kExitOk);
  EXPECT_EQ(mesh(drive_).exit_code, kExitUsage);
  EXPECT_EQ(
      redrive({"export", drive_.string(), "--to", "mesh", (folder_ / "a.obj").string()}).exit_code,
      kExitBadInput)
      << "a recording has no field";
}

TEST_F(ExportFormats, WritesThePointsOfARecording) {
  const fs::path cloud = folder_ / "cloud.ply";
  ASSERT_EQ(redrive({"export", drive_.string(), cloud.string(), "--to", "ply"}).exit_code, kExitOk);
  EXPECT_EQ(read_ply(cloud).size(), 36u);
  fs::remove(drive_ / "points.ply");
  const ProgramResult none =
      redrive({"export", drive_.string(), cloud.string(), "--to", "ply", "--force"});
  EXPECT_EQ(none.exit_code, kExitBadInput);
  EXPECT_THAT(none.err, HasSubstr("neither LiDAR nor a point cloud"));
}

TEST_F(ExportFormats, WritesAFolderWholeOrNotAtAll) {
  fs::create_directory(out_);
  write_file(out_ / "mine.txt", "mine");
  const auto before = contents(folder_);
  EXPECT_EQ(exported(drive_, "colmap").exit_code, kExitUsage);
  const ProgramResult foreign = exported(drive_, "colmap", {"--force"});
  EXPECT_EQ(foreign.exit_code, kExitUsage);
  EXPECT_THAT(foreign.err, HasSubstr("no folder that redrive made"));
  EXPECT_EQ(contents(folder_), before);

  fs::remove_all(out_);
  const auto nothing = contents(folder_);
  std::vector<std::string> arguments = {"export", drive_.string(), "--to", "colmap", out_.string()};
  EXPECT_EQ(redrive(arguments, /*file_limit_bytes=*/300).exit_code, kExitIo);
  for (const int frame : {0, 1})  // a single one would only cost its own record
    write_file(tiny_image(drive_, kTinyLeft, kTinyFirstId + frame),
               "no image " + std::to_string(frame));
  EXPECT_EQ(exported(drive_, "colmap").exit_code, kExitBadInput);
  EXPECT_FALSE(fs::exists(out_));
  EXPECT_EQ(contents(folder_).size(), nothing.size());
}

TEST_F(ExportFormats, ForceReplacesAnEarlierExport) {
  ASSERT_EQ(exported(drive_, "colmap").exit_code, kExitOk);
  write_file(out_ / "images/old.txt", "old");
  EXPECT_EQ(exported(drive_, "colmap").exit_code, kExitUsage);
  ASSERT_EQ(exported(drive_, "colmap", {"--force"}).exit_code, kExitOk);
  EXPECT_FALSE(fs::exists(out_ / "images/old.txt"));
  EXPECT_EQ(open_recording(out_).frames.size(), 12u);
}

TEST_F(ExportFormats, ColmapReadsItsModel) {
  if (std::system("colmap help >/dev/null 2>&1") != 0)
    GTEST_SKIP() << "there is no colmap (Debian package colmap)";
  ASSERT_EQ(exported(drive_, "colmap").exit_code, kExitOk);
  const fs::path model = out_ / "sparse/0", log = folder_ / "colmap.log", even = folder_ / "even";
  const auto colmap = [&](const std::string& arguments) {
    return std::system(("colmap " + arguments + " >" + log.string() + " 2>&1").c_str());
  };
  ASSERT_EQ(colmap("model_analyzer --path " + model.string()), 0) << read_file(log);
  EXPECT_THAT(read_file(log), AllOf(HasSubstr("Cameras: 3"), HasSubstr("Images: 12"),
                                    HasSubstr("Registered images: 12"), HasSubstr("Points: 36")));
  ASSERT_EQ(colmap("image_undistorter --image_path " + (out_ / "images").string() +
                   " --input_path " + model.string() + " --output_path " + even.string()),
            0)
      << read_file(log);
  EXPECT_TRUE(fs::exists(even / "images" / kTinyFront /
                         tiny_image("", kTinyFront, kTinyFirstId).filename()));
}

// What COLMAP made trains: inspect, train, eval; align says why it cannot.
TEST_F(ExportFormats, AColmapModelTrains) {
  ASSERT_EQ(exported(drive_, "colmap").exit_code, kExitOk);
  const ProgramResult table = redrive({"inspect", out_.string()});
  EXPECT_EQ(table.exit_code, kExitOk) << table.err;
  EXPECT_THAT(table.out, HasSubstr("(colmap)"));
  const fs::path run = folder_ / "run";
  const ProgramResult trained =
      redrive({"train", out_.string(), "--out", run.string(), "--method", "splat", "--max-steps",
               "20", "--max-gaussians", "2000", "--set", "initial.sky=500", "--threads", "2",
               "--holdout-every", "4"});
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.out << trained.err;
  EXPECT_THAT(trained.out, HasSubstr("points of " + (out_ / "sparse/0/points3D.bin").string()));
  EXPECT_EQ(redrive({"eval", run.string(), "--threads", "2"}).exit_code, kExitOk);
  EXPECT_EQ(redrive({"align", out_.string()}).exit_code, kExitInsufficientData);
}

}  // namespace
}  // namespace redrive::testing
