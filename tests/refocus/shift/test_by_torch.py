import torch

from lfref.refocus.shift import shift_torch


def planned(views, slopes, **options):
    return shift_torch.plan(slopes, views.shape[1:3], views.shape[-2:], **options)


def test_one_view_is_handed_back():
    views = torch.rand(2, 1, 1, 3, 5, 6)
    stack = shift_torch.shift_and_sum(views, planned(views, [0.7, -3.0]))
    torch.testing.assert_close(stack, views[:, 0].expand(-1, 2, -1, -1, -1))


def test_integers_are_scaled_to_radiance():
    views = torch.full((1, 2, 2, 1, 4, 4), 51, dtype=torch.uint8)
    torch.testing.assert_close(
        shift_torch.shift_and_sum(views, planned(views, [0.0])), torch.full((1, 1, 1, 4, 4), 0.2)
    )


def test_derivatives_in_both_modes():
    views = torch.rand(1, 2, 2, 1, 3, 4, dtype=torch.float64, requires_grad=True)
    for interpolation in ("nearest", "linear", "cubic", "exact"):
        plan = planned(views, [0.4, -0.9], interpolation=interpolation)
        assert torch.autograd.gradcheck(
            lambda x, plan=plan: shift_torch.shift_and_sum(x, plan), views, check_forward_ad=True
        )
