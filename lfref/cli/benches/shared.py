"""What the groups of `lfref bench` share: their light fields, and a note of what they were measured on."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from omegaconf import DictConfig

from lfref.bench import machine
from lfref.cli import config as configs
from lfref.cli import inputs
from lfref.data.sources import SimulatedSource
from lfref.errors import chosen
from lfref.geometry import FocalPlanes
from lfref.io import atomic
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser
from lfref.simulator import sim30
from lfref.simulator.scene import Scene


class Rounds(NamedTuple):
    """How often everything is run."""

    counted: int
    warmup: int

    @property
    def all(self) -> range:
        """One number a round, the warm-up first."""
        return range(self.warmup + self.counted)


def rounds(config: DictConfig, counted: str = "repeats") -> Rounds:
    """The rounds that a configuration asks for.

    Args:
        config: Where they stand.
        counted: Under which name.

    Raises:
        InputError: They are no numbers, or too small.
    """
    return Rounds(int(configs.number(config, counted, 1)), int(configs.number(config, "warmup", 0)))


def light_fields(config: DictConfig, refocusers: Sequence[Refocuser] = ()) -> list[LightField]:
    """The light fields given, or simulated ones of the paper's size, for these to refocus."""
    if config.input is not None:
        return [inputs.read(path, config, refocusers) for path in inputs.find(config)]
    source: SimulatedSource = configs.build(config.source)
    return [source.field(index) for index in range(len(source))]


def scenes(names: DictConfig | None) -> dict[str, Scene]:
    """Test scenes of sim30 by name; null takes all thirty.

    Args:
        names: A list of them, or null.

    Raises:
        InputError: There is no such scene.
    """
    wanted = list(sim30.SCENES) if names is None else list(configs.plain(names))
    return {name: chosen("sim30 scene", name, sim30.SCENES) for name in wanted}


def write_facts(
    folder: Path,
    device: torch.device,
    fields: Sequence[LightField],
    planes: FocalPlanes,
    counted: int,
    **more: object,
) -> None:
    """Write `machine.json`: machine, libraries, threads, and what was measured how often.

    Args:
        folder: The run folder.
        device: Where the work was done.
        fields: What was refocused.
        planes: To which planes.
        counted: Runs that counted.
        **more: Further facts, by name.
    """
    facts = machine.facts(device) | {
        "light_fields": ", ".join(field.name for field in fields),
        "views": ", ".join(sorted({"x".join(map(str, field.views.shape)) for field in fields})),
        "planes": len(planes),
        "repeats": counted,
        **more,
    }
    atomic.write_text(folder / "machine.json", json.dumps(facts, indent=2) + "\n")
