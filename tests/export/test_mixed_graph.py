"""A mixer's method as one graph computes the pictures of the method, for slopes and sizes unknown when it was made."""

import pytest
import torch

from lfref.encoding import SRGB
from lfref.engines.files import file_formats
from lfref.engines.files.file_formats import FORMATS
from lfref.errors import InputError
from lfref.export import graphs, mixed_graph
from lfref.export.graphs import Samples
from lfref.functional import splines
from lfref.geometry import FocalPlanes
from lfref.nets.mixer import Mixer
from lfref.refocus import apertures
from lfref.refocuser import mixing
from lfref.refocuser.load import load
from lfref.refocuser.networks import MixedRefocuser
from tests.export import cases

PLANES = FocalPlanes([-3.0, -0.6, 0.0, 0.4, 1.0])


def mixed(aperture=None):
    """A mixer that does something."""
    torch.manual_seed(0)
    mixer = Mixer(mixing.N_GUIDES, mixing.N_CANDIDATES, width=8, n_blocks=1).requires_grad_(False)
    for parameter in mixer.parameters():
        torch.nn.init.normal_(parameter, std=0.03)
    return MixedRefocuser(mixer, "mixed", aperture)


def views(grid, size, seed=0):
    """Views of one scene that move by half a pixel per view step, and differ a little."""
    random = torch.Generator().manual_seed(seed)
    coarse = torch.rand(1, 3, 12, 12, generator=random)
    large = torch.nn.functional.interpolate(coarse, (4 * (size[0] + 8), 4 * (size[1] + 8)), mode="bicubic")
    parts = []
    for v in range(grid[0]):
        for u in range(grid[1]):
            window = large[..., 2 * v : 2 * v + 4 * size[0], 2 * u : 2 * u + 4 * size[1]]
            parts.append(torch.nn.functional.avg_pool2d(window, 4)[0])
    light = torch.stack(parts).reshape(*grid, 3, *size)
    return (light + 0.01 * torch.rand(light.shape, generator=random)).clamp(0, 1)


@pytest.mark.parametrize(
    ("grid", "size"), [((5, 5), (36, 45)), ((5, 5), (33, 64)), ((4, 4), (41, 38)), ((3, 5), (36, 36))]
)
def test_a_graph_computes_the_pictures_of_the_method(grid, size):
    subject, light = graphs.exportable(mixed(), PLANES, grid), views(grid, size)
    planes = PLANES.slopes.float()
    result, expected = subject.graph.module(light, planes), subject.reference(light, planes)
    torch.testing.assert_close(result, expected, atol=1e-4, rtol=0)
    # The network matters.
    assert float((expected - mixing.spline_sum(light, PLANES.slopes)).abs().max()) > 1e-2


def test_flat_frames_stay_flat():
    subject = graphs.exportable(mixed(), PLANES, (5, 5))
    for level in (0.0, 0.5, 1.0):
        result = subject.graph.module(torch.full((5, 5, 3, 36, 40), level), PLANES.slopes.float())
        assert float((result - level).abs().max()) < 1e-5


def test_an_aperture_is_part_of_the_graph():
    def aperture(grid):
        return apertures.disc(grid, 4)

    subject, light = graphs.exportable(mixed(aperture), PLANES, (5, 5)), views((5, 5), (36, 45))
    planes = PLANES.slopes.float()
    expected = mixed(aperture).full_precision()
    torch.testing.assert_close(subject.graph.module(light, planes), expected(light, PLANES.slopes), atol=1e-4, rtol=0)


@pytest.mark.parametrize("size", [(24, 31), (16, 17)])
def test_coefficients_of_splines_are_those_of_the_filter(size):
    images = torch.rand(3, *size)
    expected = torch.from_numpy(splines.coefficients(images.numpy()))
    found = mixed_graph.spline_coefficients(images, mixed_graph.spline_powers())
    torch.testing.assert_close(found, expected, atol=5e-6, rtol=0)


@pytest.mark.slow
@pytest.mark.parametrize("format", FORMATS)
def test_one_file_refocuses_any_size_to_any_slopes(format, tmp_path):
    subject = graphs.exportable(mixed(), PLANES, (3, 3), Samples("uint8", SRGB))
    path = tmp_path / f"mixed{FORMATS[format].suffix}"
    file_formats.write(path, format, subject.graph, subject.manifest())
    run, manifest = file_formats.read(path)
    assert manifest.config["operator"] == "mixed"
    loaded, method = load(path), mixed().full_precision()
    for size, slopes in (((36, 45), [-1.0, 0.3]), ((51, 40), [0.0, 0.5, 0.7])):
        samples = (255 * SRGB.encode(views((3, 3), size))).round().to(torch.uint8)
        light = SRGB.decode(samples / 255)
        expected = SRGB.encode(method(light, slopes))
        torch.testing.assert_close(run(samples, torch.tensor(slopes)), expected, atol=2e-4, rtol=0)
        torch.testing.assert_close(SRGB.encode(loaded(light, slopes)), expected, atol=2e-4, rtol=0)
    with pytest.raises(InputError, match=r"reads views \[\.\.\., 3, 3, 3, H, W\]"):
        loaded(torch.rand(3, 3, 1, 36, 45), [0.0])


def test_a_mixer_of_another_runtime_cannot_be_exported():
    method = mixed()
    method.corrector = cases.refiner().corrector
    with pytest.raises(InputError, match="must come from a checkpoint"):
        graphs.exportable(method, PLANES, (3, 3))
