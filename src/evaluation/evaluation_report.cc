#include <algorithm>
#include <cmath>
#include <iomanip>
#include <nlohmann/json.hpp>
#include <ostream>
#include <sstream>

#include "src/evaluation/evaluation.h"

namespace mfir {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kAxisNames[] = {"fx", "fy", "cx", "cy"};

// JSON has no NaN and no infinity.
Json Number(std::optional<double> value) {
  return value && std::isfinite(*value) ? Json(*value) : Json(nullptr);
}

Json ToJson(const FrameStatistic& statistic) {
  return {{"mean", Number(statistic.mean)},
          {"max", Number(statistic.max)},
          {"min", Number(statistic.min)}};
}

Json ToJson(const ErrorSpread& spread) {
  return {{"median", Number(spread.median)},
          {"p95", Number(spread.p95)},
          {"max", Number(spread.max)}};
}

Json ToJson(const CameraError& camera) {
  Json json = {{"name", camera.name},
               {"model", camera.model},
               {"width", camera.width},
               {"height", camera.height}};
  for (size_t axis = 0; axis < 4; ++axis) {
    json[kAxisNames[axis] + std::string("_error")] =
        Number(camera.error_px(axis));
  }
  for (size_t axis = 0; axis < 4; ++axis) {
    json[kAxisNames[axis] + std::string("_error_permille")] =
        Number(camera.error_permille(axis));
  }
  json["projection_rms_px"] = Number(camera.projection_rms_px);
  return json;
}

Json ToJson(const FrameEvaluation& frame) {
  return {{"name", frame.frame_name},
          {"num_cameras", frame.cameras.size()},
          {"focal_abs", Number(frame.focal_abs)},
          {"focal_rel", Number(frame.focal_rel)},
          {"pp_abs", Number(frame.pp_abs)},
          {"pp_rel", Number(frame.pp_rel)}};
}

// Lines of up to three numbers below a caption.
class Table {
 public:
  explicit Table(std::ostream* stream) : stream_(*stream) {}

  void Header(const std::string& caption,
              const std::vector<std::string>& columns) {
    Label(caption);
    for (const std::string& column : columns) {
      stream_ << std::setw(kColumnWidth) << column;
    }
    stream_ << "\n";
  }

  void Row(const std::string& label,
           const std::vector<std::optional<double>>& values,
           bool with_sign = false) {
    Label("  " + label);
    for (const std::optional<double>& value : values) {
      std::ostringstream text;  // keeps the format flags of stream_
      if (with_sign) text << std::showpos;
      if (value) {
        text << std::fixed << std::setprecision(3) << *value;
      } else {
        text << "-";
      }
      stream_ << std::setw(kColumnWidth) << text.str();
    }
    stream_ << "\n";
  }

  void Metric(const std::string& label,
              const FrameStatistic& statistic,
              bool with_sign = false) {
    Row(label, {statistic.mean, statistic.max, statistic.min}, with_sign);
  }

  void Spread(const std::string& label, const ErrorSpread& spread) {
    Row(label, {spread.median, spread.p95, spread.max});
  }

  void Names(const std::string& caption,
             const std::vector<std::string>& names) {
    if (names.empty()) return;
    stream_ << caption << " (" << names.size() << "):";
    for (const std::string& name : names) {
      stream_ << " " << name;
    }
    stream_ << "\n";
  }

 private:
  static constexpr int kLabelWidth = 30;
  static constexpr int kColumnWidth = 12;

  void Label(const std::string& label) {
    stream_ << label
            << std::string(
                   kLabelWidth - std::min<size_t>(kLabelWidth, label.size()),
                   ' ');
  }

  std::ostream& stream_;
};

}  // namespace

