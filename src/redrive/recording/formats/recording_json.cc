// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/recording_json.h"

#include <algorithm>
#include <map>

#include "redrive/base/files/files.h"
#include "redrive/camera/models.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/parse/json_numbers.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr double kMostAway_m = 1e7, kMostSpeed_m_per_s = 1e4;
constexpr std::int64_t kMostReadout_ns = 200'000'000, kMostOffset_ns = 1'000'000'000;

/// Rows of the 3 x 4 matrix.
Json pose_to_json(const Rigid3d& pose) {
  Json numbers = Json::array();
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c) numbers.push_back(pose.matrix()(r, c));
  return numbers;
}

Rigid3d pose_from_json(const JsonField& field) {
  const auto numbers =
      numbers_within<12>(field, -kMostAway_m, kMostAway_m, "expected twelve numbers, at most 1e7");
  Rigid3d pose = Rigid3d::Identity();
  for (int k = 0; k < 12; ++k) pose.matrix()(k / 4, k % 4) = numbers[k];
  if (const std::string why = rigid_obstacle(pose.matrix()); !why.empty()) field.fail(why);
  return pose;
}

std::int64_t integer_within(const JsonField& field, std::int64_t least, std::int64_t most,
                            const char* rule) {
  const std::int64_t value = field.integer();
  if (value < least || value > most) field.fail(rule);
  return value;
}

std::int64_t time_from_json(const JsonField& field) {
  constexpr std::int64_t kMost_ns = 4'000'000'000'000'000'000;
  return integer_within(field, -kMost_ns, kMost_ns, "expected nanoseconds, at most 4e18");
}

Json camera_to_json(const RecordedCamera& camera) {
  const CameraCalibration& c = camera.calibration;
  Json ids = Json::array(), held_out = Json::array();
  for (const ImageFile& image : camera.images)
    (image.held_out ? held_out : ids).push_back(image.frame_id);
  return {{"name", c.name},
          {"model", c.model},
          {"parameters", c.parameters},
          {"width", c.width},
          {"height", c.height},
          {"body_from_sensor", pose_to_json(c.body_from_sensor)},
          {"time_offset_ns", c.time_offset_ns},
          {"readout_ns", c.readout_ns},
          {"readout_by_column", c.readout_by_column},
          {"images", ids},
          {"held_out_images", held_out}};
}

RecordedCamera camera_from_json(const JsonField& json, const fs::path& root) {
  RecordedCamera camera;
  CameraCalibration& c = camera.calibration;
  c.name = json.at("name").string();
  c.model = json.at("model").string();
  const CameraModelInfo* const model = find_camera_model(c.model);
  if (!model) json.at("model").fail("unknown camera model; known are " + camera_model_names());
  image_size_from_json(json.at("width"), json.at("height"), &c);
  const JsonField parameters = json.at("parameters");
  c.parameters = parameters.numbers(4 + model->distortion.size() + model->other.size());
  for (std::size_t k = 0; k < c.parameters.size(); ++k) {
    const JsonField one = parameters.at(k);
    const std::size_t n = k - 4;
    if (k < 2)
      focal_length_from_json(one);
    else if (k < 4)
      principal_point_from_json(one, k == 2 ? c.width : c.height);
    else if (n < model->distortion.size())
      parameter_from_json(one, model->distortion[n]);
    else
      parameter_from_json(one, model->other[n - model->distortion.size()]);
  }
  c.body_from_sensor = pose_from_json(json.at("body_from_sensor"));
  c.time_offset_ns = integer_within(json.at("time_offset_ns"), -kMostOffset_ns, kMostOffset_ns,
                                    "expected nanoseconds, at most 1e9");
  c.readout_ns = integer_within(json.at("readout_ns"), -kMostReadout_ns, kMostReadout_ns,
                                "expected nanoseconds, at most 2e8");
  if (json.has("readout_by_column")) {  // files of before have rows
    const JsonField by_column = json.at("readout_by_column");
    if (!by_column.json().is_boolean()) by_column.fail("expected true or false");
    c.readout_by_column = by_column.json().get<bool>();
  }
  for (const char* const key : {"images", "held_out_images"}) {
    const JsonField ids = json.at(key);
    if (!ids.json().is_array()) ids.fail("expected a list of frames");
    for (std::size_t i = 0; i < ids.size(); ++i) {
      ImageFile image;
      image.frame_id = ids.at(i).integer();
      image.path = root / "images-are-not-here" / c.name / std::to_string(image.frame_id);
      image.held_out = key != std::string_view("images");
      camera.images.push_back(image);
    }
  }
  std::ranges::stable_sort(camera.images, {}, &ImageFile::frame_id);
  return camera;
}

