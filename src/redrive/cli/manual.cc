// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/manual.h"

#include <algorithm>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include <CLI/Error.hpp>
#include <CLI/Option.hpp>
#include <CLI/Validators.hpp>
#include <nlohmann/json.hpp>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/cli/help.h"
#include "redrive/render/open_to_render.h"

namespace redrive {
namespace {

constexpr std::pair<ExitCode, const char*> kExitCodes[] = {
    {kExitOk, "success"},
    {kExitInternal, "a bug in redrive, or out of memory"},
    {kExitUsage, "an unknown option, a value out of range, an output folder that exists"},
    {kExitBadInput, "an input file is missing, malformed or inconsistent"},
    {kExitIo, "a file could not be written"},
    {kExitInsufficientData, "the input is valid, but does not determine what was asked for"},
    {kExitPreflightFailed, "inspect --report found a fault that training would learn"},
    {kExitInterrupted, "interrupted by Ctrl-C; the state was saved"},
};

/// Escapes text for roff: hyphens as typed on a command line, no line that begins with a request.
std::string roff(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    if (c == '\\')
      escaped += "\\e";
    else if (c == '-')
      escaped += "\\-";
    else if ((c == '.' || c == '\'') && (escaped.empty() || escaped.back() == '\n'))
      escaped += std::string("\\&") + c;
    else
      escaped += c;
  }
  return escaped;
}

std::string bold(const std::string& text) { return "\\fB" + roff(text) + "\\fR"; }
std::string italic(const std::string& text) { return "\\fI" + roff(text) + "\\fR"; }

/// Returns option_heading: names in bold, the value in italics.
std::string heading(const CLI::Option& option) {
  const std::string text = option_heading(option);
  const std::size_t dashes = text.rfind("-"), space = text.find(' ', dashes + 1);
  if (dashes == std::string::npos) return italic(text);
  if (space == std::string::npos) return bold(text);
  return bold(text.substr(0, space)) + " " + italic(text.substr(space + 1));
}

std::string option_list(const CLI::App& command) {
  std::string text;
  for (const CLI::Option* option : command.get_options())
    text += ".TP\n" + heading(*option) + "\n" + roff(option_text(*option)) +
            (option->get_required() ? " (required)\n" : "\n");
  return text;
}

/// Returns the commands, each before its subcommands.
std::vector<const CLI::App*> commands_of(const CLI::App& app) {
  std::vector<const CLI::App*> all;
  for (const CLI::App* command : subcommands_of(app)) {
    all.push_back(command);
    std::ranges::copy(subcommands_of(*command), std::back_inserter(all));
  }
  return all;
}

/// Returns the words that call a command, quoted for bash: "render lidar" with its quotes.
std::string quoted_name(const CLI::App& command) {
  const std::string name = full_name(command);
  return '"' + name.substr(name.find(' ') + 1) + '"';
}

std::string name_words(const std::vector<const CLI::App*>& commands) {
  std::string words;
  for (const CLI::App* command : commands)
    words += (words.empty() ? "" : " ") + command->get_name();
  return words;
}

/// Returns the names of all options, "--a --b".
std::string option_words(const CLI::App& command) {
  std::string words;
  for (const CLI::Option* option : command.get_options())
    if (!option->get_lnames().empty())
      words += (words.empty() ? "--" : " --") + option->get_lnames().front();
  return words;
}

/// Returns the man page (section 1) in roff.
std::string man_page(const CLI::App& app, const std::string& version) {
  const std::string name = app.get_name(), summary = app.get_description();
  std::string page = ".TH REDRIVE 1 \"\" \"redrive " + roff(version) + "\" \"User Commands\"\n" +
                     ".SH NAME\n" + name + " \\- " + roff(summary.substr(summary.find(": ") + 2)) +
                     "\n.SH SYNOPSIS\n" + bold(name) + " " + italic("COMMAND") + " [" +
                     italic("OPTIONS") + "]\n.SH OPTIONS\n" + option_list(app) + ".SH COMMANDS\n";
  for (const CLI::App* command : commands_of(app))
    page += ".SS " + bold(full_name(*command)) + "\n" + roff(command->get_description()) +
            "\n.PP\n" + roff(usage_of(*command)) + "\n" + option_list(*command) + ".PP\n.nf\n" +
            roff(command->get_footer()) + "\n.fi\n";
  page += ".SH EXIT STATUS\n";
  for (const auto& [code, meaning] : kExitCodes)
    page += ".TP\n" + bold(std::to_string(code)) + "\n" + roff(meaning) + "\n";
  return page;
}

/// Returns bash case lines: the values of each option that has a fixed set of them.
std::string value_cases(const CLI::App& command) {
  std::string cases;
  for (const CLI::Option* option : command.get_options()) {
    std::string values;
    for (const std::string& value : offered_values(*option))
      values += (values.empty() ? "" : " ") + value;
    if (!values.empty())
      cases += "    " + quoted_name(command) + "," + option->get_name() + ") words='" + values +
               "' ;;\n";
  }
  return cases;
}

/// Returns bash case lines for "COMMAND,NEXT WORD" that make $command a command with its
/// subcommand, the first one where the next word names none.
std::string subcommand_cases(const CLI::App& app) {
  std::string cases;
  for (const CLI::App* command : subcommands_of(app)) {
    const std::vector<const CLI::App*> inner = subcommands_of(*command);
    for (const CLI::App* sub : inner)
      cases += "    " + command->get_name() + "," + sub->get_name() +
               ") command=" + quoted_name(*sub) + " ;;\n";
    if (!inner.empty())
      cases += "    " + command->get_name() + ",*) command=" + quoted_name(*inner[0]) + " ;;\n";
  }
  return cases;
}

/// Completes commands, subcommands, the options of the typed command, values of options, and
/// cameras of the run; readline completes files.
std::string bash_completion(const CLI::App& app) {
  const std::string commands = name_words(subcommands_of(app));
  std::string cases, values, inner;
  for (const CLI::App* command : commands_of(app)) {
    cases += "    0," + quoted_name(*command) + ") words='" + option_words(*command) + "' ;;\n";
    values += value_cases(*command);
    if (const std::string names = name_words(subcommands_of(*command)); !names.empty())
      inner += "    2,*," + command->get_name() + "|3,help," + command->get_name() + ") words='" +
               names + "' ;;\n";
  }
  return "# Completion of redrive's commands, options and values for bash.\n"
         "_redrive() {\n"
         "  local current=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]} words=\n"
         "  local command=${COMP_WORDS[1]}\n"
         "  COMPREPLY=()\n"
         "  [[ $current == -* ]] || case $COMP_CWORD,$command,$before in\n" +
         inner + "    2,help,help) words='" + commands +
         "' ;;\n"
         "  esac\n"
         "  case $command,${COMP_WORDS[2]} in\n" +
         subcommand_cases(app) +
         "  esac\n"
         "  case $command,$before in\n" +
         values +
         "    *,--camera|*,--cameras)\n"
         "      words=$(for word in \"${COMP_WORDS[@]:2}\"; do\n"
         "        [ -d \"$word\" ] && \"${COMP_WORDS[0]}\" --generate \"cameras:$word\"\n"
         "      done 2>/dev/null) ;;\n"
         "  esac\n"
         "  if [ -z \"$words\" ]; then\n"
         "    case $((COMP_CWORD == 1)),$command in\n"
         "      1,*) words='" +
         commands + " help " + option_words(app) + "' ;;\n" + cases +
         "    esac\n"
         "    ((COMP_CWORD == 1)) || [[ $current == -* ]] || return 0\n"
         "  fi\n"
         "  mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$current\")\n"
         "}\n"
         "complete -o default -F _redrive redrive";
}

/// Returns the cameras of a run or a recording, one a line.
std::string camera_names(const std::string& folder) {
  const bool is_run = is_run_folder(folder);
  Run run;
  if (is_run) {
    const std::filesystem::path config = RunPaths{folder}.config();
    run.options = options_from_json(read_json(config), config);
  }
  run.options.recording = is_run ? run.options.recording : folder;
  std::string names;
  for (const RecordedCamera& camera : open_recording(run.options.recording).cameras) {
    const std::string& name = camera.calibration.name;
    const std::vector<std::string>& used = run.options.cameras;
    if (used.empty() || std::ranges::find(used, name) != used.end()) names += name + "\n";
  }
  return names;
}

}  // namespace

void add_generate_option(CLI::App& app, const std::string& version) {
  app.add_option_function<std::string>(
         "--generate",
         [&app, version](const std::string& text) {
           const std::vector<std::string> known = {"man", "bash-completion"};
           const std::string cameras = "cameras:";  // prefix of what completion asks for
           std::string out;
           if (text == "man")
             out = man_page(app, version);
           else if (text == "bash-completion")
             out = bash_completion(app);
           else if (text.starts_with(cameras))
             out = camera_names(text.substr(cameras.size()));
           else
             throw UsageError("--generate", text, unknown_name(text, known));
           // CLI11 prints the text of this exception and exits with success.
           throw CLI::CallForVersion(out, kExitOk);
         },
         "print the man page or the bash completion: man, bash-completion")
      ->type_name("WHAT")
      ->check(offering({"man", "bash-completion"}));
}

}  // namespace redrive
