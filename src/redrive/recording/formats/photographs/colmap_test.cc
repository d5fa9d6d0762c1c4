// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/colmap.h"

#include <cmath>
#include <cstring>

#include "redrive/camera/camera.h"
#include "redrive/camera/example_cameras_testing.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/formats/photographs/colmap_files.h"
#include "redrive/recording/formats/photographs/colmap_rigs.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::input_error;

const std::string kCameras =
    "# a comment\n"
    "1 SIMPLE_RADIAL 100 80 90 50 40 -0.05\n"
    "7 OPENCV_FISHEYE 60 40 30 31 30.5 20 0.1 0.01 0.001 0.0001\n";
// Image 3 looks along the world's z; image 10 stands 2 to its right and looks to the right.
const std::string kImages =
    "3 1 0 0 0 0 0 0 1 a/2.png\n10.5 20 1 30 40 -1\n"
    "10 0.70710678118654752 0 -0.70710678118654752 0 0 0 2 7 a/10.png\n\n"
    "4 1 0 0 0 -1 -2 -3 1 gone.png\n\n";
const std::string kPoints =
    "1 0 0 5 10 20 30 0.5 3 0 10 4 3 7\n"
    "2 1 1 6 1 2 3 0.5 4 0\n"
    "3 1 1 7 1 2 3 0.5\n";

class ColmapTest : public ::testing::Test {
 protected:
  void write_model(const std::string& folder = "sparse/0/") {
    folder_.write(folder + "cameras.txt", kCameras);
    folder_.write(folder + "images.txt", kImages);
    folder_.write(folder + "points3D.txt", kPoints);
    folder_.write("images/a/2.png", "");
    folder_.write("images/a/10.png", "");
  }
  Recording opened() const { return open_recording(folder_.path); }

  TemporaryFolder folder_;
};

TEST_F(ColmapTest, ReadsATextModel) {
  write_model();
  const Recording recording = opened();
  EXPECT_EQ(recording.format, "colmap");
  EXPECT_FALSE(recording.metric);
  EXPECT_EQ(recording.global_frame, GlobalFrame::kArbitrary);
  ASSERT_EQ(recording.frames.size(), 2u);
  ASSERT_EQ(recording.cameras.size(), 2u);
  const CameraCalibration& pinhole = recording.cameras[0].calibration;
  EXPECT_EQ(pinhole.name, "camera_1");
  EXPECT_EQ(pinhole.model, "opencv_pinhole");
  EXPECT_THAT(pinhole.parameters, ElementsAre(90, 90, 49.5, 39.5, -0.05, 0, 0, 0, 0));
  EXPECT_EQ(recording.cameras[1].calibration.name, "camera_7");
  EXPECT_EQ(recording.cameras[0].images.at(0).path, folder_.path / "images/a/2.png")
      << "2 is before 10";
  EXPECT_EQ(recording.cameras[1].images.at(0).frame_id, 1);
  EXPECT_EQ(recording.points_file, folder_.path / "sparse/0/points3D.txt");
  ASSERT_EQ(recording.findings.size(), 1u);
  EXPECT_THAT(recording.findings[0].what, HasSubstr("gone.png"));
}

TEST_F(ColmapTest, PosesAreThoseOfTheFile) {
  write_model();
  const Recording recording = opened();
  const auto global_from_camera = [&](int i) {
    return Rigid3d(recording.frames[i].global_from_body *
                   recording.cameras[i].calibration.body_from_sensor);
  };
  EXPECT_TRUE(global_from_camera(0).isApprox(Rigid3d::Identity(), 1e-15));
  const Rigid3d second = global_from_camera(1);
  // R turns the world by -90 degrees about y, and X_camera = R X_world + (0, 0, 2).
  const Eigen::Vector3d at(0.5, 0.25, 3);
  const Eigen::Vector3d in_camera = second.inverse(Eigen::Isometry) * at;
  EXPECT_NEAR((in_camera - Eigen::Vector3d(-3, 0.25, 0.5 + 2)).norm(), 0, 1e-12)
      << in_camera.transpose();
}

