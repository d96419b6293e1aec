"""PT2 archives of `torch.export`: run by PyTorch, and made into programs by its compiler.

`torch.export.load` unpickles members of the archive, evaluates expressions as Python and calls functions of PyTorch by
name. Archives are hostile input, so each is checked first: plain weights, expressions of sizes, operators of ATen.
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
from lfref.engines.files.manifest import KEY, Graph, Manifest, parse
from lfref.engines.files.network_copies import half_convolutions
from lfref.errors import CheckpointError, first_line
from lfref.io import atomic

PRECISIONS = (FP32, FP16, BF16)
PACKAGES: tuple[str, ...] = ()
LARGEST = 2**33
"""Bytes of an archive, and of all of its members."""
LARGEST_TEXT = 2**26
"""Bytes of one of its texts."""
LONGEST_EXPRESSION = 10000
"""Characters."""
MEMBERS = re.compile(
    r"\.data/(version|serialization_id)|byteorder|archive_format|archive_version|models/model\.json|extra/lfref"
    r"|data/(weights|constants)/(weight_\d+|tensor_\d+|model_(weights|constants)_config\.json)"
)
"""Names of members that an archive may have; compiled code for processors is not among them."""
SAMPLE_INPUTS = "data/sample_inputs/model.pt"
"""A member that PyTorch would unpickle unless it is empty."""
TARGETS = re.compile(r"torch\.ops\.aten\.\w+\.\w+|_operator\.(add|sub|mul|floordiv|mod|neg|ge|gt|le|lt|eq|ne)")
"""Functions that a graph may call."""
EXPRESSION = re.compile(
    r"('[su]\d+'|\b(Symbol|Integer|Add|Mul|FloorDiv|CeilDiv|Mod|PythonMod|Max|Min|positive|nonnegative|integer|True)\b"
    r"|\d{1,12}\b|[ (),=-])*"
)
"""An expression of sizes; whatever else could be any Python."""


def write(path: Path, graph: Graph, manifest: Manifest) -> None:
    """Write an archive as `NAME.pt2`.

    Raises:
        FileError: The disk refuses.
    """
    is_full = manifest.precision == FP32
    module = copy.deepcopy(graph.module) if is_full else half_convolutions(graph.module, manifest.precision).eval()
    # Weights in another memory order would be stored as parts of others.
    for weight in module.parameters():
        weight.data = weight.data.clone(memory_format=torch.contiguous_format)
    axes = tuple(dict.fromkeys(free, torch.export.Dim.DYNAMIC) for free in graph.free)
    with torch.no_grad():
        program = torch.export.export(module, graph.example, dynamic_shapes=axes)
    # Example inputs would be pickled, and guards are Python code.
    program.example_inputs = None
    program._guards_code.clear()
    archive = io.BytesIO()
    torch.export.save(program, archive, extra_files={KEY: manifest.text()})
    with atomic.replacing(path) as partial:
        partial.write_bytes(archive.getvalue())


def read(path: Path) -> tuple[Run, Manifest]:
    """An archive that `write` wrote, ready to run, and its manifest.

    Raises:
        CheckpointError: Another file, or one that could do more than compute.
    """
    try:
        _check(path)
        texts = {KEY: ""}
        program = torch.export.load(path, extra_files=texts)
        manifest, module = parse(path, texts[KEY] or None), program.module(check_guards=False)
    except CheckpointError:
        raise
    # On a foreign file PyTorch raises whatever it likes.
    except Exception as error:
        raise CheckpointError(
            f"{path} must be an archive of torch.export", got=first_line(error), remedy="export it anew"
        ) from error

    # A function, since a module would be a part of whatever module holds it.
    def run(*inputs: Tensor) -> Tensor:
        stack: Tensor = module(*inputs)
        return stack

    return run, manifest


def _check(path: Path) -> None:
    """Refuse an archive with which PyTorch would do more than compute."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if path.stat().st_size > LARGEST or sum(member.file_size for member in members) > LARGEST:
            raise _refusal(path, "more than 8 GiB")
        if any(member.compress_type != zipfile.ZIP_STORED for member in members):
            raise _refusal(path, "compressed members")
        # Of two members with one name, another reader might see the other one.
        if len({member.filename for member in members}) < len(members):
            raise _refusal(path, "members of one name")
        for member in members:
            name = member.filename.partition("/")[2]
            is_empty_input = name == SAMPLE_INPUTS and member.file_size == 0
            if not (is_empty_input or MEMBERS.fullmatch(name)):
                raise _refusal(path, name[:80])
            if name.endswith((".json", f"/{KEY}")) and member.file_size > LARGEST_TEXT:
                raise _refusal(path, f"{member.file_size} bytes of {name}")
        for member in members:
            if member.filename.endswith(".json"):
                _check_text(path, json.loads(archive.read(member)))


def _check_text(path: Path, text: Any) -> None:
    """Refuse pickles, Python code and functions that a text of an archive names."""
    for key, value in _pairs(text):
        is_code = key in ("use_pickle", "guards_code") and value
        is_expression = isinstance(value, str) and len(value) <= LONGEST_EXPRESSION and EXPRESSION.fullmatch(value)
        is_call = key == "target" and isinstance(value, str) and "." in value
        if is_code or (key == "expr_str" and not is_expression) or (is_call and not TARGETS.fullmatch(value)):
            raise _refusal(path, f"{key} {str(value)[:80]!r}")


def _pairs(text: Any) -> Iterator[tuple[str, Any]]:
    """All (key, value) of all mappings; without recursion, which deep nesting would break."""
    waiting = [text]
    while waiting:
        part = waiting.pop()
        if isinstance(part, dict):
            yield from part.items()
            waiting += part.values()
        elif isinstance(part, list):
            waiting += part


def _refusal(path: Path, got: str) -> CheckpointError:
    return CheckpointError(
        f"{path} must hold plain weights, and a graph of ATen's operators", got=got, remedy="export it anew"
    )
