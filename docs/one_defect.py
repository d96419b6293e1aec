"""What `correct=auto` changes in refocused pictures of scenes with one defect, or none: a table of `captures.md`.

The light fields are scenes of sim30 without their sensors, to which an effect of the simulator is applied, or hot
pixels or exposures are added. Pictures are compared with the truth.
"""

import dataclasses
from collections.abc import Callable, Iterator

import maps
import torch
from torch import Generator, Tensor

import lfref
from lfref.captures.correct import AUTO, correct
from lfref.functional.psnr import psnr
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import OperatorRefocuser
from lfref.simulator import sim30
from lfref.simulator.effects.optics import Chromatic, Misalignment, Vignetting
from lfref.simulator.effects.recording import Mosaic, Noise
from lfref.simulator.effects.sensor import Sensor, recorded
from lfref.simulator.scene import Scene

SCENES = ("shards", "leaves", "twigs", "thicket", "floor", "dome", "gloss", "apple", "mirror", "lamps", "running")
SLOPES = torch.tensor([-2.0, -1.0, -0.3, 0.0, 0.4, 1.2], dtype=torch.float64)
LIGHT = 0.7  # so that brighter views do not clip
EXPOSURE, HOT = 0.1, 200  # standard deviation of the logarithm of gains, and number of hot and dead samples
GRAIN = Noise(shot=1e-3, read=1e-5)
SHIFTS = Misalignment(sigma=0.2)
COLOURS = Chromatic(magnification=(1.003, 1, 0.997), disparity=(0.03, 0, -0.03))


def _exposed(views: Tensor) -> Tensor:
    gains = (EXPOSURE * torch.randn(*views.shape[:2], 1, 1, 1, generator=Generator().manual_seed(2))).exp()
    gains[views.shape[0] // 2, views.shape[1] // 2] = 1
    return views * gains


def _hot(views: Tensor) -> Tensor:
    random = Generator().manual_seed(3)
    places = tuple(torch.randint(0, length, (HOT,), generator=random) for length in views.shape)
    changed = views.clone()
    changed[places] = torch.where(torch.arange(HOT) % 2 == 0, 1.0, 0.0)
    return changed


def _through(**effects: object) -> Callable[[Tensor], Tensor]:
    return lambda views: recorded(views, Sensor(**effects), seed=4)  # type: ignore[arg-type]


DEFECTS: dict[str, Callable[[Tensor], Tensor]] = {
    "none": lambda views: views,
    "vignetting to a quarter": _through(vignetting=Vignetting(field=0.6, cats_eye=0.5)),
    "slight vignetting": _through(vignetting=Vignetting(field=0.3, cats_eye=0.15)),
    "falloff alone": _through(vignetting=Vignetting(field=0.6)),
    "exposures": _exposed,
    "hot pixels": _hot,
    "misaligned": _through(misalignment=SHIFTS),
    "chromatic": _through(chromatic=COLOURS),
    "noise": _through(noise=GRAIN),
    "mosaic and noise": _through(mosaic=Mosaic(), noise=GRAIN),
    "hot pixels, mosaic": lambda views: _through(mosaic=Mosaic())(_hot(views)),
    "all": lambda views: _exposed(
        _hot(_through(vignetting=Vignetting(0.4, 0.3), chromatic=COLOURS, misalignment=SHIFTS, noise=GRAIN)(views))
    ),
}


def one_defect() -> Iterator[str]:
    """Change of the PSNR by `correct=auto`, for each defect: the mean of each method, and the worst of all."""
    scenes = {name: lfref.simulate(_ideal(name), outputs=("views", "truth"), slopes=SLOPES) for name in SCENES}
    yield f"| defect | corrected, of {len(SCENES)} | {' | '.join(f'{name}, dB' for name in maps.METHODS)} | worst, dB |"
    yield f"|---|---|{'---|' * len(maps.METHODS)}---|"
    for defect, spoil in DEFECTS.items():
        won: dict[tuple[str, str], float] = {}
        n_corrected = 0
        for name, scene in scenes.items():
            field = LightField(spoil(LIGHT * scene.views).clamp(0), name)
            corrected, _ = correct(field, AUTO, None, "some methods need an even grid")
            n_corrected += corrected is not field
            for method in maps.METHODS:
                before, after = (
                    0.0 if corrected is field else _psnr(method, each, LIGHT * scene.truth)
                    for each in (field, corrected)
                )
                won[name, method] = after - before
        means = [sum(won[name, method] for name in SCENES) / len(SCENES) for method in maps.METHODS]
        worst = min(won, key=won.__getitem__)
        note = f"{won[worst]:+.2f} ({', '.join(worst)})" if won[worst] < 0 else f"{won[worst]:+.2f}"
        yield f"| {defect} | {n_corrected} | {' | '.join(f'{mean:+.1f}' for mean in means)} | {note} |"
    yield ""
    yield f"Scenes {', '.join(SCENES)} of sim30 (version {sim30.VERSION}) without their sensors."


def _ideal(name: str) -> Scene:
    return dataclasses.replace(sim30.SCENES[name], sensor=Sensor())


def _psnr(method: str, field: LightField, truth: Tensor) -> float:
    return float(psnr(OperatorRefocuser(method, maps.METHODS[method])(field, SLOPES), truth).mean())


TABLES: dict[str, Callable[[], Iterator[str]]] = {"one_defect": one_defect}
