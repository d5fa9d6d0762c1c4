// SPDX-License-Identifier: Apache-2.0
// A program of the build: writes the formulas and constants of this project as GLSL.
//   write_formulas FOLDER    makes constants.glsl, formulas.glsl, ssim.glsl and flip.glsl
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/kernels/gaussian/vulkan/formulas/traced_gaussian.h"
#include "redrive/math/angle_of.h"
#include "redrive/optim/flip.h"
#include "redrive/optim/ssim.h"
#include "redrive/optim/ssim_gradient.h"

namespace redrive::trace {
namespace {

std::string number(double x) { return name_of(id_of(x)); }

#define REDRIVE_INT(name) "const int " #name " = " << int(name) << ";\n"
#define REDRIVE_FLOAT(name) "const float " #name " = " << number(double(name)) << ";\n"

std::string constants() {
  using namespace kernels;
  const double kLog2InverseMinAlpha = -std::log2(double(kMinAlpha));
  std::ostringstream out;
  out << "// field/gaussian.h\n"
      << REDRIVE_INT(kPositionRow) << REDRIVE_INT(kLogScaleRow) << REDRIVE_INT(kQuaternionRow)
      << REDRIVE_INT(kOpacityRow) << REDRIVE_INT(kColourRow) << REDRIVE_INT(kHarmonicsRow)
      << REDRIVE_INT(kLidarRow) << REDRIVE_INT(kDistanceRow) << REDRIVE_INT(kGaussianRows)
      << REDRIVE_INT(kGaussianBlock) << REDRIVE_INT(kBlockSize) << REDRIVE_INT(kIntensitySlot)
      << REDRIVE_INT(kReturnSlot) << REDRIVE_FLOAT(kMinAlpha) << REDRIVE_FLOAT(kMaxAlpha)
      << REDRIVE_FLOAT(kMinTransmittance) << REDRIVE_FLOAT(kMaxLogDistance)
      << REDRIVE_FLOAT(kMaxRangeError) << REDRIVE_FLOAT(kLog2InverseMinAlpha)
      << "// is_seen: bit `row` of kSeenRows[by]\nconst uint kSeenRows[3] = uint[3](";
  for (const SeenBy by : {SeenBy::kCamera, SeenBy::kLidar, SeenBy::kBoth}) {
    unsigned bits = 0;
    for (int row = 0; row < kDistanceRow; ++row) bits |= unsigned{is_seen(by, row)} << row;
    out << bits << (by == SeenBy::kBoth ? "u);\n" : "u, ");
  }
  constexpr int kLensNumbers = PlainCamera::kMostNumbers;
  out << "// camera/plain_camera.h\n"
      << REDRIVE_INT(kLensNumbers) << "// kernels/gaussian/pair_sums.h\n"
      << REDRIVE_INT(kSumAlpha) << REDRIVE_INT(kSumX) << REDRIVE_INT(kSumY) << REDRIVE_INT(kSumXX)
      << REDRIVE_INT(kSumXY) << REDRIVE_INT(kSumYY) << REDRIVE_INT(kSumRgb)
      << REDRIVE_INT(kSumError) << REDRIVE_INT(kSumLogDistance) << REDRIVE_INT(kPairSums)
      << "// kernels/gaussian/gaussian_stages.h\n"
      << REDRIVE_INT(kTileSide) << REDRIVE_INT(kPatchSide) << REDRIVE_FLOAT(kNoRange)
      << REDRIVE_FLOAT(kSaturated);
  return out.str();
}

/// Functions of every camera, and those that choose among them by kModel.
std::string formulas() {
  std::string text = R"(#include "constants.glsl"

// Index into CameraModel, as PlainCamera::model; -1: the projection of a LiDAR.
layout(constant_id = 0) const int kModel = 0;

struct PlainCamera {  // camera/plain_camera.h
  float fx, fy, cx, cy;
  float numbers[kLensNumbers];
  float max_radius2;
};
struct Pose {  // GaussianPose
  float rotation[9];  // camera_from_world, row-major
  float centre[3];    // position of the camera in the world
};
struct Projected {  // ProjectedGaussian; numbers are arbitrary where it is not visible
  bool visible;
  float mean[2], conic[3], variance[2], covariance, slope[2], alpha, distance, colour[3];
};

)";
  text += function("float angle_of(float y, float x)",
                   {{"float angle", angle_of<TraceMath>(input("y"), input("x"))}});
  text.replace(text.rfind("}  //"), 0, "  return angle;\n");
  Sym r[3][3];
  rotation_from_quaternion<TraceMath>(inputs<4>("q").data(), r);
  std::vector<Output> rotation;
  for (int k = 0; k < 9; ++k) rotation.emplace_back(indexed("r", k), r[k / 3][k % 3]);
  text += function("void rotation_from_quaternion(float q[4], out float r[9])", rotation);

