// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/model.h"

#include "redrive/model/grid_model.h"
#include "redrive/model/nerf_model.h"

namespace redrive {

std::unique_ptr<Model> make_model(std::string_view method) {
  if (method == "nerf") return std::make_unique<NerfModel>();
  if (method == "grid") return std::make_unique<GridModel>();
  return nullptr;
}

}  // namespace redrive
