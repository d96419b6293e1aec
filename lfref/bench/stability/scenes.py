"""Hard scenes for the simulator: all their surfaces have one colour, so that every view and every plane must have it.

Whatever hides, slants, moves, lets light through or falls between samples, a wrong weight anywhere shows.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from lfref.bench.accuracy import Row
from lfref.bench.stability import trials
from lfref.bench.stability.trials import OURS, Tried
from lfref.simulator.mattes import Disc, Full, Outline
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.simulate import simulate
from lfref.simulator.surfaces import Dome, Geometry, Plane
from lfref.simulator.textures import Flat

CAMERA = Camera(grid=(3, 4), size=(24, 32))
SLOPES = (-7.0, -0.5, 1e-9, 1.0)
COLOUR = 0.5
ALLOWED = 1e-6
"""Error of a colour, as a share of it."""


def rows() -> Iterator[Row]:
    """Try the simulator on every scene.

    Yields:
        Rows as from `trials.trials`, one for the views and one for the truth of each scene.
    """
    for name, scene in SCENES.items():
        for output, values in _simulated(scene).items():
            wanted = scene.light.gain * scene.surfaces[0].texture.colour[0]  # type: ignore[attr-defined]
            right = torch.full_like(values, wanted)
            verdict = trials.compared(Tried(values, None), right, ALLOWED * right.clamp(min=1e-30))
            heading = {"component": f"simulator, {output}", "case": name, "precision": "float32", "formulation": OURS}
            yield heading | verdict


def _simulated(scene: Scene) -> dict[str, Tensor]:
    made = simulate(scene, slopes=torch.tensor(SLOPES, dtype=torch.float64))
    assert made.views is not None
    assert made.truth is not None
    return {"views": made.views.double(), "truth": made.truth.double()}


def _surface(
    geometry: Geometry | float, matte: Outline | None = None, colour: float = COLOUR, **more: object
) -> Surface:
    where = geometry if isinstance(geometry, Geometry) else Plane(geometry)
    return Surface(where, Flat((colour,) * 3), matte or Full(), **more)  # type: ignore[arg-type]


def _scene(*surfaces: Surface, camera: Camera = CAMERA) -> Scene:
    return Scene(camera, surfaces)


_BEHIND = _surface(-0.7)

SCENES: dict[str, Scene] = {
    "a wall": _scene(_surface(0.3)),
    "whole disparity": _scene(_surface(1.0)),
    "half disparity": _scene(_surface(0.5)),
    "disparity 1e-9 from 1": _scene(_surface(1 + 1e-9)),
    "disparity -7": _scene(_surface(-7.0)),
    "black": _scene(_surface(0.3, colour=0.0)),
    "light of 1e6": Scene(CAMERA, (_surface(0.3),), Light(1e6)),
    "light of 1e-30": Scene(CAMERA, (_surface(0.3),), Light(1e-30)),
    "steepest slant": _scene(_surface(Plane(0.0, (0.25, 0.0)))),
    "crossing slants": _scene(_surface(Plane(0.0, (0.1, 0.0))), _surface(Plane(0.0, (-0.1, 0.0)))),
    "dome": _scene(_BEHIND, _surface(Dome(0.2, 0.5, 9.0))),
    "two at one disparity": _scene(_surface(0.5), _surface(0.5, Disc(6.3))),
    "two 1e-12 apart": _scene(_surface(0.5), _surface(0.5 + 1e-12, Disc(6.3))),
    "disc in front": _scene(_BEHIND, _surface(0.8, Disc(6.3))),
    "disc of one pixel": _scene(_BEHIND, _surface(0.8, Disc(0.5))),
    "opacity 0": _scene(_BEHIND, _surface(0.8, Disc(6.3), opacity=0.0)),
    "opacity .5": _scene(_BEHIND, _surface(0.8, Disc(6.3), opacity=0.5)),
    "motion": _scene(_BEHIND, _surface(0.8, Disc(6.3), motion=(3.3, -1.7))),
    "one view": _scene(_BEHIND, _surface(0.8, Disc(6.3)), camera=Camera(grid=(1, 1), size=(24, 32))),
    "round aperture": _scene(_BEHIND, _surface(0.8, Disc(6.3)), camera=Camera((3, 4), (24, 32), "disc")),
}
"""By name."""
