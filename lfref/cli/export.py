"""`lfref export`: write a network or an operator as a file that other programs run."""

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

SIZES = (272, 304), (261, 299)
"""Height and width of the simulated light fields that a file is tried on."""
SEED = 11


def export(config: DictConfig, folder: Path) -> None:
    """Write `NAME.SUFFIX`, if its pictures are those of the refocuser; `config` is `conf/export.yaml`."""
    planes, aperture = fixed_planes(config), steps.aperture_for(config, None)
    refocuser: Refocuser = configs.build(config.method) if config.checkpoint is None else steps.checkpoints(config)[0]
    if config.checkpoint is None and getattr(aperture, "func", aperture) is not apertures.full:
        refocuser = refocuser.through(aperture)
    path = folder / f"{config.name or refocuser.name}.{config.format}"
    grid = refocuser.grid or tuple(config.grid)
    source = SimulatedSource(len(SIZES), SEED, RandomScenes(Camera(grid, SIZES[0])))
    drawn = [source.light(index) for index in progress(range(len(SIZES)), "drawing scenes")]
    fields = [field.crop(0, 0, *size) for field, size in zip(drawn, SIZES, strict=True)]
    parity = files.export(refocuser, path, fields, planes.slopes)
    text = "wrote %s: its pictures differ from those of %s by %.2g at most (%.0f dB)"
    log.info(text, path, refocuser.name, parity.max_error, parity.psnr_db)


run = command(export)
