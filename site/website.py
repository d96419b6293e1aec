"""Hooks of mkdocs: which files of this repository are pages, and the reference made from docstrings.

mkdocs calls the functions named `on_...`; a warning that they log fails the build.
"""

import ast
import html
import importlib
import logging
import os
import re
import sys
from pathlib import Path
from types import ModuleType

import griffe
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url

import lfref
from lfref.cli import main

ROOT = Path(__file__).resolve().parents[1]
PUBLISHED = (
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "docs/*.md",
    "docs/*.ipynb",
    "docs/*.css",
    "docs/*.js",
    "docs/pictures/*",
)
# The face of this package are the commands, which tell about themselves by `--help`.
WITHOUT_PAGE = "cli"
PUBLIC_NAMES, COMMANDS = "reference/names.md", "reference/commands.md"
# A line of a configuration, `key: value # what it is`, and one that chooses a file of a group, `- group: file # ...`.
OPTION = re.compile(r"^(?P<indent> *)(?P<key>\w+): *(?P<value>[^#]*?) *(?:# (?P<text>.*))?$")
CHOICE = re.compile(r"^  - /?(?P<key>[\w@.]+): (?P<value>\w+)(?: # (?P<text>.*))?$")
# Who searches for a word first wants the page that explains it, then the functions that have it in their description.
SEARCHED_LAST = "---\nsearch:\n  boost: 0.2\n---\n\n"
# What a browser fetches to show a page; where a link leads it goes only when people click on it.
FETCHED = re.compile(
    r"<(?:script|link(?! rel=.canonical)|img|iframe|source)\b[^>]*?\b(?:src|href)=[\"']?((?:https?:)?//[^\"'\s>]+)"
)
# The page that opens the site, with its picture; on the site people refocus the picture themselves.
FRONT, PICTURE = "README.md", re.compile(r"^!\[[^\]]*\]\(docs/pictures/page\.webp\)$", re.MULTILINE)
# Badges are on other hosts; the site leaves them out.
BADGE = re.compile(r"!\[[^\]]*\]\((?:https:|\.\./)[^)]*\)\s*")
LIVING, CARD = "living.html", "card.jpg"
LIVING_PICTURE = f"""\
<iframe class="living" src="{LIVING}#embed" title="A simulated scene to refocus: click a point to focus there"></iframe>

Click a point to focus there. The scene is simulated. [The page alone]({LIVING}); [how to make one](docs/viewing.md).
"""
# Pictures of path-traced scenes; those whose pages `page.py --gallery` has made are living.
GALLERY = "docs/gallery.md"
GALLERY_PICTURE = re.compile(r"^!\[(?P<what>[^\]]*)\]\(pictures/gallery_(?P<name>\w+)\.jpg\)$", re.MULTILINE)
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
    """Let the navigation lead to the reference; give the site its address, if one is known."""
    config.site_url = config.site_url or site_address()
    config.nav.append({"Reference": [COMMANDS, PUBLIC_NAMES, *({name: address(name)} for name in described())]})


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Publish what `PUBLISHED` names as it lies in the repository, and the reference; the theme's files stay."""
    theme = [file for file in files if file.src_dir != config.docs_dir]
    pages = [
        File(path.relative_to(ROOT).as_posix(), str(ROOT), config.site_dir, config.use_directory_urls)
        for pattern in PUBLISHED
        for path in sorted(ROOT.glob(pattern))
    ]
    living = script("page")
    living.make()
    shown = {LIVING: living.PAGE, CARD: living.CARD}
    made = [path for path in living.RUN.glob("*/index.html") if path != living.PAGE]
    shown |= {f"gallery_{path.parent.name}.html": path for path in made}
    pages += [File.generated(config, name, abs_src_path=str(path)) for name, path in shown.items()]
    texts = {COMMANDS: commands(), PUBLIC_NAMES: public_names()} | {
        address(name): description(name) for name in described()
    }
    return Files([*theme, *pages, *(File.generated(config, name, content=text) for name, text in texts.items())])


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Open the site with the living picture, over the width of the contents' list too; pictures of the gallery live."""
    if page.file.src_uri == GALLERY:
        return GALLERY_PICTURE.sub(lambda picture: living_picture(picture, files), markdown)
    if page.file.src_uri != FRONT:
        return markdown
    page.meta["hide"] = ["toc"]
    markdown, n_pictures = PICTURE.subn(LIVING_PICTURE, BADGE.sub("", markdown))
    if n_pictures != 1:
        log.warning(f"{FRONT} must show docs/pictures/page.webp once; it does {n_pictures} times")
    return markdown


