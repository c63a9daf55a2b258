#include "colmap_ext/models/camera_models.h"

#include <map>
#include <memory>
#include <optional>

#include <ceres/jet.h>

#include "colmap_ext/host/camera_models.h"
#include "colmap_ext/host/util.h"
#include "src/residuals/linearization.h"

namespace mfir {
namespace {

// COLMAP's static, templated functions as virtual ones. Derivatives are those
// of ceres::Jet over the ray and the parameters only (2 + kNumParams), much
// cheaper than differentiating pose and point as well.
template <typename ColmapModel>
class ColmapCameraModel final : public CameraModel {
  static_assert(host::CameraModelTraits<ColmapModel>::kNumParams <=
                    kMaxNumIntrinsics,
                "The solver's buffers are too small for this lens model.");

 public:
  const std::string& Name() const override { return ColmapModel::model_name; }
  size_t NumParams() const override { return Traits::kNumParams; }
  const std::vector<size_t>& FocalLengthIdxs() const override {
    return focal_length_idxs_;
  }
  const std::vector<size_t>& PrincipalPointIdxs() const override {
    return principal_point_idxs_;
  }
  const std::vector<size_t>& ExtraParamsIdxs() const override {
    return extra_params_idxs_;
  }

  void Project(const double* params,
               double u,
               double v,
               double* xy) const override {
    Traits::ImgFromCam(params, u, v, &xy[0], &xy[1]);
  }

  void ProjectWithJacobian(const double* params,
                           double u,
                           double v,
                           double* xy,
                           double* jacobian_uv,
                           double* jacobian_params) const override {
    constexpr int kNumParams = Traits::kNumParams;
    using Jet = ceres::Jet<double, 2 + kNumParams>;
    Jet jet_params[kNumParams];
    for (int i = 0; i < kNumParams; ++i) {
      jet_params[i] = Jet(params[i], 2 + i);
    }
    Jet jet_xy[2];
    Traits::ImgFromCam(
        jet_params, Jet(u, 0), Jet(v, 1), &jet_xy[0], &jet_xy[1]);
    for (int row = 0; row < 2; ++row) {
      xy[row] = jet_xy[row].a;
      jacobian_uv[2 * row] = jet_xy[row].v[0];
      jacobian_uv[2 * row + 1] = jet_xy[row].v[1];
      for (int i = 0; i < kNumParams; ++i) {
        jacobian_params[row * kNumParams + i] = jet_xy[row].v[2 + i];
      }
    }
  }

  void Unproject(const double* params,
                 double x,
                 double y,
                 double* uv) const override {
    Traits::CamFromImg(params, x, y, &uv[0], &uv[1]);
  }

 private:
  using Traits = host::CameraModelTraits<ColmapModel>;

  const std::vector<size_t> focal_length_idxs_ = Traits::FocalLengthIdxs();
  const std::vector<size_t> principal_point_idxs_ =
      Traits::PrincipalPointIdxs();
  const std::vector<size_t> extra_params_idxs_ = Traits::ExtraParamsIdxs();
};

// By COLMAP's model identifier.
const std::map<int, std::unique_ptr<CameraModel>>& Models() {
  static const auto& models = *[] {
    auto* models = new std::map<int, std::unique_ptr<CameraModel>>();
    host::VisitCameraModels([models](auto model) {
      using Model = decltype(model);
      models->emplace(host::CameraModelTraits<Model>::kModelId,
                      std::make_unique<ColmapCameraModel<Model>>());
    });
    return models;
  }();
  return models;
}

struct NamedModel {
  int id;
  const char* name;
};

// Of COLMAP 4: 3.8 does not have them, and the last one has no intrinsics.
constexpr NamedModel kLaterModels[] = {{11, "RAD_TAN_THIN_PRISM_FISHEYE"},
                                       {12, "SIMPLE_DIVISION"},
                                       {13, "DIVISION"},
                                       {14, "SIMPLE_FISHEYE"},
                                       {15, "FISHEYE"},
                                       {16, "EUCM"},
                                       {17, "EQUIRECTANGULAR"}};

std::string ReasonAgainst(const NamedModel& model) {
  return "the camera model " + std::string(model.name) +
         (model.id == 17 ? " has no intrinsics that could be refined"
                         : " of COLMAP 4 is not in " + host::VersionInfo() +
                               ", which this program is built with") +
         ". Leave such images out" +
         (model.id == 17 ? "." : ", or build with COLMAP 4.");
}

}  // namespace

const CameraModel* FindCameraModel(int model_id) {
  const auto it = Models().find(model_id);
  return it == Models().end() ? nullptr : it->second.get();
}

const CameraModel* FindCameraModel(const std::string& model_name) {
  for (const auto& id_and_model : Models()) {
    if (id_and_model.second->Name() == model_name) {
      return id_and_model.second.get();
    }
  }
  return nullptr;
}

std::optional<std::string> WhyNotSupported(int model_id) {
  for (const NamedModel& model : kLaterModels) {
    if (model.id == model_id) return ReasonAgainst(model);
  }
  return std::nullopt;
}

std::optional<std::string> WhyNotSupported(const std::string& model_name) {
  for (const NamedModel& model : kLaterModels) {
    if (model.name == model_name) return ReasonAgainst(model);
  }
  return std::nullopt;
}

int CameraModelId(const CameraModel& model) {
  for (const auto& [id, known] : Models()) {
    if (known.get() == &model || known->Name() == model.Name()) return id;
  }
  return -1;
}

std::vector<const CameraModel*> AllCameraModels() {
  std::vector<const CameraModel*> models;
  for (const auto& id_and_model : Models()) {
    models.push_back(id_and_model.second.get());
  }
  return models;
}

std::vector<std::string> CameraParamNames(const CameraModel& model) {
  std::string info;
  host::VisitCameraModels([&](auto colmap_model) {
    using Traits = host::CameraModelTraits<decltype(colmap_model)>;
    if (Traits::kModelId == CameraModelId(model)) info = Traits::ParamsInfo();
  });
  std::vector<std::string> names(1);
  for (const char c : info) {
    if (c == ',') {
      names.emplace_back();
    } else if (c != ' ') {
      names.back() += c;
    }
  }
  return names;
}

}  // namespace mfir
