"""Result folders: where the results of each light field go, and which exist already when a run is resumed."""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from lfref.cli import run_folder
from lfref.cli.command import log
from lfref.errors import counted
from lfref.io import atomic


def result_folder(folder: Path, name: str, path: Path, inputs: Sequence[Path]) -> Path:
    """The result folder of one light field: the run folder for a single input, else RUN/NAME."""
    if {path.resolve()} == {other.resolve() for other in inputs}:
        return folder
    return folder / (f"{name}_results" if name in run_folder.NOTES or name.endswith(".log") else name)


@contextmanager
def writing(folder: Path, results: Path) -> Iterator[Path]:
    """The folder to write results into: the run folder, or a partial folder that gets its name when it is complete."""
    if results == folder:
        yield results
        return
    with atomic.replacing_folder(results) as partial:
        yield partial
    run_folder.list_also(folder, results)


def remaining(fields: Mapping[str, Path], results: Mapping[str, Path], folder: Path) -> dict[str, Path]:
    """The light fields without results; partial results of a killed run are deleted."""
    for partial in (entry for place in {folder, *results.values()} for entry in atomic.partial_files(place)):
        shutil.rmtree(partial) if partial.is_dir() else partial.unlink()
    waiting = {name: path for name, path in fields.items() if results[name] == folder or not results[name].exists()}
    log.info("done: %d of %s", len(fields) - len(waiting), counted(len(fields), "light field"))
    return waiting
