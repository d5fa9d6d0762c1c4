// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/server/server.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <deque>
#include <functional>
#include <limits>
#include <list>
#include <map>
#include <optional>
#include <thread>
#include <utility>

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket.hpp>

#include "redrive/base/error.h"
#include "redrive/view/server/access.h"

namespace redrive::view {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
namespace websocket = beast::websocket;
using asio::ip::tcp;
using ErrorCode = beast::error_code;
using Request = http::request<http::empty_body>;

constexpr std::chrono::seconds kStrangerTimeout{3}, kRequestTimeout{10};
// delay before accepting again, for example without free descriptors
constexpr std::chrono::milliseconds kAcceptAgain{200};
constexpr std::uint32_t kMaxHeaderBytes = 8192;
constexpr std::size_t kHeadBytes = 14;         // bytes of a frame's head, at most
constexpr std::size_t kReadAhead = 64 * 1024;  // bytes of the next messages that a read may take

std::string_view view_of(beast::string_view text) { return {text.data(), text.size()}; }

/// State that all connections share. Only the server's thread uses it.
struct Shared {
  ServerOptions options;
  ServerEvents* events = nullptr;
  int known = 0;                                ///< connections that have shown the token
  int sockets = 0;                              ///< clients, with those that are not open yet
  std::list<class Connection*> strangers = {};  ///< connections that have not, the oldest first
  ClientId last_client = 0;
  std::map<ClientId, std::weak_ptr<class Client>> clients = {};
};

void report(const std::exception& error) {
  std::fprintf(stderr, "redrive: the viewer closed a connection: %s\n", error.what());
}

/// Reports the bytes that a stream reads, as its rate policy, without limiting them.
class Meter {
 public:
  explicit Meter(std::function<void(std::size_t)> on_read) : on_read_(std::move(on_read)) {}

 private:
  friend class beast::rate_policy_access;
  static constexpr std::size_t kAll = std::numeric_limits<std::size_t>::max();
  std::size_t available_read_bytes() const noexcept { return kAll; }
  std::size_t available_write_bytes() const noexcept { return kAll; }
  void transfer_read_bytes(std::size_t bytes) const { on_read_(bytes); }
  void transfer_write_bytes(std::size_t) const noexcept {}
  void on_timer() const noexcept {}

  std::function<void(std::size_t)> on_read_;
};
using MeteredStream = beast::basic_stream<tcp, asio::any_io_executor, Meter>;

/// A page's WebSocket.
class Client : public std::enable_shared_from_this<Client> {
 public:
  Client(tcp::socket socket, Shared* shared)
      : socket_(Meter([this](std::size_t bytes) { count(0, bytes); }), std::move(socket)),
        shared_(*shared),
        id_(++shared->last_client) {
    ++shared_.sockets;
  }

  ~Client() {
    --shared_.known;
    --shared_.sockets;
    if (shared_.clients.erase(id_) == 0) return;
    try {
      shared_.events->closed(id_);
    } catch (const std::exception& error) {
      report(error);
    }
  }

  void start(const Request& request) {
    beast::get_lowest_layer(socket_).expires_never();
    socket_.set_option(websocket::stream_base::timeout{
        kRequestTimeout, std::chrono::seconds(shared_.options.idle_seconds), true});
    socket_.read_message_max(shared_.options.max_message_bytes);
    socket_.control_callback([this](websocket::frame_type, beast::string_view) { count(1, 0); });
    socket_.async_accept(request, [self = shared_from_this()](ErrorCode error) {
      if (error) return;
      self->shared_.clients[self->id_] = self;
      self->shared_.events->opened(self->id_);
      self->read();
    });
  }

  void send(std::string bytes, bool binary) {
    if (closing_) return;
    if (queue_.size() >= static_cast<std::size_t>(shared_.options.max_queued))
      return close(websocket::close_code::policy_error, "does not read");
    queue_.push_back({std::move(bytes), binary});
    if (queue_.size() == 1) write();
  }

