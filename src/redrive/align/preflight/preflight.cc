// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/preflight/preflight.h"

#include <cmath>
#include <limits>

#include "redrive/align/preflight/drive_checks.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

constexpr double kMinFlow_px = 1.5;
constexpr double kScan_ms = 100, kScanStep_ms = 5;
constexpr double kGood_px = 1;  // median error; pose noise of 6 cm and 0.12 degrees makes up to 0.5
constexpr double kUsable_px = 2;  // redrive align can correct it
constexpr double kFactor = 2.5;   // factor by which a hypothesis has to lower the error
constexpr double kMutualFactor =
    1.3;  // the same factor if each of two cameras fits the other's extrinsics
constexpr double kSynchronous_ms = 5, kAlignable_ms = 30;
constexpr double kObservableFactor = 1.4;  // ratio of the scan's ends to its minimum
constexpr double kScanFactor = 0.8;        // factor by which the scan's minimum has to be lower,
constexpr double kSigmas = 2;  // or standard deviations from 0: a false "usable" costs little
constexpr std::size_t kMinOfPair = 10;  // least number of points of two images
constexpr double kNearTie = 1.25;       // ratio of errors whose hypotheses are named together
constexpr std::size_t kMaxNamed = 3;
const char* const kUnobservableByImages =
    "; its time offset is unobservable: with this motion any time looks the same";
const char* const kUnobservableByAll =
    "; its time offset is unobservable: with this motion any time looks the same, and the LiDAR's "
    "contrast does not determine it";

std::string extrinsics_of(const std::string& other) { return "it has the extrinsics of " + other; }

std::string px_text(double px) {
  char text[40];
  std::snprintf(text, sizeof text, "%.2f", px);
  return text;
}
std::string then_agree(const std::string& px, double recorded_px) {
  return ": then half of the points agree to " + px + " px, as recorded to " +
         px_text(recorded_px) + " px";
}

/// Ratio of the recorded error to the error with the other's extrinsics; 0 where that was not
/// tried.
double gain_as(const CameraCheck& camera, const std::string& other) {
  for (const Hypothesis& h : camera.tried)
    if (h.what == extrinsics_of(other)) return camera.tried[0].error_px / h.error_px;
  return 0;
}

/// Finds swapped cameras that look nearly the same way: each fits the other's extrinsics only a
/// little better, but both do.
void find_swapped(std::vector<CameraCheck>* cameras) {
  for (CameraCheck& a : *cameras)
    for (const CameraCheck& b : *cameras) {
      if (a.verdict == Verdict::kCannotTell || a.fault == Fault::kSwappedCameras) continue;
      if (gain_as(a, b.name) < kMutualFactor || gain_as(b, a.name) < kMutualFactor) continue;
      const auto best = std::ranges::min_element(a.tried, {}, &Hypothesis::error_px);
      if (best->what != extrinsics_of(b.name)) continue;
      a.verdict = Verdict::kWrong;
      a.fault = Fault::kSwappedCameras;
      a.why = best->what + then_agree(px_text(best->error_px), a.tried[0].error_px);
    }
}

/// ", but those between frames 1018 and 1020 to 25.10 px only".
std::string odd_pairs_text(const std::vector<OddPair>& pairs) {
  constexpr std::size_t kShown = 3;
  std::string text;
  for (std::size_t i = 0; i < std::min(kShown, pairs.size()); ++i)
    text += (i == 0 ? ", but those between frames " : ", between ") +
            std::to_string(pairs[i].first_id) + " and " + std::to_string(pairs[i].last_id) +
            " to " + px_text(pairs[i].error_px) + " px only";
  if (pairs.size() > kShown) text += ", and of " + std::to_string(pairs.size() - kShown) + " more";
  return text;
}

/// A camera's extrinsics and times, as recorded or as a hypothesis.
struct Setup {
  Rigid3d body_from_sensor;
  double offset_s = 0;  ///< exposure minus its frame's time
  double rate = 1;      ///< interval between images relative to that between frames
};

