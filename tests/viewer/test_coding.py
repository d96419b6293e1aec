"""How the page keeps pictures: predictions against a slow reference, formats against their own sizes and errors."""

import math

import numpy as np
import pytest

from lfref.viewer import coding
from lfref.viewer.coding import Coding, Prediction
from tests.viewer import cases


def image(height=24, width=30, seed=0):
    return np.random.default_rng(seed).random((height, width, 3))


def predicted_slowly(prediction, camera, row, column):
    """A pixel of a predicted view, in plain words of one pixel at a time."""
    (height, width, _), (down, across) = prediction.reference.shape, prediction.disparity.shape

    def disparity(x, y):
        inside = min(max(math.floor(y * down), 0), down - 1), min(max(math.floor(x * across), 0), across - 1)
        return prediction.disparity[inside]

    x, y = at = (column + 0.5) / width, (row + 0.5) / height
    for _ in range(coding.STEPS):
        d = disparity(x, y)
        x, y = at[0] - d * camera[0] / across, at[1] - d * camera[1] / down
    d = disparity(x, y)
    x, y = x + d * prediction.camera[0] / across, y + d * prediction.camera[1] / down
    left, top = x * width - 0.5, y * height - 0.5
    total = np.zeros(3)
    for j in (math.floor(top), math.floor(top) + 1):
        for i in (math.floor(left), math.floor(left) + 1):
            share = (1 - abs(top - j)) * (1 - abs(left - i))
            total += share * prediction.reference[min(max(j, 0), height - 1), min(max(i, 0), width - 1)]
    return total


@pytest.mark.parametrize(("size", "camera", "own"), [((24, 30), (2, -3), (0, 0)), ((48, 60), (-1.5, 0.5), (0.5, 0.5))])
def test_a_prediction_follows_the_disparity(size, camera, own):
    disparity = np.random.default_rng(1).uniform(-1.3, 1.1, size)
    prediction = Prediction(image(), own, disparity)
    view = prediction.view(camera)
    slow = [[predicted_slowly(prediction, camera, row, column) for column in range(30)] for row in range(24)]
    # Rounding may choose the neighbour of a pixel of the map.
    differs = np.abs(view - slow).max(-1) > 1e-4
    assert differs.mean() < 0.005


def test_quality_rises_until_it_is_enough():
    shown = cases.methods()["linear"]
    view = shown.encoded(shown.field.views[2, 2])
    first = Coding(".jpg", 75)
    errors = {quality: coding.code(view, Coding(".jpg", quality)).decibels for quality in coding.QUALITIES[".jpg"]}
    for decibels in (20.0, errors[75] + 0.1, errors[95] - 0.1, 200.0):
        coded = coding.at_least(decibels, view, first)
        enough = [quality for quality, value in errors.items() if value >= decibels]
        assert coded.coding.quality == (min(enough) if enough else 100)


@pytest.mark.slow
def test_the_coding_has_the_fewest_bytes_that_do():
    shown = cases.methods()["linear"]
    view = shown.encoded(shown.field.views[2, 2])
    sizes, errors = {}, {}
    for suffix, qualities in coding.QUALITIES.items():
        for quality in qualities:
            tried = coding.Coding(suffix, quality)
            file, read = tried.coded(view)
            sizes[tried], errors[tried] = len(file), -10 * np.log10(np.square(read / 255 - view).mean())
    for least in (30.0, 38.5, 42.0):
        chosen = coding.smallest(view, least_db=least)
        assert chosen.decibels == pytest.approx(errors[chosen.coding])
        assert chosen.decibels >= least
        assert len(chosen.file) == min(sizes[tried] for tried, decibels in errors.items() if decibels >= least)
    assert coding.smallest(view, least_db=90.0).decibels == max(errors.values())
