import pytest
import torch

from lfref.refocus.fourier.slice import kaiser_bessel


@pytest.mark.parametrize(("width", "sigma"), [(3, 2.0), (4, 2.0), (6, 2.0), (4, 1.5)])
def test_transform_is_the_fourier_integral_of_the_kernel(width, sigma):
    kernel = kaiser_bessel(width, sigma)
    t = torch.linspace(-width / 2, width / 2, 20001, dtype=torch.float64)
    positions = torch.linspace(-0.5, 0.5, 11, dtype=torch.float64)
    values = kernel.weight(t)
    values[[0, -1]] *= 2  # the trapezoid rule wants the inner limit at the ends, not the half of it
    integral = torch.trapezoid(values * torch.cos(2 * torch.pi * positions[:, None] * t), t, dim=-1)
    torch.testing.assert_close(kernel.transform(positions), integral, atol=1e-6, rtol=1e-6)


def test_the_kernel_is_even_and_ends_at_its_width():
    kernel = kaiser_bessel(4, 2.0)
    t = torch.tensor([-2.5, -2.0, -1.0, 1.0, 2.0, 2.5], dtype=torch.float64)
    torch.testing.assert_close(kernel.weight(t), kernel.weight(-t))
    assert kernel.weight(t)[0] == 0
