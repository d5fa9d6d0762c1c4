// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/transforms.h"

#include "redrive/camera/models.h"

#include <numbers>

#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using ::testing::AllOf;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::input_error;

// At (1, 2, 3) looking along the world's x axis, its z axis up. Columns in OpenGL's axes: right,
// up, backward.
const json kLookingAlongX = {{0, 0, -1, 1}, {-1, 0, 0, 2}, {0, 1, 0, 3}, {0, 0, 0, 1}};

json frame(const std::string& file) {
  return {{"file_path", file}, {"transform_matrix", kLookingAlongX}};
}

json document() {
  return {{"fl_x", 100.5}, {"fl_y", 90},
          {"cx", 52},      {"cy", 39.5},
          {"w", 100.0},    {"h", 80},
          {"k1", 0.1},     {"k2", -0.02},
          {"p1", 1e-3},    {"p2", -2e-3},
          {"k3", 4e-3},    {"camera_model", "OPENCV"},
          {"k4", 0},       {"frames", {frame("images/1.png"), frame("images/2.png")}}};
}

transforms::TransformsFile parsed_transforms(const json& text) {
  return transforms::parse(text.dump(), "dir/transforms.json", [](const std::string&) {
    return ImageSize{800, 600};
  });
}

CameraCalibration first_camera(const json& text) {
  return *parsed_transforms(text).entries.at(0).camera;
}

/// Returns the message for a document with `value` at a JSON pointer.
std::string error_message(const std::string& pointer, const json& value) {
  json text = document();
  text[json::json_pointer(pointer)] = value;
  const std::string message = input_error([&] { parsed_transforms(text); });
  EXPECT_THAT(message, HasSubstr("dir/transforms.json")) << pointer;
  return message;
}

TEST(Transforms, ReadsEveryField) {
  json text = document();
  text["frames"][1]["mask_path"] = "masks\\2.png";
  const transforms::TransformsFile file = parsed_transforms(text);
  ASSERT_EQ(file.entries.size(), 2u);
  EXPECT_EQ(file.entries[0].file, "images/1.png");
  EXPECT_EQ(file.entries[0].mask, "");
  EXPECT_EQ(file.entries[1].mask, "masks/2.png");
  EXPECT_FALSE(file.bounds);
  EXPECT_FALSE(file.train);
  const CameraCalibration& camera = *file.entries[1].camera;
  EXPECT_EQ(camera.model, "opencv_pinhole");
  EXPECT_EQ(camera.fx(), 100.5);
  EXPECT_EQ(camera.fy(), 90);
  EXPECT_EQ(camera.width, 100);
  EXPECT_EQ(camera.height, 80);
  EXPECT_THAT(distortion(camera), ElementsAre(0.1, -0.02, 1e-3, -2e-3, 4e-3));
}

TEST(Transforms, ReadsPrincipalPointsRelativeToTheCorner) {
  const CameraCalibration camera = first_camera(document());
  EXPECT_EQ(camera.cx(), 51.5);
  EXPECT_EQ(camera.cy(), 39);
  json text = document();
  text.erase("cx");
  text.erase("cy");
  EXPECT_EQ(first_camera(text).cx(), 49.5) << "the middle of pixels 0 to 99";
  EXPECT_EQ(first_camera(text).cy(), 39.5);
}

TEST(Transforms, ConvertsOpenGlAxes) {
  const transforms::FrameEntry entry = parsed_transforms(document()).entries[0];
  EXPECT_TRUE(entry.global_from_body.linear().isApprox(Eigen::Matrix3d::Identity(), 1e-15))
      << "x forward, z up";
  const Rigid3d world_from_camera = entry.global_from_body * entry.camera->body_from_sensor;
  // 5 ahead, 2 to the right, 1 down.
  const Eigen::Vector3d point = world_from_camera * Eigen::Vector3d(2, 1, 5);
  EXPECT_TRUE(point.isApprox(Eigen::Vector3d(1 + 5, 2 - 2, 3 - 1), 1e-15)) << point.transpose();
}

TEST(Transforms, FrameIntrinsicsTakePrecedence) {
  json text = document();
  text["frames"][1].update({{"fl_x", 200}, {"cx", 10.5}, {"w", 50}, {"h", 40}, {"k1", 0}});
  const auto entries = parsed_transforms(text).entries;
  EXPECT_EQ(entries[0].camera->fx(), 100.5);
  const CameraCalibration& own = *entries[1].camera;
  EXPECT_EQ(own.fx(), 200);
  EXPECT_EQ(own.fy(), 200) << "the frame's own along both axes";
  EXPECT_EQ(own.cx(), 10);
  EXPECT_EQ(own.cy(), 39) << "the file's";
  EXPECT_EQ(own.width, 50);
  EXPECT_EQ(distortion(own)[0], 0);
  EXPECT_EQ(distortion(own)[1], -0.02);
}

