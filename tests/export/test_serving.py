"""The server of the pages, asked by their client, answers as lfref does, and refuses what its model cannot read."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import numpy as np
import pytest
import torch

import lfref
from lfref.engines.files import file_formats
from lfref.export import graphs
from lfref.export.graphs import Samples
from tests.conftest import ROOT
from tests.export import cases

pytest.importorskip("onnxruntime")
pytest.importorskip("litserve", reason="needs litserve, pip install 'lfref[serve]'")
PAGE = ROOT / "docs" / "deployment.md"
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


OPERATOR = cases.operator(interpolation="cubic")


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Files of a network and of an operator that reads 8-bit samples."""
    folder, paths = tmp_path_factory.mktemp("model"), {}
    for name, refocuser, samples in (
        ("network", cases.network(), graphs.LINEAR),
        ("operator", OPERATOR, Samples("uint8")),
    ):
        subject = graphs.exportable(refocuser, cases.PLANES, cases.GRID, samples)
        paths[name] = folder / f"{name}.onnx"
        file_formats.write(paths[name], "onnx", subject.graph, subject.manifest())
    return paths


@contextlib.contextmanager
def serving(model, folder):
    """Port and process of the server of the page, which has a session of its own."""
    port = free_port()
    command = [sys.executable, str(ROOT / "docs" / "serve.py"), str(model), "--port", str(port)]
    with (folder / "log").open("w") as log:
        server = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log, start_new_session=True)
    try:
        end = time.monotonic() + SECONDS
        while answer(f"http://127.0.0.1:{port}/health")[0] != 200:
            assert server.poll() is None, (folder / "log").read_text()
            assert time.monotonic() < end, (folder / "log").read_text()
            time.sleep(0.2)
        yield port, server
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(server.pid, signal.SIGKILL)
        server.wait()


def of_session(leader):
    """Living processes of the session of a process."""
    listed = subprocess.run(["ps", "-eo", "pid=,sess=,stat="], capture_output=True, text=True, check=True).stdout
    rows = [line.split() for line in listed.splitlines()]
    return [int(pid) for pid, session, state in rows if int(session) == leader and not state.startswith("Z")]


def stack_of(port, folder, *inputs):
    """What the client of the page gets for arrays."""
    paths = [folder / f"input_{place}.npy" for place in range(len(inputs))]
    for path, array in zip(paths, inputs, strict=True):
        np.save(path, array.numpy())
    command = [sys.executable, script(folder, "client.py"), port, *paths, folder / "stack.npy"]
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return torch.from_numpy(np.load(folder / "stack.npy"))


@pytest.mark.slow
def test_a_network_is_served_and_what_it_does_not_read_is_the_clients_mistake(models, tmp_path):
    with serving(models["network"], tmp_path) as (port, _):
        views = torch.stack([field.views for field in (cases.field((40, 52)), cases.field((40, 52), 1))])
        expected = lfref.load(models["network"])(views)
        torch.testing.assert_close(stack_of(port, tmp_path, views), expected, atol=1e-6, rtol=0)
        address = f"http://127.0.0.1:{port}/predict"
        for shape, message in (((1, 2, 3, 3, 20, 20), "Got: 2 Expected: 3"), ((3, 20, 20), "rank")):
            np.save(tmp_path / "views.npy", np.zeros(shape, np.float32))
            status, body = answer(address, (tmp_path / "views.npy").read_bytes())
            assert status == 400
            assert message in body
        assert answer(address, b"no array")[0] == 400
        assert answer(f"http://127.0.0.1:{port}/health")[0] == 200


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ps") is None, reason="needs ps")
def test_an_operator_is_served_one_by_one_and_in_batches_until_sigterm(models, tmp_path):
    with serving(models["operator"], tmp_path) as (port, server):
        views = torch.stack([(255 * cases.field((24, 32), seed).views).round().to(torch.uint8) for seed in range(3)])
        slopes = torch.tensor([0.5, -1.25])
        expected = OPERATOR(views, slopes)
        torch.testing.assert_close(stack_of(port, tmp_path, views, slopes), expected, atol=1e-5, rtol=0)
        torch.testing.assert_close(stack_of(port, tmp_path, views[1], slopes), expected[1], atol=1e-5, rtol=0)
        processes = of_session(server.pid)
        assert len(processes) > 2
        server.send_signal(signal.SIGTERM)
        server.wait(SECONDS)
        end = time.monotonic() + 10
        while of_session(server.pid) and time.monotonic() < end:
            time.sleep(0.2)
        assert of_session(server.pid) == []
