// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/error.h"

namespace redrive {
namespace {

std::string input_message(const std::filesystem::path& file, std::string_view field,
                          std::string_view value, std::string_view rule) {
  std::string message = file.string();
  if (!field.empty()) message += ": " + std::string(field);
  if (!value.empty()) message += " = " + std::string(value);
  return message + ": " + std::string(rule);
}

std::string usage_message(std::string_view option, std::string_view value, std::string_view rule) {
  std::string message(option);
  if (!value.empty()) message.append(" ").append(value);
  return message.append(": ").append(rule);
}

}  // namespace

InputError::InputError(const std::filesystem::path& file, std::string_view field,
                       std::string_view value, std::string_view rule)
    : std::runtime_error(input_message(file, field, value, rule)),
      file(file.string()),
      field(field),
      value(value),
      rule(rule) {}

UsageError::UsageError(std::string_view option, std::string_view value, std::string_view rule)
    : std::runtime_error(usage_message(option, value, rule)),
      option(option),
      value(value),
      rule(rule) {}

IoError::IoError(const std::filesystem::path& file, std::string_view what)
    : std::runtime_error(file.string() + ": " + std::string(what)) {}

InsufficientDataError::InsufficientDataError(const std::filesystem::path& recording,
                                             std::string_view reason, std::string_view means)
    : std::runtime_error(recording.string() + ": cannot be aligned: " + std::string(reason) + " (" +
                         std::string(means) + ")") {}

DeviceError::DeviceError(std::string_view device, std::string_view what)
    : std::runtime_error(std::string(device) + ": " + std::string(what)) {}

void check_failed(const char* file, int line, const char* expression, const std::string& values) {
  throw std::logic_error(std::string(file) + ":" + std::to_string(line) + ": check failed: " +
                         expression + (values.empty() ? "" : " (" + values + ")"));
}

}  // namespace redrive
