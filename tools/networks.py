"""Networks whose dense descriptors can be exported, see export_onnx.py.

All take a 1 x 3 x H x W image (RGB, normalized as the options say) and give a
1 x 128 x H x W map of descriptors. The networks end with a normalization of the
descriptors to unit length, which is left to the option onnx_l2_normalize:
PyTorch exports it by operators that OpenCV 4.6 runs for one image size only.
"""
import dataclasses
import typing

import torch
from torch import nn

IMAGENET = {"onnx_mean": "0.485,0.456,0.406", "onnx_std": "0.229,0.224,0.225"}


class S2DNetFine(nn.Module):
    """Fine level of S2DNet (Germain et al., "S2DNet: Learning Image Features
    for Accurate Sparse-to-Dense Matching", 2020): the first two convolutions of
    VGG16 with their ReLUs, then the adaptation layer."""

    def __init__(self):
        super().__init__()
        self.encoder = nn.Sequential(
            nn.Conv2d(3, 64, 3, padding=1), nn.ReLU(),
            nn.Conv2d(64, 64, 3, padding=1), nn.ReLU())
        self.adaptation = nn.Sequential(
            nn.Conv2d(64, 64, 1), nn.ReLU(),
            nn.Conv2d(64, 128, 5, padding=2), nn.BatchNorm2d(128))

    def forward(self, image):
        return self.adaptation(self.encoder(image))


class AlikeBlock(nn.Module):
    """Two convolutions; with `shortcut`, a 1 x 1 convolution around them."""

    def __init__(self, num_inputs, num_outputs, shortcut):
        super().__init__()
        self.conv1 = nn.Conv2d(num_inputs, num_outputs, 3, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(num_outputs)
        self.conv2 = nn.Conv2d(num_outputs, num_outputs, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(num_outputs)
        if shortcut:
            self.downsample = nn.Conv2d(num_inputs, num_outputs, 1)

    def forward(self, x):
        y = self.bn2(self.conv2(torch.relu(self.bn1(self.conv1(x)))))
        return torch.relu(y + self.downsample(x) if hasattr(self, "downsample") else y)


class AlikeN(nn.Module):
    """ALIKE-n (Zhao et al., "ALIKE: Accurate and Lightweight Keypoint Detection
    and Descriptor Extraction", 2022), names of layers as in its checkpoint.
    Coarse maps are upsampled with aligned corners, as it was trained: their
    place depends a little on the size of the input."""

    SCALES = (1, 2, 8, 32)

    def __init__(self):
        super().__init__()
        channels = (3, 16, 32, 64, 128)
        for i in range(4):
            setattr(self, f"block{i + 1}", AlikeBlock(channels[i], channels[i + 1], i > 0))
            setattr(self, f"conv{i + 1}", nn.Conv2d(channels[i + 1], 32, 1, bias=False))
        # 128 descriptor channels and the score of keypoints.
        self.convhead2 = nn.Conv2d(128, 129, 1, bias=False)

    def forward(self, x):
        maps = []
        for i, scale in enumerate(self.SCALES):
            if i > 0:
                pool = scale // self.SCALES[i - 1]
                x = nn.functional.max_pool2d(x, pool)
            x = getattr(self, f"block{i + 1}")(x)
            y = torch.relu(getattr(self, f"conv{i + 1}")(x))
            if scale > 1:
                y = nn.functional.interpolate(
                    y, scale_factor=scale, mode="bilinear", align_corners=True)
            maps.append(y)
        return self.convhead2(torch.cat(maps, dim=1))[:, :-1]


class R2D2(nn.Module):
    """R2D2 with the descriptor of Quad L2-Net (Revaud et al., "R2D2: Reliable
    and Repeatable Detector and Descriptor", 2019), every stride replaced by
    dilation. Layers are numbered as in its checkpoint."""

    # Output channels, kernel, dilation, ReLU after the batch normalization.
    LAYERS = ((32, 3, 1, True), (32, 3, 1, True), (64, 3, 1, True), (64, 3, 2, True),
              (128, 3, 2, True), (128, 3, 4, True), (128, 2, 4, False), (128, 2, 8, False),
              (128, 2, 16, None))

    def __init__(self):
        super().__init__()
        layers = []
        num_inputs = 3
        for num_outputs, kernel, dilation, relu in self.LAYERS:
            layers.append(nn.Conv2d(num_inputs, num_outputs, kernel,
                                    padding=(kernel - 1) * dilation // 2, dilation=dilation))
            if relu is not None:
                layers.append(nn.BatchNorm2d(num_outputs, affine=False))
            if relu:
                layers.append(nn.ReLU())
            num_inputs = num_outputs
        self.ops = nn.Sequential(*layers)

    def forward(self, image):
        return self.ops(image)


def s2dnet_state(checkpoint):
    """The checkpoint holds VGG16 and one adaptation layer per level."""
    layers = {"encoder.0": "encoder.0", "encoder.2": "encoder.2",
              "adaptation_layers.adap_layer_0.0": "adaptation.0",
              "adaptation_layers.adap_layer_0.2": "adaptation.2",
              "adaptation_layers.adap_layer_0.3": "adaptation.3"}
    state = {}
    for name, value in checkpoint["state_dict"].items():
        layer, _, parameter = name.rpartition(".")
        if layer in layers:
            state[f"{layers[layer]}.{parameter}"] = value
    return state


def r2d2_state(checkpoint):
    return {name.replace("module.", "", 1): value
            for name, value in checkpoint["state_dict"].items() if ".ops." in name}


@dataclasses.dataclass
class Network:
    module: type
    state: typing.Callable
    options: dict


NETWORKS = {
    "s2dnet": Network(S2DNetFine, s2dnet_state,
                      {**IMAGENET, "onnx_tile_overlap": 4, "onnx_tile_alignment": 1}),
    "alike": Network(AlikeN, lambda checkpoint: checkpoint, {"onnx_tile_overlap": 160}),
    "r2d2": Network(R2D2, r2d2_state,
                    {**IMAGENET, "onnx_tile_overlap": 25, "onnx_tile_alignment": 1}),
}


def load(name, weights):
    """The network in evaluation mode. ValueError if the weights are not its."""
    network = NETWORKS[name].module()
    if weights is None:
        if name != "s2dnet":
            raise ValueError(f"{name} needs --weights")
        torch.manual_seed(0)
        for module in network.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.running_mean.normal_()
                module.running_var.uniform_(0.5, 2.0)
        return network.eval()
    checkpoint = torch.load(weights, map_location="cpu")
    try:
        network.load_state_dict(NETWORKS[name].state(checkpoint))
    except (AttributeError, KeyError, RuntimeError) as error:
        raise ValueError(f"{weights} does not hold the weights of {name}: {error}") from error
    return network.eval()
