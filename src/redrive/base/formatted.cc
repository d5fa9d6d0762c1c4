// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/formatted.h"

#include <algorithm>
#include <cstdarg>
#include <cstdio>

namespace redrive {

std::string formatted(const char* format, ...) {
  va_list values, again;
  va_start(values, format);
  va_copy(again, values);
  std::string text(std::max(0, std::vsnprintf(nullptr, 0, format, values)), '\0');
  std::vsnprintf(text.data(), text.size() + 1, format, again);
  va_end(again);
  va_end(values);
  return text;
}

}  // namespace redrive