  struct Head {
    std::string name, in, out, arguments, choice{};
  };
  const std::string camera = "PlainCamera c, Pose pose, float rows[kGaussianRows]";
  Head heads[] = {{"project_mean", camera, ", out float mean[2], out bool visible",
                   "c, pose, rows, mean, visible"},
                  {"project_gaussian", camera, ", out Projected o", "c, pose, rows, o"},
                  {"project_adjoint", camera + ", float sum[kPairSums]",
                   ", out float d_rows[kGaussianRows], out float d_pose[6]",
                   "c, pose, rows, sum, d_rows, d_pose"}};
  const auto write = [&](const auto& of, const std::string& name) {
    TracedGaussian gaussian(of);
    const std::vector<Output> outputs[] = {gaussian.mean(), gaussian.projection(),
                                           gaussian.adjoint()};
    for (int i = 0; i < 3; ++i)
      text +=
          function("void " + heads[i].name + "_" + name + "(" + heads[i].in + heads[i].out + ")",
                   outputs[i]);
  };
  int model = 0;
  for_each_model([&](const auto& of, const std::string& name) {
    write(of, name);
    for (Head& head : heads)
      head.choice += "  if (kModel == " + std::to_string(model) + ") " + head.name + "_" + name +
                     "(" + head.arguments + ");\n";
    ++model;
  });
  write(TracedLidar(), "lidar");
  for (Head& head : heads)
    text += "void " + head.name + "(" + head.in + head.out + ") {\n" + head.choice +
            "  if (kModel == -1) " + head.name + "_lidar(" + head.arguments + ");\n}\n";
  return text;
}

std::string ssim() {
  std::ostringstream out;
  out << REDRIVE_INT(kSsimRadius) << REDRIVE_INT(kSsimTaps)
      << "const float kSsimWeights[kSsimTaps] = float[kSsimTaps](";
  const SsimTaps taps = ssim_taps();
  for (int i = 0; i < kSsimTaps; ++i) out << (i > 0 ? ", " : "") << number(taps[i]);
  const SsimGradient<TraceMath> s = ssim_gradient<TraceMath>(
      input("m[0]"), input("m[1]"), input("m[2]"), input("m[3]"), input("m[4]"));
  out << ");\n// m: means over the window of x, y, xx, yy, xy\n"
      << function(
             "void ssim_gradient(float m[5], out float ssim, out float by_x, out float by_xx, "
             "out float by_xy)",
             {{"ssim", s.ssim}, {"by_x", s.by_x}, {"by_xx", s.by_xx}, {"by_xy", s.by_xy}});
  return out.str();
}

std::string numbers(const float* values, int n) {
  std::string text = "float[](";
  for (int i = 0; i < n; ++i) text += (i > 0 ? ", " : "") + number(static_cast<double>(values[i]));
  return text + ")";
}

std::string flip() {
  const FlipFilters filters = flip_filters();
  std::ostringstream out;
  out << REDRIVE_INT(kFlipColourRadius) << REDRIVE_INT(kFlipFeatureRadius)
      << REDRIVE_INT(kFlipTerms);
  int term = 0;
  for (const FlipFilters::Term& of : filters.colour)
    out << "const float kFlipColour" << term++ << "[] = " << numbers(of.taps, kFlipColourTaps)
        << ";\n";
  out << "const float kFlipSmooth[] = " << numbers(filters.smooth, kFlipFeatureTaps)
      << ";\nconst float kFlipFirst[] = " << numbers(filters.first, kFlipFeatureTaps)
      << ";\nconst float kFlipSecond[] = " << numbers(filters.second, kFlipFeatureTaps)
      << ";\nconst float kFlipWeights[] = float[](";
  for (int t = 0; t < kFlipTerms; ++t)
    out << (t > 0 ? ", " : "") << number(static_cast<double>(filters.colour[t].weight));
  out << ");\n";
  const auto three = [](const std::string& name, const Sym(&values)[3]) {
    return std::vector<Output>{
        {name + "[0]", values[0]}, {name + "[1]", values[1]}, {name + "[2]", values[2]}};
  };
  Sym opponent[3], lab[3];
  flip_opponent<TraceMath>(inputs<3>("srgb").data(), opponent);
  flip_lab<TraceMath>(inputs<3>("opponent").data(), lab);
  FlipPixel<TraceMath> pixels[2];
  for (int i = 0; i < 2; ++i) {
    const auto of_pixel = inputs<5>(i == 0 ? "a" : "b");
    for (int k = 0; k < 3; ++k) pixels[i].lab[k] = of_pixel[k];
    pixels[i].edges = of_pixel[3];
    pixels[i].points = of_pixel[4];
  }
  out << function("void flip_opponent(float srgb[3], out float opponent[3])",
                  three("opponent", opponent))
      << function("void flip_lab(float opponent[3], out float lab[3])", three("lab", lab))
      << "// a, b: L*a*b*, edges and points\n"
      << function("void flip_difference(float a[5], float b[5], out float error)",
                  {{"error", flip_difference<TraceMath>(filters.largest, pixels[0], pixels[1])}});
  return out.str();
}

void write(const std::filesystem::path& file, const std::string& text) {
  const std::string guard = file.stem().string() + "_glsl";
  std::ofstream out(file);
  out << "// Generated by formulas/write_formulas.cc.\n#ifndef " << guard << "\n#define " << guard
      << "\n"
      << text << "#endif\n";
  if (!out.flush()) throw std::runtime_error(file.string() + ": cannot be written");
}

}  // namespace
}  // namespace redrive::trace

int main(int, char** arguments) {
  using namespace redrive::trace;
  const std::filesystem::path folder = arguments[1];
  write(folder / "constants.glsl", constants());
  write(folder / "formulas.glsl", formulas());
  write(folder / "ssim.glsl", ssim());
  write(folder / "flip.glsl", flip());
}
