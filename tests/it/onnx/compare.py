"""Answers of onnxruntime to the same files and frames (onnx, onnxruntime, numpy).

    python3 tests/it/onnx/compare.py FOLDER

Each NAME.onnx in the folder has frames in NAME.frames and another engine's answers in NAME.answers, raw
little-endian f32. Checks the file by onnx's own rules, and prints a JSON object: for each name the largest
difference and the largest answer.
"""

import json
import sys
from pathlib import Path

import numpy
import onnx
import onnxruntime

found = {}
for path in sorted(Path(sys.argv[1]).glob("*.onnx")):
    onnx.checker.check_model(onnx.load(path), full_check=True)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    (port,) = session.get_inputs()
    frames = numpy.fromfile(path.with_suffix(".frames"), "<f4").reshape(-1, port.shape[1])
    (theirs,) = session.run(None, {port.name: frames})
    ours = numpy.fromfile(path.with_suffix(".answers"), "<f4").reshape(theirs.shape)
    assert numpy.isfinite(theirs).all(), path.name
    found[path.stem] = {
        "difference": float(abs(ours - theirs).max()),
        "largest": float(abs(theirs).max()),
        "shape": list(theirs.shape),
        "input": port.name,
        "output": session.get_outputs()[0].name,
        "metadata": session.get_modelmeta().custom_metadata_map,
    }
print(json.dumps(found))
