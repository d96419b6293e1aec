"""Which files of a package a module is made of: its own, and whatever these import from the package."""

import functools
import hashlib
import re
from pathlib import Path

IMPORT = re.compile(r"^[ \t]*(?:from +([\w.]+) +import +(\([^)]*\)|[^(\n]*)|import +([\w.]+))", re.MULTILINE)


@functools.cache
def digest(file: Path, package: Path) -> str:
    """What changes with the text of any of these files, and with nothing else.

    Args:
        file: Of the module.
        package: Folder of its package; what is imported from elsewhere does not count.
    """
    files = [file]
    for each in files:  # which grows meanwhile
        files += [other for other in imported(each, package) if other not in files]
    return hashlib.sha256(b"".join(sorted(each.read_bytes() for each in files))).hexdigest()


@functools.cache
def imported(file: Path, package: Path) -> list[Path]:
    """Files of a package that a file of it imports, inside functions too; arguments as of `digest`."""
    found: dict[Path, None] = {}
    for origin, names, whole in IMPORT.findall(file.read_text(encoding="utf-8")):
        for module in (whole or origin, *(f"{origin}.{name}" for name in re.findall(r"\w+", names))):
            if module.split(".")[0] == package.name:
                path = package.parent / module.replace(".", "/")
                found |= dict.fromkeys((path.with_suffix(".py"), path / "__init__.py"))
    return [path for path in found if path.is_file()]
