// SPDX-License-Identifier: Apache-2.0
// Sequences of NCore, read by a reader of the test's own.
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/base/files/zarr_testing.h"
#include "redrive/export/made_drive_testing.h"
#include "redrive/export/ncore/ncore_sequence.h"
#include "redrive/export/ncore/ncore_terms.h"
#include "redrive/image/png.h"
#include "redrive/recording/core/lidar_sensor.h"

namespace redrive {
namespace {

using nlohmann::json;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

Rigid3d pose_of(const json& rows) {
  Rigid3d pose = Rigid3d::Identity();
  for (int r = 0; r < 4; ++r)
    for (int c = 0; c < 4; ++c) pose.matrix()(r, c) = rows[r][c];
  return pose;
}

class WriteNcore : public MadeDrive {
 protected:
  WriteNcore() {
    recording_.cameras[1].calibration.readout_ns = 32'000'000;
    for (FramePose& frame : recording_.frames) frame.t_ns += kBegin_ns;
    make_reader();
  }
  WalkedStore written() {
    recording_.root = folder_.path / "a drive";
    std::filesystem::create_directories(out_);
    notes_ = write_ncore(out_, drive(), pool_, stop_);
    return WalkedStore(out_ / "a_drive.ncore4.zarr.itar");
  }
  std::int64_t us(std::int64_t t_ns) const { return (t_ns + 500) / 1000; }
  /// Pose of the rig in the store's world, interpolated as NCore does.
  static Rigid3d rig_at(const WalkedStore& store, std::int64_t us) {
    const json rig = store.attributes("poses/default/dynamic_poses")["('rig', 'world')"];
    std::vector<FramePose> poses;
    for (std::size_t i = 0; i < rig["poses"].size(); ++i)
      poses.push_back(
          {static_cast<std::int64_t>(i), rig["timestamps_us"][i], pose_of(rig["poses"][i])});
    return pose_at(poses, us);
  }

