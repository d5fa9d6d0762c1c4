// SPDX-License-Identifier: Apache-2.0
// Fills places of the world that moving objects hide in every training image. No image constrains
// the Gaussians there, so they have arbitrary colours, which an edit that moves the object would
// show. They are replaced by a smooth continuation of the surroundings.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/methods/splat/actors/drawn_gaussians.h"
#include "redrive/scene/shutter_poses.h"

namespace redrive {

/// A training image at a small size.
struct FillView {
  Camera camera;
  ShutterPoses poses;
  DrawnGaussians drawn;
  std::vector<std::uint8_t> used;  ///< [height, width], 0: masked; empty: no pixel is
};

/// The training images: their number, and each of them with the current Gaussians.
struct FillViews {
  std::size_t n = 0;
  std::function<FillView(std::size_t)> view;
};

/// Whether a pixel shows what images saw, without objects and hidden Gaussians.
enum class FillPixel : std::uint8_t { kKnown, kUnknown, kFill, kEmpty };

/// Places of the world that moving objects hide in all images.
struct HiddenPlaces {
  std::vector<std::size_t> gaussians;  ///< Gaussians of the world
  struct Hole {
    std::size_t view;
    std::vector<FillPixel> pixels;  ///< [height, width]
  };
  std::vector<Hole> holes;  ///< holes in the views that would show hidden Gaussians
};

/// Finds the Gaussians of the world that no image sees, but would see without its moving objects.
/// An image sees a Gaussian if the sum of its blending weights is at least 0.05 pixels and a tenth
/// of the sum without objects. all: the `world` first Gaussians, then the parts.
HiddenPlaces find_hidden(kernels::GaussianStages& stages, const FillViews& views,
                         const kernels::Gaussians& all, std::size_t world);

/// Returns the maximum number of new Gaussians that fill the holes.
std::size_t fills_needed(const HiddenPlaces& hidden);

/// Fills the holes after the hidden Gaussians are gone. In each image, the pixels in which hidden
/// Gaussians had most of the weight get the colours and inverse distances of a membrane from their
/// border: the solution of Laplace's equation (Pérez, Gangnet and Blake, Poisson Image Editing,
/// 2003). The new Gaussians of these pixels are written to the world's last `spare` places. Pixels
/// that an earlier image has filled stay. A new Gaussian that an image sees in front of other
/// things is removed; unused places are transparent.
void fill_holes(kernels::GaussianStages& stages, const FillViews& views, const HiddenPlaces& hidden,
                std::size_t gaussians, std::size_t world, std::size_t spare,
                std::span<float> numbers);

}  // namespace redrive