TEST_F(ColmapTest, PointsKnowTheirFrames) {
  write_model();
  const Recording recording = opened();
  const std::vector<StaticPoint> points = recording.reader->read_points(recording);
  ASSERT_EQ(points.size(), 3u);
  EXPECT_EQ(points[0].in_global, Eigen::Vector3d(0, 0, 5));
  EXPECT_THAT(points[0].frames, ElementsAre(0, 1));
  EXPECT_TRUE(points[1].has_track);
  EXPECT_TRUE(points[1].frames.empty()) << "its image is gone";
  EXPECT_FALSE(points[2].has_track);
  ASSERT_TRUE(recording.bounds);
  const Eigen::Vector3d off =
      recording.frames[1].global_from_body.translation() - recording.bounds->center;
  EXPECT_LE(off.cwiseAbs().maxCoeff(), recording.bounds->half_side * (1 + 1e-12));
}

TEST_F(ColmapTest, ReadsBinaryModelsAndOtherFolders) {
  write_model("");
  EXPECT_EQ(opened().frames.size(), 2u);
  const fs::path file = "f";
  const colmap::ModelFiles binary = colmap::make_binary(colmap::parse_cameras_text(kCameras, file),
                                                        colmap::parse_images_text(kImages, file),
                                                        colmap::parse_points_text(kPoints, file));
  folder_.write("sparse/cameras.bin", binary.cameras);
  folder_.write("sparse/images.bin", binary.images);
  folder_.write("sparse/points3D.bin", binary.points);
  folder_.write("sparse/rigs.bin", "anything");
  folder_.write("images/other.jpg", "");
  folder_.write("masks/a/2.png.png", "");
  const Recording recording = opened();
  EXPECT_EQ(recording.points_file, folder_.path / "sparse/points3D.bin");
  EXPECT_EQ(recording.frames.size(), 2u);
  EXPECT_EQ(recording.reader->read_points(recording).size(), 3u);
  EXPECT_EQ(recording.cameras[0].images[0].mask.path, folder_.path / "masks/a/2.png.png");
  std::string findings;
  for (const Finding& finding : recording.findings)
    findings += finding.subject + ": " + finding.what + "\n";
  EXPECT_THAT(findings, AllOf(HasSubstr("rigs.bin: not used: the model has no frames"),
                              HasSubstr("other.jpg"), HasSubstr("gone.png")));
}

TEST_F(ColmapTest, HasNoBoundsAroundPointsTooFarAway) {
  write_model();
  folder_.write("sparse/0/points3D.txt",
                "1 -3e7 0 0 1 2 3 0\n2 3e7 0 0 1 2 3 0\n3 4e7 0 0 1 2 3 0\n");
  EXPECT_FALSE(opened().bounds);
}

TEST_F(ColmapTest, CountsPointsThatAreNotFinite) {
  write_model();
  folder_.write("sparse/0/points3D.txt",
                kPoints + "4 1 nan 7 1 2 3 0.5\n5 inf 1 7 1 2 3 0.5\n6 2e7 0 0 1 2 3 0\n");
  const Recording recording = opened();
  EXPECT_EQ(recording.reader->read_points(recording).size(), 3u);
  ASSERT_EQ(recording.findings.size(), 2u);
  EXPECT_EQ(recording.findings[1].subject, "points3D.txt");
  EXPECT_THAT(recording.findings[1].what, HasSubstr("3 points not finite"));
}

// A track may be as long as the file.
TEST_F(ColmapTest, ReadsALongTrackOnceInItsOrder) {
  constexpr int kImagesOfTrack = 200000;
  std::string line = "1 0 0 5 1 2 3 0.5";
  for (int i = kImagesOfTrack; i > 0; --i) line += " " + std::to_string(i) + " 0";
  const auto points = colmap::parse_points_text(line + " 7 1 8 0\n", "f");
  ASSERT_EQ(points.at(0).images.size(), static_cast<std::size_t>(kImagesOfTrack));
  EXPECT_EQ(points[0].images[0], kImagesOfTrack);
}

TEST_F(ColmapTest, RejectsModelsThatDoNotFitTogether) {
  write_model();
  folder_.write("sparse/0/images.txt", "3 1 0 0 0 0 0 0 2 a/2.png\n\n");
  EXPECT_THAT(
      input_error([&] { opened(); }),
      AllOf(HasSubstr("images.txt"), HasSubstr("image 3 camera = 2"), HasSubstr("cameras.txt")));
  folder_.write("sparse/0/images.txt", "3 1 0 0 0 0 0 0 1 a/2.png\n\n4 1 0 0 0 0 0 0 1 a//2.png\n");
  EXPECT_THAT(input_error([&] { opened(); }), HasSubstr("image 4 name = a/2.png"));
  folder_.write("sparse/0/images.txt", "3 1 0 0 0 0 0 0 1 b.png\n\n");
  EXPECT_THAT(input_error([&] { opened(); }), HasSubstr("images/b.png: missing, and so are all"));
  fs::remove_all(folder_.path / "images");
  EXPECT_THAT(input_error([&] { opened(); }), HasSubstr("no such folder"));
  EXPECT_THAT(input_error([&] { open_recording(folder_.path, PoseSource::kGroundTruth); }),
              HasSubstr("exact poses"));
}

