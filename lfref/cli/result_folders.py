"""Where the results of each light field go, and whose are there already: a run of many may be killed and go on."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from lfref.cli import run_folder
from lfref.cli.command import log
from lfref.io import atomic


def of(folder: Path, name: str, path: Path, given: Sequence[Path]) -> Path:
    """Where the results of a light field go: of one that is all that was given, itself and not as a part of a folder,
    into the run folder; of others each into one of its own.

    Args:
        folder: The run folder.
        name: Of the light field.
        path: Where it was found.
        given: As of `several.found`.
    """
    return folder if {path.resolve()} == {each.resolve() for each in given} else folder / name


@contextmanager
def filled(folder: Path, place: Path) -> Iterator[Path]:
    """Where results are written to: the run folder itself, or a folder in it, which is there only when it is whole.

    Args:
        folder: The run folder.
        place: As of `of`.
    """
    if place == folder:
        yield place
        return
    with atomic.replacing_folder(place) as partial:
        yield partial
    run_folder.list_also(folder, place)


def unfilled(captures: Mapping[str, Path], places: Mapping[str, Path], folder: Path) -> dict[str, Path]:
    """Light fields whose results are not there yet; what was half written when a run was killed goes away.

    Args:
        captures: As of `several.found`.
        places: Name -> place, as of `of`.
        folder: The run folder.
    """
    for half in (each for place in {folder, *places.values()} for each in atomic.partial_files(place)):
        shutil.rmtree(half) if half.is_dir() else half.unlink()
    waiting = {name: path for name, path in captures.items() if places[name] == folder or not places[name].exists()}
    log.info("%d of %d light fields are done", len(captures) - len(waiting), len(captures))
    return waiting
