# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Names of layers and surfaces, and their tags.

A *group* is a name with a dimension, 3 for layers and 2 for surfaces, and a tag. Names come from
the user or from a file; tags without a name are called ``layer_7`` and ``surface_7``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral
from typing import TypeAlias

import numpy as np

from dolfinx_feti.runtime.arrays import Numbers

__all__ = [
    "Group",
    "Groups",
    "checked_groups",
    "merged_names",
    "names_in_use",
    "tags_with_names",
    "with_default_names",
]

#: Dimension and tag of each name.
Groups: TypeAlias = Mapping[str, tuple[int, int]]

#: Name, dimension and tag.
Group: TypeAlias = tuple[str, int, int]


def checked_groups(names: Groups) -> list[Group]:
    """Return name, dimension and tag of each group, without those whose name is empty.

    Raises:
        TypeError: The names are no mapping, or one of them is not mapped to a sequence.
        ValueError: A name is not mapped to two integers.
    """
    expected = "give Mapping[str, tuple[int, int]]"
    if not isinstance(names, Mapping):
        raise TypeError(f"names is {names!r}: {expected}.")
    for name, pair in names.items():
        if not isinstance(pair, Sequence):
            raise TypeError(f"names[{name!r}] is {pair!r}: {expected}, the dimension and the tag.")
        if len(pair) != 2 or not all(isinstance(number, Integral) for number in pair):
            raise ValueError(
                f"names[{name!r}] is {pair!r}: give the dimension and the tag, (2, 3) for facets "
                "tagged 3."
            )
    return [(name, *pair) for name, pair in names.items() if name]


def with_default_names(names: Mapping[str, int], tags: Iterable[int], dim: int) -> dict[str, int]:
    """Return the names of all tags that occur; a tag without a name is called ``layer_7``.

    Names of other tags are dropped. The tag 0 gets no such name: it marks nothing.

    Args:
        names: Names and their tags.
        tags: All tags that occur.
        dim: 3 for layers, 2 for surfaces, which are called ``surface_7``.
    """
    present = {int(tag) for tag in tags}
    named = {name: tag for name, tag in names.items() if tag in present}
    prefix = "layer" if dim == 3 else "surface"
    return named | {f"{prefix}_{tag}": tag for tag in sorted(present - {0, *named.values()})}


def merged_names(
    of_file: Mapping[str, int], groups: Sequence[Group], dim: int, tags: Numbers
) -> dict[str, int]:
    """Return the names of the tags of one dimension, from the user or else from the file.

    Args:
        of_file: Names and tags of the file. A name is dropped if the user names its tag.
        groups: Groups of the user.
        dim: 3 for layers, 2 for surfaces.
        tags: Tags of all entities; names of other tags are dropped.
    """
    of_user = {name: tag for name, group_dim, tag in groups if group_dim == dim}
    remaining = {name: tag for name, tag in of_file.items() if tag not in of_user.values()}
    return names_in_use(remaining | of_user, tags)


def names_in_use(names: Mapping[str, int], tags: Numbers) -> dict[str, int]:
    """Return the names whose tags occur, with these tags.

    Args:
        names: Tags by name.
        tags: Tags of all cells or facets, (n,).
    """
    return {name: tag for name, tag in names.items() if np.any(tags == tag)}


def tags_with_names(names: Mapping[str, int], tags: Numbers) -> list[tuple[str | None, int]]:
    """Return name and tag of each tag that occurs; the name is None for a nameless one."""
    name_of = {tag: name for name, tag in names.items()}
    return [(name_of.get(int(tag)), int(tag)) for tag in np.unique(tags)]
