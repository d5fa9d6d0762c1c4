// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/help.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cstdio>
#include <filesystem>
#include <iterator>
#include <memory>
#include <utility>

#include <CLI/Error.hpp>
#include <CLI/Formatter.hpp>
#include <CLI/Validators.hpp>

#include "redrive/base/did_you_mean.h"
#include "redrive/base/error.h"
#include "redrive/base/wrapped_text.h"

namespace redrive {
namespace {

constexpr std::size_t kTextColumn = 26;
constexpr const char* kHelpGroup = "Help";

/// What the help calls an option's value, and the option's group.
struct OptionWords {
  const char *name, *value, *group;
};

constexpr const char *kView = "View", *kLidar = "LiDAR", *kTraffic = "Moving objects",
                     *kOutput = "Output", *kServer = "Server", *kRecording = "Recording",
                     *kResources = "Resources";

constexpr OptionWords kOptionWords[] = {
    {"actors", "IDS", kTraffic},
    {"axes", "AXES", kView},
    {"azimuth-steps", "N", kLidar},
    {"backend", "NAME", kResources},
    {"blocks", "METRES", ""},
    {"camera", "CAM", kView},
    {"cameras", "A,B", ""},
    {"certificate", "FILE.pem", kServer},
    {"compare", "RUN", ""},
    {"cores", "N", ""},
    {"depth", "FILE", kOutput},
    {"edit", "EDIT.json", kTraffic},
    {"edited", "DIR", ""},
    {"exposure", "WHOSE", kView},
    {"filter", "TEXT", ""},
    {"force", "", kOutput},
    {"fps", "N", kView},
    {"frame", "ID", kView},
    {"frames", "FIRST:LAST[:STEP]", kRecording},
    {"generate", "WHAT", ""},
    {"help", "", kHelpGroup},
    {"ids", "FILE.png", kOutput},
    {"isa", "NAME", kResources},
    {"key", "FILE.pem", kServer},
    {"device", "NAME", kResources},
    {"labels", "WHICH", kOutput},
    {"lens", "LENS", kView},
    {"listen", "ADDRESS", kServer},
    {"machines", "N", ""},
    {"masks", "DIR", ""},
    {"masks-out", "DIR", ""},
    {"max-images", "N", ""},
    {"mount", "X,Y,Z,YAW,PITCH,ROLL", kView},
    {"normals", "FILE.png", kOutput},
    {"opacity", "FILE.png", kOutput},
    {"open", "", kServer},
    {"out", "OUT", kOutput},
    {"path", "PATH", ""},
    {"pitch", "DEG", kView},
    {"points-in", "AXES", kLidar},
    {"port", "N", kServer},
    {"poses", "DIR", ""},
    {"range", "MIN:MAX", kLidar},
    {"rate", "HZ", kLidar},
    {"repetitions", "N", ""},
    {"report", "DIR", ""},
    {"rolling-shutter", "MS", ""},
    {"seconds", "S", kView},
    {"sensor", "SENSOR", kLidar},
    {"sh-degree", "N", ""},
    {"threads", "N", kResources},
    {"to", "FORMAT", ""},
    {"translate", "X,Y,Z", kView},
    {"view", "", kServer},
    {"voxel", "M", ""},
    {"window", "N", ""},
    {"yaw", "DEG", kView},
};

/// Two columns: the heading, and the text from kTextColumn on, or below where there is no room.
std::string row(const std::string& heading, const std::string& text) {
  std::string line = "  " + heading;
  if (line.size() + 2 > kTextColumn)
    line += "\n" + std::string(kTextColumn, ' ');
  else
    line.resize(kTextColumn, ' ');
  return line + wrapped(text, kTextColumn, kTextColumn) + "\n";
}

class OwnFormatter : public CLI::FormatterBase {
 public:
  std::string make_help(const CLI::App* app, std::string, CLI::AppFormatMode) const override {
    const std::vector<const CLI::App*> commands = subcommands_of(*app);
    std::string help =
        wrapped(app->get_description(), 0, 0) + "\n\n  " + wrapped(usage_of(*app), 2, 6) + "\n";
    if (!commands.empty()) help += "\nCommands\n";
    for (const CLI::App* command : commands)
      help += row(command->get_name(), command->get_description());
    std::vector<std::string> groups = app->get_groups();
    std::erase(groups, kHelpGroup);
    groups.emplace_back(kHelpGroup);
    for (const std::string& group : groups) {
      const auto options = app->get_options([&](const CLI::Option* option) {
        return option->get_group() == group && !option->get_positional();
      });
      if (group.empty() || options.empty()) continue;
      help += "\n" + group + "\n";
      for (const CLI::Option* option : options)
        help += row(option_heading(*option), option_text(*option));
    }
    std::string arguments;
    for (const CLI::Option* option : app->get_options())
      if (option->get_positional()) arguments += row(option_heading(*option), option_text(*option));
    if (!arguments.empty()) {
      const std::size_t at = help.find("\n\n", help.find(usage_of(*app).substr(0, 12)));
      help.insert(at == std::string::npos ? help.size() : at + 1, "\n" + arguments);
    }
    if (!app->get_footer().empty()) help += "\n" + app->get_footer() + "\n";
    return help;
  }
};

/// Whether a word begins with a dash and is no negative number.
bool is_option(std::string_view word) {
  return word.size() > 1 && word[0] == '-' &&
         !(std::isdigit(static_cast<unsigned char>(word[1])) || word[1] == '.');
}

bool takes_value(const CLI::Option& option) { return option.get_items_expected_max() > 0; }

std::vector<std::string> names_of(const std::vector<const CLI::App*>& commands) {
  std::vector<std::string> names;
  for (const CLI::App* command : commands) names.push_back(command->get_name());
  return names;
}

/// Throws UsageError for a word that is no option of a command. It names the subcommand beside it
/// that is called like the option or has it, or the option that may have been meant.
[[noreturn]] void no_such_option(const CLI::App& command, const std::string& option) {
  const std::string whose = full_name(command);
  const CLI::App* const parent = command.get_parent();
  if (parent && parent->get_parent()) {
    for (const CLI::App* beside : subcommands_of(*parent))
      if ("--" + beside->get_name() == option)
        throw UsageError(option, "", "is no option of " + whose + "; it is " + usage_of(*beside));
    for (const CLI::App* beside : subcommands_of(*parent))
      if (beside->get_option_no_throw(option))
        throw UsageError(option, "",
                         "is no option of " + whose + ", but one of " + full_name(*beside));
  }
  std::vector<std::string> names;
  for (const CLI::Option* known : command.get_options())
    if (!known->get_lnames().empty()) names.push_back("--" + known->get_lnames().front());
  const std::string meant = did_you_mean(option, names);
  throw UsageError(option, "",
                   "is no option of " + whose + meant + (meant.empty() ? "; " : " ") + whose +
                       " --help lists them");
}

}  // namespace

std::vector<const CLI::App*> subcommands_of(const CLI::App& app) {
  return app.get_subcommands([](const CLI::App* command) { return !command->get_name().empty(); });
}

const CLI::App* find_subcommand(const CLI::App& app, const std::string& name) {
  for (const CLI::App* command : subcommands_of(app))
    if (command->get_name() == name) return command;
  return nullptr;
}

const CLI::App& chosen_command(const CLI::App& app) {
  const auto chosen = app.get_subcommands();
  return chosen.empty() ? app : chosen_command(*chosen.front());
}

std::string full_name(const CLI::App& command) {
  const CLI::App* const parent = command.get_parent();
  return (parent ? full_name(*parent) + " " : "") + command.get_name();
}

void use_own_help(CLI::App& app) { app.formatter(std::make_shared<OwnFormatter>()); }

void name_options(CLI::App& command) {
  for (CLI::Option* option : command.get_options([](const CLI::Option*) { return true; })) {
    if (option->get_lnames().empty()) continue;
    const auto words = std::ranges::find_if(kOptionWords, [&](const OptionWords& known) {
      return option->get_lnames().front() == known.name;
    });
    if (words == std::end(kOptionWords)) continue;
    const std::string type = option->get_type_name();
    const bool is_own = !type.starts_with("TEXT") && !type.starts_with("INT") &&
                        !type.starts_with("UINT") && !type.starts_with("FLOAT");
    if (takes_value(*option) && !is_own) option->type_name(words->value);
    if (option->get_group() == "Options" && words->group[0] != '\0') option->group(words->group);
  }
}

std::string option_heading(const CLI::Option& option) {
  if (option.get_positional() && option.get_lnames().empty()) return option.get_name(true);
  std::string text;
  for (const std::string& name : option.get_snames()) text += "-" + name + ", ";
  text += "--" + option.get_lnames().front();  // further ones are old names
  const std::string type = option.get_type_name();
  if (takes_value(option)) text += " " + type.substr(0, type.find(":{"));
  return text;
}

std::string option_text(const CLI::Option& option) {
  std::string text = option.get_description();
  if (!option.get_default_str().empty()) text += " (default: " + option.get_default_str() + ")";
  return text;
}

std::string usage_of(const CLI::App& command) {
  std::string usage = full_name(command);
  if (!subcommands_of(command).empty()) return usage + " COMMAND [options]";
  std::string required;
  bool optional = false;
  for (const CLI::Option* option : command.get_options()) {
    if (option->get_positional())
      usage += " " + option->get_name(true);
    else if (option->get_required())
      required += " " + option_heading(*option);
    else
      optional = true;
  }
  return usage + required + (optional ? " [options]" : "");
}

std::string number_text(double value) {
  char text[40];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

CLI::Validator one_of(const std::string& option, const std::vector<std::string>& names) {
  CLI::Validator check = offering(names);
  check.operation([option, names](std::string& value) {
    if (std::ranges::find(names, value) == names.end())
      throw UsageError(option, value, unknown_name(value, names));
    return std::string();
  });
  return check;
}

CLI::Validator within(const std::string& option, double low, double high) {
  return CLI::Validator(
      [option, low, high](std::string& value) {
        double number = 0;
        const char* const end = value.data() + value.size();
        const auto [at, error] = std::from_chars(value.data(), end, number);
        if (error != std::errc() || at != end || !(number >= low && number <= high))
          throw UsageError(option, value,
                           "must be a number in " + number_text(low) + ".." + number_text(high));
        return std::string();
      },
      "");
}

CLI::Validator offering(const std::vector<std::string>& names) {
  std::string all;
  for (const std::string& name : names)
    if (!name.empty()) all += (all.empty() ? "" : ",") + name;
  return CLI::Validator([](std::string&) { return std::string(); }, "{" + all + "}");
}

std::vector<std::string> offered_values(const CLI::Option& option) {
  const std::string type = option.get_type_name();
  const std::size_t begin = type.find('{'), end = type.find('}');
  std::vector<std::string> values;
  if (begin == std::string::npos || end == std::string::npos) return values;
  for (std::size_t at = begin + 1; at < end;) {
    const std::size_t comma = std::min(type.find(',', at), end);
    values.push_back(type.substr(at, comma - at));
    at = comma + 1;
  }
  return values;
}

void insert_usual_subcommand(const CLI::App& app, std::vector<std::string>* words) {
  const CLI::App* const command = find_subcommand(app, words->front());
  if (!command || words->size() < 2) return;
  const std::string& next = (*words)[1];
  const std::vector<std::string> names = names_of(subcommands_of(*command));
  if (names.empty() || next == "--help" || next == "-h" || find_subcommand(*command, next)) return;
  const std::string meant = did_you_mean(next, names);
  std::error_code error;
  if (!is_option(next) && !meant.empty() && !std::filesystem::exists(next, error))
    throw UsageError(full_name(*command), next, "is neither a run nor a subcommand" + meant);
  words->insert(words->begin() + 1, names.front());
}

void check_words(const CLI::App& app, const std::vector<std::string>& words) {
  const CLI::App* command = &app;
  bool is_value = false;
  for (const std::string& word : words) {
    if (word == "--") return;
    if (is_option(word)) {
      const std::string name = word.substr(0, word.find('='));
      const CLI::Option* const option = command->get_option_no_throw(name);
      if (!option) no_such_option(*command, name);
      is_value = takes_value(*option) && name == word;
      continue;
    }
    const std::vector<std::string> names = names_of(subcommands_of(*command));
    if (std::exchange(is_value, false) || names.empty()) continue;
    const CLI::App* const known = find_subcommand(*command, word);
    if (!known) {
      std::string all;
      for (const std::string& name : names) all += (all.empty() ? "; there are " : ", ") + name;
      throw UsageError("redrive", word, "is not a command" + all + did_you_mean(word, names));
    }
    command = known;
  }
}

std::string usage_message(const CLI::App& app, const CLI::ParseError& error) {
  const CLI::App& command = chosen_command(app);
  const std::string usage = usage_of(command), what = error.what();
  const std::string option = what.substr(0, what.find(':'));
  const auto too_many = [&](const std::string& word) -> std::string {
    return UsageError(command.get_name(), word, "is one argument too many: " + usage).what();
  };
  if (dynamic_cast<const CLI::ExtrasError*>(&error)) {
    const std::vector<std::string> extra = command.remaining();
    return too_many(extra.empty() ? "" : extra.front());
  }
  if (dynamic_cast<const CLI::RequiredError*>(&error)) {
    const auto missing = command.get_options([](const CLI::Option* option) {
      return option->get_positional() && option->get_required() && option->count() == 0;
    });
    return (missing.empty() ? what : missing.front()->get_name(true) + " is required") + ": " +
           usage;
  }
  if (dynamic_cast<const CLI::ArgumentMismatch*>(&error)) {
    if (what.find("missing") != std::string::npos || what.find("At least") != std::string::npos)
      return option + ": needs a value: " + usage;
    const CLI::Option* const given = command.get_option_no_throw(option);
    if (given && given->get_positional() && given->count() > 1)
      return too_many(given->results().back());
    if (what.find("At Most") != std::string::npos) return option + ": is given more than once";
  }
  if (dynamic_cast<const CLI::ConversionError*>(&error)) {
    const std::string prefix = "Could not convert: ";
    if (const std::size_t equals = what.find(" = ");
        what.starts_with(prefix) && equals != std::string::npos)
      return UsageError(what.substr(prefix.size(), equals - prefix.size()), what.substr(equals + 3),
                        "must be a whole number")
          .what();
  }
  return what;
}

}  // namespace redrive
