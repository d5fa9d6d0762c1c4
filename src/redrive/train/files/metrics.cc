// SPDX-License-Identifier: Apache-2.0
// metrics.jsonl: one object per line, appended by one write each, so that a kill truncates at most
// the last line.
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <functional>
#include <limits>
#include <tuple>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/json_field.h"
#include "redrive/train/run.h"

namespace redrive {
namespace {

void append_line(const std::filesystem::path& path, const nlohmann::json& json) {
  const std::string line = json.dump() + "\n";
  const int file =
      ::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_NOFOLLOW | O_CLOEXEC, 0644);
  if (file < 0 && errno == ELOOP)
    throw IoError(path, "is a link; nothing is written outside of the run's folder");
  if (file < 0) throw IoError(path, std::strerror(errno));
  errno = ENOSPC;  // the cause of a partial write
  const bool written = ::write(file, line.data(), line.size()) == static_cast<ssize_t>(line.size());
  const int why = errno;
  ::close(file);
  if (!written) throw IoError(path, std::strerror(why));
}

struct Line {
  std::string_view text;
  MetricsPosition position;
  bool is_event = false;
  /// step that a roll-back went back to
  std::int64_t undone_to = std::numeric_limits<std::int64_t>::max();
  MetricsRow row;
};

/// Calls `take` for each complete line.
void for_lines(const std::filesystem::path& path, std::string_view bytes,
               const std::function<void(const Line&)>& take) {
  MetricsPosition position;
  std::int64_t number = 0;
  for (std::size_t begin = 0, end; (end = bytes.find('\n', begin)) != std::string_view::npos;
       begin = end + 1) {
    Line line;
    line.text = bytes.substr(begin, end + 1 - begin);
    const std::filesystem::path where = path.string() + ":" + std::to_string(++number);
    const nlohmann::json json = parse_json(line.text, where);
    const JsonField field(json, where);
    position.step = field.at("step").integer();
    if (field.has("event")) {
      line.is_event = true;
      const std::string event = field.at("event").string();
      if (event == "restart") {
        position.restarts = static_cast<int>(field.at("restarts").integer());
        position.rollbacks = 0;
      } else if (event == "rollback") {
        position.rollbacks = static_cast<int>(field.at("rollbacks").integer());
        line.undone_to = field.at("to_step").integer();
      }
    } else {
      line.row = {position.step,
                  field.at("seconds").number(),
                  field.at("loss").number(),
                  field.at("psnr_db").number(),
                  field.at("learning_rate").number(),
                  field.at("rays_per_s").number(),
                  static_cast<int>(field.at("epoch").integer())};
      if (field.has("losses"))
        for (const std::string& name : field.at("losses").keys())
          line.row.losses.emplace_back(name, field.at("losses").at(name).number());
    }
    line.position = position;
    take(line);
  }
}

std::string bytes_or_nothing(const std::filesystem::path& path) {
  std::error_code error;
  const bool missing =
      std::filesystem::status(path, error).type() == std::filesystem::file_type::not_found;
  return missing ? std::string() : read_file(path);
}

}  // namespace

void append_metrics(const RunPaths& paths, const MetricsRow& row) {
  nlohmann::json json = {{"step", row.step},
                         {"epoch", row.epoch},
                         {"seconds", row.seconds},
                         {"loss", row.loss},
                         {"psnr_db", row.psnr_db},
                         {"learning_rate", row.learning_rate},
                         {"rays_per_s", row.rays_per_s}};
  for (const auto& [name, value] : row.losses) json["losses"][name] = value;
  if (row.image_wait_s > 0) json["image_wait_s"] = row.image_wait_s;
  append_line(paths.metrics(), json);
}

void append_restart(const RunPaths& paths, std::int64_t step, int restarts, std::uint64_t seed,
                    const std::string& reason) {
  append_line(paths.metrics(), {{"event", "restart"},
                                {"step", step},
                                {"restarts", restarts},
                                {"seed", seed},
                                {"reason", reason}});
}

void append_rollback(const RunPaths& paths, std::int64_t step, std::int64_t to_step, int rollbacks,
                     double rate_factor, const std::string& reason) {
  append_line(paths.metrics(), {{"event", "rollback"},
                                {"step", step},
                                {"to_step", to_step},
                                {"rollbacks", rollbacks},
                                {"rate_factor", rate_factor},
                                {"reason", reason}});
}

std::vector<MetricsRow> read_metrics(const RunPaths& paths) {
  return parse_metrics(bytes_or_nothing(paths.metrics()), paths.metrics());
}

std::vector<MetricsRow> parse_metrics(std::string_view bytes, const std::filesystem::path& file) {
  std::vector<MetricsRow> rows;
  for_lines(file, bytes, [&, current = 0](const Line& line) mutable {
    if (line.position.restarts != current) rows.clear();
    current = line.position.restarts;
    // Rows are in the order of their steps: looking at the last ones takes linear time.
    while (!rows.empty() && rows.back().step > line.undone_to) rows.pop_back();
    if (!line.is_event) rows.push_back(line.row);
  });
  return rows;
}

std::string truncated_metrics(std::string_view bytes, const MetricsPosition& position) {
  std::string kept;
  try {
    for_lines("metrics.jsonl", bytes, [&](const Line& line) {
      const auto here = std::tie(line.position.restarts, line.position.rollbacks),
                 there = std::tie(position.restarts, position.rollbacks);
      if (here < there || (here == there && (line.is_event || line.position.step <= position.step)))
        kept += line.text;
    });
  } catch (const InputError&) {
    // The data that survived a power cut ends here; the steps after the checkpoint are computed and
    // written again anyway.
  }
  return kept;
}

void truncate_metrics(const RunPaths& paths, const MetricsPosition& position) {
  const std::string bytes = bytes_or_nothing(paths.metrics()),
                    kept = truncated_metrics(bytes, position);
  if (kept != bytes) write_file(paths.metrics(), kept);
}

void sync_metrics(const RunPaths& paths) {
  const int file = ::open(paths.metrics().c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0 && errno == ENOENT) return;  // no row yet
  const bool synced = file >= 0 && ::fsync(file) == 0;
  const int why = errno;
  if (file >= 0) ::close(file);
  if (!synced) throw IoError(paths.metrics(), std::strerror(why));
}

}  // namespace redrive