class Checker {
 public:
  Checker(const Recording& recording, const RigImages& images,
          const std::vector<ContrastFit>& contrast, int camera,
          const CorrespondenceOptions& options)
      : recording_(recording), correspondences_(find_correspondences(images, camera, options)) {
    for (const FramePose& pose : recording.frames) {
      FramePose local = pose;
      local.global_from_body = images.scene.global_from_world.inverse() * pose.global_from_body;
      frames_.push_back(local);
    }
    const CameraCalibration& calibration = recording.cameras[camera].calibration;
    recorded_ = {calibration.body_from_sensor,
                 1e-9 * static_cast<double>(calibration.time_offset_ns), 1};
    check_.name = calibration.name;
    check_.scale = images.factor[camera];
    check_.points = static_cast<int>(correspondences_.size());
    if (!contrast.empty()) take(contrast[camera]);
  }

  CameraCheck run() {
    if (check_.points < kMinPoints) {
      check_.why = "only " + std::to_string(check_.points) +
                   " points could be followed: dark, without structure, or too few images";
      return check_;
    }
    std::vector<double> flow_px = flow();
    check_.flow_px = median_of(&flow_px);
    try_setup(Fault::kNone, "as recorded", recorded_);
    if (check_.flow_px < kMinFlow_px) {
      check_.why = "the vehicle hardly moves: directions and times are unobservable";
      return check_;
    }
    find_odd_pairs();
    try_extrinsics();
    try_time_offsets();
    scan();
    std::stable_sort(
        check_.tried.begin() + 1, check_.tried.end(),
        [](const Hypothesis& a, const Hypothesis& b) { return a.error_px < b.error_px; });
    judge();
    return check_;
  }

 private:
  void take(const ContrastFit& fit) {
    if (fit.cells == 0) return;
    const int middle = static_cast<int>(fit.correlation.size() / 2);
    for (int k = 0; k <= 2 * middle; ++k)
      check_.contrast.push_back({1e3 * kContrastStep_s * (k - middle), fit.correlation[k]});
    if (fit.observable)
      check_.by_lidar =
          TimeOffsetEstimate{1e3 * (fit.offset_s - recorded_.offset_s), 1e3 * fit.sigma_s, true};
  }

  Rigid3d world_from_body(const Setup& setup, int frame) const {
    const double since_first_s = 1e-9 * static_cast<double>(frames_[frame].t_ns - frames_[0].t_ns);
    const double t_s = setup.rate * since_first_s + setup.offset_s;
    return pose_at(frames_, frames_[0].t_ns + std::llround(1e9 * t_s));
  }
  bool has_poses(const Setup& setup, int frame) const {
    const double end_s = 1e-9 * static_cast<double>(frames_.back().t_ns - frames_[0].t_ns);
    const double t_s =
        setup.rate * 1e-9 * static_cast<double>(frames_[frame].t_ns - frames_[0].t_ns) +
        setup.offset_s;
    return t_s >= -0.001 && t_s <= end_s + 0.001;
  }

  /// One per correspondence; NaN for images without poses.
  std::vector<double> errors(const Setup& setup) const {
    std::vector<double> all;
    all.reserve(correspondences_.size());
    const Rigid3d sensor_from_body = setup.body_from_sensor.inverse();
    int a = -1, b = -1;
    PairGeometry pose;
    for (const Correspondence& sight : correspondences_) {
      if (!has_poses(setup, sight.frame_a) || !has_poses(setup, sight.frame_b)) {
        all.push_back(std::numeric_limits<double>::quiet_NaN());
        continue;
      }
      if (sight.frame_a != a || sight.frame_b != b) {
        a = sight.frame_a;
        b = sight.frame_b;
        pose.b_from_a = sensor_from_body * world_from_body(setup, b).inverse() *
                        world_from_body(setup, a) * setup.body_from_sensor;
        pose.up_in_a = sensor_from_body.linear() * Eigen::Vector3d::UnitZ();
        pose.height_m = setup.body_from_sensor.translation().z();
      }
      all.push_back(correspondence_error_px(sight.rays, pose));
    }
    return all;
  }