  static constexpr std::int64_t kBegin_ns = 1'600'000'000'000'000'000;
};

TEST_F(WriteNcore, MetadataAgree) {
  const WalkedStore store = written();
  const json meta = read_json(out_ / "a_drive.json"), root = store.json(".zattrs");
  EXPECT_EQ(root["version"], "v4");
  EXPECT_EQ(root["component_group_name"], "");
  for (const char* key :
       {"sequence_id", "sequence_timestamp_interval_us", "version", "generic_meta_data"})
    EXPECT_EQ(meta[key], root[key]) << key;
  ASSERT_EQ(meta["component_stores"].size(), 1u);
  const json& listed = meta["component_stores"][0];
  EXPECT_EQ(listed["path"], "a_drive.ncore4.zarr.itar");
  EXPECT_EQ(listed["md5"].get<std::string>().size(), 32u);
  for (const auto& [kind, instances] : listed["components"].items())
    for (const auto& [name, about] : instances.items()) {
      const json attributes = store.attributes(kind + "/" + name);
      EXPECT_EQ(attributes["component_name"], kind);
      EXPECT_EQ(attributes["component_instance_name"], name);
      EXPECT_EQ(attributes["component_version"], about["version"]);
    }
  EXPECT_EQ(listed["components"].size(), 6u);
  // The store repeats all metadata, and every level of a path is a group.
  const json all = json::from_cbor(unxz(store.bytes(".zmetadata.cbor.xz")));
  EXPECT_EQ(all["zarr_consolidated_format"], 1);
  std::size_t count = 0;
  for (const auto& [name, member] : store.members) {
    const std::string last = name.substr(name.rfind('/') + 1);
    if (last == ".zgroup" || last == ".zarray" || last == ".zattrs") {
      EXPECT_EQ(all["metadata"].at(name), json::parse(member.bytes)) << name;
      ++count;
    }
    if (last != ".zarray") continue;
    std::string group = name.substr(0, name.rfind('/'));
    while (group.find('/') != group.npos) {
      group.resize(group.rfind('/'));
      EXPECT_TRUE(store.members.contains(group + "/.zgroup")) << group;
    }
  }
  EXPECT_EQ(all["metadata"].size(), count);
}

TEST_F(WriteNcore, Md5IsOfTheStore) {
  EXPECT_TRUE(written().members.size() > 0);
  const std::string command = "md5sum '" + (out_ / "a_drive.ncore4.zarr.itar").string() + "'";
  FILE* pipe = popen(command.c_str(), "r");
  ASSERT_TRUE(pipe);
  char text[33] = {};
  EXPECT_EQ(std::fread(text, 1, 32, pipe), 32u);
  pclose(pipe);
  EXPECT_EQ(read_json(out_ / "a_drive.json")["component_stores"][0]["md5"], std::string(text));
}

TEST_F(WriteNcore, PosesCoverTheSequence) {
  const WalkedStore store = written();
  const json interval = store.json(".zattrs")["sequence_timestamp_interval_us"],
             rig = store.attributes("poses/default/dynamic_poses")["('rig', 'world')"],
             fixed = store.attributes("poses/default/static_poses");
  EXPECT_EQ(rig["timestamps_us"].front(), interval["start"]);
  EXPECT_EQ(rig["timestamps_us"].back(), interval["stop"].get<std::int64_t>() - 1);
  EXPECT_TRUE(std::ranges::is_sorted(rig["timestamps_us"].get<std::vector<std::int64_t>>(),
                                     std::ranges::less_equal()));
  const Rigid3d global_from_world = pose_of(fixed["('world', 'world_global')"]["pose"]);
  for (const FramePose& frame : recording_.frames) {
    const Rigid3d found = global_from_world * rig_at(store, us(frame.t_ns));
    EXPECT_LT((found.translation() - frame.global_from_body.translation()).norm(), 1e-4);
    EXPECT_LT((found.linear() - frame.global_from_body.linear()).norm(), 1e-6);
  }
  for (const RecordedCamera& camera : recording_.cameras)
    EXPECT_TRUE(pose_of(fixed["('" + camera.calibration.name + "', 'rig')"]["pose"])
                    .isApprox(camera.calibration.body_from_sensor, 1e-12));
  EXPECT_TRUE(pose_of(fixed["('lidar', 'rig')"]["pose"])
                  .isApprox(recording_.lidars[0].body_from_lidar, 1e-12));
}

TEST_F(WriteNcore, PosesWithoutPlaceOnTheEarth) {
  recording_.global_frame = GlobalFrame::kArbitrary;
  EXPECT_FALSE(
      written().attributes("poses/default/static_poses").contains("('world', 'world_global')"));
}

TEST_F(WriteNcore, ImagesAreTheRecordedFilesAtTheirTimes) {
  const WalkedStore store = written();
  const CameraCalibration& camera = recording_.cameras[1].calibration;
  const json times = store.attributes("cameras/FRONT/frames")["frames_timestamps_us"];
  ASSERT_EQ(times.size(), recording_.frames.size());
  for (std::size_t i = 0; i < times.size(); ++i) {
    const std::int64_t start = times[i][0], end = times[i][1], t_ns = recording_.frames[i].t_ns;
    // Row v of h: start + v / (h - 1) (end - start).
    for (const int v : {0, camera.height - 1}) {
      const double share = (v + 0.5) / camera.height - 0.5;
      EXPECT_NEAR(static_cast<double>(v == 0 ? start : end) - static_cast<double>(us(t_ns)),
                  share * 32'000, 1);
    }
    const std::string frame = "cameras/FRONT/frames/" + std::to_string(end);
    const std::string image = read_file(recording_.cameras[1].images[i].path);
    EXPECT_EQ(store.bytes(frame + "/image/0"), image);
    EXPECT_EQ(store.attributes(frame + "/image")["format"], "png");
    const json about = store.json(frame + "/image/.zarray");
    EXPECT_EQ(about["dtype"], "|S" + std::to_string(image.size()));
    EXPECT_EQ(about["shape"], json::array());
    EXPECT_TRUE(about["compressor"].is_null());
    EXPECT_TRUE(store.members.contains(frame + "/generic_data/.zgroup"));
  }
  const json intrinsics = store.attributes("intrinsics/default/cameras/FRONT");
  EXPECT_EQ(intrinsics["camera_model_type"], "opencv-pinhole");
  const json& p = intrinsics["camera_model_parameters"];
  EXPECT_EQ(p["resolution"], json({24, 16}));
  EXPECT_EQ(p["shutter_type"], "ROLLING_TOP_TO_BOTTOM");
  EXPECT_EQ(p["principal_point"], json({12.0, 8.0}));
  EXPECT_EQ(p["focal_length"], json({22.0, 20.0}));
  EXPECT_EQ(p["radial_coeffs"], json({-0.3, 0.08, 0.0, 0.0, 0.0, 0.0}));
  EXPECT_EQ(p["tangential_coeffs"], json({0.002, 0.0006}));
  EXPECT_EQ(store.attributes("masks/default/cameras/FRONT")["mask_names"], json::array());
}

// NCore has no such lens: images are resampled, and pixels that it does not see are masked.
TEST_F(WriteNcore, OtherLensesAreResampled) {
  const WalkedStore store = written();
  const json times = store.attributes("cameras/FISHEYE/frames")["frames_timestamps_us"];
  const std::int64_t end = times[2][1];
  EXPECT_EQ(times[2][0], end) << "a global shutter";
  EXPECT_EQ(end, us(recording_.frames[2].t_ns + 12'000'000));
  const json p = store.attributes("intrinsics/default/cameras/FISHEYE");
  EXPECT_EQ(p["camera_model_type"], "opencv-fisheye");
  EXPECT_EQ(p["camera_model_parameters"]["shutter_type"], "GLOBAL");
  EXPECT_GT(p["camera_model_parameters"]["max_angle"], 0.0);
  const PhotoCamera photo = photo_camera(recording_.cameras[0].calibration, ncore::has_model);
  const Image8 image =
      decode_png(store.bytes("cameras/FISHEYE/frames/" + std::to_string(end) + "/image/0"), "made");
  const Image8 mask = decode_png(store.bytes("masks/default/cameras/FISHEYE/ego/0"), "made");
  int seen = 0, masked = 0;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const auto i = 3 * static_cast<std::size_t>(y * image.width + x);
      const auto at = photo.recorded.project(*photo.camera.unproject({double(x), double(y)}));
      const bool inside = at && at->x() >= 0 && at->x() <= 19 && at->y() >= 0 && at->y() <= 13;
      EXPECT_EQ(mask.rgb[i], inside ? 0 : 255) << x << ' ' << y;
      ++(inside ? seen : masked);
      if (!inside) continue;
      EXPECT_NEAR(image.rgb[i], 5 * at->x(), 1.5);  // test_colour
      EXPECT_NEAR(image.rgb[i + 1], 7 * at->y(), 1.5);
    }
  EXPECT_GT(seen, 100);
  EXPECT_GT(masked, 0);
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("FISHEYE (mei) are resampled")));
}

