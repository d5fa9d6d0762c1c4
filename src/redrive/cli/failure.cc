// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/failure.h"

#include <cstdio>
#include <exception>
#include <filesystem>
#include <new>

namespace redrive {

Failure current_failure() {
  try {
    throw;
  } catch (const UsageError& error) {
    return {kExitUsage, error.what()};
  } catch (const InputError& error) {
    return {kExitBadInput, error.what()};
  } catch (const InsufficientDataError& error) {
    return {kExitInsufficientData, error.what()};
  } catch (const IoError& error) {
    return {kExitIo, error.what()};
  } catch (const DeviceError& error) {
    return {kExitDevice, error.what()};
  } catch (const Interrupted& error) {
    return {kExitInterrupted, error.what()};
    // thrown for a name too long or a loop of links
  } catch (const std::filesystem::filesystem_error& error) {
    return {kExitBadInput, error.what()};
  } catch (const std::bad_alloc&) {
    return {kExitInternal, "out of memory"};
  } catch (const std::exception& error) {
    return {kExitInternal, error.what()};
  }
}

ExitCode print_failure() {
  const Failure failure = current_failure();
  std::fprintf(stderr, "redrive: %s\n", failure.message.c_str());
  std::fflush(stderr);
  return failure.code;
}

}  // namespace redrive
