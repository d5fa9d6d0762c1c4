// SPDX-License-Identifier: Apache-2.0
// redrive render --path: renders a camera path into a video or a folder of images.
#include <algorithm>
#include <charconv>
#include <cstdio>
#include <filesystem>
#include <memory>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/cli/image_progress.h"
#include "redrive/cli/output_file.h"
#include "redrive/cli/render_options.h"
#include "redrive/cli/training.h"
#include "redrive/image/image_io.h"
#include "redrive/image/video.h"
#include "redrive/render/camera_path.h"
#include "redrive/render/renderer.h"
#include "redrive/train/memory.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

/// Where the images of a path go, in order. It has its name once finish() has returned, and leaves
/// nothing where that was not called.
struct ImageSink {
  virtual ~ImageSink() = default;
  virtual void add(const Image8& image) = 0;
  virtual void finish() = 0;
};

class VideoSink : public ImageSink {
 public:
  VideoSink(const fs::path& file, const Camera& camera, double fps)
      : video_(file, camera.width, camera.height, fps) {}
  void add(const Image8& image) override { video_.add(image); }
  void finish() override { video_.finish(); }

 private:
  VideoWriter video_;
};

std::string image_name(int index) {
  std::string digits = std::to_string(index);
  return digits.insert(0, 6 - std::min<std::size_t>(6, digits.size()), '0') + ".png";
}

/// Whether a folder holds images as FolderSink writes them and nothing else.
bool holds_images_alone(const fs::path& folder) {
  return std::ranges::all_of(fs::directory_iterator(folder), [](const fs::directory_entry& entry) {
    const std::string stem = entry.path().stem().string();
    return entry.is_regular_file() && entry.path().extension() == ".png" && stem.size() >= 6 &&
           stem.find_first_not_of("0123456789") == std::string::npos;
  });
}

/// A folder of 000000.png, 000001.png and so on, made under a temporary name.
class FolderSink : public ImageSink {
 public:
  explicit FolderSink(const fs::path& folder)
      : folder_(folder), temporary_(beside(".redrive-tmp")) {
    std::error_code error;
    fs::remove_all(temporary_, error);  // of a program that was killed
    if (!fs::create_directory(temporary_, error)) throw IoError(temporary_, error.message());
  }
  ~FolderSink() override {
    std::error_code error;
    fs::remove_all(temporary_, error);
  }
  void add(const Image8& image) override { write_image(temporary_ / image_name(images_++), image); }
  void finish() override {
    const fs::path old = beside(".redrive-old");
    std::error_code error;
    fs::remove_all(old, error);
    if (fs::exists(folder_)) fs::rename(folder_, old, error);
    if (!error) fs::rename(temporary_, folder_, error);
    if (error) throw IoError(folder_, error.message());
    fs::remove_all(old, error);
  }

 private:
  fs::path beside(const char* ending) const {
    return folder_.parent_path() / ("." + folder_.filename().string() + ending);
  }
  fs::path folder_, temporary_;
  int images_ = 0;
};

bool is_video(const fs::path& out) { return has_extension(out, {".mp4"}); }

/// Checks --out before anything is rendered, and returns it without a slash at its end.
fs::path checked_output(const RenderOptions& options) {
  const fs::path out = fs::path(options.out).has_filename() ? fs::path(options.out)
                                                            : fs::path(options.out).parent_path();
  if (is_video(out)) {
    check_output_file("--out", out, options.force);
    if (const auto obstacle = video_obstacle())
      throw UsageError("--out", options.out,
                       "videos need FFmpeg's libraries with libx264, and " + *obstacle +
                           "; --out FOLDER writes PNGs");
    return out;
  }
  if (!out.extension().empty() && !fs::is_directory(out))
    throw UsageError("--out", options.out,
                     "must be a video that ends in .mp4, or a folder for PNGs");
  if (const fs::path parent = out.parent_path(); !parent.empty() && !fs::is_directory(parent))
    throw UsageError("--out", options.out, "its folder does not exist");
  if (!fs::exists(out)) return out;
  if (!options.force) throw UsageError("--out", options.out, "exists; --force overwrites it");
  if (!fs::is_directory(out) || !holds_images_alone(out))
    throw UsageError("--out", options.out,
                     "is not a folder of such images alone; --force overwrites only those");
  return out;
}

/// Parses "drive" and "sideways:METRES"; nothing for a file.
std::optional<double> left_of_drive(const std::string& path) {
  if (path == "drive") return 0;
  const std::string_view prefix = "sideways:";
  if (!path.starts_with(prefix)) return std::nullopt;
  double left_m = 0;
  const char* const end = path.data() + path.size();
  const auto [at, error] = std::from_chars(path.data() + prefix.size(), end, left_m);
  if (error != std::errc{} || at != end || !(std::abs(left_m) <= kMaxShift_m))
    throw UsageError("--path", path, "must be sideways:METRES to the left, at most 1e4");
  return left_m;
}

CameraPath make_path(const RenderOptions& options, const Run& run) {
  const RigCamera& camera =
      options.camera.empty() ? run.scene.rig.front() : find_camera(run.scene, options.camera);
  CameraPath path;
  if (const auto left_m = left_of_drive(options.path))
    path = drive_path(run.recording, run.scene, camera, *left_m);
  else
    path = path_of_file(read_camera_path(options.path), run.recording, run.scene);
  if (!options.camera.empty()) path.camera = options.camera;
  if (options.fps > 0) path.fps = options.fps;
  if (options.seconds > 0) path.seconds = options.seconds;
  return path;
}

}  // namespace

int render_path(const RenderOptions& options) {
  const fs::path out = checked_output(options);
  left_of_drive(options.path);  // checks it before the run is opened
  const Run run = open_run(options.run);
  const CameraPath path = make_path(options, run);
  const bool own_lens = path.camera.empty();
  const int camera = std::max(0, run.scene.camera_index(path.camera));
  const Exposure exposure =
      chosen_exposure(options, run).value_or(path_exposure(path, run.scene, camera));
  Camera lens = own_lens ? *path.lens : run.scene.rig[camera].camera;

  const auto backend = make_backend_of(run, options.backend);
  std::printf("%s\n", kernels::describe(*backend).c_str());
  check_device_memory(run, *backend, run.state.model->rendering_work());
  const std::atomic<bool>& stop = stop_on_signal();
  std::unique_ptr<ImageSink> sink;
  if (is_video(out))
    sink = std::make_unique<VideoSink>(out, lens, path.fps);
  else
    sink = std::make_unique<FolderSink>(out);

  const int images = path.images();
  const auto progress = image_progress("rendered");
  std::optional<RayTable> rays;
  double fov_deg = 0;
  for (int i = 0; i < images; ++i) {
    if (stop) {
      std::fprintf(stderr, "redrive: interrupted, nothing written\n");
      return kExitInterrupted;
    }
    const PathKey key = path.at_image(i);
    if (own_lens) lens = with_fov(lens, key.fov_deg);
    if (!rays || (own_lens && key.fov_deg != fov_deg))
      rays = make_ray_table(lens, backend->threads());
    fov_deg = key.fov_deg;
    sink->add(to_image8(
        render_image(*backend, *run.state.model, *rays, key.world_from_camera, exposure)));
    if (progress) progress(i + 1, images);
  }
  sink->finish();
  std::printf("%s: %d images, %s, %g a second, %.2f s\n", out.c_str(), images,
              size_text(lens.width, lens.height).c_str(), path.fps, images / path.fps);
  return kExitOk;
}

}  // namespace redrive