TEST_F(ColmapTest, NamesTheFileThatIsMissing) {
  for (const std::string file : {"cameras", "images"}) {
    write_model();
    fs::remove(folder_.path / ("sparse/0/" + file + ".txt"));
    EXPECT_THAT(input_error([&] { opened(); }),
                AllOf(HasSubstr("sparse/0: " + file), HasSubstr("both as .bin or both as .txt")));
  }
  // cameras.bin without images.bin beside a text model is not looked at.
  write_model();
  folder_.write("sparse/0/cameras.bin", "");
  EXPECT_EQ(opened().frames.size(), 2u);
  fs::remove(folder_.path / "sparse/0/cameras.txt");
  EXPECT_THAT(input_error([&] { opened(); }), HasSubstr("sparse/0: cameras"));
}

TEST_F(ColmapTest, ReportsTracksOfImagesThatTheModelDoesNotHave) {
  write_model();
  folder_.write("sparse/0/points3D.txt", kPoints + "4 1 1 7 1 2 3 0.5 3 0 99 0\n");
  const Recording recording = opened();
  ASSERT_EQ(recording.findings.size(), 2u);
  EXPECT_THAT(recording.findings[1].what,
              AllOf(HasSubstr("1 point seen by images that images.txt does not have"),
                    HasSubstr("such as image 99")));
  EXPECT_THAT(recording.reader->read_points(recording).at(3).frames, ElementsAre(0));
}

std::string error_of_cameras(const std::string& text) {
  return input_error([&] {
    for (const colmap::CameraRecord& camera : colmap::parse_cameras_text(text, "cameras.txt"))
      colmap::to_calibration(camera, "cameras.txt");
  });
}

TEST(ColmapFiles, RejectsCamerasThatCannotBe) {
  EXPECT_THAT(error_of_cameras("1 PINHOLE 100\n"), HasSubstr("line 1"));
  EXPECT_THAT(error_of_cameras("1 DIVISION 100 80 1 2 3 4\n"),
              AllOf(HasSubstr("camera 1 MODEL = DIVISION"), HasSubstr("THIN_PRISM_FISHEYE")));
  EXPECT_THAT(error_of_cameras("1 PINHOLE 100 80 90 90 50\n"), HasSubstr("PINHOLE"));
  EXPECT_THAT(error_of_cameras("1 PINHOLE 100 80 nan 90 50 40\n"), HasSubstr("fx = nan"));
  EXPECT_THAT(error_of_cameras("1 PINHOLE 100 80 -90 90 50 40\n"), HasSubstr("camera 1 fx = -90"));
  EXPECT_THAT(error_of_cameras("1 PINHOLE 100 80 90 90 500 40\n"), HasSubstr("camera 1 cx = 500"));
  EXPECT_THAT(error_of_cameras("1 PINHOLE 100000 80 90 90 50 40\n"), HasSubstr("camera 1 width"));
  EXPECT_THAT(error_of_cameras("1 FOV 100 80 90 90 50 40 4\n"), HasSubstr("camera 1 omega = 4"));
  const std::string line = "1 SIMPLE_PINHOLE 100 80 90 50 40\n";
  EXPECT_THAT(error_of_cameras(line + line), HasSubstr("camera id = 1"));
}

std::string error_of_image(const std::string& text) {
  return input_error([&] { colmap::parse_images_text(text, "images.txt"); });
}

TEST(ColmapFiles, RejectsImagesThatCannotBe) {
  EXPECT_THAT(error_of_image("3 1 0 0 0 0 0 0 1\n"), HasSubstr("NAME"));
  for (const char* name : {"../a.png", "a/../../b.png", "..", ".", "a/", "..\\a.png"})
    EXPECT_THAT(error_of_image(std::string("3 1 0 0 0 0 0 0 1 ") + name + "\n"),
                HasSubstr("image 3 name"))
        << name;
  EXPECT_THAT(error_of_image("3 1 0 0 0 0 0 0 1 a.png\n1 2\n"), HasSubstr("line 2"));
  EXPECT_THAT(error_of_image("3 1 0 0 0 0 0 0 1 a.png\n\n3 1 0 0 0 0 0 0 1 b.png\n"),
              HasSubstr("image id = 3"));
}

