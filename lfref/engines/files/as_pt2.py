"""PT2 archives of `torch.export`: run by PyTorch in Python, and made into programs by its compiler.

`torch.export.load` unpickles what an archive asks it to, evaluates its expressions as Python and calls any function of
PyTorch by name, so an archive is looked through before: plain weights, expressions of sizes, operators of ATen.
"""

import copy
import io
import json
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lfref.engines.engine import BF16, FP16, FP32, Run
from lfref.engines.files.manifest import KEY, Graph, Manifest, lowered, parsed
from lfref.errors import CheckpointError, first_line
from lfref.io import atomic

PRECISIONS = (FP32, FP16, BF16)
PACKAGES: tuple[str, ...] = ()
LARGEST = 2**33
"""Bytes of an archive, and of all that is in it."""
LARGEST_TEXT = 2**26
"""Bytes of one of its texts."""
PLACES = re.compile(
    r"\.data/(version|serialization_id)|byteorder|archive_format|archive_version|models/model\.json|extra/lfref"
    r"|data/(weights|constants)/(weight_\d+|tensor_\d+|model_(weights|constants)_config\.json)"
)
"""What an archive may hold; code for processors is not among it."""
NO_INPUTS = "data/sample_inputs/model.pt"
"""Would be unpickled if it were not empty."""
TARGETS = re.compile(r"torch\.ops\.aten\.\w+\.\w+|_operator\.(add|sub|mul|floordiv|mod|neg|ge|gt|le|lt|eq|ne)")
"""What a graph may call."""
EXPRESSION = re.compile(
    r"('[su]\d+'|\b(Symbol|Integer|Add|Mul|FloorDiv|CeilDiv|Mod|PythonMod|Max|Min|positive|nonnegative|integer|True)\b"
    r"|\d{1,12}\b|[ (),=-])*"
)
"""Of sizes; whatever else could be Python."""
LONGEST = 10000
"""Characters of an expression."""


def write(path: Path, graph: Graph, manifest: Manifest) -> None:
    """Write an archive.

    Args:
        path: The file, `NAME.pt2`.
        graph: What it shall do.
        manifest: What it shall say of itself; its precision is one of `PRECISIONS`.

    Raises:
        FileError: The disk refuses.
    """
    archive = io.BytesIO()
    torch.export.save(_program(graph, manifest.precision), archive, extra_files={KEY: manifest.text()})
    with atomic.replacing(path) as partial:
        partial.write_bytes(archive.getvalue())


def opened(path: Path) -> tuple[Run, Manifest]:
    """An archive, ready to run, and what it says of itself.

    Args:
        path: A file that `write` wrote.

    Raises:
        CheckpointError: Another file, or one that could do more than compute.
    """
    try:
        _check(path)
        texts = {KEY: ""}
        program = torch.export.load(path, extra_files=texts)
        manifest, module = parsed(path, texts[KEY] or None), program.module(check_guards=False)
    except CheckpointError:
        raise
    # Over a foreign file PyTorch raises whatever it stumbles on.
    except Exception as error:
        raise CheckpointError(
            f"{path} must be an archive of torch.export", got=first_line(error), remedy="export it anew"
        ) from error

    def run(*inputs: Tensor) -> Tensor:
        made: Tensor = module(*inputs)
        return made

    return run, manifest


def _program(graph: Graph, precision: str) -> torch.export.ExportedProgram:
    module = copy.deepcopy(graph.module) if precision == FP32 else lowered(graph.module, precision).eval()
    # Weights in another order of memory are told to be parts of others.
    for weight in module.parameters():
        weight.data = weight.data.clone(memory_format=torch.contiguous_format)
    axes = tuple(dict.fromkeys(free, torch.export.Dim.DYNAMIC) for free in graph.free)
    with torch.no_grad():
        program = torch.export.export(module, graph.example, dynamic_shapes=axes)
    # What it was followed with would be pickled, and what it was found to need is Python.
    program.example_inputs = None
    program._guards_code.clear()
    return program


def _check(path: Path) -> None:
    """Refuse an archive that PyTorch would do more with than compute."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if path.stat().st_size > LARGEST or sum(each.file_size for each in members) > LARGEST:
            raise _refused(path, "more than 8 GiB")
        if any(each.compress_type != zipfile.ZIP_STORED for each in members):
            raise _refused(path, "compressed members")
        if len({each.filename for each in members}) < len(members):
            raise _refused(path, "members of one name")
        sizes = {each.filename.partition("/")[2]: each.file_size for each in members}
        inputs = sizes.pop(NO_INPUTS, 0)
        if strange := next((name for name in sizes if not PLACES.fullmatch(name)), NO_INPUTS if inputs else None):
            raise _refused(path, strange[:80])
        for each in members:
            if each.filename.endswith((".json", f"/{KEY}")) and each.file_size > LARGEST_TEXT:
                raise _refused(path, f"{each.file_size} bytes of {each.filename}")
        for each in members:
            if each.filename.endswith(".json"):
                _check_text(path, json.loads(archive.read(each)))


def _check_text(path: Path, told: Any) -> None:
    for key, value in _pairs(told):
        if key in ("use_pickle", "guards_code") and value:
            raise _refused(path, f"{key} {str(value)[:80]}")
        if key == "expr_str" and not (_is_expression(value)):
            raise _refused(path, f"{key} {str(value)[:80]!r}")
        if key == "target" and isinstance(value, str) and "." in value and not TARGETS.fullmatch(value):
            raise _refused(path, f"{key} {value[:80]!r}")


def _is_expression(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= LONGEST and EXPRESSION.fullmatch(value) is not None


def _pairs(told: Any) -> Iterator[tuple[str, Any]]:
    """All keys of all mappings, with their values; without recursion, which whoever nests them would end."""
    waiting = [told]
    while waiting:
        each = waiting.pop()
        if isinstance(each, dict):
            yield from each.items()
            waiting += each.values()
        elif isinstance(each, list):
            waiting += each


def _refused(path: Path, got: str) -> CheckpointError:
    return CheckpointError(
        f"{path} must hold plain weights, and a graph of ATen's operators", got=got, remedy="export it anew"
    )
