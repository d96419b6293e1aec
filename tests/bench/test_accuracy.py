"""Quality plane by plane: the interior by hand, means by hand, and rows for every pair."""

import pandas as pd
import pytest
import torch

from lfref.bench import accuracy
from lfref.errors import InputError
from lfref.functional.ssim import ssim
from lfref.geometry import FocalPlanes, planes_at_alphas
from lfref.refocus.shift.shift_and_sum import coverage

PLANES = planes_at_alphas((0.5, 2.0))  # slopes -1 and 0.5


def stack_off_by(*differences):
    """A stack whose planes differ from `grey` by these levels."""
    return torch.stack([torch.full((3, 12, 12), 0.5 + difference) for difference in differences])


GREY = stack_off_by(0, 0)


@pytest.mark.parametrize(
    ("slopes", "grid", "margin"), [([0.0], (7, 7), 0), ([-1.0, 0.5], (7, 7), 3), ([0.4], (7, 7), 2), ([0.5], (2, 5), 1)]
)
def test_the_interior_is_what_every_view_covers_at_every_plane(slopes, grid, margin):
    stack = torch.arange(20.0 * 22).reshape(1, 1, 20, 22)
    inner = accuracy.interior(stack, torch.tensor(slopes), grid)
    assert torch.equal(inner, stack[..., margin : 20 - margin, margin : 22 - margin])
    covered = coverage(slopes, grid, (20, 22))[:, None]
    torch.testing.assert_close(accuracy.interior(covered, torch.tensor(slopes), grid).min(), torch.tensor(1.0).double())


def test_there_is_a_row_for_every_plane_of_every_method_and_reference():
    stacks = {"exact": GREY, "off": stack_off_by(0.1, 0.01)}
    labels = {"one": GREY, "two": stack_off_by(0.1, 0.1)}
    rows = list(accuracy.plane_rows("field", stacks, labels, PLANES))
    keys = [(row["light_field"], row["method"], row["reference"], row["alpha"], row["slope"]) for row in rows]
    assert keys == [
        ("field", method, reference, alpha, slope)
        for method in stacks
        for reference in labels
        for alpha, slope in ((0.5, -1.0), (2.0, 0.5))
    ]


def test_quality_of_planes_by_hand():
    label = stack_off_by(0, 0)
    rows = list(accuracy.plane_rows("field", {"off": stack_off_by(0.1, 0.01)}, {"label": label}, PLANES))
    assert [row["psnr_db"] for row in rows] == pytest.approx([20, 40], abs=1e-4)
    assert [row["ssim"] for row in rows] == pytest.approx(ssim(stack_off_by(0.1, 0.01), label).tolist())
    (row, _) = accuracy.plane_rows("field", {"same": label}, {"label": label}, PLANES)
    assert (row["psnr_db"], row["ssim"]) == (100, 1)


def test_stacks_of_another_number_of_planes_are_refused():
    with pytest.raises(InputError, match="one shape"):
        list(accuracy.plane_rows("field", {"short": GREY[:1]}, {"label": GREY}, PLANES))


def test_planes_without_alphas_have_an_empty_one():
    rows = list(accuracy.plane_rows("field", {"a": GREY}, {"b": GREY}, FocalPlanes([-1, 0.5])))
    assert [(row["alpha"], row["slope"]) for row in rows] == [(None, -1.0), (None, 0.5)]


def test_summaries_are_the_means_over_the_planes_of_each_group():
    columns = ["light_field", "method", "reference", "psnr_db", "ssim"]
    rows = [
        ("a", "net", "sum", 30.0, 0.5),
        ("b", "net", "sum", 10.0, 0.1),
        ("a", "net", "slice", 20.0, 0.25),
        ("a", "net", "sum", 40.0, 0.75),
        ("a", "net", "sum", 80.0, 1.0),
    ]
    summary = accuracy.summaries(pd.DataFrame(rows, columns=columns))
    assert summary.columns.tolist() == ["light_field", "method", "reference", "mpsnr_db", "mssim"]
    assert summary.to_numpy().tolist() == [
        ["a", "net", "sum", 50.0, 0.75],
        ["b", "net", "sum", 10.0, 0.1],
        ["a", "net", "slice", 20.0, 0.25],
    ]


def test_interior_quality_is_the_mean_over_the_planes_and_the_largest_difference():
    reference = torch.rand(2, 3, 16, 16)
    spoiled = reference + torch.tensor([0.1, 0.01])[:, None, None, None]
    spoiled[..., 0, :] = spoiled[..., -1] = 9  # outside of the interior
    found = accuracy.interior_quality(spoiled, reference, PLANES.slopes, (3, 3), list(accuracy.MEASURES))
    inner = (..., slice(1, -1), slice(1, -1))
    assert found == {
        "psnr_db": pytest.approx(30, abs=1e-3),
        "ssim": pytest.approx(float(ssim(spoiled[inner], reference[inner]).mean())),
        "max_error": pytest.approx(0.1),
    }


def test_only_the_measures_asked_for_are_taken():
    tiny = torch.zeros(2, 3, 4, 4)  # too small for SSIM
    assert accuracy.interior_quality(tiny, tiny, PLANES.slopes, (1, 1), ["psnr_db"]) == {"psnr_db": 100.0}