TEST(Transforms, ReadsFocalLengthsFromTheAngleOfView) {
  json text = {{"camera_angle_x", 0.6911112070083618}, {"frames", {frame("./train/r_0")}}};
  const CameraCalibration camera = first_camera(text);
  EXPECT_EQ(camera.width, 800) << "from the image, as the file has no size";
  EXPECT_NEAR(camera.fx(), 1111.1110311937682,
              1e-9);  // 400 / tan(angle / 2), as in the published sets
  EXPECT_EQ(camera.fy(), camera.fx());
  EXPECT_EQ(camera.cx(), 399.5);
  EXPECT_EQ(camera.cy(), 299.5);
  EXPECT_THAT(distortion(camera), Each(0));
  text["camera_angle_y"] = std::numbers::pi / 2;
  EXPECT_NEAR(first_camera(text).fy(), 300, 1e-12);
  EXPECT_NEAR(first_camera(text).fx(), 1111.1110311937682, 1e-9);
  text["x_fov"] = 90;
  EXPECT_NEAR(first_camera(text).fx(), 400, 1e-12);
}

TEST(Transforms, ReadsFisheyesOfBothDialects) {
  json text = document();
  for (const char* key : {"camera_model", "p1", "p2"}) text.erase(key);
  text["k4"] = 5e-4;
  json nerfstudio = text, ngp = text;
  nerfstudio["camera_model"] = "OPENCV_FISHEYE";
  ngp["is_fisheye"] = true;
  for (const json& fisheye : {nerfstudio, ngp}) {
    const CameraCalibration camera = first_camera(fisheye);
    EXPECT_EQ(camera.model, "opencv_fisheye");
    EXPECT_THAT(distortion(camera), ElementsAre(0.1, -0.02, 4e-3, 5e-4));
  }
  nerfstudio["p1"] = 0.01;
  EXPECT_THAT(input_error([&] { parsed_transforms(nerfstudio); }), HasSubstr("p1 = 0.01"));
  ngp.erase("fl_x");
  ngp["camera_angle_x"] = 2;
  EXPECT_THAT(input_error([&] { parsed_transforms(ngp); }), HasSubstr("fl_x"));
}

