// SPDX-License-Identifier: Apache-2.0
// Known LiDAR sensors. Directions follow the manuals named below, or drivers that quote them.
// Ranges, cycles and divergences are nominal and were not checked against data sheets. A sensor
// whose table of directions is not published is left out.
#include <algorithm>

#include "redrive/math/angles.h"
#include "redrive/recording/core/lidar_sensor.h"

namespace redrive {
namespace {

// Velodyne, "VLS-128 user manual", elevations by channel; channels repeat eight azimuths.
constexpr double kVls128Elevations_deg[] = {
    -11.742, -1.99,   3.4,   -5.29,   -0.78, 4.61,  -4.08,   1.31,   -6.5,  -1.11,   4.28,  -4.41,
    0.1,     6.48,    -3.2,  2.19,    -3.86, 1.53,  -9.244,  -1.77,  2.74,  -5.95,   -0.56, 4.83,
    -2.98,   2.41,    -6.28, -0.89,   3.62,  -5.07, 0.32,    7.58,   -0.34, 5.18,    -3.64, 1.75,
    -25,     -2.43,   2.96,  -5.73,   0.54,  9.7,   -2.76,   2.63,   -7.65, -1.55,   3.84,  -4.85,
    3.18,    -5.51,   -0.12, 5.73,    -4.3,  1.09,  -16.042, -2.21,  4.06,  -4.63,   0.76,  15,
    -3.42,   1.97,    -6.85, -1.33,   -5.62, -0.23, 5.43,    -3.53,  0.98,  -19.582, -2.32, 3.07,
    -4.74,   0.65,    11.75, -2.65,   1.86,  -7.15, -1.44,   3.95,   -2.1,  3.29,    -5.4,  -0.01,
    4.5,     -4.19,   1.2,   -13.565, -1.22, 4.17,  -4.52,   0.87,   6.08,  -3.31,   2.08,  -6.65,
    1.42,    -10.346, -1.88, 3.51,    -6.06, -0.67, 4.72,    -3.97,  2.3,   -6.39,   -1,    4.39,
    -5.18,   0.21,    6.98,  -3.09,   4.98,  -3.75, 1.64,    -8.352, -2.54, 2.85,    -5.84, -0.45,
    8.43,    -2.87,   2.52,  -6.17,   -1.66, 3.73,  -4.96,   0.43};
constexpr double kVls128Azimuths_deg[] = {-6.354, -4.548, -2.732, -0.911,
                                          0.911,  2.732,  4.548,  6.354};

// Hesai, "Pandar64 user manual", appendix "Channel distribution", from channel 1 down.
constexpr double kPandar64Elevations_deg[] = {
    14.882, 11.032, 8.059,  5.057,   3.04,    2.028,   1.86,   1.688,   1.522,  1.351,  1.184,
    1.013,  0.846,  0.675,  0.508,   0.337,   0.169,   0,      -0.169,  -0.337, -0.508, -0.675,
    -0.845, -1.013, -1.184, -1.351,  -1.522,  -1.688,  -1.86,  -2.028,  -2.198, -2.365, -2.536,
    -2.7,   -2.873, -3.04,  -3.21,   -3.375,  -3.548,  -3.712, -3.884,  -4.05,  -4.221, -4.385,
    -4.558, -4.72,  -4.892, -5.057,  -5.229,  -5.391,  -5.565, -5.726,  -5.898, -6.061, -7.063,
    -8.059, -9.06,  -9.885, -11.032, -12.006, -12.974, -13.93, -18.889, -24.897};

// Hesai, "Pandar128 user manual", appendix "Channel distribution", from channel 1 down. Its
// azimuths by channel, which shift beams against each other, are left out.
constexpr double kPandar128Elevations_deg[] = {
    14.436,  13.535,  13.082,  12.624,  12.165,  11.702,  11.239,  10.771,  10.305,  9.83,
    9.356,   8.88,    8.401,   7.921,   7.438,   6.953,   6.467,   5.978,   5.487,   4.996,
    4.501,   4.007,   3.509,   3.013,   2.512,   2.013,   1.885,   1.761,   1.637,   1.511,
    1.386,   1.258,   1.13,    1.008,   0.88,    0.756,   0.63,    0.505,   0.379,   0.251,
    0.124,   0,       -0.129,  -0.254,  -0.38,   -0.506,  -0.632,  -0.76,   -0.887,  -1.012,
    -1.141,  -1.266,  -1.393,  -1.519,  -1.646,  -1.773,  -1.901,  -2.027,  -2.155,  -2.282,
    -2.409,  -2.535,  -2.663,  -2.789,  -2.916,  -3.044,  -3.172,  -3.299,  -3.425,  -3.552,
    -3.68,   -3.806,  -3.933,  -4.062,  -4.19,   -4.318,  -4.444,  -4.571,  -4.699,  -4.824,
    -4.951,  -5.081,  -5.209,  -5.336,  -5.463,  -5.589,  -5.718,  -5.843,  -5.968,  -6.1,
    -6.607,  -7.117,  -7.624,  -8.134,  -8.64,   -9.149,  -9.652,  -10.16,  -10.665, -11.17,
    -11.672, -12.174, -12.673, -13.173, -13.67,  -14.166, -14.66,  -15.154, -15.645, -16.135,
    -16.622, -17.106, -17.592, -18.072, -18.548, -19.03,  -19.501, -19.978, -20.445, -20.918,
    -21.379, -21.848, -22.304, -22.768, -23.219, -23.678, -24.123, -25};

/// Returns the azimuth of a channel of Pandar64, counted from 0, to the left: the table counts
/// clockwise. The six highest beams and the ten lowest are in one column.
double pandar64_azimuth_deg(int channel) {
  constexpr double kColumns_deg[] = {1.042, 3.125, 5.208, -5.208, -3.125, -1.042};
  return channel < 6 || channel >= 54 ? 1.042 : -kColumns_deg[(channel - 6) % 6];
}

std::vector<LidarBeam> sorted(std::vector<LidarBeam> beams) {
  std::ranges::sort(beams, {}, &LidarBeam::elevation_rad);
  return beams;
}

std::vector<LidarBeam> vls128_beams() {
  std::vector<LidarBeam> beams;
  for (const double elevation_deg : kVls128Elevations_deg)
    beams.push_back({kRadiansPerDegree * elevation_deg,
                     kRadiansPerDegree * kVls128Azimuths_deg[beams.size() % 8]});
  return sorted(beams);
}

std::vector<LidarBeam> pandar64_beams() {
  std::vector<LidarBeam> beams;
  for (const double elevation_deg : kPandar64Elevations_deg)
    beams.push_back({kRadiansPerDegree * elevation_deg,
                     kRadiansPerDegree * pandar64_azimuth_deg(static_cast<int>(beams.size()))});
  return sorted(beams);
}

/// Lasers of the lower block are 1/2 degree apart, lasers of the upper one 1/3 (Velodyne, "HDL-64E
/// S2 user's manual"). Each unit is calibrated and differs from this.
std::vector<LidarBeam> hdl64_beams() {
  constexpr int kOfBlock = 32;
  std::vector<LidarBeam> beams = evenly_spaced_beams(kOfBlock, -24.33, -8.83);
  std::ranges::copy(evenly_spaced_beams(kOfBlock, -8.33, 2), std::back_inserter(beams));
  return beams;
}

std::vector<LidarBeam> pandar128_beams() {
  std::vector<LidarBeam> beams;
  for (const double elevation_deg : kPandar128Elevations_deg)
    beams.push_back({kRadiansPerDegree * elevation_deg, 0});
  return sorted(beams);
}

/// Pulses in rows and columns of even angles, symmetric to the left and to the right.
struct PulseGrid {
  int columns, rows;
  double column_deg, row_deg, highest_deg;
  bool by_columns;  ///< a column at a time, from the left; else a pulse, row by row from above

