// SPDX-License-Identifier: Apache-2.0
// The server over loopback: what it serves, what it refuses, and clients that misbehave.
#include "redrive/view/server/server.h"

#include <sys/resource.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <chrono>
#include <ctime>
#include <mutex>
#include <new>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/view/server/loopback_client_testing.h"

namespace redrive::view {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;
using ::testing::StartsWith;

/// Collects what clients send and echoes it.
class EchoEvents : public ServerEvents {
 public:
  void opened(ClientId) override { ++open; }
  void received(ClientId client, std::string_view text) override {
    if (text == "throw") throw std::bad_alloc();
    ++messages;
    last = client;
    if (server) server.load()->send_text(client, "echo " + std::string(text));
  }
  void closed(ClientId) override {
    --open;
    if (throws_when_closed) throw std::bad_alloc();
  }

  std::atomic<Server*> server{nullptr};
  std::atomic<int> open{0}, messages{0};
  std::atomic<ClientId> last{0};
  std::atomic<bool> throws_when_closed{false};
};

class ServerTest : public testing::Test {
 protected:
  ServerTest() { start(); }

  void start() {
    events_.server = nullptr;
    server_.reset();
    options_.token = "0123456789abcdef";
    options_.page = page_;
    server_ = std::make_unique<Server>(options_, &events_);
    events_.server = server_.get();
    host_ = "127.0.0.1:" + std::to_string(server_->port());
  }

