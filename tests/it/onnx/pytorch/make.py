"""Writes the files of this folder, which stand for a model that a person trained in PyTorch.

    python3 tests/it/onnx/pytorch/make.py FOLDER        (torch 2.15, onnxscript)

One module, exported by both of PyTorch's exporters with an open batch; frames, and PyTorch's own answers to
them, raw little-endian f32.
"""

import sys
from pathlib import Path

import onnx
import torch
from torch import nn


class Skin(nn.Module):
    """20 channels to a map of 8 x 8, with what a person would write: norms, views, an odd batch norm."""

    def __init__(self):
        super().__init__()
        self.first = nn.Sequential(nn.Linear(21, 24), nn.GELU(), nn.Linear(24, 32), nn.LayerNorm(32))
        self.images = nn.Sequential(
            nn.BatchNorm2d(8),
            nn.ReLU(),
            nn.ConvTranspose2d(8, 4, 4, stride=2, padding=1),
            nn.LeakyReLU(0.1),
            nn.Conv2d(4, 4, 3, padding=1),
            nn.PixelShuffle(2),
        )

    def forward(self, voltages):
        size = torch.linalg.vector_norm(voltages, dim=1, keepdim=True).clamp(min=1e-4)
        features = self.first(torch.cat([voltages / size, size.log() * 0.1], dim=1))
        images = self.images(features.view(features.shape[0], 8, 2, 2))
        return nn.functional.softplus(images.squeeze(1)) * size[:, :, None]


def main(folder: Path) -> None:
    torch.manual_seed(1)
    net = Skin()
    for _ in range(20):  # moments for the batch norm
        net(torch.randn(32, 20) * 0.05)
    net.eval()
    frames = torch.randn(11, 20) * torch.logspace(-4, 0, 11)[:, None]
    names = {"input_names": ["voltages_v"], "output_names": ["force_map_n"]}
    batch = torch.export.Dim("batch", min=1, max=4096)
    torch.onnx.export(
        net, (frames[:2],), folder / "dynamo.onnx", dynamo=True, external_data=False,
        dynamic_shapes=[{0: batch}], **names,
    )
    torch.onnx.export(
        net, (frames[:2],), folder / "torchscript.onnx", dynamo=False, opset_version=17,
        dynamic_axes={"voltages_v": {0: "batch"}, "force_map_n": {0: "batch"}}, **names,
    )
    model = onnx.load(folder / "dynamo.onnx")
    graph = model.graph
    for part in [*graph.node, *graph.input, *graph.output, *graph.initializer, *graph.value_info]:
        del part.metadata_props[:]  # where in whose source code, on whose machine
    onnx.save(model, folder / "dynamo.onnx")
    frames.numpy().astype("<f4").tofile(folder / "frames.f32")
    with torch.no_grad():
        net(frames).numpy().astype("<f4").tofile(folder / "answers.f32")


main(Path(sys.argv[1]))
