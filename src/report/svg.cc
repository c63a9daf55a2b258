#include "src/report/svg.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include "src/report/html.h"

namespace mfir {
namespace {

constexpr int kNumColors = 12;

// Of a diagram, in SVG units.
constexpr double kWidth = 420.0;
constexpr double kHeight = 240.0;
constexpr double kLeft = 52.0;
constexpr double kRight = 12.0;
constexpr double kTop = 14.0;
constexpr double kBottom = 40.0;

std::string Attributes(
    const std::vector<std::pair<std::string, double>>& values) {
  std::string text;
  for (const auto& name_and_value : values) {
    text += " " + name_and_value.first + "=\"" +
            Coordinate(name_and_value.second) + "\"";
  }
  return text;
}

std::string LineSvg(double x1, double y1, double x2, double y2, const char* c) {
  return "<line" +
         Attributes({{"x1", x1}, {"y1", y1}, {"x2", x2}, {"y2", y2}}) +
         " class=\"" + c + "\"/>";
}

std::string TextSvg(double x,
                    double y,
                    const std::string& anchor,
                    const std::string& text) {
  return "<text" + Attributes({{"x", x}, {"y", y}}) + " text-anchor=\"" +
         anchor + "\">" + text + "</text>";
}

std::vector<double> AxisTicks(const Plot::Axis& axis, int count) {
  if (!axis.is_log) return Ticks(axis.low, axis.high, count);
  std::vector<double> ticks;
  const int first = static_cast<int>(std::ceil(std::log10(axis.low) - 1e-9));
  const int last = static_cast<int>(std::floor(std::log10(axis.high) + 1e-9));
  const int step = std::max(1, (last - first + count) / count);
  for (int i = first; i <= last; i += step) ticks.push_back(std::pow(10.0, i));
  return ticks;
}

std::string AxisTickLabel(const Plot::Axis& axis,
                          const std::vector<double>& ticks,
                          double value) {
  if (!axis.is_log) {
    return TickLabel(value, ticks.size() > 1 ? ticks[1] - ticks[0] : value);
  }
  const int exponent = static_cast<int>(std::lround(std::log10(value)));
  if (exponent >= -3 && exponent <= 4) {
    return Fixed(value, std::max(0, -exponent));
  }
  char text[16];
  std::snprintf(text, sizeof(text), "1e%d", exponent);
  return text;
}

double AxisShare(const Plot::Axis& axis, double value) {
  if (!axis.is_log) return (value - axis.low) / (axis.high - axis.low);
  return std::log(std::max(value, axis.low) / axis.low) /
         std::log(axis.high / axis.low);
}

}  // namespace

std::string SequentialColor(double share) {
  static const std::array<std::array<double, 3>, 6> kColors = {
      {{68, 1, 84},
       {65, 68, 135},
       {42, 120, 142},
       {34, 168, 132},
       {122, 209, 81},
       {253, 231, 37}}};
  const double position =
      std::clamp(share, 0.0, 1.0) * static_cast<double>(kColors.size() - 1);
  const size_t i = std::min(static_cast<size_t>(position), kColors.size() - 2);
  const double fraction = position - static_cast<double>(i);
  std::string color = "#";
  for (size_t channel = 0; channel < 3; ++channel) {
    char text[8];
    std::snprintf(
        text,
        sizeof(text),
        "%02x",
        static_cast<unsigned>(std::lround(
            kColors[i][channel] +
            fraction * (kColors[i + 1][channel] - kColors[i][channel]))));
    color += text;
  }
  return color;
}

std::string Coordinate(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.1f", value);
  std::string coordinate = text;
  if (coordinate.size() > 2 &&
      coordinate.compare(coordinate.size() - 2, 2, ".0") == 0) {
    coordinate.resize(coordinate.size() - 2);
  }
  return coordinate == "-0" ? "0" : coordinate;
}

double RoundDown(double value) {
  if (!(value > 0.0) || !std::isfinite(value)) return 1.0;
  const double power = std::pow(10.0, std::floor(std::log10(value)));
  const double mantissa = value / power;
  return power * (mantissa >= 5.0 ? 5.0 : mantissa >= 2.0 ? 2.0 : 1.0);
}

std::vector<double> Ticks(double low, double high, int count) {
  std::vector<double> ticks;
  if (!(high > low) || !std::isfinite(high - low)) return ticks;
  double step = RoundDown((high - low) / count);
  while ((high - low) / step > count + 0.5) {
    step = RoundDown(step * 2.51);
  }
  const double first = std::ceil(low / step - 1e-9);
  const double last = std::floor(high / step + 1e-9);
  for (int i = 0; first + i <= last; ++i) ticks.push_back((first + i) * step);
  return ticks;
}

std::string TickLabel(double value, double step) {
  const int digits = std::clamp(
      static_cast<int>(std::ceil(-std::log10(std::abs(step)) - 1e-9)), 0, 9);
  return Fixed(value, digits);
}

std::string Svg(double width,
                double height,
                const std::string& title,
                const std::string& content) {
  return "<svg viewBox=\"0 0 " + Coordinate(width) + " " + Coordinate(height) +
         "\" role=\"img\" aria-label=\"" + EscapeHtml(title) + "\">" + content +
         "</svg>";
}

std::string ArrowPath(const std::vector<Arrow>& arrows,
                      const std::string& css_class) {
  std::string path;
  const auto add = [&](char command, const Eigen::Vector2d& point) {
    path += command + Coordinate(point.x()) + " " + Coordinate(point.y());
  };
  for (const Arrow& arrow : arrows) {
    const Eigen::Vector2d shaft = arrow.to - arrow.from;
    const double length = shaft.norm();
    if (!std::isfinite(length)) continue;
    add('M', arrow.from);
    add('L', arrow.to);
    if (length < 1.0) continue;
    const Eigen::Vector2d back = shaft / length * std::min(4.0, 0.4 * length);
    const Eigen::Vector2d side(-0.5 * back.y(), 0.5 * back.x());
    add('M', arrow.to - back + side);
    add('L', arrow.to);
    add('L', arrow.to - back - side);
  }
  return "<path class=\"" + css_class + "\" d=\"" + path + "\"/>";
}

Plot::Plot(const std::string& title, const Axis& x, const Axis& y)
    : title_(title), x_(x), y_(y) {}

double Plot::X(double value) const {
  return kLeft + (kWidth - kLeft - kRight) * AxisShare(x_, value);
}

double Plot::Y(double value) const {
  return kHeight - kBottom - (kHeight - kTop - kBottom) * AxisShare(y_, value);
}

void Plot::AddLine(const std::vector<Eigen::Vector2d>& points,
                   const std::string& css_class) {
  std::string coordinates;
  for (const Eigen::Vector2d& point : points) {
    if (!point.allFinite()) continue;
    coordinates += Coordinate(X(point.x())) + "," +
                   Coordinate(std::clamp(
                       Y(point.y()), kTop - 1.0, kHeight - kBottom + 1.0)) +
                   " ";
  }
  content_ += "<polyline class=\"line " + css_class + "\" points=\"" +
              coordinates + "\"/>";
}

void Plot::AddBar(double x_begin,
                  double x_end,
                  double y,
                  const std::string& css) {
  if (!std::isfinite(y)) return;
  const double top = std::min(Y(y), kHeight - kBottom);
  content_ += "<rect class=\"" + css + "\"" +
              Attributes({{"x", X(x_begin)},
                          {"y", top},
                          {"width", std::max(0.5, X(x_end) - X(x_begin) - 0.6)},
                          {"height", kHeight - kBottom - top}}) +
              "/>";
}

void Plot::AddDot(const Eigen::Vector2d& point,
                  const std::string& css_class,
                  const std::string& label,
                  bool show_label) {
  if (!point.allFinite()) return;
  const double x = X(point.x());
  const double y = Y(point.y());
  content_ += "<circle class=\"dot " + css_class + "\"" +
              Attributes({{"cx", x}, {"cy", y}, {"r", 3.2}}) + "><title>" +
              EscapeHtml(label) + "</title></circle>";
  if (!show_label) return;
  const bool left = x > 0.75 * kWidth;
  content_ += TextSvg(
      left ? x - 6 : x + 6, y - 4, left ? "end" : "start", EscapeHtml(label));
}

void Plot::AddErrorBar(const Eigen::Vector2d& point, double error) {
  if (!point.allFinite() || !std::isfinite(error)) return;
  content_ += LineSvg(X(point.x()),
                      std::min(Y(point.y() - error), kHeight - kBottom),
                      X(point.x()),
                      std::max(Y(point.y() + error), kTop),
                      "error");
}

void Plot::AddLegend(const std::string& text, const std::string& css_class) {
  legend_.push_back({text, css_class});
}

std::string Plot::AxesSvg() const {
  const double bottom = kHeight - kBottom;
  std::string axes;
  const std::vector<double> x_ticks = AxisTicks(x_, 7);
  for (const double tick : x_ticks) {
    if (hide_x_ticks_) break;
    axes +=
        LineSvg(X(tick), kTop, X(tick), bottom, "grid") +
        TextSvg(
            X(tick), bottom + 14, "middle", AxisTickLabel(x_, x_ticks, tick));
  }
  const std::vector<double> y_ticks = AxisTicks(y_, 5);
  for (const double tick : y_ticks) {
    const bool is_zero = tick == 0.0;
    axes +=
        LineSvg(kLeft,
                Y(tick),
                kWidth - kRight,
                Y(tick),
                is_zero ? "axis" : "grid") +
        TextSvg(
            kLeft - 5, Y(tick) + 4, "end", AxisTickLabel(y_, y_ticks, tick));
  }
  axes += LineSvg(kLeft, bottom, kWidth - kRight, bottom, "axis");
  axes +=
      "<g class=\"label\">" +
      TextSvg(
          0.5 * (kLeft + kWidth - kRight), kHeight - 6, "middle", x_.label) +
      "<text transform=\"translate(11 " + Coordinate(0.5 * (kTop + bottom)) +
      ") rotate(-90)\" text-anchor=\"middle\">" + y_.label + "</text></g>";
  return axes;
}

std::string Plot::ToSvg() const {
  std::string legend;
  for (size_t i = 0; i < legend_.size(); ++i) {
    const double y = kTop + 8.0 + 14.0 * static_cast<double>(i);
    legend += "<line class=\"line " + legend_[i].second + "\"" +
              Attributes({{"x1", kWidth - 40},
                          {"y1", y},
                          {"x2", kWidth - kRight - 6},
                          {"y2", y}}) +
              "/>" + TextSvg(kWidth - 45, y + 4, "end", legend_[i].first);
  }
  return Svg(kWidth, kHeight, title_, AxesSvg() + content_ + legend);
}

std::string CellsSvg(const std::vector<double>& values,
                     int columns,
                     double low,
                     double high,
                     double cell_width,
                     double cell_height) {
  std::array<std::string, kNumColors> paths;
  for (size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) continue;
    const double share = high > low ? (values[i] - low) / (high - low) : 0.0;
    const int color =
        std::clamp(static_cast<int>(share * kNumColors), 0, kNumColors - 1);
    const double x = static_cast<double>(i % static_cast<size_t>(columns));
    const double y = static_cast<double>(i / static_cast<size_t>(columns));
    paths[static_cast<size_t>(color)] +=
        "M" + Coordinate(x * cell_width) + " " + Coordinate(y * cell_height) +
        "h" + Coordinate(cell_width) + "v" + Coordinate(cell_height) + "h-" +
        Coordinate(cell_width) + "z";
  }
  std::string svg;
  for (int color = 0; color < kNumColors; ++color) {
    const std::string& path = paths[static_cast<size_t>(color)];
    if (path.empty()) continue;
    svg += "<path fill=\"" + SequentialColor((color + 0.5) / kNumColors) +
           "\" d=\"" + path + "\"/>";
  }
  return svg;
}

std::string ColorScale(const std::string& low, const std::string& high) {
  return "<span class=\"scale\">" + low + " <i class=\"viridis\"></i> " + high +
         "</span>";
}

}  // namespace mfir
