"""The programs of the page refocus views by an exported file alone, where neither PyTorch nor lfref is installed."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from lfref.encoding import SRGB
from lfref.engines.files import file_formats
from lfref.export import graphs
from lfref.export.graphs import Samples
from lfref.refocus.separable_wiener import separable_wiener
from lfref.refocuser.refocuser import OperatorRefocuser
from tests.export import cases

pytest.importorskip("onnxruntime")
Image = pytest.importorskip("PIL.Image")
PAGE = Path(__file__).parents[2] / "docs" / "deployment.md"
NEEDED = ("numpy", "numpy.libs", "onnxruntime", "PIL", "pillow.libs", "flatbuffers", "google", "packaging")
RUN = "import runpy, sys; sys.path.append(sys.argv.pop(1)); runpy.run_path(sys.argv.pop(1), run_name='__main__')"
SLOPES = ("-1.5", "0", "0.3")
LONGEST = 25
"""Lines of a program."""


WIENER = OperatorRefocuser("separable_wiener", separable_wiener)


@pytest.fixture(
    scope="module", params=[cases.operator(interpolation="cubic"), pytest.param(WIENER, marks=pytest.mark.slow)]
)
def operator(request):
    return request.param


@pytest.fixture(scope="module")
def model(operator, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "net.onnx"
    subject = graphs.exportable(operator, cases.SLOPES, cases.GRID, Samples("uint8", SRGB))
    file_formats.write(path, "onnx", subject.graph, subject.manifest())
    return path


@pytest.fixture(scope="module")
def views():
    """8-bit samples, [3, 3, 3, 40, 53]."""
    return (255 * cases.field((40, 53)).views).round().to(torch.uint8)


@pytest.fixture(scope="module")
def expected(operator, views):
    """The stack in sRGB."""
    return SRGB.encode(operator(SRGB.decode(views / 255), list(map(float, SLOPES))))


def program(folder, language, start, suffix):
    """A program of the page, written into a folder."""
    blocks = PAGE.read_text("utf-8").split(f"```{language}\n")[1:]
    (text,) = (block.partition("```")[0] for block in blocks if block.startswith(start))
    assert sum(bool(line.strip()) for line in text.splitlines()[1:]) <= LONGEST
    (path := folder / f"refocus{suffix}").write_text(text)
    return path


def done(command, folder, **options):
    result = subprocess.run([str(word) for word in command], cwd=folder, capture_output=True, text=True, **options)
    assert result.returncode == 0, result.stderr
    return result


@pytest.fixture
def packages(tmp_path):
    """A folder of what the script imports, and of nothing else."""
    installed = Path(importlib.util.find_spec("numpy").origin).parents[1]
    (folder := tmp_path / "packages").mkdir()
    for name in NEEDED:
        if (installed / name).exists():
            (folder / name).symlink_to(installed / name)
    return folder


def test_views_are_refocused_without_pytorch(model, views, expected, packages, tmp_path):
    script = program(tmp_path, "python", "# refocus.py ", ".py")
    (folder := tmp_path / "views").mkdir()
    for place, view in enumerate(views.flatten(0, 1)):
        Image.fromarray(view.permute(1, 2, 0).numpy()).save(folder / f"view_{place:02d}.png")
    python = [sys.executable, "-I", "-S", "-c"]
    without = subprocess.run([*python, "import torch"], capture_output=True, text=True)
    assert "No module named 'torch'" in without.stderr
    done([*python, RUN, packages, script, model, folder, *SLOPES], tmp_path)
    for slope, picture in zip(SLOPES, expected.clamp(0, 1), strict=True):
        result = np.asarray(Image.open(tmp_path / f"slope_{slope}.png")).transpose(2, 0, 1)
        assert float((torch.tensor(result) - 255 * picture).abs().max()) < 0.51


def computed(command, model, views, folder, **options):
    """The stack that a program writes as bare numbers."""
    (folder / "views.raw").write_bytes(views.numpy().tobytes())
    done([*command, model, "views.raw", "stack.raw", *views.shape, *SLOPES], folder, **options)
    numbers = np.fromfile(folder / "stack.raw", np.float32)
    return torch.from_numpy(numbers).reshape(len(SLOPES), *views.shape[2:])


def test_cpp_refocuses_views(model, views, expected, tmp_path):
    home = Path(os.environ.get("ORT_HOME", "/usr/local"))
    if shutil.which("g++") is None or not (home / "include" / "onnxruntime_cxx_api.h").is_file():
        pytest.skip("needs g++, and include/onnxruntime_cxx_api.h and lib/libonnxruntime.so in the folder ORT_HOME")
    source = program(tmp_path, "cpp", "// refocus ", ".cpp")
    library = home / "lib"
    done(
        ["g++", "-std=c++17", source, "-I", home / "include", "-L", library, "-lonnxruntime", "-o", "refocus"], tmp_path
    )
    paths = {"env": os.environ | {"LD_LIBRARY_PATH": str(library)}}
    stack = computed([tmp_path / "refocus"], model, views, tmp_path, **paths)
    torch.testing.assert_close(stack, expected, atol=1e-5, rtol=0)


def test_javascript_refocuses_views(model, views, expected, tmp_path):
    modules = Path(os.environ.get("NODE_MODULES", "node_modules"))
    if shutil.which("node") is None or not (modules / "onnxruntime-web").is_dir():
        pytest.skip("needs node, and onnxruntime-web in the folder NODE_MODULES (npm install onnxruntime-web)")
    (tmp_path / "node_modules").symlink_to(modules.resolve())
    script = program(tmp_path, "js", "// refocus.mjs ", ".mjs")
    stack = computed(["node", script], model, views, tmp_path)
    torch.testing.assert_close(stack, expected, atol=1e-5, rtol=0)
