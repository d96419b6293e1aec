"""Steps in which layers are painted: passes that leave out the surfaces that they would not change."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from lfref.simulator import canvases, layers, lookups, planner
from lfref.simulator import layers as extents
from lfref.simulator.blurs import Bitmap
from lfref.simulator.canvases import OVERSAMPLING, Box, Canvas
from lfref.simulator.layers import Highlight, Layer, Reflection, hides
from lfref.simulator.materials import Glass, Glossy, Mirror
from lfref.simulator.mattes import Full
from lfref.simulator.planner import Pass
from lfref.simulator.scene import Camera, Scene, Surface
from lfref.simulator.surfaces import Geometry, Plane
from lfref.simulator.textures import Flat


@dataclass(frozen=True)
class Order:
    """What is to be painted, and for what."""

    scene: Scene
    device: torch.device
    reach: float
    """Greatest |slope|, in pixels per view step, that the layers will be refocused at."""

    @functools.cached_property
    def from_far_to_near(self) -> tuple[int, ...]:
        """Places of all surfaces in the scene's list, sorted by their mean disparity."""
        size = self.scene.camera.size
        shapes = [surface.geometry for surface in self.scene.surfaces]
        return tuple(sorted(range(len(shapes)), key=lambda place: sum(shapes[place].disparity_range(size))))

    @functools.cached_property
    def shown(self) -> tuple[int, ...]:
        """Places of the surfaces that no nearer one hides all over, from wherever they are looked at."""
        order = self.from_far_to_near
        return tuple(
            far for rank, far in enumerate(order) if not any(self._hides(near, far) for near in order[rank + 1 :])
        )

    @functools.cached_property
    def crossing(self) -> frozenset[int]:
        """Places of the surfaces shown that are before another one at some point, and behind it at another."""
        shapes = [self.surface(place).geometry for place in self.shown]
        pairs = extents.crossing(shapes, self.scene.camera, self.reach)
        return frozenset(self.shown[rank] for pair in pairs for rank in pair)

    def surface(self, place: int) -> Surface:
        """The surface at a place of the scene's list."""
        return self.scene.surfaces[place]

    def _hides(self, near: int, far: int) -> bool:
        one, other = self.surface(near), self.surface(far)
        return hides(one) and extents.is_before(one.geometry, other.geometry, self.scene.camera, self.reach)


class Change(NamedTuple):
    """One change of layers."""

    name: str
    needs: str
    """Name of the layers that it takes."""
    makes: str
    """Name of the layers that it makes."""
    make: Callable[[Order, Layer], Layer]
    is_idle: Callable[[Order, int], bool]
    """Whether it would leave the surface at a place of the scene's list as it is."""
    why: str
    """Said where it would leave all of them."""

    def planned(self, order: Order, force: bool = False) -> Pass:
        """The change as a pass.

        Args:
            order: What it works on.
            force: Change layers too that stay as they are.
        """
        reason = self.why if all(self.is_idle(order, place) for place in order.shown) else None
        return Pass(self.name, (self.needs,), self.makes, functools.partial(self._changed, order, force), reason)

    def _changed(self, order: Order, force: bool, layers: Sequence[Layer]) -> list[Layer]:
        return [self.make(order, layer) if force or not self.is_idle(order, layer.place) else layer for layer in layers]


# PART bitmaps
# Painting the surfaces of a scene, step by step, on the CPU: so layers are the same on every device.
#
# Letters: `h w` rows and columns of a canvas.


def paint(scene: Scene, device: str | torch.device = "cpu", reach: float = 0.0) -> list[Layer]:
    """Paint all surfaces of a scene that can be seen.

    Args:
        scene: The scene.
        device: Where the layers go.
        reach: Greatest |slope|, in pixels per view step, that the layers will be refocused at.

    Returns:
        Layers from far to near (by their mean disparity), large enough for every aperture point.

    Raises:
        FileError: A picture cannot be read.
    """
    painted: list[Layer] = planner.plan(passes(scene, device, reach), ["layers"]).run()["layers"]
    return painted


