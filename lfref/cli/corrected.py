"""Light fields put right before they are used: `correct=auto`, `none`, or what was found in another capture."""

from pathlib import Path

from omegaconf import DictConfig

from lfref.captures.correct import Corrections, correct
from lfref.cli import inputs
from lfref.cli.command import log
from lfref.io import atomic
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser

AUTO, NONE = "auto", "none"


def white_of(config: DictConfig, refocuser: Refocuser) -> LightField | None:
    """The picture of a white scene that `config.white` names, read like the inputs; None if it names none.

    Raises:
        FileError: It cannot be read.
    """
    return None if config.white is None else inputs.read(Path(config.white), config, [refocuser])


def prepared(field: LightField, config: DictConfig, white: LightField | None) -> tuple[LightField, Corrections | None]:
    """A light field as it is to be refocused, and what was corrected; None where nothing was looked for.

    Args:
        field: As it was read.
        config: Holds `correct` and `explain`.
        white: A picture of a white scene by the same camera.

    Raises:
        InputError: A white picture or corrections of another grid or size.
        FileError: The file of corrections cannot be read.
    """
    wanted = str(config.correct)
    if wanted == NONE:
        return field, None
    if not field.is_linear:
        log.info("%s holds encoded samples (reader.encoding=none): nothing is corrected", field.name)
        return field, None
    made, found = correct(field, white, None if wanted == AUTO else wanted)
    if config.explain:
        log.info("%s\n%s", field.name, found.explain())
    elif found.active:
        log.info("corrected: %s (explain=true says more, correct=none leaves them)", ", ".join(found.active))
    return made, found


def write(folder: Path, found: Corrections | None) -> None:
    """Keep what was corrected: `correction.pt` for other captures of the camera, `corrections.txt` to read.

    Args:
        folder: Where.
        found: What was looked for; None writes nothing.

    Raises:
        FileError: It cannot be written.
    """
    if found is not None:
        found.save(folder / "correction.pt")
        atomic.write_text(folder / "corrections.txt", found.explain() + "\n")
