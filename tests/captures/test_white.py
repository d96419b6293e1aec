"""The white picture: gains as they are, noise smoothed away, dust kept; what is no white picture is refused."""

import pytest
import torch
from torch.nn import functional as F

from lfref.captures import vignetting
from lfref.errors import InputError


def shaded():
    x = torch.linspace(-1, 1, 60)
    shade = 1 - 0.4 * x.square()[:, None] - 0.3 * x.square()
    views = 0.7 * shade.expand(3, 3, 3, -1, -1).clone()
    views[:, :, 2] *= 0.5
    return views


def test_gains_are_the_picture_over_its_middle_whatever_its_colour():
    gains, error = vignetting.white_gain(shaded())
    assert error < 1e-3
    torch.testing.assert_close(gains[:, :, 2], gains[:, :, 0])
    assert float(gains[1, 1, 0, 30, 30]) == pytest.approx(1, abs=0.01)
    assert float(gains[0, 2, 1, 0, 30]) == pytest.approx(0.6, abs=0.01)


def test_noise_is_smoothed_away_and_what_has_none_stays_as_it_is():
    clean = shaded()
    noisy = clean + 0.01 * torch.randn(clean.shape)
    exact, _ = vignetting.white_gain(clean)
    gains, told = vignetting.white_gain(noisy)
    error = (gains - exact)[..., 10:-10, 10:-10]
    assert float(error.std()) < 0.005
    assert float(error.std()) == pytest.approx(told, rel=0.5)
    assert float((noisy / 0.7)[:, :, 0].sub(exact[:, :, 0]).std()) > 0.013
    dusty = clean.clone()
    dusty[0, 0, :, 20, 20] *= 0.5
    assert float(vignetting.white_gain(dusty)[0][0, 0, 0, 20, 20]) == pytest.approx(
        0.5 * float(exact[0, 0, 0, 20, 20]), rel=0.02
    )


def test_the_noise_of_a_smooth_picture_is_measured():
    assert vignetting.noise_of(shaded()[1, 1] + 0.02 * torch.randn(3, 60, 60)) == pytest.approx(0.02, rel=0.25)
    assert vignetting.noise_of(shaded()[1, 1]) < 1e-3
    shared = F.avg_pool2d(torch.randn(3, 242, 242), 3, 1)
    assert vignetting.noise_of(0.7 + 0.03 * shared) == pytest.approx(0.03, rel=0.25)
    assert vignetting.noise_of(torch.ones(3, 2, 2)) == 0


@pytest.mark.parametrize("views", [torch.zeros(3, 3, 3, 16, 16), torch.full((3, 3, 3, 16, 16), torch.nan)])
def test_a_picture_of_nothing_is_refused(views):
    with pytest.raises(InputError, match="white"):
        vignetting.white_gain(views)
