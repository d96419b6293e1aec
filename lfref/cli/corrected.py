"""Light fields put right before they are used: `correct=auto`, `none`, or what was found in another capture."""

from pathlib import Path

from omegaconf import DictConfig

from lfref.captures.asked import as_asked
from lfref.captures.correct import Corrections
from lfref.cli import inputs
from lfref.cli.command import log
from lfref.io import atomic
from lfref.lightfield import LightField
from lfref.refocuser.refocuser import Refocuser


def white_of(config: DictConfig, refocuser: Refocuser) -> LightField | None:
    """The picture of a white scene that `config.white` names, read like the inputs; None if it names none.

    Raises:
        FileError: It cannot be read.
    """
    return None if config.white is None else inputs.read(Path(config.white), config, [refocuser])


def prepared(
    field: LightField, config: DictConfig, white: LightField | None, refocuser: Refocuser
) -> tuple[LightField, Corrections | None]:
    """A light field as it is to be refocused, and what was corrected; None where nothing was looked for.

    Args:
        field: As it was read.
        config: Holds `correct` and `explain`.
        white: A picture of a white scene by the same camera.
        refocuser: Who will refocus it: spacing is corrected only for those that take positions, and told otherwise.

    Raises:
        InputError: A white picture or corrections of another grid or size.
        FileError: The file of corrections cannot be read.
    """
    other = "take method=shift_and_sum_through_cells to have it corrected"
    even = None if refocuser.takes_positions else f"{refocuser.name} needs an even grid: {other}"
    made, found = as_asked(field, str(config.correct), white, even)
    if found is not None:
        _tell(field.name, found, bool(config.explain))
    return made, found


def _tell(name: str, found: Corrections, all_of_it: bool) -> None:
    """Say what was corrected, and what was not though somebody might expect it."""
    if all_of_it:
        log.info("%s\n%s", name, found.explain())
        return
    if found.active:
        log.info("corrected: %s (explain=true says more, correct=none leaves them)", ", ".join(found.active))
    for why in dict.fromkeys(found.left.values()):
        log.info("%s: %s left: %s", name, ", ".join(each for each in found.left if found.left[each] == why), why)


def write(folder: Path, found: Corrections | None) -> None:
    """Keep what was corrected: `corrections.txt` to read; `correction.pt`, if anything was, for other captures.

    Args:
        folder: Where.
        found: What was looked for; None writes nothing.

    Raises:
        FileError: It cannot be written.
    """
    if found is not None:
        if found.active:
            found.save(folder / "correction.pt")
        atomic.write_text(folder / "corrections.txt", found.explain() + "\n")
