// SPDX-License-Identifier: Apache-2.0
// Code that view and train --view share: the server of the viewer's page.
#pragma once

#include <memory>
#include <string>

#include "redrive/view/server.h"

namespace redrive {

constexpr int kUsualViewPort = 7007;

/// Throws UsageError where this build has no page. `option` and `value` are for the message.
void check_page(const std::string& option, const std::string& value);

/// Throws UsageError where `port` is taken. Below 1 there is nothing to check.
void check_port(int port);

/// Listens on `port`; below 0 on the usual port, or another one if that is taken. Prints the
/// address. Throws UsageError as view::Server.
std::unique_ptr<view::Server> start_view_server(const std::string& listen, int port,
                                                view::ServerEvents* events);

}  // namespace redrive