TEST(Transforms, ReadsModelsThatArePinholes) {
  for (const char* model : {"OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "RADIAL", "SIMPLE_RADIAL"}) {
    json text = document();
    text["camera_model"] = model;
    EXPECT_EQ(first_camera(text).model, "opencv_pinhole") << model;
  }
}

TEST(Transforms, ReadsBoundsAsInstantNgp) {
  json text = document();
  text["aabb_scale"] = 4;
  transforms::TransformsFile file = parsed_transforms(text);
  ASSERT_TRUE(file.bounds);
  EXPECT_EQ(file.bounds->center, Eigen::Vector3d::Zero());
  EXPECT_DOUBLE_EQ(file.bounds->half_side, 2 / 0.33);
  // scale x + offset is 0.5 at the middle and 0.5 + 2 at the far side.
  text["scale"] = 0.25;
  text["offset"] = {0.5, 0.25, 1.0};
  file = parsed_transforms(text);
  EXPECT_EQ(file.bounds->center, Eigen::Vector3d(0, 1, -2));
  EXPECT_EQ(file.bounds->half_side, 8);
  text["offset"] = 0.25;
  EXPECT_EQ(parsed_transforms(text).bounds->center, Eigen::Vector3d(1, 1, 1));
  text.erase("aabb_scale");
  text["aabb"] = {{-1, 0, 2}, {3, 2, 3}};
  file = parsed_transforms(text);
  EXPECT_EQ(file.bounds->center, Eigen::Vector3d(1, 1, 2.5));
  EXPECT_EQ(file.bounds->half_side, 2) << "half of the longest side";
}

TEST(Transforms, RejectsUnsupportedFields) {
  const std::vector<std::tuple<std::string, json, std::string>> cases = {
      {"/frames", json::array(), "frames"},
      {"/frames/1/file_path", "images/1.png", "frames[1].file_path = \"images/1.png\""},
      {"/frames/1/file_path", 3, "a string"},
      {"/frames/1/file_path", "", "the name of a file"},
      {"/frames/1/transform_matrix", {{1, 0}, {0, 1}}, "frames[1].transform_matrix"},
      {"/frames/1/transform_matrix/0/0", nullptr, "frames[1].transform_matrix[0][0] = null"},
      {"/frames/1/transform_matrix/0/2", 1, "det"},
      {"/frames/1/transform_matrix/2/1", 2, "rotation"},
      {"/frames/1/transform_matrix/0/3", 1e8, "1e7"},
      {"/fl_x", 0, "fl_x = 0"},
      {"/fl_x", "100", "fl_x"},
      {"/w", 100.5, "whole pixels"},
      {"/h", 0, "h = 0"},
      {"/cx", -101, "cx = -101"},
      {"/k1", 1e7, "k1"},
      {"/k4", 0.01, "k4 = 0.01"},
      {"/k6", 0.01, "k6 = 0.01"},
      {"/camera_model", "EQUIRECTANGULAR", "camera_model = \"EQUIRECTANGULAR\""},
      {"/is_fisheye", 1, "is_fisheye"},
      {"/rolling_shutter", {0, 0, 0.1, 0}, "rolling_shutter"},
      {"/frames/0/rolling_shutter", {0, 0, 0.1, 0}, "frames[0].rolling_shutter"},
      {"/equirectangular", true, "equirectangular"},
      {"/white_transparent", true, "white_transparent"},
      {"/frames/0/transform_matrix_start", kLookingAlongX, "transform_matrix_start"},
      {"/aabb_scale", 0, "aabb_scale = 0"},
      {"/aabb", {{0, 0, 0}, {0, 0, 0}}, "aabb"},
      {"/train_filenames", {"images/3.png"}, "train_filenames[0] = \"images/3.png\""},
      {"/test_filenames", "all", "test_filenames"},
  };
  for (const auto& [pointer, value, part] : cases)
    EXPECT_THAT(error_message(pointer, value), HasSubstr(part)) << pointer;
  EXPECT_EQ(parsed_transforms([] {
              json text = document();
              text["rolling_shutter"] = {0, 0, 0, 0};
              text["white_transparent"] = false;
              return text;
            }())
                .entries.size(),
            2u);
  for (const char* key : {"w", "fl_x", "frames"}) {
    json text = document();
    text.erase(key);
    if (std::string(key) == "fl_x") text.erase("fl_y");
    input_error([&] { parsed_transforms(text); });
  }
}

/// Returns the first 29 bytes of a PNG.
std::string png_head(int width, int height) {
  std::string head("\x89PNG\r\n\x1a\n\0\0\0\rIHDR", 16);
  for (const int size : {width, height})
    for (const int shift : {24, 16, 8, 0}) head += static_cast<char>(size >> shift);
  return head + std::string("\x08\x02\0\0\0", 5);  // 8 bits of each of three colours
}

std::string finding(const Recording& recording) {
  std::string all;
  for (const Finding& finding : recording.findings)
    all += finding.subject + ": " + finding.what + "\n";
  return all;
}

TEST(Transforms, OpensASet) {
  const TemporaryFolder folder;
  json text = document();
  text["frames"] = {frame("./images/r_10.png"), frame("images/r_9.png"), frame("images/r_2.png")};
  text["frames"][0]["fl_x"] = 200;
  text["frames"][2]["mask_path"] = "masks/2.png";
  text["aabb_scale"] = 2;
  for (const char* file : {"images/r_10.png", "images/r_9.png", "images/r_2.png",
                           "images/dynamic_mask_r_9.png", "masks/2.png", "images/r_7.png"})
    folder.write(file, "");
  folder.write("transforms.json", text.dump());
  const Recording recording = open_recording(folder.path);
  EXPECT_EQ(recording.format, "transforms");
  EXPECT_FALSE(recording.metric);
  EXPECT_DOUBLE_EQ(recording.bounds->half_side, 1 / 0.33);
  EXPECT_TRUE(recording.findings.empty());
  ASSERT_EQ(recording.frames.size(), 3u);
  EXPECT_LT(recording.frames[0].t_ns, recording.frames[1].t_ns);
  ASSERT_EQ(recording.cameras.size(), 2u);
  EXPECT_EQ(recording.cameras[0].calibration.name, "camera_1");
  EXPECT_EQ(recording.cameras[1].calibration.name, "camera_2");
  const auto& images = recording.cameras[0].images;
  ASSERT_EQ(images.size(), 2u);
  EXPECT_EQ(images[0].frame_id, 0);
  EXPECT_EQ(images[0].path, folder.path / "images/r_2.png") << "2, 9, 10";
  EXPECT_EQ(images[0].mask.path, folder.path / "masks/2.png");
  EXPECT_TRUE(images[0].mask.black_is_masked);
  EXPECT_FALSE(images[0].held_out);
  EXPECT_EQ(images[1].frame_id, 1);
  EXPECT_EQ(images[1].mask.path, folder.path / "images/dynamic_mask_r_9.png");
  EXPECT_FALSE(images[1].mask.black_is_masked);
  ASSERT_EQ(recording.cameras[1].images.size(), 1u);
  EXPECT_EQ(recording.cameras[1].images[0].frame_id, 2);
  EXPECT_EQ(recording.cameras[1].images[0].path, folder.path / "images/r_10.png");
  EXPECT_EQ(recording.cameras[1].calibration.fx(), 200);
  EXPECT_THAT(input_error([&] { open_recording(folder.path, PoseSource::kGroundTruth); }),
              HasSubstr("exact poses"));
}

TEST(Transforms, ReportsMissingImagesAndMasks) {
  const TemporaryFolder folder;
  json text = document();
  folder.write("transforms.json", text.dump());
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }),
              AllOf(HasSubstr("images/1.png: missing"), HasSubstr("transforms.json in")));
  folder.write("images/1.png", "");
  const Recording recording = open_recording(folder.path);
  EXPECT_EQ(recording.frames.size(), 1u);
  EXPECT_EQ(recording.cameras[0].images.size(), 1u);
  EXPECT_EQ(recording.cameras[0].calibration.name, "camera");
  EXPECT_THAT(finding(recording),
              HasSubstr("1 image listed, but not there, left out: images/2.png"));
  text["frames"][0]["mask_path"] = "masks/1.png";
  folder.write("transforms.json", text.dump());
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }), HasSubstr("masks/1.png: missing"));
  folder.write("masks/1.png", "");
  folder.write("images/dynamic_mask_1.png", "");
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }),
              AllOf(HasSubstr("mask_path = masks/1.png"), HasSubstr("dynamic_mask_1.png")));
}

