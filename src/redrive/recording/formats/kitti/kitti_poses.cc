// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_poses.h"

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/math/local_level.h"
#include "redrive/recording/parse/rigid_json.h"
#include "redrive/recording/parse/text_lines.h"

namespace redrive::kitti {
namespace {

constexpr double kMaxRadius_m = 1e7;
constexpr double kMaxTime_s = 9e9;  // int64 nanoseconds end at 9.22e9 s
constexpr double kAnyNumber =
    1e12;  // status words and accuracies of the packet, which are not used

/// The digits of a field of fixed width, or -1.
int digits(std::string_view text, std::size_t begin, std::size_t count) {
  int value = 0;
  for (std::size_t i = begin; i < begin + count; ++i) {
    if (i >= text.size() || text[i] < '0' || text[i] > '9') return -1;
    value = 10 * value + (text[i] - '0');
  }
  return value;
}

std::optional<std::chrono::sys_days> day_of(std::string_view date) {
  if (date.size() != 10 || date[4] != '-' || date[7] != '-') return std::nullopt;
  const int year = digits(date, 0, 4), month = digits(date, 5, 2), day = digits(date, 8, 2);
  if (year < 1970 || year > 2200 || month < 0 || day < 0) return std::nullopt;
  const std::chrono::year_month_day ymd{std::chrono::year(year),
                                        std::chrono::month(static_cast<unsigned>(month)),
                                        std::chrono::day(static_cast<unsigned>(day))};
  if (!ymd.ok()) return std::nullopt;
  return std::chrono::sys_days(ymd);
}

/// Nanoseconds since midnight of "13:10:51.175862102"; 1 to 9 decimals, or none.
std::optional<std::int64_t> time_of_day_ns(std::string_view time) {
  if (time.size() < 8 || time[2] != ':' || time[5] != ':') return std::nullopt;
  const int hour = digits(time, 0, 2), minute = digits(time, 3, 2), second = digits(time, 6, 2);
  if (hour < 0 || hour > 23 || minute < 0 || minute > 59 || second < 0 || second > 60)
    return std::nullopt;
  std::int64_t fraction_ns = 0;
  if (time.size() > 8) {
    const std::size_t decimals = time.size() - 9;
    if (time[8] != '.' || decimals < 1 || decimals > 9) return std::nullopt;
    const int value = digits(time, 9, decimals);
    if (value < 0) return std::nullopt;
    fraction_ns = value;
    for (std::size_t i = decimals; i < 9; ++i) fraction_ns *= 10;
  }
  return ((hour * 60 + minute) * 60 + second) * 1'000'000'000ll + fraction_ns;
}

/// The rows of a 3 x 4 matrix from word `first` on.
Rigid3d rigid_from_words(const TextLine& line, std::size_t first,
                         const std::filesystem::path& file) {
  nlohmann::json rows = nlohmann::json::array();
  for (std::size_t i = 0; i < 12; ++i) {
    if (i % 4 == 0) rows.push_back(nlohmann::json::array());
    rows.back().push_back(line.number(first + i, "value " + std::to_string(first + i + 1),
                                      -kMaxRadius_m, kMaxRadius_m));
  }
  rows.push_back({0, 0, 0, 1});
  const nlohmann::json document = {{line.name(), rows}};
  return rigid_from_json(JsonField(document, file).at(line.name()));
}

std::vector<TextLine> lines_of_file(std::string_view text, const std::filesystem::path& file) {
  std::vector<TextLine> lines = text_lines(text, file);
  if (lines.empty()) throw InputError(file, "", "", "is empty: a line for each frame is expected");
  return lines;
}

/// Returns ECEF from IMU for a packet.
Rigid3d pose_of_packet(const TextLine& line) {
  line.expect_size(30, "latitude, longitude, altitude, roll, pitch, yaw, ...");
  constexpr double kTurn_rad = 2 * std::numbers::pi + 1e-6;
  const double latitude_rad = line.number(0, "latitude", -90, 90) * std::numbers::pi / 180,
               longitude_rad = line.number(1, "longitude", -360, 360) * std::numbers::pi / 180,
               altitude_m = line.number(2, "altitude", -1000, 20000),
               roll_rad = line.number(3, "roll", -kTurn_rad, kTurn_rad),
               pitch_rad = line.number(4, "pitch", -kTurn_rad, kTurn_rad),
               yaw_rad = line.number(5, "yaw", -kTurn_rad, kTurn_rad);
  for (std::size_t i = 6; i < line.size(); ++i)
    line.number(i, "value " + std::to_string(i + 1), -kAnyNumber, kAnyNumber);

  Rigid3d ecef_from_imu = ecef_from_enu({latitude_rad, longitude_rad, altitude_m});
  ecef_from_imu.linear() *= (Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()) *
                             Eigen::AngleAxisd(pitch_rad, Eigen::Vector3d::UnitY()) *
                             Eigen::AngleAxisd(roll_rad, Eigen::Vector3d::UnitX()))
                                .toRotationMatrix();
  return ecef_from_imu;
}

/// Returns each line parsed by `parse`; nothing for lines that go to `damaged`.
template <class Parse>
auto by_line(std::string_view text, const std::filesystem::path& file, const DamagedList* damaged,
             const Parse& parse) {
  std::vector<decltype(parse(std::declval<TextLine>()))> values;
  for (const TextLine& line : lines_of_file(text, file)) {
    const auto frame_id = static_cast<std::int64_t>(values.size());
    values.emplace_back();
    parse_record(damaged, frame_id, [&] { values.back() = parse(line); });
  }
  return values;
}

/// Drops times that are not between their neighbours.
void require_increasing(const std::filesystem::path& file, const DamagedList* damaged,
                        std::vector<std::optional<std::int64_t>>* times) {
  std::vector<std::size_t> there;
  for (std::size_t i = 0; i < times->size(); ++i)
    if ((*times)[i]) there.push_back(i);
  const auto time = [&](std::size_t k) { return *(*times)[there[k]]; };
  const Misfits misfits =
      find_misfits(there.size(), [&](std::size_t a, std::size_t b) { return time(a) < time(b); });
  const auto refuse = [&](std::size_t k) {
    char value[40];
    std::snprintf(value, sizeof value, "%.15g s", 1e-9 * static_cast<double>(time(k)));
    throw InputError(file, "line " + std::to_string(there[k] + 1) + ", time", value,
                     "is not after that of the line before");
  };
  for (const std::size_t k : misfits.breaks) refuse(k);
  for (const std::size_t k : misfits.single)
    parse_record(damaged, static_cast<std::int64_t>(there[k]), [&] { refuse(k); });
  for (const std::size_t k : misfits.single) (*times)[there[k]].reset();
}

}  // namespace