def passes(scene: Scene, device: str | torch.device = "cpu", reach: float = 0.0, force: bool = False) -> list[Pass]:
    """The passes that turn a scene into the result `layers`.

    Args:
        scene: The scene.
        device: Where the layers go.
        reach: As in `paint`.
        force: Passes that run change all layers, those too that stay as they are.
    """
    order = Order(scene, torch.device(device), reach)
    all_shown = None if len(order.shown) < len(scene.surfaces) else "no surface hides all of another"
    return [
        Pass("line up", (), "surfaces", lambda: order.from_far_to_near),
        Pass("leave out hidden", ("surfaces",), "shown", lambda _: order.shown, all_shown),
        Pass("paint", ("shown",), "painted", functools.partial(_painted, order)),
        *(change.planned(order, force) for change in CHANGES),
    ]


def _painted(order: Order, places: Sequence[int]) -> list[Layer]:
    """Colours without light, opaque all over."""
    return [_colours(order, place) for place in places]


def _colours(order: Order, place: int) -> Layer:
    surface = order.surface(place)
    canvas = _canvas(order, surface.geometry, surface)
    samples = _opaque(canvas, surface.texture.painted(canvas, (order.scene.seed, place)))
    return Layer(surface, Bitmap(canvas, samples), place)


def _opaque(canvas: Canvas, colours: Tensor) -> Tensor:
    samples = torch.empty(4, canvas.height, canvas.width)
    samples[:3], samples[3] = colours, 1
    return samples


def _lit(order: Order, layer: Layer) -> Layer:
    return _times(layer, _gains(order, layer.surface))


def _gains(order: Order, surface: Surface) -> Tensor:
    """What light multiplies colours by, and opacity by 1, [4, 1, 1]."""
    own_gain, light = surface.material.own_gain, order.scene.light
    gains = [part * light.gain if own_gain is None else own_gain for part in light.colour]
    return torch.tensor([*gains, 1.0])[:, None, None]


def _is_lit(order: Order, place: int) -> bool:
    return bool((_gains(order, order.surface(place)) == 1).all())


def _thinned(order: Order, layer: Layer) -> Layer:
    own, total = _opacities(layer.surface)
    return _times(layer, torch.tensor([own, own, own, total])[:, None, None])


def _opacities(surface: Surface) -> tuple[float, float]:
    """Share of its own colours, and of all that it hides."""
    return surface.opacity * (1 - surface.material.reflectance), layers.total_opacity(surface)


def _is_opaque(order: Order, place: int) -> bool:
    return _opacities(order.surface(place)) == (1, 1)


def _outlined(order: Order, layer: Layer) -> Layer:
    canvas = layer.bitmap.canvas
    return _times(layer, layer.surface.matte.opacity(canvas.x.float(), canvas.y.float()))


def _is_full(order: Order, place: int) -> bool:
    return isinstance(order.surface(place).matte, Full)


def _smeared(order: Order, layer: Layer) -> Layer:
    """The mean of a bitmap over its way during the exposure."""
    samples, motion = layer.bitmap.samples, layer.surface.motion
    n_places = math.ceil(OVERSAMPLING * math.hypot(*motion)) + 1
    way = OVERSAMPLING * ((torch.arange(n_places, dtype=torch.float64) + 0.5) / n_places - 0.5)
    height, width = samples.shape[-2:]
    i = torch.arange(width, dtype=torch.float64) - way[:, None, None] * motion[0]
    j = torch.arange(height, dtype=torch.float64)[:, None] - way[:, None, None] * motion[1]
    return _with_samples(layer, lookups.on_grid(samples, i, j).mean(0))


def _stands_still(order: Order, place: int) -> bool:
    return order.surface(place).motion == (0, 0)


def _reflecting(order: Order, layer: Layer) -> Layer:
    """A mirror that reflects nothing where the surface is none."""
    own, opacity = layer.surface.material, layers.total_opacity(layer.surface)
    form = layer.surface.geometry.form
    material = own if isinstance(own, Mirror | Glass) else Mirror(0.0, Flat(), form.disparity)
    canvas = _canvas(order, Plane(material.disparity))
    picture = _opaque(canvas, material.texture.painted(canvas, (order.scene.seed, layer.place, 1)))
    picture *= _gains(order, layer.surface)
    share = material.share / opacity if opacity > 0 else 0.0
    return replace(layer, reflection=Reflection(Bitmap(canvas, picture), share, material.disparity))


