"""Geometry of the page under node: no browser, values against formulas and slow references."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lfref.viewer

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
SOURCE = Path(lfref.viewer.__file__).parent / "geometry.js"
GRID = [[x, y] for y in range(-2, 3) for x in range(-3, 4)]
LENS = {"slope": 0.5, "x": 0, "y": 0, "aperture": 6, "tiltX": 0, "tiltY": 0, "shape": "square"}
WHOLE = LENS | {"slope": 0.25}
CROP = [0, 0, 1, 1]
CENTRE = {"zoom": 1, "x": 0.5, "y": 0.5}
LIMITS = {"low": -1, "high": 1, "reach": [3, 2]}


def computed(expression, **values):
    """Value of a JavaScript expression of the page's functions and of these values."""
    names = ", ".join(values)
    program = f"{SOURCE.read_text()}\nconst {{ {names} }} = JSON.parse(process.argv[1]);\n"
    program += f"console.log(JSON.stringify({expression}))"
    command = ["node", "-e", program, "--", json.dumps(values)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_whole_aperture_weighs_all_cameras_alike_on_any_grid():
    assert computed("cameraWeights(grid, lens, reachOf(grid))", grid=GRID, lens=LENS) == [1] * 35
    row = [[x - 1.5, 0] for x in range(4)]
    assert computed("cameraWeights(grid, lens, reachOf(grid))", grid=row, lens=LENS | {"aperture": 3}) == [1] * 4


@pytest.mark.parametrize(("x", "y"), [(0, 0), (1.25, -0.5), (3, 2)])
def test_a_pinhole_interpolates_between_the_cameras_around_it(x, y):
    weights = computed(
        "cameraWeights(grid, lens, reachOf(grid))", grid=GRID, lens=LENS | {"x": x, "y": y, "aperture": 0}
    )
    assert sum(weights) == pytest.approx(1)
    assert np.average(GRID, axis=0, weights=weights) == pytest.approx([x, y])


def test_shapes_are_what_they_are_called():
    points = [[1, 0], [0, 1], [0.9, 0.9], [0, -1]]
    # At width 1, a place of norm n, between 1/2 and 3/2, has the weight 3/2 - n.
    norms = computed(
        "Object.fromEntries(Object.keys(SHAPES).map((k) => [k, points.map(([x, y]) => 1.5 - SHAPES[k](x, y, 1))]))",
        points=points,
    )
    assert norms["square"] == pytest.approx([1, 1, 0.9, 1])
    assert norms["disc"] == pytest.approx([1, 1, 0.9 * 2**0.5, 1])
    assert norms["hexagon"] == pytest.approx([1, 0.866, 0.9 * 1.366, 0.866])
    heart = norms["heart"]
    assert heart[1] < heart[0], "its point, below, reaches farther than its side"
    assert heart[3] > heart[1], "above there is the notch"


def test_distances_follow_the_dioptres():
    words = computed("[0, 1, -2, -2.5, -3].map((slope) => distanceOf(slope, [0.5, 0.2]))")
    assert words == ["2 m", "1.43 m", "10 m", "infinity", "infinity"]


def seen_slowly(lens, at, disparity_of_row, near):
    """The point seen at `at`: of all points of its line that lie there, the nearest one; None behind an edge."""
    found = []
    for x in np.linspace(0, 1, 20001):
        disparity = disparity_of_row(x)
        slope = lens["slope"] + lens["tiltX"] * (at[0] - 0.5)
        if abs(x + (disparity - slope) * lens["x"] / 200 - at[0]) < 1e-4:
            found.append((near * disparity, x))
    return max(found)[1] if found else None


@pytest.mark.parametrize("near", [1, -1])
@pytest.mark.parametrize("lens", [LENS | {"x": 2}, LENS | {"x": -3, "slope": -0.4}, LENS | {"x": 2.5, "tiltX": 1.0}])
def test_the_nearest_surface_is_seen_from_any_viewpoint_under_any_tilt(lens, near):
    step = "(at) => (at[0] > 0.45 && at[0] < 0.6 ? near * 0.9 : -near * 0.9)"
    scene = {"low": -1, "high": 1, "near": near, "size": [200, 100]}
    points = [[x, 0.5] for x in (0.2, 0.44, 0.5, 0.58, 0.7)]
    seen = computed(
        f"points.map((at) => visiblePoint(lens, at, {step}, scene))", points=points, lens=lens, scene=scene, near=near
    )
    n_known = 0
    for (x, _), (found, _) in zip(points, seen, strict=True):
        expected = seen_slowly(lens, (x, 0.5), lambda x: near * (0.9 if 0.45 < x < 0.6 else -0.9), near)
        assert expected is None or found == pytest.approx(expected, abs=1.5 / 200), x
        n_known += expected is not None
    assert n_known >= 4


def test_a_plane_stands_for_what_the_whole_lens_shows_nearby():
    def held(**part):
        return computed("heldPlane([-1, 0, 1], lens, whole, [3, 2])", lens=WHOLE | part, whole=WHOLE)

    assert held(slope=0.1) == 1
    assert held(slope=0.2) == -1, "the outermost views are .6 px off"
    assert [held(slope=0.1, **part) for part in ({"x": 1}, {"tiltY": 0.1}, {"aperture": 5}, {"shape": "disc"})] == [
        -1
    ] * 4


@settings(max_examples=12, deadline=None)
@given(
    zoom=st.floats(1, 8),
    x=st.floats(0, 1),
    y=st.floats(0, 1),
    factor=st.floats(0.2, 5),
    window=st.tuples(st.integers(100, 3000), st.integers(100, 3000)),
)
def test_zoom_keeps_what_lies_under_the_pointer_unless_an_edge_comes_in(zoom, x, y, factor, window):
    before, after, placed = computed(
        """(() => {
          const place = inside({ zoom, x, y }, crop), size = [300, 200];
          const at = [window[0] * 0.4, window[1] * 0.6];
          const before = pointUnder(boxOf(place, window, crop, size), ...at);
          const next = zoomed(place, factor, before, crop);
          return [before, pointUnder(boxOf(next, window, crop, size), ...at), next];
        })()""",
        zoom=zoom,
        x=x,
        y=y,
        factor=factor,
        window=window,
        crop=CROP,
    )
    room = 0.5 * (1 - 1 / placed["zoom"])
    assert 1 <= placed["zoom"] <= 8
    for axis, name in enumerate("xy"):
        assert abs(placed[name] - 0.5) <= room + 1e-9
        if abs(placed[name] - 0.5) < room - 1e-6:
            assert after[axis] == pytest.approx(before[axis], abs=1e-6)


@pytest.mark.parametrize("shape", ["square", "disc", "hexagon", "heart"])
def test_an_address_holds_the_state(shape):
    lens = {"slope": -0.437, "x": 2.9, "y": -1.55, "aperture": 0.3, "tiltX": 1.2, "tiltY": -0.8, "shape": shape}
    place = {"zoom": 3.25, "x": 0.31, "y": 0.69}
    values = {"lens": lens, "place": place, "whole": WHOLE, "centre": CENTRE, "limits": LIMITS}
    state = computed("stateOf(addressOf(lens, place, whole), whole, centre, limits)", **values)
    assert state["lens"].pop("shape") == lens.pop("shape")
    assert state["lens"] == pytest.approx(lens, abs=1e-3)
    assert state["place"] == pytest.approx(place, abs=1e-3)