  /// Compares the pairs of images with each other: a single wrong pose does not change the median
  /// of all.
  void find_odd_pairs() {
    const std::vector<double> px = errors(recorded_);
    const double least_px = std::max(kUsable_px, kFactor * check_.tried[0].error_px);
    std::vector<double> of_pair;
    for (std::size_t i = 0; i < px.size(); ++i) {
      const Correspondence& sight = correspondences_[i];
      if (!std::isnan(px[i])) of_pair.push_back(px[i]);
      if (i + 1 < px.size() && correspondences_[i + 1].frame_a == sight.frame_a) continue;
      if (of_pair.size() >= kMinOfPair)
        if (const double median_px = median_of(&of_pair); median_px > least_px)
          check_.odd_pairs.push_back(
              {frames_[sight.frame_a].id, frames_[sight.frame_b].id, median_px});
      of_pair.clear();
    }
  }

  /// Displacement of each point, independent of the calibration.
  std::vector<double> flow() const {
    std::vector<double> all;
    for (const Correspondence& s : correspondences_)
      all.push_back(s.rays.px_per_rad_b * std::atan2(s.rays.ray_a.cross(s.rays.ray_b).norm(),
                                                     s.rays.ray_a.dot(s.rays.ray_b)));
    return all;
  }

  std::optional<double> error(const Setup& setup) const {
    std::vector<double> all = errors(setup);
    std::erase_if(all, [](double px) { return std::isnan(px); });
    if (static_cast<int>(all.size()) < kMinPoints) return std::nullopt;
    return median_of(&all);
  }

  void try_setup(Fault fault, const std::string& what, const Setup& setup) {
    if (const auto e = error(setup)) check_.tried.push_back({fault, what, *e});
  }
  void try_extrinsic(Fault fault, const std::string& what, const Rigid3d& body_from_sensor) {
    Setup setup = recorded_;
    setup.body_from_sensor = body_from_sensor;
    try_setup(fault, what, setup);
  }

  void try_extrinsics() {
    const Rigid3d& extrinsics = recorded_.body_from_sensor;
    try_extrinsic(Fault::kInvertedExtrinsic, "the extrinsic is inverted (sensor_from_body)",
                  extrinsics.inverse());
    for (const RecordedCamera& other : recording_.cameras)
      if (other.calibration.name != check_.name)
        try_extrinsic(Fault::kSwappedCameras, extrinsics_of(other.calibration.name),
                      other.calibration.body_from_sensor);
    // Columns: possible axes of the file in the documented ones.
    const auto axes = [](std::initializer_list<double> rows) {
      Eigen::Matrix3d m;
      std::copy(rows.begin(), rows.end(), m.data());
      return Eigen::Matrix3d(m.transpose());
    };
    struct Axes {
      const char* what;
      Eigen::Matrix3d ours_from_theirs;
    };
    const Axes of_camera[] = {
        {"the camera's axes are x right, y up, z back (OpenGL)",
         axes({1, 0, 0, 0, -1, 0, 0, 0, -1})},
        {"the camera's axes are x forward, y left, z up", axes({0, -1, 0, 0, 0, -1, 1, 0, 0})},
        {"the camera's axes are x forward, y right, z down", axes({0, 1, 0, 0, 0, 1, 1, 0, 0})},
        {"the camera's axes are x left, y up, z forward (upside down)",
         axes({-1, 0, 0, 0, -1, 0, 0, 0, 1})},
        {"the image is rotated by 90 degrees", axes({0, -1, 0, 1, 0, 0, 0, 0, 1})},
        {"the image is rotated by -90 degrees", axes({0, 1, 0, -1, 0, 0, 0, 0, 1})},
        {"the camera's axes are x left, y down, z back", axes({-1, 0, 0, 0, 1, 0, 0, 0, -1})}};
    for (const Axes& a : of_camera) {
      Rigid3d fixed = extrinsics;
      fixed.linear() = extrinsics.linear() * a.ours_from_theirs.transpose();
      try_extrinsic(Fault::kAxesConvention, a.what, fixed);
    }
    const Axes of_body[] = {
        {"the body's axes are x forward, y right, z down", axes({1, 0, 0, 0, -1, 0, 0, 0, -1})},
        {"the body's axes are x right, y forward, z up", axes({0, 1, 0, -1, 0, 0, 0, 0, 1})},
        {"the body's axes are x back, y right, z up", axes({-1, 0, 0, 0, -1, 0, 0, 0, 1})}};
    for (const Axes& a : of_body)
      try_extrinsic(Fault::kAxesConvention, a.what, Rigid3d(a.ours_from_theirs) * extrinsics);
  }

