"""Networks get the inputs of their refocusers; engines take turns; the arithmetic of the table by hand."""

import math

import pandas as pd
import pytest
import torch

from lfref import geometry
from lfref.bench import engine_timing
from lfref.bench.engine_timing import FieldInputs, Fields, NetworkCase
from lfref.data.field_sources import SimulatedSource
from lfref.engines import runtimes
from lfref.engines.engine import Preparation
from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.nets.refiner import Refiner
from lfref.nets.refnet import RefNet
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser import networks
from lfref.refocuser.networks import RefinedRefocuser
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

BASE = OperatorRefocuser("sum", shift_and_sum)
CPU = torch.device("cpu")
PLANES = geometry.even_planes(2)
EAGER = ("eager", "fp32")


@pytest.fixture(scope="module")
def fields():
    def drawn(size, seed, count):
        source = SimulatedSource(count, seed, RandomScenes(Camera(grid=(3, 3), size=size)))
        return [source.field(index) for index in range(count)]

    return Fields(drawn((32, 40), 1, 2), drawn((24, 24), 2, 1))


def network():
    return RefNet(n_planes=2, grid=(3, 3), widths=(8,), stem_width=8)


def test_a_network_reads_views_and_has_the_truth_of_the_scenes(fields):
    case = engine_timing.network_case("net", network(), fields, PLANES, True, CPU)
    assert [inputs.scene for inputs in case.fields] == [field.name for field in fields.whole]
    for inputs, field in zip(case.fields, fields.whole, strict=True):
        assert torch.equal(inputs.parts[0][0], field.views)
        assert torch.equal(inputs.truth, field.photograph(PLANES.values))
        assert inputs.stack(case.network).shape == inputs.truth.shape
    assert [tuple(views.shape) for (views,) in case.calibration] == [(3, 3, 3, 24, 24)]
    assert not case.network.training


def test_a_network_without_training_makes_pictures_as_bright_as_the_scenes_and_a_trained_one_is_left_alone(fields):
    raw, trained = network(), network()
    before = trained.head.weight.clone()
    engine_timing.network_case("net", trained, fields, PLANES, True, CPU)
    assert torch.equal(trained.head.weight, before)
    case = engine_timing.network_case("net", raw, fields, PLANES, False, CPU)
    with torch.no_grad():
        stack = case.network(*case.calibration[0])
    assert stack.mean() == pytest.approx(float(fields.calibration[0].photograph(PLANES.values).mean()), abs=0.02)
    assert stack.std() > 0.03


def test_a_refiner_reads_the_parts_that_its_refocuser_makes(fields, monkeypatch):
    network = Refiner(6, 1, width=8, n_blocks=1)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    refiner = RefinedRefocuser(network, BASE, ("central", "picture"), "refined")
    monkeypatch.setattr(networks, "AT_ONCE", 3 * 6 * 32 * 40)
    # Digits are compared here, which half of them would hide.
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict, raising=False)
    planes = geometry.even_planes(4)
    case = engine_timing.refiner_case(refiner, fields, planes, CPU)
    for inputs, field in zip(case.fields, fields.whole, strict=True):
        # Three planes would fit, and the fourth would be a part of another shape.
        assert [tuple(features.shape) for features, *_ in inputs.parts] == [(2, 6, 32, 40)] * 2
        with torch.no_grad():
            stack = inputs.stack(case.network)
        torch.testing.assert_close(stack, refiner(field, planes.slopes), atol=1e-5, rtol=0)
        assert (stack - BASE(field, planes.slopes)).std() > 1e-3
        assert torch.equal(inputs.truth, field.photograph(planes.values))
    assert [tuple(features.shape) for features, *_ in case.calibration] == [(2, 6, 24, 24)] * 2
    assert (case.name, case.is_trained) == ("refined", True)


def convolution(is_trained=True, sides=(24, 24)):
    """A convolution on two light fields; their truth is its output plus .01."""
    network = torch.nn.Conv2d(3, 3, 3, padding=1).eval().requires_grad_(False)
    views = {f"scene {place}": torch.rand(2, 3, side, 32) for place, side in enumerate(sides)}
    fields = [FieldInputs(name, [(stack,)], network(stack) + 0.01) for name, stack in views.items()]
    return NetworkCase("convolution", network, is_trained, fields, [(torch.rand(2, 3, 16, 16),)])


def test_eager_float32_comes_first_and_every_engine_with_its_own_precisions():
    all_choices = engine_timing.choices()
    assert all_choices[0] == EAGER
    assert len(set(all_choices)) == len(all_choices) == sum(map(len, runtimes.ENGINES.values()))
    assert engine_timing.choices(["openvino", "eager"], ["int8", "bf16"]) == [
        EAGER, ("openvino", "bf16"), ("openvino", "int8"), ("eager", "bf16"),
    ]  # fmt: skip
    for wrong in ({"engines": ["tensorrt"]}, {"precisions": ["fp4"]}):
        with pytest.raises(InputError, match="one of"):
            engine_timing.choices(**wrong)


