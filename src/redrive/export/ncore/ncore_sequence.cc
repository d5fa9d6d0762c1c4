// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/ncore/ncore_sequence.h"

#include <algorithm>
#include <cstdio>
#include <iterator>

#include <boost/uuid/detail/md5.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"

namespace redrive::ncore {
namespace {

std::string store_name(const std::string& id) { return id + ".ncore4.zarr.itar"; }

std::string md5_of(const std::filesystem::path& file) {
  boost::uuids::detail::md5 md5;
  read_blocks(file, [&](std::string_view block) { md5.process_bytes(block.data(), block.size()); });
  boost::uuids::detail::md5::digest_type digest;
  md5.get_digest(digest);
  std::string text;
  for (const unsigned word : digest) {  // in Boost 1.74 its first byte is the highest
    char hex[9];
    std::snprintf(hex, sizeof hex, "%08x", word);
    text += hex;
  }
  return text;
}

}  // namespace

bool FrameTimes::add(std::int64_t start_us, std::int64_t end_us) {
  const auto after = start_of_end_.lower_bound(end_us);
  if (after != start_of_end_.end() && (after->first == end_us || after->second <= start_us))
    return false;
  if (after != start_of_end_.begin() && std::prev(after)->second >= start_us) return false;
  start_of_end_.emplace_hint(after, end_us, start_us);
  return true;
}

Json FrameTimes::json() const {
  Json times = Json::array();
  for (const auto& [end_us, start_us] : start_of_end_) times.push_back({start_us, end_us});
  return times;
}

Sequence::Sequence(const std::filesystem::path& folder, const std::string& id,
                   std::int64_t earlier_ns)
    : folder_(folder), id_(id), earlier_ns_(earlier_ns), store_(folder / store_name(id)) {}

std::string Sequence::component(const std::string& kind, const std::string& instance) {
  const std::string path = kind + "/" + instance;
  store_.group(path, {{"component_name", kind},
                      {"component_instance_name", instance},
                      {"component_version", "v1"},
                      {"generic_meta_data", Json::object()}});
  components_[kind][instance] = {{"version", "v1"}, {"generic_meta_data", Json::object()}};
  return path;
}

std::int64_t Sequence::us(std::int64_t t_ns) const {
  const std::int64_t ns = t_ns - earlier_ns_;
  REDRIVE_CHECK_OP(ns, >=, 0);
  return (ns + 500) / 1000;
}

std::string Sequence::sensor_id(const std::string& name) {
  std::string id = name.empty() ? "sensor" : name;
  constexpr std::string_view kSpecial = "/\\'\"";
  std::ranges::replace_if(
      id, [&](char c) { return (c >= 0 && c <= ' ') || kSpecial.find(c) != kSpecial.npos; }, '_');
  const std::string once = id;
  for (int n = 2; !sensors_.insert(id).second; ++n) id = once + "_" + std::to_string(n);
  return id;
}

void Sequence::cover(std::int64_t start_us, std::int64_t end_us) {
  const bool first = last_us_ < first_us_;
  first_us_ = first ? start_us : std::min(first_us_, start_us);
  last_us_ = first ? end_us : std::max(last_us_, end_us);
}

void Sequence::finish() {
  const Json interval = {{"start", first_us_}, {"stop", last_us_ + 1}};
  store_.group("", {{"sequence_id", id_},
                    {"sequence_timestamp_interval_us", interval},
                    {"generic_meta_data", Json::object()},
                    {"version", "v4"},
                    {"component_group_name", ""}});
  store_.finish();
  const Json meta = {{"sequence_id", id_},
                     {"sequence_timestamp_interval_us", interval},
                     {"generic_meta_data", Json::object()},
                     {"version", "v4"},
                     {"component_stores",
                      {{{"path", store_name(id_)},
                        {"md5", md5_of(folder_ / store_name(id_))},
                        {"components", components_}}}}};
  write_file(folder_ / (id_ + ".json"), meta.dump(1) + "\n");
}

}  // namespace redrive::ncore
