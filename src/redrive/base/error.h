// SPDX-License-Identifier: Apache-2.0
// Exceptions and exit codes. Library code throws one of these errors; only cli/failure.cc maps each
// to its exit code. A broken invariant of redrive itself is a REDRIVE_CHECK instead.
#pragma once

#include <filesystem>
#include <stdexcept>
#include <string>
#include <string_view>

namespace redrive {

/// Process exit codes (docs/cli.md).
enum ExitCode {
  kExitOk = 0,
  kExitInternal = 1,          ///< a bug in redrive (failed check, unexpected exception)
  kExitUsage = 2,             ///< unknown or out-of-range option, out folder that exists
  kExitBadInput = 3,          ///< a file that cannot be used: missing, malformed, inconsistent
  kExitIo = 4,                ///< a file could not be written
  kExitInsufficientData = 5,  ///< the input is valid, but does not determine the result
  kExitPreflightFailed = 6,   ///< inspect --report: errors that training would learn
  kExitDevice = 7,            ///< a GPU, its driver or its memory failed
  kExitInterrupted = 130      ///< Ctrl-C; a training saved its state, others wrote nothing
};

/// A recording, run or poses file that cannot be used.
class InputError : public std::runtime_error {
 public:
  /// `field`: a JSON-like path such as "F_CAM.focal_length_px[0]", empty for the whole file;
  /// `value`: its value; `rule`: the expectation it breaks.
  InputError(const std::filesystem::path& file, std::string_view field, std::string_view value,
             std::string_view rule);
  const std::string file, field, value, rule;
};

/// An option that cannot be used.
class UsageError : public std::runtime_error {
 public:
  UsageError(std::string_view option, std::string_view value, std::string_view rule);
  const std::string option, value, rule;
};

/// A file or folder that could not be written (disk full, permissions).
class IoError : public std::runtime_error {
 public:
  IoError(const std::filesystem::path& file, std::string_view what);
};

/// The recording does not determine the result, though its files are valid. `reason`: why not;
/// `means`: the data that was used.
class InsufficientDataError : public std::runtime_error {
 public:
  InsufficientDataError(const std::filesystem::path& recording, std::string_view reason,
                        std::string_view means);
};

/// A GPU that failed, was lost or has no memory left.
class DeviceError : public std::runtime_error {
 public:
  DeviceError(std::string_view device, std::string_view what);
};

/// Ctrl-C, or another signal, ended work that leaves nothing behind.
class Interrupted : public std::runtime_error {
 public:
  explicit Interrupted(const char* what = "interrupted, nothing written")
      : std::runtime_error(what) {}
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
