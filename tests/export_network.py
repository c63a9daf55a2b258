"""For exported_networks_test: exports a network and computes its descriptors.

    export_network.py NETWORK WEIGHTS INPUT WIDTH HEIGHT OUTPUT.onnx OUTPUT

INPUT: 3 x HEIGHT x WIDTH 32-bit floats, normalized as the network wants it;
OUTPUT: the same with 128 channels, of unit length. WEIGHTS "-": random. Exits with 77 when
PyTorch or its ONNX package is missing.
"""
import pathlib
import sys

try:
    import onnx  # noqa: F401, used by torch.onnx
    import torch
except ImportError as error:
    print(error)
    sys.exit(77)

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "tools"))
import export_onnx  # noqa: E402
import networks  # noqa: E402

name, weights, input_path, width, height, onnx_path, output_path = sys.argv[1:]
network = networks.load(name, None if weights == "-" else weights)
export_onnx.export(network, onnx_path)
values = bytearray(pathlib.Path(input_path).read_bytes())
image = torch.frombuffer(values, dtype=torch.float32).reshape(1, 3, int(height), int(width))
with torch.no_grad():
    output = torch.nn.functional.normalize(network(image), dim=1)
pathlib.Path(output_path).write_bytes(output.numpy().tobytes())
