// SPDX-License-Identifier: Apache-2.0
// Decides which client's image is made next and how large. Images are made one at a time on the
// thread of serve(), in turn for the clients; a newer request of a client replaces the older one,
// so nothing queues.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include <nlohmann/json_fwd.hpp>

#include "redrive/view/drive_map.h"
#include "redrive/view/overlay.h"
#include "redrive/view/pace.h"
#include "redrive/view/path_store.h"
#include "redrive/view/run_watch.h"
#include "redrive/view/server/messages.h"
#include "redrive/view/server/server.h"
#include "redrive/view/traffic.h"
#include "redrive/view/view_renderer.h"

namespace redrive::view {

/// Progress of a run that trains in this process.
struct Training {
  bool trains = false;  ///< false: it has ended
  std::int64_t step = 0;
  double seconds = 0;  ///< time of training
  bool paused = false;
  std::int64_t steps = 0;  ///< when it ends at the latest; 0: not known
  bool operator==(const Training&) const = default;
};

/// Sends to a page, all little-endian: texts are JSON with a "kind"; images are bytes: the size of
/// a JSON header (32 bits), the header ({"kind": "image" or "reference", ..., "jpeg", "points",
/// "mask"}), that many bytes of JPEG, of points and of the mask (overlay.h).
class Viewer : public ServerEvents {
 public:
  using Look = std::function<RunNews()>;
  /// The backend must outlive it. `look` is called every few seconds between two images, on the
  /// thread of serve(). `edit`: changes to moving objects with which pages begin.
  Viewer(std::shared_ptr<const Run> run, kernels::Backend& backend, Look look = {},
         FirstEdit edit = {});
  ~Viewer() override;

  /// Makes images until `stop`; looks at it 10 times a second.
  void serve(Server& server, const std::atomic<bool>& stop);

  /// A piece of what serve() does, for LiveView; call use() first. Does at most an image or a strip
  /// of it. Returns whether there was anything to do; with `waits` it waits 0.1 s for it. An error
  /// of a page closes the page; nothing is thrown.
  bool work(bool waits);
  void use(Server& server);

  void set_training(const Training& training);
  bool paused() const { return paused_; }  ///< whether a page paused it
  bool has_clients() const;
  void show_again();  ///< the model has changed: makes the shown images once more
  void drop_jobs();   ///< the model is another object: forgets the images that are being made

  void opened(ClientId id) override;
  void received(ClientId id, std::string_view text) override;
  void closed(ClientId id) override;

 private:
  using Clock = std::chrono::steady_clock;
  struct Inbox;
  struct Client;

  void send(ClientId id, const nlohmann::json& json);
  void read_curve();
  void show(std::shared_ptr<const Run> run);
  void look_at_run();
  void take_texts(ClientId id, Client& client, Inbox inbox);
  bool work(ClientId id, Client& client, Clock::time_point* wake_at);
  bool work_on_image(ClientId id, Client& client, Clock::time_point* wake_at);
  bool search_on(ClientId id, Client& client);
  void answer_path(ClientId id, Client& client, const ClientMessage& message);
  void send_paths(ClientId id, nlohmann::json more);
  const Scene& traffic_of(Client& client);
  void answer_pick(ClientId id, Client& client, const Pick& pick);
  void answer_edit(ClientId id, Client& client, const EditMessage& message);
  void check(const TrafficEdit& edit) const;
  void answer_drag(ClientId id, Client& client, const DragMessage& drag);
  void begin(Client& client);
  bool more_of_the_cloud(ClientId id, Client& client);
  void finish(ClientId id, Client& client);
  void send_reference(ClientId id, Client& client, const ViewRequest& view);
  bool send_score(ClientId id, Client& client);
  int busy_clients() const;

  kernels::Backend& backend_;
  std::shared_ptr<const Run> run_;
  std::optional<ViewRenderer> renderer_;  ///< renderer of run_, as are the next four
  std::optional<Overlay> overlay_;
  std::optional<RenderedScans> scans_;
  std::optional<DriveMap> map_;
  std::string hello_;
  const FirstEdit first_edit_;
  std::shared_ptr<const TrafficEdit> parsed_first_edit_;  ///< null: none
  ActorBodies bodies_;                                    ///< bodies of the pages' edits
  Look look_;
  Clock::time_point look_at_;
  std::string curve_;  ///< curve of training, as it is sent
  std::optional<Training> training_;
  std::atomic<bool> paused_ = false;
  ClientId last_served_ = 0;
  std::string problem_;  ///< problem of the run, as the pages know it
  Server* server_ = nullptr;
  std::map<std::pair<std::string, Layer>, Pace> paces_;  ///< key: camera and layer

  mutable std::mutex mutex_;  ///< guards the clients' list and their inboxes
  std::condition_variable wake_;
  bool has_news_ = false;
  std::map<ClientId, std::shared_ptr<Client>> clients_;
};

}  // namespace redrive::view
