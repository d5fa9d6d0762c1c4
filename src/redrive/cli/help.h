// SPDX-License-Identifier: Apache-2.0
// Help texts, and errors of the command line in the words of the other errors.
#pragma once

#include <string>
#include <vector>

#include <CLI/App.hpp>

namespace redrive {

/// Gives the program and the commands added to it later help in groups and in 80 columns.
void use_own_help(CLI::App& app);
/// Names the values of a command's options, "N" or "DIR", and their groups, unless it names them
/// itself.
void name_options(CLI::App& command);

/// Returns "--out RUN" for an option, "RECORDING" for a positional argument.
std::string option_heading(const CLI::Option& option);
/// Returns what the option does, with its default: "side of a voxel in metres (default: 0.1)".
std::string option_text(const CLI::Option& option);
/// Returns the subcommands of a program or a command.
std::vector<const CLI::App*> subcommands_of(const CLI::App& app);
/// Returns the subcommand of this name, or null.
const CLI::App* find_subcommand(const CLI::App& app, const std::string& name);
/// Returns the command that was parsed, "lidar" of `redrive render lidar`, or `app` where none was.
const CLI::App& chosen_command(const CLI::App& app);
/// Returns "redrive render lidar".
std::string full_name(const CLI::App& command);
/// Returns "redrive train RECORDING --out RUN [options]".
std::string usage_of(const CLI::App& command);

/// Returns the shortest text of a number, for defaults in help: "0.1".
std::string number_text(double value);

/// Returns a check that an option's value is one of `names`, which completion offers. UsageError
/// with what may have been meant.
CLI::Validator one_of(const std::string& option, const std::vector<std::string>& names);
/// Returns a check that a number is in range. UsageError.
CLI::Validator within(const std::string& option, double low, double high);
/// Offers `names` to completion and checks nothing.
CLI::Validator offering(const std::vector<std::string>& names);
/// Returns what completion offers for an option's value.
std::vector<std::string> offered_values(const CLI::Option& option);

/// Inserts the first subcommand of a command with subcommands where its next word names none of
/// them: `render RUN` becomes `render image RUN`. UsageError for a mistyped one.
void insert_usual_subcommand(const CLI::App& app, std::vector<std::string>* words);
/// Throws UsageError for the first word that names no command or no option of the typed command.
/// Call it before the words are parsed: a parser's error often blames another option.
void check_words(const CLI::App& app, const std::vector<std::string>& words);
/// Returns a parser's error in the words of UsageError.
std::string usage_message(const CLI::App& app, const CLI::ParseError& error);

}  // namespace redrive
