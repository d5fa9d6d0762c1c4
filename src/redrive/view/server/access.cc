// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/server/access.h"

#include <arpa/inet.h>
#include <ifaddrs.h>
#include <net/if.h>
#include <sys/random.h>

#include <algorithm>
#include <array>
#include <cctype>

#include "redrive/base/error.h"

namespace redrive::view {
namespace {

/// Returns the name in "name:port" and "[address]:port".
std::string_view without_port(std::string_view host) {
  if (host.starts_with('[')) {
    const std::size_t end = host.find(']');
    return end == std::string_view::npos ? std::string_view{} : host.substr(1, end - 1);
  }
  return host.substr(0, host.find(':'));
}

bool is_ip_address(const std::string& name) {
  std::array<unsigned char, sizeof(in6_addr)> address;
  return inet_pton(AF_INET, name.c_str(), address.data()) == 1 ||
         inet_pton(AF_INET6, name.c_str(), address.data()) == 1;
}

/// Returns the IP address of an active interface that other machines may reach; empty otherwise.
std::string host_of(const ifaddrs& interface) {
  if (!interface.ifa_addr || !(interface.ifa_flags & IFF_UP) ||
      (interface.ifa_flags & IFF_LOOPBACK))
    return "";
  const int family = interface.ifa_addr->sa_family;
  const void* address = nullptr;
  if (family == AF_INET)
    address = &reinterpret_cast<const sockaddr_in*>(interface.ifa_addr)->sin_addr;
  if (family == AF_INET6) {
    const in6_addr& six = reinterpret_cast<const sockaddr_in6*>(interface.ifa_addr)->sin6_addr;
    // link-local ones need the name of an interface
    if (!IN6_IS_ADDR_LINKLOCAL(&six)) address = &six;
  }
  std::array<char, INET6_ADDRSTRLEN> text{};
  return address && inet_ntop(family, address, text.data(), text.size()) ? text.data() : "";
}

}  // namespace

std::string random_token() {
  std::array<unsigned char, 16> bytes;
  if (getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size()))
    throw IoError("/dev/urandom", "the system gives no random numbers");
  std::string token;
  for (const unsigned char byte : bytes)
    for (const int digit : {byte >> 4, byte & 15}) token += "0123456789abcdef"[digit];
  return token;
}

bool equal_in_constant_time(std::string_view a, std::string_view b) {
  if (a.size() != b.size()) return false;
  volatile unsigned char differs = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    differs = differs | static_cast<unsigned char>(a[i] ^ b[i]);
  return differs == 0;
}

bool is_own_host(std::string_view host, std::string_view listen) {
  std::string name(without_port(host));
  std::ranges::transform(name, name.begin(), [](unsigned char c) { return std::tolower(c); });
  return !name.empty() && (name == "localhost" || name == listen || is_ip_address(name));
}

bool is_own_origin(std::string_view origin, std::string_view host) {
  constexpr std::string_view scheme = "http://";
  return !host.empty() && origin.starts_with(scheme) && origin.substr(scheme.size()) == host;
}

std::vector<std::string> outside_hosts(const std::string& listen) {
  if (listen.starts_with("127.") || listen == "::1") return {};
  if (listen != "0.0.0.0" && listen != "::") return {listen};
  std::vector<std::string> hosts;
  ifaddrs* all = nullptr;
  if (getifaddrs(&all) != 0) return {};
  for (const ifaddrs* interface = all; interface; interface = interface->ifa_next)
    if (const std::string host = host_of(*interface);
        !host.empty() && (listen == "::" || host.find(':') == std::string::npos))
      hosts.push_back(host);
  freeifaddrs(all);
  return hosts;
}

Target parse_target(std::string_view target) {
  if (!target.starts_with('/')) return {};
  target = target.substr(1, target.find('?') == std::string_view::npos ? std::string_view::npos
                                                                       : target.find('?') - 1);
  const std::size_t slash = target.find('/');
  if (slash == std::string_view::npos) return {};
  return {target.substr(0, slash), target.substr(slash + 1), true};
}

}  // namespace redrive::view
