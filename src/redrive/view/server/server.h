// SPDX-License-Identifier: Apache-2.0
// The server of a page: HTTP for the page's files, a WebSocket for messages, whose contents it does
// not know. Boost.Beast stays within server.cc.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace redrive::view {

/// A file of the page.
struct PageFile {
  std::string_view name;        ///< after the token; "" is the page itself
  std::string_view type;        ///< Content-Type
  std::string_view gzip_bytes;  ///< compressed by gzip
};

struct ServerOptions {
  std::string listen = "127.0.0.1";  ///< IP address
  int port = 0;                      ///< 0: any that is free
  std::string token;
  std::span<const PageFile> page;
  std::size_t max_message_bytes = 4096;  ///< a client that sends more is closed
  int max_clients = 16;                  ///< WebSockets; more are refused
  int max_connections = 64;  ///< connections that have shown the token; more are refused
  int max_strangers = 32;    ///< connections that have not; another one ends the oldest of them
  int max_messages_per_second = 500;  ///< with pings and pongs; a client that sends more is closed
  int max_queued = 16;                ///< messages to a client that does not read
  int idle_seconds = 30;              ///< a client that does not answer pings is closed
};

using ClientId = std::uint64_t;

/// Called on the server's thread, one call at a time. Must return soon. An exception from a call is
/// printed and ends only its client.
class ServerEvents {
 public:
  virtual ~ServerEvents() = default;
  virtual void opened(ClientId client) = 0;
  virtual void received(ClientId client, std::string_view text) = 0;
  virtual void closed(ClientId client) = 0;
};

/// Serves from a thread of its own until it is destroyed. What is not the page of the token is
/// refused: 404 for another path or token, 403 for a foreign Host or Origin.
class Server {
 public:
  /// Listens. `events` must outlive the server. UsageError if the address cannot be used.
  Server(const ServerOptions& options, ServerEvents* events);
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  int port() const;
  std::string address() const;  ///< address of the page: "http://127.0.0.1:7007/TOKEN/"
  /// Returns the page's addresses for other machines; none where it listens only on loopback.
  std::vector<std::string> outside_addresses() const;

  /// Sends a message, from any thread. Nothing happens if the client has gone. A client with
  /// max_queued messages before this one is closed.
  void send_text(ClientId client, std::string text);
  void send_binary(ClientId client, std::string bytes);
  void close(ClientId client, std::string reason);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace redrive::view
