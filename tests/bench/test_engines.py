"""Engines are measured in turns and judged by eager float32 and by truth; the arithmetic of the table by hand."""

import math

import pandas as pd
import pytest
import torch

from lfref.bench import engine_timing
from lfref.bench.engine_timing import Shot, Subject
from lfref.engines import runtimes
from lfref.engines.engine import Way
from lfref.errors import InputError
from lfref.functional.psnr import psnr

EAGER = ("eager", "fp32")


def subject(is_trained=True, sides=(24, 24)):
    """A convolution of two light fields, whose truth is what it makes and a tenth of a tenth."""
    network = torch.nn.Conv2d(3, 3, 3, padding=1).eval().requires_grad_(False)
    views = {f"scene {place}": torch.rand(2, 3, side, 32) for place, side in enumerate(sides)}
    shots = [Shot(name, [(each,)], network(each) + 0.01) for name, each in views.items()]
    return Subject("convolution", network, is_trained, shots, [(torch.rand(2, 3, 16, 16),)])


def test_eager_float32_comes_first_and_every_engine_with_its_own_precisions():
    every = engine_timing.choices()
    assert every[0] == EAGER
    assert len(set(every)) == len(every) == sum(map(len, runtimes.ENGINES.values()))
    assert engine_timing.choices(["openvino", "eager"], ["int8", "bf16"]) == [
        EAGER, ("openvino", "bf16"), ("openvino", "int8"), ("eager", "bf16"),
    ]  # fmt: skip
    for wrong in ({"engines": ["tensorrt"]}, {"precisions": ["fp4"]}):
        with pytest.raises(InputError, match="must be one of"):
            engine_timing.choices(**wrong)


def test_passes_take_turns_on_one_light_field_after_the_other():
    measured = subject()
    runs = {EAGER: measured.network, ("half", "fp32"): lambda views: measured.network(views) + 0.1}
    rows = pd.DataFrame(engine_timing.passes(measured, runs, range(3)))
    assert rows["scene"].tolist() == ["scene 0", "scene 0", "scene 1", "scene 1", "scene 0", "scene 0"]
    assert rows["round"].tolist() == [0, 0, 1, 1, 2, 2]
    assert rows["engine"].tolist() == ["eager", "half"] * 3
    assert rows["psnr_db"].to_numpy() == pytest.approx([40, 20 * math.log10(1 / 0.09)] * 3, abs=1e-3)
    assert rows["agreement_db"].to_numpy() == pytest.approx([100, 20] * 3, abs=1e-3)
    assert rows["max_error"].to_numpy() == pytest.approx([0, 0.1] * 3, abs=1e-6)
    assert (rows["seconds"] > 0).all()


def test_without_training_nothing_is_judged_by_truth():
    measured = subject(is_trained=False)
    (row,) = engine_timing.passes(measured, {EAGER: measured.network}, [1])
    assert math.isnan(row["psnr_db"])
    assert (row["agreement_db"], row["max_error"]) == (100, 0)


def test_an_engine_gets_ready_with_its_first_stack_and_the_memory_that_took():
    measured = subject(sides=(1200,))
    made = engine_timing.ready(measured, "channels_last", "bf16")
    assert made.start_s > 0
    # One tensor of the input's size is 0.9 MB; a copy in bfloat16 and its result, in float32 and not, are needed.
    assert made.extra_bytes is None or 0.3e6 < made.extra_bytes < 50e6
    shot = measured.shots[0]
    assert psnr(shot.stack(made.run), shot.stack(measured.network)).min() > 40


def test_an_engine_that_cannot_run_says_why_in_one_line(monkeypatch):
    def stumble(job):
        raise RuntimeError("operator aten::frobnicate is unknown\nand a page of it")

    monkeypatch.setitem(runtimes.ENGINES, "broken", {"fp32": Way(stumble)})
    with pytest.raises(InputError) as refused:
        engine_timing.ready(subject(), "broken", "fp32")
    assert str(refused.value).endswith("got operator aten::frobnicate is unknown")
    with pytest.raises(InputError, match="this engine runs on cuda; got cpu"):
        engine_timing.ready(subject(), "cuda_graphs", "fp32")


def passed(name, engine, precision, seconds, psnr_db, agreement_db=100.0):
    row = {"subject": name, "engine": engine, "precision": precision}
    more = {"psnr_db": psnr_db, "agreement_db": agreement_db, "max_error": 0.25}
    return [row | more | {"round": number, "scene": "a", "seconds": each} for number, each in enumerate(seconds)]


def summary():
    rows = [
        *passed("net", "eager", "fp32", [4.0, 5.0, 9.0], 30.0),
        *passed("net", "vino", "bf16", [3.0, 2.0, 8.0], 29.95),
        *passed("net", "vino", "int8", [1.0, 1.0, 1.0], 29.0),
        *passed("raw", "eager", "fp32", [2.0], math.nan),
        *passed("raw", "vino", "bf16", [1.0], math.nan, 47.0),
        *passed("raw", "vino", "int8", [0.5], math.nan, 45.0),
    ]
    names = dict.fromkeys((row["subject"], row["engine"], row["precision"]) for row in rows)
    starts = [dict(zip(engine_timing.KEY, name, strict=True), start_s=7.0, extra_bytes=10) for name in names]
    starts.insert(1, {"subject": "net", "engine": "graphs", "precision": "fp32", "skipped": "no GPU"})
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


def test_the_fastest_engine_is_looked_for_among_those_that_cost_little():
    # 30 dB and an error 16.3 dB below: 29.9 dB; 45 dB of agreement would cost more.
    found = engine_timing.fastest(summary())
    assert found[engine_timing.KEY].to_numpy().tolist() == [["net", "vino", "bf16"], ["raw", "vino", "bf16"]]
    assert engine_timing.fastest(summary(), 2.0)["precision"].tolist() == ["int8", "int8"]
    error = 10 ** (-30 / 10) + 10 ** (-46.33 / 10)
    assert -10 * math.log10(error) == pytest.approx(29.9, abs=1e-3)