  void try_time_offsets() {
    for (const double rate : {0.5, 2.0, 1.5, 2.0 / 3}) {
      Setup setup = recorded_;
      setup.rate = rate;
      char what[120];
      std::snprintf(what, sizeof what, "its images come %.2g times as fast as their frames",
                    1 / rate);
      try_setup(Fault::kWrongRate, what, setup);
    }
    const double frame_s = 1e-9 * static_cast<double>(frames_.back().t_ns - frames_[0].t_ns) /
                           static_cast<double>(frames_.size() - 1);
    for (int shift = -5; shift <= 5; ++shift) {
      if (std::abs(shift) * frame_s * 1e3 < kScan_ms) continue;  // the scan covers it
      Setup setup = recorded_;
      setup.offset_s += shift * frame_s;
      try_setup(Fault::kUnsynchronised,
                "its images belong " + std::to_string(std::abs(shift)) +
                    (shift > 0 ? " frames later" : " frames earlier"),
                setup);
    }
  }

  void scan() {
    OffsetErrors all;
    for (std::size_t i = 0; i < correspondences_.size(); ++i)
      all.pair.push_back(i == 0 ? 0
                                : all.pair.back() + (correspondences_[i].frame_a !=
                                                     correspondences_[i - 1].frame_a));
    for (double offset_ms = -kScan_ms; offset_ms <= kScan_ms; offset_ms += kScanStep_ms) {
      Setup setup = recorded_;
      setup.offset_s += 1e-3 * offset_ms;
      all.offsets_ms.push_back(offset_ms);
      all.px.push_back(errors(setup));
    }
    check_.scan = error_scan(all);
    if (check_.scan.empty()) return;
    const auto& s = check_.scan;
    const ScanPoint minimum = scan_minimum(s);
    check_.offset_ms = minimum.offset_ms;
    check_.offset_error_px = minimum.error_px;
    check_.offset_sigma_ms = scan_minimum_sigma_ms(all);
    check_.offset_observable =
        std::min(s.front().error_px, s.back().error_px) > kObservableFactor * minimum.error_px;
  }

