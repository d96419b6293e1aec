"""Painting the surfaces of a scene: passes of the planner that turn a scene into the result `layers`.

Surfaces are sorted from far to near, hidden surfaces are left out, and visible surfaces are painted in full, opaque
colours. Then come changes: light, opacity, outline, motion, mirrored pictures, highlights, and marks for rays and
sorting. The planner skips a change that would leave all layers as they are.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from lfref.functional import fourier
from lfref.simulator import bitmaps, layers, materials, planner
from lfref.simulator.bitmaps import OVERSAMPLING, Bitmap, Box, Canvas
from lfref.simulator.layers import Highlight, Layer, Reflection
from lfref.simulator.materials import Emissive, Glass, Glossy, Mirror
from lfref.simulator.mattes import Full
from lfref.simulator.planner import Pass
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Geometry, Plane
from lfref.simulator.textures import Flat


def paint(scene: Scene, reach: float = 0.0) -> list[Layer]:
    """Layers of all visible surfaces from far to near, large enough to be refocused at slopes of up to `reach`."""
    painted: list[Layer] = planner.run(passes(scene, reach), ["layers"])[0]["layers"]
    return painted


def passes(scene: Scene, reach: float = 0.0, force: bool = False) -> list[Pass]:
    """The passes that turn a scene into the result `layers`; with `force` each one changes all layers."""
    order, visible = far_to_near(scene), visible_surfaces(scene, reach)
    pairs = layers.crossing_pairs([scene.surfaces[index].geometry for index in visible], scene.camera, reach)
    crossing = {visible[rank] for pair in pairs for rank in pair}

    def paint_colours(indices: Sequence[int]) -> list[Layer]:
        painted = []
        for index in indices:
            surface = scene.surfaces[index]
            canvas = reachable_canvas(scene.camera, surface.geometry, reach, surface)
            samples = _opaque(canvas, surface.texture.paint(canvas, (scene.seed, index)))
            painted.append(Layer(surface, Bitmap(canvas, samples), index))
        return painted

    def change(
        name: str, needs: str, makes: str, why_not: str,
        changes: Callable[[Surface], bool], changed: Callable[[Layer], Layer],
    ) -> Pass:  # fmt: skip
        """A pass that changes some layers; `why_not` explains why it changes none."""

        def run(painted: Sequence[Layer]) -> list[Layer]:
            return [changed(layer) if force or changes(layer.surface) else layer for layer in painted]

        is_inert = not any(changes(scene.surfaces[index]) for index in visible)
        return Pass(name, (needs,), makes, run, why_not if is_inert else None)

    hides_none = None if len(visible) < len(order) else "no surface hides all of another"
    return [
        Pass("line up", (), "surfaces", lambda: order),
        Pass("leave out hidden", ("surfaces",), "shown", lambda _: visible, hides_none),
        Pass("paint", ("shown",), "painted", paint_colours),
        change(
            "light", "painted", "lit", "the light is white, of gain 1, and nothing shines",
            lambda surface: bool((_light_gains(scene, surface) != 1).any()),
            lambda layer: _multiplied(layer, _light_gains(scene, layer.surface)),
        ),
        change(
            "opacity", "lit", "thinned", "all surfaces are opaque",
            lambda surface: _opacities(surface) != (1, 1),
            lambda layer: _multiplied(layer, torch.tensor(_opacities(layer.surface))[[0, 0, 0, 1], None, None]),
        ),
        change(
            "outline", "thinned", "outlined", "no surface has an edge",
            lambda surface: not isinstance(surface.matte, Full),
            lambda layer: _multiplied(
                layer, layer.surface.matte.opacity(layer.bitmap.canvas.x.float(), layer.bitmap.canvas.y.float())
            ),
        ),
        change(
            "motion", "outlined", "smeared", "nothing moves", lambda surface: surface.motion != (0, 0), _smeared,
        ),
        change(
            "reflection", "smeared", "reflecting", "no mirror, no glass",
            lambda surface: materials.reflectance(surface.material) != 0,
            lambda layer: _with_reflection(layer, scene, reach),
        ),
        change(
            "gloss", "reflecting", "shining", "no surface is glossy",
            lambda surface: materials.is_glossy(surface.material),
            lambda layer: _with_highlight(layer, scene),
        ),
        # Marks for views and truth.
        change(
            "follow rays", "shining", "traced", "all views of every surface are shifted copies",
            lambda surface: not layers.only_shifts(surface), lambda layer: replace(layer, is_traced=True),
        ),
        change(
            # Equal surfaces cross the same surfaces: identity is enough.
            "sort by depth", "traced", "layers", "no two surfaces cross",
            lambda surface: any(scene.surfaces[index] is surface for index in crossing),
            lambda layer: replace(layer, is_sorted=True),
        ),
    ]  # fmt: skip


def far_to_near(scene: Scene) -> list[int]:
    """Indices of all surfaces, sorted by their mean disparity."""
    size, shapes = scene.camera.size, [surface.geometry for surface in scene.surfaces]
    return sorted(range(len(shapes)), key=lambda index: sum(shapes[index].disparity_range(size)))


def visible_surfaces(scene: Scene, reach: float) -> list[int]:
    """Indices, from far to near, of the surfaces that no nearer backdrop hides from all aperture points."""

    def hides(near: Surface, far: Surface) -> bool:
        return layers.is_backdrop(near) and layers.is_before(near.geometry, far.geometry, scene.camera, reach)

    order, surfaces = far_to_near(scene), scene.surfaces
    return [
        far
        for rank, far in enumerate(order)
        if not any(hides(surfaces[near], surfaces[far]) for near in order[rank + 1 :])
    ]


def reachable_canvas(camera: Camera, geometry: Geometry, reach: float, surface: Surface | None = None) -> Canvas:
    """Canvas for the part of a surface that rays can reach; without a surface, for that part of a mirrored picture."""

    def box(reach: float) -> Box:
        right, bottom = layers.ray_extent(camera, geometry, reach)
        left, top = -right, -bottom
        if surface and (outline := surface.matte.box()):
            left, top = max(left, outline[0]), max(top, outline[1])
            # If outline and reach do not overlap, the box is a point.
            right, bottom = max(left, min(right, outline[2])), max(top, min(bottom, outline[3]))
        # Motion smears a surface by half its length to each side; its cubic look-ups reach one pixel further.
        x, y = (abs(step) / 2 + 1 if step else 0.0 for step in (surface.motion if surface else (0.0, 0.0)))
        return left - x, top - y, right + x, bottom + y

    # The period decides what random textures look like: it must not depend on the reach.
    left, top, right, bottom = box(0.0)
    height, width = (fourier.next_fast_even(math.ceil(length + 1)) for length in (bottom - top, right - left))
    return bitmaps.covering(box(reach), (height, width))


def _opaque(canvas: Canvas, colours: Tensor) -> Tensor:
    samples = torch.empty(4, canvas.height, canvas.width)
    samples[:3], samples[3] = colours, 1
    return samples


def _light_gains(scene: Scene, surface: Surface) -> Tensor:
    """Factors of red, green and blue, and 1 for the opacity, [4, 1, 1]."""
    material, light = surface.material, scene.light
    gains = [material.gain if isinstance(material, Emissive) else part * light.gain for part in light.colour]
    return torch.tensor([*gains, 1.0])[:, None, None]


def _opacities(surface: Surface) -> tuple[float, float]:
    """Opacity of the surface's own colours, without the mirrored picture, and its total opacity."""
    return surface.opacity * (1 - materials.reflectance(surface.material)), layers.total_opacity(surface)


