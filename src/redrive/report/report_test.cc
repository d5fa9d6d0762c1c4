// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <cstdlib>
#include <filesystem>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/image/image_io.h"
#include "redrive/report/html.h"
#include "redrive/report/plot.h"
#include "redrive/report/report_images.h"

namespace redrive {
namespace {

TEST(Html, Base64OfTheStandardsExamples) {  // RFC 4648, section 10
  EXPECT_EQ(base64(""), "");
  EXPECT_EQ(base64("f"), "Zg==");
  EXPECT_EQ(base64("fo"), "Zm8=");
  EXPECT_EQ(base64("foo"), "Zm9v");
  EXPECT_EQ(base64("foobar"), "Zm9vYmFy");
  EXPECT_EQ(base64("\xff\xfe\xfd"), "//79");
}

TEST(Html, FormatsNumbers) {
  EXPECT_EQ(fixed(-1.256, 2), "-1.26");
  EXPECT_EQ(fixed(-0.004, 2), "0.00");
  EXPECT_EQ(fixed(-0.0, 0), "0");
  EXPECT_EQ(fixed(0.0051, 2), "0.01");
  EXPECT_EQ(fixed(std::nan(""), 2), "-");
}

TEST(Html, EscapesText) {
  EXPECT_EQ(html_escape("<a href=\"x\">'&'"), "&lt;a href=&quot;x&quot;&gt;&#39;&amp;&#39;");
  const std::string table =
      html_table({{"<a>", "<b>", "<c>", "<d>"}, {"1", "2", "3", "<e>"}}, false);
  EXPECT_NE(table.find("<td data-head=\"&lt;d&gt;\">&lt;e&gt;</td>"), std::string::npos) << table;
  EXPECT_EQ(html_command("a '<b>'"),
            "<pre><code><span>a</span> <span>&#39;&lt;b&gt;&#39;</span>"
            "</code></pre>\n");
  EXPECT_EQ(html_table({{"<b>"}}, false).find("<b>"), std::string::npos);
  EXPECT_EQ(html_warning("<script>").find("<script>"), std::string::npos);
  EXPECT_EQ(html_figure("data:,", "\"><script>").find("<script>"), std::string::npos);
}

TEST(ReportImages, DifferenceIsAmplifiedAndClamped) {
  const Image8 a{1, 2, {10, 20, 30, 255, 0, 7}}, b{1, 2, {12, 20, 25, 0, 255, 8}};
  EXPECT_EQ(difference(a, b).rgb, (std::vector<std::uint8_t>{8, 0, 20, 255, 255, 4}));
}

TEST(ReportImages, CoverageMarksUnseenPixels) {
  RenderedImage image;
  image.width = 3;
  image.height = 1;
  image.rgb = {0.2f, 0.2f, 0.2f, 0.2f, 0.2f, 0.2f, 0, 0, 0};  // 51
  image.valid = {1, 1, 0};
  const Image8 colours = coverage_colours(image, {1, 0, 0});
  EXPECT_EQ(colours.rgb, (std::vector<std::uint8_t>{51, 51, 51, 153, 25, 25, 0, 0, 0}));
}

TEST(ReportImages, MovingObjectsHaveColoursOfTheirOwn) {
  RenderedImage image;
  image.width = 4;
  image.height = 1;
  image.rgb.assign(12, 0.2f);  // 51
  image.valid = {1, 1, 1, 0};
  image.ids = {0, 1, 2, 1};
  const std::vector<std::uint8_t> rgb = actor_colours(image).rgb;
  const auto pixel = [&](std::size_t i) {
    return std::vector<std::uint8_t>(rgb.begin() + std::ptrdiff_t(3 * i),
                                     rgb.begin() + std::ptrdiff_t(3 * i + 3));
  };
  EXPECT_EQ(pixel(0), (std::vector<std::uint8_t>{51, 51, 51}));
  EXPECT_NE(pixel(1), pixel(0));
  EXPECT_NE(pixel(1), pixel(2));
  EXPECT_EQ(pixel(3), (std::vector<std::uint8_t>{51, 51, 51})) << "invalid";
}

TEST(ReportImages, DepthGoesFromBlueToRedWithInvalidPixelsGrey) {
  RenderedImage image;
  image.width = 3;
  image.height = 1;
  image.depth = {2, 9,
                 5};  // an eighth and most of the way: the ends of Turbo itself are nearly black
  image.valid = {1, 1, 0};
  const Image8 colours = depth_colours(image, 1, 10);
  EXPECT_GT(colours.rgb[2], colours.rgb[0] + 60) << "near is blue";
  EXPECT_GT(colours.rgb[3], colours.rgb[5] + 60) << "far is red";
  EXPECT_EQ((std::vector<std::uint8_t>(colours.rgb.begin() + 6, colours.rgb.end())),
            (std::vector<std::uint8_t>{40, 40, 40}));
}

TEST(Plot, RunningMeanShrinksAtTheEnds) {
  EXPECT_EQ(running_mean({1, 2, 6, 3, 8}, 1),
            (std::vector<double>{1.5, 3, 11.0 / 3, 17.0 / 3, 5.5}));
  EXPECT_EQ(running_mean({4, 5}, 0), (std::vector<double>{4, 5}));
}

TEST(Plot, TimeCurvesHaveBandsOfTwoSigmas) {
  TimeCurves curves{{"moved", "time (s)", "moved (cm)"},
                    {"ahead", "left", "up"},
                    {0, 0.5},
                    {{1, 2, 3}, {4, 5, -6}},
                    {}};
  curves.bound = 50;
  std::string script = time_curves_script(curves);
  EXPECT_NE(script.find("\n0.5 4 4 4 5 5 5 -6 -6 -6\nend\n"), std::string::npos) << script;
  EXPECT_EQ(script.find("filledcurves"), std::string::npos);
  EXPECT_EQ(script.find("bound"), std::string::npos) << "far away";
  curves.sigmas = {{1, 1, 1}, {0.5, 0.25, 2}};
  curves.bound = 11;
  script = time_curves_script(curves);
  EXPECT_NE(script.find("\n0.5 4 3 5 5 4.5 5.5 -6 -10 -2\n"), std::string::npos) << script;
  EXPECT_NE(script.find("filledcurves"), std::string::npos);
  EXPECT_NE(script.find("title 'bound'"), std::string::npos);
  EXPECT_NE(script.find(", -11 with lines"), std::string::npos);
}

class PlotFolder : public testing::Test {
 protected:
  PlotFolder() {
    std::filesystem::create_directory(folder);
    for (int i = 0; i < 200; ++i) {
      MetricsRow row;
      row.step = 25 * (i + 1);
      row.loss = 0.1 / (i + 1);
      row.psnr_db = 10 + i * 0.1;
      row.epoch = i / 50;
      rows.push_back(row);
    }
  }
  const TemporaryFolder above;
  const std::filesystem::path folder = above.path / "plot's folder";  // a name that needs quotes
  std::vector<MetricsRow> rows;
};

TEST_F(PlotFolder, DrawsAPngOfTheHistory) {
  draw_plot(folder, "loss", loss_script(rows));
  draw_plot(folder, "psnr", psnr_script(rows));
  const Image8 image = read_image(folder / "loss.png");
  EXPECT_EQ(image.width, kPlotWidth_px);
  EXPECT_EQ(image.height, 560);
  EXPECT_TRUE(std::filesystem::exists(folder / "psnr.png"));
  EXPECT_FALSE(std::filesystem::exists(folder / "loss.png.part"));
}

TEST_F(PlotFolder, DrawsTimeCurvesIntoAPage) {
  TimeCurves curves{
      {"it's", "x", "'y"}, {"a", "b'", "c"}, {0, 1, 2}, {{1, 2, 3}, {4, 5, -6}, {0, 0, 0}}, {}, 6};
  const std::string html =
      plot_figure(folder / "figures", "it's", time_curves_script(curves), "how <far>");
  EXPECT_EQ(read_image(folder / "figures/it's.png").width, kPlotWidth_px);
  EXPECT_NE(html.find("data:image/png;base64,iVBOR"), std::string::npos);
  EXPECT_NE(html.find("how &lt;far&gt;"), std::string::npos);
  curves.t_s = {0};  // a single frame has no curve, which is no error
  curves.values.assign(1, Eigen::Vector3d::Zero());
  curves.sigmas = curves.values;
  draw_plot(folder, "it's", time_curves_script(curves));
}

TEST_F(PlotFolder, HasAtLeastTwoTicksHoweverLittleTheLossFalls) {
  EXPECT_NE(loss_script(rows).find("set logscale y"), std::string::npos);
  for (MetricsRow& row : rows) row.loss = 0.11 + 0.0001 * static_cast<double>(row.epoch);
  EXPECT_EQ(loss_script(rows).find("set logscale y"), std::string::npos)
      << "1, 2 and 5 of a decade are all outside";
}

TEST_F(PlotFolder, MarksEachEpochWhereItBegins) {
  const std::string script = loss_script(rows);
  EXPECT_NE(script.find("set arrow from 1250, graph 0"), std::string::npos);
  EXPECT_NE(script.find("set label 'epoch 4' at 3750"), std::string::npos);
  EXPECT_EQ(script.find("epoch 5"), std::string::npos);
  rows[1].epoch = 1;  // an epoch of one row, whose label would cover the first one's
  for (std::size_t i = 2; i < rows.size(); ++i) rows[i].epoch = static_cast<int>(i) / 50 + 1;
  const std::string crowded = loss_script(rows);
  EXPECT_NE(crowded.find("set label 'epoch 1' at 0"), std::string::npos);
  EXPECT_EQ(crowded.find("set label 'epoch 2'"), std::string::npos);
  EXPECT_NE(crowded.find("set label 'epoch 3'"), std::string::npos);
}

TEST_F(PlotFolder, AFailingPlotThrowsAndKeepsTheOldImage) {
  draw_plot(folder, "loss", loss_script(rows));
  const std::string before = read_file(folder / "loss.png");
  EXPECT_THROW(draw_plot(folder, "loss", "set output 'loss.png.part'\nthis is no gnuplot\n"),
               IoError);
  EXPECT_EQ(read_file(folder / "loss.png"), before);
  EXPECT_FALSE(std::filesystem::exists(folder / "loss.png.part"));
}

// gnuplot exits with success although its output is truncated, as on a full disk.
TEST_F(PlotFolder, ATruncatedPlotThrowsAndKeepsTheOldImage) {
  draw_plot(folder, "loss", loss_script(rows));
  const std::string before = read_file(folder / "loss.png");
  const std::string cut =
      loss_script(rows) + "unset output\nsystem 'truncate -s 2000 loss.png.part'\n";
  EXPECT_THROW(draw_plot(folder, "loss", cut), IoError);
  EXPECT_EQ(read_file(folder / "loss.png"), before);
  EXPECT_FALSE(std::filesystem::exists(folder / "loss.png.part"));
}

TEST_F(PlotFolder, NamesTheMissingPackage) {
  const std::string path = std::getenv("PATH");
  setenv("PATH", folder.c_str(), 1);  // a folder without gnuplot
  std::string what;
  try {
    draw_plot(folder, "loss", loss_script(rows));
  } catch (const IoError& error) {
    what = error.what();
  }
  setenv("PATH", path.c_str(), 1);
  EXPECT_NE(what.find("gnuplot-nox"), std::string::npos) << what;
}

}  // namespace
}  // namespace redrive
