// SPDX-License-Identifier: Apache-2.0
// Loads the library of the gRPC server, so that nothing else needs gRPC.
#pragma once

#include <memory>

#include "redrive/serve/rpc/rpc_server.h"

namespace redrive::serve {

/// UsageError where there is no server, or where it cannot listen.
std::unique_ptr<RpcServer> start_rpc_server(const RpcOptions& options, SensorService* service);

}  // namespace redrive::serve
