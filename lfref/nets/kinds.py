"""The kinds of networks there are: what checkpoints may hold, and configurations may build.

Names only, so that a command line can be checked against them before PyTorch is loaded.
"""

KINDS: dict[str, str] = {
    "refnet": "lfref.nets.refnet.RefNet",
}
"""`Network.name` -> the class, as `conf/net` names it."""