TEST(ColmapFiles, APoseThatCannotBeIsSaidOfItsImage) {
  const auto damage = [](const std::string& pose) {
    const auto images = colmap::parse_images_text(
        "2 1 0 0 0 0 0 0 1 b.png\n\n3 " + pose + " 1 a.png\n", "images.txt");
    EXPECT_EQ(images.at(0).damage, "");
    return images.at(1).damage;
  };
  EXPECT_THAT(damage("0 0 0 0 0 0 0"), HasSubstr("image 3 quaternion"));
  EXPECT_THAT(damage("1 0 0 nan 0 0 0"), HasSubstr("image 3 QZ = nan"));
  EXPECT_THAT(damage("1 0 0 0 0 0 2e7"), HasSubstr("image 3 translation"));
}

TEST(ColmapFiles, AcceptsALastImageWithoutItsLineOfFeatures) {
  EXPECT_EQ(colmap::parse_images_text("3 1 0 0 0 0 0 0 1 a.png", "images.txt").size(), 1u);
}

TEST(ColmapFiles, RejectsPointsThatCannotBe) {
  const auto error = [](const std::string& text) {
    return input_error([&] { colmap::parse_points_text(text, "points3D.txt"); });
  };
  EXPECT_THAT(error("1 0 0 5 10 20 30\n"), HasSubstr("line 1"));
  EXPECT_THAT(error("1 0 0 5 10 20 30 0.5 3\n"), HasSubstr("line 1"));
  EXPECT_THAT(error("1 0 0 five 10 20 30 0.5\n"), HasSubstr("Z = five"));
  EXPECT_THAT(error("1 0 0 5 10 256 30 0.5\n"), HasSubstr("G = 256"));
}

// Each binary file, cut anywhere or longer than it says.
TEST(ColmapFiles, RejectsTruncatedBinaryFiles) {
  const colmap::ModelFiles files = colmap::make_binary(colmap::parse_cameras_text(kCameras, "f"),
                                                       colmap::parse_images_text(kImages, "f"),
                                                       colmap::parse_points_text(kPoints, "f"));
  const auto check = [](const std::string& bytes, auto parse) {
    for (std::size_t size = 0; size < bytes.size(); ++size)
      EXPECT_THAT(input_error([&] { parse(std::string_view(bytes).substr(0, size), "m.bin"); }),
                  AllOf(HasSubstr("m.bin"), HasSubstr("truncated")))
          << size;
    EXPECT_THAT(input_error([&] { parse(bytes + "x", "m.bin"); }), HasSubstr("follow"));
  };
  check(files.cameras, colmap::parse_cameras_binary);
  check(files.images, colmap::parse_images_binary);
  check(files.points, colmap::parse_points_binary);

  std::string nan = files.points;
  const double value = std::nan("");
  std::memcpy(nan.data() + 16, &value, sizeof value);
  EXPECT_FALSE(std::isfinite(colmap::parse_points_binary(nan, "m.bin").at(0).in_world.x()));
  nan = files.images;  // a count, an id of 4 bytes, then the quaternion
  std::memcpy(nan.data() + 12, &value, sizeof value);
  EXPECT_THAT(colmap::parse_images_binary(nan, "m.bin").at(0).damage,
              HasSubstr("image 3 pose = nan"));
  nan = files.cameras;  // a count, id and model of 4 bytes, width and height of 8, parameters
  std::memcpy(nan.data() + 32, &value, sizeof value);
  EXPECT_THAT(input_error([&] { colmap::parse_cameras_binary(nan, "m.bin"); }),
              HasSubstr("camera 1 f = nan"));
  std::string model = files.cameras;
  model[12] = 99;
  EXPECT_THAT(input_error([&] { colmap::parse_cameras_binary(model, "m.bin"); }),
              HasSubstr("camera 1 model = 99"));
}