TEST_F(WriteNcore, AMaskOfAllImagesIsTheEgoMask) {
  Image8 mask{24, 16, std::vector<std::uint8_t>(3 * 24 * 16, 255), {}, {}};
  std::fill_n(mask.rgb.begin(), 3 * 5, 0);
  write_image(folder_.path / "mask.png", mask);
  for (ImageFile& image : recording_.cameras[1].images) image.mask = {folder_.path / "mask.png"};
  {
    const WalkedStore store = written();
    EXPECT_EQ(store.attributes("masks/default/cameras/FRONT")["mask_names"], json({"ego"}));
    const Image8 ego = decode_png(store.bytes("masks/default/cameras/FRONT/ego/0"), "made");
    for (std::size_t i = 0; i < ego.rgb.size(); ++i) EXPECT_EQ(ego.rgb[i], 255 - mask.rgb[i]);
  }
  recording_.cameras[1].images[2].mask = {};
  std::filesystem::remove_all(out_);
  const WalkedStore store = written();
  EXPECT_EQ(store.attributes("masks/default/cameras/FRONT")["mask_names"], json::array());
  EXPECT_THAT(notes_.left_out, Contains(HasSubstr("masks of single images of FRONT")));
}

TEST_F(WriteNcore, RaysEndAtTheRecordedPoints) {
  reader_->columns = kColumns - 3;  // the last byte of the mask is not full
  const WalkedStore store = written();
  const json times = store.attributes("lidars/lidar/frames")["frames_timestamps_us"],
             interval = store.json(".zattrs")["sequence_timestamp_interval_us"],
             fixed = store.attributes("poses/default/static_poses");
  const Rigid3d rig_from_lidar = pose_of(fixed["('lidar', 'rig')"]["pose"]),
                global_from_world = pose_of(fixed["('world', 'world_global')"]["pose"]);
  ASSERT_EQ(times.size(), recording_.lidar_files.size());
  for (std::size_t f = 0; f < times.size(); ++f) {
    const auto were = recording_.reader->read_lidar(recording_.lidar_files[f]);
    const std::size_t n = were.size();
    EXPECT_GE(times[f][0], interval["start"]);
    EXPECT_LT(times[f][1], interval["stop"]);
    const std::string frame =
        "lidars/lidar/frames/" + std::to_string(times[f][1].get<std::int64_t>());
    EXPECT_EQ(store.attributes(frame + "/ray_bundle")["n_rays"], n);
    EXPECT_EQ(store.attributes(frame + "/ray_bundle_returns")["n_returns"], 1);
    const auto direction = store.array<float>(frame + "/ray_bundle/direction", "<f4", {n, 3});
    const auto t_us = store.array<std::uint64_t>(frame + "/ray_bundle/timestamp_us", "<u8", {n});
    const auto distance =
        store.array<float>(frame + "/ray_bundle_returns/distance_m", "<f4", {1, n});
    const auto intensity =
        store.array<float>(frame + "/ray_bundle_returns/intensity", "<f4", {1, n});
    EXPECT_EQ(times[f][0], *std::ranges::min_element(t_us));
    EXPECT_EQ(times[f][1], *std::ranges::max_element(t_us));
    for (std::size_t i = 0; i < n; ++i) {
      const Eigen::Vector3d ray(direction[3 * i], direction[3 * i + 1], direction[3 * i + 2]);
      ASSERT_NEAR(ray.norm(), 1, 1e-6);
      ASSERT_LT((rig_from_lidar * (distance[i] * ray) - were[i].in_body_m.cast<double>()).norm(),
                5e-6);
      ASSERT_EQ(t_us[i], static_cast<std::uint64_t>(us(were[i].t_ns)));
      ASSERT_FLOAT_EQ(intensity[i], static_cast<float>(were[i].intensity) / 255);
    }
    // In the world, motion compensated: within the way of half a microsecond.
    const Eigen::Vector3d ray(direction[0], direction[1], direction[2]),
        found = global_from_world * (rig_at(store, static_cast<std::int64_t>(t_us[0])) *
                                     (rig_from_lidar * (distance[0] * ray))),
        expected = pose_at(recording_.frames, were[0].t_ns) * were[0].in_body_m.cast<double>();
    EXPECT_LT((found - expected).norm(), 1e-4);
    const std::string valid = frame + "/ray_bundle_returns_valid_mask_packed";
    EXPECT_EQ(store.attributes(valid), json({{"n_rays", n}, {"n_returns", 1}}));
    const auto bits = store.array<std::uint8_t>(valid, "|u1", {(n + 7) / 8});
    for (std::size_t i = 0; i < 8 * bits.size(); ++i)
      ASSERT_EQ(bits[i / 8] >> (7 - i % 8) & 1, i < n) << i;
  }
}

