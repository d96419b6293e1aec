"""What is exported of a refocuser computes what the refocuser does, and says what it is."""

import itertools

import pytest
import torch

from lfref.errors import InputError
from lfref.export import graphs
from lfref.export.graphs import Sum, SumOfViews
from lfref.geometry import even_planes, planes_from
from lfref.nets.refnet import RefNet
from lfref.refocus import apertures
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.shift.shift_and_sum import shift_and_sum
from lfref.refocuser.networks import NetworkRefocuser
from lfref.refocuser.refocuser import OperatorRefocuser
from tests.export import cases


@pytest.mark.parametrize("kind", cases.SUBJECTS)
def test_a_graph_makes_the_pictures_of_its_refocuser(kind):
    refocuser = cases.SUBJECTS[kind]()
    subject = graphs.exportable(refocuser, cases.PLANES, cases.GRID)
    for field in cases.FIELDS:
        result = subject.graph.module(*subject.inputs([field]))
        expected = refocuser(field, cases.PLANES.slopes)
        torch.testing.assert_close(
            result.reshape(expected.shape), expected, atol=3e-3 if kind == "refiner" else 3e-6, rtol=0
        )


@pytest.mark.parametrize("kind", cases.SUBJECTS)
def test_inputs_have_the_axes_that_are_told(kind):
    subject = graphs.exportable(cases.SUBJECTS[kind](), cases.PLANES, cases.GRID)
    for tensors in (subject.graph.example, subject.inputs(cases.FIELDS[:1])):
        lengths = {}
        entries = dict(zip(subject.graph.inputs, tensors, strict=True))
        for name, axes in subject.graph.inputs.items():
            for axis, length in zip(axes, entries[name].shape, strict=True):
                assert length == (axis if isinstance(axis, int) else lengths.setdefault(axis, length))
        result = subject.graph.module(*tensors)
        assert result.shape == tuple(lengths.get(axis, axis) for axis in subject.graph.output)


def test_networks_and_operators_say_their_planes():
    for refocuser in (cases.network(), cases.operator()):
        entries = graphs.exportable(refocuser, cases.PLANES, cases.GRID).manifest_entries
        assert planes_from(entries["planes"]) == cases.PLANES
        assert entries["planes"]["alphas"] == [0.5, 1.0, 2.0]
    assert "planes" not in graphs.exportable(cases.refiner(), cases.PLANES, cases.GRID).manifest_entries


def test_an_aperture_is_exported_with_its_operator():
    refocuser = cases.operator(interpolation="cubic", fill=1.0).through(lambda grid: apertures.gaussian(grid, 1.0))
    subject = graphs.exportable(refocuser, cases.SLOPES, cases.GRID)
    views = cases.FIELDS[0].views[None]
    torch.testing.assert_close(subject.graph.module(views), subject.reference(views), atol=3e-6, rtol=0)
    assert len(subject.manifest_entries["config"]["options"]["weights"]) == 3


@pytest.mark.parametrize(
    "refocuser", [OperatorRefocuser("exact_fourier", exact_fourier), cases.operator(positions=torch.zeros(3, 3, 2))]
)
def test_what_no_graph_does_is_a_line(refocuser):
    with pytest.raises(InputError, match="must be a network, a refiner, or shift-and-sum"):
        graphs.exportable(refocuser, cases.PLANES, cases.GRID)


def test_a_network_that_names_no_channels_has_three():
    network = RefNet(n_planes=2, grid=(3, 3), widths=(4, 4), stem_width=4, n_blocks=2).requires_grad_(False)
    network.config = {key: value for key, value in network.config.items() if key != "channels"}
    subject = graphs.exportable(NetworkRefocuser(network, even_planes(2), "own"), even_planes(2), (3, 3))
    assert subject.graph.example[0].shape[-3] == 3


SLOPES = (-7.0, -1.3, -0.5, 0.0, 0.21, 1.0, 2.5)


def both(options, views):
    """What the convolutions make, and what the operator makes of it in float64."""
    weights = None if options.weights is None else torch.tensor(options.weights)
    expected = shift_and_sum(
        views.double(),
        options.slopes,
        options.interpolation,
        options.border,
        weights,
        options.fill,
        options.disparity,
    )
    return SumOfViews(options)(views), expected.float()


@pytest.mark.parametrize("border", ["renormalize", "edge", "zero"])
@pytest.mark.parametrize("interpolation", ["nearest", "linear", "cubic"])
@pytest.mark.parametrize("fill", [0.0, 1.0])
def test_convolutions_make_the_planes_of_the_operator(interpolation, border, fill):
    views = torch.rand(2, 5, 5, 1, 45, 40)
    result, expected = both(Sum(SLOPES, (5, 5), interpolation, border, fill, 0.3), views)
    torch.testing.assert_close(result, expected, atol=3e-6, rtol=0)


@pytest.mark.parametrize("grid", [(1, 1), (2, 3), (7, 4)])
def test_any_grid_and_number_of_channels_is_summed(grid):
    views = torch.rand(1, *grid, 1, 51, 44)
    torch.testing.assert_close(*both(Sum(SLOPES[1:], grid), views), atol=3e-6, rtol=0)


def test_an_aperture_weighs_the_views():
    weights = tuple(map(tuple, apertures.disc((5, 5), 4.0).tolist()))
    views = torch.rand(1, 5, 5, 3, 40, 40)
    torch.testing.assert_close(*both(Sum(SLOPES, (5, 5), weights=weights), views), atol=3e-6, rtol=0)


def test_a_pixel_is_what_a_slow_loop_adds_up():
    views, slope = torch.rand(1, 3, 3, 1, 12, 13), 0.75
    result = SumOfViews(Sum((slope,), (3, 3)))(views)[0, 0, 0]
    for y, x in ((0, 0), (5, 6), (11, 12), (0, 7)):
        total = count = 0.0
        for v, u in itertools.product(range(3), repeat=2):
            row, column = y + slope * (v - 1), x + slope * (u - 1)
            if 0 <= row <= 11 and 0 <= column <= 12:
                total, count = total + read(views[0, v, u, 0], row, column), count + 1
        assert abs(float(result[y, x]) - total / count) < 1e-6


def read(image, row, column):
    total = 0.0
    for y, x in itertools.product((int(row), int(row) + 1), (int(column), int(column) + 1)):
        weight = max(0, 1 - abs(row - y)) * max(0, 1 - abs(column - x))
        total += weight * float(image[y, x]) if weight else 0.0
    return total


@pytest.mark.parametrize(
    ("interpolation", "border", "message"), [("exact", "edge", "few samples"), ("cubic", "wrap", "border")]
)
def test_what_is_no_short_convolution_is_refused(interpolation, border, message):
    with pytest.raises(InputError, match=message):
        Sum((0.0,), (3, 3), interpolation, border)
