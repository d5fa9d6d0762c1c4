// SPDX-License-Identifier: Apache-2.0
// What tests of moving objects on samples/street_traffic share.
#pragma once

#include <string>
#include <vector>

#include "redrive/image/image_io.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {

inline constexpr const char* kTrafficCamera = "F_MIDLONGRANGECAM_CL";

class TrafficEndToEnd : public EndToEnd {
 protected:
  /// Trains splat on one camera of `recording` with exact poses, every 6th frame held out.
  static ProgramResult train_on(const fs::path& recording, const fs::path& run, int steps,
                                const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"train",
                                          recording.string(),
                                          "--out",
                                          run.string(),
                                          "--method",
                                          "splat",
                                          "--cameras",
                                          kTrafficCamera,
                                          "--truth-poses",
                                          "--holdout-every",
                                          "6",
                                          "--threads",
                                          "2",
                                          "--max-steps",
                                          std::to_string(steps)};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(arguments);
  }
  /// Renders the held-out frame 1012.
  Image8 rendered(const fs::path& run, std::vector<std::string> more) const {
    const fs::path out = folder_ / "view.png";
    more.insert(more.begin(), {"render", run.string(), "--camera", kTrafficCamera, "--frame",
                               "1012", "--force", "--out", out.string()});
    const ProgramResult ended = redrive(more);
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.err;
    printed_ = ended.out;
    return read_image(out);
  }

  mutable std::string printed_;  ///< output of the last rendering
};

}  // namespace redrive::testing
