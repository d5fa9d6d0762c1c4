// SPDX-License-Identifier: Apache-2.0
// For tests: a browser's side of HTTP and WebSocket over plain sockets, so that it can misbehave.
#pragma once

#include <arpa/inet.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

namespace redrive::view {

class LoopbackClient {
 public:
  explicit LoopbackClient(int port, int receive_buffer = 0, bool connects = true) : port_(port) {
    socket_ = ::socket(AF_INET, SOCK_STREAM, 0);
    if (receive_buffer > 0)
      ::setsockopt(socket_, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
    const timeval timeout{10, 0};
    ::setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof timeout);
    ::setsockopt(socket_, SOL_SOCKET, SO_SNDTIMEO, &timeout, sizeof timeout);
    if (connects) connect();
  }
  void connect() {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port_));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (::connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
      throw std::runtime_error("cannot connect");
  }
  ~LoopbackClient() { ::close(socket_); }
  LoopbackClient(const LoopbackClient&) = delete;
  LoopbackClient& operator=(const LoopbackClient&) = delete;

  /// Returns whether all bytes could be sent.
  bool send(const std::string& bytes) {
    for (std::size_t at = 0; at < bytes.size();) {
      const ssize_t n = ::send(socket_, bytes.data() + at, bytes.size() - at, MSG_NOSIGNAL);
      if (n <= 0) return false;
      at += static_cast<std::size_t>(n);
    }
    return true;
  }

  /// Sends a GET and returns the head and the body of the answer; empty if the server closes.
  std::string get(const std::string& target, const std::string& host,
                  const std::string& headers = "", const std::string& method = "GET") {
    send(method + " " + target + " HTTP/1.1\r\nHost: " + host + "\r\n" + headers + "\r\n");
    std::string answer;
    while (answer.find("\r\n\r\n") == std::string::npos)
      if (!receive(&answer)) return answer;
    const std::size_t head = answer.find("\r\n\r\n") + 4;
    const std::size_t length = answer.find("Content-Length: ");
    const std::size_t body =
        length < head && method != "HEAD" ? std::stoul(answer.substr(length + 16)) : 0;
    while (answer.size() < head + body)
      if (!receive(&answer)) return answer;
    left_ = answer.substr(head + body);
    return answer.substr(0, head + body);
  }

  /// Opens a WebSocket and returns the head of the answer.
  std::string upgrade(const std::string& target, const std::string& host,
                      const std::string& origin) {
    return get(target, host,
               "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
               "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n" +
                   (origin.empty() ? "" : "Origin: " + origin + "\r\n"));
  }

  /// Sends a message in one frame (RFC 6455), masked by zeros.
  bool send_message(const std::string& payload, int opcode = 1) {
    std::string frame(1, static_cast<char>(0x80 | opcode));
    if (payload.size() < 126) {
      frame += static_cast<char>(0x80 | payload.size());
    } else {
      const bool is_long = payload.size() >= 65536;
      frame += static_cast<char>(0x80 | (is_long ? 127 : 126));
      for (int shift = is_long ? 56 : 8; shift >= 0; shift -= 8)
        frame += static_cast<char>((payload.size() >> shift) & 255);
    }
    return send(frame + std::string(4, '\0') + payload);
  }

  struct Message {
    int opcode = 0;  ///< 1 text, 2 binary, 8 close
    std::string payload;
  };
  /// Returns the next message; pings are answered. Nothing if the server has gone.
  std::optional<Message> receive_message() {
    Message message;
    for (;;) {
      if (!need(2)) return std::nullopt;
      const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(left_[i]); };
      const int opcode = byte(0) & 15;
      const bool last = byte(0) & 128;
      std::size_t size = byte(1) & 127, head = 2;
      if (size >= 126) {
        const std::size_t extra = size == 126 ? 2 : 8;
        if (!need(2 + extra)) return std::nullopt;
        size = 0;
        for (std::size_t i = 0; i < extra; ++i) size = size << 8 | byte(2 + i);
        head += extra;
      }
      if (!need(head + size)) return std::nullopt;
      const std::string payload = left_.substr(head, size);
      left_.erase(0, head + size);
      if (opcode == 9) {
        send_message(payload, 10);
        continue;
      }
      if (opcode == 10) continue;
      if (opcode != 0) message.opcode = opcode;
      message.payload += payload;
      if (last) return message;
    }
  }

 private:
  bool receive(std::string* into) {
    char bytes[65536];
    const ssize_t n = ::recv(socket_, bytes, sizeof bytes, 0);
    if (n <= 0) return false;
    into->append(bytes, static_cast<std::size_t>(n));
    return true;
  }
  bool need(std::size_t size) {
    while (left_.size() < size)
      if (!receive(&left_)) return false;
    return true;
  }

  int port_ = 0, socket_ = -1;
  std::string left_;  ///< received, not yet read
};

}  // namespace redrive::view
