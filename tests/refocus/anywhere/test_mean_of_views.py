"""The mean over the aperture: which views count, what is refused, and who computes it."""

import pytest
import torch

from lfref.errors import InputError
from lfref.refocus import gather
from lfref.refocus.gather import Places, mean_of_views

VIEWS = torch.tensor([1.0, 2.0, 4.0]).reshape(1, 1, 3, 1, 1, 1).expand(1, 1, 3, 1, 2, 2)
APERTURE = torch.tensor([[0.5, 0.25, 0.25]], dtype=torch.float64)


@pytest.mark.parametrize("views", [VIEWS, VIEWS.clone().requires_grad_()])
def test_the_mean_counts_only_views_that_see_the_point(views):
    # View 0 has what is below behind it, view 1 is read two pixels aside, view 2 has only the last corner behind it.
    matrices = torch.eye(3, dtype=torch.float64).repeat(1, 3, 1, 1)
    matrices[0, 0, 2], matrices[0, 1, 0, 2] = torch.tensor([0, -2, 1.0]), 2.0
    matrices[0, 2] *= 3
    matrices[0, 2, 2] = torch.tensor([-2, -2, 3.0])
    stack, coverage = mean_of_views(views, APERTURE, [Places(matrices)], "nearest", "edge")
    torch.testing.assert_close(stack.detach()[0, 0, 0], torch.tensor([[7 / 4 + 1 / 4, 7 / 4 + 1 / 4], [3.0, 2.0]]))
    torch.testing.assert_close(coverage[0], torch.tensor([[1, 1], [0.5, 0.25]], dtype=torch.float64))


def test_matrices_and_slopes_add_up():
    views = torch.rand(1, 2, 3, 1, 6, 7, dtype=torch.float64)
    aperture, slopes = torch.full((2, 3), 1 / 6).double(), torch.rand(6, 7, dtype=torch.float64)
    moved = torch.eye(3, dtype=torch.float64).repeat(2, 3, 1, 1)
    moved[..., 0, 2], moved[..., 1, 2] = torch.tensor([-0.5, 0, 0.5]).double(), torch.tensor([[-0.25], [0.25]]).double()
    both = mean_of_views(views, aperture, [Places(moved, slopes)], "linear", "wrap")
    alone = mean_of_views(views, aperture, [Places(slopes=slopes + 0.5)], "linear", "wrap")
    torch.testing.assert_close(both, alone, atol=1e-12, rtol=0)
    slow = mean_of_views(views, aperture, [Places(moved, slopes.clone().requires_grad_())], "linear", "wrap")
    torch.testing.assert_close([each.detach() for each in slow], list(both), atol=1e-12, rtol=0)


def test_compiled_loops_serve_plain_tensors_and_pytorch_all_others(monkeypatch):
    slopes = torch.zeros(2, 2, dtype=torch.float64)
    asked = {"numba": (VIEWS, slopes), "torch": (VIEWS, slopes.clone().requires_grad_())}
    expected = mean_of_views(VIEWS, APERTURE, [Places(slopes=slopes)], "linear", "edge")
    for unused, other in (("means_numba", "torch"), ("means_torch", "numba")):
        with monkeypatch.context() as patched:
            patched.setattr(gather, unused, pytest.fail)
            views, places = asked[other]
            found = mean_of_views(views, APERTURE, [Places(slopes=places)], "linear", "edge")
        torch.testing.assert_close([each.detach() for each in found], list(expected))


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        (("exact", "edge"), "vary over the picture must be one of nearest, linear, cubic; got 'exact'"),
        (("magic", "edge"), "must be one of nearest"),
        (("linear", "mirror"), "border must be one of"),
    ],
)
def test_bad_names_are_refused(choice, message):
    with pytest.raises(InputError, match=message):
        mean_of_views(VIEWS, APERTURE, [Places()], *choice)
