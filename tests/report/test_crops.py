"""Crops are cut where our picture is worst, all at the same place."""

import numpy as np
import pytest
import torch

from lfref.io import images
from lfref.report import answers
from lfref.report.answers import Answer

ROWS, COLUMNS = slice(40, 112), slice(60, 132)
"""The part that is worst."""
TIMES = "\N{MULTIPLICATION SIGN}"


def answer(reference="truth", other="sum"):
    return Answer("ideal", reference, "net", other, "dome", "")


def pictures():
    """View, ours, other and reference, of which ours is wrong in one place, and more so on the border."""
    view, other, reference = (torch.rand(3, 160, 200, generator=torch.Generator().manual_seed(n)) / 2 for n in range(3))
    ours = reference.clone()
    ours[:, ROWS, COLUMNS] += 0.1
    ours[:, :8] += 0.4
    return view, ours, other, reference


def test_crops_are_of_the_worst_part_of_the_interior(tmp_path):
    view, ours, other, reference = pictures()
    answers.write_crops(tmp_path, view, ours, other, reference, margin=8)
    found = answers.read_crops(tmp_path, answer())
    assert list(found) == ["Centre view", "sum", "net", "Truth", f"Difference {TIMES} 8"]
    expected = [view, other, ours, reference, torch.full_like(view, 0.8)]
    for file, picture in zip(found.values(), expected, strict=True):
        shown = images.to_float(images.read_image(file))
        assert shown.shape == (answers.SIDE, answers.SIDE, 3)
        np.testing.assert_allclose(shown, picture[:, ROWS, COLUMNS].permute(1, 2, 0), atol=1 / 255)


@pytest.mark.parametrize(("error", "factor"), [(0.0, 64), (0.3, 2), (0.9, 1)])
def test_a_difference_is_amplified_as_far_as_it_is_not_cut(tmp_path, error, factor):
    grey = torch.full((3, 80, 80), 0.05)
    answers.write_crops(tmp_path, grey, grey + error, None, grey)
    found = answers.read_crops(tmp_path, answer(other=None))
    shown = images.to_float(images.read_image(found[f"Difference {TIMES} {factor}"]))
    np.testing.assert_allclose(shown, error * factor, atol=1 / 255)
