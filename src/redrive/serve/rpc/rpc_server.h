// SPDX-License-Identifier: Apache-2.0
// The gRPC server of a SensorService, in the library libredrive_grpc.so. It is registered under
// every name that the interface has had, and answers grpc.health.v1.
#pragma once

#include <memory>
#include <string>

#include "redrive/serve/sensor_service.h"

namespace redrive::serve {

struct RpcOptions {
  std::string listen = "127.0.0.1";  ///< IP address or host name
  int port = 0;                      ///< 0: any that is free
  std::string certificate, key;      ///< PEM for TLS; both empty: without
  std::string version;               ///< redrive's, for get_version
  int workers = 4;                   ///< requests in work at a time
};

class RpcServer {
 public:
  virtual ~RpcServer() = default;  ///< cancels what is in work and waits for it
  virtual int port() const = 0;
};

/// Starts it; null where it cannot listen. `service` must outlive it. One a process at a time.
using StartRpcServer = RpcServer*(const RpcOptions&, SensorService*);
extern "C" StartRpcServer redrive_start_grpc;

}  // namespace redrive::serve
