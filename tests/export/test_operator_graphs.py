"""Graphs of operators compute what the operators compute, for slopes and sizes that nobody knew when they were made."""

import functools
import itertools

import pytest
import torch

from lfref.encoding import LINEAR, SRGB
from lfref.engines.files import file_formats
from lfref.engines.files.file_formats import FORMATS
from lfref.errors import InputError
from lfref.export import graphs, operator_graphs
from lfref.export.graphs import Samples
from lfref.geometry import FocalPlanes
from lfref.refocus import apertures, footprint
from lfref.refocus.fourier.exact import exact_fourier
from lfref.refocus.sampling import BORDERS, INTERPOLATIONS
from lfref.refocus.shift.shift_and_sum import disparity_range, shift_and_sum, shift_and_sum_through_cells
from lfref.refocuser.load import load
from lfref.refocuser.refocuser import OperatorRefocuser

SLOPES = [-2.9, -1.3, -0.5, 0.0, 0.21, 1.0, 2.0, 1 / 3, 0.1]
SIZES = [((5, 5), 3, (31, 45)), ((7, 7), 1, (24, 24)), ((3, 4), 1, (20, 33)), ((1, 1), 1, (9, 8))]
"""Grid, channels, height and width: even and odd ones, square, smaller than a block along an axis."""


def subject(operator=shift_and_sum, grid=(5, 5), samples=graphs.LINEAR, aperture=None, **options):
    refocuser = OperatorRefocuser("operator", functools.partial(operator, **options), aperture)
    return graphs.exportable(refocuser, FocalPlanes([0.0]), grid, samples)


def fitting(slopes, grid, size, fill=0.0):
    """The slopes that operators take for these views: corners move by less than half a view, no box exceeds it."""
    reach = (max(grid) - 1) / 2
    return [s for s in slopes if abs(s) * reach < min(size) / 2 and fill * abs(s - 0.3) <= max(size)]


def error(operator, grid, channels, size, slopes=SLOPES, **options):
    """Largest distance of a graph from its operator in float64."""
    views = torch.rand(*grid, channels, *size)
    planes = fitting(slopes, grid, size, options.get("fill", 0.0))
    result = subject(operator, grid, **options).graph.module(views, torch.tensor(planes))
    expected = operator(views.double(), torch.tensor(planes, dtype=torch.float64), **options)
    assert result.shape == expected.shape
    return float((result - expected).abs().max())


@pytest.mark.parametrize(("interpolation", "border"), list(itertools.product(INTERPOLATIONS, BORDERS)))
def test_shift_and_sum_is_computed_for_any_slopes_and_sizes(interpolation, border):
    for fill in (0.0, 1.0):
        options = {"interpolation": interpolation, "border": border, "fill": fill, "disparity": 0.3}
        if border == "wrap" and fill:
            with pytest.raises(InputError, match="border without wrap"):
                subject(**options)
        else:
            assert max(error(shift_and_sum, *each, **options) for each in SIZES) < 2e-6, fill


@pytest.mark.parametrize("fill", [0.0, 1.0])
def test_exact_fourier_is_computed_for_any_slopes_and_sizes(fill):
    for grid, channels, size in SIZES:
        assert error(exact_fourier, grid, channels, size, fill=fill, disparity=0.3) < 3e-6
    # Large spectra round more: without its mean, a picture of this size was off by 2e-5.
    assert error(exact_fourier, (1, 3), 1, (200, 301), [0.0, 1.7]) < 3e-6


@pytest.mark.parametrize("operator", [shift_and_sum, exact_fourier])
def test_a_single_pixel_and_a_single_plane_are_computed(operator):
    assert error(operator, (1, 1), 2, (1, 1), [0.5]) < 1e-6
    assert error(operator, (3, 3), 1, (5, 4), [1.9]) < 1e-6


@pytest.mark.parametrize("interpolation", ["linear", "exact"])
def test_slopes_near_the_limit_are_computed(interpolation):
    limit = 15.5 / 3 - 1e-3
    assert error(shift_and_sum, (7, 7), 1, (31, 33), [limit, -limit], interpolation=interpolation) < 2e-6


