// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/waymo/waymo_frame.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/files/gzip.h"
#include "redrive/camera/models.h"

namespace redrive::waymo {
namespace {

constexpr double kMaxSize_m = 100, kMaxFocal_px = 1e6;
constexpr int kMaxSide_px = 65536;
constexpr const char* kCameras[] = {"UNKNOWN",     "FRONT",     "FRONT_LEFT",
                                    "FRONT_RIGHT", "SIDE_LEFT", "SIDE_RIGHT"};
constexpr const char* kLasers[] = {"UNKNOWN", "TOP", "FRONT", "SIDE_LEFT", "SIDE_RIGHT", "REAR"};
constexpr const char* kTypes[] = {"UNKNOWN", "VEHICLE", "PEDESTRIAN", "SIGN", "CYCLIST"};

/// Calls use(field) for each field of a message.
template <class Use>
void each_field(ProtoReader message, const Use& use) {
  while (const auto field = message.next()) use(*field, message);
}

Rigid3d parse_transform(const ProtoReader& of, const ProtoField& field, const char* name) {
  std::vector<double> values;
  each_field(of.message(field, name), [&](const ProtoField& part, const ProtoReader& message) {
    if (part.number == 1) message.append(part, name, &values);
  });
  if (values.size() != 16) of.fail(name, std::to_string(values.size()) + " numbers", "must be 4x4");
  const Eigen::Matrix4d matrix =
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(values.data());
  const std::string obstacle =
      matrix.allFinite() ? rigid_obstacle(matrix) : std::string("not finite");
  if (!obstacle.empty()) of.fail(name, "", "is no rigid transform: " + obstacle);
  if (!(matrix.topRightCorner<3, 1>().norm() <= kMaxCoordinate_m))
    of.fail(name, "", "is more than 1e7 m away");
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = Eigen::Quaterniond(Eigen::Matrix3d(matrix.topLeftCorner<3, 3>()))
                      .normalized()
                      .toRotationMatrix();
  pose.translation() = matrix.topRightCorner<3, 1>();
  return pose;
}

int number_of(const ProtoReader& message, const ProtoField& field, const char* name,
              std::size_t count) {
  const std::int64_t value = message.integer(field, name);
  if (value < 1 || value >= static_cast<std::int64_t>(count))
    message.fail(name, std::to_string(value), "must be 1 to " + std::to_string(count - 1));
  return static_cast<int>(value);
}

/// f_u, f_v, c_u, c_v, k1, k2, p1, p2, k3; pixels count from the corner of the first one.
void set_intrinsics(const ProtoReader& message, const std::vector<double>& values,
                    CameraCalibration* camera) {
  const char* const name = "intrinsic";
  if (values.size() != 9)
    message.fail(name, std::to_string(values.size()) + " numbers", "must be 9");
  const auto within = [&](double value, double least, double most) {
    if (!(value >= least && value <= most))
      message.fail(name, std::to_string(value), "is out of range");
  };
  for (const int k : {0, 1}) within(values[k], 1e-3, kMaxFocal_px);
  for (const int k : {2, 3}) within(values[k], -kMaxSide_px, 2 * kMaxSide_px);
  camera->model = "opencv_pinhole";
  camera->parameters = {values[0], values[1], values[2] - 0.5, values[3] - 0.5};
  const auto distortion = find_camera_model(camera->model)->distortion;
  for (std::size_t k = 0; k < distortion.size(); ++k) {
    within(values[4 + k], distortion[k].min, distortion[k].max);
    camera->parameters.push_back(values[4 + k]);
  }
}

void parse_camera(const ProtoReader& message, Context* context) {
  CameraContext camera;
  int number = 0;
  std::vector<double> intrinsic;
  each_field(message, [&](const ProtoField& field, const ProtoReader& of) {
    CameraCalibration& calibration = camera.calibration;
    const auto side = [&](const char* name) {
      const std::int64_t size = of.integer(field, name);
      if (size < 1 || size > kMaxSide_px)
        of.fail(name, std::to_string(size), "must be 1 to 65536 pixels");
      return static_cast<int>(size);
    };
    switch (field.number) {
      case 1: number = number_of(of, field, "camera name", std::size(kCameras)); break;
      case 2: of.append(field, "intrinsic", &intrinsic); break;
      case 3: calibration.body_from_sensor = parse_transform(of, field, "camera extrinsic"); break;
      case 4: calibration.width = side("width"); break;
      case 5: calibration.height = side("height"); break;
      case 6: {
        const std::int64_t way = of.integer(field, "rolling_shutter_direction");
        // 1 down, 2 to the right, 3 up, 4 to the left, 5 global
        camera.direction = way == 1 || way == 2 ? 1 : way == 3 || way == 4 ? -1 : 0;
        calibration.readout_by_column = way == 2 || way == 4;
        break;
      }
      default: break;
    }
  });
  if (camera.calibration.width == 0 || camera.calibration.height == 0)
    message.fail("width, height", "", "are missing in the calibration of " + camera_name(number));
  set_intrinsics(message, intrinsic, &camera.calibration);
  camera.calibration.name = camera_name(number);
  Eigen::Matrix3d axes;  // Waymo's cameras look along x, with z up
  axes << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  camera.calibration.body_from_sensor.linear() *= axes;
  context->cameras[number] = camera;
}

void parse_laser(const ProtoReader& message, Context* context) {
  LaserContext laser;
  int number = 0;
  each_field(message, [&](const ProtoField& field, const ProtoReader& of) {
    switch (field.number) {
      case 1: number = number_of(of, field, "laser name", std::size(kLasers)); break;
      case 2: of.append(field, "beam_inclinations", &laser.inclinations_rad); break;
      case 3: laser.least_rad = of.number(field, "beam_inclination_min"); break;
      case 4: laser.most_rad = of.number(field, "beam_inclination_max"); break;
      case 5: laser.body_from_laser = parse_transform(of, field, "laser extrinsic"); break;
      default: break;
    }
  });
  for (const double angle : laser.inclinations_rad)
    if (!(std::abs(angle) <= M_PI / 2))
      message.fail("beam_inclinations", std::to_string(angle), "must be at most 90 degrees");
  if (!(std::abs(laser.least_rad) <= M_PI / 2 && std::abs(laser.most_rad) <= M_PI / 2))
    message.fail("beam_inclination_min, beam_inclination_max", "", "must be at most 90 degrees");
  context->lasers[number] = laser;
}

std::int64_t seconds_ns(const ProtoReader& message, const ProtoField& field, const char* name) {
  const double seconds = message.number(field, name);
  constexpr double kMost_s = 9e9;
  if (!(seconds >= 0 && seconds <= kMost_s))
    message.fail(name, std::to_string(seconds), "must be seconds since 1970");
  return std::llround(1e9 * seconds);
}

Image parse_image(const ProtoReader& message) {
  Image image;
  bool has_pose = false;
  each_field(message, [&](const ProtoField& field, const ProtoReader& of) {
    switch (field.number) {
      case 1: image.camera = number_of(of, field, "image name", std::size(kCameras)); break;
      case 2: image.jpeg = field.span; break;
      case 3:
        image.world_from_body = parse_transform(of, field, "image pose");
        has_pose = true;
        break;
      case 5: image.pose_ns = seconds_ns(of, field, "pose_timestamp"); break;
      case 6: image.shutter_s = of.number(field, "shutter"); break;
      case 7: image.trigger_s = 1e-9 * double(seconds_ns(of, field, "camera_trigger_time")); break;
      case 8:
        image.done_s = 1e-9 * double(seconds_ns(of, field, "camera_readout_done_time"));
        break;
      default: break;
    }
  });
  const std::string name = "image of " + camera_name(image.camera);
  if (image.jpeg.size() == 0) message.fail(name, "", "has no image");
  if (!has_pose || image.pose_ns == 0) message.fail(name, "", "has no pose with a time");
  if (!(image.shutter_s >= 0 && image.shutter_s <= 1 && image.done_s >= image.trigger_s &&
        image.done_s - image.trigger_s <= 1))
    message.fail(name, "", "shutter, camera_trigger_time or camera_readout_done_time cannot be");
  return image;
}

void parse_range_image(const ProtoReader& message, RangeImage* image) {
  each_field(message, [&](const ProtoField& field, const ProtoReader&) {
    if (field.number == 2) image->first = field.span;
    if (field.number == 4) image->poses = field.span;
  });
}

RangeImage parse_laser_scan(const ProtoReader& message) {
  RangeImage image;
  each_field(message, [&](const ProtoField& field, const ProtoReader& of) {
    if (field.number == 1) image.laser = number_of(of, field, "laser name", std::size(kLasers));
    if (field.number == 2) parse_range_image(of.message(field, "ri_return1"), &image);
    image.has_second |= field.number == 3;
  });
  return image;
}

LabelledBox parse_label(const ProtoReader& message) {
  LabelledBox label;
  double box[8] = {};  // key: field number
  std::int64_t type = 0;
  each_field(message, [&](const ProtoField& field, const ProtoReader& of) {
    if (field.number == 1)
      each_field(of.message(field, "box"), [&](const ProtoField& part, const ProtoReader& in) {
        if (part.number >= 1 && part.number <= 7) box[part.number] = in.number(part, "box");
      });
    if (field.number == 3) type = of.integer(field, "type");
    if (field.number == 4) label.id = of.text(field, "id", 1000);
  });
  if (label.id.empty()) message.fail("laser_labels.id", "", "is missing");
  label.type = kTypes[type >= 0 && type < std::ssize(kTypes) ? type : 0];
  label.size_m = {box[5], box[4], box[6]};
  const Eigen::Vector3d centre(box[1], box[2], box[3]);
  if (!(label.size_m.minCoeff() > 0 && label.size_m.maxCoeff() <= kMaxSize_m) ||
      !(centre.norm() <= kMaxCoordinate_m) || !std::isfinite(box[7]))
    message.fail("box of " + label.id, "", "cannot be: its place, its size or its heading");
  label.body_from_box =
      Eigen::Translation3d(centre) * Eigen::AngleAxisd(box[7], Eigen::Vector3d::UnitZ());
  return label;
}

}  // namespace

std::string camera_name(int camera) { return kCameras[camera]; }
std::string laser_name(int laser) { return kLasers[laser]; }

Context parse_context(const ByteSource& bytes, ByteSpan frame, const std::filesystem::path& file,
                      std::vector<Finding>* findings) {
  Context context;
  const auto part = [&](const std::string& what, const auto& parse) {
    try {
      parse();
    } catch (const InputError& error) {
      findings->push_back({what, std::string("left out: ") + error.what()});
    }
  };
  each_field(ProtoReader(bytes, frame, file), [&](const ProtoField& field, const ProtoReader& of) {
    if (field.number != 1) return;
    each_field(of.message(field, "context"), [&](const ProtoField& one, const ProtoReader& in) {
      if (one.number == 1) context.name = in.text(one, "context.name");
      if (one.number == 2)
        part("camera_calibrations",
             [&] { parse_camera(in.message(one, "camera_calibrations"), &context); });
      if (one.number == 3)
        part("laser_calibrations",
             [&] { parse_laser(in.message(one, "laser_calibrations"), &context); });
    });
  });
  return context;
}

Frame parse_frame(const ByteSource& bytes, ByteSpan span, std::int64_t record,
                  const std::filesystem::path& file, std::vector<std::string>* impossible,
                  std::vector<DamagedRecord>* damaged) {
  Frame frame;
  bool has_pose = false;
  const auto part = [&](const char* sensor, const auto& parse) {
    try {
      parse();
    } catch (const InputError& error) {
      damaged->push_back({sensor, record, error.what()});
    }
  };
  each_field(ProtoReader(bytes, span, file), [&](const ProtoField& field, const ProtoReader& of) {
    switch (field.number) {
      case 1:
        each_field(of.message(field, "context"), [&](const ProtoField& one, const ProtoReader& in) {
          if (one.number == 1) frame.context_name = in.text(one, "context.name");
        });
        break;
      case 2: {
        const std::int64_t us = of.integer(field, "timestamp_micros");
        constexpr std::int64_t kMost_us = 9'000'000'000'000'000;
        if (us < 0 || us > kMost_us)
          of.fail("timestamp_micros", std::to_string(us), "must be microseconds since 1970");
        frame.t_ns = 1000 * us;
        break;
      }
      case 3:
        frame.world_from_body = parse_transform(of, field, "pose");
        has_pose = true;
        break;
      case 4:
        part("images", [&] { frame.images.push_back(parse_image(of.message(field, "images"))); });
        break;
      case 5:
        part("lidar",
             [&] { frame.range_images.push_back(parse_laser_scan(of.message(field, "lasers"))); });
        break;
      case 6: try { frame.boxes.push_back(parse_label(of.message(field, "laser_labels")));
        } catch (const InputError& error) {
          impossible->push_back(error.what());
        }
        break;
      case 7: ++frame.no_label_zones; break;
      default: break;
    }
  });
  if (!has_pose || frame.t_ns == 0) throw InputError(file, "pose", "", "is missing, or its time");
  return frame;
}

Matrix parse_matrix(const ByteSource& bytes, ByteSpan packed, const std::filesystem::path& file,
                    const std::string& name) {
  constexpr std::size_t kMostBytes = std::size_t{1} << 27;
  const auto fail = [&](const std::string& rule) { throw InputError(file, name, "", rule); };
  const std::string in = packed.size() <= kMostBytes ? bytes.read(packed.begin, packed.size()) : "";
  const auto message = gunzip_at_most(kMostBytes, in);
  if (!message) fail("is damaged");
  const StringBytes source(*message);
  Matrix matrix;
  each_field(ProtoReader(source, {0, source.size()}, file), [&](const ProtoField& field,
                                                                const ProtoReader& of) {
    if (field.number == 1) of.append(field, name.c_str(), &matrix.values);
    if (field.number != 2) return;
    each_field(of.message(field, "shape"), [&](const ProtoField& dim, const ProtoReader& shape) {
      if (dim.number == 1) shape.append(dim, name.c_str(), &matrix.dims);
    });
  });
  std::int64_t all = 1;
  constexpr std::int64_t kMostDim = 1 << 20;
  for (const std::int64_t dim : matrix.dims) {
    if (dim < 1 || dim > kMostDim || all > kMostDim * kMostDim / dim)
      fail("has an impossible shape");
    all *= dim;
  }
  if (matrix.dims.empty() || all != std::ssize(matrix.values))
    fail("has " + std::to_string(matrix.values.size()) + " values, its shape another number");
  return matrix;
}

}  // namespace redrive::waymo
