// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/scene_page.h"

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/gzip.h"
#include "redrive/field/gaussian.h"
#include "redrive/model/gaussian_spz.h"
#include "redrive/render/camera_path.h"
#include "redrive/render/view_pose.h"
#include "redrive/report/html.h"
#include "redrive/view/page.h"

namespace redrive::view {
namespace {

/// Replaces the only `mark` in `text`.
void fill(std::string_view mark, std::string_view with, std::string* text) {
  const std::size_t at = text->find(mark);
  REDRIVE_CHECK(at != std::string::npos);
  text->replace(at, mark.size(), with);
}

/// Returns the name of a run's folder; "run/" is run.
std::string name_of(const std::filesystem::path& run) {
  return (run.has_filename() ? run : run.parent_path()).filename().string();
}

}  // namespace

std::string scene_page(const Run& run, int sh_degree) {
  const FieldGaussians* const gaussians = run.field()->as_gaussians();
  if (!gaussians)
    throw UsageError("--to", "html",
                     "shows Gaussians, and the run is of method " + run.options.method);
  const ScenePageFiles files = scene_page_files();
  if (files.script_gz.empty())
    throw UsageError("--to", "html",
                     "this build has no pages: node and npm were missing, or npm could not "
                     "install; scripts/setup and another build bring them");
  const RigCamera& camera = run.scene.rig.front();
  nlohmann::json drive = nlohmann::json::array();
  const CameraPath path = drive_path(run.scene, camera, 0);
  for (const PathKey& key : path.keys)
    drive.push_back(
        {{"t_s", key.t_s}, {"camera_to_world", camera_to_world_json(key.world_from_camera)}});
  const Eigen::Vector3d up = up_in_world(run.scene);
  const WorldGaussians world = gaussians->world();
  const nlohmann::json scene = {{"fov", fov_of(camera.camera)},
                                {"screen_variance", kScreenVariance},
                                {"background", world.background},
                                {"up", {up.x(), up.y(), up.z()}},
                                {"drive", drive}};
  std::string html = gunzip(files.html_gz);
  // The script and the data contain marks themselves: fills the last ones first.
  fill("@SCRIPT@", gunzip(files.script_gz), &html);
  fill("@SPLATS@", base64(gaussian_spz(world.gaussians, sh_degree)), &html);
  fill("@SCENE@", scene.dump(), &html);
  fill("@TITLE@", html_escape(name_of(run.paths.root) + " - redrive"), &html);
  return html;
}

}  // namespace redrive::view
