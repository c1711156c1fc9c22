"""YAML of unknown origin."""

from typing import Any, Final

import yaml

_DEEPEST: Final = 50
_MOST_NODES: Final = 250_000

Loader: Final[Any] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
TextLoader: Final[Any] = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
"""Loads every value as a string: what is written stays as it is."""


def load_yaml(text: str, loader: Any = Loader, *, aliases: bool = False) -> Any:
    """Load a YAML document that is neither deep, large nor folded.

    Parameters
    ----------
    text : str
        The document.
    loader : type
        A loader of PyYAML.
    aliases : bool
        Whether a part may stand for itself in several places: what a few lines unfold to may be
        larger than any memory, for a loader that merges or for whoever walks through it.

    Raises
    ------
    yaml.YAMLError
        If it is not such a document, or nested too deeply, or larger than is read.
    """
    depth = nodes = 0
    for event in yaml.parse(text, Loader=loader):
        nodes += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            # The loader in C ends the process when it runs out of stack.
            raise yaml.YAMLError("it is nested too deeply")
        if nodes > _MOST_NODES:
            raise yaml.YAMLError(f"it has more than {_MOST_NODES} values")
        if isinstance(event, yaml.AliasEvent) and not aliases:
            raise yaml.YAMLError(f"the alias *{event.anchor:.40} is not allowed")
    return yaml.load(text, Loader=loader)
