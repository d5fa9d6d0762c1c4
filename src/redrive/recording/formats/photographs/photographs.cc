// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/photographs.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <optional>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/image_size.h"

namespace redrive::photographs {
namespace {

namespace fs = std::filesystem;

/// Returns the camera with images of another size of the same field of view.
CameraCalibration scaled_to(CameraCalibration camera, ImageSize size) {
  const double x = double(size.width) / camera.width, y = double(size.height) / camera.height;
  std::vector<double>& p = camera.parameters;  // fx, fy, cx, cy, then the distortion's
  p[0] *= x;
  p[1] *= y;
  p[2] = (p[2] + 0.5) * x - 0.5;
  p[3] = (p[3] + 0.5) * y - 0.5;
  camera.width = size.width;
  camera.height = size.height;
  return camera;
}

/// Returns the size that a camera's images have, except as many as may be damaged; nothing where
/// they differ.
std::optional<ImageSize> common_size(const std::vector<ImageFile>& images) {
  const std::optional<ImageSize> usual = usual_image_size(images);
  std::size_t others = 0;
  for (const ImageFile& image : images)
    if (const auto size = image_size(image.path)) others += *size != *usual;
  const auto most =
      static_cast<std::size_t>(0.01 * kMostDamagedPercent * static_cast<double>(images.size()));
  return others > std::max<std::size_t>(1, most) ? std::nullopt : usual;
}

bool is_file(const fs::path& path) {
  std::error_code error;
  return fs::is_regular_file(path, error);
}

std::string with_case(std::string text, int (*change)(int)) {
  std::ranges::transform(text, text.begin(),
                         [&](unsigned char c) { return static_cast<char>(change(c)); });
  return text;
}

}  // namespace

void fit_to_images(Recording* recording) {
  const auto text = [](int width, int height) {
    return std::to_string(width) + " x " + std::to_string(height);
  };
  for (RecordedCamera& camera : recording->cameras) {
    CameraCalibration& c = camera.calibration;
    if (camera.images.empty() || usual_image_size(camera.images) == ImageSize{c.width, c.height})
      continue;  // the usual case reads a few heads
    const std::optional<ImageSize> size = common_size(camera.images);
    if (!size || *size == ImageSize{c.width, c.height} ||
        std::abs(double(size->width) * c.height / c.width - size->height) > 1)
      continue;
    recording->findings.push_back({c.name, "all images have " + text(size->width, size->height) +
                                               " pixels, the calibration has " +
                                               text(c.width, c.height) +
                                               "; its intrinsics are scaled to the images"});
    c = scaled_to(c, *size);
  }
}

fs::path find_image(const fs::path& folder, const std::string& name) {
  if (is_file(folder / name)) return folder / name;
  std::string portable = name;
  std::ranges::replace(portable, '\\', '/');  // paths of Windows
  for (fs::path rest = fs::path(portable).relative_path(); !rest.empty();) {
    const fs::path path = folder / rest;
    const std::string extension = path.extension().string();
    for (const auto& other :
         {with_case(extension, std::tolower), with_case(extension, std::toupper)})
      for (const fs::path& candidate : {path, fs::path(path).replace_extension(other)})
        if (is_file(candidate)) return candidate;
    for (const char* added : {".png", ".jpg", ".jpeg", ".PNG", ".JPG", ".JPEG"})
      if (const fs::path candidate = path.string() + added; is_file(candidate)) return candidate;
    fs::path shorter;
    for (auto part = std::next(rest.begin()); part != rest.end(); ++part) shorter /= *part;
    rest = shorter;
  }
  return {};
}

void note_found_elsewhere(const std::vector<std::string>& images, std::vector<Finding>* findings) {
  if (images.empty()) return;
  findings->push_back(
      {"frames", counted(images.size(), "image") +
                     " found by the last parts of the path or another case: " + first_few(images)});
}

void refuse_without_images(const fs::path& folder, const std::string& first) {
  const fs::path sought = fs::absolute(folder / fs::path(first).relative_path()).lexically_normal();
  std::vector<std::string> there;
  for (const fs::path& entry :
       list_folder(is_folder(sought.parent_path()) ? sought.parent_path() : folder))
    there.push_back(entry.filename().string());
  throw InputError(sought, "", "",
                   "missing, and so are all other images that are listed; there is " +
                       (there.empty() ? "nothing" : first_few(there)) +
                       (is_folder(sought.parent_path()) ? " beside it" : " in " + folder.string()));
}

void report_unread_points(const std::vector<std::filesystem::path>& folders,
                          const std::filesystem::path& read, std::vector<Finding>* findings) {
  std::vector<std::string> unread;
  for (const std::filesystem::path& folder : folders)
    for (const std::filesystem::path& file : list_folder(folder))
      if (has_extension(file, {".ply", ".pcd", ".las", ".laz"}) && file != read)
        unread.push_back(file.filename().string());
  if (!unread.empty())
    findings->push_back(
        {"points", counted(unread.size(), "cloud") + " not read: " + first_few(unread)});
}

}  // namespace redrive::photographs
