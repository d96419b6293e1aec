"""The sentence has the figures of the tables, and calls nothing better without the truth."""

import pandas as pd
import pytest

from lfref.errors import InputError
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


def test_a_network_is_compared_with_the_best_classical_method():
    answer = answers.of_bench(*bench())
    assert answer.sentence == (
        "On 2 scenes (ideal), learned is 0.8 dB better than the best classical method, layers, worst on stripes "
        "(30.5 dB), at 1.6 units of time against 12."
    )
    assert (answer.worst, answer.scores) == ("stripes", {"dome": 36.0, "stripes": 30.5})


def test_a_network_that_is_worse_is_called_worse_and_a_tie_a_tie():
    rows, scenes = bench()
    for lift, words in ((-2.0, "learned is 1.2 dB worse than"), (-0.73, "learned is as good as")):
        lower = rows.assign(psnr_db=rows["psnr_db"] + lift * rows["is_network"])
        sentence = answers.of_bench(lower, scenes).sentence
        assert f"{words} the best classical method, layers" in sentence


def test_without_a_network_the_best_method_is_compared_with_the_next():
    answer = answers.of_bench(*bench(methods=("sum", "layers")))
    assert answer.sentence == (
        "On 2 scenes (ideal), layers is 2.0 dB better than the next method, sum, worst on stripes (31.0 dB), at 12 "
        "units of time against 0.25."
    )
    rows, scenes = bench(methods=("sum", "layers"))
    assert answers.of_bench(rows.drop(columns="is_network"), scenes) == answer


def test_a_method_alone_has_its_own_figures():
    sentence = answers.of_bench(*bench(methods=("sum",))).sentence
    assert sentence == "On 2 scenes (ideal), sum has 30.5 dB, worst on stripes (30.0 dB), at 0.25 units of time."


def test_without_truth_nothing_is_better_and_no_method_judges_itself():
    answer = answers.of_bench(*bench("layers", "capture"))
    assert answer.sentence == (
        "On 2 light fields, judged by layers and not by the truth, learned is 2.8 dB nearer to it than the nearest "
        "classical method, sum, worst on stripes (30.5 dB), at 1.6 units of time against 0.25."
    )
    assert answers.of_bench(*bench("sum", methods=("sum",))) is None


def test_the_first_class_with_a_truth_answers():
    (captures, of_captures), (scenes, of_scenes), (more, of_more) = (
        bench("exact", "capture"), bench(), bench(kind="wide")
    )  # fmt: skip
    fft = pd.DataFrame([{"method": "numpy_fft_4d", "numpy_ffts": 1.0, "is_network": False}])
    answer = answers.of_bench(pd.concat([fft, captures, scenes, more]), pd.concat([of_captures, of_scenes, of_more]))
    assert (answer.kind, answer.reference) == ("ideal", "truth")


def test_scenes_without_our_method_are_an_error():
    rows, scenes = bench()
    with pytest.raises(InputError, match="must have the PSNR of learned"):
        answers.of_bench(rows, scenes[scenes["method"] != "learned"])


def summary(references=("shift_and_sum", "fourier_slice"), fields=("a", "b")):
    values = {"net": (31.0, 20.0), "cells": (30.0, 27.0), "shift_and_sum": (100.0, 100.0)}
    return pd.DataFrame(
        {"light_field": field, "method": name, "reference": reference, "mpsnr_db": mpsnr, "is_network": name == "net"}
        for name, of_fields in values.items()
        for reference in references
        for field, mpsnr in zip(fields, of_fields, strict=False)
    )


def test_an_evaluation_is_judged_by_its_first_label_or_by_the_rendered_one():
    assert answers.of_evaluation(summary()).sentence == (
        "On 2 light fields, judged by shift_and_sum and not by the truth, net is 3.0 dB farther from it than the "
        "nearest classical method, cells, worst on b (20.0 dB)."
    )
    rendered = answers.of_evaluation(summary(("fourier_slice", "rendered")))
    assert rendered.sentence == (
        "On 2 light fields, net is 74.5 dB worse than the best classical method, shift_and_sum, worst on b (20.0 dB)."
    )
    one = answers.of_evaluation(summary(("rendered",), ("a",))[:2])
    assert one.sentence == "On a, net is 1.0 dB better than the best classical method, cells."


@pytest.mark.parametrize(("text", "expected"), [(True, True), ("True", True), ("False", False), (None, False)])
def test_networks_are_known_from_a_file_too(text, expected):
    assert answers.networks(pd.DataFrame({"is_network": [text]})).tolist() == [expected]
