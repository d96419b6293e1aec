import pytest
import torch

from lfref.errors import InputError
from lfref.functional import fourier
from lfref.refocus.fourier import layer_mixing


def test_wrap_leaves_pictures_as_they_are():
    frame, pictures = layer_mixing.make_frame("wrap", (5, 7), 3.0), torch.rand(2, 5, 7)
    assert frame.period == (5, 7)
    assert torch.equal(frame.extend(pictures), pictures)


@pytest.mark.parametrize("reach", [0.0, 3.2, 40.0])
def test_edge_makes_room_for_the_reach_at_every_side_and_goes_on_with_the_outermost_pixel(reach):
    frame, pictures = layer_mixing.make_frame("edge", (5, 8), reach), torch.rand(2, 3, 5, 8)
    period = frame.extend(pictures)
    assert period.shape == (2, 3, *frame.period)
    assert all(fourier.is_fast(length) for length in frame.period)
    for first, length, whole in zip(frame.first, frame.size, frame.period, strict=True):
        assert first > reach
        assert whole - first - length > reach
    assert torch.equal(period[..., 0, 0], pictures[..., 0, 0])
    assert torch.equal(period[..., -1, frame.first[1] + 2], pictures[..., -1, 2])


@pytest.mark.parametrize("border", ["edge", "wrap"])
def test_pictures_come_back_from_the_spectra_of_their_periods(border):
    frame, pictures = layer_mixing.make_frame(border, (5, 8), 2.0), torch.rand(3, 5, 8, dtype=torch.float64)
    again = frame.pictures(torch.fft.rfft2(frame.extend(pictures)))
    torch.testing.assert_close(again, pictures, atol=1e-14, rtol=0)


def test_refuses_other_borders():
    with pytest.raises(InputError, match="border must be one of edge, wrap"):
        layer_mixing.make_frame("mirror", (5, 8), 2.0)
