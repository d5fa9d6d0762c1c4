// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/colmap.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/mask_folder.h"
#include "redrive/recording/formats/photographs/colmap_files.h"
#include "redrive/recording/formats/photographs/colmap_rigs.h"
#include "redrive/recording/formats/photographs/far_photographs.h"
#include "redrive/recording/formats/photographs/photographs.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/unusable_returns.h"

namespace redrive::colmap {
namespace {

namespace fs = std::filesystem;

bool has_model(const fs::path& folder) {
  for (const std::string extension : {".bin", ".txt"})
    if (is_there(folder / ("cameras" + extension)) && is_there(folder / ("images" + extension)))
      return true;
  return false;
}

/// Returns the folders of models: in `sparse` by number or name, `sparse` and the folder itself.
/// Without a complete one, the one in `sparse` that lacks some files; empty if there is none.
std::vector<fs::path> find_models(const fs::path& root) {
  std::vector<fs::path> folders = list_folder(root / "sparse");
  std::ranges::sort(folders, [](const fs::path& a, const fs::path& b) {
    return strverscmp(a.filename().c_str(), b.filename().c_str()) < 0;
  });
  folders.push_back(root / "sparse");
  folders.push_back(root);
  std::vector<fs::path> models;
  std::ranges::copy_if(folders, std::back_inserter(models), has_model);
  for (const char* folder : {"sparse/0", "sparse"})
    for (const char* file : {"cameras.bin", "cameras.txt", "images.bin", "images.txt"})
      if (models.empty() && is_there(root / folder / file)) models.push_back(root / folder);
  return models;
}

/// Returns the folder with `images` to which a model's folder belongs: itself or one of the two
/// above.
fs::path project_of(const fs::path& root) {
  const fs::path path = fs::absolute(root / "").lexically_normal().parent_path();
  for (const fs::path& folder : {path.parent_path(), path.parent_path().parent_path()})
    if (!is_folder(root / "images") && has_model(root) && is_folder(folder / "images"))
      return folder;
  return root;
}

/// Returns the file of that name, binary or text; empty if there is none.
fs::path find_file(const fs::path& model, const std::string& name) {
  // cameras and images have to be of one kind.
  const bool binary = is_there(model / "cameras.bin") && is_there(model / "images.bin");
  const fs::path path = model / (name + (binary ? ".bin" : ".txt"));
  return is_there(path) ? path : fs::path();
}

fs::path required_file(const fs::path& model, const std::string& name) {
  fs::path file = find_file(model, name);
  if (file.empty())
    throw InputError(model, name, "",
                     "missing: a model has cameras and images, both as .bin or both as .txt");
  return file;
}

/// Reads a file by the parser of its kind.
template <class Record>
std::vector<Record> read(const fs::path& file,
                         std::vector<Record> (*binary)(std::string_view, const fs::path&),
                         std::vector<Record> (*text)(std::string_view, const fs::path&)) {
  return (file.extension() == ".bin" ? binary : text)(read_file(file, kMaxDataBytes), file);
}

/// A model's folder and the number of its images in the folder of images; -1: cannot be read.
struct ModelSize {
  fs::path folder;
  std::ptrdiff_t images;

