// SPDX-License-Identifier: Apache-2.0
// What shaders must not contain, so that every driver of Vulkan 1.2 can run them: features beyond
// the least that is common to all, and shapes that crash known compilers.
#include "redrive/kernels/gaussian/vulkan/shaders.h"

#include <algorithm>
#include <cctype>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <span>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace redrive::kernels {
namespace {

namespace fs = std::filesystem;
using Faults = std::vector<std::string>;

/// Numbers of the SPIR-V specification, unified1.
namespace spv {
constexpr std::uint32_t MagicNumber = 0x07230203;
enum class Op : std::uint32_t {
  OpExecutionMode = 16,
  OpCapability = 17,
  OpTypeInt = 21,
  OpTypeFloat = 22,
  OpTypeVector = 23,
  OpTypeArray = 28,
  OpTypeStruct = 30,
  OpTypePointer = 32,
  OpConstant = 43,
  OpVariable = 59
};
enum class Capability : std::uint32_t {
  Shader = 1,
  Float16 = 9,
  Float64 = 10,
  Int64 = 11,
  Int16 = 22,
  Int8 = 39,
  GroupNonUniform = 61,
  GroupNonUniformArithmetic = 63,
  StorageBuffer16BitAccess = 4433,
  PhysicalStorageBufferAddresses = 5347,
  AtomicFloat32AddEXT = 6033
};
enum class ExecutionMode : std::uint32_t { LocalSize = 17 };
enum class StorageClass : std::uint32_t { Workgroup = 4 };
}  // namespace spv

/// The least that SwiftShader and lavapipe have.
constexpr std::uint32_t kMostThreads = 256, kMostSharedBytes = 32768;

/// Shared variables of a module, and the sizes of types.
struct Types {
  std::map<std::uint32_t, std::uint32_t> bytes, constants;  ///< values by their ids
  std::set<std::uint32_t> structs;
  std::map<std::uint32_t, std::uint32_t> shared;  ///< pointed-to type of a pointer type

  void read(spv::Op op, std::span<const std::uint32_t> words) {
    if (op == spv::Op::OpConstant) constants[words[1]] = words[2];
    if (op == spv::Op::OpTypeInt || op == spv::Op::OpTypeFloat) bytes[words[0]] = words[1] / 8;
    if (op == spv::Op::OpTypeVector) bytes[words[0]] = bytes[words[1]] * words[2];
    if (op == spv::Op::OpTypeStruct) structs.insert(words[0]);
    if (op == spv::Op::OpTypeArray) {
      bytes[words[0]] = bytes[words[1]] * constants[words[2]];
      if (structs.contains(words[1])) structs.insert(words[0]);
    }
    if (op == spv::Op::OpTypePointer && spv::StorageClass(words[1]) == spv::StorageClass::Workgroup)
      shared[words[0]] = words[2];
  }
};

/// Capabilities stand for subgroup operations, atomic floats and types of 8, 16 and 64 bits.
Faults faults_of_module(std::span<const std::uint32_t> module) {
  const std::set<spv::Capability> allowed = {spv::Capability::Shader,
                                             spv::Capability::PhysicalStorageBufferAddresses};
  Faults faults;
  Types types;
  std::uint32_t shared_bytes = 0;
  for (std::size_t at = 5; at < module.size();) {
    const std::uint32_t n = module[at] >> 16;
    const auto op = static_cast<spv::Op>(module[at] & 0xffff);
    if (n == 0 || at + n > module.size()) return {"is cut off"};
    const std::span words = module.subspan(at + 1, n - 1);
    types.read(op, words);
    if (op == spv::Op::OpCapability && !allowed.contains(spv::Capability(words[0])))
      faults.push_back("needs capability " + std::to_string(words[0]));
    if (op == spv::Op::OpExecutionMode &&
        spv::ExecutionMode(words[1]) == spv::ExecutionMode::LocalSize &&
        words[2] * words[3] * words[4] > kMostThreads)
      faults.push_back("has groups of more than 256 threads");
    if (op == spv::Op::OpVariable && types.shared.contains(words[0])) {
      const std::uint32_t type = types.shared[words[0]];
      shared_bytes += types.bytes[type];
      if (types.structs.contains(type)) faults.push_back("has a struct in shared memory");
    }
    at += n;
  }
  if (shared_bytes > kMostSharedBytes)
    faults.push_back("takes " + std::to_string(shared_bytes) + " bytes of shared memory");
  return faults;
}

/// Finds loops of variable length under an `if` in another such loop, which crash NVIDIA's compiler
/// 580: in the text of a shader, functions included as if they were inlined. A loop's length is
/// constant if its condition compares with a number or a constant (kName) alone.
class LoopNesting {
 public:
  explicit LoopNesting(const std::string& glsl) {
    std::string word;
    std::istringstream lines(glsl);
    for (std::string line; std::getline(lines, line);) {
      const auto first = line.find_first_not_of(' ');
      if (first == std::string::npos || line[first] == '#') continue;
      line.resize(std::min(line.size(), line.find("//")));
      for (std::size_t i = 0; i < line.size();) {
        std::size_t end = i;
        const auto is_word = [](char c) {
          return std::isalnum(static_cast<unsigned char>(c)) || c == '_' || c == '.';
        };
        while (end < line.size() && is_word(line[end])) ++end;
        if (end == i) ++end;
        if (line[i] != ' ') tokens_.push_back(line.substr(i, end - i));
        i = end;
      }
    }
    while (at_ < tokens_.size()) statement({});
  }
  const Faults& faults() const { return faults_; }

