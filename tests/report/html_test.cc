// Text, numbers and pictures of the report.

#include "src/report/html.h"

#include <cmath>

#include <gtest/gtest.h>

#include "src/report/svg.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

TEST(HtmlTest, TextIsEscaped) {
  EXPECT_EQ(EscapeHtml("<b a='1'>\"&amp;\"</b>"),
            "&lt;b a=&#39;1&#39;&gt;&quot;&amp;amp;&quot;&lt;/b&gt;");
  EXPECT_EQ(EscapeHtml("Käm\xc3\xa9ra 左"), "Käm\xc3\xa9ra 左");
  // Names of files need not be UTF-8.
  EXPECT_EQ(EscapeHtml("a\xff"
                       "b"),
            "a\xef\xbf\xbd"
            "b");
}

TEST(HtmlTest, JsonCannotEndTheScript) {
  const std::string text = ScriptJson({{"name", "</script><!--ä"}});
  EXPECT_EQ(text.find('<'), std::string::npos);
  EXPECT_EQ(Json::parse(text)["name"], "</script><!--ä");
}

TEST(HtmlTest, Numbers) {
  EXPECT_EQ(Fixed(1.2345, 2), "1.23");
  EXPECT_EQ(Fixed(-0.001, 2), "0.00");
  EXPECT_EQ(Fixed(-0.5, 1), "-0.5");
  EXPECT_EQ(Fixed(NAN, 2), "&ndash;");
  EXPECT_EQ(Signed(0.25, 1), "+0.2");
  EXPECT_EQ(Signed(-3, 0), "-3");
  EXPECT_EQ(Count(1234567), "1&#8239;234&#8239;567");
  EXPECT_EQ(Count(999), "999");
  EXPECT_EQ(Plural(1, "camera"), "1 camera");
  EXPECT_EQ(Plural(2, "camera"), "2 cameras");
}

TEST(HtmlTest, FieldsAreThoseOfTheSummary) {
  const Json summary = {{"result", {{"rms", 0.12345}, {"none", nullptr}}},
                        {"cameras", {{{"name", "<a>"}}}}};
  EXPECT_EQ(Field(summary, "/result/rms", 2),
            "<data data-field=\"/result/rms\" value=\"0.12345\">0.12</data>");
  EXPECT_EQ(Field(summary, "/result/rms", 1, 100.0),
            "<data data-field=\"/result/rms\" value=\"0.12345\">12.3</data>");
  EXPECT_EQ(Field(summary, "/result/none", 2), "&ndash;");
  EXPECT_EQ(Field(summary, "/result/missing", 2), "&ndash;");
  EXPECT_EQ(TextField(summary, "/cameras/0/name"),
            "<span data-text=\"/cameras/0/name\">&lt;a&gt;</span>");
  EXPECT_TRUE(std::isnan(NumberAt(summary, "/cameras/0/name")));
}

TEST(SvgTest, TicksAreRound) {
  EXPECT_EQ(Ticks(0.0, 1.0, 5),
            (std::vector<double>{0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0}));
  EXPECT_EQ(Ticks(-7.0, 23.0, 4), (std::vector<double>{0.0, 10.0, 20.0}));
  EXPECT_TRUE(Ticks(1.0, 1.0, 5).empty());
  EXPECT_TRUE(Ticks(0.0, NAN, 5).empty());
  EXPECT_EQ(RoundDown(0.07), 0.05);
  EXPECT_EQ(RoundDown(430), 200);
  EXPECT_EQ(TickLabel(0.25, 0.05), "0.25");
  EXPECT_EQ(TickLabel(20, 10), "20");
}

TEST(SvgTest, ArrowsAndCellsSkipWhatIsNotFinite) {
  const std::string path = ArrowPath(
      {{{0, 0}, {10, 0}}, {{0, 0}, {NAN, 1}}, {{5, 5}, {5.5, 5}}}, "arrow");
  EXPECT_EQ(path,
            "<path class=\"arrow\" d=\"M0 0L10 0M6 2L10 0L6 -2M5 5L5.5 5\"/>");
  const std::string cells = CellsSvg({0.0, NAN, 1.0, 1.0}, 2, 0.0, 1.0, 3, 2);
  EXPECT_EQ(cells.find("nan"), std::string::npos);
  EXPECT_EQ(cells,
            "<path fill=\"" + SequentialColor(0.5 / 12) +
                "\" d=\"M0 0h3v2h-3z\"/><path fill=\"" +
                SequentialColor(11.5 / 12) +
                "\" d=\"M0 2h3v2h-3zM3 2h3v2h-3z\"/>");
}

TEST(SvgTest, PlotsPutValuesWhereAxesSay) {
  const Plot plot("t", {"x", 0.0, 10.0}, {"y", 0.01, 1.0, true});
  EXPECT_LT(plot.X(0.0), plot.X(10.0));
  EXPECT_GT(plot.Y(0.01), plot.Y(1.0));  // SVG counts downwards
  EXPECT_NEAR(plot.Y(0.1), 0.5 * (plot.Y(0.01) + plot.Y(1.0)), 1e-9);
  EXPECT_NEAR(plot.X(5.0), 0.5 * (plot.X(0.0) + plot.X(10.0)), 1e-9);
}

}  // namespace
}  // namespace mfir
