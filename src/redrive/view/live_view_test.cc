// SPDX-License-Identifier: Apache-2.0
// The viewer in a process that trains.
#include "redrive/view/live_view.h"

#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/methods/splat/splat_model.h"
#include "redrive/train/train_testing.h"
#include "redrive/view/server/loopback_client_testing.h"

namespace redrive::view {
namespace {

using ::testing::HasSubstr;

class LiveViewTest : public testing::Test {
 protected:
  redrive::Run fresh_run(const char* name, std::int64_t steps) {
    return tiny_run(folder_.path / name, folder_.path, tiny_options(steps));
  }

  static nlohmann::json next(LoopbackClient& client) {
    const auto message = client.receive_message();
    if (!message || message->opcode == 8) return {{"kind", "closed"}};
    if (message->opcode == 1) return nlohmann::json::parse(message->payload);
    std::size_t size = 0;
    for (int i = 0; i < 4; ++i)
      size |= static_cast<std::size_t>(static_cast<unsigned char>(message->payload[i])) << 8 * i;
    nlohmann::json header = nlohmann::json::parse(message->payload.substr(4, size));
    if (header["kind"] == "image")
      client.send_message(
          nlohmann::json{{"type", "shown"}, {"sequence", header["sequence"]}}.dump());
    return header;
  }
  /// Reads until a message of a kind for which `wanted` holds.
  static nlohmann::json wait_for(
      LoopbackClient& client, const std::string& kind,
      const std::function<bool(const nlohmann::json&)>& wanted = [](const auto&) { return true; }) {
    for (;;) {
      nlohmann::json message = next(client);
      if (message["kind"] == "closed" || (message["kind"] == kind && wanted(message)))
        return message;
    }
  }

