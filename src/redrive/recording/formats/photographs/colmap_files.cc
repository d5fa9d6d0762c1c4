// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/colmap_files.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include <Eigen/Geometry>

#include "redrive/base/error.h"
#include "redrive/recording/formats/photographs/colmap_rigs.h"
#include "redrive/recording/formats/photographs/photographs.h"
#include "redrive/recording/parse/little_endian.h"
#include "redrive/recording/parse/rigid_json.h"
#include "redrive/recording/parse/text_lines.h"

namespace redrive::colmap {
namespace {

namespace fs = std::filesystem;

constexpr double kAny = std::numeric_limits<double>::max();
constexpr std::int64_t kMaxId = std::numeric_limits<std::uint32_t>::max();

std::string record_name(std::string_view kind, std::int64_t id) {
  return std::string(kind) + " " + std::to_string(id);
}

/// Throws if an id was there before.
class Ids {
 public:
  Ids(std::string_view kind, const fs::path& file) : kind_(kind), file_(file) {}
  void add(std::int64_t id) {
    if (!ids_.insert(id).second)
      throw InputError(file_, std::string(kind_) + " id", std::to_string(id), "is there twice");
  }

 private:
  std::string_view kind_;
  const fs::path& file_;
  std::set<std::int64_t> ids_;
};

Eigen::Quaterniond quaternion_of(const std::array<double, 7>& numbers) {
  return {numbers[0], numbers[1], numbers[2], numbers[3]};
}

/// Returns the pose of seven checked numbers, with the quaternion normalised.
Rigid3d pose_from(const std::array<double, 7>& numbers, const std::string& record,
                  const fs::path& file) {
  const Eigen::Quaterniond q = quaternion_of(numbers);
  if (!is_rotation(q))
    throw InputError(file, record + " quaternion", "length " + std::to_string(q.norm()),
                     "must be a rotation, of a length between 1e-6 and 1e6");
  Rigid3d pose(q.normalized().toRotationMatrix());
  pose.translation() = Eigen::Vector3d(numbers[4], numbers[5], numbers[6]);
  if (!(pose.translation().norm() <= photographs::kMaxDistance))
    throw InputError(file, record + " translation", std::to_string(pose.translation().norm()),
                     "must be a position within 1e7 of the origin");
  return pose;
}

/// `read_numbers`: the seven of the pose.
template <class Read>
void set_pose(const Read& read_numbers, const std::string& record, const fs::path& file,
              ImageRecord* image) {
  try {
    const std::array<double, 7> numbers = read_numbers();
    image->camera_from_world = pose_from(numbers, record, file);
    image->quaternion_length = quaternion_of(numbers).norm();
  } catch (const InputError& error) {
    image->damage = error.what();
  }
}

std::string checked_name(std::string_view name, const std::string& record, const fs::path& file) {
  std::string text(name);
  std::replace(text.begin(), text.end(), '\\', '/');
  const fs::path path = fs::path(text).lexically_normal().relative_path();
  if (name.empty() || path == "." || *path.begin() == ".." || !path.has_filename())
    throw InputError(file, record + " name", text.substr(0, 80),
                     "must be the name of a file in the folder of the images");
  return path.string();
}

/// Keeps each image of a track once, in the order of the file.
class Track {
 public:
  explicit Track(std::vector<std::int64_t>* images) : images_(images) {}
  void add(std::int64_t image) {
    if (known_.insert(image).second) images_->push_back(image);
  }

 private:
  std::vector<std::int64_t>* images_;
  std::set<std::int64_t> known_;
};

[[noreturn]] void refuse_model(const fs::path& file, const std::string& field,
                               const std::string& value) {
  throw InputError(file, field, value,
                   "is no camera model that redrive has; known are " + camera_model_names());
}

/// Calls `use` with each line that is neither empty nor a comment, and with a function that returns
/// the next line unchanged.
template <class Use>
void for_each_record(std::string_view text, const fs::path& file, const Use& use) {
  std::size_t begin = 0, number = 0;
  const auto next = [&] {  // empty behind the end
    begin = std::min(begin, text.size());
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    const TextLine line(text.substr(begin, end - begin), file, ++number);
    begin = end + 1;
    return line;
  };
  while (begin < text.size()) {
    const TextLine line = next();
    if (line.size() > 0 && !line.word(0).starts_with('#')) use(line, next);
  }
}

/// Takes numbers from the front of a file's bytes.
class ByteReader {
 public:
  ByteReader(std::string_view bytes, const fs::path& file) : bytes_(bytes), file_(file) {}

