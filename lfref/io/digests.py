"""SHA-256 of files that hold networks, written into the file itself: reading notices damage and changes.

A file holds `MARK` and 64 hexadecimal digits once. They are the digest of the whole file with zeros in their place, and
of the files beside it: weights and graph. Whoever changes a file can write the new digest too; this is no signature.
"""

import hashlib
import logging
import mmap
import re
import zipfile
from pathlib import Path

from lfref.errors import CheckpointError

log = logging.getLogger(__name__)
MARK = "lfref-sha256:"
BLANK = MARK + 64 * "0"
"""Place of the digest in a file that is still without it."""
# No look-behind: with one, searching 100 MB took 2.7 s instead of 0.1 s.
PLACE = re.compile(f"{MARK}([0-9a-f]{{64}})".encode())
END = b"PK\x05\x06"
"""Start of the last record of a ZIP archive, of 22 bytes; its last two are the length of the comment that follows."""


def write(path: Path, *beside: Path) -> None:
    """Fill in the digest of a file that holds `BLANK` once; `beside` are files of which it is the digest too."""
    place, _, digest = _digest(path, beside) or (0, "", "")
    assert place, path
    with path.open("r+b") as file:
        file.seek(place)
        file.write(digest.encode())


def write_to_archive(path: Path) -> None:
    """Give a ZIP archive without a comment its digest as the comment."""
    comment = BLANK.encode()
    with path.open("r+b") as file:
        file.seek(-22, 2)
        assert file.read(4) == END, path
        file.seek(-2, 2)
        file.write(len(comment).to_bytes(2, "little") + comment)
    write(path)


def check(path: Path, *beside: Path) -> bool:
    """Whether a file holds its digest; CheckpointError if the file does not match its digest."""
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


def warn(path: Path) -> None:
    """Say that a file of an earlier version has no digest."""
    log.warning("%s has no digest, so damage would not show: write it anew with this version of lfref", path)


def check_archive(path: Path) -> bool:
    """Check a ZIP archive like `check`, and that its members are plain; without a digest, also their checksums.

    PyTorch checks neither the checksums nor the size of the unpacked members.
    """
    has_digest = check(path)
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        is_plain = all(member.compress_type == zipfile.ZIP_STORED for member in members)
        if not is_plain or sum(member.file_size for member in members) > path.stat().st_size:
            raise CheckpointError(f"{path} must hold plain members", got="compressed ones", remedy="write it anew")
        if not has_digest and (name := archive.testzip()) is not None:
            raise CheckpointError(f"{path} is damaged", got=f"another checksum of {name}", remedy="copy it anew")
    return has_digest
