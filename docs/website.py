"""Hooks of mkdocs: which files of this repository are pages, and the reference made from docstrings.

mkdocs calls the functions named `on_...`; a warning that they log fails the build.
"""

import ast
import logging
import re
from pathlib import Path

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import lfref

ROOT = Path(__file__).resolve().parents[1]
PUBLISHED = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/*.md", "docs/*.css", "docs/*.js", "docs/pictures/*")
# The face of this package are the commands, which tell about themselves by `--help`.
WITHOUT_PAGE = "cli"
PUBLIC_NAMES = "reference/names.md"
# Who searches for a word first wants the page that explains it, then the functions that have it in their description.
SEARCHED_LAST = "---\nsearch:\n  boost: 0.2\n---\n\n"
# What a browser fetches to show a page; where a link leads it goes only when people click on it.
FETCHED = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=[\"']?((?:https?:)?//[^\"'\s>]+)")
# What screen readers need and the theme lacks: its search has a name, and an entry of the contents is no landmark.
AMENDED = (
    (re.compile(r'(data-md-component="search" role="dialog")'), r'\1 aria-label="Search"'),
    (re.compile(r'(<nav class="md-nav") aria-label="[^"]*"(>\s*<ul class="md-nav__list">)'), r'\1 role="none"\2'),
)

log = logging.getLogger("mkdocs.hooks.website")


class OneExample(griffe.Extension):
    """Reads the section `Example:`, which Google's style calls `Examples:`."""

    def on_object(self, *, obj: griffe.Object, **_: object) -> None:
        """Rename the section before it is parsed."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(r"^Example:$", "Examples:", obj.docstring.value, flags=re.MULTILINE)


def on_config(config: MkDocsConfig) -> None:
    """Let the navigation lead to the reference."""
    config.nav.append({"Reference": [PUBLIC_NAMES, *({name: address(name)} for name in described())]})


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Publish what `PUBLISHED` names as it lies in the repository, and the reference; the theme's files stay."""
    theme = [file for file in files if file.src_dir != config.docs_dir]
    pages = [
        File(path.relative_to(ROOT).as_posix(), str(ROOT), config.site_dir, config.use_directory_urls)
        for pattern in PUBLISHED
        for path in sorted(ROOT.glob(pattern))
    ]
    texts = {PUBLIC_NAMES: public_names()} | {address(name): description(name) for name in described()}
    return Files([*theme, *pages, *(File.generated(config, name, content=text) for name, text in texts.items())])


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Warn of pages that ask another host for something; amend what the theme writes."""
    for url in FETCHED.findall(output):
        log.warning(f"{page.file.src_uri} asks another host: {url}")
    return amended(output)


def on_post_template(output_content: str, template_name: str, config: MkDocsConfig) -> str:
    """Amend the page of an unknown address too."""
    return amended(output_content) if template_name == "404.html" else output_content


def amended(output: str) -> str:
    """A page with what the theme lacks for screen readers."""
    for pattern, replacement in AMENDED:
        output = pattern.sub(replacement, output)
    return output


def described() -> list[str]:
    """Packages and single modules that have a page, such as `lfref.io` and `lfref.errors`."""
    package = ROOT / "lfref"
    paths = [*package.glob("[!_]*.py"), *(path.parent for path in package.glob("*/**/__init__.py"))]
    names = (".".join(path.relative_to(ROOT).with_suffix("").parts) for path in paths)
    return sorted(name for name in names if name.split(".")[1] != WITHOUT_PAGE)


def address(name: str) -> str:
    """Path of the page on a package."""
    return f"reference/{name}.md"


def description(name: str) -> str:
    """Page on a single module, or on a package and the modules that lie in it."""
    modules = [f"{name}.{path.stem}" for path in sorted(ROOT.joinpath(*name.split(".")).glob("[!_]*.py"))]
    members = "false" if modules else "null"
    top = f"{SEARCHED_LAST}::: {name}\n    options: {{ heading_level: 1, members: {members} }}\n"
    return "\n".join([top, *(f"::: {module}\n    options: {{ heading_level: 2 }}\n" for module in modules)])


def public_names() -> str:
    """Page on the names that `lfref` itself offers: what each is, and where it is described."""
    lines = [f"- [`lfref.{name}`][{home}.{name}]: {first_line(home, name)}" for name, home in lfref._HOMES.items()]
    return "\n".join(["# Public names", "", "What `lfref` itself offers:", "", *lines, ""])


def first_line(home: str, name: str) -> str:
    """First line of the docstring of what a module defines."""
    module = ast.parse(ROOT.joinpath(*home.split(".")).with_suffix(".py").read_text("utf-8"))
    (definition,) = (node for node in module.body if getattr(node, "name", None) == name)
    return (ast.get_docstring(definition) or "").partition("\n")[0]