  void judge() {
    const double recorded_px = check_.tried[0].error_px;
    const bool better = std::abs(check_.offset_ms) > kSynchronous_ms &&
                        check_.offset_error_px < kScanFactor * recorded_px;
    const std::optional<TimeOffsetEstimate> offset =
        better ? check_.by_images() : check_.time_offset();
    const double distance_ms = offset ? std::abs(offset->offset_ms) : 0;
    const bool is_off =
        offset && distance_ms > std::max(kSynchronous_ms, kSigmas * offset->sigma_ms);
    const Hypothesis* best = check_.tried.size() > 1 ? &check_.tried[1] : nullptr;
    if (best && kFactor * best->error_px < recorded_px && recorded_px > kGood_px &&
        best->error_px < check_.offset_error_px) {
      check_.verdict = Verdict::kWrong;
      check_.fault = best->fault;
      check_.why = explanation_of(check_.tried);
    } else if (better || (is_off && recorded_px <= kUsable_px)) {
      check_.verdict = better && distance_ms > kAlignable_ms ? Verdict::kWrong : Verdict::kUsable;
      check_.fault = Fault::kUnsynchronised;
      char text[160], sure[40] = "";
      if (std::isfinite(offset->sigma_ms))
        std::snprintf(sure, sizeof sure, " (+- %.0f)", offset->sigma_ms);
      std::snprintf(text, sizeof text, "time offset of about %.0f ms%s%s, exposed %s than recorded",
                    distance_ms, sure, offset->by_lidar ? " by the LiDAR's contrast" : "",
                    offset->offset_ms > 0 ? "later" : "earlier");
      check_.why = text + (better ? then_agree(px_text(check_.offset_error_px), recorded_px)
                                  : "; half of the points agree to " + px_text(recorded_px) +
                                        " px as recorded");
    } else if (recorded_px > kUsable_px) {
      check_.verdict = Verdict::kWrong;
      check_.fault = Fault::kUnexplained;
      check_.why = "half of the points agree to " + px_text(recorded_px) +
                   " px only, and no hypothesis explains it";
    } else {
      const bool good = recorded_px <= kGood_px && check_.odd_pairs.empty();
      check_.verdict = good ? Verdict::kGood : Verdict::kUsable;
      check_.why = "half of the points agree to " + px_text(recorded_px) + " px" +
                   odd_pairs_text(check_.odd_pairs) +
                   (good ? "" : ": redrive align may improve it");
      if (!offset)
        check_.why += check_.contrast.empty() ? kUnobservableByImages : kUnobservableByAll;
    }
  }

  const Recording& recording_;
  std::vector<FramePose> frames_;  ///< with the scene's world as the global frame
  std::vector<Correspondence> correspondences_;
  Setup recorded_;
  CameraCheck check_;
};

}  // namespace

const char* verdict_name(Verdict verdict) {
  constexpr const char* kNames[] = {"good", "usable", "wrong", "cannot tell"};
  return kNames[static_cast<int>(verdict)];
}

const char* fault_name(Fault fault) {
  constexpr const char* kNames[] = {
      "",           "inverted_extrinsic", "swapped_cameras", "axes_convention",
      "wrong_rate", "unsynchronised",     "unexplained"};
  return kNames[static_cast<int>(fault)];
}

std::optional<TimeOffsetEstimate> CameraCheck::time_offset() const {
  if (by_lidar && !(offset_observable && offset_sigma_ms < by_lidar->sigma_ms)) return by_lidar;
  if (offset_observable) return by_images();
  return std::nullopt;
}

std::string explanation_of(const std::vector<Hypothesis>& tried) {
  std::string what = tried[1].what, px = px_text(tried[1].error_px);
  const std::size_t named = std::min(tried.size(), kMaxNamed + 1);
  for (std::size_t i = 2; i < named && tried[i].error_px <= kNearTie * tried[1].error_px; ++i) {
    what += ", or " + tried[i].what;
    px += " or " + px_text(tried[i].error_px);
  }
  return what + then_agree(px, tried[0].error_px);
}

std::string Preflight::headline() const {
  if (!passes()) return "Training makes no sense before this is corrected";
  std::string unchecked;
  bool all = true;
  for (const CameraCheck& camera : cameras) {
    if (camera.verdict != Verdict::kCannotTell)
      all = false;
    else
      unchecked += (unchecked.empty() ? "" : ", ") + camera.name;
  }
  if (all)
    return "No camera could be checked: this check can neither recommend nor refuse training";
  for (const SharedCheck& check : shared)
    if (check.verdict == Verdict::kUsable) return "Align before training: " + check.why;
  return "Nothing speaks against training" +
         (unchecked.empty() ? "" : "; could not be checked: " + unchecked);
}

bool Preflight::passes() const {
  const auto is_wrong = [](const auto& check) { return check.verdict == Verdict::kWrong; };
  return !is_wrong(clock) && std::ranges::none_of(cameras, is_wrong) &&
         std::ranges::none_of(shared, is_wrong);
}

