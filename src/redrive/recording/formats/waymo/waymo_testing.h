// SPDX-License-Identifier: Apache-2.0
// For tests: a small valid segment of the Waymo Open Dataset with made numbers, written by Debian's
// protobuf. Tests break parts of it.
#pragma once

#include <cmath>
#include <fstream>
#include <string>
#include <vector>

#include <zlib.h>

#include "redrive/image/jpeg.h"
#include "redrive/math/rigid3.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "waymo_testing.pb.h"

namespace redrive::testing {

/// Six frames at 10 Hz of two cameras, the laser on the roof and one at the front. The car drives
/// along a line at 8 m/s while it turns evenly, which linear interpolation has exactly.
class MadeSegment {
 public:
  static constexpr int kFrames = 6, kRows = 4, kColumns = 40, kWidth = 64, kHeight = 48;
  static constexpr std::int64_t kFirst_us = 1'500'000'000'000'000, kStep_us = 100'000;
  static constexpr double kShutter_s = 0.005, kReadout_s = 0.03, kFront_s = 0.05, kLeft_s = 0.03;
  static constexpr double kInclinations_rad[kRows] = {-0.3, -0.2, -0.05, 0.04};

  static Rigid3d world_from_body(double s) {
    return Eigen::Translation3d(1000 + 8 * s, -500, 20) *
           Eigen::AngleAxisd(0.5 + 0.2 * s, Eigen::Vector3d::UnitZ());
  }
  static double frame_s(int frame) { return 1e-6 * double(kStep_us) * frame; }
  static Rigid3d body_from_top() {
    return Eigen::Translation3d(1.25, 0, 2) * Eigen::AngleAxisd(2.5, Eigen::Vector3d::UnitZ());
  }
  static Rigid3d body_from_front_laser() { return Rigid3d(Eigen::Translation3d(4, 0, 0.75)); }
  static Rigid3d body_from_camera(double y) { return Rigid3d(Eigen::Translation3d(1.5, y, 2)); }
  /// A column looks backwards first and then turns clockwise.
  static double azimuth_in_body_rad(int column, int columns) {
    return M_PI * (1 - 2 * (column + 0.5) / columns);
  }
  static double column_s(int frame, int column) {
    return frame_s(frame) + 0.1 * (column + 0.5) / kColumns;
  }
  static float range_m(int row, int column) { return 5 + 0.25f * float(column) + float(row); }
  static bool is_lost(int row, int column) { return (row + column) % 7 == 0; }
  /// A point as the laser on the roof sees it, in the body's axes at its own time.
  static Eigen::Vector3d in_body(int row, int column) {
    const double azimuth = azimuth_in_body_rad(column, kColumns) - 2.5;
    return body_from_top() *
           (range_m(row, column) * beam_direction(kInclinations_rad[kRows - 1 - row], azimuth));
  }

  MadeSegment() {
    for (int f = 0; f < kFrames; ++f) frames.push_back(frame(f));
  }

  std::string bytes() const {
    std::string file;
    for (const waymo_testing::Frame& one : frames) append_record(one.SerializeAsString(), &file);
    return file;
  }
  void write(const std::filesystem::path& path) const {
    std::ofstream(path, std::ios::binary) << bytes();
  }
  /// Bit by bit, after the polynomial of Castagnoli.
  static std::uint32_t masked_crc(const std::string& bytes) {
    std::uint32_t crc = ~0u;
    for (const unsigned char byte : bytes) {
      crc ^= byte;
      for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ (crc & 1 ? 0x82f63b78u : 0);
    }
    crc = ~crc;
    return (crc >> 15 | crc << 17) + 0xa282ead8u;
  }
  static void append_record(const std::string& record, std::string* file) {
    const auto append = [&](auto value) {
      file->append(reinterpret_cast<const char*>(&value), sizeof value);
    };
    const std::uint64_t size = record.size();
    append(size);
    append(masked_crc({reinterpret_cast<const char*>(&size), sizeof size}));
    file->append(record);
    append(masked_crc(record));
  }
  static std::string packed_matrix(const std::vector<float>& values,
                                   std::initializer_list<int> dims) {
    waymo_testing::MatrixFloat matrix;
    matrix.mutable_data()->Add(values.begin(), values.end());
    for (const int dim : dims) matrix.mutable_shape()->add_dims(dim);
    const std::string bytes = matrix.SerializeAsString();
    std::string packed(compressBound(bytes.size()), '\0');
    uLongf size = packed.size();
    compress(reinterpret_cast<Bytef*>(packed.data()), &size,
             reinterpret_cast<const Bytef*>(bytes.data()), bytes.size());
    return packed.substr(0, size);
  }
  static void set(const Rigid3d& pose, waymo_testing::Transform* transform) {
    for (int r = 0; r < 4; ++r)
      for (int c = 0; c < 4; ++c) transform->add_transform(pose.matrix()(r, c));
  }

