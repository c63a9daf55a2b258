#!/usr/bin/python3
"""Export a network to ONNX, for --MultiFrame.dense_features onnx.

    tools/export_onnx.py s2dnet|alike|r2d2 [--weights FILE] --output FILE.onnx

Prints the options that the network needs. The map has the resolution of the
image and 128 channels. Without --weights (s2dnet only) the weights
are random, for tests.

  s2dnet  fine level of S2DNet: checkpoint of github.com/germain-hug/S2DNet-Minimal
  alike   ALIKE-n: alike-n.pth of github.com/Shiaoming/ALIKE
  r2d2    R2D2 WASF N16: r2d2_WASF_N16.pt of github.com/naver/r2d2

Needs the Debian packages python3-torch and python3-onnx. Checkpoints are read by
pickle, which can run code: take them from their authors only.
"""
import argparse
import pathlib
import sys
import warnings

import torch

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import networks  # noqa: E402


def export(network, path):
    with warnings.catch_warnings():
        # About types that PyTorch 1.13 cannot infer; nothing depends on them.
        warnings.simplefilter("ignore", UserWarning)
        torch.onnx.export(
            network, torch.zeros(1, 3, 128, 128), path, opset_version=11,
            input_names=["image"], output_names=["descriptors"],
            dynamic_axes={"image": {2: "height", 3: "width"},
                          "descriptors": {2: "height", 3: "width"}})


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network", choices=sorted(networks.NETWORKS))
    parser.add_argument("--weights")
    parser.add_argument("--output", required=True)
    arguments = parser.parse_args()
    entry = networks.NETWORKS[arguments.network]
    try:
        network = networks.load(arguments.network, arguments.weights)
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")
    export(network, arguments.output)
    options = {"dense_features": "onnx", "onnx_path": arguments.output, **entry.options}
    print(" ".join(f"--MultiFrame.{name} {value}" for name, value in options.items()))


if __name__ == "__main__":
    main()