@pytest.mark.parametrize("interpolation", ["nearest", "linear"])
def test_shifts_that_float32_cannot_hold_are_those_that_were_meant(interpolation):
    # Thirds of whole and of half pixels: 3 times their float32 is beyond a pixel or a half by rounding, and a column
    # of samples at the border would count, or not, or be the next one.
    slopes = [1 / 3, -1 / 3, 2 / 3, 4 / 3, 1 / 6, -1 / 6, 5 / 6, 0.7 / 0.3]
    assert error(shift_and_sum, (7, 7), 1, (24, 24), slopes, interpolation=interpolation) < 2e-6


def test_shifts_next_to_whole_pixels_are_not_whole():
    # A millionth of a pixel beyond the border is no sample; it is four times the rounding of float32.
    slopes = [1 + 1e-6, 1 - 1e-6, -1 - 1e-6]
    assert error(shift_and_sum, (3, 3), 1, (8, 8), slopes) < 5e-6


def test_an_aperture_weighs_the_views():
    for operator, options in ((shift_and_sum, {"interpolation": "exact"}), (shift_and_sum, {}), (exact_fourier, {})):
        exported = subject(operator, aperture=lambda grid: apertures.disc(grid, 3.5), **options)
        views, slopes = torch.rand(5, 5, 1, 26, 31), torch.tensor([0.7, -1.0])
        expected = operator(views, slopes, weights=apertures.disc((5, 5), 3.5), **options)
        torch.testing.assert_close(exported.graph.module(views, slopes), expected, atol=2e-6, rtol=0)


def test_a_pixel_is_what_a_slow_loop_adds_up():
    views, slope = torch.rand(3, 3, 1, 12, 13), 0.75
    result = subject(grid=(3, 3)).graph.module(views, torch.tensor([slope]))[0, 0]
    for y, x in ((0, 0), (5, 6), (11, 12), (0, 7)):
        total = count = 0.0
        for v, u in itertools.product(range(3), repeat=2):
            row, column = y + slope * (v - 1), x + slope * (u - 1)
            if 0 <= row <= 11 and 0 <= column <= 12:
                total, count = total + read(views[v, u, 0], row, column), count + 1
        assert abs(float(result[y, x]) - total / count) < 1e-6


def read(image, row, column):
    total = 0.0
    for y, x in itertools.product((int(row), int(row) + 1), (int(column), int(column) + 1)):
        weight = max(0, 1 - abs(row - y)) * max(0, 1 - abs(column - x))
        total += weight * float(image[y, x]) if weight else 0.0
    return total


