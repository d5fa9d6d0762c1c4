// SPDX-License-Identifier: Apache-2.0
// Decides which client's image is made next and how large. Images are made one at a time on the
// thread of serve(), the clients in turn; a newer request of a client replaces the older one, so
// nothing queues.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "redrive/view/messages.h"
#include "redrive/view/overlay.h"
#include "redrive/view/pace.h"
#include "redrive/view/server.h"
#include "redrive/view/view_renderer.h"

namespace redrive::view {

/// Sends to a page, all little-endian: texts are JSON with a "kind"; images are bytes: the size of
/// a JSON header (32 bits), the header ({"kind": "image" or "reference", ..., "jpeg", "points"}),
/// that many bytes of JPEG, that many of points (overlay.h).
class Viewer : public ServerEvents {
 public:
  /// Run and backend must outlive it.
  Viewer(const Run& run, kernels::Backend& backend);
  ~Viewer() override;

  /// Makes images until `stop`; looks at it 10 times a second.
  void serve(Server& server, const std::atomic<bool>& stop);

  void opened(ClientId id) override;
  void received(ClientId id, std::string_view text) override;
  void closed(ClientId id) override;

 private:
  using Clock = std::chrono::steady_clock;
  struct Inbox;
  struct Client;

  bool work(ClientId id, Client& client, Clock::time_point* wake_at);
  void answer_pick(ClientId id, const Client& client, const Pick& pick);
  void begin(Client& client);
  void finish(ClientId id, Client& client);
  void send_reference(ClientId id, Client& client, const ViewRequest& view);
  void send_score(ClientId id, Client& client);
  int busy_clients() const;

  ViewRenderer renderer_;
  Overlay overlay_;
  std::string hello_;
  Server* server_ = nullptr;
  std::map<std::string, Pace> paces_;  ///< by camera

  mutable std::mutex mutex_;  ///< of the clients' list and their inboxes
  std::condition_variable wake_;
  bool has_news_ = false;
  std::map<ClientId, std::shared_ptr<Client>> clients_;
};

}  // namespace redrive::view
