"""The README as the package index shows it, outside the repository: its links are whole addresses.

The build reads the repository's address from the environment, `LFREF_REPOSITORY`, or where GitHub runs it. Without an
address, as in a checkout, links stay as they are and the package has no addresses.
"""

import os
import re
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(?P<start>(?P<picture>!?)\[[^\]]*\]\()(?P<target>(?![a-z]+:|#)[^)#\s]+)(?P<anchor>#[^)\s]*)?\)")
"""A link or a picture of Markdown whose target is a file."""


def repository() -> str | None:
    """Address of the repository, if the environment names one."""
    server, name = os.environ.get("GITHUB_SERVER_URL"), os.environ.get("GITHUB_REPOSITORY")
    return os.environ.get("LFREF_REPOSITORY") or (f"{server}/{name}" if server and name else None)


def with_addresses(text: str, address: str, version: str) -> str:
    """Markdown whose links to files lead to the files of a version at the repository's address."""

    def replacement(link: re.Match[str]) -> str:
        view = "raw" if link["picture"] else "blob"
        return f"{link['start']}{address}/{view}/v{version}/{link['target']}{link['anchor'] or ''})"

    return LINK.sub(replacement, text)


class IndexPage(MetadataHookInterface):
    """Hook of the build that adds the README and the addresses of the project."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict) -> None:
        """Add `readme` and `urls` to the metadata."""
        root = Path(self.root)
        text, address = (root / "README.md").read_text("utf-8"), repository()
        source = (root / "lfref" / "__init__.py").read_text("utf-8")
        version = re.search(r'__version__ = "([^"]+)"', source)
        assert version is not None
        metadata["urls"] = {}
        if address is not None:
            text = with_addresses(text, address, version[1])
            metadata["urls"] = {
                "Source": address,
                "Documentation": f"{address}/blob/v{version[1]}/docs/quickstart.md",
                "Changelog": f"{address}/blob/v{version[1]}/CHANGELOG.md",
                "Issues": f"{address}/issues",
            }
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
