"""Painting the surfaces of a scene: passes of the planner that turn a scene into the result `layers`.

Surfaces are lined up from far to near, hidden ones are left out, and the rest is painted in full, opaque colours.
Changes follow, each of which the planner skips if it would leave all layers as they are: light, opacity, outline,
motion, mirrored pictures, highlights, and marks for rays and sorting. All is painted on the CPU, so that layers are the
same on every device.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.simulator import bitmaps, layers, planner
from lfref.simulator.bitmaps import OVERSAMPLING, Bitmap, Box, Canvas
from lfref.simulator.layers import Highlight, Layer, Reflection
from lfref.simulator.materials import Glass, Glossy, Mirror
from lfref.simulator.mattes import Full
from lfref.simulator.planner import Pass
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Geometry, Plane
from lfref.simulator.textures import Flat


@dataclass(frozen=True)
class Painting:
    """A scene to be painted, and the order of its surfaces."""

    scene: Scene
    device: torch.device
    reach: float  # greatest |slope|, in pixels per view step, that the layers will be refocused at

    @functools.cached_property
    def far_to_near(self) -> tuple[int, ...]:
        """Indices of all surfaces, sorted by their mean disparity."""
        size = self.scene.camera.size
        shapes = [surface.geometry for surface in self.scene.surfaces]
        return tuple(sorted(range(len(shapes)), key=lambda index: sum(shapes[index].disparity_range(size))))

    @functools.cached_property
    def visible(self) -> tuple[int, ...]:
        """Indices of the surfaces that no nearer backdrop hides from everywhere."""
        order = self.far_to_near

        def hides(near: int, far: int) -> bool:
            one, other = self.scene.surfaces[near], self.scene.surfaces[far]
            return layers.is_backdrop(one) and layers.is_before(
                one.geometry, other.geometry, self.scene.camera, self.reach
            )

        return tuple(far for rank, far in enumerate(order) if not any(hides(near, far) for near in order[rank + 1 :]))

    @functools.cached_property
    def crossing(self) -> frozenset[int]:
        """Indices of the visible surfaces that cross another one."""
        shapes = [self.scene.surfaces[index].geometry for index in self.visible]
        pairs = layers.crossing_pairs(shapes, self.scene.camera, self.reach)
        return frozenset(self.visible[rank] for pair in pairs for rank in pair)


def paint(scene: Scene, device: str | torch.device = "cpu", reach: float = 0.0) -> list[Layer]:
    """Layers of all visible surfaces from far to near (by their mean disparity), large enough for every aperture point.

    `reach` is the greatest |slope|, in pixels per view step, that the layers will be refocused at.
    """
    painted: list[Layer] = planner.plan(passes(scene, device, reach), ["layers"]).run()["layers"]
    return painted


def passes(scene: Scene, device: str | torch.device = "cpu", reach: float = 0.0, force: bool = False) -> list[Pass]:
    """The passes that turn a scene into the result `layers`; with `force` each one changes all layers."""
    painting = Painting(scene, torch.device(device), reach)
    has_hidden = len(painting.visible) < len(scene.surfaces)
    return [
        Pass("line up", (), "surfaces", lambda: painting.far_to_near),
        Pass(
            "leave out hidden",
            ("surfaces",),
            "shown",
            lambda _: painting.visible,
            None if has_hidden else "no surface hides all of another",
        ),
        Pass("paint", ("shown",), "painted", functools.partial(_paint_colours, painting)),
        *(_as_pass(change, painting, force) for change in CHANGES),
    ]


def _paint_colours(painting: Painting, indices: Sequence[int]) -> list[Layer]:
    """Layers in the colours of their textures, without light, opaque all over."""
    painted = []
    for index in indices:
        surface = painting.scene.surfaces[index]
        canvas = _canvas(painting, surface.geometry, surface)
        samples = _opaque(canvas, surface.texture.paint(canvas, (painting.scene.seed, index)))
        painted.append(Layer(surface, Bitmap(canvas, samples), index))
    return painted


def _opaque(canvas: Canvas, colours: Tensor) -> Tensor:
    samples = torch.empty(4, canvas.height, canvas.width)
    samples[:3], samples[3] = colours, 1
    return samples


def _canvas(painting: Painting, geometry: Geometry, surface: Surface | None = None) -> Canvas:
    """The part of a surface that rays can reach; without a surface, all of a mirrored picture."""
    camera = painting.scene.camera
    # The period decides what random textures look like: it must not depend on the reach.
    left, top, right, bottom = _reachable_box(camera, geometry, surface, 0.0)
    period = bitmaps.fast_length(bottom - top + 1), bitmaps.fast_length(right - left + 1)
    return bitmaps.covering(_reachable_box(camera, geometry, surface, painting.reach), period)


def _reachable_box(camera: Camera, geometry: Geometry, surface: Surface | None, reach: float) -> Box:
    right, bottom = layers.ray_extent(camera, geometry, reach)
    box = (-right, -bottom, right, bottom)
    if surface and (outline := surface.matte.box()):
        left, top = max(box[0], outline[0]), max(box[1], outline[1])
        # A point where they do not overlap.
        box = left, top, max(left, min(box[2], outline[2])), max(top, min(box[3], outline[3]))
    # Motion smears half its length to each side, and the cubic look-ups that do it one pixel more.
    motion = surface.motion if surface else (0.0, 0.0)
    more = [abs(step) / 2 + 1 if step else 0.0 for step in motion]
    return box[0] - more[0], box[1] - more[1], box[2] + more[0], box[3] + more[1]


class Change(NamedTuple):
    """One step that changes layers."""

    name: str
    needs: str
    makes: str
    change: Callable[[Painting, Layer], Layer]
    is_inert: Callable[[Painting, Surface], bool]  # whether it leaves the layer of a surface as it is
    why: str  # explanation if it leaves all layers as they are


def _as_pass(change: Change, painting: Painting, force: bool) -> Pass:
    def run(painted: Sequence[Layer]) -> list[Layer]:
        return [
            change.change(painting, layer) if force or not change.is_inert(painting, layer.surface) else layer
            for layer in painted
        ]

    is_inert = all(change.is_inert(painting, painting.scene.surfaces[index]) for index in painting.visible)
    return Pass(change.name, (change.needs,), change.makes, run, change.why if is_inert else None)


def _light_gains(painting: Painting, surface: Surface) -> Tensor:
    """Factors of red, green and blue, and 1 for the opacity, [4, 1, 1]."""
    own_gain, light = surface.material.own_gain, painting.scene.light
    gains = [part * light.gain if own_gain is None else own_gain for part in light.colour]
    return torch.tensor([*gains, 1.0])[:, None, None]


def _light(painting: Painting, layer: Layer) -> Layer:
    return _multiply(layer, _light_gains(painting, layer.surface))


def _opacities(surface: Surface) -> tuple[float, float]:
    """Opacity of its own colours, without what it mirrors, and of all."""
    return surface.opacity * (1 - surface.material.reflectance), layers.total_opacity(surface)


def _thin(painting: Painting, layer: Layer) -> Layer:
    own, total = _opacities(layer.surface)
    return _multiply(layer, torch.tensor([own, own, own, total])[:, None, None])


def _cut_out(painting: Painting, layer: Layer) -> Layer:
    canvas = layer.bitmap.canvas
    return _multiply(layer, layer.surface.matte.opacity(canvas.x.float(), canvas.y.float()))


def _smear(painting: Painting, layer: Layer) -> Layer:
    """The mean of the bitmap at evenly spaced times of the exposure, at most one sample apart."""
    samples, motion = layer.bitmap.samples, layer.surface.motion
    n_times = math.ceil(OVERSAMPLING * math.hypot(*motion)) + 1
    shift = OVERSAMPLING * ((torch.arange(n_times, dtype=torch.float64) + 0.5) / n_times - 0.5)
    height, width = samples.shape[-2:]
    i = torch.arange(width, dtype=torch.float64) - shift[:, None, None] * motion[0]
    j = torch.arange(height, dtype=torch.float64)[:, None] - shift[:, None, None] * motion[1]
    return _with_samples(layer, bitmaps.cubic_on_grid(samples, i, j).mean(0))


def _add_reflection(painting: Painting, layer: Layer) -> Layer:
    """The mirrored picture; forced on a surface without one, a mirror of share 0."""
    own, opacity = layer.surface.material, layers.total_opacity(layer.surface)
    material = own if isinstance(own, Mirror | Glass) else Mirror(0.0, Flat(), layer.surface.geometry.form.disparity)
    canvas = _canvas(painting, Plane(material.disparity))
    picture = _opaque(canvas, material.texture.paint(canvas, (painting.scene.seed, layer.index, 1)))
    picture *= _light_gains(painting, layer.surface)
    share = material.share / opacity if opacity > 0 else 0.0
    return replace(layer, reflection=Reflection(Bitmap(canvas, picture), share, material.disparity))


def _add_highlight(painting: Painting, layer: Layer) -> Layer:
    """The highlight; forced on a surface without one, a lobe without light."""
    own, light = layer.surface.material, painting.scene.light
    material = own if isinstance(own, Glossy) else Glossy(strength=0.0, drift=0.0)
    red, green, blue = (material.strength * light.gain * part for part in light.colour)
    return replace(layer, highlight=Highlight(red, green, blue, material.width, material.drift, *material.centre))


def _has_no_highlight(painting: Painting, surface: Surface) -> bool:
    return not (isinstance(surface.material, Glossy) and surface.material.strength > 0)


def _keeps_its_order(painting: Painting, surface: Surface) -> bool:
    # Equal surfaces cross the same others: identity is enough.
    return not any(painting.scene.surfaces[index] is surface for index in painting.crossing)


def _send(painting: Painting, layer: Layer) -> Layer:
    def sent(bitmap: Bitmap) -> Bitmap:
        return Bitmap(bitmap.canvas, bitmap.samples.to(painting.device))

    reflection = layer.reflection and layer.reflection._replace(picture=sent(layer.reflection.picture))
    return replace(layer, bitmap=sent(layer.bitmap), reflection=reflection)


CHANGES = (
    Change(
        "light", "painted", "lit", _light,
        lambda painting, surface: bool((_light_gains(painting, surface) == 1).all()),
        "the light is white, of gain 1, and nothing shines",
    ),
    Change(
        "opacity", "lit", "thinned", _thin,
        lambda painting, surface: _opacities(surface) == (1, 1), "all surfaces are opaque",
    ),
    Change(
        "outline", "thinned", "outlined", _cut_out,
        lambda painting, surface: isinstance(surface.matte, Full), "no surface has an edge",
    ),
    Change(
        "motion", "outlined", "smeared", _smear,
        lambda painting, surface: surface.motion == (0, 0), "nothing moves",
    ),
    Change(
        "reflection", "smeared", "reflecting", _add_reflection,
        lambda painting, surface: surface.material.reflectance == 0, "no mirror, no glass",
    ),
    Change("gloss", "reflecting", "shining", _add_highlight, _has_no_highlight, "no surface is glossy"),
    Change(
        "follow rays", "shining", "traced", lambda painting, layer: replace(layer, is_traced=True),
        lambda painting, surface: layers.only_shifts(surface), "all views of every surface are shifted copies",
    ),
    Change(
        "sort by depth", "traced", "sorted", lambda painting, layer: replace(layer, is_sorted=True),
        _keeps_its_order, "no two surfaces cross",
    ),
    Change(
        "send", "sorted", "layers", _send,
        lambda painting, surface: painting.device.type == "cpu", "layers stay on the CPU",
    ),
)  # fmt: skip
"""From colours to layers, in this order. `follow rays` and `sort by depth` only mark layers, for views and truth."""


def _multiply(layer: Layer, factors: Tensor) -> Layer:
    return _with_samples(layer, layer.bitmap.samples * factors)


def _with_samples(layer: Layer, samples: Tensor) -> Layer:
    return replace(layer, bitmap=Bitmap(layer.bitmap.canvas, samples))
