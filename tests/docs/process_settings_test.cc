// SPDX-License-Identifier: Apache-2.0
// Settings of the whole process, which threads must not change: each is set in one file, at the
// program's start.
#include <fstream>
#include <map>
#include <regex>
#include <sstream>

#include <gtest/gtest.h>

namespace {

namespace fs = std::filesystem;

const fs::path kSources = fs::path(REDRIVE_SOURCE) / "src/redrive";

std::string text_of(const fs::path& file) {
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

/// Calls `use` with each source but tests, relative to src/redrive, and its text.
template <class Use>
void for_sources(const Use& use) {
  int sources = 0;
  for (const auto& entry : fs::recursive_directory_iterator(kSources)) {
    const std::string name = entry.path().lexically_relative(kSources).string();
    if (!std::regex_search(name, std::regex("\\.(cc|h)$")) || name.ends_with("_test.cc")) continue;
    use(name, text_of(entry.path()));
    ++sources;
  }
  ASSERT_GT(sources, 100);
}

TEST(ProcessSettings, AreSetInOneFileEach) {
  const std::map<std::string, std::string> files = {
      {"setNumThreads|setUseOptimized|setRNGSeed|theRNG", "base/opencv_threads.h"},
      {"sigaction|signal|sigprocmask|pthread_sigmask", "base/processes/interruption.cc"},
      {"mallopt", "cli/main.cc"},
      {"av_log_set_level", "image/video.cc"},
      {"global_control|setNbThreads|omp_set_\\w+|setLogLevel|redirectError", ""},
      // Functions whose result or state is one for all threads.
      {"strtok|localtime|gmtime|asctime|ctime|rand|drand48|tmpnam|getpwuid|tjGetErrorStr", ""},
      {"setlocale|global|imbue", ""},
      {"fesetround|fesetenv|_MM_SET_\\w+|_mm_setcsr", ""},
      {"umask|chdir|fchdir|current_path|setenv|putenv|unsetenv|setrlimit|srand", ""}};
  for_sources([&](const std::string& name, const std::string& text) {
    for (const auto& [calls, file] : files) {
      const std::regex call("(^|[^\\w>.])(" + calls + ")\\(\\w");
      std::smatch found;
      if (name != file && std::regex_search(text, found, call))
        ADD_FAILURE() << name << " calls " << found[2] << ", which "
                      << (file.empty() ? "nothing may" : "is for " + file);
    }
  });
}

TEST(ProcessSettings, OpenCvHasOneThreadWhereverItIsIncluded) {
  for_sources([](const std::string& name, const std::string& text) {
    if (name == "base/opencv_threads.h" || text.find("#include <opencv2/") == std::string::npos)
      return;
    EXPECT_NE(text.find("#include \"redrive/base/opencv_threads.h\""), std::string::npos) << name;
  });
}

}  // namespace
