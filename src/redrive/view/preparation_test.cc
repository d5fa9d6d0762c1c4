// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/preparation.h"

#include <memory>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/progress.h"
#include "redrive/view/server/loopback_client_testing.h"

namespace redrive::view {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::StartsWith;

/// Answers each text with itself.
struct Echo : ServerEvents {
  Server* server = nullptr;
  std::vector<std::string> heard;
  void opened(ClientId) override { heard.emplace_back("opened"); }
  void received(ClientId id, std::string_view text) override {
    heard.emplace_back(text);
    server->send_text(id, nlohmann::json{{"kind", text}}.dump());
  }
  void closed(ClientId) override {}
};

nlohmann::json next(LoopbackClient& client) {
  const auto message = client.receive_message();
  return nlohmann::json::parse(message ? message->payload : "null");
}

// A page that is opened while images are decoded learns how many are, and then belongs to the
// viewer; before that nothing that it asks for reaches it.
TEST(Preparation, SaysWhatIsDoneAndHandsThePagesOver) {
  Echo viewer;
  Preparation preparation;
  ServerOptions options;
  options.token = "t";
  auto server = std::make_unique<Server>(options, &preparation);
  viewer.server = server.get();
  preparation.begin(*server);
  LoopbackClient client(server->port());
  const std::string host = "127.0.0.1:" + std::to_string(server->port());
  ASSERT_THAT(client.upgrade("/t/socket", host, "http://" + host), HasSubstr("101"));
  client.send_message("too early");
  nlohmann::json news;
  {
    Progress progress("decoding images", 4);
    progress.count();
    do {
      news = next(client);
    } while (news["text"] == "");
  }
  EXPECT_EQ(news["kind"], "preparing");
  EXPECT_THAT(news["text"].get<std::string>(), StartsWith("decoding images: 1 of 4"));
  EXPECT_EQ(news["share"], 0.25);
  preparation.hand_over(viewer);
  client.send_message("now");
  do {
    news = next(client);
  } while (news["kind"] == "preparing");
  EXPECT_EQ(news["kind"], "now");
  server.reset();
  EXPECT_THAT(viewer.heard, ElementsAre("opened", "now"));
}

}  // namespace
}  // namespace redrive::view