TEST_F(WriteNcore, RowsAndColumnsGiveTheDirections) {
  reader_->has_ring = true;
  const WalkedStore store = written();
  const json about = store.attributes("intrinsics/default/lidars/lidar");
  EXPECT_EQ(about["lidar_model_type"], "row-offset-spinning");
  const json& p = about["lidar_model_parameters"];
  EXPECT_EQ(p["spinning_direction"], "cw");
  EXPECT_NEAR(p["spinning_frequency_hz"], 10, 0.01);
  ASSERT_EQ(p["n_rows"], 1);
  ASSERT_EQ(p["n_columns"], kColumns);
  for (int j = 1; j < kColumns; ++j) {
    const double step =
        p["column_azimuths_rad"][j - 1].get<double>() - p["column_azimuths_rad"][j].get<double>();
    EXPECT_NEAR(std::remainder(step, 2 * M_PI), 2 * M_PI / kColumns, 1e-9);
  }
  const json times = store.attributes("lidars/lidar/frames")["frames_timestamps_us"];
  for (const json& time : times) {
    const std::string bundle =
        "lidars/lidar/frames/" + std::to_string(time[1].get<std::int64_t>()) + "/ray_bundle/";
    const std::size_t n = kColumns;
    const auto direction = store.array<float>(bundle + "direction", "<f4", {n, 3});
    const auto element = store.array<std::uint16_t>(bundle + "model_element", "<u2", {n, 2});
    std::set<int> columns;
    for (std::size_t i = 0; i < n; ++i) {
      const int row = element[2 * i], column = element[2 * i + 1];
      ASSERT_LT(row, 1);
      ASSERT_LT(column, kColumns);
      columns.insert(column);
      const Eigen::Vector3d expected = beam_direction(
          p["row_elevations_rad"][row], p["column_azimuths_rad"][column].get<double>() +
                                            p["row_azimuth_offsets_rad"][row].get<double>());
      const Eigen::Vector3d ray(direction[3 * i], direction[3 * i + 1], direction[3 * i + 2]);
      EXPECT_LT((ray - expected).norm(), 1e-3);
    }
    EXPECT_EQ(columns.size(), n) << "each ray has its own";
  }
}

