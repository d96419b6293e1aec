"""The mosaic keeps the colour that its pattern spells; demosaicing is exact on ramps and keeps the samples."""

import numpy as np
import pytest
import torch

from lfref.errors import InputError
from lfref.simulator.effects.recording import PATTERNS, demosaicked, mosaicked


@pytest.mark.parametrize("pattern", list(PATTERNS))
@pytest.mark.parametrize("size", [(4, 6), (5, 3)])
def test_the_pattern_spells_what_is_kept(pattern, size):
    views = torch.rand(2, 2, 3, *size)
    raw = mosaicked(views, pattern)
    assert raw.shape == (2, 2, 1, *size)
    for y in range(size[0]):
        for x in range(size[1]):
            channel = "RGB".index(pattern[2 * (y % 2) + x % 2])
            assert torch.equal(raw[:, :, 0, y, x], views[:, :, channel, y, x])


@pytest.mark.parametrize("size", [(2, 8), (8, 1)])
def test_views_too_small_to_demosaic_are_refused(size):
    with pytest.raises(InputError, match=f"at least 3x3 pixels; got {size[0]}x{size[1]}"):
        mosaicked(torch.rand(1, 1, 3, *size), "RGGB")


SIZES = [(8, 10), (7, 9), (3, 3)]


def each_pattern(test):
    return pytest.mark.parametrize("pattern", list(PATTERNS))(test)


@each_pattern
@pytest.mark.parametrize("size", SIZES)
def test_a_constant_colour_stays_up_to_the_edge(pattern, size):
    views = torch.tensor([0.2, 0.9, 0.4])[:, None, None].expand(2, 1, 3, *size)
    torch.testing.assert_close(demosaicked(mosaicked(views, pattern), pattern), views, atol=1e-6, rtol=0)


@each_pattern
def test_ramps_of_all_colours_are_exact_inside(pattern):
    y, x = torch.arange(11, dtype=torch.float64)[:, None], torch.arange(12, dtype=torch.float64)
    views = torch.stack([0.1 * x - 0.2 * y + 3, 0.3 * x + 0.05 * y, 1 - 0.07 * x + 0.4 * y])[None, None]
    result = demosaicked(mosaicked(views, pattern), pattern)
    torch.testing.assert_close(result[..., 2:-2, 2:-2], views[..., 2:-2, 2:-2], atol=1e-12, rtol=0)


@each_pattern
@pytest.mark.parametrize("size", SIZES)
def test_the_samples_themselves_are_kept(pattern, size):
    raw = torch.rand(2, 2, 1, *size)
    assert torch.equal(mosaicked(demosaicked(raw, pattern), pattern), raw)


def test_green_at_red_is_corrected_by_half_of_reds_laplacian():
    raw = torch.rand(1, 1, 1, 12, 12, dtype=torch.float64)
    samples, result = raw[0, 0, 0], demosaicked(raw, "RGGB")[0, 0]
    for y, x in ((4, 4), (6, 2)):
        near = samples[y - 1, x] + samples[y + 1, x] + samples[y, x - 1] + samples[y, x + 1]
        far = samples[y - 2, x] + samples[y + 2, x] + samples[y, x - 2] + samples[y, x + 2]
        assert float(result[1, y, x]) == pytest.approx(float(near / 4 + (samples[y, x] - far / 4) / 2))


@each_pattern
def test_it_is_what_the_library_makes(pattern):
    library = pytest.importorskip("colour_demosaicing")
    raw = torch.rand(1, 1, 1, 12, 14, dtype=torch.float64)
    expected = library.demosaicing_CFA_Bayer_Malvar2004(raw[0, 0, 0].numpy(), pattern)
    result = demosaicked(raw, pattern)[0, 0].movedim(0, -1).numpy()
    np.testing.assert_allclose(result[2:-2, 2:-2], expected[2:-2, 2:-2], atol=1e-12)
