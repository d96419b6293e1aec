"""The sentence has the figures of the tables, and calls nothing better without the truth."""

import math

import pandas as pd
import pytest

from lfref.bench import accuracy
from lfref.report import answers

PSNR = {"learned": (36.0, 30.5), "sum": (31.0, 30.0), "layers": (34.0, 31.0)}
"""PSNR of each method on the scenes `dome` and `stripes`."""
TIMES = {"learned": 1.6, "sum": 0.25, "layers": 12.0}


def bench(reference="truth", kind="ideal", methods=tuple(PSNR), **more):
    names = {"class": kind, "reference": reference}
    rows = [
        {"method": name, "psnr_db": sum(PSNR[name]) / 2, "numpy_ffts": TIMES[name], "is_network": name == "learned"}
        for name in methods
    ]
    scenes = [
        names | {"method": name, "scene": scene, "psnr_db": psnr}
        for name in methods
        for scene, psnr in zip(("dome", "stripes"), PSNR[name], strict=True)
    ]
    return pd.DataFrame(rows).assign(**names, **more), pd.DataFrame(scenes)


CLASSICAL = {"methods": ("sum", "layers")}
EXPLAINED = {"explained": [0.931, 0.9, 0.99], "explained_wide": [0.712, 0.5, None]}


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            {},
            "On 2 scenes (ideal), learned is 0.8 dB better than the best classical method, layers, worst on stripes "
            "(30.5 dB), at 1.6 units of time against 12.",
        ),
        (
            CLASSICAL,
            "On 2 scenes (ideal), layers is 2.0 dB better than the next method, sum, worst on stripes (31.0 dB), at 12 "
            "units of time against 0.25.",
        ),
        (
            {"methods": ("sum",)},
            "On 2 scenes (ideal), sum has 30.5 dB, worst on stripes (30.0 dB), at 0.25 units of time.",
        ),
        (
            {"reference": "layers", "kind": "capture"},
            "On 2 light fields, judged by layers and not by the truth, learned is 2.8 dB nearer to it than the nearest "
            "classical method, sum, worst on stripes (30.5 dB), at 1.6 units of time against 0.25.",
        ),
        (
            EXPLAINED,
            "On 2 scenes (ideal), learned explains 93.1 % of refocusing (wide blur 71.2 %) and is 0.8 dB better than "
            "the best classical method, layers, worst on stripes (30.5 dB), at 1.6 units of time against 12.",
        ),
        (
            {"explained": [-2.0, 0.9, 0.99], "explained_wide": math.nan},
            "On 2 scenes (ideal), learned is worse than no refocusing at all (its squared error is 3 times that of "
            "mean_of_views, explained -2) and is 0.8 dB better than the best classical method, layers, worst on "
            "stripes (30.5 dB), at 1.6 units of time against 12.",
        ),
    ],
)
def test_the_sentence_has_the_figures_of_the_tables(given, sentence):
    answer = answers.of_bench(*bench(**given))
    assert answer.sentence == sentence
    assert answer.worst == "stripes"


@pytest.mark.parametrize(("lift", "words"), [(-2.0, "learned is 1.2 dB worse than"), (-0.73, "learned is as good as")])
def test_a_network_that_is_worse_is_called_worse_and_a_tie_a_tie(lift, words):
    rows, scenes = bench()
    lower = rows.assign(psnr_db=rows["psnr_db"] + lift * rows["is_network"])
    assert f"{words} the best classical method, layers" in answers.of_bench(lower, scenes).sentence


def test_no_method_judges_itself():
    assert answers.of_bench(*bench("sum", methods=("sum",))) is None


def test_the_first_class_with_a_truth_answers():
    kinds = (bench("exact", "capture"), bench(), bench(kind="wide"))
    rows, scenes = (pd.concat(tables) for tables in zip(*kinds, strict=True))
    fft = pd.DataFrame([{"method": "numpy_fft_4d", "numpy_ffts": 1.0, "is_network": False}])
    answer = answers.of_bench(pd.concat([fft, rows]), scenes)
    assert (answer.kind, answer.reference) == ("ideal", "truth")


def test_the_mean_of_views_is_no_competitor():
    rows, scenes = bench(**CLASSICAL)
    rival = rows[:1].assign(method="mean_of_views", psnr_db=90.0)
    answer = answers.of_bench(pd.concat([rival, rows]), scenes)
    assert (answer.ours, answer.other) == ("layers", "sum")
    assert answers.of_bench(rival, scenes) is None


def test_an_evaluation_pools_the_squared_errors_of_all_light_fields():
    # At slope 1: squared errors .1 and .001 of the mean of views, .02 and .002 of the network.
    values = {"mean_of_views": (0.1, 0.001), "net": (0.02, 0.002), "cells": (0.01, 0.01)}
    rows = [
        {"light_field": field, "method": name, "reference": reference, "slope": slope, "ssim": 0.5, "colour_error": 0.0}
        | {"psnr_db": 10.0 if slope == 0 else -10 * math.log10(error)}
        for name, errors in values.items()
        for field, error in zip("ab", errors, strict=True)
        for reference in ("shift_and_sum", "rendered")
        for slope in (0.0, 1.0)
    ]
    planes = pd.DataFrame(rows)
    table = accuracy.summaries(planes)
    answer = answers.of_evaluation(table.assign(is_network=table["method"] == "net"), planes)
    assert answer.reference == "rendered"  # the truth, though it is not the first
    # 10 and 20 dB at most at slope 0 and 1: means of 13.5 and 18.5 dB, and of 15 dB.
    assert answer.sentence == (
        f"On 2 light fields, net explains {100 * (1 - 0.022 / 0.101):.3g} % of refocusing and is 1.0 dB better than "
        "the best classical method, cells, worst on a (13.5 dB)."
    )
