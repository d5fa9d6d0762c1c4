// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/viewer.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/image/jpeg.h"
#include "redrive/train/divided_run.h"
#include "redrive/view/server/outgoing.h"
#include "redrive/view/viewer_client.h"

namespace redrive::view {
namespace {

// 15 images a second leave 66 ms for rendering, JPEG (10 ms for 1280 x 704) and overlays.
constexpr double kMovingBudget_s = 0.05;
constexpr double kStrip_s = 0.1;    ///< the longest wait for a newer request
constexpr double kSearch_s = 0.05;  ///< time of observers between two looks at the requests
constexpr double kAtOnce_s = 0.3;   ///< a full image that takes longer is reached in steps
/// time without a request after which the camera rests
constexpr std::chrono::milliseconds kRest{150};
constexpr std::chrono::seconds kLook{2};   ///< between two looks at the run's folder
constexpr std::chrono::seconds kBusy{1};   ///< a client counts as busy after a request
constexpr std::uint64_t kMostUnshown = 2;  ///< images on their way to a page
/// revolutions that a page's cloud grows by at once
constexpr std::size_t kRevolutionsAtOnce = 20;
constexpr std::size_t kMostPathMessages = 16;  ///< messages that wait, at most
/// bytes of a page's messages, not yet parsed
constexpr std::size_t kMostWaitingBytes = 4 * kMaxMessageBytes;
constexpr int kSmallestSide = 64;  ///< pixels of the smallest image
constexpr int kQuality = 92;

/// Returns the factor beyond which an image is too small to show anything.
int largest_factor(const Camera& camera) {
  return std::clamp(std::min(camera.width, camera.height) / kSmallestSide, 1, 16);
}

double seconds_between(std::chrono::steady_clock::time_point from,
                       std::chrono::steady_clock::time_point to) {
  return std::chrono::duration<double>(to - from).count();
}

/// Names the recorded image that belongs to a view.
std::string reference_key(const ViewRequest& view) {
  if (view.novel) return view.novel->set + "/" + std::to_string(view.novel->index);
  if (view.mount) return "mount";
  return view.camera + ":" + std::to_string(view.frame);
}

}  // namespace

Viewer::Viewer(std::shared_ptr<const Run> run, kernels::Backend& backend, Look look, FirstEdit edit)
    : backend_(backend),
      first_edit_(std::move(edit)),
      look_(std::move(look)),
      look_at_(Clock::now() + kLook) {
  if (!first_edit_.text.empty())
    parsed_first_edit_ =
        std::make_shared<const TrafficEdit>(parse_traffic_edit(first_edit_.text, first_edit_.file));
  show(std::move(run));
  if (parsed_first_edit_) check(*parsed_first_edit_);
}
Viewer::~Viewer() = default;

void Viewer::opened(ClientId id) {
  const std::lock_guard lock(mutex_);
  clients_[id] = std::make_shared<Client>();
  clients_[id]->edit = parsed_first_edit_;
  has_news_ = true;
  wake_.notify_one();
}

void Viewer::received(ClientId id, std::string_view text) {
  const std::lock_guard lock(mutex_);
  const auto found = clients_.find(id);
  if (found == clients_.end()) return;
  Inbox& inbox = found->second->inbox;
  inbox.bytes += text.size() + sizeof(Inbox::Text);
  if (inbox.bytes > kMostWaitingBytes) {
    if (server_) server_->close(id, "sends more than can be answered");
    return;
  }
  inbox.texts.push_back({std::string(text), Clock::now()});
  has_news_ = true;
  wake_.notify_one();
}

/// Parses a client's texts. A text that is none of the messages ends the client.
void Viewer::take_texts(ClientId id, Client& client, Inbox inbox) {
  for (Inbox::Text& text : inbox.texts) {
    ClientMessage message = parse_client_message(text.text);
    if (const auto* const train = std::get_if<TrainCommand>(&message))
      paused_ = train->paused;
    else
      client.take(std::move(message), text.arrived);
    if (client.path_messages.size() > kMostPathMessages)
      return server_->close(id, "too many paths at once");
  }
}

void Viewer::closed(ClientId id) {
  const std::lock_guard lock(mutex_);
  clients_.erase(id);
  if (clients_.empty()) paused_ = false;  // no page is left that could resume training
}

void Viewer::show(std::shared_ptr<const Run> run) {
  // Exceptions are thrown before anything changes.
  ViewRenderer renderer(*run, backend_);
  Overlay overlay(*run);
  RenderedScans scans(*run, backend_);
  DriveMap map(run->scene);
  nlohmann::json described = renderer.describe();
  described["map"] = map.frames();
  described["sensors"] = scans.sensors();
  described["edit"] = nullptr;
  if (parsed_first_edit_)
    described["edit"] = {{"text", first_edit_.text}, {"file", first_edit_.saved_as}};
  std::string hello = text_message(described);
  renderer_.emplace(std::move(renderer));
  overlay_.emplace(std::move(overlay));
  scans_.emplace(std::move(scans));
  map_.emplace(std::move(map));
  hello_ = std::move(hello);
  const std::lock_guard lock(mutex_);
  for (const auto& [id, client] : clients_) client->begin_again();
  run_ = std::move(run);
  read_curve();
}

/// Shows a newer checkpoint to all pages, or says why there is none.
void Viewer::look_at_run() {
  if (!look_ || Clock::now() < look_at_) return;
  RunNews news;
  try {
    news = look_();
    if (news.run) show(std::move(news.run));
  } catch (const std::exception& error) {
    news = {nullptr, error.what()};
  }
  look_at_ = Clock::now() + kLook;
  problem_ = std::move(news.problem);
}

void Viewer::use(Server& server) {
  const std::lock_guard lock(mutex_);
  server_ = &server;
}

void Viewer::serve(Server& server, const std::atomic<bool>& stop) {
  use(server);
  while (!stop) work(/*waits=*/true);
}

bool Viewer::work(bool waits) {
  look_at_run();
  struct Turn {
    ClientId id;
    std::shared_ptr<Client> client;
    Inbox inbox;
  };
  std::vector<Turn> turn;
  {
    const std::lock_guard lock(mutex_);
    has_news_ = false;
    for (const auto& [id, client] : clients_)
      turn.push_back({id, client, std::exchange(client->inbox, {})});
  }
  // The clients after the last served one come first.
  std::rotate(
      turn.begin(),
      std::ranges::find_if(turn, [&](const Turn& entry) { return entry.id > last_served_; }),
      turn.end());
  Clock::time_point wake_at = Clock::now() + std::chrono::milliseconds(100);
  bool worked = false;
  for (Turn& entry : turn) try {
      take_texts(entry.id, *entry.client, std::move(entry.inbox));
      if (worked || !work(entry.id, *entry.client, &wake_at)) continue;
      last_served_ = entry.id;
      worked = true;
    } catch (const std::exception& error) {  // ends the page, not the training
      server_->close(entry.id, error.what());
    }
  if (worked) return true;
  if (!waits) return false;
  std::unique_lock lock(mutex_);
  wake_.wait_until(lock, wake_at, [this] { return has_news_; });
  return false;
}

void Viewer::set_training(const Training& training) { training_ = training; }

void Viewer::show_again() {
  renderer_->forget_field();
  read_curve();
  const std::lock_guard lock(mutex_);
  for (const auto& [id, client] : clients_) {
    client->failed = client->scored = false;
    // Renders at full size at once, since the camera rests; refinement continues.
    if (client->sent_factor == 1) client->sent_factor = 2;
    client->search = std::nullopt;
    client->traffic = nullptr;  // tracks train along
    client->scan = std::nullopt;
  }
}

void Viewer::drop_jobs() {
  const std::lock_guard lock(mutex_);
  for (const auto& [id, client] : clients_) client->job = std::nullopt;
}

/// Reads the rows of metrics.jsonl again.
void Viewer::read_curve() {
  if (!renderer_->has_field()) return;
  try {
    curve_ = text_message(curve_to_json(is_divided_run(run_->paths.root)
                                            ? read_block_metrics(run_->paths.root).rows
                                            : read_metrics(run_->paths)));
  } catch (const std::exception&) {  // no file, or a damaged one: the page has no curve
    curve_.clear();
  }
}

/// Does the client's next piece of work. Returns false where there is none before *wake_at, which
/// is lowered to the time from which there is.
bool Viewer::work(ClientId id, Client& client, Clock::time_point* wake_at) {
  if (!client.greeted) {
    client.greeted = true;
    server_->send_text(id, hello_);
    if (renderer_->has_field()) send_paths(id, nlohmann::json::object());
    return true;
  }
  if (!client.path_messages.empty()) {
    const std::vector<ClientMessage> messages = std::exchange(client.path_messages, {});
    for (const ClientMessage& message : messages) answer_path(id, client, message);
    return true;
  }
  if (client.edit_message) {
    answer_edit(id, client, *std::exchange(client.edit_message, std::nullopt));
    return true;
  }
  if (client.drag) {
    answer_drag(id, client, *std::exchange(client.drag, std::nullopt));
    return true;
  }
  if (client.curve != curve_) {
    client.curve = curve_;
    if (!curve_.empty()) server_->send_text(id, curve_);
    return true;
  }
  if (training_) training_->paused = paused_;
  if (training_ && client.training != training_) {
    client.training = training_;
    send(id, {{"kind", "training"},
              {"trains", training_->trains},
              {"paused", training_->paused},
              {"step", training_->step},
              {"steps", training_->steps},
              {"seconds", training_->seconds}});
    return true;
  }
  if (client.problem != problem_) {
    client.problem = problem_;
    send(id, {{"kind", "problem"}, {"text", problem_}});
    return true;
  }
  if (client.pick) {
    answer_pick(id, client, *std::exchange(client.pick, std::nullopt));
    return true;
  }
  return work_on_image(id, client, wake_at) || search_on(id, client);
}

void Viewer::send(ClientId id, const nlohmann::json& json) {
  server_->send_text(id, text_message(json));
}

bool Viewer::work_on_image(ClientId id, Client& client, Clock::time_point* wake_at) {
  if (!client.view || client.failed) return false;
  try {
    if (!client.job) {
      if (client.sent - client.shown >= kMostUnshown) return false;
      const Clock::time_point rests_at = client.arrived + kRest;
      const bool complete = client.sent_factor == 1;
      const bool scores = renderer_->has_field() && !client.scored;
      if (complete && !scores && !client.view->overlays.cloud) return false;
      if (client.sent_factor != 0 && Clock::now() < rests_at) {
        *wake_at = std::min(*wake_at, rests_at);
        return false;
      }
      if (complete && !scores) return more_of_the_cloud(id, client);
      if (complete) return send_score(id, client);
      begin(client);
    }
    if (client.job->step()) finish(id, client);
  } catch (const std::exception& error) {
    client.failed = true;
    client.job.reset();
    send(id, {{"kind", "error"}, {"id", client.view->id}, {"text", error.what()}});
  }
  return true;
}

/// Searches, for some time, the training images that saw the last picked point. Returns false where
/// there is nothing to search.
bool Viewer::search_on(ClientId id, Client& client) {
  if (!client.searched) return false;
  const Clock::time_point start = Clock::now();
  nlohmann::json answer;
  try {
    if (!client.search) client.search = renderer_->begin_search(client.search_at);
    while (renderer_->step(&*client.search))
      if (seconds_between(start, Clock::now()) > kSearch_s) return true;
    answer = renderer_->found(*client.search);
  } catch (const std::exception& error) {  // masks or boxes cannot be read any more
    answer["text"] = error.what();
  }
  answer["kind"] = "seen_by";
  answer["id"] = *std::exchange(client.searched, std::nullopt);
  send(id, answer);
  return true;
}

void Viewer::begin(Client& client) {
  const ViewRequest& view = *client.view;
  const Scene& traffic = traffic_of(client);
  const Placement placement =
      view.path_s && !client.path.empty()
          ? renderer_->place_at(view, interpolate_path(client.path, *view.path_s), traffic)
          : renderer_->place(view, traffic);
  Pace& pace = paces_[{placement.camera_name, view.layer}];
  int factor = 1;
  if (client.sent_factor == 0)
    factor = pace.factor_within(kMovingBudget_s / std::max(1, busy_clients()),
                                largest_factor(placement.camera));
  else if (pace.seconds(1).value_or(0) > kAtOnce_s)
    factor = std::max(1, client.sent_factor / 2);
  client.job_view = *client.view;
  client.job_arrived = client.arrived;
  client.job_refines = client.sent_factor != 0;
  client.job =
      renderer_->begin(*client.view, placement, factor, pace.seconds(factor).value_or(0), kStrip_s);
}

/// Reads a scan of the cloud, or sends the image again with the scans read since. Returns false
/// where both are done.
bool Viewer::more_of_the_cloud(ClientId id, Client& client) {
  bool read = true;
  try {
    read = overlay_->read_cloud();
  } catch (const InputError&) {  // a damaged file is left out
  }
  const std::size_t unseen = overlay_->cloud_revolutions() - client.sent_revolutions;
  if (client.last && unseen >= (read ? kRevolutionsAtOnce : 1)) {
    client.job = std::exchange(client.last, std::nullopt);
    client.job_view = *client.view;
    finish(id, client);
    return true;
  }
  return read;
}

void Viewer::finish(ClientId id, Client& client) {
  const RenderJob& job = *client.job;
  const ViewRequest& view = client.job_view;
  const Placement& placement = job.placement();
  const Clock::time_point rendered = Clock::now();
  const Image8 image = renderer_->colours(job, view.layer, traffic_of(client));
  paces_[{placement.camera_name, view.layer}].measured(
      job.factor(), job.seconds() + seconds_between(rendered, Clock::now()));
  const std::string jpeg = encode_jpeg(image, kQuality);
  std::string points, masked, trouble;
  nlohmann::json lines = nlohmann::json::array(), scan;
  try {
    const Scene& traffic = traffic_of(client);
    if (!renderer_->has_field() && view.is_driven() && !renderer_->reference(view))
      trouble = "the recording has no image of " + view.camera + " at frame " +
                std::to_string(view.frame);
    std::vector<OverlayLine> drawn = overlay_->lines(placement, view.overlays);
    if (const auto object = std::ranges::find(traffic.actors, view.object, &MovingObject::id);
        object != traffic.actors.end())
      std::ranges::move(object_lines(placement, *object), std::back_inserter(drawn));
    lines = lines_to_json(drawn);
    std::optional<Mask> mask;
    if (view.overlays.masks && view.is_driven()) mask = renderer_->mask(view);
    if (mask) masked = mask_runs(*mask);
    if (view.scan) {
      scans_->update(*view.scan, placement.frame, traffic, &client.scan);
      scan = client.scan->described;
    }
    points = overlay_->points(job, view.overlays, view.scan ? &*client.scan : nullptr);
  } catch (const std::exception& error) {  // for example because the recording has moved
    trouble = error.what();
  }
  ++client.sent;
  server_->send_binary(
      id, bytes_message(
              {{"kind", "image"},
               {"sequence", client.sent},
               {"id", view.id},
               {"camera", placement.camera_name},
               {"frame", placement.frame},
               {"width", image.width},
               {"height", image.height},
               {"full_width", placement.camera.width},
               {"full_height", placement.camera.height},
               {"factor", job.factor()},
               {"render_ms", rounded(1e3 * job.seconds(), 0.1)},
               {"total_ms", rounded(1e3 * seconds_between(client.job_arrived, Clock::now()), 0.1)},
               {"at", map_->place(placement.world_from_camera)},
               {"beside",
                map_->beside(placement.camera_name, placement.world_from_camera.translation())},
               {"lines", lines},
               {"scan", scan},
               {"trouble", trouble},
               {"jpeg", jpeg.size()},
               {"points", points.size()},
               {"mask", masked.size()}},
              jpeg, points, masked));
  client.sent_revolutions = overlay_->cloud_revolutions();
  if (client.view->id == view.id) client.sent_factor = job.factor();
  if (client.last) renderer_->reuse(std::move(*client.last));
  client.last = std::exchange(client.job, std::nullopt);
  if (view.reference) send_reference(id, client, view);
}

void Viewer::send_reference(ClientId id, Client& client, const ViewRequest& view) {
  const std::string key = reference_key(view);
  if (client.reference == key) return;
  client.reference = key;
  std::string why = "there is no recorded image of this camera and frame";
  try {
    if (const auto image = renderer_->reference(view)) {
      const std::string jpeg = encode_jpeg(*image, kQuality);
      server_->send_binary(id, bytes_message({{"kind", "reference"},
                                              {"key", key},
                                              {"width", image->width},
                                              {"height", image->height},
                                              {"jpeg", jpeg.size()},
                                              {"points", 0},
                                              {"mask", 0}},
                                             jpeg));
      return;
    }
  } catch (const std::exception& error) {  // for example because the recording has moved
    why = error.what();
  }
  send(id, {{"kind", "no_reference"}, {"key", key}, {"text", why}});
}

/// Sends what is known of the image that rests: its PSNR where it was recorded, else the share that
/// training images saw. Returns false where nothing is known.
bool Viewer::send_score(ClientId id, Client& client) {
  std::optional<double> psnr_db, seen;
  try {
    if (client.last && (client.view->is_driven() || client.view->novel)) {
      psnr_db = renderer_->psnr_db(*client.view, *client.last);
    } else if (client.last && !(training_ && training_->trains)) {
      const auto prepared = renderer_->prepare_coverage(kSearch_s);
      if (prepared == ViewRenderer::Preparation::kMore) return true;
      if (prepared == ViewRenderer::Preparation::kReady) seen = renderer_->seen_share(*client.last);
    }
    // an image or a mask is gone; the page hears of it where it shows them
  } catch (const InputError&) {
  }
  client.scored = true;
  if (!psnr_db && !seen) return false;
  send(id, {{"kind", "score"},
            {"id", client.view->id},
            {"psnr_db", psnr_db ? nlohmann::json(rounded(*psnr_db, 0.01)) : nlohmann::json()},
            {"seen", seen ? nlohmann::json(rounded(*seen, 1e-3)) : nlohmann::json()}});
  return true;
}

bool Viewer::has_clients() const {
  const std::lock_guard lock(mutex_);
  return !clients_.empty();
}

/// Returns the number of clients that asked for something within the last second.
int Viewer::busy_clients() const {
  const std::lock_guard lock(mutex_);
  const Clock::time_point now = Clock::now();
  return static_cast<int>(std::ranges::count_if(
      clients_, [&](const auto& entry) { return now - entry.second->arrived < kBusy; }));
}

}  // namespace redrive::view