  TemporaryFolder folder_;
  std::unique_ptr<kernels::Backend> backend_ = processor_backend(1);
};

/// A page of a run that trains.
class LivePage {
 public:
  LivePage(redrive::Run* run, kernels::Backend& backend, const std::atomic<bool>& stop,
           const nlohmann::json& more = nlohmann::json::object())
      : live(run, backend, stop) {
    ServerOptions options;
    options.token = "t";
    server = std::make_unique<Server>(options, &live.viewer());
    live.use(*server);
    client = std::make_unique<LoopbackClient>(server->port());
    const std::string host = "127.0.0.1:" + std::to_string(server->port());
    EXPECT_THAT(client->upgrade("/t/socket", host, "http://" + host), HasSubstr("101"));
    look(more);
  }
  /// Asks for the image of frame 11, where `more` says nothing else.
  void look(const nlohmann::json& more) {
    nlohmann::json view = {{"type", "view"},       {"id", 1},
                           {"camera", "FRONT"},    {"frame", 11},
                           {"shift_m", {0, 0, 0}}, {"yaw_deg", 0},
                           {"pitch_deg", 0},       {"layer", "image"},
                           {"exposure", "own"},    {"overlays", nlohmann::json::array()},
                           {"reference", false},   {"novel", nullptr}};
    view.update(more);
    client->send_message(view.dump());
  }
  LiveView live;
  std::unique_ptr<Server> server;
  std::unique_ptr<LoopbackClient> client;
};

TEST_F(LiveViewTest, PausesAndGoesOn) {
  redrive::Run run = fresh_run("run", 1000000);
  std::atomic<bool> stop{false};
  LivePage page(&run, *backend_, stop);
  std::thread trainer([&] {
    train(&run, *backend_, stop, &page.live);
    page.live.serve(run);
  });
  EXPECT_EQ(wait_for(*page.client, "hello")["method"], "nerf");
  EXPECT_EQ(wait_for(*page.client, "image")["camera"], "FRONT");
  const auto is_trained = [](const nlohmann::json& training) { return training["step"] > 25; };
  EXPECT_EQ(wait_for(*page.client, "training", is_trained)["trains"], true);
  EXPECT_GE(wait_for(*page.client, "curve")["steps"].size(), 1u);
  page.client->send_message(R"({"type": "train", "paused": true})");
  const nlohmann::json paused =
      wait_for(*page.client, "training",
               [](const nlohmann::json& training) { return training["paused"].get<bool>(); });
  page.client->send_message(R"({"type": "pick", "id": 1, "at": [0.5, 0.5]})");
  wait_for(*page.client, "picked");  // images are made while it waits
  page.client->send_message(R"({"type": "train", "paused": false})");
  wait_for(*page.client, "training", [&](const nlohmann::json& training) {
    return !training["paused"].get<bool>() && training["step"] > paused["step"];
  });
  stop = true;
  trainer.join();
  EXPECT_GT(run.state.step, paused["step"].get<std::int64_t>());
  EXPECT_NE(run.state.model, nullptr);
}

TEST_F(LiveViewTest, ChangesNoBitOfTheRun) {
  redrive::Run alone = fresh_run("alone", 60), watched = fresh_run("watched", 60);
  std::atomic<bool> stop{false};
  train(&alone, *backend_, stop);
  LivePage page(&watched, *backend_, stop);
  EXPECT_EQ(train(&watched, *backend_, stop, &page.live), TrainEnd::kFinished);
  EXPECT_EQ(watched.state.step, 60);
  const auto values = [](const redrive::Run& run) {
    const auto span = run.state.model->parameters.span();
    return std::vector<float>(span.begin(), span.end());
  };
  EXPECT_EQ(values(watched), values(alone));
  EXPECT_EQ(wait_for(*page.client, "image")["kind"], "image") << "none was made between the steps";
  // The page learns that it has ended.
  std::thread server([&] { page.live.serve(watched); });
  EXPECT_EQ(wait_for(*page.client, "training",
                     [](const nlohmann::json& training) {
                       return !training["trains"].get<bool>();
                     })["step"],
            60);
  stop = true;
  server.join();
}

TEST_F(LiveViewTest, SplatsGrowOnThreadsWhileThePageLooksAround) {
  TrainOptions options;
  options.recording = "in memory";
  options.method = "splat";
  options.max_seconds = 0;
  options.max_steps = 1000000;
  options.refine_poses = "on";
  options.checkpoint_every = 15;
  options.set("initial.sky", 400);
  options.set("max_gaussians", 1000);
  options.set("densify_every", 8);
  options.set("grown_by", 1e-4);  // step 8 has them all
  redrive::Run run = tiny_run(folder_.path / "run", folder_.path, options);
  const auto backend = processor_backend(3);
  std::atomic<bool> stop{false};
  LivePage page(&run, *backend, stop);
  std::thread trainer([&] { train(&run, *backend, stop, &page.live); });
  for (const int yaw_deg : {0, 20, -20}) {
    page.look({{"id", yaw_deg + 100}, {"yaw_deg", yaw_deg}});
    wait_for(*page.client, "image",
             [&](const nlohmann::json& image) { return image["id"] == yaw_deg + 100; });
  }
  wait_for(*page.client, "training",
           [](const nlohmann::json& training) { return training["step"] > 25; });
  stop = true;
  trainer.join();
  const auto& model = dynamic_cast<const SplatModel&>(*run.state.model);
  EXPECT_GT(model.gaussians, model.first_gaussians);
}

/// The host's numbers are the device's when images are made.
TEST_F(LiveViewTest, FetchesWhatADeviceTrains) {
#ifdef REDRIVE_SANITIZED
  GTEST_SKIP() << "drivers are not built with sanitizers";
#endif
  std::unique_ptr<kernels::Backend> device;
  try {
    device = kernels::make_backend({.name = "vulkan", .threads = 1, .device = "0"});
  } catch (const UsageError& error) {
    GTEST_SKIP() << error.what();
  }
  struct Watch final : StepObserver {
    LiveView* live = nullptr;
    kernels::Backend* device = nullptr;
    int looks = 0, steps = 0;
    void between_steps(redrive::Run& run) override {
      const auto numbers = [&] {
        const auto span = run.state.model->parameters.span();
        return std::vector<float>(span.begin(), span.end());
      };
      const std::vector<float> before = numbers();
      live->between_steps(run);
      ++steps;
      const std::vector<float> shown = numbers();
      if (shown == before) return;  // nothing was fetched
      ++looks;
      run.state.model->fetch(*device);
      EXPECT_EQ(shown, numbers()) << "step " << run.state.step;
    }
  };
  TrainOptions options;
  options.recording = "in memory";
  options.method = "splat";
  options.max_seconds = 0;
  options.max_steps = 12;
  options.set("initial.sky", 200);
  redrive::Run alone = tiny_run(folder_.path / "alone", folder_.path, options),
               watched = tiny_run(folder_.path / "watched", folder_.path, options);
  std::atomic<bool> stop{false};
  train(&alone, *device, stop);
  LivePage page(&watched, *device, stop);
  Watch watch;
  watch.live = &page.live;
  watch.device = device.get();
  EXPECT_EQ(train(&watched, *device, stop, &watch), TrainEnd::kFinished);
  EXPECT_GE(watch.looks, 2) << "of " << watch.steps;
  const auto bytes = [](redrive::Run& run) {
    run.state.seconds = run.state.window.seconds = 0;
    return checkpoint_bytes(run.state);
  };
  EXPECT_EQ(bytes(watched), bytes(alone));
  stop = true;
}

TEST_F(LiveViewTest, ServesTheLastPoses) {
  const auto lines_of = [&](const char* name, float shift_m) {
    redrive::Run run = fresh_run(name, 60);
    run.state.poses = PoseState(run.scene);
    std::atomic<bool> stop{false};
    LivePage page(&run, *backend_, stop,
                  {{"overlays", {"trajectory"}}, {"frame", 10}, {"shift_m", {-4, 0, 1}}});
    // correction of the first frame, trained since
    run.state.poses.corrections.values[0] = shift_m;
    std::thread server([&] { page.live.serve(run); });
    const nlohmann::json lines = wait_for(*page.client, "image")["lines"];
    stop = true;
    server.join();
    return lines;
  };
  const nlohmann::json initial = lines_of("initial", 0), refined = lines_of("refined", 0.5);
  EXPECT_FALSE(initial.empty());
  EXPECT_NE(initial, refined);
}

}  // namespace
}  // namespace redrive::view