  template <class T>
  T take(const std::string& field) {
    need(sizeof(T), field);
    const T value = little_endian<T>(bytes_, at_);
    at_ += sizeof(T);
    return value;
  }
  double take_number(const std::string& field) {
    const double value = take<double>(field);
    if (!std::isfinite(value))
      throw InputError(file_, field, std::to_string(value), "must be a finite number");
    return value;
  }
  /// Returns a number of records of at least `least_bytes` each, which must fit into the rest of
  /// the file.
  std::uint64_t take_count(const std::string& field, std::size_t least_bytes) {
    const auto count = take<std::uint64_t>(field);
    if (count > (bytes_.size() - at_) / least_bytes)
      throw InputError(file_, field, std::to_string(count),
                       "of at least " + std::to_string(least_bytes) +
                           " bytes each do not fit in the " + std::to_string(bytes_.size() - at_) +
                           " that follow (truncated?)");
    return count;
  }
  std::string_view take_text(const std::string& field) {
    const std::size_t end = bytes_.find('\0', at_);
    if (end == std::string_view::npos) need(bytes_.size() - at_ + 1, field);
    const std::string_view text = bytes_.substr(at_, end - at_);
    at_ = end + 1;
    return text;
  }
  void skip(std::uint64_t bytes) { at_ += bytes; }
  /// Skips bytes, which must exist.
  void take_bytes(std::size_t bytes, const std::string& field) {
    need(bytes, field);
    at_ += bytes;
  }
  void expect_end() const {
    if (at_ != bytes_.size())
      throw InputError(file_, "", std::to_string(bytes_.size() - at_),
                       "bytes follow the last record");
  }

 private:
  void need(std::size_t bytes, const std::string& field) const {
    if (bytes > bytes_.size() - at_) throw InputError(file_, field, "", "ends here (truncated?)");
  }

