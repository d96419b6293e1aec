"""What is exported of a refocuser computes what the refocuser does, and says what it is."""

import pytest
import torch

from lfref.errors import InputError
from lfref.export import graphs
from lfref.geometry import even_planes, planes_from
from lfref.nets.refnet import RefNet
from lfref.refocus import apertures
from lfref.refocus.fourier.slice import fourier_slice
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


def test_networks_say_their_planes_and_others_take_any():
    for kind in cases.SUBJECTS:
        entries = graphs.exportable(cases.SUBJECTS[kind](), cases.PLANES, cases.GRID).manifest_entries
        if kind == "network":
            assert planes_from(entries["planes"]) == cases.PLANES
            assert entries["planes"]["alphas"] == [0.5, 1.0, 2.0]
        else:
            assert "planes" not in entries


def test_an_aperture_is_exported_with_its_operator():
    refocuser = cases.operator(interpolation="cubic", fill=1.0).through(lambda grid: apertures.gaussian(grid, 1.0))
    subject = graphs.exportable(refocuser, cases.SLOPES, cases.GRID)
    inputs = subject.inputs(cases.FIELDS[:1])
    torch.testing.assert_close(subject.graph.module(*inputs), subject.reference(*inputs), atol=3e-6, rtol=0)
    assert len(subject.manifest_entries["config"]["weights"]) == 3


@pytest.mark.parametrize(
    "refocuser", [OperatorRefocuser("slice", fourier_slice), cases.operator(positions=torch.zeros(3, 3, 2))]
)
def test_what_no_graph_does_is_a_line(refocuser):
    with pytest.raises(
        InputError, match=r"must be a network, a refiner, shift-and-sum, exact|must be numbers; got positions"
    ):
        graphs.exportable(refocuser, cases.PLANES, cases.GRID)


def test_a_network_that_names_no_channels_has_three():
    network = RefNet(n_planes=2, grid=(3, 3), widths=(4, 4), stem_width=4, n_blocks=2).requires_grad_(False)
    network.config = {key: value for key, value in network.config.items() if key != "channels"}
    subject = graphs.exportable(NetworkRefocuser(network, even_planes(2), "own"), even_planes(2), (3, 3))
    assert subject.graph.example[0].shape[-3] == 3
