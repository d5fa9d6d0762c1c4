// SPDX-License-Identifier: Apache-2.0
// How redrive says no. Library code throws one of these; cli/main.cc is the only place that catches
// them and turns each into its exit code (exceptions cross no other boundary). A broken invariant
// of our own is a REDRIVE_CHECK, not an error.
#pragma once

#include <filesystem>
#include <stdexcept>
#include <string>
#include <string_view>

namespace redrive {

/// Process exit codes; documented in README.md.
enum ExitCode {
  kExitOk = 0,
  kExitInternal = 1,          ///< a bug in redrive (failed check, unexpected exception)
  kExitUsage = 2,             ///< unknown or out-of-range option, out folder that exists
  kExitBadInput = 3,          ///< a file that cannot be used: missing, malformed, inconsistent
  kExitIo = 4,                ///< the disk said no while writing
  kExitInsufficientData = 5,  ///< the input is in order, but does not determine what was asked for
  kExitPreflightFailed = 6,   ///< inspect --report: something is wrong that training would learn
  kExitDevice = 7,            ///< a GPU failed at its work; what was saved before stands
  kExitInterrupted = 130      ///< Ctrl-C; the state was saved
};

/// A recording, run or poses file that cannot be used. Names file, field and value.
class InputError : public std::runtime_error {
 public:
  /// `field` is a JSON-like path such as "F_CAM.focal_length_px[0]", empty if the whole file is
  /// meant; `value` what was found there; `rule` what was expected.
  InputError(const std::filesystem::path& file, std::string_view field, std::string_view value,
             std::string_view rule);
};

/// An option that cannot be used. Names option, value and rule.
class UsageError : public std::runtime_error {
 public:
  UsageError(std::string_view option, std::string_view value, std::string_view rule);

 protected:
  explicit UsageError(const std::string& message) : std::runtime_error(message) {}
};

/// A file or folder that could not be written (disk full, permissions).
class IoError : public std::runtime_error {
 public:
  IoError(const std::filesystem::path& file, std::string_view what);
};

/// What was asked for cannot be computed from this recording, though nothing about its files is
/// wrong. Says why, and by what it was tried.
class InsufficientDataError : public std::runtime_error {
 public:
  InsufficientDataError(const std::filesystem::path& recording, std::string_view reason,
                        std::string_view means);
};

/// A device that failed at its work, whatever it was: what it has in memory is lost. Says it in its
/// own words.
class DeviceError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A device without memory left for what is asked of it, while it works: other options ask for
/// less.
class DeviceMemoryError : public UsageError {
 public:
  using UsageError::UsageError;
  explicit DeviceMemoryError(const std::string& message) : UsageError(message) {}
};

[[noreturn]] void check_failed(const char* file, int line, const char* expression,
                               const std::string& values);

}  // namespace redrive

/// Broken invariant: prints the expression and both values, then throws std::logic_error.
#define REDRIVE_CHECK_OP(a, op, b)                                             \
  do {                                                                         \
    if (!((a)op(b)))                                                           \
      ::redrive::check_failed(__FILE__, __LINE__, #a " " #op " " #b,           \
                              std::to_string(a) + " vs " + std::to_string(b)); \
  } while (false)
#define REDRIVE_CHECK(condition)                                                   \
  do {                                                                             \
    if (!(condition)) ::redrive::check_failed(__FILE__, __LINE__, #condition, ""); \
  } while (false)
