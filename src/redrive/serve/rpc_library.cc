// SPDX-License-Identifier: Apache-2.0
#include "redrive/serve/rpc_library.h"

#include <dlfcn.h>

#include "redrive/base/error.h"
#include "redrive/base/processes/own_library.h"

namespace redrive::serve {
namespace {

constexpr const char* kLibrary = "libredrive_grpc.so";

StartRpcServer* find_start() {
  std::string why;
  void* const library = load_own_library(kLibrary, RTLD_NOW | RTLD_LOCAL, &why);
  if (library)
    if (void* const start = dlsym(library, "redrive_start_grpc"))
      return reinterpret_cast<StartRpcServer*>(start);
  if (why.empty())
    why = std::string("this build has no ") + kLibrary +
          ", which needs gRPC when it is built (Debian: libgrpc++-dev, libprotobuf-dev, "
          "protobuf-compiler); installed, it is the package redrive-serve";
  throw UsageError("serve", "", why);
}

}  // namespace

std::unique_ptr<RpcServer> start_rpc_server(const RpcOptions& options, SensorService* service) {
  std::unique_ptr<RpcServer> server(find_start()(options, service));
  if (!server)
    throw UsageError("--listen", options.listen + ", --port " + std::to_string(options.port),
                     "cannot be listened on: the port is taken, the address is not this machine's, "
                     "or --certificate and --key are no PEM files that belong together");
  return server;
}

}  // namespace redrive::serve
