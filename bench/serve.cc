// SPDX-License-Identifier: Apache-2.0
// Times redrive serve on this machine against the same images without gRPC:
//   ninja -C build/release bench_serve && build/release/bench_serve RUN [SECONDS [REQUESTS]]
// prints images a second and processor time at 1280 x 704 and of six cameras at 640 x 352 in one
// request, for one and four clients, JPEG, the best of five rounds; then, where REQUESTS is given,
// the memory before and after as many small images.
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <thread>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/image/jpeg.h"
#include "redrive/math/angles.h"
#include "redrive/render/lidar_scan.h"
#include "redrive/render/open_to_render.h"
#include "redrive/serve/rpc/rpc_client_testing.h"
#include "redrive/serve/rpc_library.h"
#include "redrive/serve/run_service.h"

namespace redrive::serve {
namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

double resident_mib() {
  std::ifstream file("/proc/self/statm");
  double size = 0, resident = 0;
  file >> size >> resident;
  return resident * static_cast<double>(sysconf(_SC_PAGESIZE)) / (1 << 20);
}

struct Rate {
  double per_s = 0, cpu_ms = 0;  ///< calls a second, processor time of a call
};

/// Calls what `work` returns on threads until `seconds` have passed; keeps the better rate.
template <class Work>
void measure(int threads, double seconds, const Work& work, Rate* best) {
  std::atomic<int> calls{0};
  const std::clock_t cpu = std::clock();
  const Clock::time_point start = Clock::now();
  std::vector<std::thread> running;
  for (int t = 0; t < threads; ++t)
    running.emplace_back([&] {
      const auto call = work();
      while (seconds_since(start) < seconds) {
        call();
        ++calls;
      }
    });
  for (std::thread& thread : running) thread.join();
  const double per_s = calls / seconds_since(start);
  if (per_s > best->per_s)
    *best = {per_s, 1e3 * static_cast<double>(std::clock() - cpu) / CLOCKS_PER_SEC / calls};
}

/// Cameras of 90 degrees at the middle of the drive, looking around.
struct Views {
  Camera lens;
  std::int64_t t_ns = 0;
  std::vector<Rigid3d> world_from_camera;
};

Views make_views(const Run& run, int cameras, int width, int height) {
  Views views;
  views.lens = make_camera({.name = "",
                            .model = "opencv_pinhole",
                            .parameters = {width / 2.0, width / 2.0, (width - 1) / 2.0,
                                           (height - 1) / 2.0, 0, 0, 0, 0, 0},
                            .width = width,
                            .height = height});
  views.t_ns = run.scene.frames[run.scene.frames.size() / 2].t_ns;
  for (int c = 0; c < cameras; ++c) {
    const Eigen::AngleAxisd turn(2 * std::numbers::pi * c / cameras, Eigen::Vector3d::UnitZ());
    views.world_from_camera.push_back(run.scene.world_from_body(views.t_ns) * turn *
                                      Eigen::Translation3d(0, 0, 1.5) *
                                      camera_from_lidar_axes().inverse(Eigen::Isometry));
  }
  return views;
}

sensorsim::BatchRequest request_of(const std::string& scene, const Views& views) {
  sensorsim::BatchRequest batch;
  for (const Rigid3d& pose : views.world_from_camera) {
    sensorsim::ImageRequest* const request = batch.add_items()->mutable_request();
    request->set_scene_id(scene);
    request->set_resolution_w(static_cast<unsigned>(views.lens.width));
    request->set_resolution_h(static_cast<unsigned>(views.lens.height));
    sensorsim::Pinhole* const lens =
        request->mutable_camera_intrinsics()->mutable_opencv_pinhole_param();
    lens->set_focal_length_x(views.lens.fx);
    lens->set_focal_length_y(views.lens.fy);
    lens->set_principal_point_x(views.lens.cx + 0.5);
    lens->set_principal_point_y(views.lens.cy + 0.5);
    request->set_frame_start_us(static_cast<std::uint64_t>(views.t_ns / 1000));
    request->set_frame_end_us(static_cast<std::uint64_t>(views.t_ns / 1000));
    fill_pose(pose, request->mutable_sensor_pose()->mutable_start_pose());
    fill_pose(pose, request->mutable_sensor_pose()->mutable_end_pose());
    request->set_image_format(static_cast<unsigned>(ImageFormat::kJpeg));
  }
  return batch;
}

void check(const grpc::Status& status) {
  if (!status.ok()) throw std::runtime_error(status.error_message());
}

int bench(const std::filesystem::path& root, double seconds, int requests) {
  SceneStore store({root}, {}, std::uint64_t{1} << 40);
  const std::string scene = store.ids().at(0);
  RunService service(&store);
  const auto server = start_rpc_server({}, &service);
  const auto client = [&](const sensorsim::BatchRequest& batch) {
    return [&, own = std::make_shared<RpcClient>(server->port())] {
      sensorsim::BatchReply reply;
      check(own->call("batch_render_rgb", batch, &reply));
      for (const auto& item : reply.items())
        if (!item.success()) throw std::runtime_error(item.error_message());
    };
  };
  const auto run = std::make_shared<const Run>(open_to_render(root));
  RunRenderer renderer(run, {});
  const sensorsim::BatchRequest first = request_of(scene, make_views(*run, 1, 640, 352));
  const Clock::time_point start = Clock::now();
  client(first)();
  std::printf("first image of an unloaded scene: %.2f s\n", seconds_since(start));
  std::printf("%-18s without gRPC, one client, four clients\n", "");
  for (const auto& [name, cameras, width, height] :
       {std::tuple("1280 x 704", 1, 1280, 704), std::tuple("six of 640 x 352", 6, 640, 352)}) {
    const Views views = make_views(*run, cameras, width, height);
    const sensorsim::BatchRequest batch = request_of(scene, views);
    const auto without = [&] {
      return [&] {
        for (const Rigid3d& pose : views.world_from_camera)
          encode_jpeg(to_image8(renderer.image(
                          {{.name = "", .camera = views.lens}, {pose}, views.t_ns, {}}, Scene())),
                      92);
      };
    };
    Rate best[3];
    for (int round = 0; round < 5; ++round) {  // other programs slow some rounds down
      measure(1, seconds / 15, without, &best[0]);
      measure(
          1, seconds / 15, [&] { return client(batch); }, &best[1]);
      measure(
          4, seconds / 15, [&] { return client(batch); }, &best[2]);
    }
    std::printf("%-18s images/s %8.1f %8.1f %8.1f   processor ms %6.1f %6.1f %6.1f\n", name,
                cameras * best[0].per_s, cameras * best[1].per_s, cameras * best[2].per_s,
                best[0].cpu_ms / cameras, best[1].cpu_ms / cameras, best[2].cpu_ms / cameras);
  }
  if (requests == 0) return 0;
  const sensorsim::BatchRequest small = request_of(scene, make_views(*run, 1, 64, 32));
  for (int i = 0; i <= requests; ++i) {
    if (i % std::max(1, requests / 4) == 0)
      std::printf("after %6d requests: %.1f MiB\n", i, resident_mib());
    client(small)();
  }
  return 0;
}

}  // namespace
}  // namespace redrive::serve

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "bench_serve RUN [SECONDS [REQUESTS]]\n");
    return 2;
  }
  return redrive::serve::bench(argv[1], argc > 2 ? std::atof(argv[2]) : 5,
                               argc > 3 ? std::atoi(argv[3]) : 0);
}