def _reflects_nothing(order: Order, place: int) -> bool:
    return order.surface(place).material.reflectance == 0


def _shining(order: Order, layer: Layer) -> Layer:
    """A highlight without light where the surface has none."""
    own, light = layer.surface.material, order.scene.light
    material = own if isinstance(own, Glossy) else Glossy(strength=0.0, drift=0.0)
    red, green, blue = (material.strength * light.gain * part for part in light.colour)
    return replace(layer, highlight=Highlight(red, green, blue, material.width, material.drift, *material.centre))


def _is_dull(order: Order, place: int) -> bool:
    material = order.surface(place).material
    return not (isinstance(material, Glossy) and material.strength > 0)


def _traced(order: Order, layer: Layer) -> Layer:
    return replace(layer, is_traced=True)


def _only_shifts(order: Order, place: int) -> bool:
    return layers.only_shifts(order.surface(place))


def _sorted(order: Order, layer: Layer) -> Layer:
    return replace(layer, is_sorted=True)


def _keeps_its_rank(order: Order, place: int) -> bool:
    return place not in order.crossing


def _sent(order: Order, layer: Layer) -> Layer:
    picture = layer.reflection and layer.reflection._replace(picture=layer.reflection.picture.to(order.device))
    return replace(layer, bitmap=layer.bitmap.to(order.device), reflection=picture)


CHANGES = (
    Change("light", "painted", "lit", _lit, _is_lit, "the light is white, of gain 1, and nothing shines"),
    Change("opacity", "lit", "thinned", _thinned, _is_opaque, "all surfaces are opaque"),
    Change("outline", "thinned", "outlined", _outlined, _is_full, "no surface has an edge"),
    Change("motion", "outlined", "smeared", _smeared, _stands_still, "nothing moves"),
    Change("reflection", "smeared", "reflecting", _reflecting, _reflects_nothing, "no mirror, no glass"),
    Change("gloss", "reflecting", "shining", _shining, _is_dull, "no surface is glossy"),
    Change("follow rays", "shining", "traced", _traced, _only_shifts, "from everywhere, all surfaces look but shifted"),
    Change("sort by depth", "traced", "sorted", _sorted, _keeps_its_rank, "no two surfaces cross"),
    Change("send", "sorted", "layers", _sent, lambda order, _: order.device.type == "cpu", "layers stay on the CPU"),
)
"""From colours to layers. The last ones mark what views and truth then have to take into account."""


def _times(layer: Layer, factors: Tensor) -> Layer:
    return _with_samples(layer, layer.bitmap.samples * factors)


def _with_samples(layer: Layer, samples: Tensor) -> Layer:
    return replace(layer, bitmap=Bitmap(layer.bitmap.canvas, samples))


def _canvas(order: Order, geometry: Geometry, surface: Surface | None = None) -> Canvas:
    """What rays can reach of a surface, or of all of a mirrored picture."""
    camera = order.scene.camera
    # The period must not depend on the reach: it decides what random textures look like.
    left, top, right, bottom = _box(camera, geometry, surface, 0.0)
    period = canvases.fast_length(bottom - top + 1), canvases.fast_length(right - left + 1)
    return canvases.covering(_box(camera, geometry, surface, order.reach), period)


def _box(camera: Camera, geometry: Geometry, surface: Surface | None, reach: float) -> Box:
    right, bottom = layers.ends(camera, geometry, reach)
    box = (-right, -bottom, right, bottom)
    if surface and (limits := surface.matte.box()):
        box = canvases.intersection(box, limits)
    # A cubic smears a pixel farther than the motion goes.
    motion = surface.motion if surface else (0.0, 0.0)
    more = [abs(step) / 2 + 1 if step else 0.0 for step in motion]
    return box[0] - more[0], box[1] - more[1], box[2] + more[0], box[3] + more[1]
