// SPDX-License-Identifier: Apache-2.0
// An arithmetic (math/lanes.h) whose numbers are expressions: a formula template that runs once
// with it is written down, as GLSL for a shader or as numbers for a test. It works because the
// templates select instead of branching and their loops have constant counts.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

namespace redrive::trace {

/// A number: a constant, or the index of an expression.
struct Sym {
  int id = -1;
  double value = 0;

  constexpr Sym() = default;
  constexpr Sym(double x) : value(x) {}
  bool is(double x) const { return id < 0 && value == x; }
};

/// GLSL of an operation, with $0 $1 $2 for its arguments, and its value. Masks are 0 or 1.
struct Operation {
  const char* glsl;
  bool is_mask;
  double (*value)(double, double, double);
};

/// An expression; without an operation an input of that name, or a constant if it has none.
struct Node {
  const Operation* operation = nullptr;
  std::string input{};
  double constant = 0;
  std::array<int, 3> arguments{-1, -1, -1};

  auto key() const { return std::tie(operation, input, constant, arguments); }
  bool operator<(const Node& other) const { return key() < other.key(); }
};

/// All expressions, each once, arguments before what uses them.
inline std::vector<Node> nodes;
inline std::map<Node, int> known;

inline int add(const Node& node) {
  const auto [at, is_new] = known.try_emplace(node, static_cast<int>(nodes.size()));
  if (is_new) nodes.push_back(node);
  return at->second;
}
inline int id_of(const Sym& x) { return x.id >= 0 ? x.id : add({.constant = x.value}); }
inline Sym sym(int id) {
  Sym x;
  x.id = id;
  return x;
}
inline Sym input(const std::string& name) { return sym(add({.input = name})); }

struct SymMask {
  int id = -1;

  /// A branch within a formula. TracedRadial follows both ways.
  inline explicit operator bool() const;
};

/// The only branch that a formula may have: its condition, and which way a run takes.
struct Branch {
  SymMask condition;
  bool taken = false;
};
inline Branch branch;
inline SymMask::operator bool() const {
  if (branch.condition.id >= 0 && branch.condition.id != id)
    throw std::logic_error("a formula has two branches");
  branch.condition = *this;
  return branch.taken;
}

/// Applies an operation; a constant where all arguments are.
inline Sym apply(const Operation* operation, const Sym& a, const Sym& b = {}, const Sym& c = {},
                 int n = 2) {
  if (a.id < 0 && b.id < 0 && c.id < 0) return operation->value(a.value, b.value, c.value);
  return sym(add({.operation = operation,
                  .arguments = {id_of(a), n > 1 ? id_of(b) : -1, n > 2 ? id_of(c) : -1}}));
}

#define REDRIVE_OPERATION(name, glsl, is_mask, expression)             \
  inline constexpr Operation name {                                    \
    glsl, is_mask,                                                     \
        []([[maybe_unused]] double a, [[maybe_unused]] double b,       \
           [[maybe_unused]] double c) -> double { return expression; } \
  }
REDRIVE_OPERATION(kAdd, "$0 + $1", false, a + b);
REDRIVE_OPERATION(kSubtract, "$0 - $1", false, a - b);
REDRIVE_OPERATION(kMultiply, "$0 * $1", false, a* b);
REDRIVE_OPERATION(kDivide, "$0 / $1", false, a / b);
REDRIVE_OPERATION(kNegate, "-$0", false, -a);
REDRIVE_OPERATION(kSqrt, "sqrt($0)", false, std::sqrt(a));
REDRIVE_OPERATION(kExp, "exp($0)", false, std::exp(a));
REDRIVE_OPERATION(kLog, "log($0)", false, std::log(a));
REDRIVE_OPERATION(kMin, "min($0, $1)", false, a < b ? a : b);
REDRIVE_OPERATION(kMax, "max($0, $1)", false, a > b ? a : b);
/// GLSL's atan has 4096 ulp (math/angle_of.h).
REDRIVE_OPERATION(kAngle, "angle_of($0, $1)", false, std::atan2(a, b));
REDRIVE_OPERATION(kSelect, "$0 ? $1 : $2", false, a != 0 ? b : c);
REDRIVE_OPERATION(kLess, "$0 < $1", true, a < b);
REDRIVE_OPERATION(kGreater, "$0 > $1", true, a > b);
REDRIVE_OPERATION(kNotGreater, "$0 <= $1", true, a <= b);
REDRIVE_OPERATION(kNotLess, "$0 >= $1", true, a >= b);
REDRIVE_OPERATION(kEqual, "$0 == $1", true, a == b);
REDRIVE_OPERATION(kBoth, "$0 && $1", true, a != 0 && b != 0);
REDRIVE_OPERATION(kEither, "$0 || $1", true, a != 0 || b != 0);
#undef REDRIVE_OPERATION

inline Sym operator+(const Sym& a, const Sym& b) {
  return a.is(0) ? b : b.is(0) ? a : apply(&kAdd, a, b);
}
inline Sym operator-(const Sym& a) { return apply(&kNegate, a, {}, {}, 1); }
inline Sym operator-(const Sym& a, const Sym& b) {
  return b.is(0) ? a : a.is(0) ? -b : apply(&kSubtract, a, b);
}
inline Sym operator*(const Sym& a, const Sym& b) {
  return a.is(1) ? b : b.is(1) ? a : apply(&kMultiply, a, b);
}
inline Sym operator/(const Sym& a, const Sym& b) { return b.is(1) ? a : apply(&kDivide, a, b); }

inline SymMask mask(const Operation* operation, int a, int b) {
  return {add({.operation = operation, .arguments = {a, b, -1}})};
}
inline SymMask operator<(const Sym& a, const Sym& b) { return mask(&kLess, id_of(a), id_of(b)); }
inline SymMask operator>(const Sym& a, const Sym& b) { return mask(&kGreater, id_of(a), id_of(b)); }
inline SymMask operator<=(const Sym& a, const Sym& b) {
  return mask(&kNotGreater, id_of(a), id_of(b));
}
inline SymMask operator>=(const Sym& a, const Sym& b) {
  return mask(&kNotLess, id_of(a), id_of(b));
}
inline SymMask operator==(const Sym& a, const Sym& b) { return mask(&kEqual, id_of(a), id_of(b)); }

/// The arithmetic.
struct TraceMath {
  using Real = Sym;
  using Mask = SymMask;
  static constexpr int kLanes = 1;