TEST(Transforms, RejectsNaNAndTextThatEndsEarly) {
  const auto message = [](const std::string& text) {
    return input_error([&] { transforms::parse(text, "dir/transforms.json", nullptr); });
  };
  std::string text = document().dump();
  EXPECT_THAT(message(text.substr(0, text.size() / 2)),
              AllOf(HasSubstr("dir/transforms.json"), HasSubstr("line 1")));
  text.replace(text.find("100.5"), 5, "NaN");
  EXPECT_THAT(message(text), AllOf(HasSubstr("dir/transforms.json"), HasSubstr("\"NaN\"")));
}

// instant-ngp and nerfstudio write such paths, and a stranger may.
TEST(Transforms, PathsLeadOutOfTheFolderWhereThatIsAllowed) {
  const TemporaryFolder folder;
  json text = document();
  text["frames"] = json::array({frame("../images/1.png")});
  text["frames"][0]["mask_path"] = (folder.path / "mask.png").string();
  text["ply_file_path"] = "../points.ply";
  folder.write("set/transforms.json", text.dump());
  folder.write("images/1.png", "");
  folder.write("mask.png", "");
  const auto opened = [&] {
    return open_recording(folder.path / "set", PoseSource::kRecorded, /*outside_files=*/true);
  };
  const auto refusal = [&] { return input_error([&] { open_recording(folder.path / "set"); }); };
  EXPECT_THAT(refusal(), AllOf(HasSubstr("images/1.png"), HasSubstr("--outside-files")));
  Recording recording = opened();
  const ImageFile& image = recording.cameras.at(0).images.at(0);
  EXPECT_TRUE(fs::equivalent(image.path, folder.path / "images/1.png"));
  EXPECT_EQ(image.mask.path, folder.path / "mask.png");
  EXPECT_TRUE(recording.points_file.empty());
  EXPECT_THAT(finding(recording), AllOf(HasSubstr("ply_file_path"), HasSubstr("is missing")));
  folder.write("points.ply",
               "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
               "property float z\nend_header\n0 0 nan\n");
  EXPECT_THAT(input_error([&] { opened(); }), HasSubstr("points.ply"));
  folder.write("points.ply",
               "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
               "property float z\nend_header\n0 0 nan\n1 2 3\n");
  EXPECT_THAT(finding(opened()), HasSubstr("1 point not finite"));
  EXPECT_TRUE(fs::equivalent(opened().points_file, folder.path / "points.ply"));
  folder.write("set/1.png", "");
  text["frames"] =
      json::array({frame((folder.path / "set/1.png").string())});  // absolute, but within
  folder.write("set/transforms.json", text.dump());
  EXPECT_THAT(refusal(), HasSubstr("points.ply"));
  text["frames"][0]["mask_path"] = "../mask.png";
  text.erase("ply_file_path");
  folder.write("set/transforms.json", text.dump());
  EXPECT_THAT(refusal(), HasSubstr("mask.png"));
  text["frames"][0].erase("mask_path");
  folder.write("set/transforms.json", text.dump());
  EXPECT_EQ(open_recording(folder.path / "set").frames.size(), 1u);
}

