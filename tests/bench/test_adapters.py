import torch

from lfref.bench import adapters
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum

SLOPES = torch.tensor([-1.0, -0.2, 0.6], dtype=torch.float64)


def test_even_stack_fills_the_span_of_the_slopes():
    views = torch.rand(2, 3, 3, 1, 12, 13, dtype=torch.float64)
    stack = adapters.even_stack(views, torch.tensor([0.6, -1.0, 0.0]))
    torch.testing.assert_close(stack, exact_fourier(views, SLOPES), atol=1e-6, rtol=0)


def test_coplanar_homographies_are_shift_and_sum():
    views = torch.rand(3, 4, 2, 12, 13, dtype=torch.float64)
    torch.testing.assert_close(
        adapters.coplanar_homography(views, SLOPES), shift_and_sum(views, SLOPES), atol=1e-12, rtol=0
    )


def test_focus_takes_every_pixel_from_one_of_the_planes():
    views = torch.rand(2, 3, 3, 1, 12, 13)
    picture, stack = adapters.focus(views, SLOPES), shift_and_sum(views, SLOPES)
    assert picture.shape == (2, 1, 1, 12, 13)
    assert bool((picture == stack).any(dim=1).all())