  void close(websocket::close_code code, const std::string& reason) {
    if (closing_) return;
    closing_ = true;
    socket_.async_close({code, reason.substr(0, 120)}, [self = shared_from_this()](ErrorCode) {});
  }

 private:
  struct Message {
    std::string bytes;
    bool binary;
  };

  void read() {
    socket_.async_read(buffer_, [self = shared_from_this()](ErrorCode error, std::size_t) {
      if (error || self->closing_) return;
      if (!self->socket_.got_text())
        return self->close(websocket::close_code::unknown_data, "texts only");
      const auto data = self->buffer_.cdata();
      self->unexplained_ -= std::min(self->unexplained_, data.size());
      self->count(1, 0);
      if (self->floods_) return;
      self->shared_.events->received(self->id_,
                                     {static_cast<const char*>(data.data()), data.size()});
      self->buffer_.consume(self->buffer_.size());
      self->read();
    });
  }

  /// Counts messages, and bytes that were read; closes the client where they are too many for a
  /// second. Frames without content belong to no message: their bytes remain.
  void count(int messages, std::size_t bytes) {
    const auto now = std::chrono::steady_clock::now();
    if (now - second_ >= std::chrono::seconds(1)) second_ = now, received_ = 0, unexplained_ = 0;
    received_ += messages;
    unexplained_ += bytes;
    const ServerOptions& options = shared_.options;
    const std::size_t most = options.max_message_bytes + kReadAhead +
                             kHeadBytes * static_cast<std::size_t>(options.max_messages_per_second);
    if (floods_ || (received_ <= options.max_messages_per_second && unexplained_ <= most)) return;
    floods_ = true;
    // Posted, so that it does not run within the read that counts.
    asio::post(socket_.get_executor(), [self = shared_from_this()] {
      self->close(websocket::close_code::policy_error, "too fast");
    });
  }

  void write() {
    socket_.binary(queue_.front().binary);
    socket_.async_write(asio::buffer(queue_.front().bytes),
                        [self = shared_from_this()](ErrorCode error, std::size_t) {
                          if (error) return;
                          self->queue_.pop_front();
                          if (!self->queue_.empty() && !self->closing_) self->write();
                        });
  }

  websocket::stream<MeteredStream> socket_;
  Shared& shared_;
  const ClientId id_;
  beast::flat_buffer buffer_;
  std::deque<Message> queue_;  ///< the first is being written
  std::chrono::steady_clock::time_point second_{};
  int received_ = 0;             ///< messages since second_
  std::size_t unexplained_ = 0;  ///< bytes since second_ that were in no message
  bool floods_ = false, closing_ = false;
};

/// A connection until it ends or becomes a Client.
class Connection : public std::enable_shared_from_this<Connection> {
 public:
  Connection(tcp::socket socket, Shared* shared) : stream_(std::move(socket)), shared_(*shared) {
    place_ = shared_.strangers.insert(shared_.strangers.end(), this);
  }
  ~Connection() {
    leave_strangers();
    if (known_ && !upgraded_) --shared_.known;
  }

  /// Ends the connection.
  void drop() {
    leave_strangers();
    stream_.close();
  }

  void read() {
    parser_.emplace();
    parser_->header_limit(kMaxHeaderBytes);
    parser_->body_limit(0);
    stream_.expires_after(known_ ? kRequestTimeout : kStrangerTimeout);
    http::async_read(stream_, buffer_, *parser_,
                     [self = shared_from_this()](ErrorCode error, std::size_t) {
                       if (!error) self->answer(self->parser_->release());
                     });
  }

