"""Scenes for tests: any legal one, and the views of a scene by the slow way."""

import torch
from hypothesis import strategies as st

from lfref.encoding import CURVES
from lfref.simulator import painting
from lfref.simulator import views as render
from lfref.simulator.effects import recording
from lfref.simulator.effects.optics import Chromatic, Crosstalk, Misalignment, Vignetting
from lfref.simulator.effects.recording import Clipping, Exposure, Mosaic, Quantisation, ToneCurve, WhiteBalance
from lfref.simulator.effects.sensor import Sensor
from lfref.simulator.materials import Emissive, Glass, Glossy, Matte, Mirror
from lfref.simulator.mattes import Disc, Full, Leaf, Perforated, Polygon, Twigs
from lfref.simulator.scene import Camera, Light, Scene, Surface
from lfref.simulator.scenes import RandomScenes
from lfref.simulator.surfaces import Dome, Plane
from lfref.simulator.textures import Checker, Flat, Gradient, Noise, Stripes
from tests.simulator import eager

CAMERA = Camera((3, 4), (26, 33))
SHARE = st.floats(0, 1)
PLACE = st.tuples(st.floats(-30, 30), st.floats(-30, 30))
LEVELS = st.tuples(SHARE, SHARE, SHARE)
TEXTURES = st.one_of(
    st.builds(Flat, LEVELS),
    st.builds(Noise, LEVELS, LEVELS, st.floats(0, 4), SHARE, SHARE),
    *(
        st.builds(kind, st.floats(0.5, 200), LEVELS, LEVELS, st.floats(-360, 360), SHARE)
        for kind in (Gradient, Stripes, Checker)
    ),
)
GEOMETRIES = st.one_of(
    st.builds(Plane, st.floats(-3, 3)),
    st.builds(Plane, st.floats(-3, 3), st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))),
    st.builds(Dome, st.floats(-3, 3), st.floats(-0.6, 0.6), st.floats(10, 60), PLACE),
)
MATTES = st.one_of(
    st.just(Full()),
    st.builds(Disc, st.floats(0.5, 40), PLACE),
    st.builds(Polygon, st.tuples(PLACE, PLACE, PLACE, PLACE)),
    st.builds(Leaf, st.floats(10, 60), st.floats(1, 9), st.floats(0, 360), PLACE),
    st.builds(Twigs, st.floats(1, 20), st.floats(1, 4), st.integers(0, 3), st.floats(0, 360), PLACE, st.integers(0, 9)),
    st.builds(Perforated, st.floats(7, 40), st.floats(0.5, 3), st.floats(0, 90)),
)
MATERIALS = st.one_of(
    st.just(Matte()),
    st.builds(Emissive, st.floats(0, 5)),
    st.builds(Glossy, st.floats(0, 2), st.floats(1, 30), st.floats(-8, 8), PLACE),
    st.builds(Mirror, SHARE, TEXTURES, st.floats(-3, 3)),
    st.builds(Glass, SHARE, TEXTURES, st.floats(-3, 3)),
)
SURFACES = st.builds(
    Surface, GEOMETRIES, TEXTURES, MATTES, MATERIALS, SHARE, st.tuples(st.floats(-4, 4), st.floats(-4, 4))
)
LIGHTS = st.builds(Light, st.floats(0, 3), LEVELS)
EFFECTS = {
    "chromatic": st.builds(Chromatic, st.tuples(*3 * [st.floats(0.9, 1.1)]), st.tuples(*3 * [st.floats(-1, 1)])),
    "vignetting": st.builds(Vignetting, st.floats(0, 2), SHARE),
    "misalignment": st.builds(Misalignment, st.floats(0, 3)),
    "crosstalk": st.builds(Crosstalk, st.floats(0, 1 / 3)),
    "exposure": st.builds(Exposure, st.floats(0, 8)),
    "mosaic": st.builds(Mosaic, st.sampled_from([*recording.PATTERNS])),
    "noise": st.builds(recording.Noise, SHARE, SHARE),
    "clipping": st.builds(Clipping, st.floats(-1, 0), st.floats(0.5, 2)),
    "quantisation": st.builds(Quantisation, st.integers(1, 20)),
    "white_balance": st.builds(WhiteBalance, st.tuples(*3 * [st.floats(0, 4)])),
    "tone_curve": st.builds(ToneCurve, st.sampled_from([*CURVES]), st.floats(0.3, 4)),
}
SENSORS = st.builds(Sensor, **{name: st.none() | effect for name, effect in EFFECTS.items()})
SCENES = st.builds(
    Scene, st.just(CAMERA), st.lists(SURFACES, min_size=1, max_size=4).map(tuple), LIGHTS, seed=st.integers(0, 2**31)
)


def applied(effect, views, seed=0):
    return effect.apply(views, torch.Generator().manual_seed(seed))


def painted_views(scene):
    return render.views(painting.paint(scene), scene.camera)


def intersect(geometry, x, y, p, q):
    """The point (X, Y) of a surface that is seen at pixels from aperture points."""
    disparity = eager.ray_disparity(geometry, x, y, p, q)
    return x - disparity * p, y - disparity * q


def random_scene(seed, camera, **options):
    return RandomScenes(camera, **options).draw(torch.Generator().manual_seed(seed))


def view_points(camera):
    """Aperture points p and q of all views, row by row, [V U] each."""
    q, p = map(centred, camera.grid)
    return p.repeat(len(q)), q.repeat_interleave(len(p))


def slow_views(scene):
    """All layers from all view points, by PyTorch's operations alone."""
    views = eager.radiance(painting.paint(scene), *view_points(scene.camera), *scene.camera.pixels())
    return views.unflatten(0, scene.camera.grid)


def psnr(image, truth):
    return float(-10 * (image.double() - truth.double()).square().mean().clamp(min=1e-15).log10())


def centred(length):
    return torch.arange(length, dtype=torch.float64) - (length - 1) / 2
