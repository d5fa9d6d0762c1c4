// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/ncore/ncore_stores.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"

namespace redrive::ncore {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kMostMetaBytes = 1 << 24;
constexpr std::int64_t kLongestFrame_us = 1'000'000;

/// Returns the stores that a sequence's JSON file lists; nothing for other JSON files.
std::optional<std::vector<std::string>> listed_stores(const fs::path& file) {
  std::error_code error;
  if (fs::file_size(file, error) > kMostMetaBytes || error) return std::nullopt;
  const nlohmann::json all = read_json(file);
  if (!all.is_object() || !all.contains("component_stores")) return std::nullopt;
  const JsonField stores = JsonField(all, file).at("component_stores");
  std::vector<std::string> paths;
  for (std::size_t i = 0; i < stores.size(); ++i) paths.push_back(stores.at(i).at("path").string());
  return paths;
}

std::vector<fs::path> find_stores(Recording* recording) {
  const fs::path& root = recording->root;
  std::vector<fs::path> lists, stores, missing;
  for (const fs::path& file : list_folder(root)) {
    if (is_store_name(file)) stores.push_back(file);
    if (!has_extension(file, {".json"}) || is_folder(file)) continue;
    std::optional<std::vector<std::string>> listed;
    try {
      listed = listed_stores(file);
    } catch (const InputError& error) {
      recording->findings.push_back({file.filename().string(), error.what()});
    }
    if (!listed) continue;
    if (!lists.empty())
      throw InputError(root, "", "",
                       "has several sequences: " + lists.front().filename().string() + " and " +
                           file.filename().string());
    lists.push_back(file);
    for (const std::string& text : *listed) {
      const fs::path path = root / fs::path(text).lexically_normal();
      if (lies_outside(path, root)) recording->outside_file = path;
      if (!is_there(path))
        missing.push_back(text);
      else if (std::ranges::find(stores, path) == stores.end())
        stores.push_back(path);
    }
  }
  for (const fs::path& path : missing)
    recording->findings.push_back(
        {path.string(), "missing: " + lists.front().filename().string() + " lists this store"});
  // list_folder is sorted, and each store stands there once.
  std::ranges::sort(stores);
  stores.erase(std::unique(stores.begin(), stores.end()), stores.end());
  return stores;
}

}  // namespace

bool is_store_name(const fs::path& path) {
  const std::string name = path.filename().string();
  return name.find("ncore4") != name.npos &&
         (name.ends_with(".zarr.itar") || name.ends_with(".zarr"));
}

Components open_components(Recording* recording) {
  Components components;
  std::string sequence;
  std::vector<std::string> other_versions, repeated;
  for (const fs::path& path : find_stores(recording)) {
    const auto store = std::make_shared<const ZarrReader>(path);
    const nlohmann::json about = store->attributes("");
    const JsonField root(about, path / ".zattrs");
    if (root.at("version").string() != "v4") root.at("version").fail("must be v4");
    const std::string id = root.at("sequence_id").string();
    if (sequence.empty()) sequence = id;
    if (id != sequence)
      root.at("sequence_id").fail("is another sequence than the one beside it, " + sequence);
    for (const std::string& kind : store->names(""))
      for (const std::string& name : store->names(kind)) {
        const Component component{store, kind + "/" + name, name};
        const nlohmann::json attributes = store->attributes(component.path);
        const std::string version =
            attributes.contains("component_version") && attributes["component_version"].is_string()
                ? attributes["component_version"].get<std::string>()
                : "";
        std::vector<Component>& of_kind = components[kind];
        if (version != "v1")
          other_versions.push_back(component.path + " (" + version + ")");
        else if (std::ranges::find(of_kind, name, &Component::name) != of_kind.end())
          repeated.push_back(component.path + " of " + path.filename().string());
        else
          of_kind.push_back(component);
      }
  }
  std::erase_if(components, [](const auto& kind) { return kind.second.empty(); });
  if (!repeated.empty())
    recording->findings.push_back(
        {"components", "not used, another store has them: " + first_few(repeated)});
  if (components.empty())
    throw InputError(recording->root, "", "", "has no store with a component of version v1");
  if (!other_versions.empty())
    recording->findings.push_back(
        {"components", "not used, of another version than v1: " + first_few(other_versions)});
  return components;
}

std::optional<Component> choose(const Components& components, const std::string& kind,
                                std::vector<Finding>* findings) {
  const auto of_kind = components.find(kind);
  if (of_kind == components.end()) return std::nullopt;
  const std::vector<Component>& all = of_kind->second;
  auto chosen = std::ranges::find(all, "default", &Component::name);
  if (chosen == all.end()) chosen = std::ranges::min_element(all, {}, &Component::name);
  std::vector<std::string> others;
  for (const Component& other : all)
    if (&other != &*chosen) others.push_back(other.name);
  if (!others.empty())
    findings->push_back(
        {kind, "\"" + chosen->name + "\" is used; there are also " + first_few(others)});
  return *chosen;
}

std::vector<FrameSpan> read_spans(const Component& sensor, std::vector<DamagedRecord>* damaged) {
  const nlohmann::json attributes = sensor.attributes("frames");
  const JsonField times = JsonField(attributes, sensor.file("frames")).at("frames_timestamps_us");
  const std::vector<std::string> names = sensor.store->names(sensor.path + "/frames");
  std::vector<FrameSpan> spans;
  const DamagedList list{sensor.name, damaged};
  for (std::size_t i = 0; i < times.size(); ++i)
    parse_record(&list, -1, [&] {
      const JsonField row = times.at(i);
      const std::int64_t start = row.at(std::size_t{0}).integer(), end = row.at(1).integer();
      if (start < 0 || end < start || end > kMaxTime_us || end - start > kLongestFrame_us)
        row.fail("must be start and end in microseconds, at most a second apart");
      const std::string name = std::to_string(end);
      if (!std::ranges::binary_search(names, name)) row.fail("has no group " + name);
      spans.push_back({start, end, sensor.path + "/frames/" + name});
    });
  std::ranges::sort(spans, {}, &FrameSpan::end_us);
  const auto repeated = std::ranges::unique(spans, {}, &FrameSpan::end_us);
  spans.erase(repeated.begin(), repeated.end());
  return spans;
}

}  // namespace redrive::ncore
