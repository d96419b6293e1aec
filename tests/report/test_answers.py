"""The sentence has the figures of the tables, and calls nothing better without the truth."""

import pandas as pd
import pytest

from lfref.report import answers

PSNR = {"network": (36.0, 30.5), "sum": (31.0, 30.0), "layers": (34.0, 31.0)}
"""PSNR of each method on the scenes `dome` and `stripes`."""
TIMES = {"network": 1.6, "sum": 0.25, "layers": 12.0}


def bench(reference="truth", kind="ideal", methods=tuple(PSNR), **more):
    names = {"class": kind, "reference": reference}
    rows = [
        {"method": name, "psnr_db": sum(PSNR[name]) / 2, "numpy_ffts": TIMES[name], "is_network": name == "network"}
        for name in methods
    ]
    scenes = [
        names | {"method": name, "scene": scene, "psnr_db": psnr}
        for name in methods
        for scene, psnr in zip(("dome", "stripes"), PSNR[name], strict=True)
    ]
    return pd.DataFrame(rows).assign(**names, **more), pd.DataFrame(scenes)


CLASSICAL = {"methods": ("sum", "layers")}


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            {"reference": "layers", "kind": "capture"},
            "On 2 light fields, against layers (not the truth), network is 2.8 dB above the best classical method, "
            "sum, worst on stripes (30.5 dB), at 1.6 units of time against 0.25.",
        ),
        (
            {"explained": [0.931, 0.9, 0.99], "explained_wide": [0.712, 0.5, None]},
            "On 2 scenes (ideal), network explains 93.1 % of refocusing (wide blur 71.2 %) and is 0.8 dB better than "
            "the best classical method, layers, worst on stripes (30.5 dB), at 1.6 units of time against 12.",
        ),
    ],
)
def test_the_sentence_has_the_figures_of_the_tables(given, sentence):
    answer = answers.of_bench(*bench(**given))
    assert answer.sentence == sentence
    assert answer.worst == "stripes"


@pytest.mark.parametrize(("lift", "words"), [(-2.0, "network is 1.2 dB worse than"), (-0.73, "network is as good as")])
def test_a_network_that_is_worse_is_called_worse_and_a_tie_a_tie(lift, words):
    rows, scenes = bench()
    lower = rows.assign(psnr_db=rows["psnr_db"] + lift * rows["is_network"])
    assert f"{words} the best classical method, layers" in answers.of_bench(lower, scenes).sentence


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
