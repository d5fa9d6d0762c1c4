// SPDX-License-Identifier: Apache-2.0
// Folders of photographs, read as nerfstudio reads them.
#include "redrive/export/write_photo_set.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/output_folder.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/lidar/ply.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

/// The test recording: FISHEYE (mei), FRONT (opencv_pinhole), two frames.
class WritePhotoSetTest : public ::testing::Test {
 protected:
  PhotoSet set() const {
    return make_photo_set(recording_, make_scene(recording_, {}), is_transforms_camera);
  }
  nlohmann::json transforms(const PhotoSet& set) {
    write_transforms(out_, set, {}, pool_, stop_);
    return read_json(out_ / "transforms.json");
  }

  TemporaryFolder folder_;
  const fs::path out_ = folder_.path / "out";
  Recording recording_ = make_test_recording(folder_.path, 2);
  ThreadPool pool_{2};
  std::atomic<bool> stop_ = false;
};

TEST_F(WritePhotoSetTest, LeavesNothingWhenStopped) {
  stop_ = true;
  EXPECT_THROW(write_output_folder(
                   "OUT", out_, false,
                   [&](const fs::path& folder) { write_colmap(folder, set(), {}, pool_, stop_); }),
               Interrupted);
  EXPECT_FALSE(fs::exists(out_));
  EXPECT_FALSE(fs::exists(folder_.path / ".out.redrive-tmp"));
}

TEST_F(WritePhotoSetTest, GivesAllPhotosAMaskOrNone) {
  const PhotoSet resampled = set();
  const auto frames = transforms(resampled).at("frames");
  ASSERT_EQ(frames.size(), 4u);
  bool found = false;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const Image8 image = read_image(out_ / frames[i].at("file_path").get<std::string>()),
                 mask = read_image(out_ / frames[i].at("mask_path").get<std::string>());
    EXPECT_EQ(mask.width, image.width);
    EXPECT_EQ(mask.height, image.height);
    if (resampled.cameras[resampled.photos[i].camera].resampled) continue;
    found = true;
    EXPECT_THAT(mask.rgb, Each(255)) << "FRONT has none";
  }
  EXPECT_TRUE(found);

  fs::remove_all(out_);
  recording_.cameras.erase(recording_.cameras.begin());  // FISHEYE
  EXPECT_THAT(transforms(set()).at("frames").dump(), Not(HasSubstr("mask_path")));
}

TEST_F(WritePhotoSetTest, NamesEverySplitThatNerfstudioAsksFor) {
  PhotoSet split = set();
  split.photos[1].held_out = true;
  const nlohmann::json file = transforms(split);
  EXPECT_EQ(file.at("train_filenames").size(), 3u);
  EXPECT_EQ(file.at("val_filenames"), file.at("test_filenames"));
  EXPECT_EQ(file.at("test_filenames").at(0), file.at("frames").at(1).at("file_path"));
}

TEST_F(WritePhotoSetTest, NamesACameraModelThatAllShare) {
  const PhotoSet mixed = set();
  EXPECT_TRUE(has_two_kinds_of_lenses(mixed));
  EXPECT_FALSE(transforms(mixed).contains("camera_model"));
  fs::remove_all(out_);
  RecordedCamera& fisheye = recording_.cameras[0];
  fisheye.calibration.model = "opencv_fisheye";
  fisheye.calibration.parameters.resize(8, 0);
  RecordedCamera& other = recording_.cameras[1];
  other.calibration.model = "opencv_fisheye";
  other.calibration.parameters = {22, 20, 11.5, 7.5, 0, 0, 0, 0};
  const PhotoSet same = set();
  EXPECT_FALSE(has_two_kinds_of_lenses(same));
  const nlohmann::json file = transforms(same);
  EXPECT_EQ(file.at("camera_model"), "OPENCV_FISHEYE");
  EXPECT_NE(file.at("frames").at(0).at("w"), file.at("frames").at(3).at("w"));
}

TEST_F(WritePhotoSetTest, NamesPhotosOnceAndWithoutBlanks) {
  std::vector<ImageFile>& images = recording_.cameras[1].images;  // FRONT, copied
  for (std::size_t i = 0; i < images.size(); ++i) {
    const fs::path file = folder_.path / std::to_string(i) / "a photo\t1.png";
    fs::create_directories(file.parent_path());
    fs::copy_file(images[i].path, file);
    images[i].path = file;
  }
  std::vector<std::string> names;
  for (const Photo& photo : set().photos)
    if (photo.name.parent_path() == "FRONT") names.push_back(photo.name.filename().string());
  EXPECT_THAT(names, ElementsAre("a_photo_1.png", "1_a_photo_1.png"));
}

// Photographs with coordinates of a map: floats would resolve half a metre there.
TEST_F(WritePhotoSetTest, PointsFarFromTheOriginKeepMillimetres) {
  const Eigen::Vector3d far(691'000.125, 5'335'000.25, 512);
  PhotoSet photos = set();
  photos.world_from_scene = Rigid3d(Eigen::Translation3d(far));
  PointCloud points;
  points.n = 1;
  points.position = {1.001f, 2.002f, 3.003f};
  points.rgb = {0, 0.5f, 1};
  points.seen_from = {0, 0, 0};
  write_transforms(out_, photos, points, pool_, stop_);
  const std::vector<Eigen::Vector3d> written = read_ply(out_ / "points.ply");
  ASSERT_EQ(written.size(), 1u);
  EXPECT_LT((written[0] - far - Eigen::Vector3d(1.001, 2.002, 3.003)).norm(), 1e-6);
}

}  // namespace
}  // namespace redrive
