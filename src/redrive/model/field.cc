// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/field.h"

#include "redrive/base/error.h"
#include "redrive/model/gaussian_gltf.h"
#include "redrive/model/gaussian_ply.h"
#include "redrive/model/gaussian_spz.h"
#include "redrive/model/gaussian_usd.h"

namespace redrive {
namespace {

ActorBody body_to_export(const FieldGaussians& gaussians, const MovingObject& actor) {
  ActorBody body = gaussians.body(actor);
  if (body.n == 0)
    throw UsageError("--actors", std::to_string(actor.id),
                     "has no Gaussians: no training image shows it");
  return body;
}

}  // namespace

std::vector<ExportFormat> Field::export_formats() const {
  const FieldGaussians* const of = as_gaussians();
  if (!of) return {};
  const auto encoded = [of](std::string (*encode)(const kernels::Gaussians&, int sh_degree)) {
    return [of, encode](const ExportOptions& options) {
      if (!options.actor) return encode(of->world().gaussians, options.sh_degree);
      const ActorBody body = body_to_export(*of, *options.actor);
      return encode({body.n, body.numbers}, options.sh_degree);
    };
  };
  return {{"splat-ply", "PLY of 3D Gaussians, as viewers of 3D Gaussian Splatting read it",
           [of](const ExportOptions& options) {
             if (!options.actor) return gaussian_ply(of->world().gaussians, options.sh_degree);
             const ActorBody body = body_to_export(*of, *options.actor);
             return gaussian_ply({body.n, body.numbers}, options.sh_degree,
                                 body_comments(body.type, body.size_m));
           }},
          {"splat-spz", "SPZ, a fifth of the size; positions, colours and angles are rounded",
           encoded(gaussian_spz)},
          {"splat-gltf", "binary glTF with KHR_gaussian_splatting", encoded(gaussian_gltf)},
          {"splat-usd", "USDZ with a ParticleField3DGaussianSplat; numbers are rounded",
           encoded(gaussian_usd), "default.usda"}};
}

}  // namespace redrive
