// Pictures as SVG: small, static, and as sharp in print as on the screen.

#pragma once

#include <string>
#include <utility>
#include <vector>

#include <Eigen/Core>

namespace mfir {

// "#rrggbb" between dark blue (0) and yellow (1), also for the colour-blind
// (viridis).
std::string SequentialColor(double share);

// Coordinates and lengths in SVG, a tenth of a unit.
std::string Coordinate(double value);

// Round values between `low` and `high`, at most about `count`.
std::vector<double> Ticks(double low, double high, int count);

// A tick's value with the decimals that tell it from the next.
std::string TickLabel(double value, double step);

// 1, 2 or 5 times a power of ten, at most `value`.
double RoundDown(double value);

// <svg> of width x height units around `content`; `title` is what a screen
// reader says.
std::string Svg(double width,
                double height,
                const std::string& title,
                const std::string& content);

// Lines with an arrow head each, as one path. From `from` to `to`.
struct Arrow {
  Eigen::Vector2d from;
  Eigen::Vector2d to;
};
std::string ArrowPath(const std::vector<Arrow>& arrows,
                      const std::string& css_class);

// A diagram with two axes.
class Plot {
 public:
  struct Axis {
    std::string label;
    double low = 0.0;
    double high = 1.0;
    bool is_log = false;
  };

  Plot(const std::string& title, const Axis& x, const Axis& y);

  // Of a value on the axis, in SVG units.
  double X(double value) const;
  double Y(double value) const;

  void AddLine(const std::vector<Eigen::Vector2d>& points,
               const std::string& css_class);
  // From the lower edge of the diagram.
  void AddBar(double x_begin, double x_end, double y, const std::string& css);
  // A dot with a label in its tooltip, and next to it if `show_label`. The
  // label is text, not HTML.
  void AddDot(const Eigen::Vector2d& point,
              const std::string& css_class,
              const std::string& label,
              bool show_label = false);
  // Vertical error bar of half length `error` around a point.
  void AddErrorBar(const Eigen::Vector2d& point, double error);
  // Line of the legend.
  void AddLegend(const std::string& text, const std::string& css_class);
  // The x axis has no numbers.
  void HideXTicks() { hide_x_ticks_ = true; }

  std::string ToSvg() const;

 private:
  std::string AxesSvg() const;

  const std::string title_;
  const Axis x_;
  const Axis y_;
  bool hide_x_ticks_ = false;
  std::string content_;
  std::vector<std::pair<std::string, std::string>> legend_;
};

// A grid of cells that are coloured by value: `columns` x `rows`, row by row,
// not finite: no cell. In one path per colour, 12 of them, from `low` to
// `high`.
std::string CellsSvg(const std::vector<double>& values,
                     int columns,
                     double low,
                     double high,
                     double cell_width,
                     double cell_height);

// The colours of CellsSvg with the values at both ends, as HTML.
std::string ColorScale(const std::string& low, const std::string& high);

}  // namespace mfir