ClockCheck check_clock(const Recording& recording) {
  ClockCheck check;
  // time of the frame, time of the middle of its scan
  std::vector<std::pair<double, double>> times_s;
  std::vector<FrameFile> files;  // one LiDAR's: others turn at other times
  if (!recording.lidar_files.empty()) files = recording.scans_of(recording.lidar_files[0].lidar);
  const std::size_t step = std::max<std::size_t>(1, files.size() / 8);
  for (std::size_t i = 0; i < files.size(); i += step) {
    const auto frame = std::ranges::find(recording.frames, files[i].frame_id, &FramePose::id);
    if (frame == recording.frames.end()) continue;
    std::vector<LidarPoint> points = recording.read_lidar(files[i]);
    if (points.empty()) continue;
    const auto middle = points.begin() + static_cast<std::ptrdiff_t>(points.size() / 2);
    std::ranges::nth_element(points, middle, {}, &LidarPoint::t_ns);
    const std::int64_t first_ns = recording.frames[0].t_ns;
    times_s.emplace_back(1e-9 * static_cast<double>(frame->t_ns - first_ns),
                         1e-9 * static_cast<double>(middle->t_ns - first_ns));
  }
  if (times_s.size() < 2 || times_s.back().second - times_s.front().second < 0.2) {
    check.why = "no LiDAR to compare the frames' times with";
    return check;
  }
  check.frame_seconds_per_lidar_second = (times_s.back().first - times_s.front().first) /
                                         (times_s.back().second - times_s.front().second);
  double apart_s = 0;
  for (const auto& [frame_s, lidar_s] : times_s)
    apart_s = std::max(apart_s, std::abs(frame_s - lidar_s));
  char text[200];
  const double rate = check.frame_seconds_per_lidar_second;
  if (std::abs(rate - 1) > 0.05) {
    check.verdict = Verdict::kWrong;
    std::snprintf(text, sizeof text,
                  "between frames %.2f times as much time passes as between the LiDAR revolutions "
                  "of the same names: wrong fps",
                  rate);
  } else if (apart_s > 0.1) {
    check.verdict = Verdict::kWrong;
    std::snprintf(
        text, sizeof text,
        "LiDAR revolutions lie up to %.0f ms from the frames they are named after: unsynchronised",
        1e3 * apart_s);
  } else {
    check.verdict = Verdict::kGood;
    std::snprintf(text, sizeof text,
                  "LiDAR revolutions lie within %.0f ms of the frames they are named after",
                  1e3 * apart_s);
  }
  check.why = text;
  return check;
}

Preflight check_recording(const Recording& recording, const RigImages& images,
                          const std::vector<LidarSample>& lidar, ThreadPool& pool,
                          const CorrespondenceOptions& options) {
  Preflight result;
  result.cameras.resize(recording.cameras.size());
  if (!recording.metric || recording.frames.size() < 3) {
    const char* const why =
        recording.metric ? "too few frames" : "photographs have neither metres nor times";
    for (std::size_t c = 0; c < recording.cameras.size(); ++c) {
      result.cameras[c].name = recording.cameras[c].calibration.name;
      result.cameras[c].why = why;
    }
    result.clock.why = why;
    return result;
  }
  std::vector<ContrastFit> contrast;
  std::vector<std::optional<EdgeScore>> edges(recording.cameras.size());
  if (!lidar.empty()) {
    const RigModel model = make_rig_model(recording);
    contrast = fit_time_offsets(model, {images, lidar}, pool);
    edges = depth_edge_scores(model, {images, lidar}, pool);
  }
  pool.run(images.cameras(), [&](int c) {
    result.cameras[c] = Checker(recording, images, contrast, c, options).run();
    result.cameras[c].edges = edges[c];
  });
  find_swapped(&result.cameras);
  result.clock = check_clock(recording);
  result.shared.push_back(check_motion(recording));
  return result;
}

}  // namespace redrive