TEST_F(WriteNcore, BeamsThatAreNotKnownAreNamed) {
  reader_->columns = 100;
  const WalkedStore store = written();
  EXPECT_FALSE(store.members.contains("intrinsics/default/lidars/lidar/.zattrs"));
  EXPECT_THAT(notes_.left_out,
              Contains("rows and columns of the rays of lidar: its scans have only 200 returns"));
}

TEST_F(WriteNcore, EveryLidarIsWritten) {
  recording_.lidars.push_back({"top/left", Rigid3d::Identity()});
  recording_.lidar_files.push_back({recording_.frames[1].id, "made", 1});
  const WalkedStore store = written();
  const json times = store.attributes("lidars/top_left/frames")["frames_timestamps_us"];
  EXPECT_EQ(times.size(), 1u);
  EXPECT_TRUE(store.attributes("poses/default/static_poses").contains("('top_left', 'rig')"));
}

TEST_F(WriteNcore, RevolutionsOutsideThePosesAreNamed) {
  reader_->frames[0].t_ns -= 1'000'000'000;
  const WalkedStore store = written();
  EXPECT_EQ(store.attributes("lidars/lidar/frames")["frames_timestamps_us"].size(), 4u);
  EXPECT_THAT(notes_.left_out, Contains("1 LiDAR revolution of lidar without a pose"));
}

TEST_F(WriteNcore, BoxesAreWhereTheyWere) {
  reader_->tilt = Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 2).normalized());
  const WalkedStore store = written();
  const json all = store.attributes("cuboids/default/cuboids")["cuboid_track_observations"];
  ASSERT_EQ(all.size(), 3 * recording_.frames.size());
  std::size_t i = 0;
  for (const FrameFile& file : recording_.box_files)
    for (const Box& was : recording_.reader->read_boxes(file)) {
      const json& box = all[i++];
      EXPECT_EQ(box["track_id"], std::to_string(was.object_id));
      EXPECT_EQ(box["class_id"], was.type == "CAR" ? "automobile" : "person");
      EXPECT_EQ(box["timestamp_us"], us(was.t_ns));
      EXPECT_EQ(box["reference_frame_id"], "rig");
      EXPECT_EQ(box["reference_frame_timestamp_us"], us(was.t_ns));
      EXPECT_EQ(box["source"], "EXTERNAL");
      const auto rot = box["bbox3"]["rot"].get<std::vector<double>>();
      const Eigen::Matrix3d turn = (Eigen::AngleAxisd(rot[2], Eigen::Vector3d::UnitZ()) *
                                    Eigen::AngleAxisd(rot[1], Eigen::Vector3d::UnitY()) *
                                    Eigen::AngleAxisd(rot[0], Eigen::Vector3d::UnitX()))
                                       .toRotationMatrix();
      EXPECT_TRUE(turn.isApprox(was.body_from_box.linear(), 1e-9));
      for (int k = 0; k < 3; ++k) {
        EXPECT_NEAR(box["bbox3"]["centroid"][k], was.body_from_box.translation()[k], 1e-9);
        EXPECT_NEAR(box["bbox3"]["dim"][k], was.size_m[k], 1e-12);
      }
    }
}

// Boxes up to 0.2 s beyond the poses widen the sequence.
TEST_F(WriteNcore, BoxesOutsideThePosesAreNamed) {
  recording_.lidar_files.clear();
  reader_->frames[0].t_ns -= 190'000'000;
  reader_->frames[4].t_ns += 210'000'000;
  const WalkedStore store = written();
  const json all = store.attributes("cuboids/default/cuboids")["cuboid_track_observations"],
             rig = store.attributes("poses/default/dynamic_poses")["('rig', 'world')"];
  EXPECT_EQ(all.size(), 3 * 4u);
  EXPECT_EQ(all[0]["timestamp_us"], rig["timestamps_us"].front());
  EXPECT_THAT(notes_.left_out, Contains("3 box records without a pose"));
}