 private:
  struct Place {
    bool in_loop = false, under_if = false;  ///< under_if: within that loop, or the function
  };
  /// What a call brings along.
  struct Function {
    bool has_loop = false, has_loop_under_if = false;
  };

  bool is(const char* token) const { return at_ < tokens_.size() && tokens_[at_] == token; }

  /// Skips (...), and returns what it holds.
  std::vector<std::string> parenthesis(Place place) {
    const std::size_t begin = ++at_;
    for (int depth = 1; at_ < tokens_.size() && depth > 0; ++at_) {
      depth += is("(") ? 1 : is(")") ? -1 : 0;
      call(place);
    }
    return {tokens_.begin() + begin, tokens_.begin() + at_ - 1};
  }
  void call(Place place) {
    const auto found = functions_.find(tokens_[at_]);
    if (found == functions_.end() || at_ + 1 == tokens_.size() || tokens_[at_ + 1] != "(") return;
    if (found->second.has_loop) loop(place);
    if (found->second.has_loop_under_if) loop({place.in_loop, true});
  }
  void loop(Place place) {
    current_.has_loop = true;
    current_.has_loop_under_if |= place.under_if;
    if (place.in_loop && place.under_if) faults_.push_back("a loop under an if in a loop");
  }
  static bool has_constant_length(const std::vector<std::string>& head) {
    const auto begin = std::ranges::find(head, ";"),
               end = begin == head.end() ? begin : std::find(begin + 1, head.end(), ";");
    if (end == head.end()) return false;
    const std::string& bound = *(end - 1);
    return std::isdigit(static_cast<unsigned char>(bound[0])) ||
           (bound[0] == 'k' && bound.size() > 1 &&
            std::isupper(static_cast<unsigned char>(bound[1])));
  }

  void statement(Place place) {
    if (is("{")) {
      for (++at_; at_ < tokens_.size() && !is("}");) statement(place);
      ++at_;
    } else if (is("if")) {
      ++at_;
      parenthesis(place);
      statement({place.in_loop, true});
      if (!is("else")) return;
      ++at_;
      statement({place.in_loop, true});
    } else if (is("for") || is("while")) {
      ++at_;
      const bool constant = has_constant_length(parenthesis(place));
      if (!constant) loop(place);
      statement(constant ? place : Place{.in_loop = true});
    } else if (is("do")) {
      ++at_;
      loop(place);
      statement({.in_loop = true});
      while (at_ < tokens_.size() && !is(";")) ++at_;
      ++at_;
    } else {
      other(place);
    }
  }
  /// An expression, a declaration or a function.
  void other(Place place) {
    std::string name;
    for (; at_ < tokens_.size() && !is("{") && !is(";"); ++at_) {
      if (is("(") && name.empty() && at_ > 0) name = tokens_[at_ - 1];
      call(place);
    }
    if (is("{")) {
      current_ = {};
      statement({});
      functions_[name] = current_;
    } else {
      ++at_;
    }
  }

  std::vector<std::string> tokens_;
  std::size_t at_ = 0;
  Function current_;
  std::map<std::string, Function> functions_;
  Faults faults_;
};

/// Text of a shader with the files that it includes, but those that the build writes, which have
/// neither loops nor branches.
std::string whole_text(const fs::path& file, std::set<fs::path>* seen) {
  std::ifstream in(file);
  std::string text;
  for (std::string line; std::getline(in, line);) {
    const auto quote = line.find('"');
    if (!line.starts_with("#include")) {
      text += line + "\n";
    } else if (const fs::path other =
                   file.parent_path() / line.substr(quote + 1, line.rfind('"') - quote - 1);
               fs::exists(other) && seen->insert(other).second) {
      text += whole_text(other, seen);
    }
  }
  return text;
}

TEST(Shaders, NeedNothingThatADeviceMayLack) {
  const auto shaders = gaussian_shaders();
  ASSERT_FALSE(shaders.empty());
  for (const auto& shader : shaders) {
    ASSERT_EQ(shader.words[0], std::uint32_t{spv::MagicNumber}) << shader.name;
    EXPECT_EQ(faults_of_module(shader.words), Faults()) << shader.name;
  }
}

TEST(Shaders, HaveNoLoopUnderAnIfInALoop) {
  int shaders = 0;
  const fs::path folder = fs::path(REDRIVE_SOURCE) / "src/redrive/kernels";
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.path().extension() != ".comp") continue;
    ++shaders;
    std::set<fs::path> seen;
    EXPECT_EQ(LoopNesting(whole_text(entry.path(), &seen)).faults(), Faults()) << entry.path();
  }
  EXPECT_GT(shaders, 0);
}

