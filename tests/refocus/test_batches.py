"""Weights become an aperture of sum 1; any batch dimensions pass through an operator, integers become radiance."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.autograd import forward_ad

from lfref.errors import InputError
from lfref.refocus import batches


def test_no_weights_weigh_all_views_alike():
    aperture = batches.checked_weights(None, (3, 4))
    assert aperture.shape == (3, 4)
    assert aperture.dtype == torch.float64
    torch.testing.assert_close(aperture, torch.full((3, 4), 1 / 12, dtype=torch.float64))


@given(values=st.lists(st.floats(1e-6, 1e6), min_size=6, max_size=6), scale=st.floats(1e-6, 1e6))
def test_weights_are_scaled_to_a_sum_of_1_and_keep_their_ratios(values, scale):
    weights = torch.tensor(values, dtype=torch.float64).reshape(2, 3)
    aperture = batches.checked_weights(weights * scale, (2, 3))
    assert float(aperture.sum()) == pytest.approx(1, abs=1e-12)
    torch.testing.assert_close(aperture * weights.sum(), weights, rtol=1e-12, atol=0)


@pytest.mark.parametrize("scale", [5e-324, 1e-300, 1e308])
def test_weights_may_be_as_small_or_large_as_numbers_are(scale):
    weights = torch.full((2, 3), scale, dtype=torch.float64)
    torch.testing.assert_close(batches.checked_weights(weights, (2, 3)), torch.full((2, 3), 1 / 6).double())


def test_views_that_are_not_read_are_copied_only_where_they_could_do_harm():
    views, aperture = torch.ones(1, 2, 3, 1, 300, 300, dtype=torch.float16), torch.ones(2, 3)
    aperture[0, 1] = 0
    assert batches.without_unread(views, aperture) is views
    views[0, 0, 1, 0, 5, 5] = torch.inf
    masked = batches.without_unread(views, aperture)
    assert torch.equal(masked[0].mean((-3, -2, -1)), aperture.half())
    assert batches.without_unread(views, torch.ones(2, 3)) is views


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (torch.ones(4, 3), r"weights must be \[3, 4\], one for each view; got shape \[4, 3\]"),
        (torch.ones(12), "one for each view"),
        (torch.ones(1, 3, 4), "one for each view"),
        (torch.zeros(3, 4), "not all zero"),
        (torch.full((3, 4), -1.0), "finite, >= 0"),
        (torch.full((3, 4), math.nan), "finite, >= 0"),
        (torch.full((3, 4), math.inf), "finite, >= 0"),
    ],
)
def test_weights_that_are_no_aperture_are_refused(weights, message):
    with pytest.raises(InputError, match=message):
        batches.checked_weights(weights, (3, 4))


@pytest.mark.parametrize("batch", [(), (1,), (2, 3), (2, 1, 2)])
def test_light_fields_stand_behind_one_batch_axis_and_their_stacks_get_all_back(batch):
    views = torch.rand(*batch, 2, 3, 1, 4, 5)
    flat = batches.flattened(views)
    assert flat.shape == (math.prod(batch), 2, 3, 1, 4, 5)
    stack = batches.restored(torch.stack([flat.sum((1, 2)) * n for n in range(3)], dim=1), views)
    assert stack.shape == (*batch, 3, 1, 4, 5)
    torch.testing.assert_close(stack[..., 2, :, :, :], views.sum((-5, -4)) * 2)


@pytest.mark.parametrize(
    ("dtype", "working"),
    [
        (torch.float16, torch.float32),
        (torch.bfloat16, torch.float32),
        (torch.float32, torch.float32),
        (torch.float64, torch.float64),
        (torch.uint8, torch.float32),
        (torch.uint16, torch.float32),
    ],
)
def test_all_but_float64_is_computed_in_float32(dtype, working):
    assert batches.working_dtype(dtype) == working
    radiance = batches.radiance(torch.ones(2, 3).to(dtype))
    assert (radiance.shape, radiance.dtype) == ((2, 3), working)


@pytest.mark.parametrize(("dtype", "scale"), [(torch.uint8, 255), (torch.uint16, 65535)])
def test_every_integer_is_its_share_of_full_scale(dtype, scale):
    integers = torch.arange(scale + 1)
    assert torch.equal(batches.radiance(integers.to(dtype)), (integers.double() / scale).float())


def test_floating_point_is_not_scaled_and_float32_not_copied():
    views = torch.tensor([-0.5, 255.0])
    assert batches.radiance(views) is views
    assert batches.radiance(views.half()).tolist() == [-0.5, 255.0]


@pytest.mark.parametrize("dtype", [torch.bool, torch.int8, torch.int16, torch.int64, torch.complex64])
def test_types_without_a_full_scale_are_refused(dtype):
    with pytest.raises(InputError, match=rf"uint8 or uint16; got {dtype}; scale other"):
        batches.flattened(torch.zeros(2, 2, 1, 4, 4).to(dtype))


def test_what_is_not_views_is_refused():
    with pytest.raises(InputError, match="views must be"):
        batches.flattened(torch.rand(2, 1, 4, 4))


PLAIN = torch.rand(2, 3)


def test_plain_numbers_are_for_the_compiler_of_their_device(monkeypatch):
    assert batches.compiler_for(PLAIN, PLAIN.double()) == "numba"
    monkeypatch.setattr(batches, "COMPILERS", {"meta": "triton"})
    assert batches.compiler_for(PLAIN) is None
    assert batches.compiler_for(PLAIN.to("meta")) == "triton"


def test_what_is_differentiated_is_for_pytorch():
    needed = PLAIN.clone().requires_grad_()
    assert batches.compiler_for(PLAIN, needed) is None
    with torch.no_grad():
        assert batches.compiler_for(PLAIN, needed) == "numba"
    with forward_ad.dual_level():
        assert batches.compiler_for(forward_ad.make_dual(PLAIN, PLAIN)) is None


@pytest.mark.parametrize("transform", [torch.func.vmap, torch.func.grad, torch.compile])
def test_tensors_that_are_being_transformed_are_for_pytorch(transform):
    compilers = []

    def read(tensor):
        compilers.append(batches.compiler_for(tensor))
        return tensor.sum()

    if transform is torch.compile:
        torch.compile(read, backend="eager")(PLAIN)
    else:
        transform(read)(PLAIN)
    assert compilers == [None]


def test_other_kinds_of_tensor_are_for_pytorch():
    assert batches.compiler_for(torch.nn.Parameter(PLAIN, requires_grad=False)) is None
