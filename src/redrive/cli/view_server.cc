// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/view_server.h"

#include <fcntl.h>
#include <spawn.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/cli/help.h"
#include "redrive/view/page.h"
#include "redrive/view/server/access.h"
#include "redrive/view/server/messages.h"

namespace redrive {
namespace {

constexpr int kUsualViewPort = 7007;

/// Opens a file in the user's browser, if there is xdg-open.
void open_browser(const std::string& file) {
  std::string program = "xdg-open", argument = file;
  const std::array<char*, 3> arguments = {program.data(), argument.data(), nullptr};
  posix_spawn_file_actions_t quiet;
  posix_spawn_file_actions_init(&quiet);
  for (const int output : {STDOUT_FILENO, STDERR_FILENO})
    posix_spawn_file_actions_addopen(&quiet, output, "/dev/null", O_WRONLY, 0);
  pid_t child = 0;
  if (posix_spawnp(&child, program.c_str(), &quiet, nullptr, arguments.data(), environ) != 0)
    std::fprintf(stderr, "redrive: --open: there is no xdg-open; open the address yourself\n");
  posix_spawn_file_actions_destroy(&quiet);
}

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

void add_view_server_options(CLI::App& command, ViewServerOptions* options, CLI::Option* needed) {
  const std::string with = needed ? "with " + needed->get_name() + ": " : "";
  CLI::Option* const own[] = {
      command
          .add_option("--port", options->port,
                      with + "port to listen on, 0: any that is free (default: " +
                          std::to_string(kUsualViewPort) + ", or any if that is taken)")
          ->check(within("--port", 0, 65535)),
      command
          .add_option("--listen", options->listen,
                      with + "IP address to listen on; 0.0.0.0 lets other machines in, without "
                             "encryption")
          ->capture_default_str(),
      command.add_flag("--open", options->open, with + "opens the address in a browser")};
  if (!needed) return;
  for (CLI::Option* option : own) option->needs(needed);
}

void check_page(const std::string& option, const std::string& value) {
  if (view::page_files().empty())
    throw UsageError(option, value,
                     "this build has no page: node and npm were missing, or npm could not install; "
                     "scripts/setup and another build bring it");
}

void check_address(const ViewServerOptions& options) {
  view::ServerOptions server;
  server.listen = options.listen;
  server.port = std::max(0, options.port);
  server.token = view::random_token();
  const view::Server listens(server, nullptr);
}

ViewServer start_view_server(const ViewServerOptions& options, view::ServerEvents* events) {
  view::ServerOptions with_page;
  with_page.listen = options.listen;
  with_page.token = view::random_token();
  with_page.page = view::page_files();
  with_page.max_message_bytes = view::kMaxMessageBytes;
  ViewServer started{listen_at(std::move(with_page), options.port, events), nullptr};
  const view::Server& server = *started.server;
  std::vector<std::string> addresses = server.outside_addresses();
  if (!addresses.empty())
    std::fprintf(stderr,
                 "redrive: --listen %s lets other machines in, without encryption: whoever sees "
                 "the traffic on its way learns the address below\n",
                 options.listen.c_str());
  if (std::ranges::find(addresses, server.address()) == addresses.end())
    addresses.push_back(server.address());
  for (const std::string& address : addresses) std::printf("%s\n", address.c_str());
  std::printf(
      "Whoever has this address sees the run, pauses its training and saves paths in it. Ctrl-C "
      "ends.\n");
  std::fflush(stdout);
  if (options.open) try {
      started.redirect = std::make_unique<view::RedirectFile>(server.address());
      open_browser(started.redirect->path().string());
    } catch (const IoError& error) {
      std::fprintf(stderr, "redrive: --open: %s; open the address yourself\n", error.what());
    }
  return started;
}

}  // namespace redrive
