// SPDX-License-Identifier: Apache-2.0
// What pages ask beside images: paths, points, edits of moving objects.
#include <filesystem>
#include <memory>
#include <utility>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/edit/edit_actors.h"
#include "redrive/view/viewer.h"
#include "redrive/view/viewer_client.h"

namespace redrive::view {

/// Sends {"kind": "paths", "names", ...}.
void Viewer::send_paths(ClientId id, nlohmann::json more) {
  more["kind"] = "paths";
  more["names"] = PathStore(*run_).names();
  send(id, more);
}

void Viewer::answer_path(ClientId id, Client& client, const ClientMessage& message) {
  const PathStore store(*run_);
  try {
    if (!renderer_->has_field()) throw InputError("message", "type", "path", "there is no run");
    if (const auto* const load = std::get_if<LoadPath>(&message)) {
      send_paths(id, {{"loaded", store.load(load->name)}, {"name", load->name}});
      return;
    }
    const auto& path = std::get<PathMessage>(message);
    client.path = store.keys(path.keyframes);
    if (!path.save) return;
    store.save(path);
    send_paths(id, {{"saved", path.save->name}});
  } catch (const std::exception& error) {
    send_paths(id, {{"error", error.what()}});
  }
}

/// Returns the run's scene with the moving objects as the client has edited them.
const Scene& Viewer::traffic_of(Client& client) {
  if (!client.edit) return run_->scene;
  if (!client.traffic)
    client.traffic =
        std::make_shared<const Scene>(edited_traffic(run_->scene, *client.edit, &bodies_).scene);
  return *client.traffic;
}

/// Throws InputError where a page may not have this edit, or the model cannot draw it.
void Viewer::check(const TrafficEdit& edit) const {
  check_body_files(edit, parsed_first_edit_ ? *parsed_first_edit_ : TrafficEdit{});
  check_added(edit, run_->field() && run_->field()->draws_actors());
}

/// Takes an edit for the views to come, or says why not: {"kind": "edited", "id", "remarks"} or
/// {.., "error"}.
void Viewer::answer_edit(ClientId id, Client& client, const EditMessage& message) {
  nlohmann::json answer = {{"kind", "edited"}, {"id", message.id}};
  try {
    // Names of body files are relative to the folder of --edit.
    const std::filesystem::path file =
        first_edit_.file.parent_path() / std::filesystem::path(message.file).filename();
    auto edit = std::make_shared<const TrafficEdit>(parse_traffic_edit(message.text, file));
    check(*edit);
    Traffic traffic = edited_traffic(run_->scene, *edit, &bodies_);
    client.edit = std::move(edit);
    client.traffic = std::make_shared<const Scene>(std::move(traffic.scene));
    client.scan = std::nullopt;
    answer["remarks"] = traffic.remarks;
  } catch (const std::exception& error) {
    answer["error"] = error.what();
  }
  send(id, answer);
}

/// Sends {"kind": "dragged", "id", ...}, with what dragged() returns.
void Viewer::answer_drag(ClientId id, Client& client, const DragMessage& drag) {
  nlohmann::json answer = nlohmann::json::object();
  try {
    if (client.last)
      answer = dragged(drag, client.last->placement(), traffic_of(client),
                       client.edit ? *client.edit : TrafficEdit{});
  } catch (const std::exception&) {  // the edit, or a body's file, no longer fits the run
  }
  answer["kind"] = "dragged";
  answer["id"] = drag.id;
  send(id, answer);
}

void Viewer::answer_pick(ClientId id, Client& client, const Pick& pick) {
  nlohmann::json answer = {{"surface", false}, {"object", nullptr}};
  try {
    if (client.last) answer = renderer_->pick(*client.last, pick.u, pick.v, traffic_of(client));
  } catch (const std::exception&) {  // the edit, or a body's file, no longer fits the run
  }
  answer["kind"] = "picked";
  answer["id"] = pick.id;
  send(id, answer);
  client.searched = std::nullopt;
  if (answer["surface"]) {
    const std::vector<double> at = answer["world_m"];
    client.searched = pick.id;
    client.search = std::nullopt;
    client.search_at = Eigen::Vector3d(at.data());
  }
}

}  // namespace redrive::view
