// SPDX-License-Identifier: Apache-2.0
// Code that view, train --view and resume --view share: the server of the viewer's page.
#pragma once

#include <memory>
#include <string>

#include <CLI/App.hpp>

#include "redrive/view/server/redirect_file.h"
#include "redrive/view/server/server.h"

namespace redrive {

/// Where the page is served. `port` below 0: the default port, or another one if that is taken.
struct ViewServerOptions {
  std::string listen = "127.0.0.1";
  int port = -1;
  bool open = false;  ///< opens the address in the user's browser
};

/// Adds --listen, --port and --open; with `needed`, all of them need this option.
void add_view_server_options(CLI::App& command, ViewServerOptions* options,
                             CLI::Option* needed = nullptr);

/// Throws UsageError where this build has no page. `option` and `value` are for the message.
void check_page(const std::string& option, const std::string& value);

/// Throws UsageError where the server could not listen.
void check_address(const ViewServerOptions& options);

/// The server of a page, and the file that --open opened in a browser.
struct ViewServer {
  std::unique_ptr<view::Server> server;
  std::unique_ptr<view::RedirectFile> redirect;
};

/// Listens, prints the address and opens it. Throws UsageError as view::Server.
ViewServer start_view_server(const ViewServerOptions& options, view::ServerEvents* events);

}  // namespace redrive