  static Sym constant(const Sym& x) { return x; }
  static Sym sqrt(const Sym& x) { return apply(&kSqrt, x, {}, {}, 1); }
  static Sym exp(const Sym& x) { return apply(&kExp, x, {}, {}, 1); }
  static Sym log(const Sym& x) { return apply(&kLog, x, {}, {}, 1); }
  static Sym atan2(const Sym& y, const Sym& x) { return apply(&kAngle, y, x); }
  static Sym min(const Sym& a, const Sym& b) { return apply(&kMin, a, b); }
  static Sym max(const Sym& a, const Sym& b) { return apply(&kMax, a, b); }
  static Sym select(SymMask holds, const Sym& a, const Sym& b) {
    return sym(add({.operation = &kSelect, .arguments = {holds.id, id_of(a), id_of(b)}}));
  }
  static SymMask both(SymMask a, SymMask b) { return mask(&kBoth, a.id, b.id); }
  static SymMask either(SymMask a, SymMask b) { return mask(&kEither, a.id, b.id); }
  static Sym stopped(const Sym& x) { return x; }
};

/// An output of a formula, `name` in GLSL.
struct Output {
  std::string name;
  int id;

  Output(std::string to, const Sym& x) : name(std::move(to)), id(id_of(x)) {}
  Output(std::string to, SymMask x) : name(std::move(to)), id(x.id) {}
};

inline std::vector<bool> needed_for(const std::vector<Output>& outputs) {
  std::vector<bool> needed(nodes.size());
  for (const Output& output : outputs) needed[output.id] = true;
  for (std::size_t i = nodes.size(); i-- > 0;)
    for (const int argument : nodes[i].arguments)
      if (needed[i] && argument >= 0) needed[argument] = true;
  return needed;
}

/// How an expression is called in GLSL.
inline std::string name_of(int id) {
  const Node& node = nodes[id];
  if (node.operation) return "t" + std::to_string(id);
  if (!node.input.empty()) return node.input;
  char text[40];
  std::snprintf(text, sizeof text, "%.9g", static_cast<double>(static_cast<float>(node.constant)));
  std::string number = text;
  if (number.find_first_of(".en") == std::string::npos) number += ".0";
  return node.constant < 0 ? "(" + number + ")" : number;
}

/// Returns a GLSL function that computes the outputs, each expression once.
inline std::string function(const std::string& head, const std::vector<Output>& outputs) {
  const std::vector<bool> needed = needed_for(outputs);
  std::string text = head + " {\n";
  int n = 0;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    const Node& node = nodes[i];
    if (!needed[i] || !node.operation) continue;
    std::string right = node.operation->glsl;
    for (int k = 0; k < 3; ++k)
      if (const auto at = right.find("$" + std::to_string(k)); at != std::string::npos)
        right.replace(at, 2, name_of(node.arguments[k]));
    text += (node.operation->is_mask ? "  bool t" : "  float t") + std::to_string(i) + " = " +
            right + ";\n";
    ++n;
  }
  for (const Output& output : outputs)
    text += "  " + output.name + " = " + name_of(output.id) + ";\n";
  return text + "}  // " + std::to_string(n) + " operations\n\n";
}

/// Returns the values of the outputs in double, given values of the inputs by name.
inline std::vector<double> values(const std::vector<Output>& outputs,
                                  const std::map<std::string, double>& inputs) {
  const std::vector<bool> needed = needed_for(outputs);
  std::vector<double> value(nodes.size());
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    if (!needed[i]) continue;
    const Node& node = nodes[i];
    const auto argument = [&](int k) {
      return node.arguments[k] < 0 ? 0 : value[node.arguments[k]];
    };
    value[i] = node.operation       ? node.operation->value(argument(0), argument(1), argument(2))
               : node.input.empty() ? node.constant
                                    : inputs.at(node.input);
  }
  std::vector<double> result;
  for (const Output& output : outputs) result.push_back(value[output.id]);
  return result;
}

}  // namespace redrive::trace