 private:
  void answer(const Request& request) {
    const std::string_view host = view_of(request[http::field::host]);
    if (!is_own_host(host, shared_.options.listen))
      return refuse(request, http::status::forbidden, "another host\n");
    const Target target = parse_target(view_of(request.target()));
    if (!target.valid || !equal_in_constant_time(target.token, shared_.options.token))
      return refuse(request, http::status::not_found,
                    "no such page; redrive view prints the address with its token\n");
    if (!known_ && !become_known())
      return refuse(request, http::status::service_unavailable, "too many connections\n");
    const std::string_view origin = view_of(request[http::field::origin]);
    const bool is_socket = target.file == "socket";
    // Browsers send the origin of every WebSocket; a foreign page that guessed the token has none.
    if ((is_socket || !origin.empty()) && !is_own_origin(origin, host))
      return refuse(request, http::status::forbidden, "another origin\n");
    if (is_socket) return upgrade(request);
    if (request.method() != http::verb::get && request.method() != http::verb::head)
      return refuse(request, http::status::method_not_allowed, "only GET\n");
    for (const PageFile& file : shared_.options.page)
      if (file.name == target.file) return serve(request, file);
    refuse(request, http::status::not_found, "no such file\n");
  }

  void leave_strangers() {
    if (place_) shared_.strangers.erase(*std::exchange(place_, std::nullopt));
  }

  /// Takes one of the places for connections that have shown the token, if there is one.
  bool become_known() {
    if (shared_.known >= shared_.options.max_connections) return false;
    leave_strangers();
    ++shared_.known;
    return known_ = true;
  }

  void upgrade(const Request& request) {
    if (!websocket::is_upgrade(request))
      return refuse(request, http::status::upgrade_required, "a WebSocket\n");
    if (shared_.sockets >= shared_.options.max_clients)
      return refuse(request, http::status::service_unavailable, "too many viewers\n");
    upgraded_ = true;
    std::make_shared<Client>(stream_.release_socket(), &shared_)->start(request);
  }

  void serve(const Request& request, const PageFile& file) {
    auto response = make_response(request, http::status::ok, file.type);
    response.set(http::field::content_encoding, "gzip");
    response.body() = std::string(file.gzip_bytes);
    send(request, std::move(response));
  }

  void refuse(const Request& request, http::status status, const char* why) {
    auto response = make_response(request, status, "text/plain; charset=utf-8");
    response.keep_alive(false);
    response.body() = why;
    send(request, std::move(response));
  }

  static http::response<http::string_body> make_response(const Request& request,
                                                         http::status status,
                                                         std::string_view type) {
    http::response<http::string_body> response(status, request.version());
    response.keep_alive(request.keep_alive());
    response.set(http::field::content_type, beast::string_view(type.data(), type.size()));
    response.set(http::field::cache_control, "no-store");
    response.set(
        "Content-Security-Policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'");
    response.set("Cross-Origin-Resource-Policy", "same-origin");
    response.set("Referrer-Policy", "no-referrer");
    response.set("X-Content-Type-Options", "nosniff");
    return response;
  }

  void send(const Request& request, http::response<http::string_body> response) {
    response.prepare_payload();
    if (request.method() == http::verb::head) response.body().clear();
    auto kept = std::make_shared<http::response<http::string_body>>(std::move(response));
    stream_.expires_after(kRequestTimeout);
    http::async_write(stream_, *kept,
                      [self = shared_from_this(), kept](ErrorCode error, std::size_t) {
                        if (error) return;
                        if (!kept->keep_alive()) {
                          ErrorCode ignored;
                          self->stream_.socket().shutdown(tcp::socket::shutdown_send, ignored);
                          return;
                        }
                        self->read();
                      });
  }

  beast::tcp_stream stream_;
  Shared& shared_;
  std::optional<std::list<Connection*>::iterator> place_;  ///< among the strangers
  bool known_ = false, upgraded_ = false;
  beast::flat_buffer buffer_{kMaxHeaderBytes};
  std::optional<http::request_parser<http::empty_body>> parser_;
};

std::string page_address(std::string host, int port, const std::string& token) {
  if (host.find(':') != std::string::npos) host = "[" + host + "]";
  return "http://" + host + ":" + std::to_string(port) + "/" + token + "/";
}

}  // namespace

