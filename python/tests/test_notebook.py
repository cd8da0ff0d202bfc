"""The notebook runs from its first cell to its last, and its figures are drawn.

PALPATE_FIGURES names a folder where the figures are kept, to be looked at.
"""

from __future__ import annotations

import base64
import os
import struct
from pathlib import Path

import pytest
from conftest import Service

NOTEBOOK = Path(__file__).parents[1] / "examples" / "from-a-run-to-a-figure.ipynb"


@pytest.mark.filterwarnings("default")
def test_the_notebook_draws_four_figures(
    service: Service, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code), "committed with outputs"
    monkeypatch.setenv("PALPATE_URL", service.url)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in code for output in cell.outputs]
    assert [output.text for output in outputs if output.get("name") == "stderr"] == []
    pictures = [
        base64.b64decode(output.data["image/png"])
        for output in outputs if "image/png" in output.get("data", {})
    ]  # fmt: skip
    assert len(pictures) == 4
    for number, picture in enumerate(pictures, 1):
        width, height = struct.unpack(">II", picture[16:24])
        assert width > 500 and height > 300
        if folder := os.environ.get("PALPATE_FIGURES"):
            Path(folder).mkdir(parents=True, exist_ok=True)
            (Path(folder) / f"figure-{number}.png").write_bytes(picture)