  std::vector<waymo_testing::Frame> frames;

 private:
  static double since_1970_s(double s) { return 1e-6 * double(kFirst_us) + s; }

  static void add_context(waymo_testing::Context* context) {
    context->set_name("made");
    for (const int name : {1, 4}) {
      auto* camera = context->add_camera_calibrations();
      camera->set_name(name);
      for (const double value : {50.0, 51.0, 32.5, 24.0, 0.05, -0.01, 0.001, -0.002, 0.003})
        camera->add_intrinsic(value);
      set(body_from_camera(name == 1 ? 0 : 0.5), camera->mutable_extrinsic());
      camera->set_width(kWidth);
      camera->set_height(kHeight);
      camera->set_rolling_shutter_direction(name == 1 ? 1 : 4);  // down; to the left
    }
    auto* top = context->add_laser_calibrations();
    top->set_name(1);
    for (const double angle : kInclinations_rad) top->add_beam_inclinations(angle);
    set(body_from_top(), top->mutable_extrinsic());
    auto* front = context->add_laser_calibrations();
    front->set_name(2);
    front->set_beam_inclination_min(-0.5);
    front->set_beam_inclination_max(0.5);
    set(body_from_front_laser(), front->mutable_extrinsic());
  }
  static void add_image(int name, double middle_s, int shade, waymo_testing::Frame* frame) {
    auto* image = frame->add_images();
    image->set_name(name);
    Image8 pixels{kWidth,
                  kHeight,
                  std::vector<std::uint8_t>(3 * kWidth * kHeight, std::uint8_t(shade)),
                  {},
                  {}};
    image->set_image(encode_jpeg(pixels, 95));
    set(world_from_body(middle_s), image->mutable_pose());
    image->set_pose_timestamp(since_1970_s(middle_s));
    image->set_shutter(kShutter_s);
    image->set_camera_trigger_time(since_1970_s(middle_s - (kReadout_s + kShutter_s) / 2));
    image->set_camera_readout_done_time(since_1970_s(middle_s + (kReadout_s + kShutter_s) / 2));
  }
  static void add_scans(int f, waymo_testing::Frame* frame) {
    std::vector<float> ranges, poses;
    for (int row = 0; row < kRows; ++row)
      for (int column = 0; column < kColumns; ++column) {
        ranges.insert(ranges.end(), {is_lost(row, column) ? -1 : range_m(row, column),
                                     0.01f * static_cast<float>(column), 0.1f, -1});
        const double s = column_s(f, column);
        const Eigen::Vector3d at = world_from_body(s).translation();
        poses.insert(poses.end(),
                     {0, 0, static_cast<float>(0.5 + 0.2 * s), static_cast<float>(at.x()),
                      static_cast<float>(at.y()), static_cast<float>(at.z())});
      }
    auto* top = frame->add_lasers();
    top->set_name(1);
    top->mutable_ri_return1()->set_range_image_compressed(
        packed_matrix(ranges, {kRows, kColumns, 4}));
    top->mutable_ri_return1()->set_range_image_pose_compressed(
        packed_matrix(poses, {kRows, kColumns, 6}));
    top->mutable_ri_return2()->set_range_image_compressed("another return");
    auto* front = frame->add_lasers();
    front->set_name(2);
    front->mutable_ri_return1()->set_range_image_compressed(
        packed_matrix(std::vector<float>(2 * 6 * 4, 3.0f), {2, 6, 4}));
  }
  static waymo_testing::Frame frame(int f) {
    waymo_testing::Frame frame;
    add_context(frame.mutable_context());
    frame.set_timestamp_micros(kFirst_us + kStep_us * f);
    set(world_from_body(frame_s(f)), frame.mutable_pose());
    add_image(1, frame_s(f) + kFront_s, 40 + 20 * f, &frame);
    add_image(4, frame_s(f) + kLeft_s, 40 + 20 * f, &frame);
    add_scans(f, &frame);
    // A car at 12 m/s along the world's x, in the body's axes at the frame's time.
    const Rigid3d world_from_car(Eigen::Translation3d(1015 + 12 * frame_s(f), -497, 20.8));
    const Rigid3d in_body = world_from_body(frame_s(f)).inverse() * world_from_car;
    auto* label = frame.add_laser_labels();
    label->set_id("car-1");
    label->set_type(1);
    auto* box = label->mutable_box();
    box->set_center_x(in_body.translation().x());
    box->set_center_y(in_body.translation().y());
    box->set_center_z(in_body.translation().z());
    box->set_length(4.5);
    box->set_width(1.75);
    box->set_height(1.5);
    box->set_heading(std::atan2(in_body.linear()(1, 0), in_body.linear()(0, 0)));
    if (f == 2) frame.add_no_label_zones()->add_x(1);
    return frame;
  }
};

}  // namespace redrive::testing
