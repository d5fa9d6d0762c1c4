// SPDX-License-Identifier: Apache-2.0
// redrive export: writes a run's model in a file format of other programs.
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/cli/command.h"
#include "redrive/cli/output_file.h"
#include "redrive/model/method.h"
#include "redrive/train/run.h"

namespace redrive {
namespace {

struct ExportCommandOptions {
  std::string run, format, file;
  bool force = false;
  ExportOptions encode;
};

/// Returns the model's format of this name. Throws UsageError if it has none.
ExportFormat find_format(const Model& model, const std::string& name) {
  std::string known;
  for (const ExportFormat& format : model.export_formats()) {
    if (format.name == name) return format;
    known += (known.empty() ? "; it has " : ", ") + format.name;
  }
  throw UsageError(
      "--to", name,
      "the run is of method " + std::string(model.method()) + ", which has no such format" + known);
}

int export_run(const ExportCommandOptions& options) {
  check_output_file("FILE", options.file, options.force);
  const Run run = open_run(options.run);
  const std::string bytes = find_format(*run.state.model, options.format).encode(options.encode);
  write_file(options.file, bytes);
  std::printf("%s: %.1f MB\n", options.file.c_str(), 1e-6 * static_cast<double>(bytes.size()));
  return kExitOk;
}

/// Lists the formats of all methods.
std::string formats_help() {
  std::string text = "file format";
  for (const Method& method : methods())
    for (const ExportFormat& format : method.make()->export_formats())
      text += "; " + format.name + " (runs of --method " + method.name + "): " + format.help;
  return text;
}

}  // namespace

Action configure_export(CLI::App& command) {
  auto options = std::make_shared<ExportCommandOptions>();
  command.add_option("RUN", options->run, "run folder, as train makes it")->required();
  command.add_option("FILE", options->file, "file to write")->required();
  command.add_option("--to", options->format, formats_help())->required();
  command
      .add_option("--sh-degree", options->encode.sh_degree,
                  "degree of the colours' spherical harmonics, 0 or 1: a Gaussian takes 68 bytes "
                  "with 0, 104 with 1")
      ->check(CLI::Range(0, 1))
      ->capture_default_str();
  command.add_flag("--force", options->force, "overwrites an existing file");
  return [options] { return export_run(*options); };
}

}  // namespace redrive
