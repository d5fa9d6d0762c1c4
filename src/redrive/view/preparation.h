// SPDX-License-Identifier: Apache-2.0
// The page of a run before its first step: it says what is being prepared.
#pragma once

#include <condition_variable>
#include <mutex>
#include <set>
#include <thread>

#include "redrive/view/server/server.h"

namespace redrive::view {

/// Sends {"kind": "preparing", "text": ..., "share": ...} to the pages twice a second: the latest
/// Progress (base/progress.h) and its share that is done, null where it is not known.
class Preparation : public ServerEvents {
 public:
  Preparation() = default;
  ~Preparation() override { end(); }
  Preparation(const Preparation&) = delete;
  Preparation& operator=(const Preparation&) = delete;

  void begin(Server& server);  ///< before `server` goes: end()
  void end();                  ///< sends nothing from now on
  /// Ends; the pages that are open and later ones are `events`' from now on.
  void hand_over(ServerEvents& events);

  void opened(ClientId client) override;
  void received(ClientId client, std::string_view text) override;
  void closed(ClientId client) override;

 private:
  void say_until_end(Server& server);

  std::mutex mutex_;
  std::condition_variable ended_;
  bool says_ = false;
  std::set<ClientId> pages_;
  ServerEvents* events_ = nullptr;
  std::thread thread_;
};

}  // namespace redrive::view
