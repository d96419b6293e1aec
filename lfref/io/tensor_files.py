"""Tensors in files: PyTorch's checkpoints, weights as safetensors, and the digests of all files that hold networks.

A safetensors file holds tensors and texts, and nothing in it can run. Our texts are JSON.

A digest is a SHA-256 that is written into the file itself: reading notices damage and changes. The file holds `MARK`
and 64 hexadecimal digits once. They are the digest of the whole file with zeros in their place, and of the files beside
it: weights and graph. Whoever changes a file can write the new digest too: a digest is no signature.
Format of safetensors: https://github.com/huggingface/safetensors.
"""

import hashlib
import json
import logging
import mmap
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from lfref.errors import CheckpointError
from lfref.io import atomic

log = logging.getLogger(__name__)
MARK = "lfref-sha256:"
BLANK = MARK + 64 * "0"
"""Text in the place of the digest before it is computed."""
# No look-behind: with one, searching 100 MB took 2.7 s instead of 0.1 s.
PLACE = re.compile(f"{MARK}([0-9a-f]{{64}})".encode())
END = b"PK\x05\x06"
"""Start of the last record of a ZIP archive; it has 22 bytes, the last two of which are the length of the comment."""


def fill_digest(path: Path, *beside: Path) -> None:
    """Fill in the digest of a file that holds `BLANK` once; the digest also covers the files `beside`."""
    place, _, digest = _digest(path, beside) or (0, "", "")
    assert place, path
    with path.open("r+b") as file:
        file.seek(place)
        file.write(digest.encode())


def fill_archive_digest(path: Path) -> None:
    """Give a ZIP archive without a comment its digest as the comment."""
    comment = BLANK.encode()
    with path.open("r+b") as file:
        file.seek(-22, 2)
        assert file.read(4) == END, path
        file.seek(-2, 2)
        file.write(len(comment).to_bytes(2, "little") + comment)
    fill_digest(path)


def check_digest(path: Path, *beside: Path) -> bool:
    """Whether a file holds a digest; a CheckpointError if the file does not match it."""
    result = _digest(path, beside)
    if result is not None and result[1] != result[2]:
        raise CheckpointError(
            f"{path} is damaged or was changed", got="another SHA-256", remedy="copy or write it anew"
        )
    return result is not None


def _digest(path: Path, beside: tuple[Path, ...]) -> tuple[int, str, str] | None:
    """Position of the stored digest, the stored digest, and the digest computed now; None if the file stores none."""
    if path.stat().st_size == 0:
        return None
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        places = [match.start(1) for match in PLACE.finditer(content)]
        if not places:
            return None
        place, end = places[0], places[0] + 64
        with memoryview(content) as view:
            sha256 = hashlib.sha256(view[:place])
            sha256.update(64 * b"0")
            sha256.update(view[end:])
            stated = bytes(view[place:end]).decode()
    for other in beside:
        with other.open("rb") as file:
            sha256.update(hashlib.file_digest(file, "sha256").digest())
    return place, stated, sha256.hexdigest()


def warn_without_digest(path: Path) -> None:
    """Say that a file of an earlier version has no digest."""
    log.warning("%s has no digest, so damage would not show: write it anew with this version of lfref", path)


def check_archive_digest(path: Path) -> bool:
    """Check the digest of a ZIP archive, as `check_digest`, and that its members are plain.

    Without a digest, the checksums of the members are checked. PyTorch checks neither these nor the unpacked sizes.
    """
    has_digest = check_digest(path)
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        is_plain = all(member.compress_type == zipfile.ZIP_STORED for member in members)
        if not is_plain or sum(member.file_size for member in members) > path.stat().st_size:
            raise CheckpointError(f"{path} must hold plain members", got="compressed ones", remedy="write it anew")
        if not has_digest and (name := archive.testzip()) is not None:
            raise CheckpointError(f"{path} is damaged", got=f"another checksum of {name}", remedy="copy it anew")
    return has_digest


SUFFIX = ".safetensors"
DIGEST = "sha256"
"""Name of the entry that says that a file holds a digest; in safetensors, the entry is the digest."""


def write_checkpoint(path: str | Path, contents: dict[str, Any]) -> None:
    """Write plain containers and tensors as a file of `torch.save` with a digest; FileError if the disk refuses."""
    with atomic.replacing(path) as partial:
        try:
            with partial.open("wb") as file:
                torch.save(contents | {DIGEST: True}, file)
        except RuntimeError as error:
            # PyTorch hides the error of the disk behind its own.
            raise error.__context__ if isinstance(error.__context__, OSError) else error from None
        fill_archive_digest(partial)


def read_checkpoint(path: Path) -> Any:
    """The contents of a file of `torch.save`, on the CPU; CheckpointError if it is damaged or could run code."""
    try:
        has_digest = check_archive_digest(path)
        contents = torch.load(path, map_location="cpu", weights_only=True)
    except CheckpointError:
        raise
    # The unpickler may raise any error for a foreign file; PyTorch's message would advise to load it unsafely.
    except Exception as error:
        raise CheckpointError(f"{path} is damaged or no checkpoint", remedy="train or copy it anew") from error
    _require_digest(path, has_digest, isinstance(contents, dict) and DIGEST in contents)
    return contents


def write_weights(path: str | Path, tensors: Mapping[str, Tensor], description: Mapping[str, Any]) -> None:
    """Write tensors by name, and plain containers that describe them, as safetensors with a digest.

    Raises:
        FileError: The disk refuses.
    """
    contiguous = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    texts = {name: json.dumps(value) for name, value in (*description.items(), (DIGEST, BLANK))}
    with atomic.replacing(path) as partial:
        partial.write_bytes(save(contiguous, texts))
        fill_digest(partial)


def read_weights(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors, on the CPU, and their description, as `write_weights` wrote them.

    Raises:
        CheckpointError: The file is damaged or another file.
    """
    try:
        has_digest = check_digest(Path(path))
        with safe_open(path, framework="pt", device="cpu") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  it is no mapping
            texts = {name: json.loads(text) for name, text in (file.metadata() or {}).items()}
    except CheckpointError:
        raise
    except (SafetensorError, OSError, ValueError, RecursionError, TypeError) as error:
        raise CheckpointError(f"{path} is damaged or no file of weights", remedy="copy it anew") from error
    _require_digest(Path(path), has_digest, texts.pop(DIGEST, None) is not None)
    return tensors, texts


def _require_digest(path: Path, has_digest: bool, needs_digest: bool) -> None:
    """Refuse a file that says that it holds a digest and has none; warn of a file of an earlier version."""
    if needs_digest and not has_digest:
        raise CheckpointError(f"{path} is damaged or was changed", got="no SHA-256", remedy="copy or write it anew")
    if not has_digest:
        warn_without_digest(path)
