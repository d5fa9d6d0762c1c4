// SPDX-License-Identifier: Apache-2.0
// A generic service, which gets the bytes of any method: one handler serves all names.
#include "redrive/serve/rpc/rpc_server.h"

#include <atomic>
#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include <google/protobuf/stubs/logging.h>
#include <grpc/support/log.h>
#include <grpcpp/ext/health_check_service_server_builder_option.h>
#include <grpcpp/generic/async_generic_service.h>
#include <grpcpp/health_check_service_interface.h>
#include <grpcpp/security/server_credentials.h>
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>

#include "redrive/serve/rpc/sensorsim_calls.h"

namespace redrive::serve {
namespace {

/// Most requests that wait for a worker. Each has kMaxRequestBytes at most.
constexpr std::size_t kMaxWaiting = 64;

std::string bytes_of(const grpc::ByteBuffer& buffer) {
  std::vector<grpc::Slice> slices;
  std::string bytes;
  if (!buffer.Dump(&slices).ok()) return bytes;
  bytes.reserve(buffer.Length());
  for (const grpc::Slice& slice : slices)
    bytes.append(reinterpret_cast<const char*>(slice.begin()), slice.size());
  return bytes;
}

/// Returns a buffer that owns the text.
grpc::ByteBuffer buffer_of(std::string&& text) {
  auto* const kept = new std::string(std::move(text));
  const grpc::Slice slice(
      kept->data(), kept->size(), [](void* data) { delete static_cast<std::string*>(data); }, kept);
  return {&slice, 1};
}

class PendingCall;

/// Calls that wait, and the threads that answer them.
class Workers {
 public:
  Workers(const RpcOptions& options, SensorService* service)
      : options_(options), service_(*service) {
    for (int i = 0; i < options.workers; ++i) threads_.emplace_back([this] { work(); });
  }
  /// All calls must have ended.
  ~Workers() {
    {
      const std::lock_guard lock(mutex_);
      ends_ = true;
    }
    changed_.notify_all();
    for (std::thread& thread : threads_) thread.join();
  }
  /// Returns whether there was room.
  bool add(PendingCall* call) {
    {
      const std::lock_guard lock(mutex_);
      if (waiting_.size() >= kMaxWaiting) return false;
      waiting_.push_back(call);
    }
    changed_.notify_one();
    return true;
  }

 private:
  void work();

  const RpcOptions& options_;
  SensorService& service_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<PendingCall*> waiting_;
  bool ends_ = false;
  std::vector<std::thread> threads_;
};

/// One call. gRPC ends it by OnDone, after Finish.
class PendingCall : public grpc::ServerGenericBidiReactor {
 public:
  PendingCall(Workers& workers, grpc::GenericCallbackServerContext& context)
      : workers_(workers), path_(context.method()) {
    StartRead(&request_);
  }
  void OnReadDone(bool ok) override {
    if (!ok)
      Finish({grpc::StatusCode::INVALID_ARGUMENT, "the call has no request"});
    else if (!workers_.add(this))
      Finish({grpc::StatusCode::RESOURCE_EXHAUSTED,
              std::to_string(kMaxWaiting) + " requests wait already"});
  }
  void OnCancel() override { cancelled_ = true; }
  void OnDone() override { delete this; }

  void answer(const RpcOptions& options, SensorService* service) {
    grpc::Status status;
    try {
      if (cancelled_) throw RequestError(StatusCode::kCancelled, "cancelled");
      reply_ = buffer_of(answer_call(path_, bytes_of(request_), options, service,
                                     [this] { return cancelled_.load(); }));
    } catch (const RequestError& error) {
      status = {static_cast<grpc::StatusCode>(error.code), error.what()};
    } catch (const std::exception& error) {
      status = {grpc::StatusCode::INTERNAL, error.what()};
    }
    request_.Clear();
    if (status.ok())
      StartWriteAndFinish(&reply_, {}, status);
    else
      Finish(status);
  }

 private:
  Workers& workers_;
  std::string path_;
  std::atomic<bool> cancelled_{false};
  grpc::ByteBuffer request_, reply_;
};

void Workers::work() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return ends_ || !waiting_.empty(); });
    if (waiting_.empty()) return;
    PendingCall* const call = waiting_.front();
    waiting_.pop_front();
    lock.unlock();
    call->answer(options_, &service_);
    lock.lock();
  }
}

class GrpcServer : public RpcServer, grpc::CallbackGenericService {
 public:
  GrpcServer(const RpcOptions& options, SensorService* service)
      : options_(options), workers_(options_, service) {
    // A client must not write lines.
    google::protobuf::SetLogHandler(nullptr);
    gpr_set_log_function([](gpr_log_func_args*) {});
    grpc::EnableDefaultHealthCheckService(true);
    grpc::ServerBuilder builder;
    std::shared_ptr<grpc::ServerCredentials> credentials = grpc::InsecureServerCredentials();
    if (!options.certificate.empty()) {
      grpc::SslServerCredentialsOptions tls;
      tls.pem_key_cert_pairs.push_back({options.key, options.certificate});
      credentials = grpc::SslServerCredentials(tls);
    }
    const std::string host = options.listen.find(':') == std::string::npos
                                 ? options.listen
                                 : "[" + options.listen + "]";  // IPv6
    builder.AddListeningPort(host + ":" + std::to_string(options.port), credentials, &port_);
    builder.AddChannelArgument(GRPC_ARG_ALLOW_REUSEPORT, 0);
    builder.SetMaxReceiveMessageSize(static_cast<int>(kMaxRequestBytes));
    builder.SetMaxSendMessageSize(static_cast<int>(kMaxReplyBytes));
    builder.RegisterCallbackGenericService(this);
    server_ = builder.BuildAndStart();
    if (!server_) return;
    for (const std::string_view name : kServiceNames)
      server_->GetHealthCheckService()->SetServingStatus(std::string(name), true);
  }
  ~GrpcServer() override {
    if (!server_) return;
    server_->Shutdown(std::chrono::system_clock::now());
    server_->Wait();
  }
  bool listens() const { return server_ && port_ > 0; }
  int port() const override { return port_; }

 private:
  grpc::ServerGenericBidiReactor* CreateReactor(
      grpc::GenericCallbackServerContext* context) override {
    return new PendingCall(workers_, *context);
  }

  const RpcOptions options_;
  Workers workers_;
  int port_ = 0;
  std::unique_ptr<grpc::Server> server_;
};

}  // namespace
}  // namespace redrive::serve

extern "C" redrive::serve::RpcServer* redrive_start_grpc(const redrive::serve::RpcOptions& options,
                                                         redrive::serve::SensorService* service) {
  auto server = std::make_unique<redrive::serve::GrpcServer>(options, service);
  return server->listens() ? server.release() : nullptr;
}
