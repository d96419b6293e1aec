"""What an operator says of itself: how it takes samples that count less than others."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])


class Traits(NamedTuple):
    """What an operator (views, slopes, weights=, positions=) -> stack does with the views."""

    reads: Literal["sums", "compares", "predicts"] = "sums"
    """`sums`: linear in the views, so that weighted samples are summed and divided by the sum of their weights.
    `compares`: it looks for what views have in common, which weighted views would mislead: they are filled first.
    `predicts`: it estimates what the whole aperture records, so that missing views are predicted for it too."""
    symmetric: bool = False
    """Whether weights of views must be symmetric about both axes."""


def traits(operator: Callable[..., Any]) -> Traits:
    """The traits of an operator, with options bound to it or without; a function without any sums."""
    found: Traits = getattr(getattr(operator, "func", operator), "traits", Traits())
    return found


def has_traits(
    reads: Literal["sums", "compares", "predicts"], symmetric: bool = False
) -> Callable[[Function], Function]:
    """A decorator that gives an operator these traits."""

    def decorate(function: Function) -> Function:
        function.traits = Traits(reads, symmetric)  # type: ignore[attr-defined]
        return function

    return decorate
