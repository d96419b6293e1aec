"""The planes that a configuration names: the same for all light fields, or for each its own."""

from omegaconf import DictConfig

from lfref.captures.auto_planes import AutoPlanes
from lfref.cli import config as configs
from lfref.errors import InputError
from lfref.geometry import FocalPlanes
from lfref.lightfield import LightField

Planes = FocalPlanes | AutoPlanes


def fixed(config: DictConfig) -> FocalPlanes:
    """Planes for all light fields.

    Args:
        config: Holds `planes`.

    Raises:
        InputError: They depend on the light field.
    """
    planes: Planes = configs.build(config.planes)
    if isinstance(planes, AutoPlanes):
        raise InputError(
            "planes of this command must be the same for all light fields",
            got="planes=auto",
            remedy="planes=paper, or slopes=[-1,0,1]",
        )
    return planes


def planes_of(planes: Planes, field: LightField) -> FocalPlanes:
    """The planes of one light field.

    Args:
        planes: As configured.
        field: The light field.
    """
    return planes.of(field) if isinstance(planes, AutoPlanes) else planes
