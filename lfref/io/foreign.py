"""Files that hold light fields but are not read here: what they are, and how to get from them to something that is."""

from typing import NamedTuple

from lfref.io import decode


class Foreign(NamedTuple):
    """A form of files that other tools unpack."""

    magics: tuple[bytes, ...]
    """First bytes of its files, one of them."""
    title: str
    """What it is, for messages."""
    remedy: str
    """What to do about it."""


LYTRO = Foreign(
    (b"\x89LFP\r\n\x1a\n",),
    "a raw container of a Lytro camera (.lfp, .lfr)",
    "unpack it with plenopticam and read its folder viewpoints_*, or with LFToolbox and read its *__Decoded.mat",
)
ARCHIVE = Foreign(
    (b"\x1f\x8b", b"7z\xbc\xaf\x27\x1c", b"Rar!\x1a\x07", b"BZh", b"\xfd7zXZ\0"),
    "a compressed archive",
    "unpack it and read what is in it",
)
FOREIGN = (LYTRO, ARCHIVE)


def explained(head: bytes) -> tuple[str, str]:
    """What a file of no known form is, and the remedy.

    Args:
        head: Its first bytes, as `decode.head` gave them.
    """
    known = next((form for form in FOREIGN if head.startswith(form.magics)), None)
    return (decode.kind(head), "convert it") if known is None else (known.title, known.remedy)