def _multiplied(layer: Layer, factors: Tensor) -> Layer:
    return replace(layer, bitmap=Bitmap(layer.bitmap.canvas, layer.bitmap.samples * factors))


def _smeared(layer: Layer) -> Layer:
    """The mean of the bitmap at evenly spaced times of the exposure, at most one sample apart."""
    samples, motion = layer.bitmap.samples, layer.surface.motion
    n_times = math.ceil(OVERSAMPLING * math.hypot(*motion)) + 1
    shift = OVERSAMPLING * ((torch.arange(n_times, dtype=torch.float64) + 0.5) / n_times - 0.5)
    height, width = samples.shape[-2:]
    i = torch.arange(width, dtype=torch.float64) - shift[:, None, None] * motion[0]
    j = torch.arange(height, dtype=torch.float64)[:, None] - shift[:, None, None] * motion[1]
    return replace(layer, bitmap=Bitmap(layer.bitmap.canvas, bitmaps.cubic_on_grid(samples, i, j).mean(0)))


def _with_reflection(layer: Layer, scene: Scene, reach: float) -> Layer:
    """The layer with its mirrored picture; a surface that mirrors nothing gets a mirror of share 0."""
    own, opacity = layer.surface.material, layers.total_opacity(layer.surface)
    material = own if isinstance(own, Mirror | Glass) else Mirror(0.0, Flat(), layer.surface.geometry.form.disparity)
    canvas = reachable_canvas(scene.camera, Plane(material.disparity), reach)
    picture = _opaque(canvas, material.texture.paint(canvas, (scene.seed, layer.index, 1)))
    picture *= _light_gains(scene, layer.surface)
    # `Reflection.share` is the share of the light per unit of the surface's opacity.
    share = material.share / opacity if opacity > 0 else 0.0
    return replace(layer, reflection=Reflection(Bitmap(canvas, picture), share, material.disparity))


def _with_highlight(layer: Layer, scene: Scene) -> Layer:
    """The layer with its highlight; a surface without one gets a highlight without light."""
    own, light = layer.surface.material, scene.light
    material = own if isinstance(own, Glossy) else Glossy(strength=0.0, drift=0.0)
    red, green, blue = (material.strength * light.gain * part for part in light.colour)
    return replace(layer, highlight=Highlight(red, green, blue, material.width, material.drift, *material.centre))
