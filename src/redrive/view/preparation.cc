// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/preparation.h"

#include <chrono>

#include <nlohmann/json.hpp>

#include "redrive/base/progress.h"

namespace redrive::view {
namespace {

constexpr std::chrono::milliseconds kBetweenNews{500};

std::string preparation_text() {
  const ProgressNews news = Progress::latest();
  nlohmann::json message = {{"kind", "preparing"}, {"text", news.text}, {"share", nullptr}};
  if (news.share) message["share"] = *news.share;
  return message.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace

void Preparation::begin(Server& server) {
  says_ = true;
  thread_ = std::thread([this, &server] { say_until_end(server); });
}

void Preparation::end() {
  {
    const std::lock_guard lock(mutex_);
    says_ = false;
  }
  ended_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void Preparation::say_until_end(Server& server) {
  std::unique_lock lock(mutex_);
  while (says_) {
    const std::string text = preparation_text();
    for (const ClientId page : pages_) server.send_text(page, text);
    ended_.wait_for(lock, kBetweenNews);
  }
}

void Preparation::hand_over(ServerEvents& events) {
  end();
  const std::lock_guard lock(mutex_);
  events_ = &events;
  for (const ClientId page : pages_) events.opened(page);
}

void Preparation::opened(ClientId client) {
  const std::lock_guard lock(mutex_);
  pages_.insert(client);
  if (events_) events_->opened(client);
}

/// A page of an earlier run may ask for an image; it does so again once it knows this one.
void Preparation::received(ClientId client, std::string_view text) {
  const std::lock_guard lock(mutex_);
  if (events_) events_->received(client, text);
}

void Preparation::closed(ClientId client) {
  const std::lock_guard lock(mutex_);
  pages_.erase(client);
  if (events_) events_->closed(client);
}

}  // namespace redrive::view