TEST_F(WriteNcore, TimesAreNeverNegative) {
  for (FramePose& frame : recording_.frames) frame.t_ns -= kBegin_ns + 1'000'000'000;
  make_reader();
  const WalkedStore store = written();
  EXPECT_THAT(notes_.changed, Contains(HasSubstr("10 seconds before the first frame")));
  const json rig = store.attributes("poses/default/dynamic_poses")["('rig', 'world')"];
  EXPECT_GT(rig["timestamps_us"].front(), 9'000'000);
  EXPECT_TRUE(rig_at(store, 10'000'000).isApprox(Rigid3d::Identity(), 1e-9));
}

TEST(NcoreFrameTimes, StartsAndEndsIncrease) {
  ncore::FrameTimes times;
  EXPECT_TRUE(times.add(10, 20));
  EXPECT_TRUE(times.add(30, 40));
  EXPECT_TRUE(times.add(15, 25)) << "frames may overlap";
  EXPECT_FALSE(times.add(16, 25)) << "the same end";
  EXPECT_FALSE(times.add(15, 26)) << "the same start";
  EXPECT_FALSE(times.add(5, 22)) << "within another";
  EXPECT_FALSE(times.add(35, 39));
  EXPECT_EQ(times.json(), ncore::Json::parse("[[10,20],[15,25],[30,40]]"));
}

TEST(NcoreTerms, PeopleAndVehiclesHaveNuRecsClasses) {
  for (const auto& [type, word] :
       std::map<std::string, std::string>{{"CAR", "automobile"},
                                          {"vehicle.bus.rigid", "bus"},
                                          {"BOX_TRUCK", "heavy_truck"},
                                          {"Pickup Truck", "heavy_truck"},
                                          {"REGULAR_VEHICLE", "automobile"},
                                          {"Pedestrian", "person"},
                                          {"Cyclist", "rider"},
                                          {"Cones", "Cones"},
                                          {"Construction Signs", "Construction Signs"},
                                          {"vehicle.bicycle", "vehicle.bicycle"},
                                          {"Rolling Containers", "Rolling Containers"}})
    EXPECT_EQ(ncore::class_of_box(type), word) << type;
}

TEST(NcoreTerms, PrincipalPointsCountFromTheCornerOrTheCentre) {
  for (const auto& [model, type, shift] :
       {std::tuple{"opencv_rational", "opencv-pinhole", 0.5},
        std::tuple{"opencv_thin_prism", "opencv-pinhole", 0.5},
        std::tuple{"opencv_fisheye", "opencv-fisheye", 0.5}, std::tuple{"ftheta", "ftheta", 0.0},
        std::tuple{"ftheta_inverse", "ftheta", 0.0},
        std::tuple{"ftheta_inverse_windshield", "ftheta", 0.0}}) {
    const CameraModelInfo& info = *find_camera_model(model);
    CameraCalibration camera{"C", model, {300, 300, 319.5, 239.5}, 640, 480, Rigid3d::Identity()};
    camera.parameters.insert(camera.parameters.end(), info.typical.begin(), info.typical.end());
    camera.readout_ns = -1;
    ASSERT_TRUE(ncore::has_model(camera));
    const auto json = ncore::camera_model(camera, make_camera(camera));
    EXPECT_EQ(json["type"], type);
    EXPECT_EQ(json["parameters"]["principal_point"][0], 319.5 + shift) << model;
    EXPECT_EQ(json["parameters"]["shutter_type"], "ROLLING_BOTTOM_TO_TOP");
    if (model == std::string_view("opencv_thin_prism")) {
      EXPECT_EQ(json["parameters"]["thin_prism_coeffs"].get<std::vector<double>>(),
                std::vector<double>(info.typical.end() - 4, info.typical.end()));
    }
    EXPECT_EQ(json["parameters"].contains("reference_poly"), shift == 0);
    EXPECT_EQ(json["parameters"]["external_distortion_parameters"].contains("vertical_poly"),
              std::string_view(model).ends_with("_windshield"));
    EXPECT_EQ(json.contains("external_distortion_type"),
              std::string_view(model).ends_with("_windshield"));
    camera.readout_by_column = true;
    EXPECT_EQ(ncore::camera_model(camera, make_camera(camera))["parameters"]["shutter_type"],
              "ROLLING_RIGHT_TO_LEFT");
  }
  EXPECT_FALSE(ncore::has_model({"C", "mei", {}, 1, 1, Rigid3d::Identity()}));
}

}  // namespace
}  // namespace redrive
