// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/resample.h"

#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"
#include "redrive/base/opencv_threads.h"

namespace redrive {

ResampleMap make_resample_map(const Camera& camera, const Camera& recorded,
                              const Eigen::Matrix3d& recorded_from_camera) {
  const std::size_t pixels = static_cast<std::size_t>(camera.width) * camera.height;
  ResampleMap map{camera.width, camera.height, std::vector<float>(pixels, -1.0f),
                  std::vector<float>(pixels, -1.0f)};
  for (int y = 0; y < camera.height; ++y)
    for (int x = 0; x < camera.width; ++x) {
      const auto direction = camera.unproject({x, y});
      const auto pixel =
          direction ? recorded.project(recorded_from_camera * *direction) : std::nullopt;
      if (!pixel) continue;
      const std::size_t i = static_cast<std::size_t>(y) * camera.width + x;
      map.u[i] = static_cast<float>(pixel->x());
      map.v[i] = static_cast<float>(pixel->y());
    }
  return map;
}

std::vector<std::uint8_t> resample(const ResampleMap& map, const std::vector<std::uint8_t>& values,
                                   int width, int height, int channels, std::uint8_t border) {
  REDRIVE_CHECK(channels == 1 || channels == 3);
  const auto mat = [](int h, int w, int type, const auto& data) {
    using Value = std::remove_const_t<std::remove_reference_t<decltype(data[0])>>;
    return cv::Mat(h, w, type, const_cast<Value*>(data.data()));  // read only
  };
  const int type = CV_MAKETYPE(CV_8U, channels);
  std::vector<std::uint8_t> out(map.u.size() * static_cast<std::size_t>(channels));
  cv::Mat result(map.height, map.width, type, out.data());
  cv::remap(mat(height, width, type, values), result, mat(map.height, map.width, CV_32F, map.u),
            mat(map.height, map.width, CV_32F, map.v), cv::INTER_LINEAR, cv::BORDER_CONSTANT,
            cv::Scalar::all(border));
  return out;
}

}  // namespace redrive
