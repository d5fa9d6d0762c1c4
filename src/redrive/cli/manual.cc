// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/manual.h"

#include <string>
#include <utility>
#include <vector>

#include <CLI/Error.hpp>
#include <CLI/Option.hpp>
#include <CLI/Validators.hpp>

#include "redrive/base/error.h"

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

bool takes_value(const CLI::Option& option) { return option.get_items_expected_max() > 0; }

/// Returns "--threads INT" for an option, "RECORDING" for a positional argument.
std::string heading(const CLI::Option& option) {
  if (option.get_positional()) return italic(option.get_name(true));
  std::string text;
  for (const std::string& name : option.get_snames()) text += bold("-" + name) + ", ";
  for (const std::string& name : option.get_lnames()) text += bold("--" + name) + ", ";
  text.resize(text.size() - 2);
  const std::string type = option.get_type_name();
  if (takes_value(option)) text += " " + italic(type.substr(0, type.find(':')));
  return text;
}

std::string option_list(const CLI::App& command) {
  std::string text;
  for (const CLI::Option* option : command.get_options())
    text += ".TP\n" + heading(*option) + "\n" + roff(option->get_description()) +
            (option->get_required() ? " (required)\n" : "\n");
  return text;
}

std::vector<const CLI::App*> commands_of(const CLI::App& app) {
  return app.get_subcommands([](const CLI::App*) { return true; });
}

/// Returns the names of all options, "--a --b".
std::string option_words(const CLI::App& command) {
  std::string words;
  for (const CLI::Option* option : command.get_options())
    for (const std::string& name : option->get_lnames())
      words += (words.empty() ? "--" : " --") + name;
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
    page += ".SS " + bold(name + " " + command->get_name()) + "\n" +
            roff(command->get_description()) + "\n" + option_list(*command);
  page += ".SH EXIT STATUS\n";
  for (const auto& [code, meaning] : kExitCodes)
    page += ".TP\n" + bold(std::to_string(code)) + "\n" + roff(meaning) + "\n";
  return page;
}

/// Completes commands and the options of the typed command; readline completes files elsewhere.
std::string bash_completion(const CLI::App& app) {
  std::string commands, cases;
  for (const CLI::App* command : commands_of(app)) {
    commands += command->get_name() + " ";
    cases += "    0," + command->get_name() + ") words='" + option_words(*command) + "' ;;\n";
  }
  return "# Completion of redrive's commands and options for bash.\n"
         "_redrive() {\n"
         "  local current=${COMP_WORDS[COMP_CWORD]} words=\n"
         "  case $((COMP_CWORD == 1)),${COMP_WORDS[1]} in\n"
         "    1,*) words='" +
         commands + option_words(app) + "' ;;\n" + cases +
         "  esac\n"
         "  COMPREPLY=()\n"
         "  ((COMP_CWORD == 1)) || [[ $current == -* ]] || return 0\n"
         "  mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$current\")\n"
         "}\n"
         "complete -o default -F _redrive redrive";
}

}  // namespace

void add_generate_option(CLI::App& app, const std::string& version) {
  app.add_option_function<std::string>(
         "--generate",
         [&app, version](const std::string& text) {
           // CLI11 prints the text of this exception and exits with success.
           throw CLI::CallForVersion(text == "man" ? man_page(app, version) : bash_completion(app),
                                     kExitOk);
         },
         "print the man page or the bash completion and exit: man, bash-completion")
      ->check(CLI::IsMember({"man", "bash-completion"}));
}

}  // namespace redrive
