// SPDX-License-Identifier: Apache-2.0
#include "redrive/serve/scene_store.h"

#include <algorithm>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/zip.h"
#include "redrive/base/json_field.h"
#include "redrive/render/open_to_render.h"
#include "redrive/serve/sensor_service.h"
#include "redrive/train/memory.h"

namespace redrive::serve {
namespace {

namespace fs = std::filesystem;

/// Returns an estimate of the memory of an opened run, of a drive in blocks with all blocks. Errors
/// as ZipFile.
std::uint64_t bytes_of_run(const fs::path& root) {
  constexpr std::uint64_t kTables = std::uint64_t{32} << 20;  // recording, rays of cameras
  std::uint64_t files = 0;
  if (is_scene_bundle(root))
    return kTables + 2 * ZipFile(root).size(RunPaths{root / kRunOfBundle}.checkpoint()).value_or(0);
  for (const fs::path& file : field_files(root)) files += fs::file_size(file);
  return kTables + 2 * files;
}

/// Returns the scene's id in a bundle. InputError where it has none.
std::string id_of_bundle(const fs::path& bundle) {
  const nlohmann::json document =
      parse_json(ZipFile(bundle).read(bundle / kDataInfo, kMaxTextBytes), bundle / kDataInfo);
  return JsonField(document, bundle / kDataInfo).at("sequence_id").string();
}

}  // namespace

SceneStore::SceneStore(const std::vector<fs::path>& runs, kernels::BackendChoice backend,
                       std::uint64_t memory)
    : backend_(std::move(backend)), memory_(memory) {
  const auto add = [&](const fs::path& root) {
    if (const auto missing = missing_part(root)) throw InputError(root, "", "", *missing);
    known_.push_back(
        {is_scene_bundle(root) ? id_of_bundle(root) : fs::canonical(root).filename().string(),
         root});
  };
  const auto is_scene = [](const fs::path& path) {
    return is_run_folder(path) || is_scene_bundle(path);
  };
  for (const fs::path& path : runs) {
    if (is_scene(path)) {
      add(path);
      continue;
    }
    const std::size_t before = known_.size();
    std::error_code error;
    for (const fs::directory_entry& entry : fs::directory_iterator(path, error))
      if (is_scene(entry.path())) try {
          add(entry.path());
        } catch (const InputError& damage) {
          left_out_.emplace_back(damage.what());
        }
    if (known_.size() == before)
      throw UsageError("RUN", path.string(),
                       "must be a run, a scene bundle, or a folder that has some" +
                           (left_out_.empty() ? "" : "; left out: " + left_out_.back()));
  }
  std::ranges::sort(known_, {}, &Known::id);
  const auto twice = std::ranges::adjacent_find(known_, {}, &Known::id);
  if (twice != known_.end())
    throw UsageError("RUN", twice->root.string(),
                     "has the id " + twice->id + " of " + std::next(twice)->root.string() +
                         ": names of folders, and sequence_id in bundles, are ids of scenes");
}

std::vector<std::string> SceneStore::ids() const {
  std::vector<std::string> ids;
  for (const Known& known : known_) ids.push_back(known.id);
  return ids;
}

std::vector<std::string> SceneStore::open_ids() {
  const std::lock_guard lock(mutex_);
  std::vector<std::string> ids;
  for (const Open& open : open_) ids.push_back(open.id);
  return ids;
}

std::shared_ptr<OpenScene> SceneStore::find(const std::string& id) {
  const std::lock_guard lock(mutex_);
  const auto found = std::ranges::find(open_, id, &Open::id);
  if (found == open_.end()) return nullptr;
  open_.splice(open_.begin(), open_, found);
  return open_.front().scene;
}

std::shared_ptr<OpenScene> SceneStore::get(const std::string& id) {
  if (auto open = find(id)) return open;
  const auto known = std::ranges::find(known_, id, &Known::id);
  if (known == known_.end())
    throw RequestError(StatusCode::kNotFound, "scene_id = " + id + ": " + unknown_name(id, ids()));
  const std::lock_guard opening(opening_);
  if (auto open = find(id)) return open;  // another thread opened it
  const std::uint64_t bytes = bytes_of_run(known->root);
  if (bytes > memory_)
    throw RequestError(StatusCode::kResourceExhausted,
                       "scene " + id + " " + memory_text(bytes, memory_) + " by --memory");
  {
    const std::lock_guard lock(mutex_);
    std::uint64_t sum = bytes;
    for (const Open& open : open_) sum += open.scene->bytes;
    for (; sum > memory_; open_.pop_back()) sum -= open_.back().scene->bytes;
  }
  auto scene = std::make_shared<OpenScene>(std::make_shared<const Run>(open_to_render(known->root)),
                                           backend_);
  scene->bytes = bytes;
  const std::lock_guard lock(mutex_);
  open_.push_front({id, scene});
  return scene;
}

}  // namespace redrive::serve
