// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/view_server.h"

#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/view/access.h"
#include "redrive/view/messages.h"
#include "redrive/view/page.h"

namespace redrive {
namespace {

std::unique_ptr<view::Server> listen_at(view::ServerOptions server, int port,
                                        view::ServerEvents* events) {
  if (port >= 0) {
    server.port = port;
    return std::make_unique<view::Server>(server, events);
  }
  try {
    server.port = kUsualViewPort;
    return std::make_unique<view::Server>(server, events);
  } catch (const UsageError&) {
    server.port = 0;
    return std::make_unique<view::Server>(server, events);
  }
}

}  // namespace

void check_page(const std::string& option, const std::string& value) {
  if (view::page_files().empty())
    throw UsageError(option, value,
                     "this build has no page: node and npm were missing, or npm could not install; "
                     "scripts/setup and another build bring it");
}

void check_port(int port) {
  if (port <= 0) return;
  view::ServerOptions options;
  options.port = port;
  options.token = view::random_token();
  const view::Server server(options, nullptr);
}

std::unique_ptr<view::Server> start_view_server(const std::string& listen, int port,
                                                view::ServerEvents* events) {
  view::ServerOptions options;
  options.listen = listen;
  options.token = view::random_token();
  options.page = view::page_files();
  options.max_message_bytes = view::kMaxMessageBytes;
  auto server = listen_at(std::move(options), port, events);
  std::printf(
      "%s\nWhoever has this address sees the run, pauses its training and saves paths in it. "
      "Ctrl-C ends.\n",
      server->address().c_str());
  std::fflush(stdout);
  return server;
}

}  // namespace redrive
