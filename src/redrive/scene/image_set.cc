// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/image_set.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <turbojpeg.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files.h"

namespace redrive {
namespace {

constexpr int kJpegQuality = 92;
constexpr std::int64_t kMaxPixels = std::int64_t{1} << 28;  // a header of a few bytes must not claim all memory

std::string size_text(int width, int height) { return std::to_string(width) + " x " + std::to_string(height); }

/// cv::Mat that shares the image's memory. OpenCV's codecs expect BGR: callers convert.
cv::Mat as_mat(Image8& image) { return {image.height, image.width, CV_8UC3, image.rgb.data()}; }
cv::Mat as_mat(const Image8& image) { return as_mat(const_cast<Image8&>(image)); }

Image8 from_mat(const cv::Mat& rgb) {
  Image8 image{rgb.cols, rgb.rows, std::vector<std::uint8_t>(3 * rgb.total())};
  rgb.copyTo(as_mat(image));
  return image;
}

/// TurboJPEG, because it can be told to stop where libjpeg would only warn and fill the rest with grey.
Image8 decode_jpeg(const std::filesystem::path& path, const std::string& bytes) {
  struct Decoder {
    tjhandle handle = tjInitDecompress();
    ~Decoder() { tjDestroy(handle); }
  } decoder;
  REDRIVE_CHECK(decoder.handle != nullptr);
  const auto fail = [&](const char* what) -> void {
    throw InputError(path, "", "", std::string(what) + ": " + tjGetErrorStr2(decoder.handle));
  };
  const auto* data = reinterpret_cast<const unsigned char*>(bytes.data());
  int width = 0, height = 0, subsampling = 0, colourspace = 0;
  if (tjDecompressHeader3(decoder.handle, data, bytes.size(), &width, &height, &subsampling, &colourspace) != 0)
    fail("no readable JPEG");
  if (std::int64_t{width} * height > kMaxPixels) throw InputError(path, "size", size_text(width, height), "too large");
  Image8 image{width, height, std::vector<std::uint8_t>(std::size_t(3) * width * height)};
  if (tjDecompress2(decoder.handle, data, bytes.size(), image.rgb.data(), width, 0, height, TJPF_RGB,
                    TJFLAG_STOPONWARNING) != 0)
    fail("the JPEG is truncated or damaged");
  return image;
}

cv::Mat decode_png(const std::filesystem::path& path, const std::string& bytes, int flags) {
  cv::Mat decoded;
  try {
    decoded = cv::imdecode(cv::Mat(1, static_cast<int>(bytes.size()), CV_8UC1, const_cast<char*>(bytes.data())), flags);
  } catch (const cv::Exception& error) {
    throw InputError(path, "", "", "no readable PNG: " + std::string(error.what()));
  }
  if (decoded.empty()) throw InputError(path, "", "", "the PNG is truncated or damaged");
  return decoded;
}

bool is_png(const std::string& bytes) { return bytes.starts_with("\x89PNG\r\n\x1a\n"); }
bool is_jpeg(const std::string& bytes) { return bytes.starts_with("\xff\xd8\xff"); }

void encode_to_file(const std::filesystem::path& path, const cv::Mat& mat, const std::vector<int>& parameters) {
  const bool png = has_extension(path, {".png"});
  if (!png && !has_extension(path, {".jpg", ".jpeg"}))
    throw UsageError("image file", path.string(), "must end in .png, .jpg or .jpeg");
  std::vector<unsigned char> bytes;
  REDRIVE_CHECK(cv::imencode(png ? ".png" : ".jpg", mat, bytes, parameters));
  write_file(path, std::string_view(reinterpret_cast<const char*>(bytes.data()), bytes.size()));
}

void check_recorded_size(const std::filesystem::path& path, int width, int height, const RigCamera& rig) {
  if (width != rig.recorded.width || height != rig.recorded.height)
    throw InputError(path, "size", size_text(width, height),
                     "the calibration of " + rig.name + " says " + size_text(rig.recorded.width, rig.recorded.height));
}

/// Where each pixel of the undistorted picture lies in the recorded one; (-1, -1), which is black, where the camera
/// has not looked.
struct UndistortMap {
  cv::Mat u, v;
};

UndistortMap make_undistort_map(const RigCamera& rig) {
  const Camera plain = rig.recorded.undistorted();
  UndistortMap map{cv::Mat(plain.height, plain.width, CV_32F, -1.0f),
                   cv::Mat(plain.height, plain.width, CV_32F, -1.0f)};
  for (int y = 0; y < plain.height; ++y)
    for (int x = 0; x < plain.width; ++x) {
      const auto direction = plain.unproject({x, y});
      const auto recorded = direction ? rig.recorded.project(*direction) : std::nullopt;
      if (!recorded) continue;
      map.u.at<float>(y, x) = static_cast<float>(recorded->x());
      map.v.at<float>(y, x) = static_cast<float>(recorded->y());
    }
  return map;
}

/// `map` is null unless the scene undistorts.
Image8 load_with_map(const Scene& scene, const View& view, const UndistortMap* map) {
  const RigCamera& rig = scene.rig[view.camera];
  Image8 image = read_image(view.image);
  check_recorded_size(view.image, image.width, image.height, rig);
  cv::Mat mat = as_mat(image);
  if (map) {
    cv::Mat undistorted;
    cv::remap(mat, undistorted, map->u, map->v, cv::INTER_LINEAR, cv::BORDER_CONSTANT, cv::Scalar());
    mat = undistorted;
  }
  if (scene.downscale > 1) {
    const int width = rig.camera.width, height = rig.camera.height, factor = scene.downscale;
    cv::Mat small;
    cv::resize(mat(cv::Rect(0, 0, width * factor, height * factor)), small, {width, height}, 0, 0, cv::INTER_AREA);
    mat = small;
  }
  return mat.data == image.rgb.data() ? std::move(image) : from_mat(mat);
}

}  // namespace

Image8 read_image(const std::filesystem::path& path) {
  const std::string bytes = read_file(path);
  if (is_jpeg(bytes)) return decode_jpeg(path, bytes);
  if (!is_png(bytes))
    throw InputError(path, "", "", bytes.empty() ? "the file is empty" : "neither a JPEG nor a PNG image");
  cv::Mat rgb;
  cv::cvtColor(decode_png(path, bytes, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION), rgb, cv::COLOR_BGR2RGB);
  return from_mat(rgb);
}

void write_image(const std::filesystem::path& path, const Image8& image) {
  REDRIVE_CHECK_OP(image.rgb.size(), ==, std::size_t(3) * image.width * image.height);
  cv::Mat bgr;
  cv::cvtColor(as_mat(image), bgr, cv::COLOR_RGB2BGR);
  encode_to_file(path, bgr, {cv::IMWRITE_JPEG_QUALITY, kJpegQuality});
}

void write_png16(const std::filesystem::path& path, int width, int height, const std::vector<std::uint16_t>& values) {
  REDRIVE_CHECK_OP(values.size(), ==, std::size_t(width) * height);
  if (!has_extension(path, {".png"}))
    throw UsageError("image file", path.string(), "must end in .png: JPEG has no 16 bits");
  encode_to_file(path, cv::Mat(height, width, CV_16UC1, const_cast<std::uint16_t*>(values.data())), {});
}

std::vector<std::uint16_t> read_png16(const std::filesystem::path& path, int* width, int* height) {
  const std::string bytes = read_file(path);
  if (!is_png(bytes)) throw InputError(path, "", "", "no PNG image");
  const cv::Mat mat = decode_png(path, bytes, cv::IMREAD_UNCHANGED);
  if (mat.type() != CV_16UC1) throw InputError(path, "", "", "must have one channel of 16 bits");
  *width = mat.cols;
  *height = mat.rows;
  return {mat.begin<std::uint16_t>(), mat.end<std::uint16_t>()};
}

Image8 load_view(const Scene& scene, const View& view) {
  if (!scene.undistort) return load_with_map(scene, view, nullptr);
  const UndistortMap map = make_undistort_map(scene.rig[view.camera]);
  return load_with_map(scene, view, &map);
}

std::vector<float> load_depth(const std::filesystem::path& path, const RigCamera& rig) {
  constexpr std::uint16_t kUnknown = 0, kBeyond = 65535;
  int width = 0, height = 0;
  const std::vector<std::uint16_t> depth_mm = read_png16(path, &width, &height);
  check_recorded_size(path, width, height, rig);
  const Camera& camera = rig.camera;
  std::vector<float> depth_m(static_cast<std::size_t>(camera.width) * camera.height, 0.0f);
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const auto direction = camera.unproject({x, y});
      const auto recorded = direction ? rig.recorded.project(*direction) : std::nullopt;
      if (!recorded) continue;
      const long u = std::lround(recorded->x()), v = std::lround(recorded->y());
      if (u < 0 || v < 0 || u >= width || v >= height) continue;
      const std::uint16_t value = depth_mm[static_cast<std::size_t>(v) * width + u];
      if (value != kUnknown && value != kBeyond)
        depth_m[static_cast<std::size_t>(y) * camera.width + x] = 0.001f * value;
    }
  return depth_m;
}

std::vector<Image8> load_views(const Scene& scene, ThreadPool& pool) {
  cv::setNumThreads(1);  // the images are what is done in parallel
  std::vector<UndistortMap> maps(scene.undistort ? scene.rig.size() : 0);
  pool.run(static_cast<int>(maps.size()), [&](int camera) { maps[camera] = make_undistort_map(scene.rig[camera]); });
  std::vector<Image8> images(scene.views.size());
  pool.run(static_cast<int>(images.size()), [&](int i) {
    const View& view = scene.views[i];
    images[i] = load_with_map(scene, view, scene.undistort ? &maps[view.camera] : nullptr);
  });
  return images;
}

}  // namespace redrive