std::vector<std::optional<std::int64_t>> parse_timestamps(std::string_view text,
                                                          const std::filesystem::path& file,
                                                          const DamagedList* damaged) {
  auto times =
      by_line(text, file, damaged, [](const TextLine& line) -> std::optional<std::int64_t> {
        if (line.size() == 0) return std::nullopt;
        line.expect_size(2, "a date and a time, as 2011-09-26 13:10:51.175862102");
        const auto day = day_of(line.word(0));
        if (!day) line.fail(0, "date", "expected a date as 2011-09-26");
        const auto time_ns = time_of_day_ns(line.word(1));
        if (!time_ns) line.fail(1, "time", "expected a time as 13:10:51.175862102");
        return std::chrono::nanoseconds(day->time_since_epoch()).count() + *time_ns;
      });
  require_increasing(file, damaged, &times);
  return times;
}

Rigid3d parse_oxts(std::string_view text, const std::filesystem::path& file) {
  const std::vector<TextLine> lines = lines_of_file(text, file);
  if (lines.size() != 1)
    throw InputError(file, "number of lines", std::to_string(lines.size()),
                     "expected one, with a packet of 30 numbers");
  const std::size_t end = std::min(text.find('\n'), text.size());
  const TextLine line(text.substr(0, end), file, 0);
  return pose_of_packet(line);
}

std::vector<std::optional<Rigid3d>> parse_oxts_lines(std::string_view text,
                                                     const std::filesystem::path& file,
                                                     const DamagedList* damaged) {
  return by_line(text, file, damaged,
                 [](const TextLine& line) { return std::optional(pose_of_packet(line)); });
}

std::vector<std::optional<std::int64_t>> parse_times(std::string_view text,
                                                     const std::filesystem::path& file,
                                                     const DamagedList* damaged) {
  auto times = by_line(text, file, damaged, [](const TextLine& line) {
    line.expect_size(1, "the time of a frame in seconds");
    return std::optional<std::int64_t>(std::llround(1e9 * line.number(0, "time", 0, kMaxTime_s)));
  });
  require_increasing(file, damaged, &times);
  return times;
}

std::vector<std::optional<Rigid3d>> parse_poses(std::string_view text,
                                                const std::filesystem::path& file,
                                                const DamagedList* damaged) {
  return by_line(text, file, damaged, [&](const TextLine& line) {
    line.expect_size(12, "the rows of a 3 x 4 matrix");
    return std::optional(rigid_from_words(line, 0, file));
  });
}

std::vector<FramePose> parse_frame_poses(std::string_view text, const std::filesystem::path& file,
                                         const DamagedList* damaged) {
  constexpr std::int64_t kMaxId = 1'000'000'000;
  std::vector<FramePose> poses;
  for (const TextLine& line : lines_of_file(text, file)) {
    std::int64_t id = -1;
    parse_record(damaged, id, [&] {
      if (line.size() != 17)
        line.expect_size(13, "a frame and the rows of a 3 x 4 (or 4 x 4) matrix");
      id = line.integer(0, "frame", 0, kMaxId);
      if (!poses.empty() && id <= poses.back().id)
        line.fail(0, "frame", "is not after that of the line before");
      poses.push_back({id, 0, rigid_from_words(line, 1, file)});
    });
  }
  return poses;
}

}  // namespace redrive::kitti
