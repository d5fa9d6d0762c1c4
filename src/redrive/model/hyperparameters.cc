// SPDX-License-Identifier: Apache-2.0
#include "redrive/model/hyperparameters.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <type_traits>

#include "redrive/base/error.h"

namespace redrive {
namespace {

template <class T>
std::string text_of(T value) {
  char buffer[64];
  return {buffer, std::to_chars(buffer, buffer + sizeof buffer, value).ptr};
}

/// Parses all of `text` as a T; returns whether it is one.
template <class T>
bool parse(std::string_view text, T* value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), *value);
  return error == std::errc() && end == text.data() + text.size();
}

bool valid_list(const Hyperparameter& what, const std::vector<std::int64_t>& values) {
  const auto follows = [&](std::int64_t a, std::int64_t b) {
    return what.repeats ? a <= b : a < b;
  };
  return std::ranges::adjacent_find(values, std::not_fn(follows)) == values.end() &&
         std::ranges::all_of(
             values, [&](std::int64_t value) { return what.contains(static_cast<double>(value)); });
}
std::string list_rule(const Hyperparameter& what) {
  return "must be ascending, each " + what.rule();
}

class Lister final : public HyperparameterVisitor {
 public:
  void operator()(const Hyperparameter& what, int& value) override {
    values.push_back({what, text_of(value), /*whole=*/true});
  }
  void operator()(const Hyperparameter& what, float& value) override {
    values.push_back({what, text_of(value)});
  }
  void operator()(const Hyperparameter& what, double& value) override {
    values.push_back({what, text_of(value)});
  }
  void operator()(const Hyperparameter& what, std::vector<std::int64_t>& steps) override {
    values.push_back({what, text_from_steps(steps), /*whole=*/true, /*is_list=*/true});
  }

  std::vector<HyperparameterValue> values;
};

class Setter final : public HyperparameterVisitor {
 public:
  Setter(std::string_view name, const std::string& text) : name_(name), text_(text) {}
  void operator()(const Hyperparameter& what, int& value) override { set(what, &value); }
  void operator()(const Hyperparameter& what, float& value) override { set(what, &value); }
  void operator()(const Hyperparameter& what, double& value) override { set(what, &value); }
  void operator()(const Hyperparameter& what, std::vector<std::int64_t>& steps) override {
    if (what.name != name_) return;
    found = true;
    if (!steps_from_text(text_, &steps) || !valid_list(what, steps))
      throw UsageError(what.flag(), text_, list_rule(what));
  }

  bool found = false;

 private:
  template <class T>
  void set(const Hyperparameter& what, T* value) {
    if (what.name != name_) return;
    found = true;
    if (what.derived)
      throw UsageError(what.flag(), text_,
                       "follows from the recording, or from --near and --far, and cannot be set");
    if (!parse(text_, value))
      throw UsageError(
          what.flag(), text_,
          std::is_integral_v<T> ? "must be a whole number in range" : "must be a number");
    if (!what.contains(static_cast<double>(*value)))
      throw UsageError(what.flag(), text_, "must be " + what.rule());
  }

  std::string_view name_;
  const std::string& text_;
};

class RangeChecker final : public HyperparameterVisitor {
 public:
  explicit RangeChecker(const HyperparameterFailure& fail) : fail_(fail) {}
  void operator()(const Hyperparameter& what, int& value) override { check(what, value); }
  void operator()(const Hyperparameter& what, float& value) override { check(what, value); }
  void operator()(const Hyperparameter& what, double& value) override { check(what, value); }
  void operator()(const Hyperparameter& what, std::vector<std::int64_t>& steps) override {
    if (!valid_list(what, steps)) fail_(what, text_from_steps(steps), list_rule(what));
  }

 private:
  template <class T>
  void check(const Hyperparameter& what, T value) {
    if (!what.contains(static_cast<double>(value)))
      fail_(what, text_of(value), "must be " + what.rule());
  }

  const HyperparameterFailure& fail_;
};

}  // namespace

std::string text_from_steps(const std::vector<std::int64_t>& steps) {
  std::string text;
  for (const std::int64_t step : steps) {
    if (!text.empty()) text += ',';
    text += text_of(step);
  }
  return text;
}

bool steps_from_text(std::string_view text, std::vector<std::int64_t>* steps) {
  steps->clear();
  for (std::size_t begin = 0; begin < text.size();) {
    const std::size_t end = std::min(text.find(',', begin), text.size());
    if (!parse(text.substr(begin, end - begin), &steps->emplace_back())) return false;
    begin = end + 1;
  }
  return true;
}

Hyperparameter Hyperparameter::exclusive() const {
  Hyperparameter out = *this;
  out.above_low = true;
  return out;
}

Hyperparameter Hyperparameter::multiple_of(int n) const {
  Hyperparameter out = *this;
  out.multiple = n;
  return out;
}

Hyperparameter Hyperparameter::repeating() const {
  Hyperparameter out = *this;
  out.repeats = true;
  return out;
}

Hyperparameter Hyperparameter::as_option(const std::string& o) const {
  Hyperparameter out = *this;
  out.option = o;
  return out;
}

Hyperparameter Hyperparameter::from_recording() const {
  Hyperparameter out = *this;
  out.derived = true;
  return out;
}

std::string Hyperparameter::rule() const {
  const bool lower = low > std::numeric_limits<double>::lowest(),
             upper = high < std::numeric_limits<double>::max();
  if (!lower && !upper) return "a number";
  std::string range;
  if (above_low)
    range = "above " + text_of(low) + (upper ? ", at most " + text_of(high) : "");
  else if (lower && upper)
    range = text_of(low) + ".." + text_of(high);
  else
    range = lower ? "at least " + text_of(low) : "at most " + text_of(high);
  return multiple > 1 ? "a multiple of " + std::to_string(multiple) + " in " + range : range;
}

bool Hyperparameter::contains(double value) const {
  if (multiple > 1 && std::fmod(value, multiple) != 0) return false;
  return (above_low ? value > low : value >= low) && value <= high;
}

std::vector<HyperparameterValue> hyperparameter_values(Configurable& numbers) {
  Lister lister;
  numbers.visit_hyperparameters(lister);
  return std::move(lister.values);
}

bool set_hyperparameter(Configurable& numbers, std::string_view name, const std::string& text) {
  Setter setter(name, text);
  numbers.visit_hyperparameters(setter);
  return setter.found;
}

void check_ranges(const std::function<void(HyperparameterVisitor&)>& visit,
                  const HyperparameterFailure& fail) {
  RangeChecker checker(fail);
  visit(checker);
}

}  // namespace redrive
