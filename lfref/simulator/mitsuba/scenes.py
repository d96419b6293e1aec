"""Scenes that both `lfref.simulate` and Mitsuba render: all that geometry can do wrong, bright enough to sharpen."""

from torch import Tensor

from lfref.simulator.materials import Emissive, Mirror
from lfref.simulator.mattes import Disc, Polygon
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Flat, Noise, Stripes

SIZE = (64, 96)
SLOPES = (-1.0, 0.3, 0.9)
"""Of the pictures that are compared: behind, among and before what there is to see, in pixels per view step."""
VIEWS = ((3, 3), (0, 0), (6, 1))
"""Row and column of the views that are compared: the middle, a corner, an edge."""
SHINES = Emissive()


def cards(aperture: str = "disc") -> Scene:
    """A background, a half-opaque disc and a card that hides both."""
    wall = Surface(Plane(-1.0), Noise((0.5, 0.4, 0.4), (0.25, 0.25, 0.2)), material=SHINES)
    pane = Surface(Plane(0.3), Stripes(9.0, angle=20), Disc(14.0, (-20.0, 4.0)), SHINES, opacity=0.6)
    checker = Checker(12.0, (0.3, 0.2, 0.25), (0.9, 0.8, 0.4), angle=30)
    return _scene("cards", aperture, wall, pane, Surface(Plane(0.9), checker, _card(2.5, -14, 30, 17.25), SHINES))


def relief(aperture: str = "disc") -> Scene:
    """A slanted background behind a dome, so that disparity changes all over the picture."""
    wall = Surface(Plane(-1.0, (0.008, -0.006)), Noise((0.4, 0.5, 0.6), (0.2, 0.3, 0.3)), material=SHINES)
    ball = Surface(Dome(0.2, 0.6, 30.0), Noise((0.7, 0.6, 0.4), (0.2, 0.2, 0.2)), Disc(22.0, (6.0, -2.0)), SHINES)
    return _scene("relief", aperture, wall, ball)


def mirror(aperture: str = "disc") -> Scene:
    """A mirror before a background; what it shows stands behind the cameras."""
    wall = Surface(Plane(-1.5), Noise((0.4, 0.4, 0.5), (0.2, 0.2, 0.3)), material=SHINES)
    shown = Mirror(0.8, Checker(14.0, (0.3, 0.3, 0.3), angle=15), disparity=-2.0)
    return _scene("mirror", aperture, wall, Surface(Plane(0.5), Flat((0.8, 0.3, 0.2)), _card(-30, -20, 25, 20), shown))


def matte() -> Scene:
    """One slanted matte surface under a coloured light."""
    wall = Surface(Plane(0.2, (0.01, 0.004)), Noise((0.5, 0.5, 0.5), (0.25, 0.25, 0.25)))
    return Scene(Camera((7, 7), (32, 48)), (wall,), Light(1.5, (1.0, 0.8, 0.5)), name="matte")


SCENES = (cards, relief, mirror)


def apart_from_edges(image: Tensor, truth: Tensor) -> float:
    """PSNR of pictures, [3, H, W], without the worst twentieth of their pixels: those that edges run through."""
    errors = (image - truth).double().square().mean(0).flatten().sort().values
    return float(-10 * errors[: len(errors) * 19 // 20].mean().log10())


def _scene(name: str, aperture: str, *surfaces: Surface) -> Scene:
    return Scene(Camera((7, 7), SIZE, aperture), surfaces, name=name)


def _card(left: float, top: float, right: float, bottom: float) -> Polygon:
    return Polygon(((left, top), (right, top), (right, bottom), (left, bottom)))
