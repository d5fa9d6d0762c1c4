// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include "redrive/methods/grid/grid_model.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/model/method.h"

namespace redrive {
namespace {

std::vector<Method>& registry() {
  static std::vector<Method> all = {
      grid_method(),
      nerf_method(),
      splat_method(),
  };
  return all;
}

}  // namespace

const std::vector<Method>& methods() { return registry(); }

std::string Preset::text() const {
  std::string text = help;
  for (std::size_t i = 0; help.empty() && i < values.size(); ++i)
    text += (i == 0 ? "--" : " --") + values[i].first + " " + values[i].second;
  return text;
}

const Method* find_method(std::string_view name) {
  const auto found = std::ranges::find(registry(), name, &Method::name);
  return found == registry().end() ? nullptr : &*found;
}

void register_method(const Method& method) { registry().push_back(method); }

std::unique_ptr<Trainee> make_model(std::string_view method) {
  const Method* found = find_method(method);
  return found ? found->make() : nullptr;
}

}  // namespace redrive
