// SPDX-License-Identifier: Apache-2.0
// For tests: the viewer over loopback, on a run whose images are a formula of the ray.
#pragma once

#include <atomic>
#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/image/jpeg.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"
#include "redrive/view/server/loopback_client_testing.h"
#include "redrive/view/viewer.h"

namespace redrive::view {

struct Received {
  nlohmann::json header;
  Image8 image;  ///< image of binary messages
};

class ViewerTest : public testing::Test {
 protected:
  explicit ViewerTest(bool with_model = true, std::vector<MovingObject> traffic = {},
                      const FirstEdit& edit = {}) {
    run_.recording = make_test_recording(folder_.path, 3);
    run_.recording.lidars = {{"lidar", Rigid3d::Identity()}};
    run_.scene = make_scene(run_.recording, {.holdout_every = 2});
    run_.scene.actors = std::move(traffic);
    run_.options.method = "nerf";
    run_.paths.root = folder_.path / "run";
    std::filesystem::create_directory(run_.paths.root);
    if (with_model) run_.state.model = make_painted_model();
    viewer_ = std::make_unique<Viewer>(
        std::shared_ptr<const redrive::Run>(&run_, [](auto*) {}), backend_,
        [this] { return look(); }, edit);
    ServerOptions options;
    options.token = "t";
    server_ = std::make_unique<Server>(options, viewer_.get());
    thread_ = std::thread([this] { viewer_->serve(*server_, stop_); });
  }
  ~ViewerTest() override {
    stop_ = true;
    thread_.join();
  }

  RunNews look() {
    const std::lock_guard lock(news_mutex_);
    return std::exchange(news_, {nullptr, news_.problem});
  }
  void happens(RunNews news) {
    const std::lock_guard lock(news_mutex_);
    news_ = std::move(news);
  }

  std::unique_ptr<LoopbackClient> connect() {
    auto client = std::make_unique<LoopbackClient>(server_->port());
    const std::string host = "127.0.0.1:" + std::to_string(server_->port());
    EXPECT_THAT(client->upgrade("/t/socket", host, "http://" + host), testing::HasSubstr("101"));
    return client;
  }

  static nlohmann::json view(int id, const char* camera = "FRONT", int frame = 11) {
    return {{"type", "view"},       {"id", id},
            {"camera", camera},     {"frame", frame},
            {"shift_m", {0, 0, 0}}, {"yaw_deg", 0},
            {"pitch_deg", 0},       {"layer", "image"},
            {"exposure", "own"},    {"overlays", nlohmann::json::array()},
            {"reference", false},   {"novel", nullptr}};
  }

  static Received next(LoopbackClient& client) {
    const auto message = client.receive_message();
    if (!message || message->opcode == 8) return {{{"kind", "closed"}}, {}};
    if (message->opcode == 1) return {nlohmann::json::parse(message->payload), {}};
    std::size_t size = 0;
    for (int i = 0; i < 4; ++i)
      size |= static_cast<std::size_t>(static_cast<unsigned char>(message->payload[i])) << 8 * i;
    Received received{nlohmann::json::parse(message->payload.substr(4, size)), {}};
    received.image = decode_jpeg(
        message->payload.substr(4 + size, received.header["jpeg"].get<std::size_t>()), "jpeg");
    return received;
  }
  /// Acknowledges images until a message of `kind` comes for which `wanted` holds.
  static Received wait_for(LoopbackClient& client, const std::string& kind,
                           const std::function<bool(const nlohmann::json&)>& wanted = {}) {
    for (;;) {
      Received received = next(client);
      const std::string got = received.header["kind"];
      if (got == "image")
        client.send_message(
            nlohmann::json{{"type", "shown"}, {"sequence", received.header["sequence"]}}.dump());
      if (got == "closed" || (got == kind && (!wanted || wanted(received.header)))) return received;
    }
  }
  static Received full_image(LoopbackClient& client, int id) {
    return wait_for(client, "image", [id](const nlohmann::json& header) {
      return header["id"] == id && header["factor"] == 1;
    });
  }

  TemporaryFolder folder_;
  redrive::Run run_;
  // Colours vary slowly with the direction; everything is 2 m away.
  PaintBackend backend_{[](const std::array<float, 3>&, const std::array<float, 3>& d) {
    return std::array<float, 3>{0.5f + 0.4f * d[0], 0.5f + 0.4f * d[1], 0.5f + 0.4f * d[2]};
  }};
  std::atomic<bool> stop_{false};
  std::mutex news_mutex_;
  RunNews news_;
  std::unique_ptr<Viewer> viewer_;
  std::unique_ptr<Server> server_;
  std::thread thread_;
};

}  // namespace redrive::view
