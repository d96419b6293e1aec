"""The script of the page refocuses views by an exported file alone, where neither PyTorch nor lfref is installed."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from lfref.encoding import SRGB
from lfref.engines.files import file_formats
from lfref.engines.files.manifest import Manifest
from lfref.export import graphs
from tests.export import cases

pytest.importorskip("onnxruntime")
Image = pytest.importorskip("PIL.Image")
PAGE = Path(__file__).parents[2] / "docs" / "deployment.md"
NEEDED = ("numpy", "numpy.libs", "onnxruntime", "PIL", "pillow.libs", "flatbuffers", "google", "packaging")
RUN = "import runpy, sys; sys.path.append(sys.argv.pop(1)); runpy.run_path(sys.argv.pop(1), run_name='__main__')"


@pytest.fixture
def packages(tmp_path):
    """A folder of what the script imports, and of nothing else."""
    installed = Path(importlib.util.find_spec("numpy").origin).parents[1]
    (folder := tmp_path / "packages").mkdir()
    for name in NEEDED:
        if (installed / name).exists():
            (folder / name).symlink_to(installed / name)
    return folder


def test_views_are_refocused_without_pytorch(packages, tmp_path):
    blocks = PAGE.read_text().split("```python\n")[1:]
    script = next(block.partition("```")[0] for block in blocks if "onnxruntime" in block)
    assert sum(bool(line.strip()) for line in script.splitlines()[1:]) <= 16
    (tmp_path / "refocus.py").write_text(script)
    subject = graphs.exportable(cases.operator(interpolation="cubic"), cases.SLOPES, cases.GRID)
    axes = {"inputs": subject.graph.inputs, "output": subject.graph.output}
    manifest = Manifest(**axes, precision="fp32", sha256="", version="1", **subject.manifest_entries)
    file_formats.write(tmp_path / "net.onnx", "onnx", subject.graph, manifest)
    views = (255 * cases.field((40, 52)).views).round().to(torch.uint8)
    (folder := tmp_path / "views").mkdir()
    for place, view in enumerate(views.flatten(0, 1)):
        Image.fromarray(view.permute(1, 2, 0).numpy()).save(folder / f"view_{place:02d}.png")
    command = [sys.executable, "-I", "-S", "-c", RUN, packages, tmp_path / "refocus.py", tmp_path / "net.onnx", folder]
    without = subprocess.run([*command[:4], "import torch"], capture_output=True, text=True)
    assert "No module named 'torch'" in without.stderr
    done = subprocess.run([str(word) for word in command], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    stack = SRGB.encode(
        cases.operator(interpolation="cubic")(SRGB.decode(views / 255), cases.SLOPES.slopes).clamp(0, 1)
    )
    for slope, picture in zip(cases.SLOPES.values, stack, strict=True):
        result = np.asarray(Image.open(tmp_path / f"slope_{slope:g}.png")).transpose(2, 0, 1)
        assert float((torch.tensor(result) - 255 * picture).abs().max()) < 0.51