  std::string text() const {
    return folder.string() +
           (images < 0 ? " (damaged)" : " with " + counted(std::size_t(images), "image"));
  }
};

/// Returns the model with the most images in `folder`, the first of equal ones. A finding names the
/// others.
fs::path choose_model(const std::vector<fs::path>& models, const fs::path& folder,
                      std::vector<Finding>* findings) {
  if (models.size() == 1) return models[0];
  std::vector<ModelSize> sizes;
  for (const fs::path& model : models) {
    sizes.push_back({model, -1});
    try {
      sizes.back().images = std::ranges::count_if(
          read(required_file(model, "images"), parse_images_binary, parse_images_text),
          [&](const ImageRecord& image) {
            return !photographs::find_image(folder, image.name).empty();
          });
    } catch (const InputError&) {
    }
  }
  const ModelSize best = *std::ranges::max_element(sizes, {}, &ModelSize::images);
  std::vector<std::string> others;
  for (const ModelSize& size : sizes)
    if (size.folder != best.folder) others.push_back(size.text());
  findings->push_back({"models", "of several " + best.text() +
                                     " is read; not read: " + first_few(others) +
                                     "; the path of one, given as the recording, reads that"});
  return best.folder;
}

/// Leaves out points that are not finite, or so far away that too few images saw them.
std::vector<PointRecord> read_point_records(const fs::path& file, std::size_t* left_out = nullptr) {
  std::vector<PointRecord> points = read(file, parse_points_binary, parse_points_text);
  const std::size_t bad = std::erase_if(points, [](const PointRecord& point) {
    return !(point.in_world.norm() <= photographs::kMaxDistance);
  });
  if (left_out) *left_out = bad;
  return points;
}

class Reader final : public RecordingReader {
 public:
  explicit Reader(std::map<std::int64_t, std::int64_t> frame_of_image)
      : frame_of_image_(std::move(frame_of_image)) {}

  std::vector<StaticPoint> read_points(const Recording& recording) const override {
    std::vector<StaticPoint> points;
    for (const PointRecord& record : read_point_records(recording.points_file)) {
      StaticPoint point{record.in_world, {}, !record.images.empty()};
      for (const std::int64_t image : record.images)
        if (const auto frame = frame_of_image_.find(image); frame != frame_of_image_.end())
          point.frames.push_back(frame->second);
      points.push_back(std::move(point));
    }
    return points;
  }

