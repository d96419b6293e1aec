"""Judging: a row a plane of every method on every subject, and summaries of the rows: means and least values."""

import math

import pandas as pd
import pytest
import torch

from lfref.bench import judging, quality
from lfref.bench.quality import Shown
from lfref.bench.subjects import Subject
from lfref.encoding import LINEAR, SRGB
from lfref.errors import InputError
from lfref.functional.psnr import psnr
from lfref.geometry import FocalPlanes, planes_at_alphas
from lfref.lightfield import LightField
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.operators import OperatorRefocuser

PLANES = planes_at_alphas((0.5, 2.0))
SUM, EXACT = OperatorRefocuser("sum", shift_and_sum), OperatorRefocuser("exact", exact_fourier)


def subject(kind, name, encoding=LINEAR):
    views, truth = torch.rand(3, 3, 3, 20, 24), torch.rand(2, 3, 20, 24)
    return Subject(kind, LightField(views, name), truth, "truth", encoding=encoding)


def test_there_is_a_row_for_every_plane_of_every_method_on_every_subject():
    chosen = [subject("ideal", "a"), subject("sensor", "a", SRGB)]
    rows = list(judging.rows(chosen, [SUM, EXACT], PLANES, 4))
    keys = [(row["class"], row["scene"], row["method"], row["reference"], row["alpha"], row["slope"]) for row in rows]
    assert keys == [
        (kind, "a", method, "truth", alpha, slope)
        for kind in ("ideal", "sensor")
        for method in ("sum", "exact")
        for alpha, slope in ((0.5, -1.0), (2.0, 0.5))
    ]
    assert all(set(judging.COLUMNS) <= set(row) for row in rows)


def test_rows_hold_the_measures_of_their_plane():
    curved = subject("sensor", "a", SRGB)
    rows = list(judging.rows([curved], [SUM], PLANES, 4))
    stack = SUM(curved.light, PLANES.slopes)
    shown = [Shown(SRGB.encode(light), light) for light in (stack, curved.truth)]
    expected = quality.planes(*shown, 4)
    for name, values in expected.items():
        assert [row[name] for row in rows] == pytest.approx(values)
    inner = (..., slice(4, -4), slice(4, -4))
    exact = EXACT(curved.light, PLANES.slopes)
    assert [row["exact_psnr_db"] for row in rows] == pytest.approx(
        psnr(SRGB.encode(stack[inner]), SRGB.encode(exact[inner])).tolist()
    )


def test_too_wide_a_border_is_refused_before_any_work():
    with pytest.raises(InputError, match="set margin=0"):
        list(judging.rows([subject("ideal", "a")], [SUM], PLANES, 7))


def judged():
    """Two scenes and planes in one class, one of them in another."""
    rows = [
        ("ideal", "a", "sum", -1.0, 40.0, 1.001), ("ideal", "a", "sum", 0.5, 50.0, 0.995),
        ("ideal", "b", "sum", -1.0, 30.0, 1.0), ("ideal", "b", "sum", 0.5, 70.0, 1.0),
        ("ideal", "a", "net", -1.0, 20.0, 1.0), ("ideal", "a", "net", 0.5, 22.0, 1.0),
        ("sensor", "b", "sum", -1.0, 25.0, 1.0), ("sensor", "b", "sum", 0.5, 27.0, 1.0),
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=["class", "scene", "method", "slope", "psnr_db", "brightness"])
    rest = {name: 0.5 for name in judging.COLUMNS if name not in table}
    return table.assign(alpha=math.nan, reference="truth", **rest)


def picked(table, *columns):
    return list(table[[*columns]].itertuples(index=False, name=None))


def test_planes_are_means_over_the_scenes_and_name_the_worst():
    found = picked(judging.by_plane(judged()), "class", "method", "slope", "psnr_db", "worst_psnr_db", "worst_scene")
    assert found == [
        ("ideal", "sum", -1.0, 35.0, 30.0, "b"), ("ideal", "sum", 0.5, 60.0, 50.0, "a"),
        ("ideal", "net", -1.0, 20.0, 20.0, "a"), ("ideal", "net", 0.5, 22.0, 22.0, "a"),
        ("sensor", "sum", -1.0, 25.0, 25.0, "b"), ("sensor", "sum", 0.5, 27.0, 27.0, "b"),
    ]  # fmt: skip


def test_scenes_are_means_over_the_planes_and_name_the_worst():
    found = picked(judging.by_scene(judged()), "class", "method", "scene", "psnr_db", "worst_psnr_db", "worst_slope")
    assert found == [
        ("ideal", "sum", "a", 45.0, 40.0, -1.0), ("ideal", "sum", "b", 50.0, 30.0, -1.0),
        ("ideal", "net", "a", 21.0, 20.0, -1.0), ("sensor", "sum", "b", 26.0, 25.0, -1.0),
    ]  # fmt: skip


def test_classes_are_means_over_all_and_name_the_worst_scene_and_brightness():
    columns = ("class", "method", "scenes", "psnr_db", "worst_psnr_db", "worst_scene", "brightness_error")
    found = picked(judging.by_class(judged()), *columns)
    assert [row[:-1] for row in found] == [
        ("ideal", "sum", 2, 47.5, 45.0, "a"), ("ideal", "net", 1, 21.0, 21.0, "a"),
        ("sensor", "sum", 1, 26.0, 26.0, "b"),
    ]  # fmt: skip
    assert [row[-1] for row in found] == pytest.approx([0.005, 0, 0])


def test_what_is_no_number_is_the_worst():
    table = judged()
    table.loc[1, "psnr_db"] = math.nan
    found = judging.by_scene(table).iloc[0]
    assert (found["worst_psnr_db"], found["worst_slope"]) == (-math.inf, 0.5)


def test_slopes_without_alphas_are_planes_too():
    rows = list(judging.rows([subject("ideal", "a")], [SUM], FocalPlanes([-1, 0.5]), 4))
    assert len(judging.by_plane(pd.DataFrame(rows))) == 2