def test_passes_take_turns_on_one_light_field_after_the_other():
    case = convolution()
    runs = {EAGER: case.network, ("half", "fp32"): lambda views: case.network(views) + 0.1}
    rows = pd.DataFrame(engine_timing.passes(case, runs, range(3)))
    assert rows["scene"].tolist() == ["scene 0", "scene 0", "scene 1", "scene 1", "scene 0", "scene 0"]
    assert rows["round"].tolist() == [0, 0, 1, 1, 2, 2]
    assert rows["engine"].tolist() == ["eager", "half"] * 3
    assert rows["psnr_db"].to_numpy() == pytest.approx([40, 20 * math.log10(1 / 0.09)] * 3, abs=1e-3)
    assert rows["agreement_db"].to_numpy() == pytest.approx([100, 20] * 3, abs=1e-3)
    assert rows["max_error"].to_numpy() == pytest.approx([0, 0.1] * 3, abs=1e-6)
    assert (rows["seconds"] > 0).all()


def test_networks_without_training_are_not_compared_with_the_truth():
    case = convolution(is_trained=False)
    (row,) = engine_timing.passes(case, {EAGER: case.network}, [1])
    assert math.isnan(row["psnr_db"])
    assert (row["agreement_db"], row["max_error"]) == (100, 0)


def test_an_engine_starts_with_its_first_stack_and_the_memory_of_it():
    case = convolution(sides=(1200,))
    started = engine_timing.start(case, "channels_last", "bf16")
    assert started.start_s > 0
    # One tensor of the input's size is 0.9 MB; a copy in bfloat16 and its result, in float32 and not, are needed.
    assert started.extra_bytes is None or 0.3e6 < started.extra_bytes < 50e6
    field = case.fields[0]
    assert psnr(field.stack(started.run), field.stack(case.network)).min() > 40


def test_an_engine_that_cannot_run_says_why_in_one_line(monkeypatch):
    def stumble(job):
        raise RuntimeError("operator aten::frobnicate is unknown\nand a page of it")

    monkeypatch.setitem(runtimes.ENGINES, "broken", {"fp32": Preparation(stumble)})
    with pytest.raises(InputError) as refused:
        engine_timing.start(convolution(), "broken", "fp32")
    assert str(refused.value).endswith("got operator aten::frobnicate is unknown")
    with pytest.raises(InputError, match="this engine runs on cuda; got cpu"):
        engine_timing.start(convolution(), "cuda_graphs", "fp32")


def pass_rows(name, engine, precision, seconds, psnr_db, agreement_db=100.0):
    row = {"network": name, "engine": engine, "precision": precision}
    more = {"psnr_db": psnr_db, "agreement_db": agreement_db, "max_error": 0.25}
    return [row | more | {"round": number, "scene": "a", "seconds": spent} for number, spent in enumerate(seconds)]


def summary():
    rows = [
        *pass_rows("net", "eager", "fp32", [4.0, 5.0, 9.0], 30.0),
        *pass_rows("net", "vino", "bf16", [3.0, 2.0, 8.0], 29.95),
        *pass_rows("net", "vino", "int8", [1.0, 1.0, 1.0], 29.0),
        *pass_rows("raw", "eager", "fp32", [2.0], math.nan),
        *pass_rows("raw", "vino", "bf16", [1.0], math.nan, 47.0),
        *pass_rows("raw", "vino", "int8", [0.5], math.nan, 45.0),
    ]
    names = dict.fromkeys((row["network"], row["engine"], row["precision"]) for row in rows)
    starts = [dict(zip(engine_timing.KEY, name, strict=True), start_s=7.0, extra_bytes=10) for name in names]
    starts.insert(1, {"network": "net", "engine": "graphs", "precision": "fp32", "skipped": "no GPU"})
    return engine_timing.summary(pd.DataFrame(rows), pd.DataFrame(starts))


def test_the_table_compares_the_fastest_passes_and_the_mean_decibels_with_eager_float32():
    table = summary()
    assert table.columns.tolist() == engine_timing.COLUMNS
    rows = table.set_index(engine_timing.KEY)
    assert rows.loc[("net", "vino", "bf16"), ["min_s", "median_s", "ratio_to_eager"]].tolist() == [2, 3, 2]
    assert rows.loc[("net", "vino", "bf16"), "loss_db"] == pytest.approx(0.05)
    assert rows.loc[("raw", "vino", "int8"), "ratio_to_eager"] == 4
    assert math.isnan(rows.loc[("raw", "vino", "int8"), "loss_db"])
    skipped = rows.loc[("net", "graphs", "fp32")]
    assert skipped["skipped"] == "no GPU"
    assert skipped[["start_s", "min_s", "extra_bytes"]].isna().all()


def test_the_fastest_engine_is_one_that_loses_little():
    # 30 dB and an error 16.3 dB below: 29.9 dB; 45 dB of agreement would cost more.
    best = engine_timing.fastest(summary())
    assert best[engine_timing.KEY].to_numpy().tolist() == [["net", "vino", "bf16"], ["raw", "vino", "bf16"]]
    assert engine_timing.fastest(summary(), 2.0)["precision"].tolist() == ["int8", "int8"]
    error = 10 ** (-30 / 10) + 10 ** (-46.33 / 10)
    assert -10 * math.log10(error) == pytest.approx(29.9, abs=1e-3)