struct Server::Impl {
  Impl(const ServerOptions& options, ServerEvents* events) : shared{options, events} {
    const std::string named = options.listen + " port " + std::to_string(options.port);
    ErrorCode error;
    const auto address = asio::ip::make_address(options.listen, error);
    if (error) throw UsageError("--listen", options.listen, "must be an IP address");
    const tcp::endpoint endpoint(address, static_cast<unsigned short>(options.port));
    acceptor.open(endpoint.protocol(), error);
    if (!error) acceptor.set_option(asio::socket_base::reuse_address(true), error);
    if (!error) acceptor.bind(endpoint, error);
    if (!error) acceptor.listen(asio::socket_base::max_listen_connections, error);
    if (error) throw UsageError("--port", named, "cannot be listened on: " + error.message());
    port = acceptor.local_endpoint().port();
    accept();
    thread = std::thread([this] { run(); });
  }

  ~Impl() {
    context.stop();
    thread.join();
  }

  /// Serves until the context is stopped. An exception of a handler, such as lack of memory, ends
  /// only its own connection, which it held.
  void run() {
    for (;;) try {
        context.run();
        return;
      } catch (const std::exception& error) {
        report(error);
      }
  }

  void accept() {
    acceptor.async_accept([this](ErrorCode error, tcp::socket socket) {
      if (error == asio::error::operation_aborted) return;
      if (error) return pause();
      try {
        while (shared.strangers.size() >=
               static_cast<std::size_t>(std::max(1, shared.options.max_strangers)))
          shared.strangers.front()->drop();
        socket.set_option(tcp::no_delay(true), error);
        std::make_shared<Connection>(std::move(socket), &shared)->read();
      } catch (const std::exception&) {  // there is no memory for this one
      }
      accept();
    });
  }

  /// Accepts again later, for example when there are no descriptors. A stranger gives up its own.
  void pause() {
    if (!shared.strangers.empty()) shared.strangers.front()->drop();
    retry.expires_after(kAcceptAgain);
    retry.async_wait([this](ErrorCode) { accept(); });
  }

  /// Runs `action` on the client, on the server's thread, if it is still there.
  template <class Action>
  void on_client(ClientId id, Action action) {
    asio::post(context, [this, id, action = std::move(action)]() mutable {
      const auto found = shared.clients.find(id);
      if (found == shared.clients.end()) return;
      if (const auto client = found->second.lock()) action(*client);
    });
  }

  Shared shared;  // destroyed last: connections within `context` refer to it
  int port = 0;
  asio::io_context context{1};
  tcp::acceptor acceptor{context};
  asio::steady_timer retry{context};
  std::thread thread;
};

Server::Server(const ServerOptions& options, ServerEvents* events)
    : impl_(std::make_unique<Impl>(options, events)) {}
Server::~Server() = default;

int Server::port() const { return impl_->port; }

std::string Server::address() const {
  const ServerOptions& options = impl_->shared.options;
  const bool any = options.listen == "0.0.0.0" || options.listen == "::";
  return page_address(any ? "127.0.0.1" : options.listen, port(), options.token);
}

std::vector<std::string> Server::outside_addresses() const {
  std::vector<std::string> addresses;
  for (const std::string& host : outside_hosts(impl_->shared.options.listen))
    addresses.push_back(page_address(host, port(), impl_->shared.options.token));
  return addresses;
}

void Server::send_text(ClientId client, std::string text) {
  impl_->on_client(client, [text = std::move(text)](Client& to) mutable {
    to.send(std::move(text), /*binary=*/false);
  });
}

void Server::send_binary(ClientId client, std::string bytes) {
  impl_->on_client(client, [bytes = std::move(bytes)](Client& to) mutable {
    to.send(std::move(bytes), /*binary=*/true);
  });
}

void Server::close(ClientId client, std::string reason) {
  impl_->on_client(client, [reason = std::move(reason)](Client& to) {
    to.close(websocket::close_code::policy_error, reason);
  });
}

}  // namespace redrive::view