  std::string get(const std::string& target, const std::string& headers = "") {
    return LoopbackClient(server_->port()).get(target, host_, headers);
  }
  std::unique_ptr<LoopbackClient> open_socket(int receive_buffer = 0) {
    auto client = std::make_unique<LoopbackClient>(server_->port(), receive_buffer);
    EXPECT_THAT(client->upgrade("/0123456789abcdef/socket", host_, "http://" + host_),
                StartsWith("HTTP/1.1 101"));
    return client;
  }
  /// Whether `condition` comes true within ten seconds.
  static bool comes(const std::function<bool()>& condition) {
    for (int i = 0; i < 1000 && !condition(); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return condition();
  }
  void expect_service() {
    const auto client = open_socket();
    client->send_message("hello");
    const auto answer = client->receive_message();
    ASSERT_TRUE(answer);
    EXPECT_EQ(answer->payload, "echo hello");
  }

  const std::array<PageFile, 2> page_ = {PageFile{"", "text/html", "PAGE"},
                                         PageFile{"a.js", "text/javascript", "SCRIPT"}};
  ServerOptions options_;
  EchoEvents events_;
  std::unique_ptr<Server> server_;
  std::string host_;
};

TEST_F(ServerTest, ServesThePageOfItsToken) {
  EXPECT_EQ(server_->address(), "http://" + host_ + "/0123456789abcdef/");
  const std::string page = get("/0123456789abcdef/");
  EXPECT_THAT(page, StartsWith("HTTP/1.1 200"));
  EXPECT_THAT(page, HasSubstr("Content-Encoding: gzip"));
  EXPECT_THAT(page, HasSubstr("Content-Security-Policy: default-src 'none'"));
  EXPECT_THAT(page, HasSubstr("\r\n\r\nPAGE"));
  EXPECT_THAT(get("/0123456789abcdef/a.js"), HasSubstr("SCRIPT"));
  LoopbackClient kept(server_->port());  // two requests on one connection
  EXPECT_THAT(kept.get("/0123456789abcdef/", host_), HasSubstr("PAGE"));
  EXPECT_THAT(kept.get("/0123456789abcdef/a.js", host_), HasSubstr("SCRIPT"));
  EXPECT_THAT(LoopbackClient(server_->port()).get("/0123456789abcdef/", host_, "", "HEAD"),
              Not(HasSubstr("PAGE")));
}

TEST_F(ServerTest, RefusesAllElse) {
  for (const char* target :
       {"/", "/0123456789abcdef", "/0123456789abcdee/", "/x/", "//", "/0123456789abcdef/b.js",
        "/0123456789abcdef/../a.js", "/0123456789abcdef/socket/x", "/x/socket"})
    EXPECT_THAT(get(target), AllOf(StartsWith("HTTP/1.1 404"), Not(HasSubstr("PAGE")))) << target;
  EXPECT_THAT(get("/0123456789abcdef/socket", "Origin: http://" + host_ + "\r\n"),
              StartsWith("HTTP/1.1 426"));
  EXPECT_THAT(LoopbackClient(server_->port()).get("/0123456789abcdef/", host_, "", "DELETE"),
              StartsWith("HTTP/1.1 405"));
}

TEST_F(ServerTest, RefusesForeignHostsAndOrigins) {
  for (const char* host : {"example.org", "example.org:7007", ""})
    EXPECT_THAT(LoopbackClient(server_->port()).get("/0123456789abcdef/", host),
                StartsWith("HTTP/1.1 403"))
        << host;
  EXPECT_THAT(get("/0123456789abcdef/", "Origin: http://example.org\r\n"),
              StartsWith("HTTP/1.1 403"));
  for (const char* origin : {"", "null", "http://example.org"})
    EXPECT_THAT(LoopbackClient(server_->port()).upgrade("/0123456789abcdef/socket", host_, origin),
                StartsWith("HTTP/1.1 403"))
        << origin;
  EXPECT_THAT(LoopbackClient(server_->port()).upgrade("/wrong/socket", host_, "http://" + host_),
              StartsWith("HTTP/1.1 404"));
  EXPECT_EQ(events_.open, 0);
}

TEST_F(ServerTest, CarriesMessagesBothWays) {
  const auto client = open_socket();
  client->send_message("a");
  EXPECT_EQ(client->receive_message()->payload, "echo a");
  const std::string bytes(1 << 20, 'x');
  server_->send_binary(events_.last, bytes);
  const auto message = client->receive_message();
  ASSERT_TRUE(message);
  EXPECT_EQ(message->opcode, 2);
  EXPECT_EQ(message->payload, bytes);
  server_->send_text(events_.last + 100, "to nobody");
}

TEST_F(ServerTest, ClosesClientsThatSendWhatNobodyAskedFor) {
  for (const auto& [payload, opcode] : std::vector<std::pair<std::string, int>>{
           {std::string(5000, 'x'), 1}, {"binary", 2}, {"reserved", 5}}) {
    const auto client = open_socket();
    client->send_message(payload, opcode);
    const auto answer = client->receive_message();
    EXPECT_TRUE(!answer || answer->opcode == 8) << opcode;
  }
  LoopbackClient noise(server_->port());
  noise.send(std::string(100000, 'x'));  // no HTTP, and longer than any header
  EXPECT_EQ(events_.messages, 0);
  EXPECT_TRUE(comes([&] { return events_.open == 0; }));
  expect_service();
}

TEST_F(ServerTest, ClosesAFlood) {
  options_.max_messages_per_second = 50;
  start();
  auto client = open_socket();
  for (int i = 0; i < 2000 && client->send_message("x"); ++i) {
  }
  std::optional<LoopbackClient::Message> message;
  do message = client->receive_message();
  while (message && message->opcode != 8);
  EXPECT_LE(events_.messages, 50);
  client.reset();
  EXPECT_TRUE(comes([&] { return events_.open == 0; }));
  expect_service();
}

TEST_F(ServerTest, DropsAClientThatDoesNotRead) {
  options_.idle_seconds = 2;
  start();
  const auto stalled = open_socket(/*receive_buffer=*/4096);
  stalled->send_message("x");
  ASSERT_TRUE(comes([&] { return events_.last != 0; }));
  const std::string bytes(1 << 20, 'x');
  for (int i = 0; i < 100; ++i) server_->send_binary(events_.last, bytes);
  expect_service();  // others are served meanwhile
  EXPECT_TRUE(comes([&] { return events_.open == 0; })) << "the stalled client is still there";
}

TEST_F(ServerTest, OutlivesClientsThatVanish) {
  for (int i = 0; i < 20; ++i) {
    const auto client = open_socket();
    client->send_message("x");  // and is gone before the answer
  }
  {
    LoopbackClient half(server_->port());
    half.send("GET /0123456789abcdef/ HTT");
  }
  EXPECT_TRUE(comes([&] { return events_.open == 0; }));
  expect_service();
}

TEST_F(ServerTest, LimitsClientsAndConnections) {
  options_.max_clients = 2;
  options_.max_connections = 3;
  start();
  const auto one = open_socket(), two = open_socket();
  EXPECT_THAT(
      LoopbackClient(server_->port()).upgrade("/0123456789abcdef/socket", host_, "http://" + host_),
      StartsWith("HTTP/1.1 503"));
  LoopbackClient third(server_->port());
  EXPECT_THAT(third.get("/0123456789abcdef/", host_), StartsWith("HTTP/1.1 200"));
  EXPECT_TRUE(comes([&] { return get("/0123456789abcdef/").starts_with("HTTP/1.1 503"); }));
}

TEST_F(ServerTest, StrangersLockNobodyOut) {
  std::vector<std::unique_ptr<LoopbackClient>> strangers;
  for (int i = 0; i < 200; ++i) {
    strangers.push_back(std::make_unique<LoopbackClient>(server_->port()));
    strangers.back()->send("GET /");  // and no more
    if (i % 20 == 19) {
      EXPECT_THAT(get("/0123456789abcdef/"), StartsWith("HTTP/1.1 200")) << i;
    }
  }
  expect_service();
}

TEST_F(ServerTest, AHandlerThatThrowsCostsItsClientAlone) {
  const auto bystander = open_socket();
  auto client = open_socket();
  client->send_message("throw");
  EXPECT_FALSE(client->receive_message());
  client.reset();
  EXPECT_TRUE(comes([&] { return events_.open == 1; }));
  bystander->send_message("x");
  EXPECT_EQ(bystander->receive_message()->payload, "echo x");
  expect_service();
}

TEST_F(ServerTest, OutlivesAnEventOfAClosedClientThatThrows) {
  events_.throws_when_closed = true;
  open_socket().reset();
  EXPECT_TRUE(comes([&] { return events_.open == 0; }));
  expect_service();
}

TEST_F(ServerTest, LimitsClientsThatComeAtOnce) {
  options_.max_clients = 2;
  start();
  std::vector<std::unique_ptr<LoopbackClient>> clients;
  for (int i = 0; i < 12; ++i) clients.push_back(std::make_unique<LoopbackClient>(server_->port()));
  std::atomic<int> opened = 0;
  std::vector<std::thread> threads;
  for (const auto& client : clients)
    threads.emplace_back([&] {
      opened += client->upgrade("/0123456789abcdef/socket", host_, "http://" + host_)
                    .starts_with("HTTP/1.1 101");
    });
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(opened, 2);
}

TEST_F(ServerTest, PingsAndFramesWithoutContentCount) {
  options_.max_messages_per_second = 50;
  start();
  const auto flood = [](LoopbackClient& client, const std::string& frame) {
    std::string frames;
    for (int i = 0; i < 100; ++i) frames += frame;
    for (int i = 0; i < 1000 && client.send(frames); ++i) {
    }
    std::optional<LoopbackClient::Message> message;
    do message = client.receive_message();
    while (message && message->opcode != 8);
    client.send(frames);
  };
  const std::string mask(4, '\0');
  auto pings = open_socket(), empty = open_socket();
  empty->send(std::string("\x01\x80", 2) + mask);  // the first frame of a text that goes on
  flood(*pings, std::string("\x89\x80", 2) + mask);
  flood(*empty, std::string("\x00\x80", 2) + mask);
  EXPECT_FALSE(pings->receive_message());  // both wait for the answer to a close at once
  EXPECT_FALSE(empty->receive_message());
  EXPECT_EQ(events_.messages, 0);
  pings.reset();
  empty.reset();
  EXPECT_TRUE(comes([&] { return events_.open == 0; }));
  expect_service();
}

TEST_F(ServerTest, WaitsForDescriptors) {
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_NOFILE, &before), 0);
  auto owner = open_socket();
  LoopbackClient late(server_->port(), 0, /*connects=*/false);
  std::vector<int> taken;
  for (int file = 0; (file = dup(STDERR_FILENO)) >= 0 && file < 200;) taken.push_back(file);
  rlimit low = before;
  low.rlim_cur = static_cast<rlim_t>(taken.back());  // not one more
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &low), 0);
  late.connect();
  const clock_t start = clock();
  owner->send_message("x");
  EXPECT_EQ(owner->receive_message()->payload, "echo x");
  std::this_thread::sleep_for(std::chrono::seconds(1));
  EXPECT_LT(static_cast<double>(clock() - start) / CLOCKS_PER_SEC, 0.5) << "it waits, idle";
  ASSERT_EQ(setrlimit(RLIMIT_NOFILE, &before), 0);
  for (const int file : taken) close(file);
  EXPECT_THAT(late.get("/0123456789abcdef/", host_), StartsWith("HTTP/1.1 200"));
}

TEST_F(ServerTest, NamesItsAddressesForOtherMachines) {
  EXPECT_TRUE(server_->outside_addresses().empty());
  options_.listen = "0.0.0.0";
  start();
  EXPECT_THAT(server_->address(), StartsWith("http://127.0.0.1:"));
  for (const std::string& address : server_->outside_addresses()) {
    EXPECT_THAT(address, AllOf(StartsWith("http://"), Not(HasSubstr("0.0.0.0")),
                               Not(HasSubstr("127.0.0.1"))));
    EXPECT_TRUE(address.ends_with(":" + std::to_string(server_->port()) + "/0123456789abcdef/"));
  }
}

TEST_F(ServerTest, SaysWhereItCannotListen) {
  ServerOptions other = options_;
  other.port = server_->port();
  EXPECT_THROW(Server(other, &events_), UsageError);
  other.listen = "no address";
  EXPECT_THROW(Server(other, &events_), UsageError);
}

TEST_F(ServerTest, EndsWithClientsConnected) {
  const auto client = open_socket();
  server_.reset();
  EXPECT_FALSE(client->receive_message());
  EXPECT_EQ(events_.open, 0);
}

}  // namespace
}  // namespace redrive::view
