// SPDX-License-Identifier: Apache-2.0
// A folder includes only folders below it and links the libraries that it includes. The order of
// the folders lives in the loops `foreach(layer ...)` of src/redrive, lowest first; the table in
// ARCHITECTURE.md has to agree with it. Methods and formats are known to their registries alone.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace {

namespace fs = std::filesystem;

const fs::path kRoot = REDRIVE_SOURCE, kSources = kRoot / "src/redrive";

std::string read(const fs::path& path) {
  std::ifstream file(path);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

std::vector<std::string> words_of(const std::string& text) {
  std::istringstream words(text);
  return {std::istream_iterator<std::string>(words), {}};
}

/// The folders that `foreach(layer ...)` in the CMakeLists.txt of `folder` adds; none without one.
const std::vector<std::string>& layers_in(const fs::path& folder) {
  static std::map<fs::path, std::vector<std::string>> known;
  const auto [entry, is_new] = known.try_emplace(folder);
  if (is_new) {
    const std::string text = read(folder / "CMakeLists.txt");
    std::smatch match;
    if (std::regex_search(text, match, std::regex(R"(foreach\(layer\s+([^)]*)\))")))
      entry->second = words_of(match[1]);
  }
  return entry->second;
}

/// The layer that the files of `folder` belong to, level by level: {12} for the 13th folder of
/// src/redrive, {12, 0} for its lowest layer. Folders that are no layers belong to the one above.
std::vector<std::ptrdiff_t> layer_of(const fs::path& folder) {
  std::vector<std::ptrdiff_t> layer;
  fs::path parent = kSources;
  for (const fs::path& part : folder.lexically_relative(kSources)) {
    const std::vector<std::string>& layers = layers_in(parent);
    const auto found = std::ranges::find(layers, part.string());
    if (found == layers.end()) break;
    layer.push_back(found - layers.begin());
    parent /= part;
  }
  return layer;
}

/// A folder's own files lie above the layers within it.
bool is_above(const std::vector<std::ptrdiff_t>& a, const std::vector<std::ptrdiff_t>& b) {
  const auto [in_a, in_b] = std::ranges::mismatch(a, b);
  if (in_a == a.end()) return in_b != b.end();
  return in_b != b.end() && *in_a > *in_b;
}

struct Include {
  std::string where;    ///< file:line
  fs::path from, file;  ///< the folder that includes, and what
};

/// A line that matches a pattern.
struct Match {
  fs::path file;
  std::string where;  ///< file:line
  std::string text;   ///< the pattern's group
};

/// Returns the matching lines of all sources but tests and their helpers.
std::vector<Match> all_matches(const std::regex& pattern) {
  std::vector<Match> all;
  for (const auto& entry : fs::recursive_directory_iterator(kSources)) {
    const fs::path& path = entry.path();
    const std::string stem = path.stem().string(), extension = path.extension().string();
    if (extension != ".h" && extension != ".cc") continue;
    if (stem.ends_with("_test") || stem.ends_with("_testing")) continue;
    std::ifstream file(path);
    std::string line;
    std::smatch match;
    for (int number = 1; std::getline(file, line); ++number)
      if (std::regex_search(line, match, pattern))
        all.push_back({path, path.lexically_relative(kRoot).string() + ":" + std::to_string(number),
                       match[1]});
  }
  return all;
}

std::vector<Include> all_includes() {
  std::vector<Include> all;
  for (const Match& found : all_matches(std::regex(R"rx(^\s*#\s*include "(redrive/[^"]+)")rx")))
    all.push_back({found.where, found.file.parent_path(), kRoot / "src" / found.text});
  return all;
}

TEST(Layers, EveryFolderIsInTheOrder) {
  for (const auto& entry : fs::directory_iterator(kSources))
    if (entry.is_directory()) {
      EXPECT_FALSE(layer_of(entry.path()).empty()) << entry.path();
    }
}

TEST(Layers, IncludesPointDown) {
  const std::vector<Include> includes = all_includes();
  ASSERT_GT(includes.size(), 100u);
  for (const Include& include : includes)
    EXPECT_FALSE(is_above(layer_of(include.file.parent_path()), layer_of(include.from)))
        << include.where << " includes " << include.file.lexically_relative(kRoot / "src").string()
        << ", a higher layer";
}

/// Returns the folder of the method to which a folder belongs; empty where it belongs to none.
fs::path method_of(const fs::path& folder) {
  const fs::path in_methods = folder.lexically_relative(kSources / "methods");
  const std::string first = in_methods.empty() ? ".." : in_methods.begin()->string();
  return first == ".." || first == "." ? fs::path() : kSources / "methods" / first;
}

TEST(Layers, OnlyTheRegistryIncludesAMethod) {
  const fs::path methods = kSources / "methods";
  int registered = 0;
  for (const Include& include : all_includes()) {
    const fs::path method = method_of(include.file.parent_path()), from = method_of(include.from);
    if (method.empty() || from == method) continue;
    // Methods that march along rays share a folder.
    if (method == methods / "march" && !from.empty()) continue;
    registered += include.from == methods;
    EXPECT_EQ(include.from, methods) << include.where << " includes a method's header";
  }
  EXPECT_GE(registered, 3);
}

/// Names in help texts and tables are not found: they decide nothing.
TEST(Layers, NoConditionNamesAMethodOrAFormatOutsideItsFolder) {
  std::string names;
  std::map<std::string, fs::path> folder_of;
  for (const char* const parts : {"methods", "recording/formats"})
    for (const auto& entry : fs::directory_iterator(kSources / parts))
      if (entry.is_directory()) {
        const std::string name = entry.path().filename().string();
        names += (names.empty() ? "" : "|") + name;
        folder_of[name] = entry.path();
      }
  ASSERT_TRUE(folder_of.contains("splat") && folder_of.contains("kitti"));
  for (const char* const side : {R"rx([=!]= *"(%)")rx", R"rx("(%)" *[=!]=)rx"}) {
    const std::string pattern = std::regex_replace(side, std::regex("%"), names);
    for (const Match& found : all_matches(std::regex(pattern)))
      EXPECT_TRUE(found.file.string().starts_with(folder_of.at(found.text).string() + "/"))
          << found.where << " depends on the name " << found.text;
  }
}

TEST(Layers, AFolderHas40SourceFilesAtMost) {
  std::map<fs::path, int> files;
  for (const auto& entry : fs::recursive_directory_iterator(kSources))
    if (const fs::path kind = entry.path().extension(); kind == ".cc" || kind == ".h")
      ++files[entry.path().parent_path()];
  ASSERT_GT(files.size(), 30u);
  for (const auto& [folder, count] : files) EXPECT_LE(count, 40) << folder;
}

TEST(Layers, NothingCastsAFieldBackToItsClass) {
  for (const Match& found :
       all_matches(std::regex(R"(dynamic_cast<(?:const )?(\w+(?:Model|Field))\b)")))
    ADD_FAILURE() << found.where << " casts to " << found.text;
}

/// The layers within `folder`, lowest first; a folder's own layers before the folder.
std::vector<std::string> all_layers(const fs::path& folder, const std::string& prefix = "") {
  std::vector<std::string> all;
  for (const std::string& layer : layers_in(folder)) {
    std::ranges::copy(all_layers(folder / layer, prefix + layer + "/"), std::back_inserter(all));
    all.push_back(prefix + layer);
  }
  return all;
}

TEST(Layers, TheTableInTheArchitectureHasTheSameOrder) {
  const std::string text = read(kRoot / "ARCHITECTURE.md");
  const std::regex row(R"(\n\| `src/redrive/([a-z_/]+)` )");
  std::vector<std::string> table;
  for (std::sregex_iterator at(text.begin(), text.end(), row), end; at != end; ++at)
    table.push_back((*at)[1]);
  EXPECT_EQ(table, all_layers(kSources));
}

struct Library {
  fs::path folder;
  std::set<std::string> depends;
  bool complete = true;  ///< no variable among what it depends on
};

/// Returns all libraries by name, from each redrive_library(NAME ... DEPENDS ...).
std::map<std::string, Library> all_libraries() {
  const std::regex definition(R"(redrive_library\(\s*(\w+)([^)]*)\))"),
      dependency(R"(redrive::(\w+))");
  std::map<std::string, Library> all;
  for (const auto& entry : fs::recursive_directory_iterator(kSources)) {
    if (entry.path().filename() != "CMakeLists.txt") continue;
    const std::string text = read(entry.path());
    for (std::sregex_iterator at(text.begin(), text.end(), definition), end; at != end; ++at) {
      Library& library = all[(*at)[1]];
      library.folder = entry.path().parent_path();
      const std::string arguments = (*at)[2];
      library.complete &= arguments.find("${") == std::string::npos;
      for (std::sregex_iterator name(arguments.begin(), arguments.end(), dependency); name != end;
           ++name)
        library.depends.insert((*name)[1]);
    }
  }
  return all;
}

TEST(Layers, LibrariesDependOnLowerOnes) {
  const std::map<std::string, Library> libraries = all_libraries();
  ASSERT_GT(libraries.size(), 10u);
  for (const auto& [name, library] : libraries)
    for (const std::string& other : library.depends) {
      const auto found = libraries.find(other);
      ASSERT_NE(found, libraries.end()) << name << " depends on " << other;
      EXPECT_FALSE(is_above(layer_of(found->second.folder), layer_of(library.folder)))
          << name << " depends on " << other;
    }
}

/// Folders of the libraries that `name` depends on, directly or not; false where they are not
/// known.
bool linked_folders(const std::map<std::string, Library>& libraries, const std::string& name,
                    std::set<fs::path>* folders) {
  const Library& library = libraries.at(name);
  bool complete = library.complete;
  folders->insert(library.folder);
  for (const std::string& other : library.depends)
    complete &= linked_folders(libraries, other, folders);
  return complete;
}

TEST(Layers, LibrariesLinkWhatTheyInclude) {
  const std::map<std::string, Library> libraries = all_libraries();
  std::map<fs::path, std::set<fs::path>> linked;
  std::set<fs::path> unknown;
  for (const auto& [name, library] : libraries)
    if (!linked_folders(libraries, name, &linked[library.folder])) unknown.insert(library.folder);
  for (const Include& include : all_includes()) {
    fs::path from = include.from, to = include.file.parent_path();
    // A folder without a library belongs to the one above.
    while (from != kSources && !linked.contains(from)) from = from.parent_path();
    while (to != kSources && !linked.contains(to)) to = to.parent_path();
    if (from == kSources || to == kSources || unknown.contains(from)) continue;
    if (layer_of(from) == layer_of(to)) continue;
    EXPECT_TRUE(linked.at(from).contains(to))
        << include.where << " includes " << include.file.lexically_relative(kRoot / "src").string()
        << ", whose library its own does not depend on";
  }
}

}  // namespace