def living_picture(picture: re.Match[str], files: Files) -> str:
    """A picture of the gallery, with its page if the site has one."""
    address = f"gallery_{picture['name']}.html"
    if files.get_file_from_path(address) is None:
        return picture[0]
    frame = f'<iframe class="living scene" src="../{address}#embed" loading="lazy" title="{picture["what"]}"></iframe>'
    return f"\n{frame}\n"


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Warn of pages that ask another host for something; amend what the theme writes."""
    for url in FETCHED.findall(output):
        log.warning(f"{page.file.src_uri} asks another host: {url}")
    return amended(output).replace("</head>", f"{social(page, config)}</head>", 1)


def on_post_template(output_content: str, template_name: str, config: MkDocsConfig) -> str:
    """Amend the page of an unknown address too."""
    return amended(output_content) if template_name == "404.html" else output_content


def amended(output: str) -> str:
    """A page with what the theme lacks for screen readers."""
    for pattern, replacement in AMENDED:
        output = pattern.sub(replacement, output)
    return output


def social(page: Page, config: MkDocsConfig) -> str:
    """What other sites show of a page that is linked there; the picture's address is whole if the site's is known."""
    name = config.site_name if page.is_homepage else f"{page.title} - {config.site_name}"
    card = f"{config.site_url}{CARD}" if config.site_url else get_relative_url(CARD, page.url)
    facts = {
        "og:type": "website",
        "og:site_name": config.site_name,
        "og:title": name,
        "og:description": config.site_description,
        "og:image": card,
        "og:image:width": "1200",
        "og:image:height": "630",
        "og:image:alt": "Fruit on a table in focus, leaves before it and lamps behind it out of focus",
        **({"og:url": page.canonical_url} if page.canonical_url else {}),
    }
    lines = [f'<meta property="{fact}" content="{html.escape(value or "")}">' for fact, value in facts.items()]
    twitter = {"card": "summary_large_image", "title": name, "description": config.site_description, "image": card}
    lines += [f'<meta name="twitter:{fact}" content="{html.escape(value or "")}">' for fact, value in twitter.items()]
    return "\n".join([*lines, ""])


def site_address() -> str | None:
    """Address of the site: `LFREF_SITE` in the environment, or where GitHub publishes the pages of a repository."""
    owner, _, name = os.environ.get("GITHUB_REPOSITORY", "").partition("/")
    address = os.environ.get("LFREF_SITE") or (f"https://{owner}.github.io/{name}" if name else None)
    return f"{address.rstrip('/')}/" if address else None


def script(name: str) -> ModuleType:
    """A script of the benchmarks as a module."""
    sys.path.append(str(ROOT / "benchmarks"))
    return importlib.import_module(name)


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


def commands() -> str:
    """Page on the commands and their options, by the files of `conf/`."""
    lines = ["# Commands", "", "Every command is a Hydra application: `lfref COMMAND [PATH ...] [KEY=VALUE ...]`.", ""]
    for name, what in main.COMMANDS.items():
        lines += [
            f"## lfref {name}",
            "",
            f"{what[0].upper()}{what[1:]}.",
            "",
            *options_of(ROOT / "conf" / f"{name}.yaml"),
        ]
    lines += ["## All commands", "", *options_of(ROOT / "conf" / "base.yaml")]
    groups = sorted(path for path in (ROOT / "conf").iterdir() if path.is_dir())
    lines += ["## Groups", "", "`GROUP=FILE` takes all lines of a file of `conf/GROUP`.", ""]
    for group in groups:
        files = sorted(group.glob("*.yaml"))
        lines += [f"### {group.name}", "", "| file | what it is |", "|---|---|"]
        lines += [f"| `{path.stem}` | {cell(heading(path))} |" for path in files]
        lines += ["", *(options_of(files[0]) if len(files) == 1 else [])]
    return "\n".join(lines)


def heading(path: Path) -> str:
    """First line of the comment that opens a configuration."""
    comments = re.findall(r"^# (?!@package)(.*)", path.read_text("utf-8"), re.MULTILINE)
    return comments[0] if comments else ""


def options_of(path: Path) -> list[str]:
    """Table of the groups and options of a configuration."""
    lines, above = ["| option | default | what it is |", "|---|---|---|"], list[str]()
    for line in path.read_text("utf-8").splitlines():
        entry = CHOICE.match(line) or OPTION.match(line)
        if entry is None or entry["key"] in ("defaults", "_target_"):
            continue
        if "indent" in entry.groupdict():
            above = [*above[: len(entry["indent"]) // 2], entry["key"]]
        key = ".".join(above) if "indent" in entry.groupdict() else entry["key"]
        if not (entry["value"] or entry["text"]):
            continue
        default = f"`{cell(entry['value'])}`" if entry["value"] else ""
        lines.append(f"| `{key}` | {default} | {cell(entry['text'] or '')} |")
    return [*lines, ""]


def cell(text: str) -> str:
    """Text for a cell of a table."""
    return text.replace("|", "\\|").replace("<", "&lt;")


def public_names() -> str:
    """Page on the names that `lfref` itself offers: what each is, and where it is described."""
    lines = [f"- [`lfref.{name}`][{home}.{name}]: {first_line(home, name)}" for name, home in lfref._HOMES.items()]
    return "\n".join(["# Public names", "", "What `lfref` itself offers:", "", *lines, ""])


def first_line(home: str, name: str) -> str:
    """First line of the docstring of what a module defines."""
    module = ast.parse(ROOT.joinpath(*home.split(".")).with_suffix(".py").read_text("utf-8"))
    (definition,) = (node for node in module.body if getattr(node, "name", None) == name)
    return (ast.get_docstring(definition) or "").partition("\n")[0]