def test_boxes_of_any_width_have_the_taps_of_the_operator():
    widths = torch.cat([torch.linspace(0, 12, 97), torch.tensor([63.9, 64.0, 64.1, 201.3, 256.0, 257.3, 511.2])])
    length = 600
    image = torch.zeros(len(widths), 1, 1, length)
    image[..., length // 2] = 1.0
    blurred = operator_graphs.Box("zero")(image, widths)[:, 0, 0]
    for width, line in zip(widths.tolist(), blurred, strict=True):
        taps = torch.tensor(footprint.taps(width))
        half = len(taps) // 2
        middle = taps[half]
        expected = torch.zeros(length)
        expected[length // 2 - half : length // 2 + half + 1] = taps * middle  # a box of one row: its middle tap
        torch.testing.assert_close(line, expected, atol=2e-6 if width <= 256 else 1e-5 * middle, rtol=0)


@pytest.mark.parametrize("samples", ["float32", "uint8", "uint16"])
@pytest.mark.parametrize("encoding", [LINEAR, SRGB])
def test_views_are_read_as_pictures_hold_them(samples, encoding):
    exported = subject(grid=(3, 3), samples=Samples(samples, encoding), interpolation="cubic")
    light = torch.rand(3, 3, 3, 20, 24)
    views = Samples(samples, encoding).of_light(light)
    assert views.dtype == getattr(torch, samples)
    slopes = [0.4, -1.0]
    stack = exported.graph.module(views, torch.tensor(slopes))
    expected = encoding.encode(shift_and_sum(light, slopes, "cubic"))
    rounding = {"float32": 1e-5, "uint8": 0.5 / 255 + 0.004, "uint16": 1e-4}[samples]
    assert float((stack - expected).abs().max()) < rounding


def waves(grid, channels, size, disparities):
    """Views of crossed waves; the upper and the lower half have disparities of their own, in pixels per view step."""
    v, u = ((torch.arange(n) - (n - 1) / 2)[:, None, None] for n in grid)
    y, x = torch.arange(size[0])[:, None] * 1.0, torch.arange(size[1]) * 1.0
    d = torch.where(y < size[0] / 2, *disparities)
    rows, columns = (y - d * v)[:, None, None], (x - d * u)[None, :, None]
    phase = torch.arange(channels)[:, None, None] * 0.5
    return 0.5 + 0.2 * (0.5 * columns + 0.3 * rows + phase).sin() + 0.2 * (0.25 * columns - 0.4 * rows).sin()


@pytest.mark.parametrize(
    ("grid", "channels", "size", "disparities"),
    [
        ((5, 5), 3, (128, 160), (-1.0, -0.7)),  # reduced by 4
        ((7, 7), 1, (99, 70), (-0.8, 0.3)),  # reduced by 2
        ((3, 4), 3, (64, 65), (0.0, 0.5)),
        ((1, 5), 1, (20, 20), (0.3, 0.3)),
        ((1, 1), 2, (9, 9), (0.0, 0.0)),
        ((3, 3), 1, (1, 1), (0.0, 0.0)),
        ((3, 3), 1, (5, 130), (0.1, 0.3)),
    ],
)
def test_cells_are_those_of_the_range_of_disparities(grid, channels, size, disparities):
    views = waves(grid, channels, size, disparities)
    slopes = fitting([-3.0, -1.5, -0.4, 0.0, 0.3, 1.2, 2.4], grid, size)
    exported = subject(shift_and_sum_through_cells, grid)
    assert disparity_range(views).sure is None
    for shown in (views, torch.zeros_like(views), torch.full_like(views, 0.5)):
        result = exported.graph.module(shown, torch.tensor(slopes))
        torch.testing.assert_close(result, shift_and_sum_through_cells(shown, slopes), atol=3e-6, rtol=0)


def test_cells_follow_the_views_that_an_aperture_leaves_open():
    weights = torch.zeros(5, 5)
    weights[:, 1] = weights[3] = 1.0
    views, slopes = waves((5, 5), 1, (40, 60), (-0.6, 0.2)), [-2.5, 0.0, 1.5]
    exported = subject(shift_and_sum_through_cells, aperture=lambda grid: weights)
    expected = shift_and_sum_through_cells(views, slopes, weights)
    torch.testing.assert_close(exported.graph.module(views, torch.tensor(slopes)), expected, atol=3e-6, rtol=0)


@pytest.mark.slow
@pytest.mark.parametrize("format", FORMATS)
def test_files_choose_cells_and_refuse_disparities_that_they_cannot_find(format, tmp_path):
    if format != "pt2":
        pytest.importorskip("onnxruntime")
        pytest.importorskip("openvino")
    exported = subject(shift_and_sum_through_cells, (3, 3))
    path = tmp_path / f"file{FORMATS[format].suffix}"
    file_formats.write(path, format, exported.graph, exported.manifest())
    loaded = load(path)
    for channels, size, slopes in ((3, (128, 150), [-3.0, 0.2]), (1, (41, 37), [2.0])):
        views = waves((3, 3), channels, size, (-0.4, 0.2))
        torch.testing.assert_close(loaded(views, slopes), shift_and_sum_through_cells(views, slopes), atol=1e-5, rtol=0)
    with pytest.raises(InputError, match="less than about 3 pixels per view step"):
        loaded(waves((3, 3), 1, (48, 48), (4.0, 4.0)), [0.0])


def test_an_onnx_file_tells_a_stranger_what_it_reads_and_makes(tmp_path):
    onnx = pytest.importorskip("onnx")
    exported = subject(grid=(2, 2), samples=Samples("uint8", SRGB))
    manifest = exported.manifest(version="1.2.3", license="MIT")
    file_formats.write(tmp_path / "file.onnx", "onnx", exported.graph, manifest)
    model = onnx.load(tmp_path / "file.onnx")
    onnx.checker.check_model(model, full_check=True)
    axes = {
        value.name: [place.dim_param or place.dim_value for place in value.type.tensor_type.shape.dim]
        for value in (*model.graph.input, *model.graph.output)
    }
    assert axes == {"views": [2, 2, "C", "H", "W"], "slopes": ["N"], "stack": ["N", "C", "H", "W"]}
    notes = {value.name: value.doc_string for value in (*model.graph.input, *model.graph.output)}
    assert notes == dict(manifest.notes)
    assert "view row, grows downwards" in notes["views"]
    assert "255 is white, encoded as srgb" in notes["views"]
    assert (
        "pixels per view step. A point whose picture moves by d pixels to the right when u grows by 1"
        in notes["slopes"]
    )
    entries = {entry.key: entry.value for entry in model.metadata_props}
    told = {name: entries[f"lfref_{name}"] for name in ("version", "license", "samples", "encoding")}
    assert told == {"version": "1.2.3", "license": "MIT", "samples": "uint8", "encoding": "srgb"}
    assert (model.producer_name, model.producer_version) == ("lfref", "1.2.3")
    other = subject(grid=(2, 2), samples=Samples("uint8", SRGB), border="edge").manifest()
    assert len(manifest.sha256) == 64
    assert manifest.sha256 != other.sha256


def test_options_that_are_no_numbers_are_refused():
    with pytest.raises(InputError, match="must be numbers; got disparity"):
        subject(fill=1.0, disparity=torch.zeros(20, 20))


KINDS = {
    "linear": (shift_and_sum, {}),
    "nearest_edge": (shift_and_sum, {"interpolation": "nearest", "border": "edge"}),
    "cubic_fill": (shift_and_sum, {"interpolation": "cubic", "fill": 1.0, "disparity": 0.2}),
    "exact": (shift_and_sum, {"interpolation": "exact"}),
    "cubic_wrap": (shift_and_sum, {"interpolation": "cubic", "border": "wrap"}),
    "fourier": (exact_fourier, {"fill": 0.5}),
}
HARD = [((7, 9), 1, [0.0]), ((40, 31), 3, SLOPES), ((24, 32), 1, [2.0, -1.0]), ((33, 33), 2, [2.6])]
"""Size, channels, slopes."""


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize(
    "kind", [kind if kind == "linear" else pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS]
)
def test_files_compute_what_their_operator_computes(kind, format, tmp_path):
    if format != "pt2":
        pytest.importorskip("onnxruntime")
        pytest.importorskip("openvino")
    operator, options = KINDS[kind]
    samples = Samples("uint8", SRGB) if kind == "cubic_fill" else graphs.LINEAR
    exported = subject(operator, (3, 3), samples, **options)  # exporters take seconds, and unroll rows of views
    path = tmp_path / f"file{FORMATS[format].suffix}"
    file_formats.write(path, format, exported.graph, exported.manifest(version="1.2.3", license="MIT"))
    loaded, (run, manifest) = load(path), file_formats.read(path)
    assert (manifest.license, manifest.samples, manifest.encoding) == ("MIT", samples.type, str(samples.encoding))
    for size, channels, slopes in HARD:
        light = torch.rand(3, 3, channels, *size)
        planes = fitting(slopes, (3, 3), size, options.get("fill", 0.0))
        for shown in (light, torch.zeros_like(light)):
            views = samples.of_light(shown)
            same = graphs.manifest.to_light(views, samples.type, samples.encoding)
            stack = run(views, torch.tensor(planes))
            expected = operator(same.double(), torch.tensor(planes, dtype=torch.float64), **options)
            difference = samples.encoding.decode(stack) - expected
            assert float(difference.abs().max()) < 1e-5, (size, channels, slopes)
        torch.testing.assert_close(loaded(same, planes), expected.float(), atol=1e-5, rtol=0)