  std::vector<LidarPulse> pattern() const {
    const int pulses = rows * columns;
    std::vector<LidarPulse> pattern(pulses);
    for (int row = 0; row < rows; ++row) {
      const Eigen::Vector3d in_row =
          beam_direction(kRadiansPerDegree * (highest_deg - row_deg * row), 0);
      for (int column = 0; column < columns; ++column) {
        const int at = by_columns ? column * rows + row : row * columns + column;
        pattern[at] = {in_row, by_columns ? (column + 0.5) / columns : (at + 0.5) / pulses,
                       static_cast<std::uint8_t>(rows - 1 - row)};
      }
    }
    for (int column = 0; column < columns; ++column) {
      const Eigen::Vector3d in_column =
          beam_direction(0, kRadiansPerDegree * column_deg * ((columns - 1) / 2.0 - column));
      for (int row = 0; row < rows; ++row) {
        Eigen::Vector3d& direction =
            pattern[by_columns ? column * rows + row : row * columns + column].direction;
        direction.y() = direction.x() * in_column.y();
        direction.x() *= in_column.x();
      }
    }
    return pattern;
  }
};

/// RoboSense, "RS-LiDAR-M1 data sheet": 120 by 25 degrees, 0.2 degrees apart. Its order of firing
/// is not published.
constexpr PulseGrid kM1{600, 125, 0.2, 0.2, 12.4, false};
/// Hesai, "AT128 user manual": 120 by 25.4 degrees, 128 channels that fire together; their azimuths
/// by channel are left out.
constexpr PulseGrid kAt128{1200, 128, 0.1, 0.2, 12.9, true};

/// Returns the steps of a turn at 10 Hz by the time between two firings of a beam.
constexpr int steps_at_10_hz(double cycle_us) { return static_cast<int>(1e5 / cycle_us); }

}  // namespace

const std::vector<LidarSensor>& known_lidar_sensors() {
  static const std::vector<LidarSensor> kSensors = {
      // Velodyne, "VLP-16 user manual".
      {.name = "vlp-16",
       .beams = evenly_spaced_beams(16, -15, 15),
       .azimuth_steps = steps_at_10_hz(55.296),
       .max_range_m = 100,
       .divergence_rad = 3e-3},
      // Velodyne, "HDL-32E user's manual": 4/3 of a degree apart.
      {.name = "hdl-32e",
       .beams = evenly_spaced_beams(32, -30.67, 10.67),
       .azimuth_steps = steps_at_10_hz(46.08),
       .max_range_m = 100},
      {.name = "hdl-64e",
       .beams = hdl64_beams(),
       .azimuth_steps = steps_at_10_hz(48),
       .min_range_m = 0.9,
       .max_range_m = 120,
       .divergence_rad = 2e-3},
      {.name = "vls-128",
       .beams = vls128_beams(),
       .azimuth_steps = steps_at_10_hz(53.3),
       .max_range_m = 245},
      // Ouster, "OS1 data sheet", revision 6: 45 degrees, columns 512, 1024 or 2048.
      {.name = "os1-64",
       .beams = evenly_spaced_beams(64, -22.5, 22.5),
       .azimuth_steps = 1024,
       .max_range_m = 120},
      {.name = "os1-128",
       .beams = evenly_spaced_beams(128, -22.5, 22.5),
       .azimuth_steps = 1024,
       .max_range_m = 120},
      {.name = "pandar64",
       .beams = pandar64_beams(),
       .azimuth_steps = 1800,
       .min_range_m = 0.3,
       .max_range_m = 200},
      {.name = "rs-lidar-m1", .azimuth_steps = 0, .max_range_m = 200, .pattern = kM1.pattern()},
      {.name = "pandar128",
       .beams = pandar128_beams(),
       .azimuth_steps = 1800,
       .min_range_m = 0.3,
       .max_range_m = 200},
      {.name = "at128", .azimuth_steps = 0, .max_range_m = 200, .pattern = kAt128.pattern()}};
  return kSensors;
}

std::string known_lidar_names() {
  std::string names;
  for (const LidarSensor& sensor : known_lidar_sensors())
    names += (names.empty() ? "" : ", ") + sensor.name;
  return names;
}

}  // namespace redrive
