"""`lfref export`: write a network, a refiner or separable Wiener refocusing as a file that other programs run."""

from pathlib import Path

from omegaconf import DictConfig

from lfref.cli import config as configs
from lfref.cli import steps
from lfref.cli.command import command, log, progress
from lfref.cli.steps import fixed_planes
from lfref.data.datamodules import SimulatedSource
from lfref.export import files
from lfref.refocus import apertures
from lfref.refocuser.refocuser import Refocuser
from lfref.simulator.scene import Camera
from lfref.simulator.scenes import RandomScenes

SIZES = (144, 176), (133, 171)
"""Height and width of the simulated light fields that a file is tried on."""
SEED = 11


def export(config: DictConfig, folder: Path) -> None:
    """Write `NAME.SUFFIX`, if its pictures are those of the refocuser; `config` is `conf/export.yaml`."""
    refocuser, planes = _refocuser(config), fixed_planes(config)
    path = folder / f"{config.name or refocuser.name}.{config.format}"
    grid = refocuser.grid or tuple(config.grid)
    source = SimulatedSource(len(SIZES), SEED, RandomScenes(Camera(grid, SIZES[0])))
    drawn = [source.light(index) for index in progress(range(len(SIZES)), "drawing scenes")]
    fields = [field.crop(0, 0, *size) for field, size in zip(drawn, SIZES, strict=True)]
    parity = files.export(refocuser, path, fields, planes.slopes)
    log.info("%s in %s: off by %.2g at most, %.0f dB", refocuser.name, path, parity.max_error, parity.psnr_db)


def _refocuser(config: DictConfig) -> Refocuser:
    if config.checkpoint is not None:
        return steps.checkpoints(config)[0]
    refocuser: Refocuser = configs.build(config.method)
    aperture = configs.build(config.aperture)
    return refocuser if getattr(aperture, "func", aperture) is apertures.full else refocuser.through(aperture)


run = command(export)
