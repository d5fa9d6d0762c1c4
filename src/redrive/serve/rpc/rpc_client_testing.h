// SPDX-License-Identifier: Apache-2.0
// For tests: a client of the sensorsim interface on this machine.
#pragma once

#include <string>
#include <string_view>
#include <utility>

#include <grpcpp/create_channel.h>
#include <grpcpp/impl/codegen/client_unary_call.h>
#include <grpcpp/impl/codegen/proto_utils.h>
#include <grpcpp/security/credentials.h>

#include "redrive/math/rigid3.h"
#include "redrive/serve/rpc/sensorsim_calls.h"
#include "sensorsim.pb.h"

namespace redrive::serve {

inline void fill_pose(const Rigid3d& pose, sensorsim::Pose* out) {
  const Eigen::Quaterniond turn(pose.linear());
  out->mutable_vec()->set_x(static_cast<float>(pose.translation().x()));
  out->mutable_vec()->set_y(static_cast<float>(pose.translation().y()));
  out->mutable_vec()->set_z(static_cast<float>(pose.translation().z()));
  out->mutable_quat()->set_w(static_cast<float>(turn.w()));
  out->mutable_quat()->set_x(static_cast<float>(turn.x()));
  out->mutable_quat()->set_y(static_cast<float>(turn.y()));
  out->mutable_quat()->set_z(static_cast<float>(turn.z()));
}

class RpcClient {
 public:
  explicit RpcClient(
      int port, std::string_view service = kServiceNames[0],
      std::shared_ptr<grpc::ChannelCredentials> credentials = grpc::InsecureChannelCredentials(),
      const std::string& host = "127.0.0.1")
      : service_(service) {
    grpc::ChannelArguments arguments;
    arguments.SetMaxReceiveMessageSize(static_cast<int>(kMaxReplyBytes));
    arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);  // a connection of its own
    channel_ = grpc::CreateCustomChannel(host + ":" + std::to_string(port), credentials, arguments);
  }

  /// Calls a method; `reply` is set where the status is OK.
  template <class Request, class Reply>
  grpc::Status call(const std::string& method, const Request& request, Reply* reply,
                    grpc::ClientContext* context = nullptr) const {
    grpc::ClientContext own;
    const std::string path = "/" + service_ + "/" + method;
    return grpc::internal::BlockingUnaryCall<Request, Reply, grpc::protobuf::MessageLite,
                                             grpc::protobuf::MessageLite>(
        channel_.get(),
        grpc::internal::RpcMethod(path.c_str(), grpc::internal::RpcMethod::NORMAL_RPC, channel_),
        context ? context : &own, request, reply);
  }

 private:
  std::string service_;
  std::shared_ptr<grpc::Channel> channel_;
};

}  // namespace redrive::serve