TEST(ColmapFiles, TextAndBinaryComeBack) {
  const auto cameras = colmap::parse_cameras_text(kCameras, "f");
  const auto images = colmap::parse_images_text(kImages, "f");
  const auto points = colmap::parse_points_text(kPoints, "f");
  const colmap::ModelFiles text = colmap::make_text(cameras, images, points),
                           binary = colmap::make_binary(cameras, images, points);
  for (const bool is_text : {true, false}) {
    const auto same_cameras = is_text ? colmap::parse_cameras_text(text.cameras, "f")
                                      : colmap::parse_cameras_binary(binary.cameras, "f");
    ASSERT_EQ(same_cameras.size(), 2u);
    EXPECT_EQ(same_cameras[1].params, cameras[1].params);
    EXPECT_EQ(same_cameras[1].id, 7);
    const auto same_images = is_text ? colmap::parse_images_text(text.images, "f")
                                     : colmap::parse_images_binary(binary.images, "f");
    ASSERT_EQ(same_images.size(), 3u);
    EXPECT_TRUE(same_images[1].camera_from_world.isApprox(images[1].camera_from_world, 1e-15));
    EXPECT_EQ(same_images[1].name, "a/10.png");
    const auto same_points = is_text ? colmap::parse_points_text(text.points, "f")
                                     : colmap::parse_points_binary(binary.points, "f");
    ASSERT_EQ(same_points.size(), 3u);
    EXPECT_EQ(same_points[0].images, points[0].images);
    EXPECT_EQ(same_points[0].rgb, points[0].rgb);
    EXPECT_EQ(same_points[1].in_world, points[1].in_world);
  }
}

// Every model of COLMAP: its example becomes a camera of ours and comes back.
TEST(ColmapCameras, ComeBack) {
  for (const colmap::CameraModel& model : colmap::camera_models()) {
    SCOPED_TRACE(model.name);
    colmap::CameraRecord record{1, model.id, 320, 200, {}};
    for (const std::string_view name : model.parameters)
      record.params.push_back(name == "f" || name == "fx" ? 250
                              : name == "fy"              ? 240.5
                              : name == "cx"              ? 160.25
                              : name == "cy"              ? 99
                              : name == "omega"           ? 0.9
                              : name == "k6"              ? 0.02
                                                          : 0.01);
    const CameraCalibration calibration = colmap::to_calibration(record, "cameras.txt");
    EXPECT_EQ(calibration.cx(), 159.75);
    EXPECT_NO_THROW(make_camera(calibration));
    const auto back = colmap::to_record(calibration);
    ASSERT_TRUE(back);
    EXPECT_EQ(back->model_id, model.id);
    EXPECT_EQ(back->params, record.params);
  }
}

// Five coefficients become FULL_OPENCV, with the same rays; mei has no model.
TEST(ColmapCameras, ChoosesTheModelThatIsExact) {
  CameraCalibration camera{
      "CAM", "opencv_pinhole", {250, 240, 159, 99, -0.3, 0.08, 0, 0, 0.01}, 320, 200};
  const auto record = colmap::to_record(camera);
  ASSERT_TRUE(record);
  EXPECT_EQ(colmap::find_camera_model(record->model_id)->name, "FULL_OPENCV");
  const Camera ours = make_camera(camera),
               theirs = make_camera(colmap::to_calibration(*record, "cameras.txt"));
  for (double v = 0; v < 200; v += 20)
    for (double u = 0; u < 320; u += 20)
      ASSERT_LT((*ours.unproject({u, v}) - *theirs.unproject({u, v})).norm(), 1e-12);
  camera.model = "mei";
  camera.parameters.push_back(1);
  EXPECT_FALSE(colmap::to_record(camera));
}

// COLMAP numbers models as it finds them, not by size.
TEST_F(ColmapTest, ReadsTheModelWithMostImages) {
  write_model("sparse/1/");
  folder_.write("sparse/0/cameras.txt", kCameras);
  folder_.write("sparse/0/images.txt", "3 1 0 0 0 0 0 0 1 a/2.png\n\n");
  folder_.write("sparse/2/cameras.txt", kCameras);
  folder_.write("sparse/2/images.txt", "cut");
  const Recording recording = opened();
  EXPECT_EQ(recording.frames.size(), 2u);
  EXPECT_EQ(recording.points_file, folder_.path / "sparse/1/points3D.txt");
  EXPECT_EQ(recording.findings[0].subject, "models");
  EXPECT_THAT(recording.findings[0].what,
              AllOf(HasSubstr("sparse/1 with 2 images is read"), HasSubstr("sparse/0 with 1 image"),
                    HasSubstr("sparse/2 (damaged)")));
  EXPECT_EQ(open_recording(folder_.path / "sparse/0").frames.size(), 1u) << "as the finding says";
}

