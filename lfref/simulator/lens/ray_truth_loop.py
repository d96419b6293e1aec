"""The truth of layers whose rays are followed one by one: the compiled loops, with linear look-ups of blurred copies.

Letters: as in `ray_loop`; `e` relative slope, the way of a point of a layer in pixels per view step.
"""

from typing import NamedTuple

from lfref.functional.jit import compiled, inlined
from lfref.simulator.rays import ray_loop
from lfref.simulator.rays.ray_loop import Atlas, Reals, Row, Sights, Wide
from lfref.simulator.reading import look_loop
from lfref.simulator.reading.look_loop import Quadruple


class Levels(NamedTuple):
    """How much each layer is blurred where it is out of focus."""

    places: Wide
    """Picture to read, counted from the layer's first one, with fractions, at even steps of |e| from 0 on, [K, T]."""
    steps: Wide
    """Steps for each unit of |e|, [K]."""


@compiled
def see(sights: Sights, levels: Levels, atlas: Atlas, k: int, row: Row, at: Wide, rgba: Reals) -> tuple[int, int]:
    """What a row of pixels sees of a layer through a cell.

    Args:
        sights: The layers.
        levels: Their blurs.
        atlas: Their pictures.
        k: Which.
        row: The rays.
        at: Filled where the layer is seen as by `ray_loop.meet`, [5, W].
        rgba: Likewise with premultiplied colours and opacity, [4, W].

    Returns:
        First pixel at which it may be seen, and one past the last.
    """
    begin, stop = ray_loop.reached(sights, k, row, rgba.shape[1])
    if begin >= stop:
        return 0, 0
    ray_loop.meet(sights, k, row, begin, stop, at)
    _read(sights.pictures[k, 0], levels.places[k], levels.steps[k], atlas, row.slope, begin, stop, at, rgba)
    if sights.lobes[k, 3] > 0:
        ray_loop.shine(sights, k, row, begin, stop, at, rgba)
    if sights.pictures[k, 1] >= 0:
        _reflect(sights, atlas, k, row, begin, stop, rgba)
    return begin, stop


@compiled
def _read(
    first: int, places: Wide, steps: float, atlas: Atlas, slope: float, begin: int, stop: int, at: Wide, rgba: Reals
) -> None:
    for x in range(begin, stop):
        step = abs(slope - at[2, x]) * steps
        below = min(int(step), places.size - 2)
        place = places[below] + (step - below) * (places[below + 1] - places[below])
        level = int(place)
        share = rgba.dtype.type(place - level)
        red, green, blue, opacity = _linear(atlas, first + level, at[0, x], at[1, x])
        if share > 0:
            wide = _linear(atlas, first + level + 1, at[0, x], at[1, x])
            red += share * (wide[0] - red)
            green += share * (wide[1] - green)
            blue += share * (wide[2] - blue)
            opacity += share * (wide[3] - opacity)
        rgba[0, x], rgba[1, x], rgba[2, x], rgba[3, x] = red, green, blue, opacity


@compiled
def _reflect(sights: Sights, atlas: Atlas, k: int, row: Row, begin: int, stop: int, rgba: Reals) -> None:
    share, disparity = rgba.dtype.type(sights.mirrors[k, 0]), sights.mirrors[k, 1]
    for x in range(begin, stop):
        at_x, at_y = row.x + x - disparity * row.p, row.y - disparity * row.q
        red, green, blue, _ = _linear(atlas, sights.pictures[k, 1], at_x, at_y)
        light = share * rgba[3, x]
        rgba[0, x] += light * red
        rgba[1, x] += light * green
        rgba[2, x] += light * blue


@inlined
def _linear(atlas: Atlas, n: int, at_x: float, at_y: float) -> Quadruple:
    """A picture at a point."""
    frame = atlas.frames[n]
    i, j = ray_loop.sample_position(frame, at_x, at_y)
    return look_loop.linear(atlas.samples, frame[0], frame[1], frame[2], i, j)
