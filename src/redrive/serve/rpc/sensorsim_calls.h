// SPDX-License-Identifier: Apache-2.0
// The methods of the sensorsim interface: bytes of a request to bytes of a reply.
#pragma once

#include <array>
#include <string>
#include <string_view>

#include "redrive/serve/rpc/rpc_server.h"

namespace redrive::serve {

/// The names that the service has had; the messages are the same.
constexpr std::array<std::string_view, 3> kServiceNames{
    "nre.grpc.protos.sensorsim.SensorsimService", "sensorsim.SensorsimService",
    "nurec.grpc.protos.sensorsim.SensorsimService"};

/// Answers a call of the method at `path`, "/SERVICE/METHOD". RequestError.
std::string answer_call(std::string_view path, const std::string& request,
                        const RpcOptions& options, SensorService* service,
                        const Cancelled& cancelled);

}  // namespace redrive::serve
