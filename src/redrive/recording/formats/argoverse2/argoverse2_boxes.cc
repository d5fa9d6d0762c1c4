// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/argoverse2/argoverse2_boxes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/recording/core/labels.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/argoverse2/argoverse2_scan.h"
#include "redrive/recording/formats/argoverse2/argoverse2_tables.h"
#include "redrive/recording/formats/timed_images.h"
#include "redrive/recording/parse/arrow_table.h"

namespace redrive::argoverse2 {
namespace {

constexpr double kMaxSize_m = 100;
/// AnnotationCategories of av2-api, and the guide's shorter name of one.
constexpr std::array<std::string_view, 31> kCategories = {"ANIMAL",
                                                          "ARTICULATED_BUS",
                                                          "BICYCLE",
                                                          "BICYCLIST",
                                                          "BOLLARD",
                                                          "BOX_TRUCK",
                                                          "BUS",
                                                          "CONSTRUCTION_BARREL",
                                                          "CONSTRUCTION_CONE",
                                                          "DOG",
                                                          "LARGE_VEHICLE",
                                                          "MESSAGE_BOARD_TRAILER",
                                                          "MOBILE_PEDESTRIAN_CROSSING_SIGN",
                                                          "MOBILE_PEDESTRIAN_SIGN",
                                                          "MOTORCYCLE",
                                                          "MOTORCYCLIST",
                                                          "OFFICIAL_SIGNALER",
                                                          "PEDESTRIAN",
                                                          "RAILED_VEHICLE",
                                                          "REGULAR_VEHICLE",
                                                          "SCHOOL_BUS",
                                                          "SIGN",
                                                          "STOP_SIGN",
                                                          "STROLLER",
                                                          "TRAFFIC_LIGHT_TRAILER",
                                                          "TRUCK",
                                                          "TRUCK_CAB",
                                                          "VEHICULAR_TRAILER",
                                                          "WHEELCHAIR",
                                                          "WHEELED_DEVICE",
                                                          "WHEELED_RIDER"};
static_assert(std::ranges::is_sorted(kCategories));

}  // namespace

bool is_known_category(std::string_view category) {
  return std::ranges::binary_search(kCategories, category);
}

std::vector<Cuboid> parse_cuboids(std::string_view feather, const std::filesystem::path& file,
                                  std::vector<std::string>* impossible) {
  const ArrowTable table(feather, file);
  const std::vector<std::int64_t> times_ns = table.integers("timestamp_ns");
  const std::vector<std::string> tracks = table.texts("track_uuid"),
                                 categories = table.texts("category");
  std::vector<double> sizes[3];
  for (int k = 0; k < 3; ++k) sizes[k] = table.numbers(kSizeColumns[k]);
  const PoseColumns poses(table, file);
  std::vector<Cuboid> cuboids;
  for (std::size_t i = 0; i < table.rows(); ++i) try {
      const auto fail = [&](const char* column, const std::string& value, const char* rule) {
        throw InputError(file, std::string(column) + " of row " + std::to_string(i), value, rule);
      };
      if (times_ns[i] < 0 || times_ns[i] > kMaxTime_ns)
        fail("timestamp_ns", std::to_string(times_ns[i]), kTimeRule);
      if (tracks[i].empty()) fail("track_uuid", "", "must be a name");
      if (categories[i].empty()) fail("category", "", "must be a name");
      Cuboid cuboid{times_ns[i], tracks[i], categories[i], body_from_vehicle() * poses.at(i)};
      for (int k = 0; k < 3; ++k) {
        if (!(sizes[k][i] > 0 && sizes[k][i] <= kMaxSize_m))
          fail(kSizeColumns[k], std::to_string(sizes[k][i]), "above 0, at most 100 m");
        cuboid.size_m[k] = sizes[k][i];
      }
      cuboids.push_back(std::move(cuboid));
    } catch (const InputError& error) {
      impossible->push_back(error.what());
    }
  std::ranges::stable_sort(cuboids, {}, &Cuboid::t_ns);
  return cuboids;
}

std::map<std::int64_t, std::vector<Box>> boxes_of_frames(
    const std::vector<Cuboid>& cuboids, const std::vector<FramePose>& poses,
    const std::vector<FramePose>& frames,
    const std::function<std::int64_t(const Eigen::Vector3d& in_body)>& holds_after) {
  std::map<std::int64_t, std::int64_t> scan_of;  // time by frame
  for (const Cuboid& cuboid : cuboids) {
    const std::int64_t middle_ns = cuboid.t_ns + kRevolution_ns / 2;
    const FramePose& frame = nearest_frame(frames, middle_ns);
    const std::int64_t off_ns = std::abs(frame.t_ns - middle_ns);
    if (off_ns > kRevolution_ns) continue;
    const auto [scan, is_new] = scan_of.try_emplace(frame.id, cuboid.t_ns);
    if (!is_new && off_ns < std::abs(frame.t_ns - scan->second - kRevolution_ns / 2))
      scan->second = cuboid.t_ns;
  }
  std::map<std::int64_t, std::int64_t> frame_of;
  for (const auto& [frame, t_ns] : scan_of) frame_of[t_ns] = frame;

  std::map<std::string, std::int64_t> ids;
  std::vector<Label> labels;
  std::map<std::pair<std::int64_t, std::int64_t>, std::int64_t> times_ns;  // frame, object
  for (const Cuboid& cuboid : cuboids) {
    const auto frame = frame_of.find(cuboid.t_ns);
    if (frame == frame_of.end()) continue;
    Label label;
    label.frame_id = frame->second;
    label.object_id = ids.try_emplace(cuboid.track, std::ssize(ids)).first->second;
    const std::int64_t t_ns = cuboid.t_ns + holds_after(cuboid.body_from_box.translation());
    if (!times_ns.try_emplace({label.frame_id, label.object_id}, t_ns).second) continue;
    // A sign, though one of its words is a person's.
    label.type = cuboid.category.starts_with("MOBILE_PEDESTRIAN") ? "MOBILE_SIGN" : cuboid.category;
    label.size_m = cuboid.size_m;
    label.sensor_from_box = pose_at(frames, t_ns).inverse(Eigen::Isometry) *
                            pose_at(poses, cuboid.t_ns) * cuboid.body_from_box;
    labels.push_back(std::move(label));
  }
  return place_boxes(labels, Rigid3d::Identity(), frames,
                     [&](const Label& label, const FramePose&) {
                       return times_ns.at({label.frame_id, label.object_id});
                     });
}

}  // namespace redrive::argoverse2