  std::string_view bytes_;
  const fs::path& file_;
  std::size_t at_ = 0;
};

// Types of sensors in rigs and frames.
constexpr std::string_view kCameraWord = "CAMERA";
constexpr std::int32_t kCameraType = 0;

/// The seven numbers of a pose from word `first` on.
std::array<double, 7> numbers_from(const TextLine& line, std::size_t first,
                                   const std::string& record) {
  if (line.size() < first + 7) line.expect_size(first + 7, "seven numbers of a pose");
  constexpr const char* kNames[] = {"QW", "QX", "QY", "QZ", "TX", "TY", "TZ"};
  std::array<double, 7> numbers;
  for (std::size_t i = 0; i < 7; ++i)
    numbers[i] = line.number(first + i, record + " " + kNames[i], -kAny, kAny);
  return numbers;
}
std::array<double, 7> numbers_from(ByteReader* in, const std::string& record) {
  std::array<double, 7> numbers;
  for (double& number : numbers) number = in->take_number(record + " pose");
  return numbers;
}

}  // namespace

std::vector<CameraRecord> parse_cameras_text(std::string_view text, const fs::path& file) {
  std::vector<CameraRecord> cameras;
  Ids ids("camera", file);
  for_each_record(text, file, [&](const TextLine& line, const auto&) {
    if (line.size() < 4) line.expect_size(4, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS...");
    CameraRecord camera;
    camera.id = line.integer(0, "CAMERA_ID", 0, kMaxId);
    ids.add(camera.id);
    const std::string record = record_name("camera", camera.id);
    const CameraModel* model = find_camera_model(line.word(1));
    if (!model) refuse_model(file, record + " MODEL", std::string(line.word(1).substr(0, 80)));
    camera.model_id = model->id;
    camera.width = line.integer(2, "WIDTH", 1, kMaxId);
    camera.height = line.integer(3, "HEIGHT", 1, kMaxId);
    line.expect_size(
        4 + model->parameters.size(),
        "CAMERA_ID MODEL WIDTH HEIGHT and the parameters of " + std::string(model->name));
    for (std::size_t i = 0; i < model->parameters.size(); ++i)
      camera.params.push_back(line.number(4 + i, model->parameters[i], -kAny, kAny));
    cameras.push_back(std::move(camera));
  });
  return cameras;
}

std::vector<CameraRecord> parse_cameras_binary(std::string_view bytes, const fs::path& file) {
  ByteReader in(bytes, file);
  std::vector<CameraRecord> cameras(in.take_count("number of cameras", 48));
  Ids ids("camera", file);
  for (CameraRecord& camera : cameras) {
    camera.id = in.take<std::uint32_t>("camera id");
    ids.add(camera.id);
    const std::string record = record_name("camera", camera.id);
    camera.model_id = in.take<std::int32_t>(record + " model");
    const CameraModel* model = find_camera_model(camera.model_id);
    if (!model) refuse_model(file, record + " model", std::to_string(camera.model_id));
    // Values beyond int64 become negative, which to_calibration refuses.
    camera.width = static_cast<std::int64_t>(in.take<std::uint64_t>(record + " width"));
    camera.height = static_cast<std::int64_t>(in.take<std::uint64_t>(record + " height"));
    for (const std::string_view name : model->parameters)
      camera.params.push_back(in.take_number(record + " " + std::string(name)));
  }
  in.expect_end();
  return cameras;
}

std::vector<ImageRecord> parse_images_text(std::string_view text, const fs::path& file) {
  std::vector<ImageRecord> images;
  Ids ids("image", file);
  for_each_record(text, file, [&](const TextLine& line, const auto& next) {
    if (line.size() < 10) line.expect_size(10, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME");
    ImageRecord image;
    image.id = line.integer(0, "IMAGE_ID", 0, kMaxId);
    ids.add(image.id);
    const std::string record = record_name("image", image.id);
    set_pose([&] { return numbers_from(line, 1, record); }, record, file, &image);
    image.camera_id = line.integer(8, record + " CAMERA_ID", 0, kMaxId);
    image.name = checked_name(line.rest(9), record, file);
    const TextLine features = next();
    if (features.size() % 3 != 0)
      throw InputError(file, features.name(), std::to_string(features.size()) + " values",
                       "are not X, Y, POINT3D_ID for each feature of " + record);
    images.push_back(std::move(image));
  });
  return images;
}

std::vector<ImageRecord> parse_images_binary(std::string_view bytes, const fs::path& file) {
  ByteReader in(bytes, file);
  std::vector<ImageRecord> images(in.take_count("number of images", 73));
  Ids ids("image", file);
  for (ImageRecord& image : images) {
    image.id = in.take<std::uint32_t>("image id");
    ids.add(image.id);
    const std::string record = record_name("image", image.id);
    ByteReader pose = in;
    in.take_bytes(7 * sizeof(double), record + " pose");
    set_pose([&] { return numbers_from(&pose, record); }, record, file, &image);
    image.camera_id = in.take<std::uint32_t>(record + " camera id");
    image.name = checked_name(in.take_text(record + " name"), record, file);
    constexpr std::size_t kFeatureBytes = 24;
    in.skip(kFeatureBytes * in.take_count(record + " number of features", kFeatureBytes));
  }
  in.expect_end();
  return images;
}

std::vector<PointRecord> parse_points_text(std::string_view text, const fs::path& file) {
  std::vector<PointRecord> points;
  for_each_record(text, file, [&](const TextLine& line, const auto&) {
    if (line.size() < 8 || line.size() % 2 != 0)
      line.expect_size(std::max<std::size_t>(8, line.size() / 2 * 2),
                       "POINT3D_ID X Y Z R G B ERROR and pairs of IMAGE_ID POINT2D_IDX");
    PointRecord point;
    for (int k = 0; k < 3; ++k) {
      point.in_world[k] = line.any_number(1 + k, std::string_view(&"XYZ"[k], 1));
      point.rgb[k] =
          static_cast<std::uint8_t>(line.integer(4 + k, std::string_view(&"RGB"[k], 1), 0, 255));
    }
    Track track(&point.images);
    for (std::size_t i = 8; i < line.size(); i += 2)
      track.add(line.integer(i, "IMAGE_ID", 0, kMaxId));
    points.push_back(std::move(point));
  });
  return points;
}

std::vector<PointRecord> parse_points_binary(std::string_view bytes, const fs::path& file) {
  ByteReader in(bytes, file);
  std::vector<PointRecord> points(in.take_count("number of points", 51));
  for (PointRecord& point : points) {
    const auto id = in.take<std::uint64_t>("point id");
    const std::string record = "point " + std::to_string(id);
    for (int k = 0; k < 3; ++k) point.in_world[k] = in.take<double>(record + " " + "XYZ"[k]);
    for (std::uint8_t& value : point.rgb) value = in.take<std::uint8_t>(record + " colour");
    in.take<double>(record + " error");
    Track track(&point.images);
    for (std::uint64_t left = in.take_count(record + " length of its track", 8); left > 0; --left) {
      track.add(in.take<std::uint32_t>(record + " track"));
      in.skip(sizeof(std::uint32_t));
    }
  }
  in.expect_end();
  return points;
}

std::vector<RigRecord> parse_rigs_text(std::string_view text, const fs::path& file) {
  std::vector<RigRecord> rigs;
  Ids ids("rig", file);
  for_each_record(text, file, [&](const TextLine& line, const auto&) {
    RigRecord rig;
    rig.id = line.integer(0, "RIG_ID", 0, kMaxId);
    ids.add(rig.id);
    const std::string record = record_name("rig", rig.id);
    const std::int64_t sensors = line.integer(1, record + " NUM_SENSORS", 0, kMaxId);
    std::size_t at = 2;
    for (std::int64_t i = 0; i < sensors; ++i) {
      const bool is_reference = i == 0;
      const std::size_t type = at, camera = at + 1;
      if (line.size() < at + (is_reference ? 2 : 3))
        line.expect_size(at + (is_reference ? 2 : 3), "as many sensors as NUM_SENSORS");
      at += is_reference ? 2 : 3;
      std::optional<Rigid3d> pose;
      if (is_reference) {
        pose = Rigid3d::Identity();
      } else if (line.integer(at - 1, record + " HAS_POSE", 0, 1) == 1) {
        pose = pose_from(numbers_from(line, at, record), record, file);
        at += 7;
      }
      if (line.word(type) == kCameraWord)
        rig.camera_from_rig[line.integer(camera, record + " SENSOR_ID", 0, kMaxId)] = pose;
    }
    line.expect_size(at, "as many sensors as NUM_SENSORS");
    rigs.push_back(std::move(rig));
  });
  return rigs;
}

std::vector<RigRecord> parse_rigs_binary(std::string_view bytes, const fs::path& file) {
  ByteReader in(bytes, file);
  std::vector<RigRecord> rigs(in.take_count("number of rigs", 8));
  Ids ids("rig", file);
  for (RigRecord& rig : rigs) {
    rig.id = in.take<std::uint32_t>("rig id");
    ids.add(rig.id);
    const std::string record = record_name("rig", rig.id);
    const auto sensors = in.take<std::uint32_t>(record + " number of sensors");
    for (std::uint32_t i = 0; i < sensors; ++i) {
      const auto type = in.take<std::int32_t>(record + " type of sensor");
      const auto camera = in.take<std::uint32_t>(record + " sensor");
      std::optional<Rigid3d> pose;
      if (i == 0)
        pose = Rigid3d::Identity();
      else if (in.take<std::uint8_t>(record + " has pose") != 0)
        pose = pose_from(numbers_from(&in, record), record, file);
      if (type == kCameraType) rig.camera_from_rig[camera] = pose;
    }
  }
  in.expect_end();
  return rigs;
}

std::vector<FrameRecord> parse_frames_text(std::string_view text, const fs::path& file) {
  std::vector<FrameRecord> frames;
  Ids ids("frame", file);
  for_each_record(text, file, [&](const TextLine& line, const auto&) {
    if (line.size() < 10)
      line.expect_size(10, "FRAME_ID RIG_ID, the pose's seven numbers, NUM_DATA_IDS and data");
    FrameRecord frame;
    frame.id = line.integer(0, "FRAME_ID", 0, kMaxId);
    ids.add(frame.id);
    const std::string record = record_name("frame", frame.id);
    frame.rig_id = line.integer(1, record + " RIG_ID", 0, kMaxId);
    frame.rig_from_world = pose_from(numbers_from(line, 2, record), record, file);
    const std::int64_t data = line.integer(9, record + " NUM_DATA_IDS", 0, kMaxId);
    line.expect_size(10 + 3 * static_cast<std::size_t>(data),
                     "SENSOR_TYPE, SENSOR_ID, DATA_ID as often as NUM_DATA_IDS");
    for (std::size_t i = 10; i < line.size(); i += 3)
      if (line.word(i) == kCameraWord)
        frame.camera_of_image[line.integer(i + 2, record + " DATA_ID", 0, kMaxId)] =
            line.integer(i + 1, record + " SENSOR_ID", 0, kMaxId);
    frames.push_back(std::move(frame));
  });
  return frames;
}

std::vector<FrameRecord> parse_frames_binary(std::string_view bytes, const fs::path& file) {
  ByteReader in(bytes, file);
  std::vector<FrameRecord> frames(in.take_count("number of frames", 68));
  Ids ids("frame", file);
  for (FrameRecord& frame : frames) {
    frame.id = in.take<std::uint32_t>("frame id");
    ids.add(frame.id);
    const std::string record = record_name("frame", frame.id);
    frame.rig_id = in.take<std::uint32_t>(record + " rig");
    frame.rig_from_world = pose_from(numbers_from(&in, record), record, file);
    const auto data = in.take<std::uint32_t>(record + " number of data");
    for (std::uint32_t i = 0; i < data; ++i) {
      const auto type = in.take<std::int32_t>(record + " type of sensor");
      const auto camera = in.take<std::uint32_t>(record + " sensor");
      const auto image = in.take<std::uint64_t>(record + " data");
      if (type == kCameraType) frame.camera_of_image[static_cast<std::int64_t>(image)] = camera;
    }
  }
  in.expect_end();
  return frames;
}

}  // namespace redrive::colmap
