// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/check_bundle.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/base/files/zip.h"

namespace redrive {
namespace {

using nlohmann::json;
using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

const json kUnit = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};

/// A bundle that is complete, as JSON by member; text stays text.
json complete() {
  json parameters;
  for (const char* const key : {"resolution", "shutter_type", "external_distortion_parameters",
                                "principal_point", "reference_poly", "pixeldist_to_angle_poly",
                                "angle_to_pixeldist_poly", "max_angle", "linear_cde"})
    parameters[key] = nullptr;
  return {{"metadata.yaml",
           {{"scene_id", "s"},
            {"version_string", "v"},
            {"training_date", "d"},
            {"dataset_hash", "h"},
            {"uuid", "u"},
            {"is_resumable", false},
            {"sensors", json::object()},
            {"logger", json::object()},
            {"time_range", {{"start", 1.5}, {"end", 2.5}}}}},
          {"data_info.json",
           {{"sequence_id", "s"},
            {"pose-range", {{"start-timestamp_us", 10}, {"end-timestamp_us", 20}}}}},
          {"rig_trajectories.json",
           {{"world_to_nre", {{"matrix", kUnit}}},
            {"T_world_base", kUnit},
            {"camera_calibrations",
             {{"c",
               {{"sequence_id", "s"},
                {"logical_sensor_name", "front"},
                {"unique_sensor_idx", 0},
                {"T_sensor_rig", kUnit},
                {"camera_model", {{"type", "ftheta"}, {"parameters", parameters}}}}}}},
            {"rig_trajectories",
             {{{"sequence_id", "s"},
               {"T_rig_worlds", {kUnit, kUnit}},
               {"T_rig_world_timestamps_us", {10, 20}},
               {"cameras_frame_timestamps_us", {{"c", {{10, 11}}}}}}}}}},
          {"sequence_tracks.json",
           {{"dummy_chunk_id",
             {{"tracks_data",
               {{"tracks_id", {"7"}},
                {"tracks_label_class", {"automobile"}},
                {"tracks_flags", {{"CONTROLLABLE"}}},
                {"tracks_timestamps_us", {{10, 20}}},
                {"tracks_poses", {{{0, 0, 0, 0, 0, 0, 1}, {1, 0, 0, 0, 0, 0, 1}}}}}},
              {"cuboidtracks_data", {{"cuboids_dims", {{4, 2, 1}}}}}}}}},
          {"mesh.ply", "ply"},
          {"mesh_ground.ply", "ply"},
          {"map.xodr",
           "<OpenDRIVE><header><geoReference>+lat_0=1 +lon_0=2 +=alt_0=0</geoReference></header>"
           "<road/></OpenDRIVE>"}};
}

class CheckBundle : public ::testing::Test {
 protected:
  BundleReport report(const json& members) const {
    std::vector<std::string> bytes;
    for (const auto& [name, value] : members.items())
      bytes.push_back(value.is_string() ? value.get<std::string>() : value.dump());
    std::vector<ZipMember> zip;
    for (const auto& [name, value] : members.items()) zip.push_back({name, bytes[zip.size()]});
    write_zip(folder_.path / "a.usdz", zip);
    return check_bundle(folder_.path / "a.usdz");
  }
  static std::vector<std::string> texts(const std::vector<BundleGap>& gaps) {
    std::vector<std::string> all;
    for (const BundleGap& gap : gaps) all.push_back(gap.member + ": " + gap.field + " " + gap.what);
    return all;
  }
  TemporaryFolder folder_;
};

TEST_F(CheckBundle, AliasesOfYamlAreBounded) {
  json members = complete();
  std::string yaml = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n";
  for (int i = 1; i < 12; ++i) {
    const std::string name = std::to_string(i), before = "*a" + std::to_string(i - 1);
    yaml += "a" + name + ": &a" + name + " [" + before;
    for (int k = 0; k < 9; ++k) yaml += ", " + before;
    yaml += "]\n";
  }
  members["metadata.yaml"] = yaml;
  EXPECT_THAT(texts(report(members).alpasim), Contains(HasSubstr("stand for too many values")));
}

TEST_F(CheckBundle, ARunThatCannotBeRenderedIsNamed) {
  json members = complete();
  members["redrive/config.json"] = json::object();
  const BundleReport found = report(members);
  EXPECT_TRUE(found.has_run);
  EXPECT_THAT(found.run_damage, HasSubstr("redrive/"));
}

TEST_F(CheckBundle, FindsNothingInAWholeOne) {
  const BundleReport whole = report(complete());
  EXPECT_THAT(texts(whole.alpasim), IsEmpty());
  EXPECT_THAT(texts(whole.carla), IsEmpty());
  EXPECT_THAT(texts(whole.remarks), IsEmpty());
  EXPECT_EQ(whole.scene_id, "s");
  EXPECT_EQ(whole.members.size(), 7u);
  EXPECT_FALSE(whole.has_run);
}

TEST_F(CheckBundle, NamesWhatEachOfThemMisses) {
  // what is removed, and whom it keeps from opening the bundle
  const std::vector<std::tuple<const char*, const char*, bool, bool>> cases = {
      {"metadata.yaml", "/scene_id", true, false},
      {"metadata.yaml", "/time_range/end", true, false},
      {"data_info.json", "/sequence_id", false, true},
      {"data_info.json", "/pose-range/end-timestamp_us", false, true},
      {"rig_trajectories.json", "/world_to_nre/matrix", true, false},
      {"rig_trajectories.json", "/T_world_base", true, true},
      {"rig_trajectories.json", "/camera_calibrations/c/logical_sensor_name", true, true},
      {"rig_trajectories.json", "/camera_calibrations/c/camera_model/parameters/linear_cde", false,
       true},
      {"rig_trajectories.json", "/rig_trajectories/0/cameras_frame_timestamps_us", true, false},
      {"rig_trajectories.json", "/rig_trajectories/0/T_rig_worlds/1", true, true},
      {"sequence_tracks.json", "/dummy_chunk_id/tracks_data/tracks_flags", true, true},
      {"sequence_tracks.json", "/dummy_chunk_id/cuboidtracks_data/cuboids_dims/0", true, true},
      {"sequence_tracks.json", "/dummy_chunk_id/tracks_data/tracks_poses/0/0/6", true, true}};
  for (const auto& [member, pointer, alpasim, carla] : cases) {
    json members = complete();
    const json::json_pointer at(pointer);
    json& parent = members[member][at.parent_pointer()];
    if (parent.is_array())
      parent.erase(std::stoul(at.back()));
    else
      parent.erase(at.back());
    const BundleReport broken = report(members);
    const std::string leaf = parent.is_array() ? "" : at.back();
    for (const auto& [gaps, expected] :
         {std::pair(broken.alpasim, alpasim), std::pair(broken.carla, carla)}) {
      ASSERT_EQ(gaps.size(), expected ? 1u : 0u) << pointer;
      if (!expected) continue;
      EXPECT_EQ(gaps[0].member, member);
      EXPECT_THAT(gaps[0].field, HasSubstr(leaf)) << pointer;
    }
  }
}

TEST_F(CheckBundle, NamesMembersThatAreMissingOrBroken) {
  const json whole = complete();
  for (const auto& [name, value] : whole.items()) {
    json members = whole;
    members.erase(name);
    const BundleReport without = report(members);
    const std::vector<BundleGap>& gaps = name == "mesh_ground.ply"  ? without.remarks
                                         : name == "map.xodr"       ? without.carla
                                         : name == "data_info.json" ? without.carla
                                                                    : without.alpasim;
    ASSERT_EQ(gaps.size(), 1u) << name;
    EXPECT_EQ(gaps[0].member, name);
    EXPECT_THAT(gaps[0].what, HasSubstr("is missing"));
    for (const char* const broken : {"", "{", "[]", "\"x\"", "{\"a\": 1}", "\xff\xfe"}) {
      members = whole;
      members[name] = "";
      std::vector<std::string> bytes;
      for (const auto& [own, own_value] : members.items())
        bytes.push_back(own == name             ? broken
                        : own_value.is_string() ? own_value.get<std::string>()
                                                : own_value.dump());
      std::vector<ZipMember> zip;
      for (const auto& [own, own_value] : members.items()) zip.push_back({own, bytes[zip.size()]});
      write_zip(folder_.path / "b.usdz", zip);
      const BundleReport damaged = check_bundle(folder_.path / "b.usdz");
      if (!name.ends_with(".ply")) {
        EXPECT_FALSE(damaged.alpasim.empty() && damaged.carla.empty()) << name << broken;
      }
    }
  }
}

TEST_F(CheckBundle, SaysWhatDiffersAndWhatIsLeftOut) {
  json members = complete();
  members["data_info.json"]["sequence_id"] = "t";
  members["map.xodr"] = "<OpenDRIVE><header/><road/></OpenDRIVE>";
  members["rig_trajectories.json"]["rig_trajectories"][0]["cameras_frame_timestamps_us"]["d"] =
      json::array();
  const BundleReport other = report(members);
  EXPECT_THAT(texts(other.remarks), Contains(HasSubstr("sequence_id is t")));
  EXPECT_THAT(texts(other.remarks), Contains(HasSubstr("geoReference is missing")));
  EXPECT_THAT(texts(other.alpasim), Contains(HasSubstr(".d is not among camera_calibrations")));
  write_file(folder_.path / "c.usdz", "no zip");
  EXPECT_THROW(check_bundle(folder_.path / "c.usdz"), InputError);
}

}  // namespace
}  // namespace redrive