Json box_to_json(const Box& box, std::int64_t frame_id) {
  const Eigen::Vector3d &size = box.size_m, &v = box.velocity_in_body_m_per_s;
  return {{"frame", frame_id},
          {"id", box.object_id},
          {"type", box.type},
          {"t_ns", box.t_ns},
          {"body_from_box", pose_to_json(box.body_from_box)},
          {"size_m", {size.x(), size.y(), size.z()}},
          {"velocity_in_body_m_per_s", {v.x(), v.y(), v.z()}}};
}

Box box_from_json(const JsonField& json) {
  constexpr double kMostSize_m = 1000;
  Box box;
  box.object_id = json.at("id").integer();
  box.type = json.at("type").string();
  box.t_ns = time_from_json(json.at("t_ns"));
  box.body_from_box = pose_from_json(json.at("body_from_box"));
  box.size_m = Eigen::Vector3d(
      numbers_within<3>(json.at("size_m"), 0, kMostSize_m, "expected three metres, 0 to 1000")
          .data());
  box.velocity_in_body_m_per_s =
      Eigen::Vector3d(numbers_within<3>(json.at("velocity_in_body_m_per_s"), -kMostSpeed_m_per_s,
                                        kMostSpeed_m_per_s, "expected three m/s, at most 1e4")
                          .data());
  return box;
}

/// Boxes by frame.
class BoxesReader : public RecordingReader {
 public:
  explicit BoxesReader(std::map<std::int64_t, std::vector<Box>> boxes) : boxes_(std::move(boxes)) {}
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    return boxes_.at(file.frame_id);
  }

 private:
  std::map<std::int64_t, std::vector<Box>> boxes_;
};

void read_frames(const JsonField& frames, Recording* recording) {
  if (!frames.json().is_array()) frames.fail("expected a list");
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const JsonField json = frames.at(i);
    FramePose frame{json.at("id").integer(), time_from_json(json.at("t_ns")),
                    pose_from_json(json.at("global_from_body"))};
    if (i > 0 && frame.t_ns <= recording->frames.back().t_ns)
      json.at("t_ns").fail("expected times that increase");
    if (i > 0 && frame.id <= recording->frames.back().id)
      json.at("id").fail("expected ids that increase");
    recording->frames.push_back(std::move(frame));
  }
}

}  // namespace

std::string recording_to_json(const Recording& recording) {
  Json json = {{"format", recording.format}, {"ecef", recording.global_frame == GlobalFrame::kEcef},
               {"cameras", Json::array()},   {"lidars", Json::array()},
               {"frames", Json::array()},    {"boxes", Json::array()}};
  for (const RecordedCamera& camera : recording.cameras)
    json["cameras"].push_back(camera_to_json(camera));
  for (const RecordedLidar& lidar : recording.lidars) {
    json["lidars"].push_back({{"name", lidar.name},
                              {"body_from_lidar", pose_to_json(lidar.body_from_lidar)},
                              {"elevation_rad", lidar.elevation_rad},
                              {"gain", lidar.gain}});
    for (const BeamGain& beam : lidar.beam_gains)
      json["lidars"].back()["beam_gains"].push_back({beam.elevation_rad, beam.gain});
    if (!lidar.blind.empty()) json["lidars"].back()["blind"] = lidar.blind.runs();
  }
  for (const FramePose& frame : recording.frames)
    json["frames"].push_back({{"id", frame.id},
                              {"t_ns", frame.t_ns},
                              {"global_from_body", pose_to_json(frame.global_from_body)}});
  for (const FrameFile& file : recording.box_files)
    for (const Box& box : recording.reader->read_boxes(file))
      json["boxes"].push_back(box_to_json(box, file.frame_id));
  return json.dump() + "\n";
}

