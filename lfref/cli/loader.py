"""Hydra's way of composing a configuration, with our checks in it: nothing has been made of it by then.

Every composition goes through here, those of `--help` and of each job of a sweep too.
"""

import difflib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from hydra._internal import hydra as runner
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.override_parser.types import Override
from hydra.core.utils import JobRuntime
from omegaconf import DictConfig

from lfref.cli import hydra_node, leaving, options
from lfref.cli.arguments import SHORTHANDS
from lfref.errors import InputError, LfrefError

WRONG_USAGE = 2


class CheckedLoader(ConfigLoaderImpl):
    """Composes what a configuration may be, or leaves with one line."""

    def load_configuration(self, *args: Any, **kwargs: Any) -> DictConfig:
        """As Hydra's."""
        self._overrides: list[Override] = []
        try:
            config = super().load_configuration(*args, **kwargs)
            hydra_node.check(config.hydra)
        except Exception as error:  # whatever it is, it is about the configuration
            said = error if isinstance(error, LfrefError) else self._explained(error)
            leaving.fail(JobRuntime.instance().get("name"), said, WRONG_USAGE)
        return config

    def _process_config_searchpath(self, config_name: str | None, parsed_overrides: list[Override], repo: Any) -> None:
        """As Hydra's, which imports the packages on a search path."""
        self._overrides = parsed_overrides
        for override in parsed_overrides:
            if "searchpath" in override.key_or_group:
                remedy = "give --config-dir FOLDER"
                raise InputError("hydra.searchpath must be left out", got=override.input_line, remedy=remedy)
        super()._process_config_searchpath(config_name, parsed_overrides, repo)

    def _compose_config_from_defaults_list(self, defaults: list[Any], repo: Any) -> DictConfig:
        """As Hydra's, which merges the overrides of single values into it right afterwards."""
        config = super()._compose_config_from_defaults_list(defaults, repo)
        ours = [override for override in self._overrides if not override.is_hydra_override()]
        others = [*SHORTHANDS, *repo.get_group_options("", None)]
        added = [override.get_key_element()[1:] for override in ours if override.is_add()]
        packages = {default.override_key: default.package for default in defaults if default.override_key in added}
        if packages:
            rest = [default for default in defaults if default.override_key not in packages]
            options.check_groups(super()._compose_config_from_defaults_list(rest, repo), packages, others)
        options.check(config, [each for each in ours if not repo.group_exists(each.key_or_group)], others)
        return config

    def _explained(self, error: Exception) -> object:
        """Hydra's message as one line; a choice that does not exist gets those that do."""
        for override in self._overrides:
            group, value = override.key_or_group, override.value()
            known = self.repository.get_group_options(group)
            if known and isinstance(value, str) and value not in known:
                near = difflib.get_close_matches(value, known, 1)
                remedy = f"perhaps {group}={near[0]}" if near else ""
                return InputError(f"{group} must be one of {', '.join(known)}", got=repr(value), remedy=remedy)
        alien = re.search(r"Could not override '([^']+)'.\s+No match in the defaults list", str(error))
        if alien:
            return options.unknown(alien[1], options.Place(None), ())
        return str(error) or error.__cause__


@contextmanager
def checking() -> Iterator[None]:
    """While this lasts, Hydra composes by `CheckedLoader`."""
    before = runner.ConfigLoaderImpl
    runner.ConfigLoaderImpl = CheckedLoader  # type: ignore[misc]
    try:
        yield
    finally:
        runner.ConfigLoaderImpl = before  # type: ignore[misc]
