"""Every engine computes what eager float32 computes, to what its precision allows; what is missing is told."""

import copy
import subprocess
import sys

import pytest
import torch

from lfref.engines import engine as engines
from lfref.engines import runtimes
from lfref.engines.engine import EngineWorkload, Preparation
from lfref.engines.runtimes import ENGINES
from lfref.errors import InputError
from tests.engines import cases

CPU = torch.device("cpu")
EVERY = [
    pytest.param(engine, precision, marks=[pytest.mark.gpu] if engine == "cuda_graphs" else [])
    for engine, ways in ENGINES.items()
    for precision in ways
]
ALLOWED = {"fp32": 1e-5, "bf16": 0.1, "int8": 0.3}
"""Root mean square of what changes, beside the standard deviation of what the network adds or draws."""


def prepared(engine, precision, workload):
    """The engine, or a skip that says why it can't be had."""
    lacking = ENGINES[engine][precision].lacking(workload.device)
    if lacking is not None:
        pytest.skip(str(lacking))
    return runtimes.prepare(engine, precision, workload)


def error(workload, stack):
    """Root mean square of the change beside that of what the network makes of its pictures."""
    with torch.no_grad():
        exact = workload.network(*workload.example)
    result = exact - (workload.example[1] if len(workload.example) > 1 else exact.mean())
    return float((stack - exact).square().mean().sqrt() / result.square().mean().sqrt())


@pytest.mark.slow
@pytest.mark.parametrize("network", cases.WORKLOADS)
@pytest.mark.parametrize(("engine", "precision"), EVERY)
def test_an_engine_computes_what_the_network_computes(engine, precision, network, monkeypatch):
    # GPUs multiply float32 with ten bits in convolutions unless they are told otherwise.
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)
    workload = cases.WORKLOADS[network]("cuda" if "cuda" in engine and torch.cuda.is_available() else "cpu")
    before = copy.deepcopy(workload.network.state_dict())
    run = prepared(engine, precision, workload)
    first, again = run(*workload.example), run(*workload.example)
    assert (first.shape, first.dtype) == (workload.network(*workload.example).shape, torch.float32)
    assert error(workload, first) < ALLOWED[precision]
    if precision != "fp32":
        assert error(workload, first) > 1e-5, "it is no other precision"
    # Results are the caller's: another pass doesn't write into them.
    run(*(0.5 * each for each in workload.example))
    torch.testing.assert_close(first, again, rtol=0, atol=1e-6)
    assert all(torch.equal(value, before[name]) for name, value in workload.network.state_dict().items())


def test_an_engine_that_cannot_run_here_says_in_a_line_what_it_lacks():
    def message_of(preparation):
        return str(preparation.lacking(CPU))

    assert Preparation(None).lacking(CPU) is None
    expected = "this engine needs a package; got no nothing_like_it; pip install 'lfref[export]'"
    assert message_of(Preparation(None, packages=("torch", "nothing_like_it"))) == expected
    assert message_of(Preparation(None, devices=("cuda",))) == "this engine runs on cuda; got cpu"
    assert message_of(Preparation(None, programs=("no-such-compiler",))).startswith(
        "this engine needs a C++ compiler; got none"
    )
    assert Preparation(None, programs=("no-such-compiler", "sh")).lacking(CPU) is None


def test_what_is_missing_is_an_error_where_it_is_asked_for(monkeypatch):
    monkeypatch.setattr(engines.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="got no openvino and no nncf; pip install"):
        runtimes.prepare("openvino", "int8", cases.refnet())


@pytest.mark.parametrize(
    ("engine", "precision", "message"),
    [
        ("tensorrt", "fp32", "engine must be one of eager"),
        ("eager", "int8", "precision of engine eager must be"),
    ],
)
def test_an_engine_or_precision_that_is_not_there_is_told(engine, precision, message):
    with pytest.raises(InputError, match=message):
        runtimes.prepare(engine, precision, cases.refnet())


def test_a_network_in_training_and_whole_numbers_without_patches_are_refused():
    workload = cases.refnet()
    with pytest.raises(InputError, match="got training mode"):
        runtimes.prepare("eager", "fp32", EngineWorkload(copy.deepcopy(workload.network).train(), workload.example))
    pytest.importorskip("onnxruntime")
    with pytest.raises(InputError, match="got no patches"):
        runtimes.prepare("onnxruntime", "int8", EngineWorkload(workload.network, workload.example))


def test_inputs_of_another_shape_or_type_are_refused_by_every_engine_alike():
    run = runtimes.prepare("eager", "fp32", cases.refiner())
    rest = torch.rand(4, 3, 31, 45), torch.rand(4, 1, 31, 45)
    with pytest.raises(InputError, match=r"prepared for 4x5x31x45 float32, .*, 4x1x31x45 float32; got 4x5x31x44"):
        run(torch.rand(4, 5, 31, 44), *rest)
    with pytest.raises(InputError, match="got 4x5x31x45 float64"):
        run(torch.rand(4, 5, 31, 45).double(), *rest)


def test_an_engine_takes_no_gradients():
    workload = cases.refnet()
    workload.network.requires_grad_(True)
    assert not runtimes.prepare("channels_last", "bf16", workload)(*workload.example).requires_grad


@pytest.mark.slow
def test_two_networks_compiled_one_after_the_other_keep_their_own_weights():
    workloads = [cases.refnet(), cases.refnet()]
    runs = [prepared("compile", "fp32", workload) for workload in workloads]
    for workload, run in [*zip(workloads, runs, strict=True), (workloads[0], runs[0])]:
        assert error(workload, run(*workload.example)) < ALLOWED["fp32"]
    assert error(workloads[0], workloads[1].network(*workloads[0].example)) > 0.1


def test_whole_numbers_are_for_inner_convolutions_of_more_than_a_pixel():
    kernels = {"stem": (3, 3), "wide": (1, 1), "inner": (3, 3), "row": (1, 5), "head": (1, 1)}
    assert engines.float_convolutions(kernels) == ["stem", "wide", "head"]


SIGNAL_AFTER_OPENVINO = """
import faulthandler, gc, signal, threading
import torch
from lfref.engines import runtimes
from lfref.engines.engine import EngineWorkload

faulthandler.enable()
signal.signal(signal.SIGUSR1, lambda *_: print("handled"))
views = torch.rand(1, 3, 8, 8)
runs = [runtimes.prepare("openvino", "fp32", EngineWorkload(torch.nn.Conv2d(3, 3, 3).eval(), (views,)))]
runs[0](views)
other = threading.Thread(target=lambda: (runs.clear(), gc.collect()))
other.start()
other.join()
signal.raise_signal(signal.SIGUSR1)
print("alive")
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="stacks of signals are those of Linux")
def test_signals_are_handled_after_openvinos_model_was_deleted_by_another_thread():
    pytest.importorskip("openvino")
    run = subprocess.run([sys.executable, "-c", SIGNAL_AFTER_OPENVINO], capture_output=True, text=True)
    assert (run.returncode, run.stdout) == (0, "handled\nalive\n"), run.stderr[-500:]
