"""Shares of a work: every item falls into one of them, and an empty one is no failure."""

import pytest

from lfref.cli import shards
from lfref.errors import InputError


def test_shares_hold_every_item_once():
    assert shards.share_of("abcde", "2/3") == ["b", "e"]
    assert sorted(item for number in (1, 2, 3) for item in shards.share_of("abcde", f"{number}/3")) == list("abcde")
    assert shards.share_of("abcde", None) == list("abcde")


def test_an_empty_share_is_named_in_the_log(caplog):
    with caplog.at_level("INFO"):
        assert shards.share_of("ab", "2/3") == ["b"]
        assert caplog.text == ""
        assert shards.share_of("ab", "3/3") == []
    assert "no light field falls into shard 3/3" in caplog.text


@pytest.mark.parametrize("shard", ["0/2", "3/2", "1", "1/0", 1])
def test_what_is_no_share_is_refused(shard):
    with pytest.raises(InputError, match="shard must be K/N, such as 2/8"):
        shards.share_of("ab", shard)