nlohmann::ordered_json EvaluationToJson(const Evaluation& evaluation) {
  Json json;
  json["schema_version"] = 1;
  json["focal_abs"] = ToJson(evaluation.focal_abs);
  json["focal_rel"] = ToJson(evaluation.focal_rel);
  json["pp_abs"] = ToJson(evaluation.pp_abs);
  json["pp_rel"] = ToJson(evaluation.pp_rel);
  for (size_t axis = 0; axis < 4; ++axis) {
    Json& axis_json = json["per_axis"][kAxisNames[axis]];
    axis_json["px"] = ToJson(evaluation.spread_px[axis]);
    if (axis < evaluation.spread_permille.size()) {
      axis_json["permille"] = ToJson(evaluation.spread_permille[axis]);
    }
  }
  json["common"] = {{"focal_scale_permille", ToJson(evaluation.focal_scale)},
                    {"pp_shift_x_px", ToJson(evaluation.pp_shift_x)},
                    {"pp_shift_y_px", ToJson(evaluation.pp_shift_y)}};
  json["rest"] = {{"focal_rel", ToJson(evaluation.rest_focal_rel)},
                  {"pp_abs", ToJson(evaluation.rest_pp_abs)}};
  json["projection_rms_px"] = {
      {"mean", Number(evaluation.projection_rms_mean_px)},
      {"max", Number(evaluation.projection_rms_max_px)}};
  json["num_cameras"] = evaluation.num_cameras;
  json["num_frames"] = evaluation.frames.size();
  json["missing_cameras"] = evaluation.missing_cameras;
  json["extra_cameras"] = evaluation.extra_cameras;
  json["skipped_frames"] = evaluation.skipped_frames;
  json["cameras"] = Json::array();
  json["frames"] = Json::array();
  if (evaluation.frames.size() == 1) {
    for (const CameraError& camera : evaluation.frames[0].cameras) {
      json["cameras"].push_back(ToJson(camera));
    }
  } else {
    for (const FrameEvaluation& frame : evaluation.frames) {
      json["frames"].push_back(ToJson(frame));
    }
  }
  return json;
}

void PrintEvaluation(const Evaluation& evaluation, std::ostream& stream) {
  const bool per_frame = evaluation.frames.size() > 1;
  stream << "Evaluated " << evaluation.num_cameras << " of "
         << evaluation.num_cameras + evaluation.missing_cameras.size()
         << " cameras of the ground truth, "
         << (per_frame ? std::to_string(evaluation.frames.size()) + " frames"
                       : "one estimate")
         << "\n\n";
  Table table(&stream);
  table.Header("Sum of both axes", {"mean", "max", "min"});
  table.Metric("focal_abs [px]", evaluation.focal_abs);
  table.Metric("focal_rel [permille]", evaluation.focal_rel);
  table.Metric("pp_abs    [px]", evaluation.pp_abs);
  table.Metric("pp_rel    [permille]", evaluation.pp_rel);
  table.Header("Common to all cameras", {});
  table.Metric("focal scale [permille]", evaluation.focal_scale, true);
  table.Metric("pp shift x  [px]", evaluation.pp_shift_x, true);
  table.Metric("pp shift y  [px]", evaluation.pp_shift_y, true);
  table.Header("Rest, common part removed", {});
  table.Metric("focal_rel [permille]", evaluation.rest_focal_rel);
  table.Metric("pp_abs    [px]", evaluation.rest_pp_abs);
  stream << "\n";
  table.Header("Absolute, per camera", {"median", "p95", "max"});
  for (size_t axis = 0; axis < 4; ++axis) {
    table.Spread(kAxisNames[axis] + std::string(" [px]"),
                 evaluation.spread_px[axis]);
  }
  for (size_t axis = 0; axis < evaluation.spread_permille.size(); ++axis) {
    table.Spread(kAxisNames[axis] + std::string(" [permille]"),
                 evaluation.spread_permille[axis]);
  }
  stream << "\n";
  table.Header("Whole lens model", {"mean", "max"});
  table.Row(
      "projection rms [px]",
      {evaluation.projection_rms_mean_px, evaluation.projection_rms_max_px});
  table.Names("Cameras of the ground truth without estimate",
              evaluation.missing_cameras);
  table.Names("Cameras without ground truth, left out",
              evaluation.extra_cameras);
  table.Names("Frames without a known camera, left out",
              evaluation.skipped_frames);
  stream << std::flush;
}

}  // namespace mfir
