// SPDX-License-Identifier: Apache-2.0
// redrive serve: renders for AlpaSim and CARLA.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/memory_limit.h"
#include "redrive/base/processes/interruption.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/help.h"
#include "redrive/serve/rpc_library.h"
#include "redrive/serve/run_service.h"

namespace redrive {
namespace {

struct ServeOptions {
  std::vector<std::filesystem::path> runs;
  std::filesystem::path certificate, key;
  serve::RpcOptions rpc{.port = 46435};
  std::string memory = TrainOptions().memory;
  kernels::BackendChoice backend;
};

int run_serve(const ServeOptions& options) {
  if (options.certificate.empty() != options.key.empty())
    throw UsageError(options.key.empty() ? "--certificate" : "--key", "",
                     "--certificate and --key belong together");
  TrainOptions limits;
  limits.memory = options.memory;
  serve::SceneStore store(options.runs, options.backend, allowed_memory(limits, memory_bytes()));
  serve::RunService service(&store);
  serve::RpcOptions rpc = options.rpc;
  rpc.version = REDRIVE_VERSION;
  rpc.workers = std::max(4, hardware_threads() + 2);
  if (!options.certificate.empty()) {
    rpc.certificate = read_file(options.certificate);
    rpc.key = read_file(options.key);
  }
  const std::atomic<bool>& stop = stop_on_signal();
  const std::unique_ptr<serve::RpcServer> server = serve::start_rpc_server(rpc, &service);
  const bool outside =
      !rpc.listen.starts_with("127.") && rpc.listen != "::1" && rpc.listen != "localhost";
  if (outside && rpc.certificate.empty())
    std::fprintf(stderr,
                 "redrive: --listen %s lets other machines in, without encryption; --certificate "
                 "and --key encrypt\n",
                 rpc.listen.c_str());
  for (const std::string& why : store.left_out())
    std::fprintf(stderr, "redrive: left out: %s\n", why.c_str());
  for (const std::string& id : store.ids()) std::printf("scene %s\n", id.c_str());
  std::printf("serving at %s:%d. Ctrl-C ends.\n", rpc.listen.c_str(), server->port());
  std::fflush(stdout);
  while (!stop) std::this_thread::sleep_for(std::chrono::milliseconds(50));
  return kExitOk;
}

}  // namespace

Action configure_serve(CLI::App& command) {
  auto options = std::make_shared<ServeOptions>();
  command
      .add_option("RUN", options->runs,
                  "run folders, scene bundles (.usdz), or folders that have some")
      ->required();
  command.add_option("--port", options->rpc.port, "port to listen on, 0: any that is free")
      ->capture_default_str()
      ->check(within("--port", 0, 65535));
  command
      .add_option("--listen", options->rpc.listen,
                  "IP address to listen on; 0.0.0.0 lets other machines in")
      ->capture_default_str();
  command.add_option("--certificate", options->certificate, "the server's certificate, for TLS");
  command.add_option("--key", options->key, "its key");
  add_train_option(command, "memory", &options->memory,
                   "memory that opened scenes may take together; those not used for longest are "
                   "closed: bytes, a number of GiB such as 6GiB, or a percentage");
  add_backend_options(command, &options->backend);
  return [options] { return run_serve(*options); };
}

}  // namespace redrive
