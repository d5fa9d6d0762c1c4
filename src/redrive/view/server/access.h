// SPDX-License-Identifier: Apache-2.0
// Access to the page: whoever knows the token in its address, from a page of this server.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace redrive::view {

/// Returns 128 random bits of the system as 32 hexadecimal digits.
std::string random_token();

/// Compares in a time that depends only on the sizes.
bool equal_in_constant_time(std::string_view a, std::string_view b);

/// Whether a request's Host names this server: `localhost`, an IP address, or `listen`, each with
/// any port (ssh forwards others). Another name may be DNS rebinding: a foreign page whose name
/// was made to point here.
bool is_own_host(std::string_view host, std::string_view listen);

/// Whether the Origin of a request is the page that `host` served.
bool is_own_origin(std::string_view origin, std::string_view host);

/// Returns the addresses under which other machines reach a server that listens on `listen`, an IP
/// address: the addresses of all interfaces for 0.0.0.0 and ::, none for loopback.
std::vector<std::string> outside_hosts(const std::string& listen);

/// The parts of a request's target: the token, and the rest ("" for the page itself). Nothing for a
/// target of another form.
struct Target {
  std::string_view token, file;
  bool valid = false;
};
Target parse_target(std::string_view target);

}  // namespace redrive::view
