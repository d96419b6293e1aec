"""Light fields as somebody wants them: put right, left as they are, or corrected by what another capture showed."""

from lfref.captures.correct import Corrections, correct
from lfref.lightfield import LightField

AUTO, NONE = "auto", "none"


def as_asked(field: LightField, wanted: str, white: LightField | None = None) -> tuple[LightField, Corrections | None]:
    """A light field as it is to be used, and what was corrected; None where nothing was looked for.

    Args:
        field: As it was read.
        wanted: `auto`, `none`, or a file that `Corrections.save` wrote.
        white: A picture of a white scene by the same camera.

    Raises:
        InputError: A white picture or corrections of another grid or size.
        FileError: The file of corrections cannot be read.
    """
    if wanted == NONE:
        return field, None
    return correct(field, white, None if wanted == AUTO else wanted)
