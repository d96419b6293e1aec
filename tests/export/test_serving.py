"""The server and the client of the page answer with what lfref makes of a file, and refuse what it cannot read."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
import torch

import lfref
from lfref.engines.files import file_formats
from lfref.engines.files.manifest import Manifest
from lfref.export import graphs
from tests.export import cases

pytest.importorskip("onnxruntime")
pytest.importorskip("litserve", reason="needs litserve, pip install 'lfref[serve]'")
PAGE = Path(__file__).parents[2] / "docs" / "deployment.md"
SECONDS = 120


def script(folder, name):
    """A script of the page, written into a folder."""
    blocks = PAGE.read_text("utf-8").split("```python\n")[1:]
    (text,) = (block.partition("```")[0] for block in blocks if block.startswith(f"# {name} "))
    (folder / name).write_text(text)
    return folder / name


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def answer(address, body=None):
    """Status and text of what a server says."""
    request = urllib.request.Request(address, body, {"Content-Type": "application/octet-stream"})
    try:
        with urllib.request.urlopen(request, timeout=SECONDS) as got:
            return got.status, got.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()
    except urllib.error.URLError:
        return None, ""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    subject = graphs.exportable(cases.network(), cases.PLANES, cases.GRID)
    axes = {"inputs": subject.graph.inputs, "output": subject.graph.output}
    manifest = Manifest(**axes, precision="fp32", sha256="", version="1", **subject.manifest_entries)
    file_formats.write(path := tmp_path_factory.mktemp("model") / "net.onnx", "onnx", subject.graph, manifest)
    return path


@pytest.fixture(scope="module")
def port(model, tmp_path_factory):
    """Where the server of the page listens, as long as the tests run."""
    folder, port = tmp_path_factory.mktemp("server"), free_port()
    command = [sys.executable, str(script(folder, "serve.py")), str(model), str(port)]
    with (folder / "log").open("w") as log:
        server = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log, start_new_session=True)
    try:
        end = time.monotonic() + SECONDS
        while answer(f"http://127.0.0.1:{port}/health")[0] != 200:
            assert server.poll() is None, (folder / "log").read_text()
            assert time.monotonic() < end, (folder / "log").read_text()
            time.sleep(0.2)
        yield port
    finally:
        os.killpg(server.pid, signal.SIGKILL)
        server.wait()


@pytest.mark.slow
def test_a_client_gets_what_lfref_makes_of_the_file(model, port, tmp_path):
    views = torch.stack([field.views for field in (cases.field((40, 52)), cases.field((40, 52), 1))])
    np.save(tmp_path / "views.npy", views.numpy())
    command = [sys.executable, script(tmp_path, "client.py"), port, tmp_path / "views.npy", tmp_path / "stack.npy"]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    stack = torch.from_numpy(np.load(tmp_path / "stack.npy"))
    torch.testing.assert_close(stack, lfref.load(model)(views), atol=1e-6, rtol=0)


@pytest.mark.slow
def test_what_the_model_does_not_read_is_the_clients_mistake(port, tmp_path):
    address = f"http://127.0.0.1:{port}/predict"
    for shape, message in (((1, 2, 3, 3, 20, 20), "Got: 2 Expected: 3"), ((3, 20, 20), "rank")):
        np.save(tmp_path / "views.npy", np.zeros(shape, np.float32))
        status, body = answer(address, (tmp_path / "views.npy").read_bytes())
        assert status == 400
        assert message in body
    assert answer(address, b"no array")[0] == 400
    assert answer(f"http://127.0.0.1:{port}/health")[0] == 200