TEST(ShaderRules, FindWhatDevicesLack) {
  const auto instruction = [](spv::Op op, std::vector<std::uint32_t> words) {
    words.insert(words.begin(), std::uint32_t(op) | static_cast<std::uint32_t>(words.size() + 1)
                                                        << 16);
    return words;
  };
  const auto faults = [&](std::vector<std::vector<std::uint32_t>> instructions) {
    std::vector<std::uint32_t> module = {spv::MagicNumber, 0x10500, 0, 100, 0};
    for (const auto& words : instructions) module.insert(module.end(), words.begin(), words.end());
    return faults_of_module(module);
  };
  for (const auto capability :
       {spv::Capability::GroupNonUniform, spv::Capability::GroupNonUniformArithmetic,
        spv::Capability::AtomicFloat32AddEXT, spv::Capability::Int64, spv::Capability::Int16,
        spv::Capability::Int8, spv::Capability::Float16, spv::Capability::Float64,
        spv::Capability::StorageBuffer16BitAccess})
    EXPECT_EQ(faults({instruction(spv::Op::OpCapability, {std::uint32_t(capability)})}).size(), 1u);
  const auto size = [&](std::uint32_t threads) {
    return instruction(spv::Op::OpExecutionMode,
                       {1, std::uint32_t(spv::ExecutionMode::LocalSize), threads, 1, 1});
  };
  EXPECT_EQ(faults({size(256)}), Faults());
  EXPECT_EQ(faults({size(512)}).size(), 1u);
  // float s_numbers[n], and an array of structs.
  const auto shared = [&](std::uint32_t n, std::uint32_t element) {
    return faults(
        {instruction(spv::Op::OpTypeFloat, {1, 32}), instruction(spv::Op::OpTypeInt, {2, 32, 0}),
         instruction(spv::Op::OpTypeStruct, {3, 1, 1}), instruction(spv::Op::OpConstant, {2, 4, n}),
         instruction(spv::Op::OpTypeArray, {5, element, 4}),
         instruction(spv::Op::OpTypePointer, {6, std::uint32_t(spv::StorageClass::Workgroup), 5}),
         instruction(spv::Op::OpVariable, {6, 7, std::uint32_t(spv::StorageClass::Workgroup)})});
  };
  EXPECT_EQ(shared(8192, 1), Faults());
  EXPECT_EQ(shared(8193, 1), Faults{"takes 32772 bytes of shared memory"});
  EXPECT_EQ(shared(2, 3), Faults{"has a struct in shared memory"});
  EXPECT_EQ(faults({{0x00080011}}), Faults{"is cut off"});
}

TEST(ShaderRules, FindLoopsUnderAnIfInALoop) {
  const auto n = [](const std::string& text) { return LoopNesting(text).faults().size(); };
  EXPECT_EQ(n("void main() { for (uint i = a; i < b; ++i) if (c) for (; d < e;) f(); }"), 1u);
  EXPECT_EQ(n("void main() { while (a) { if (b) {} else { while (c) --d; } } }"), 1u);
  EXPECT_EQ(n("void main() { while (a) { if (b) do { --d; } while (c > 1); } }"), 1u);
  EXPECT_EQ(n("void main() { while (a) if (b) for (int i = 0; i < 8; ++i) while (c) d(); }"), 1u)
      << "the constant loop changes nothing";
  // Through functions.
  EXPECT_EQ(n("void f() { while (a) --b; } void main() { while (c) if (d) f(); }"), 1u);
  EXPECT_EQ(n("void f() { if (e) while (a) --b; } void main() { while (c) { d = f(); } }"), 1u);
  EXPECT_EQ(
      n("void f() { while (a) --b; } void g() { if (x) f(); } void main() { while (c) g(); }"), 1u);
  // What is allowed.
  EXPECT_EQ(n("void main() { if (a) while (b) { while (c) { if (d) e = f; } } }"), 0u);
  EXPECT_EQ(n("void main() { while (a) if (b) for (int i = 0; i < 8; ++i) c(); }"), 0u);
  EXPECT_EQ(n("void main() { while (a) if (b) for (int i = 0; i < kMany; ++i) c(); }"), 0u);
  EXPECT_EQ(n("#define loop while\n// while (a) if (b) while (c)\nvoid main() { if (a) b(); }"),
            0u);
  EXPECT_EQ(n("struct S { float a[3]; };\nvoid f() { while (a) --b; } void main() { f(); }"), 0u);
}

}  // namespace
}  // namespace redrive::kernels