TEST(Transforms, UsesTheSplitOfTheFile) {
  const TemporaryFolder folder;
  json text = document();
  text["frames"] = json::array();
  for (const char* name : {"1.png", "2.png", "3.png", "4.png"}) {
    text["frames"].push_back(frame(name));
    folder.write(name, "");
  }
  text["train_filenames"] = {"1.png", "3.png"};
  text["val_filenames"] = {"4.png"};
  const auto open = [&] {
    folder.write("transforms.json", text.dump());
    return open_recording(folder.path);
  };
  Recording recording = open();
  ASSERT_EQ(recording.cameras[0].images.size(), 3u);
  EXPECT_FALSE(recording.cameras[0].images[1].held_out);
  EXPECT_TRUE(recording.cameras[0].images[2].held_out) << "val, as there is no test";
  EXPECT_THAT(finding(recording), HasSubstr("2.png"));
  text["test_filenames"] = {"2.png"};
  recording = open();
  EXPECT_TRUE(recording.cameras[0].images[1].held_out);
  EXPECT_THAT(finding(recording), HasSubstr("4.png"));
  text["test_filenames"] = {"3.png"};
  EXPECT_THAT(input_error(open), HasSubstr("train_filenames = 3.png"));
}

TEST(Transforms, OpensBlenderSets) {
  const TemporaryFolder folder;
  const auto write = [&](const std::string& split, int count) {
    json text = {{"camera_angle_x", 0.6911112}, {"frames", json::array()}};
    for (int i = count - 1; i >= 0; --i) {
      const std::string name = split + "/r_" + std::to_string(i);
      text["frames"].push_back(frame("./" + name));
      folder.write(name + ".png", png_head(640, 480));
    }
    folder.write("transforms_" + split + ".json", text.dump());
  };
  write("train", 12);
  write("val", 2);
  Recording recording = open_recording(folder.path);
  EXPECT_EQ(recording.format, "blender");
  ASSERT_EQ(recording.cameras.size(), 1u);
  ASSERT_EQ(recording.cameras[0].images.size(), 14u) << "val, where there is no test";
  write("test", 3);
  recording = open_recording(folder.path);
  const auto& images = recording.cameras[0].images;
  ASSERT_EQ(images.size(), 15u);
  for (int i = 0; i < 15; ++i) {
    EXPECT_EQ(images[i].frame_id, i);
    EXPECT_EQ(images[i].held_out, i >= 12);
  }
  EXPECT_EQ(images[11].path, folder.path / "train/r_11.png");
  EXPECT_EQ(images[12].path, folder.path / "test/r_0.png");
  const CameraCalibration& camera = recording.cameras[0].calibration;
  EXPECT_EQ(camera.width, 640) << "from the PNG";
  EXPECT_EQ(camera.height, 480);
  EXPECT_FALSE(recording.metric);
  EXPECT_DOUBLE_EQ(recording.bounds->half_side, 0.5 / 0.33);

  folder.write("train/r_3.png", "JFIF");
  EXPECT_THAT(open_recording(folder.path).damaged.at(0).why,
              AllOf(HasSubstr("r_3.png"), HasSubstr("w and h")));
  folder.write("train/r_3.png", png_head(640, 0));
  EXPECT_THAT(open_recording(folder.path).damaged.at(0).why,
              HasSubstr("r_3.png: neither a PNG nor a JPEG with a size"));
  folder.write("train/r_3.png", png_head(640, 480));
  json again = {{"camera_angle_x", 0.7}, {"frames", {frame("train/r_1")}}};
  folder.write("transforms_test.json", again.dump());
  EXPECT_THAT(input_error([&] { open_recording(folder.path); }), HasSubstr("a second frame"))
      << "would be a training image";
}

}  // namespace
}  // namespace redrive