 private:
  std::map<std::int64_t, std::int64_t> frame_of_image_;
};

/// Reports tracks with images that the model does not have, by their ids.
void report_unknown_images(const std::vector<PointRecord>& points, const fs::path& points_file,
                           const fs::path& images_file, const std::set<std::int64_t>& ids,
                           std::vector<Finding>* findings) {
  std::size_t count = 0;
  std::int64_t first = 0;
  for (const PointRecord& point : points) {
    const auto unknown =
        std::ranges::find_if(point.images, [&](std::int64_t id) { return !ids.contains(id); });
    if (unknown != point.images.end() && count++ == 0) first = *unknown;
  }
  if (count > 0)
    findings->push_back({points_file.filename().string(),
                         counted(count, "point") + " seen by images that " +
                             images_file.filename().string() + " does not have, such as image " +
                             std::to_string(first) + "; these are not used"});
}

/// Returns images below `folder`, relative to it, that the model does not have.
std::vector<std::string> images_without_pose(const fs::path& folder,
                                             const std::set<std::string>& known) {
  std::vector<std::string> names = images_below(folder);
  std::erase_if(names, [&](const std::string& name) { return known.contains(name); });
  return names;
}

/// Takes the poses of the model's rigs, where it has any. A damaged file of rigs only loses these.
void apply_rigs(const fs::path& model, std::vector<ImageRecord>* images,
                std::vector<Finding>* findings) {
  const fs::path rigs = find_file(model, "rigs"), frames = find_file(model, "frames");
  if (rigs.empty() && frames.empty()) return;
  if (rigs.empty() || frames.empty()) {
    findings->push_back(
        {(rigs.empty() ? frames : rigs).filename().string(),
         std::string("not used: the model has no ") + (rigs.empty() ? "rigs" : "frames")});
    return;
  }
  try {
    take_poses_of_rigs(read(rigs, parse_rigs_binary, parse_rigs_text),
                       read(frames, parse_frames_binary, parse_frames_text), images, findings);
  } catch (const InputError& error) {
    findings->push_back(
        {"rigs", "not used, images have poses of their own: " + std::string(error.what())});
  }
}

/// Returns a cube around the cameras and the middle 80 % of the points along each axis: a few
/// points may be far away.
std::optional<BoundingCube> bounds_of(const std::vector<FramePose>& frames,
                                      const std::vector<PointRecord>& points) {
  if (points.empty()) return std::nullopt;
  Eigen::AlignedBox3d box;
  for (const FramePose& frame : frames) box.extend(frame.global_from_body.translation());
  Eigen::Vector3d low, high;
  std::vector<double> values(points.size());
  for (int k = 0; k < 3; ++k) {
    std::ranges::transform(points, values.begin(),
                           [&](const PointRecord& point) { return point.in_world[k]; });
    const auto at = [&](std::size_t tenths) {
      const auto nth =
          values.begin() + static_cast<std::ptrdiff_t>((values.size() - 1) * tenths / 10);
      std::ranges::nth_element(values, nth);
      return *nth;
    };
    low[k] = at(1);
    high[k] = at(9);
  }
  box.extend(low);
  box.extend(high);
  const double side = box.sizes().maxCoeff();
  if (!(side > 1e-6 && side <= photographs::kMaxDistance &&
        box.center().norm() <= photographs::kMaxDistance))
    return std::nullopt;
  return BoundingCube{box.center(), 0.5 * side};
}

/// Name of a camera: one of several is numbered, so that names sort by number.
std::string camera_name(std::int64_t id, const std::vector<CameraRecord>& cameras) {
  if (cameras.size() == 1) return "camera";
  std::size_t digits = 0;
  for (const CameraRecord& camera : cameras)
    digits = std::max(digits, std::to_string(camera.id).size());
  const std::string number = std::to_string(id);
  return "camera_" + std::string(digits - number.size(), '0') + number;
}

/// Returns the model's cameras by id, without images.
std::map<std::int64_t, RecordedCamera> recorded_cameras(const std::vector<CameraRecord>& cameras,
                                                        const fs::path& file) {
  std::map<std::int64_t, RecordedCamera> by_id;
  for (const CameraRecord& camera : cameras) {
    RecordedCamera& recorded = by_id[camera.id];
    recorded.calibration = to_calibration(camera, file);
    recorded.calibration.name = camera_name(camera.id, cameras);
    recorded.calibration.body_from_sensor = photographs::body_from_camera();
  }
  return by_id;
}

struct PhotoFiles {
  fs::path images_folder, cameras, images;
};

/// Images of a model after each that can be used has become a frame.
struct PlacedImages {
  std::set<std::int64_t> ids;
  std::set<std::string> names;  ///< and paths of files that were found under another name
  std::map<std::int64_t, std::int64_t> frame_of_image;
  std::vector<std::string> missing, found_elsewhere, not_normalised;
};

/// Adds a frame to the recording, and the image to its camera, where its file is there.
void place_image(const ImageRecord& image, const PhotoFiles& files, const MaskFile& mask,
                 std::map<std::int64_t, RecordedCamera>* cameras, Recording* recording,
                 PlacedImages* placed) {
  constexpr double kUnitLength = 1e-3;  // what rounding leaves is less
  const fs::path& folder = files.images_folder;
  placed->ids.insert(image.id);
  const std::string record = "image " + std::to_string(image.id);
  const auto camera = cameras->find(image.camera_id);
  if (camera == cameras->end())
    throw InputError(files.images, record + " camera", std::to_string(image.camera_id),
                     "is not in " + files.cameras.filename().string());
  if (!placed->names.insert(image.name).second)
    throw InputError(files.images, record + " name", image.name, "is there twice");
  const fs::path path = photographs::find_image(folder, image.name);
  if (lies_outside(path.empty() ? folder / image.name : path, folder))
    throw InputError(files.images, record + " name", image.name, "leads out of " + folder.string());
  if (path.empty()) {
    placed->missing.push_back(image.name);
    return;
  }
  if (!image.damage.empty()) {
    recording->damaged.push_back({"poses", -1, image.damage});
    return;
  }
  if (path != folder / image.name) {
    placed->names.insert(path.lexically_relative(folder).string());
    placed->found_elsewhere.push_back(path.string());
  }
  if (std::abs(image.quaternion_length - 1) > kUnitLength)
    placed->not_normalised.push_back(image.name);
  const auto id = static_cast<std::int64_t>(recording->frames.size());
  placed->frame_of_image[image.id] = id;
  recording->frames.push_back({id, id * photographs::kFrameTime_ns,
                               image.camera_from_world.inverse(Eigen::Isometry) *
                                   photographs::body_from_camera().inverse(Eigen::Isometry)});
  camera->second.images.push_back({{id, path}, mask, false});
}

/// Reports images of the model that are not as it says, images without a pose, and masks of none.
void report_images(const PlacedImages& placed, const PhotoFiles& files, MaskFolder* masks,
                   std::vector<Finding>* findings) {
  photographs::note_found_elsewhere(placed.found_elsewhere, findings);
  if (!placed.not_normalised.empty())
    findings->push_back({files.images.filename().string(),
                         "quaternions of " + counted(placed.not_normalised.size(), "image") +
                             " are more than 0.001 off the length 1; they are normalised: " +
                             first_few(placed.not_normalised)});
  if (!placed.missing.empty())
    findings->push_back(
        {"frames", counted(placed.missing.size(), "image") +
                       " of the model, but not in images, left out: " + first_few(placed.missing)});
  const std::vector<std::string> others = images_without_pose(files.images_folder, placed.names);
  for (const std::string& name : others) masks->find(name);
  if (!others.empty())
    findings->push_back(
        {"images", counted(others.size(), "image") +
                       " without a pose in the model, left out: " + first_few(others)});
  masks->report_unused(findings);
}

/// Takes points as the recording's, and its bounds from them.
void take_points(const fs::path& file, const fs::path& images_file,
                 const std::set<std::int64_t>& images, Recording* recording) {
  recording->points_file = file;
  std::size_t left_out = 0;
  const std::vector<PointRecord> records = read_point_records(file, &left_out);
  if (const auto finding = points_left_out(file, left_out)) recording->findings.push_back(*finding);
  report_unknown_images(records, file, images_file, images, &recording->findings);
  recording->bounds = bounds_of(recording->frames, records);
}

}  // namespace

bool looks_like(const fs::path& root) { return !find_models(root).empty(); }

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  Recording recording = photographs::empty_recording(root);
  std::vector<Finding>& findings = recording.findings;
  const fs::path project = project_of(root), folder = project / "images",
                 model = choose_model(find_models(root), folder, &findings);
  const PhotoFiles files{folder, required_file(model, "cameras"), required_file(model, "images")};
  const std::vector<CameraRecord> cameras =
      read(files.cameras, parse_cameras_binary, parse_cameras_text);
  std::vector<ImageRecord> images = read(files.images, parse_images_binary, parse_images_text);
  apply_rigs(model, &images, &findings);
  std::ranges::sort(images, [](const ImageRecord& a, const ImageRecord& b) {
    return strverscmp(a.name.c_str(), b.name.c_str()) < 0;
  });
  if (!is_folder(folder))
    throw InputError(folder, "", "",
                     "no such folder; the images of " + files.images.string() + " belong there");