BlindDirections blind_from_json(const JsonField& runs) {
  BlindDirections blind;
  if (!runs.json().is_array()) runs.fail("expected a list");
  for (std::size_t i = 0; i < runs.size(); ++i) {
    const JsonField run = runs.at(i);
    if (run.size() != 2) run.fail("expected a cell and a number of cells");
    const std::int64_t first = run.at(0).integer(), n = run.at(1).integer();
    constexpr auto kCells = static_cast<std::int64_t>(BlindDirections::kCells);
    if (first < 0 || n < 1 || first >= kCells || n > kCells - first)
      run.fail("expected cells of " + std::to_string(kCells));
    for (std::int64_t cell = first; cell < first + n; ++cell)
      blind.insert(static_cast<std::size_t>(cell));
  }
  return blind;
}

Recording read_recording_json(const fs::path& file) {
  return parse_recording_json(read_file(file), file);
}

Recording parse_recording_json(std::string_view text, const fs::path& file) {
  const Json document = parse_json(text, file);
  const JsonField json(document, file);
  Recording recording;
  recording.root = file.parent_path();
  recording.format = json.at("format").string();
  const JsonField ecef = json.at("ecef"), cameras = json.at("cameras"), lidars = json.at("lidars"),
                  boxes = json.at("boxes");
  if (!ecef.json().is_boolean()) ecef.fail("expected true or false");
  recording.global_frame = ecef.json().get<bool>() ? GlobalFrame::kEcef : GlobalFrame::kArbitrary;
  for (const JsonField& list : {cameras, lidars, boxes})
    if (!list.json().is_array()) list.fail("expected a list");
  for (std::size_t i = 0; i < cameras.size(); ++i)
    recording.cameras.push_back(camera_from_json(cameras.at(i), recording.root));
  for (std::size_t i = 0; i < lidars.size(); ++i) {
    const JsonField lidar = lidars.at(i);
    recording.lidars.push_back({lidar.at("name").string(),
                                pose_from_json(lidar.at("body_from_lidar")),
                                lidar.at("elevation_rad").number(), lidar.at("gain").number()});
    if (!(recording.lidars.back().gain > 0)) lidar.at("gain").fail("must be above 0");
    if (lidar.has("blind")) recording.lidars.back().blind = blind_from_json(lidar.at("blind"));
    if (!lidar.has("beam_gains")) continue;
    const JsonField beams = lidar.at("beam_gains");
    for (std::size_t b = 0; b < beams.size(); ++b) {
      const std::vector<double> beam = beams.at(b).numbers(2);
      if (!(beam[1] > 0)) beams.at(b).fail("an elevation and a gain above 0 were expected");
      recording.lidars.back().beam_gains.push_back({float(beam[0]), float(beam[1])});
    }
  }
  read_frames(json.at("frames"), &recording);
  std::map<std::int64_t, std::vector<Box>> of_frame;
  for (std::size_t i = 0; i < boxes.size(); ++i)
    of_frame[boxes.at(i).at("frame").integer()].push_back(box_from_json(boxes.at(i)));
  for (const auto& [frame_id, list] : of_frame) recording.box_files.push_back({frame_id, file});
  recording.reader = std::make_shared<BoxesReader>(std::move(of_frame));
  return recording;
}

}  // namespace redrive
