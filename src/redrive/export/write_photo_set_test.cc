// SPDX-License-Identifier: Apache-2.0
// Folders of photographs, read as nerfstudio reads them.
#include "redrive/export/write_photo_set.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/base/output_folder.h"
#include "redrive/image/image_io.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

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
  EXPECT_THROW(
      write_output_folder(out_,
                          [&](const fs::path& folder) {
                            write_colmap(folder, set(), {}, pool_, stop_);
                          }),
      Interrupted);
  EXPECT_FALSE(fs::exists(out_));
  EXPECT_FALSE(fs::exists(folder_.path / ".out.redrive-tmp"));
}

}  // namespace
}  // namespace redrive
