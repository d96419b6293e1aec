"""Views read at any position: samples against the definition in plain Python, means, compiled loop against PyTorch."""

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

from lfref.refocus import gather
from lfref.refocus.gather import ViewMap, mean_of_views
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS
from tests.refocus.slow import slow_sample

LOCAL = ["nearest", "linear", "cubic"]


def sample(images, x, y, interpolation="linear", border="renormalize"):
    return gather.sample(images, x, y, INTERPOLATIONS[interpolation], BORDERS[border])


def doubles(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize("border", list(BORDERS))
@pytest.mark.parametrize("interpolation", LOCAL)
def test_equals_the_slow_reference_on_and_beyond_the_image(interpolation, border):
    image = torch.rand(2, 5, 7, dtype=torch.float64)
    x, y = torch.rand(60, dtype=torch.float64) * 20 - 7, torch.rand(60, dtype=torch.float64) * 16 - 6
    samples, has_sample = sample(image, x, y, interpolation, border)
    for i, (column, row) in enumerate(zip(x.tolist(), y.tolist(), strict=True)):
        slow = slow_sample(image, column, row, interpolation, border)
        assert bool(has_sample[i]) == (slow is not None)
        if slow is not None:
            torch.testing.assert_close(samples[:, i], slow, atol=1e-13, rtol=0)


@pytest.mark.parametrize("border", list(BORDERS))
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_derivatives_by_images_and_positions_are_right_forwards_backwards_and_twice(interpolation, border):
    image = torch.rand(3, 4, dtype=torch.float64, requires_grad=True)
    # Away from whole pixels, where linear interpolation has a kink.
    x = doubles(-0.7, 0.3, 1.6, 3.4).requires_grad_()
    y = doubles(0.4, 1.3, 1.8, 2.6).requires_grad_()

    def read(image, x, y):
        return sample(image, x, y, interpolation, border)[0]

    assert gradcheck(read, (image, x, y), check_forward_ad=True)
    assert gradgradcheck(read, (image, x, y), check_fwd_over_rev=True, fast_mode=True)


VIEWS = torch.tensor([1.0, 2.0, 4.0]).reshape(1, 1, 3, 1, 1, 1).expand(1, 1, 3, 1, 2, 2)
APERTURE = torch.tensor([[0.5, 0.25, 0.25]], dtype=torch.float64)


def test_the_mean_counts_only_views_that_see_the_point():
    # View 0 has what is below behind it, view 1 is read two pixels aside, view 2 has only the last corner behind it.
    matrices = torch.eye(3, dtype=torch.float64).repeat(1, 3, 1, 1)
    matrices[0, 0, 2], matrices[0, 1, 0, 2] = torch.tensor([0, -2, 1.0]), 2.0
    matrices[0, 2] *= 3
    matrices[0, 2, 2] = torch.tensor([-2, -2, 3.0])
    stack = mean_of_views(VIEWS, APERTURE, [ViewMap(matrices)], "nearest", "edge")
    torch.testing.assert_close(stack[0, 0, 0], torch.tensor([[7 / 4 + 1 / 4, 7 / 4 + 1 / 4], [3.0, 2.0]]))
