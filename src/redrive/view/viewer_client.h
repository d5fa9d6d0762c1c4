// SPDX-License-Identifier: Apache-2.0
// What the viewer knows of a page. Only viewer.cc and viewer_answers.cc include it.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/view/viewer.h"

namespace redrive::view {

/// Texts received from a page and not yet parsed; guarded by mutex_.
struct Viewer::Inbox {
  struct Text {
    std::string text;
    Clock::time_point arrived;
  };
  std::vector<Text> texts;
  std::size_t bytes = 0;  ///< bytes of the texts, and of their places
};

/// A page. Only serve() uses its members, except the inbox.
struct Viewer::Client {
  Inbox inbox;

  bool greeted = false;
  std::optional<Training> training;  ///< as the page knows it, as are the next two
  std::string curve, problem;
  std::optional<ViewRequest> view;  ///< the latest
  Clock::time_point arrived{};
  bool failed = false;               ///< `view` cannot be shown; the page knows why
  bool scored = false;               ///< the score of `view` was sent
  int sent_factor = 0;               ///< factor of the last image of `view`; 0: none yet
  std::string reference;             ///< key of the recorded image that was sent last
  std::size_t sent_revolutions = 0;  ///< scans of the cloud that were sent with the last image
  std::uint64_t sent = 0, shown = 0;
  std::optional<Pick> pick;
  std::optional<EditMessage> edit_message;
  std::optional<DragMessage> drag;
  std::shared_ptr<const TrafficEdit> edit;  ///< null: none
  std::shared_ptr<const Scene> traffic;     ///< the run's as edited; null: not made yet
  std::optional<RenderedScan> scan;         ///< the scan that was made last
  std::vector<ClientMessage> path_messages;
  std::vector<PathKey> path;

  std::optional<std::uint64_t> searched;  ///< id of the pick whose observers are searched
  std::optional<PointSearch> search;      ///< nothing: not begun
  Eigen::Vector3d search_at = Eigen::Vector3d::Zero();

  std::optional<RenderJob> job;
  ViewRequest job_view;
  Clock::time_point job_arrived{};
  bool job_refines = false;       ///< an image of the same view was sent before
  std::optional<RenderJob> last;  ///< the image that was sent last

  /// Forgets what was made of another state of the run.
  void begin_again() {
    greeted = failed = scored = false;
    sent_factor = 0;
    sent_revolutions = 0;
    searched = std::nullopt;
    search = std::nullopt;
    job = last = std::nullopt;
    traffic = nullptr;
    scan = std::nullopt;
  }

  /// Takes a message; the later one of a kind takes the earlier one's place.
  void take(ClientMessage message, Clock::time_point at) {
    if (auto* const request = std::get_if<ViewRequest>(&message)) {
      view = std::move(*request);
      arrived = at;
      failed = scored = false;
      sent_factor = 0;
      if (job_refines) job.reset();
    } else if (const auto* const picks = std::get_if<Pick>(&message)) {
      pick = *picks;
    } else if (auto* const edits = std::get_if<EditMessage>(&message)) {
      edit_message = std::move(*edits);
    } else if (const auto* const drags = std::get_if<DragMessage>(&message)) {
      drag = *drags;
    } else if (const auto* const drawn = std::get_if<Shown>(&message)) {
      shown = std::min(std::max(shown, drawn->sequence), sent);
    } else {
      path_messages.push_back(std::move(message));
    }
  }
};

}  // namespace redrive::view