  std::map<std::int64_t, RecordedCamera> by_id = recorded_cameras(cameras, files.cameras);
  MaskFolder masks(project);
  PlacedImages placed;
  for (const ImageRecord& image : images)
    place_image(image, files, masks.find(image.name), &by_id, &recording, &placed);
  report_images(placed, files, &masks, &findings);
  for (auto& [id, camera] : by_id)
    if (!camera.images.empty()) recording.cameras.push_back(std::move(camera));
  const std::vector<std::string>& missing = placed.missing;
  if (recording.cameras.empty() && missing.empty() && !recording.damaged.empty())
    throw InputError(files.images, "", "", "no pose can be used: " + recording.damaged.front().why);
  if (recording.cameras.empty())
    photographs::refuse_without_images(folder, missing.empty() ? "" : missing.front());
  photographs::fit_to_images(&recording);

  leave_out_far_photographs(&recording);
  if (const fs::path points = find_file(model, "points3D"); points.empty()) {
    findings.push_back({"points3D", "missing: nothing says where the scene is"});
    photographs::report_unread_points({model, project}, "", &findings);
  } else {
    take_points(points, files.images, placed.ids, &recording);
  }
  recording.reader = std::make_shared<Reader>(std::move(placed.frame_of_image));
  return recording;
}

}  // namespace redrive::colmap