TEST_F(ColmapTest, TakesMasksByOtherNamesAndNamesUnusedOnes) {
  write_model();
  folder_.write("masks/a/2.png", "");
  folder_.write("masks/a/gone.png", "");
  folder_.write("masks/gone.png", "");
  const Recording recording = opened();
  EXPECT_EQ(recording.cameras[0].images[0].mask.path, folder_.path / "masks/a/2.png");
  ASSERT_EQ(recording.findings.size(), 2u);
  EXPECT_THAT(recording.findings[1].what, HasSubstr("1 file not used, as they are named after no"));
}

// Image 10 belongs to camera 7, which looks to the right of camera 1 from 2 to its right.
const std::string kRigs =
    "1 3 CAMERA 1 CAMERA 7 1 0.70710678118654752 0 -0.70710678118654752 0 0 0 2 IMU 1 0\n";
const std::string kFrames = "1 1 1 0 0 0 0 0 0 2 CAMERA 1 3 CAMERA 7 10\n";

TEST_F(ColmapTest, RigsThatAgreeAreNoFinding) {
  write_model();
  folder_.write("sparse/0/rigs.txt", kRigs);
  folder_.write("sparse/0/frames.txt", kFrames);
  EXPECT_EQ(opened().findings.size(), 1u);
}

TEST_F(ColmapTest, PosesOfRigsReplaceStaleOnes) {
  write_model();
  folder_.write("sparse/0/rigs.txt", kRigs);
  folder_.write("sparse/0/frames.txt", "1 1 1 0 0 0 0 0 0.5 2 CAMERA 1 3 CAMERA 7 10\n");
  const Recording recording = opened();
  const Finding& finding = recording.findings.at(0);
  EXPECT_EQ(finding.subject, "rigs");
  EXPECT_THAT(finding.what, AllOf(HasSubstr("2 images of 3"), HasSubstr("0 degrees and 0.5")));
  EXPECT_NEAR(
      (recording.frames[0].global_from_body.translation() - Eigen::Vector3d(0, 0, -0.5)).norm(), 0,
      1e-12);
  folder_.write("sparse/0/frames.txt", "1 1 1 0 0 0 0 0 0.5 2 CAMERA 1 3 CAMERA\n");
  EXPECT_THAT(opened().findings.at(0).what,
              AllOf(HasSubstr("not used"), HasSubstr("frames.txt"), HasSubstr("number of values")));
}

TEST_F(ColmapTest, BinaryRigsAreThoseOfTheText) {
  const fs::path file = "f";
  std::string rigs, frames;
  const auto add = [](std::string* bytes, auto value) {
    bytes->append(reinterpret_cast<const char*>(&value), sizeof value);
  };
  add(&rigs, std::uint64_t{1}), add(&rigs, std::uint32_t{1}), add(&rigs, std::uint32_t{3});
  add(&rigs, std::int32_t{0}), add(&rigs, std::uint32_t{1});
  add(&rigs, std::int32_t{0}), add(&rigs, std::uint32_t{7}), add(&rigs, std::uint8_t{1});
  for (const double number : {std::sqrt(0.5), 0.0, -std::sqrt(0.5), 0.0, 0.0, 0.0, 2.0})
    add(&rigs, number);
  add(&rigs, std::int32_t{1}), add(&rigs, std::uint32_t{1}), add(&rigs, std::uint8_t{0});
  add(&frames, std::uint64_t{1}), add(&frames, std::uint32_t{1}), add(&frames, std::uint32_t{1});
  for (const double number : {1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}) add(&frames, number);
  add(&frames, std::uint32_t{2});
  for (const auto& [camera, image] : {std::pair(1u, 3ull), std::pair(7u, 10ull)})
    add(&frames, std::int32_t{0}), add(&frames, camera), add(&frames, image);
  const auto text = colmap::parse_rigs_text(kRigs, file);
  const auto binary = colmap::parse_rigs_binary(rigs, file);
  ASSERT_EQ(binary.size(), 1u);
  ASSERT_EQ(binary[0].camera_from_rig.size(), 2u);
  EXPECT_TRUE(binary[0].camera_from_rig.at(7)->isApprox(*text[0].camera_from_rig.at(7), 1e-15));
  EXPECT_EQ(colmap::parse_frames_binary(frames, file)[0].camera_of_image,
            colmap::parse_frames_text(kFrames, file)[0].camera_of_image);
  rigs.pop_back();
  EXPECT_THAT(input_error([&] { colmap::parse_rigs_binary(rigs, file); }),
              HasSubstr("rig 1 has pose: ends here"));
}

}  // namespace
}  // namespace redrive
